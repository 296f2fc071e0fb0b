"""A frame of points that a camera saw, and when that was by the host's clock.

    taken = rate · stamp + offset,   arrived − taken ≥ 0, and the quickest frame came at once

A camera has a clock of its own: an offset from the first frame on, a rate once the frames span
`LONG` s. The host cannot measure the fixed latency of a frame (exposure, readout, detection): the
program that measured it states it (`late`). Known limit: over frames that all wait in a queue they
seem to be taken late. Pinned by tests/robot/test_emulated_finger.py and
tests/robot/test_camera_points.py.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LONG = 60.0  # s of frames from which on two clocks are seen to part
PART = 10.0  # s; the quickest frame of each such part counts
MOST_DRIFT = 1e-3  # of a clock against another: beyond any crystal


@dataclass(frozen=True, eq=False)
class Frame:
    """What a camera saw: `stamp` s by its clock, `arrived` s by the host's, `points` (N, 3) mm.

    The clock of the host is monotonic.

    NaN stands for a point that was not seen.
    """

    stamp: float
    arrived: float
    points: NDArray[np.floating]


Seen = Callable[[], list[Frame]]  # the frames that have arrived, oldest first


class HostClock:
    """A camera's clock against the host's, learnt by frame; it keeps numbers, no frames.

    Args:
        late: s that the quickest frame takes from its light to its arrival.
    """

    def __init__(self, late: float = 0.0) -> None:
        self._late, self._first, self._newest = late, math.nan, -math.inf
        # s since the first, s behind: the quickest under whatever drift
        self._lower: list[tuple[float, float]] = []
        self._parts: dict[int, tuple[float, float]] = {}  # the quickest of each part

    def add(self, frames: Sequence[Frame]) -> list[Frame]:
        """Take frames, oldest first, and return those that were not taken before."""
        new: list[Frame] = []
        for frame in reversed(frames):
            if frame.stamp <= self._newest:
                break
            new.append(frame)
        new.reverse()
        for frame in new:
            self._newest = frame.stamp
            self._first = frame.stamp if math.isnan(self._first) else self._first
            now = frame.stamp - self._first, frame.arrived - frame.stamp
            part = int(now[0] // PART)
            self._parts[part] = min(self._parts.get(part, now), now, key=lambda one: one[1])
            while len(self._lower) > 1 and _above(self._lower[-2], self._lower[-1], now):
                self._lower.pop()
            self._lower.append(now)
        return new

    def times(self, frames: Sequence[Frame]) -> Floats:
        """Return when frames were taken (K,) s by the host's clock, by all that were added."""
        stamps = np.array([frame.stamp for frame in frames])
        if not self._lower:
            return stamps
        drift = 0.0
        if self._newest - self._first >= LONG:
            since, behind = np.array(list(self._parts.values())).T
            drift = float(np.polyfit(since, behind, 1)[0])
            drift = drift if abs(drift) <= MOST_DRIFT else 0.0
        quickest = min(behind - drift * since for since, behind in self._lower)
        return np.asarray(stamps + drift * (stamps - self._first) + quickest - self._late)


def _above(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
    """Return whether `b` lies on or above the line from `a` to `c`."""
    return (b[1] - a[1]) * (c[0] - a[0]) >= (c[1] - a[1]) * (b[0] - a[0])


def on_host(frames: Sequence[Frame], late: float = 0.0) -> Floats:
    """Return when all frames of a camera were taken (K,) s by the host's clock."""
    clock = HostClock(late)
    clock.add(frames)
    return clock.times(frames)
