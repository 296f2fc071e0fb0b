"""Time a path within the slew and acceleration limits of the servos.

The path's parameter s runs from 0 to 1. With x = ṡ², a servo at q(s) ticks moves at q'·√x and is
accelerated by q''·x + q'·s̈. Each term may use half of the acceleration, so no limit is exceeded. A
forward and a backward sweep over s give the fastest such profile (as Bobrow, Dubowsky & Gibson
1985, coarser). It is then slowed evenly to the requested duration. Pinned by
tests/robot/test_timing.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SHARE = 0.8  # share of the limits that a plan uses: the guard needs the rest to follow it


@dataclass(frozen=True)
class Profile:
    """Times `t` (N,) s at which the evenly spaced parameters s (N,) in [0, 1] are passed.

    `quickest` s is the shortest possible duration.
    """

    t: Floats
    quickest: float

    def at(self, t: Floats) -> Floats:
        """Return the parameters s (T,) at times `t` (T,) s."""
        return np.asarray(np.interp(t, self.t, np.linspace(0.0, 1.0, len(self.t))))


def timed(
    ticks: Floats, slew: Sequence[float], acceleration: Sequence[float], duration: float
) -> Profile:
    """Return the profile of a path through `ticks` (N, S) at even parameters, at rest at both ends.

    Args:
        ticks: N >= 3 points
        slew: (S,) ticks/s
        acceleration: (S,) ticks/s²
        duration: s, shortest duration of the result
    """
    count = len(ticks)
    h = 1.0 / (count - 1)
    most, push = SHARE * np.asarray(slew, float), SHARE * np.asarray(acceleration, float) / 2
    first = np.diff(ticks, axis=0) / h  # (N-1, S) between points
    bend = np.zeros_like(ticks)
    bend[1:-1] = np.diff(first, axis=0) / h
    steep = np.abs(first)
    with np.errstate(divide="ignore"):
        speed = np.min((most / steep) ** 2, axis=1, initial=np.inf)  # limit of x between points
        turn = np.min(push / np.abs(bend), axis=1, initial=np.inf)  # limit of x at points
        change = np.min(push / steep, axis=1, initial=np.inf)  # limit of |s̈| between points
    x = np.minimum(turn, np.minimum(np.append(speed, np.inf), np.append(np.inf, speed)))
    x = np.minimum(x, 1e12)  # where nothing moves
    x[0] = x[-1] = 0.0
    for k in range(1, count):
        x[k] = min(x[k], x[k - 1] + 2 * h * change[k - 1])
    for k in range(count - 2, -1, -1):
        x[k] = min(x[k], x[k + 1] + 2 * h * change[k])
    pace = np.sqrt(x)
    steps = 2 * h / np.maximum(pace[:-1] + pace[1:], 1e-12)
    t = np.concatenate([[0.0], np.cumsum(steps)])
    quickest = float(t[-1])
    return Profile(t * max(1.0, duration / quickest), quickest)
