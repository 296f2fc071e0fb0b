"""The keys of a terminal: typed ones, a held one as a deadman, and the one that is the emergency stop.

Terminals tell no key-up, so a key counts as held while it repeats, some 30 times a second after a first pause of a
quarter to half a second; whoever taps moves a little, whoever holds goes on. Pinned by tests/test_move.py and
tests/test_emergency_key.py.
"""

from __future__ import annotations

import os
import select
import sys
import termios
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any, Self

from softmap_edge.errors import ServoError

REPEATS = 0.25  # s within which a held key must repeat: the time after which the guard takes a deadman for released
EMERGENCY = "e"  # wherever a terminal drives: torque off at once
STOP = (EMERGENCY, "escape", " ", "q", "\x03")
ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
ESC = "\x1b"
MOST = 4096  # bytes that are read at a time: more was pasted, not typed


def terminal() -> int | None:
    """Return the descriptor of standard input where it is a terminal whose keys are ours to read, else None."""
    try:
        file = sys.stdin.fileno()
    except (AttributeError, OSError, ValueError):  # closed, or replaced by something that is no file
        return None
    return file if os.isatty(file) and _foreground(file) else None


def _foreground(file: int) -> bool:
    """Return whether this process may read `file`: whoever does so from the background is stopped by the system."""
    try:
        return os.tcgetpgrp(file) == os.getpgrp()
    except OSError:  # a terminal without job control
        return True


class Typed:
    """The keys that are typed at the terminal `file`, unechoed, from entering to leaving; Ctrl-C stays an interrupt."""

    def __init__(self, file: int) -> None:
        self._file, self._before = file, list[Any]()
        self.gone = False

    def __enter__(self) -> Self:
        self._before = termios.tcgetattr(self._file)
        tty.setcbreak(self._file)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self.gone:  # what still repeats is not for the shell
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
        """Return the names of the keys that came since, never waiting; a terminal that is gone was left by escape."""
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


def named(read: bytes) -> list[str]:
    """Return the names of the keys in what a terminal sent: characters, in small letters, `up`, `down`, `left`,
    `right`, `escape`; a sequence that is not known is no key."""
    keys, rest = [], read.decode("ascii", "ignore")
    while rest:
        if rest.startswith((f"{ESC}[", f"{ESC}O")) and len(rest) >= 3:
            end = next((k for k, c in enumerate(rest[2:], 2) if c.isalpha() or c == "~"), len(rest) - 1)
            keys += [ARROWS[rest[2]]] if end == 2 and rest[2] in ARROWS else []
            rest = rest[end + 1 :]
        else:
            keys.append("escape" if rest[0] == ESC else rest[0].lower())
            rest = rest[1:]
    return keys


class Keys:
    """A held key of the terminal `file` (standard input) as a deadman (`jog.Deadman`), from entering to leaving.

    Args:
        always: no key has to be held, but those that stop do.

    Raises:
        ServoError: it is no terminal.
    """

    def __init__(self, file: int | None = None, *, always: bool = False) -> None:
        file = terminal() if file is None else file
        if file is None or not os.isatty(file):
            raise ServoError("no terminal whose keys could be held; start it in one, or give --hold")
        self._typed, self._always = Typed(file), always
        self._last: tuple[str, float] = ("", -1e9)
        self.stopped = self.emergency = False
        held = "Ctrl-C lets go" if always else "hold any key"
        self.how = f"{held}; space, escape and q stop, {EMERGENCY} is the emergency stop"

    def __enter__(self) -> Self:
        self._typed.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._typed.__exit__(kind, fault, trace)

    def key(self) -> str:
        """Return the key that is held now, empty if none, by the name that `named` gives."""
        for key in self._typed.read():
            self._last = (key, time.monotonic())
            self.stopped |= key in STOP
            self.emergency |= key == EMERGENCY
        key, since = self._last
        return "" if self.stopped or time.monotonic() - since > REPEATS else key

    def held(self) -> bool:
        """Return whether any key is held, or none has to be, and none has stopped it."""
        key = self.key()
        return not self.stopped and (self._always or key != "")
