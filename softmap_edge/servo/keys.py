"""A held key of a terminal as a deadman: terminals tell no key-up, so a key counts as held while it repeats.

A terminal repeats a held key some 30 times a second after a first pause of a quarter to half a second; whoever taps
moves a little, whoever holds goes on. Escape, space and q stop. Pinned by tests/test_move.py.
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
        if file is None and not sys.stdin.isatty():
            file = -1
        self._file = sys.stdin.fileno() if file is None else file
        self._last: tuple[str, float] = ("", -1e9)
        self.stopped = False
        if self._file < 0 or not os.isatty(self._file):
            raise ServoError("no terminal whose keys could be held; start it in one, or give --hold")

    def __enter__(self) -> Self:
        self._before = termios.tcgetattr(self._file)
        tty.setcbreak(self._file)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        termios.tcsetattr(self._file, termios.TCSAFLUSH, self._before)

    def key(self) -> str:
        """Return the key that is held now, empty if none: its character, `up`, `down`, `left`, `right` or `escape`."""
        while not self.stopped and select.select([self._file], [], [], 0.0)[0]:
            read = _read(self._file)
            for key in named(read) or (["escape"] if not read else []):  # a terminal that is gone stops too
                self._last = (key, time.monotonic())
                self.stopped |= key in STOP
        key, since = self._last
        return "" if self.stopped or time.monotonic() - since > REPEATS else key

    def held(self) -> bool:
        """Return whether any key is held, none of them one that stops."""
        return self.key() != ""


def _read(file: int) -> bytes:
    try:
        return os.read(file, 64)
    except OSError:
        return b""


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
