"""A camera frame of points, and its exposure time by the host's clock.

    taken = rate · stamp + offset,   arrived − taken ≥ 0, equality for the fastest frame

A camera has its own clock: the offset is estimated from the first frame on, the rate once the
frames span `LONG` s. The fixed latency (exposure, readout, detection) cannot be estimated; a
program that measured it passes it as `late`. Known limit: if all frames wait in a queue, their
times are estimated too late. Pinned by tests/robot/test_emulated_finger.py and
tests/robot/test_camera_points.py.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LONG = 60.0  # s of frames from which the rate of the camera's clock is estimated
PART = 10.0  # s; the fastest frame of each such interval counts
MOST_DRIFT = 1e-3  # relative rate of two clocks: more than any crystal drifts


@dataclass(frozen=True, eq=False)
class Frame:
    """A camera frame: `stamp` s by its clock, `arrived` s by the host's, `points` (N, 3) mm.

    The clock of the host is monotonic. NaN stands for a point that was not seen.
    """

    stamp: float
    arrived: float
    points: NDArray[np.floating]


Seen = Callable[[], list[Frame]]  # returns the frames that have arrived, oldest first


class HostClock:
    """Estimate a camera's clock against the host's, frame by frame, without storing frames.

    Args:
        late: s from exposure to arrival of the fastest frame
    """

    def __init__(self, late: float = 0.0) -> None:
        self._late, self._first, self._newest = late, math.nan, -math.inf
        # (s since the first frame, delay s) of frames that are fastest at some drift: a convex hull
        self._lower: list[tuple[float, float]] = []
        self._parts: dict[int, tuple[float, float]] = {}  # fastest frame of each interval

    def add(self, frames: Sequence[Frame]) -> list[Frame]:
        """Add frames, oldest first, and return those that are new."""
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
        """Return the exposure times (K,) s by the host's clock, estimated from all added frames."""
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
    """Return the exposure times (K,) s of all frames of a camera by the host's clock."""
    clock = HostClock(late)
    clock.add(frames)
    return clock.times(frames)
