"""The clock of a robot: real time, or simulated time, which a busy computer does not delay.

A program that drives waits by the clock of the rig (`Rig.time`). *Paced* time follows real time,
for a person who drives a simulated robot. It stands while the computer is held up: the robot stops,
then goes on. In *stepped* time the loop, the servos and the finger advance in steps of the program,
as fast as the computer can. The same program then gives the same result under any load. Pinned by
tests/robot/test_simulated_time.py.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from typing import Protocol

from softmap_edge import _core
from softmap_edge.errors import ServoError

NS = 1_000_000_000  # ns per s
EPOCH = 10 * NS  # ns: start of stepped time; set-up is complete by then
EVERY = 5_000_000  # ns between two readings of the horns; also one step of waiting
FROZEN = 0.6  # s without a report after which a real loop counts as hung
STUCK = 60.0  # s without a period of the loop after which a simulated session ends
PATIENT = 50.0  # factor on time limits for a simulated robot, where waiting longer is safe
WINDOW = 0.1  # s for which paced time goes on without a signal from the driving program
BUSY = "the computer is too busy for real time"


class Clock(Protocol):
    """The time of a robot. After `frozen` s without a report the loop counts as hung."""

    simulated: bool
    stepped: bool
    frozen: float

    def now(self) -> float:
        """Return the time, s."""
        ...

    def sleep(self, seconds: float) -> None:
        """Wait."""
        ...

    def wait_for(
        self, heard: threading.Condition, what: Callable[[], object], seconds: float
    ) -> bool:
        """Wait until `what` is true, at most `seconds`; it is tested while `heard` is held."""
        ...

    def patience(self, seconds: float) -> float:
        """Return the real time limit (s) for a process that takes `seconds`."""
        ...

    def running(self) -> contextlib.AbstractContextManager[object]:
        """Let time go on by itself, while a process ends."""
        ...

    def there(self, driving: bool = True) -> float:
        """Signal that the program is alive; return how long (s) the computer was too busy."""
        ...

    def each_step(self, hear: Callable[[], None]) -> None:
        """Call `hear` after each step, if there are steps."""
        ...


class RealTime:
    """The steady clock of this computer."""

    simulated = stepped = False
    frozen = FROZEN

    def now(self) -> float:
        """Return the time, s."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Wait."""
        time.sleep(seconds)

    def wait_for(
        self, heard: threading.Condition, what: Callable[[], object], seconds: float
    ) -> bool:
        """Wait until `what` is true, at most `seconds`."""
        with heard:
            return bool(heard.wait_for(what, seconds))

    def patience(self, seconds: float) -> float:
        """Return `seconds` unchanged."""
        return seconds

    def running(self) -> contextlib.AbstractContextManager[object]:
        """Do nothing: real time never stops."""
        return contextlib.nullcontext()

    def there(self, driving: bool = True) -> float:
        """Return 0: real servos do not wait."""
        return 0.0

    def each_step(self, hear: Callable[[], None]) -> None:
        """Do nothing: there are no steps."""


class PacedTime(RealTime):
    """The time of simulated servos that follows real time as far as the computer can."""

    simulated = True
    frozen = 30.0

    def __init__(self, bus: _core.EmulatedBus) -> None:
        self._bus, self._driving = bus, False

    def now(self) -> float:
        """Return the servos' time, s."""
        return self._bus.now() / NS

    def wait_for(
        self, heard: threading.Condition, what: Callable[[], object], seconds: float
    ) -> bool:
        """Wait until `what` is true, with a longer limit than for a real robot."""
        until = time.monotonic() + self.patience(seconds)
        while not super().wait_for(heard, what, 0.5 * WINDOW):
            if time.monotonic() > until:
                return False
            if self._driving:
                self.there()
        return True

    def patience(self, seconds: float) -> float:
        """Return a longer limit, for a busy computer."""
        return PATIENT * seconds

    def there(self, driving: bool = True) -> float:
        """Let time go on for `WINDOW` s more; without a limit if not `driving`."""
        self._driving = driving
        return self._bus.there(WINDOW if driving else None)


class SteppedTime(PacedTime):
    """The time of simulated servos, advanced in steps by the thread that creates this object."""

    stepped = True
    frozen = float("inf")  # time stands while that thread computes

    def __init__(self, bus: _core.EmulatedBus) -> None:
        super().__init__(bus)
        bus.hold(EPOCH)
        self._ns = max(EPOCH, bus.now())
        self._next = self._ns + EVERY
        self._owner = threading.get_ident()
        self._looks: list[Callable[[], None]] = []
        self._hears: list[Callable[[], None]] = []

    def each_look(self, look: Callable[[], None]) -> None:
        """Call `look` each `EVERY` ns."""
        self._looks.append(look)

    def each_step(self, hear: Callable[[], None]) -> None:
        """Call `hear` after each step."""
        self._hears = [hear]

    def now(self) -> float:
        """Return the current time, s."""
        return self._ns / NS

    def sleep(self, seconds: float) -> None:
        """Advance by `seconds`."""
        self._to(self._ns + max(round(seconds * NS), 0))

    def wait_for(
        self, heard: threading.Condition, what: Callable[[], object], seconds: float
    ) -> bool:
        """Advance until `what` is true.

        Other threads, or a thread without a running loop, wait in real time.
        """
        until, real = self._ns + round(seconds * NS), time.monotonic() + STUCK
        while True:
            with heard:
                if what():
                    return True
            if self._owner != threading.get_ident() or not self._bus.waiting():
                if RealTime.wait_for(self, heard, what, 0.02):
                    return True
                if time.monotonic() > real:
                    return False
            elif self._ns >= until:
                return False
            else:
                self._to(min(self._ns + EVERY, until))

    def patience(self, seconds: float) -> float:
        """Return the longest time that a loop may take."""
        return STUCK

    @contextlib.contextmanager
    def running(self) -> Iterator[None]:
        """Let time run freely while the loop ends."""
        self._bus.free(True)
        try:
            yield
        finally:
            self._ns = max(self._ns, self._bus.free(False))
            self._next = max(self._next, self._ns)

    def there(self, driving: bool = True) -> float:
        """Return 0: stepped time is never late."""
        return 0.0

    def _to(self, ns: int) -> None:
        while self._ns < ns:
            self._grant(min(ns, max(self._next, self._ns)))
            if self._ns >= self._next:
                self._next += EVERY
                for look in self._looks:
                    look()

    def _grant(self, ns: int) -> None:
        begun = time.monotonic()
        while not self._bus.advance(ns, 0.5):
            if time.monotonic() - begun > STUCK:
                raise ServoError(
                    f"{BUSY}: the simulated robot did not move for {STUCK:g} s; start again"
                )
        self._ns = ns
        for hear in self._hears:
            hear()


REAL_TIME = RealTime()
