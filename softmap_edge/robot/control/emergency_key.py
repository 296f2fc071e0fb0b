"""An emergency stop on a key of the terminal, for a program that drives a robot.

    robot = Controller(...)
    with EmergencyKey(robot, print), robot:     # the key works until torque is off
        ...

A thread polls the key, so it works while the program computes or waits. If standard input is no
terminal of this program, there is no key, and nothing is printed. Pinned by
tests/robot/test_emergency_key.py.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Self

from softmap_edge.errors import ServoError
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.servo.terminal import EMERGENCY, Typed, terminal

EVERY = 0.02  # s between two polls
HELP = f"{EMERGENCY} is the emergency stop: torque off at once"
PRESSED = (
    "the emergency stop was pressed: torque is off, home is known as before; see that all is "
    "well, then start again"
)


class EmergencyKey:
    """Press the emergency stop of `robot` when the key `EMERGENCY` of this terminal is pressed.

    It is active from entering to leaving; `say` is called with the name of the key.

    Raises:
        ServoError: on leaving, if the key was pressed; a failure that it caused is the context of
            this error.
    """

    def __init__(self, robot: Controller, say: Callable[[str], None]) -> None:
        self._robot, self._say = robot, say
        self._typed: Typed | None = None
        self._said = ""
        self._reading, self._done = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> Self:
        file = terminal()
        if file is not None:
            self._typed = Typed(file).__enter__()
            self._say(HELP)
            self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._typed is None:
            return
        self._done.set()
        self._thread.join()
        self._typed.__exit__(kind, fault, trace)
        if self._said and (fault is None or isinstance(fault, Exception | KeyboardInterrupt)):
            raise ServoError(self._said) from fault

    @contextlib.contextmanager
    def aside(self) -> Iterator[None]:
        """Release the terminal to code that reads a line from it; use it while torque is off."""
        with (
            self._reading,
            contextlib.nullcontext() if self._typed is None else self._typed.aside(),
        ):
            yield

    def _watch(self) -> None:
        assert self._typed is not None
        while not self._done.wait(EVERY) and not self._said:
            with self._reading:
                pressed = EMERGENCY in self._typed.read()
            if pressed:
                self._said = PRESSED
                try:
                    self._robot.emergency()
                except ServoError as fault:
                    self._said = str(fault)
