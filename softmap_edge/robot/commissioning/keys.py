"""A held terminal key as enable key of commissioning moves, from its first repetition on.

After a single press the terminal cannot report a release for 0.7 s (`servo/terminal.py`,
`RepeatedKey`). Motion therefore starts only at the first repetition, so a tap moves nothing. Pinned
by tests/robot/test_move.py and tests/robot/test_emergency_key.py.
"""

from __future__ import annotations

import os
import time
from types import TracebackType
from typing import Self

from softmap_edge.errors import ServoError
from softmap_edge.robot.servo.terminal import EMERGENCY, RepeatedKey, Typed, terminal

STOP = (EMERGENCY, "escape", " ", "q", "\x03")


class Keys:
    """A held key of the terminal `file` (standard input) as enable key (`jog.Deadman`).

    It is active from entering to leaving.

    Args:
        always: no key needs to be held, but stop keys work

    Raises:
        ServoError: it is not a terminal.
    """

    def __init__(self, file: int | None = None, *, always: bool = False) -> None:
        file = terminal() if file is None else file
        if file is None or not os.isatty(file):
            raise ServoError(
                "no terminal whose keys could be held; start it in one, or give --hold"
            )
        self._typed, self._always = Typed(file), always
        self._name, self._key = "", RepeatedKey()
        self.presses = 0
        self.stopped = self.emergency = False
        held = "Ctrl-C lets go" if always else "hold any key"
        self.how = f"{held}; space, escape and q stop, {EMERGENCY} is the emergency stop"

    def __enter__(self) -> Self:
        self._typed.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._typed.__exit__(kind, fault, trace)

    def key(self) -> str:
        """Return the key that is down, by its name in `named`, or an empty text.

        It was pressed recently, or it repeats. `.presses` counts new presses.
        """
        now = time.monotonic()
        for key in self._typed.read():
            if key != self._name or not self._key.held(now):
                self._name, self.presses = key, self.presses + 1
                self._key.let_go()
            self._key.press(now)
            self.stopped |= key in STOP
            self.emergency |= key == EMERGENCY
        return self._name if not self.stopped and self._key.held(now) else ""

    def held(self) -> bool:
        """Return whether a key repeats, or none is needed, and no stop key was pressed."""
        self.key()
        return not self.stopped and (self._always or self._key.repeats(time.monotonic()))
