"""A held key of a terminal as a deadman: terminals tell no key-up, so a key counts as held while it repeats.

A terminal repeats a held key some 30 times a second after a first pause of a quarter to half a second; whoever taps moves
a little, whoever holds goes on. Escape, space and q stop. Pinned by tests/test_move.py.
"""

from __future__ import annotations

import os
import select
import sys
import termios
import time
import tty
from types import TracebackType
from typing import Self

from softmap_edge.errors import ServoError

REPEATS = 0.25  # s within which a held key must repeat: the time after which the guard takes a deadman for released
STOP = ("escape", " ", "q", "\x03")
ARROWS = {b"A": "up", b"B": "down", b"C": "right", b"D": "left"}


class Keys:
    """Keys of the terminal `file` (standard input), one at a time, unechoed, from entering to leaving.

    Raises:
        ServoError: it is no terminal.
    """

    def __init__(self, file: int | None = None) -> None:
        self._file = sys.stdin.fileno() if file is None else file
        self._last: tuple[str, float] = ("", -1e9)
        if not os.isatty(self._file):
            raise ServoError("no terminal whose keys could be held; start it in one, or give --hold")

    def __enter__(self) -> Self:
        self._before = termios.tcgetattr(self._file)
        tty.setcbreak(self._file)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        termios.tcsetattr(self._file, termios.TCSAFLUSH, self._before)

    def held(self) -> str:
        """Return the key that is held now, empty if none: its character, `up`, `down`, `left`, `right` or `escape`."""
        while select.select([self._file], [], [], 0.0)[0]:
            read = os.read(self._file, 64)
            if not read:  # the terminal is gone
                return "escape"
            for key in named(read):
                self._last = (key, time.monotonic())
                if key in STOP:
                    return key
        key, since = self._last
        return key if time.monotonic() - since <= REPEATS else ""


def named(read: bytes) -> list[str]:
    """Return the names of the keys in what a terminal sent; a sequence that is not known is no key."""
    keys, at = [], 0
    while at < len(read):
        if read[at : at + 2] in (b"\x1b[", b"\x1bO") and at + 2 < len(read):
            keys += [ARROWS[read[at + 2 : at + 3]]] if read[at + 2 : at + 3] in ARROWS else []
            at += 3
        else:
            one = read[at : at + 1]
            keys.append("escape" if one == b"\x1b" else one.decode("latin-1"))
            at += 1
    return keys
