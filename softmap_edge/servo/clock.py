"""The time that a robot lives in: real, or that of simulated servos, which a busy computer does not make late.

Whoever drives waits by the clock of the rig (`Rig.time`). A simulated robot in *paced* time keeps to real time, for a
person who drives it; what the computer was late by is left out, so that it stands meanwhile and then goes on. In
*stepped* time loop, servos and finger go on by the steps of the program, as fast as the computer can: the same program
gives the same result under any load. Pinned by tests/test_simulated_time.py.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, Protocol

from softmap_edge import _core
from softmap_edge.errors import ServoError

NS = 1_000_000_000
EPOCH = 10 * NS  # at which stepped time begins: set-up is done by then
EVERY = 5_000_000  # ns between two looks at the horns, and of a step of whoever waits
FROZEN = 0.6  # s without a report after which a real loop is taken to hang
STUCK = 60.0  # s without a period of the loop after which a simulated session ends
PATIENT = 50.0  # times as long a simulated robot is waited for: nothing can break meanwhile
WINDOW = 0.1  # s for which paced time goes on without a word from whoever drives
BUSY = "the computer is too busy for real time"


class Clock(Protocol):
    """The time of a robot. `frozen` s without a report are taken for a loop that hangs."""

    simulated: bool
    stepped: bool
    frozen: float

    def now(self) -> float:
        """Return the time, s."""
        ...

    def sleep(self, seconds: float) -> None:
        """Wait."""
        ...

    def wait_for(self, heard: threading.Condition, what: Callable[[], Any], seconds: float) -> bool:
        """Wait until `what` is true, some seconds at most; it is looked at under `heard`."""
        ...

    def patience(self, seconds: float) -> float:
        """Return for how many real seconds a process that takes `seconds` is waited for."""
        ...

    def running(self) -> contextlib.AbstractContextManager[object]:
        """Let time go on by itself, while a process ends."""
        ...

    def there(self, driving: bool = True) -> float:
        """Hear that whoever drives is there; returns for how many s the computer was too busy so far."""
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

    def wait_for(self, heard: threading.Condition, what: Callable[[], Any], seconds: float) -> bool:
        """Wait until `what` is true, some seconds at most."""
        with heard:
            return bool(heard.wait_for(what, seconds))

    def patience(self, seconds: float) -> float:
        """Return the same."""
        return seconds

    def running(self) -> contextlib.AbstractContextManager[object]:
        """Do nothing: it always goes on."""
        return contextlib.nullcontext()

    def there(self, driving: bool = True) -> float:
        """Return 0: real servos do not wait for anybody."""
        return 0.0

    def each_step(self, hear: Callable[[], None]) -> None:
        """Do nothing: there are no steps."""


class PacedTime(RealTime):
    """The time of simulated servos that keeps to real time as far as the computer does."""

    simulated = True
    frozen = 30.0

    def __init__(self, bus: _core.EmulatedBus) -> None:
        self._bus, self._driving = bus, False

    def now(self) -> float:
        """Return the servos' time, s."""
        return self._bus.now() / NS

    def wait_for(self, heard: threading.Condition, what: Callable[[], Any], seconds: float) -> bool:
        """Wait until `what` is true; a simulated robot is waited for longer."""
        until = time.monotonic() + self.patience(seconds)
        while not super().wait_for(heard, what, 0.5 * WINDOW):
            if time.monotonic() > until:
                return False
            if self._driving:
                self.there()
        return True

    def patience(self, seconds: float) -> float:
        """Return more: a busy computer takes its time."""
        return PATIENT * seconds

    def there(self, driving: bool = True) -> float:
        """Let time go on for `WINDOW` s more, or whatever happens where nobody is `driving`."""
        self._driving = driving
        return self._bus.there(WINDOW if driving else None)


class SteppedTime(PacedTime):
    """The time of simulated servos that goes on by the steps of one thread, the one that makes this."""

    stepped = True
    frozen = float("inf")  # it stands while that thread computes

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
        """Return the time up to which it has gone, s."""
        return self._ns / NS

    def sleep(self, seconds: float) -> None:
        """Go on by so much."""
        self._to(self._ns + max(round(seconds * NS), 0))

    def wait_for(self, heard: threading.Condition, what: Callable[[], Any], seconds: float) -> bool:
        """Go on until `what` is true; another thread, or one whose loop is not there yet, waits in real time."""
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
        """Return as long as a loop may take at all."""
        return STUCK

    @contextlib.contextmanager
    def running(self) -> Iterator[None]:
        """Let the loop go on as it likes, while it ends."""
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
                raise ServoError(f"{BUSY}: the simulated robot did not move for {STUCK:g} s; start again")
        self._ns = ns
        for hear in self._hears:
            hear()


REAL_TIME = RealTime()
