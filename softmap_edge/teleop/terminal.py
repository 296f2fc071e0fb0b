"""The terminal's keys: Space or an arrow held drives, Esc slackens, e stops at once, q ends.

A terminal tells no key-up: a key counts as held while it repeats (`keys.RepeatedKey`), so letting go is noticed 0.2 s
later, after a short tap 0.7 s. Pinned by tests/test_teleop_terminal.py.
"""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from types import TracebackType
from typing import Any, Self

from softmap_edge.teleop.keys import Controls, RepeatedKey, Source, Wish

STEP = 0.04  # of the range, a repetition of an arrow
ESC = "\x1b"
ARROWS = {
    f"{ESC}[C": (1, 0), f"{ESC}[D": (-1, 0), f"{ESC}[A": (0, 1), f"{ESC}[B": (0, -1),
    "d": (1, 0), "a": (-1, 0), "w": (0, 1), "s": (0, -1),
}  # fmt: skip
WISHES = {ESC: "stop", "x": "stop", "e": "emergency", "q": "end", "r": "acknowledge"}
HELP = "hold Space to drive, arrows or WASD move, Esc slackens, e stops at once, r resets a fault, q ends"


class Terminal:
    """The keys of a terminal, as an input; a context manager that leaves it as it was. `source`: what drives."""

    name = "the terminal"

    def __init__(self, source: Source, descriptor: int | None = None) -> None:
        self._source, self._fd = source, sys.stdin.fileno() if descriptor is None else descriptor
        self._key, self._wish = RepeatedKey(), Wish()
        self._knob = (0.0, 0.0)
        self._before: list[Any] | None = None

    def __enter__(self) -> Self:
        self._before = termios.tcgetattr(self._fd)
        tty.setcbreak(self._fd)  # Ctrl-C stays an interrupt
        return self

    def __exit__(self, kind: type[BaseException] | None, fault: BaseException | None, at: TracebackType | None) -> None:
        if self._before is not None:
            termios.tcsetattr(self._fd, termios.TCSADRAIN, self._before)

    def controls(self, now: float) -> Controls:
        """Read what was typed."""
        while select.select([self._fd], [], [], 0.0)[0]:
            typed = os.read(self._fd, 256).decode("ascii", "ignore")
            if not typed:
                break
            for key in _keys(typed):
                self._press(key, now)
        return Controls(self._key.held(now), self._knob, self._source)

    def asked(self) -> str | None:
        """Return what was asked for by a key."""
        return self._wish.take()

    def rest(self, knob: tuple[float, float]) -> None:
        """Begin where the finger is."""
        self._knob = knob

    def _press(self, key: str, now: float) -> None:
        if key in WISHES:
            self._key.let_go()
            self._wish.ask(WISHES[key])
        elif key == " ":
            self._key.press(now)
        elif key in ARROWS:
            self._key.press(now)
            x, y = (min(max(at + STEP * way, -1.0), 1.0) for at, way in zip(self._knob, ARROWS[key]))
            self._knob = (x, y)


def _keys(typed: str) -> list[str]:
    """Split what was typed into keys; an unknown sequence of the terminal's is no Esc."""
    found, rest = [], typed
    while rest:
        if rest.startswith((f"{ESC}[", f"{ESC}O")) and len(rest) >= 3:
            end = next((k for k, c in enumerate(rest[2:], 2) if c.isalpha() or c == "~"), len(rest) - 1)
            found.append(f"{ESC}[{rest[2 : end + 1]}")
            rest = rest[end + 1 :]
        else:
            found.append(rest[0].lower())
            rest = rest[1:]
    return found
