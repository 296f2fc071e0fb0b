"""Keys of a terminal: typed keys by name, and a held key, which a terminal does not report.

A terminal reports no key-up. It repeats a held key: first after at most `FIRST` s, then at least
every `REPEAT` s. So a key pressed once may or may not be held; only a repetition shows that it is.
Motion that must not continue after a tap (`robot/commissioning/keys.py`) starts at the first
repetition. Pinned by tests/robot/test_clutch.py, tests/robot/test_move.py and
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

# s until the first repetition of a key (keyboards: 0.25 to 0.66), and between two (0.03 to 0.1)
FIRST, REPEAT = 0.7, 0.2
EMERGENCY = "e"  # key of the emergency stop in every command that drives: torque off at once
ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
ESC = "\x1b"
MOST = 4096  # bytes read at a time; more were pasted, not typed


class RepeatedKey:
    """A terminal's key, which only reports repetitions: it is released if none comes in time."""

    def __init__(self) -> None:
        self._last, self._again = float("-inf"), False

    def press(self, now: float) -> None:
        """Record a press or repetition of the key at `now` s."""
        self._again = self.held(now)
        self._last = now

    def let_go(self) -> None:
        """Count it as released until the next press."""
        self._last, self._again = float("-inf"), False

    def held(self, now: float) -> bool:
        """Return whether it may be held at `now` s: it repeats, or a repetition may still come."""
        return now - self._last <= (REPEAT if self._again else FIRST)

    def repeats(self, now: float) -> bool:
        """Return whether it is certainly held at `now` s: it has repeated recently."""
        return self._again and self.held(now)


def terminal() -> int | None:
    """Return the descriptor of standard input if it is a terminal to read from, else None."""
    try:
        file = sys.stdin.fileno()
    # standard input is closed, or replaced by an object that is not a file
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
    """The keys typed at the terminal `file`, without echo, from entering to leaving.

    Ctrl-C remains an interrupt.
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
        # the terminal may be gone; discard repetitions, which are not meant for the shell
        with suppress(termios.error):
            termios.tcsetattr(self._file, termios.TCSAFLUSH, self._before)

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Restore the terminal for a while, so that a line can be read from it."""
        termios.tcsetattr(self._file, termios.TCSADRAIN, self._before)
        try:
            yield
        finally:
            tty.setcbreak(self._file)

    def read(self) -> list[str]:
        """Return the names of the keys typed since the last call, without waiting.

        A closed terminal counts as escape.
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

    A key that is still held would become part of an answer.
    """
    with Typed(file) as typed:
        since = time.monotonic()
        while not typed.gone and time.monotonic() - since < REPEAT:
            if typed.read():
                since = time.monotonic()
            time.sleep(0.02)


def named(read: bytes) -> list[str]:
    """Return the names of the keys in the text of a terminal.

    They are characters in lower case, `up`, `down`, `left`, `right`, `escape`; unknown sequences
    are ignored.
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
