"""The enable key as a repeated signal, the operator's controls, and requests from several inputs.

A key that is not reported for LAPSE counts as released. The operator must then release and press
it: a page that returns from an interruption with its key down does not resume driving. Pinned by
tests/robot/test_clutch.py.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Literal, Protocol

from softmap_edge.model.safety import STALE

Source = Literal["hand", "knob"]

# s without a report after which a key counts as released: the guard's own limit for commands
LAPSE = STALE


class HeldKey:
    """A key whose state is reported repeatedly (`say`), possibly from another thread."""

    def __init__(self) -> None:
        self._last, self._down = float("-inf"), False
        # a key that is down at the first report was not pressed for this program
        self._must_let_go = True
        self._lock = threading.Lock()

    def say(self, down: bool, now: float) -> None:
        """Record whether the key is down at `now` s (steady clock)."""
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
    """The operator's controls.

    Whether the key is held, the position of the knob (right, up; −1 to 1 of the range), and whether
    hand or knob drives.
    """

    held: bool = False
    knob: tuple[float, float] = (0.0, 0.0)
    source: Source = "knob"


class Input(Protocol):
    """A source of controls: a page, a terminal, or another computer."""

    name: str

    def controls(self, now: float) -> Controls:
        """Return the controls at `now` s; called often, so it must not block."""
        ...

    def asked(self) -> str | None:
        """Return the last request: `stop`, `emergency`, `acknowledge` or `end`."""
        ...

    def rest(self, knob: tuple[float, float]) -> None:
        """Set the knob to the position of the finger while nothing drives."""
        ...


PRIORITY = ("emergency", "stop", "end", "acknowledge")  # requests, highest priority first


class Wish:
    """A slot for the pending request; of several, the one with the highest priority remains."""

    def __init__(self) -> None:
        self._wish: str | None = None
        self._lock = threading.Lock()

    def ask(self, wish: str) -> None:
        """Add one of PRIORITY."""
        with self._lock:
            if self._wish is None or PRIORITY.index(wish) < PRIORITY.index(self._wish):
                self._wish = wish

    def take(self) -> str | None:
        """Return the pending request and clear it."""
        with self._lock:
            wish, self._wish = self._wish, None
        return wish
