"""The keys of a terminal: what is typed, by name, and a held key, which a terminal does not report.

A terminal reports no key-up. It repeats a held key: the first time after `FIRST` s at most, then
each `REPEAT` s at most. So a key that was pressed once may be held or not, and only its first
repetition shows it: what must not run on after a tap (`robot/commissioning/keys.py`) begins with
that. Pinned by tests/robot/test_clutch.py, tests/robot/test_move.py and
tests/robot/test_emergency_key.py.
"""

from __future__ import annotations

import os
import select
import sys
import termios
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import TracebackType
from typing import Self

# s until a keyboard's first repetition of a key (0.25 to 0.66), and between two (0.03 to 0.1)
FIRST, REPEAT = 0.7, 0.2
EMERGENCY = "e"  # wherever a terminal drives: torque off at once
ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
ESC = "\x1b"
MOST = 4096  # bytes that are read at a time: more was pasted, not typed


class RepeatedKey:
    """A terminal's key, which only reports repetitions: without one in time it is released."""

    def __init__(self) -> None:
        self._last, self._again = float("-inf"), False

    def press(self, now: float) -> None:
        """Record that the key, or a repetition of it, came at `now` s."""
        self._again = self.held(now)
        self._last = now

    def let_go(self) -> None:
        """Count it as let go, whatever comes."""
        self._last, self._again = float("-inf"), False

    def held(self, now: float) -> bool:
        """Return whether it may be held at `now` s: it repeats, or was pressed and may yet."""
        return now - self._last <= (REPEAT if self._again else FIRST)

    def repeats(self, now: float) -> bool:
        """Return whether it is surely held at `now` s: it has repeated, and lately."""
        return self._again and self.held(now)


def terminal() -> int | None:
    """Return the descriptor of a terminal at standard input whose keys are ours to read.

    Else None.
    """
    try:
        file = sys.stdin.fileno()
    # closed, or replaced by something that is no file
    except (AttributeError, OSError, ValueError):
        return None
    return file if os.isatty(file) and _foreground(file) else None


def _foreground(file: int) -> bool:
    """Return whether this process may read `file`; the system stops background readers."""
    try:
        return os.tcgetpgrp(file) == os.getpgrp()
    except OSError:  # a terminal without job control
        return True


class Typed:
    """The keys typed at the terminal `file`, unechoed, from entering to leaving.

    Ctrl-C stays an interrupt.
    """

    def __init__(self, file: int) -> None:
        self._file = file
        self._before: list[int | list[bytes | int]] = []  # as termios has its settings
        self.gone = False

    def __enter__(self) -> Self:
        self._before = termios.tcgetattr(self._file)
        tty.setcbreak(self._file)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # a terminal that is gone; what still repeats is not for the shell
        with suppress(termios.error):
            termios.tcsetattr(self._file, termios.TCSAFLUSH, self._before)

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Leave the terminal as it was for a while, so that a line can be read from it."""
        termios.tcsetattr(self._file, termios.TCSADRAIN, self._before)
        try:
            yield
        finally:
            tty.setcbreak(self._file)

    def read(self) -> list[str]:
        """Return the names of the keys that came since, without waiting.

        A terminal that is gone counts as escape.
        """
        read = b""
        while not self.gone and len(read) < MOST and select.select([self._file], [], [], 0.0)[0]:
            if not _foreground(self._file):
                break
            more = _read(self._file)
            read += more or ESC.encode()
            self.gone = not more
        return named(read)


def _read(file: int) -> bytes:
    try:
        return os.read(file, 256)
    except OSError:
        return b""


def wait_for_release(file: int) -> None:
    """Wait until no key of the terminal `file` has come for `REPEAT` s.

    One that is held would be part of an answer.
    """
    with Typed(file) as typed:
        since = time.monotonic()
        while not typed.gone and time.monotonic() - since < REPEAT:
            if typed.read():
                since = time.monotonic()
            time.sleep(0.02)


def named(read: bytes) -> list[str]:
    """Return the names of the keys in what a terminal sent.

    They are characters, in small letters, `up`, `down`, `left`, `right`, `escape`; a sequence that
    is not known is no key.
    """
    keys, rest = [], read.decode("ascii", "ignore")
    while rest:
        if rest.startswith((f"{ESC}[", f"{ESC}O")) and len(rest) >= 3:
            end = next(
                (k for k, c in enumerate(rest[2:], 2) if c.isalpha() or c == "~"), len(rest) - 1
            )
            keys += [ARROWS[rest[2]]] if end == 2 and rest[2] in ARROWS else []
            rest = rest[end + 1 :]
        else:
            keys.append("escape" if rest[0] == ESC else rest[0].lower())
            rest = rest[1:]
    return keys
