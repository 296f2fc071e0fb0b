"""The repeated signal of the enable key, what an operator does, and who asks for what.

Several inputs may ask.

What is heard of less often than every LAPSE counts as let go, and must then be let go and pressed
again: a page or a computer that comes back after a silence with its key down does not go on by
itself. Pinned by tests/robot/test_clutch.py.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Literal, Protocol

from softmap_edge.model.safety import STALE

Source = Literal["hand", "knob"]

# s without a word, after which a key counts as let go: the guard's own limit for commands
LAPSE = STALE


class HeldKey:
    """A key whose state is reported repeatedly (`say`), by another thread perhaps."""

    def __init__(self) -> None:
        self._last, self._down = float("-inf"), False
        self._must_let_go = True  # who comes with the key down has not pressed it for us
        self._lock = threading.Lock()

    def say(self, down: bool, now: float) -> None:
        """Record whether it is down at `now` s, a steady clock."""
        with self._lock:
            silent = now - self._last > LAPSE
            self._must_let_go = down and (self._must_let_go or silent)
            self._down, self._last = down, max(self._last, now)

    def held(self, now: float) -> bool:
        """Return whether it is held at `now` s."""
        with self._lock:
            return self._down and not self._must_let_go and now - self._last <= LAPSE


@dataclass(frozen=True)
class Controls:
    """What an operator does.

    Whether the key is held, where the knob is (right, up; -1 to 1 of the range), and which of hand
    and knob drives.
    """

    held: bool = False
    knob: tuple[float, float] = (0.0, 0.0)
    source: Source = "knob"


class Input(Protocol):
    """Somewhere an operator's controls come from: a page, a terminal, another computer."""

    name: str

    def controls(self, now: float) -> Controls:
        """Return what the operator does at `now` s; it is asked often, and must not wait."""
        ...

    def asked(self) -> str | None:
        """Return the last request since: `stop`, `emergency`, `acknowledge` or `end`."""
        ...

    def rest(self, knob: tuple[float, float]) -> None:
        """Hear where the finger is while nothing is driven, so that the knob begins there."""
        ...


GRAVEST = ("emergency", "stop", "end", "acknowledge")


class Wish:
    """A slot for what was asked for: of several the gravest stays, none is queued."""

    def __init__(self) -> None:
        self._wish: str | None = None
        self._lock = threading.Lock()

    def ask(self, wish: str) -> None:
        """Ask for one of GRAVEST."""
        with self._lock:
            if self._wish is None or GRAVEST.index(wish) < GRAVEST.index(self._wish):
                self._wish = wish

    def take(self) -> str | None:
        """Return what was asked for, and forget it."""
        with self._lock:
            wish, self._wish = self._wish, None
        return wish
