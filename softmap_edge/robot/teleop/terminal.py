"""The terminal's keys: hold Space or an arrow to drive, Esc releases tension, e stops, q ends.

A terminal reports no key-up: a key counts as held while it repeats (`terminal_keys`), so letting go
is noticed 0.2 s later, after a short tap 0.7 s. Pinned by tests/robot/test_teleop_terminal.py.
"""

from __future__ import annotations

from types import TracebackType
from typing import Self

from softmap_edge.robot.servo.terminal import EMERGENCY, RepeatedKey, Typed
from softmap_edge.robot.teleop.keys import Controls, Source, Wish

STEP = 0.04  # of the range, a repetition of an arrow
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
    """The keys of a terminal, as an input; a context manager that leaves it as it was.

    `source`: what drives.
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
        """Read what was typed."""
        for key in self._typed.read():
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
            x, y = (
                min(max(at + STEP * way, -1.0), 1.0) for at, way in zip(self._knob, ARROWS[key])
            )
            self._knob = (x, y)
