"""Terminal keys: Space or an arrow (held) drives, Esc releases tension, e stops, q ends.

A terminal reports no key-up, so a key counts as held while it repeats (`servo/terminal.py`). A
release is detected 0.2 s later, or 0.7 s after a short tap. Pinned by
tests/robot/test_teleop_terminal.py.
"""

from __future__ import annotations

from types import TracebackType
from typing import Self

from softmap_edge.robot.servo.terminal import EMERGENCY, RepeatedKey, Typed
from softmap_edge.robot.teleop.keys import Controls, Source, Wish

STEP = 0.04  # of the range, per repetition of an arrow
ARROWS = {
    "right": (1, 0), "left": (-1, 0), "up": (0, 1), "down": (0, -1),
    "d": (1, 0), "a": (-1, 0), "w": (0, 1), "s": (0, -1),
}  # fmt: skip
WISHES = {"escape": "stop", "x": "stop", EMERGENCY: "emergency", "q": "end", "r": "acknowledge"}
HELP = (
    "Space (held) drives, arrows or WASD move, Esc releases tension, "
    f"{EMERGENCY} stops at once, r resets a fault, q ends"
)


class Terminal:
    """The keys of a terminal, as an input; a context manager that restores the terminal.

    `source`: the input that drives.
    """

    name = "the terminal"

    def __init__(self, source: Source, descriptor: int) -> None:
        self._source, self._typed = source, Typed(descriptor)
        self._key, self._wish = RepeatedKey(), Wish()
        self._knob = (0.0, 0.0)

    def __enter__(self) -> Self:
        self._typed.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self._typed.__exit__(kind, fault, at)

    def controls(self, now: float) -> Controls:
        """Read the typed keys."""
        for key in self._typed.read():
            self._press(key, now)
        return Controls(self._key.held(now), self._knob, self._source)

    def asked(self) -> str | None:
        """Return the request of a key."""
        return self._wish.take()

    def rest(self, knob: tuple[float, float]) -> None:
        """Set the knob to the position of the finger."""
        self._knob = knob

    def _press(self, key: str, now: float) -> None:
        if key in WISHES:
            self._key.let_go()
            self._wish.ask(WISHES[key])
        elif key == " ":
            self._key.press(now)
        elif key in ARROWS:
            self._key.press(now)
            x, y = (
                min(max(at + STEP * way, -1.0), 1.0) for at, way in zip(self._knob, ARROWS[key])
            )
            self._knob = (x, y)
