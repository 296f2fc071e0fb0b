"""What a busy computer takes from a person who drives a simulated robot: it stands meanwhile, which is reported.

Real servos wait for nobody: there nothing is excused. Pinned by tests/test_simulated_time.py.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from softmap_edge.servo.clock import BUSY, Clock

LATE = 0.05  # s between two rounds, several times what one takes: the computer had no time for this program
TELLS, AGAIN = 0.2, 5.0  # s that a robot stood before it is reported, and between two reports


class Busy:
    """Counts how long the computer was too busy for a simulated robot in the time of `clock`.

    Args:
        clock: of the robot. say: called with a line where it stood.
    """

    def __init__(self, clock: Clock, say: Callable[[str], None]) -> None:
        self._clock, self._say = clock, say
        self._last: float | None = None
        self._gaps: deque[tuple[float, float]] = deque(maxlen=20)
        self._told, self._told_at = 0.0, -AGAIN
        self.seconds = 0.0

    def round(self, now: float) -> None:
        """Hear that a round begins at `now` s, a steady clock."""
        self.seconds = self._clock.there()
        if self._clock.simulated and self._last is not None and now - self._last > LATE:
            self._gaps.append((self._last, now))
        self._last = now
        if (stood := self.seconds - self._told) > TELLS and now - self._told_at >= AGAIN:
            self._told, self._told_at = self.seconds, now
            self._say(f"{BUSY}: the simulated robot stood still for {stood:.1f} s, and goes on")

    def age(self, t: float, now: float) -> float:
        """Return how old (s) what was seen at `t` is, without the time in which this program could not run."""
        return now - t - sum(max(0.0, end - max(begin, t)) for begin, end in self._gaps)

    def end(self) -> None:
        """Let the robot go on whatever this program does."""
        self.seconds = max(self.seconds, self._clock.there(driving=False))
