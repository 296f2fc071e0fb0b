"""Detect that the computer is too busy for a simulated robot, which then stops with a report.

Real servos do not wait, so this does not apply to them. Pinned by
tests/robot/test_simulated_time.py.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from softmap_edge.robot.servo.clock import BUSY, Clock

# s between two rounds from which the program counts as held up: several times a usual round
LATE = 0.05
LONG, AGAIN = 0.2, 5.0  # s: standstill that is reported; least time between two reports
SHOWN = 1.0  # s for which the page shows a report


class Busy:
    """Count how long a busy computer held up a simulated robot.

    Args:
        clock: clock of the robot
        say: called with one line after a standstill
    """

    def __init__(self, clock: Clock, say: Callable[[str], None]) -> None:
        self._clock, self._say = clock, say
        self._last: float | None = None
        self._gaps: deque[tuple[float, float]] = deque(maxlen=20)
        self._reported, self._reported_at = 0.0, -AGAIN
        self.seconds, self._stood_at = 0.0, -AGAIN

    def round(self, now: float) -> None:
        """Register that a round begins at `now` s (steady clock)."""
        before, self.seconds = self.seconds, self._clock.there()
        self._stood_at = now if self.seconds > before else self._stood_at
        if self._clock.simulated and self._last is not None and now - self._last > LATE:
            self._gaps.append((self._last, now))
        self._last = now
        if (stood := self.seconds - self._reported) > LONG and now - self._reported_at >= AGAIN:
            self._reported, self._reported_at = self.seconds, now
            self._say(f"{BUSY}: the simulated robot stood still for {stood:.1f} s, and goes on")

    def line(self, now: float) -> str:
        """Return the page's line on a recent standstill at `now` s; "" if there was none."""
        return BUSY if now - self._stood_at < SHOWN else ""

    def age(self, t: float, now: float) -> float:
        """Return the age (s) of data seen at `t`, less the time when the program was held up."""
        return now - t - sum(max(0.0, end - max(begin, t)) for begin, end in self._gaps)

    def end(self) -> None:
        """Let the robot run on without this program."""
        self.seconds = max(self.seconds, self._clock.there(driving=False))
