"""A frame of points that a camera saw, and when that was by the host's clock.

    taken = rate · stamp + offset,   arrived − taken ≥ 0, and the quickest frame came at once

A camera has a clock of its own: an offset from the first frame on, a rate once the frames span `LONG` s. What every
frame takes (exposure, readout, the points found in it) no host can know: whoever measured it says so (`late`).
Known limit: over frames that all wait in a queue they seem to be taken late. Pinned by tests/test_emulated_finger.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LONG = 60.0  # s of frames from which on two clocks are seen to part
PART = 10.0  # s; the quickest frame of each such part counts
MOST_DRIFT = 1e-3  # of a clock against another: beyond any crystal


@dataclass(frozen=True, eq=False)
class Frame:
    """What a camera saw: `stamp` s by its own clock, `arrived` s by the host's monotonic one, `points` (N, 3) mm.

    NaN stands for a point that was not seen.
    """

    stamp: float
    arrived: float
    points: NDArray[np.floating[Any]]


Seen = Callable[[], list[Frame]]  # the frames that have arrived, oldest first


def host_times(stamps: Floats, arrived: Floats, late: float = 0.0) -> Floats:
    """Return when frames were taken (K,) s by the host's clock, from their stamps and arrivals (K,) s.

    Args:
        late: s that the quickest frame takes from its light to its arrival.
    """
    if not len(stamps):
        return np.zeros(0)
    behind, drift = arrived - stamps, 0.0
    if np.ptp(stamps) >= LONG:
        part = np.floor((stamps - stamps[0]) / PART)
        quickest = np.array([np.flatnonzero(part == p)[np.argmin(behind[part == p])] for p in np.unique(part)])
        drift = float(np.polyfit(stamps[quickest] - stamps[0], behind[quickest], 1)[0])
        drift = drift if abs(drift) <= MOST_DRIFT else 0.0
    rest = behind - drift * (stamps - stamps[0])
    return np.asarray(stamps + drift * (stamps - stamps[0]) + rest.min() - late)


def on_host(frames: Sequence[Frame], late: float = 0.0) -> Floats:
    """Return when frames were taken (K,) s by the host's clock (`host_times`)."""
    stamps, arrived = (np.array([getattr(frame, name) for frame in frames]) for name in ("stamp", "arrived"))
    return host_times(stamps, arrived, late)
