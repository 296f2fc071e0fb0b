"""Time the rows of the benchmarks: medians of alternating runs, ours and a peer's."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

REPEATS = 9


def side_by_side(ours, peer, clock: Callable[[], float] = time.perf_counter) -> tuple[float, float]:
    """Return median seconds of `ours` and `peer`, run alternately after one warm-up each."""
    ours(), peer()
    times = [[], []]
    for _ in range(REPEATS):
        for column, work in zip(times, (ours, peer)):
            start = clock()
            work()
            column.append(clock() - start)
    return float(np.median(times[0])), float(np.median(times[1]))


def ratio(name: str, ours: float, peer: float, peer_name: str, wanted: str) -> dict[str, object]:
    """Return one row with the ratio peer ÷ ours."""
    return {
        "name": name,
        "value": ours * 1e3,
        "unit": "ms",
        "peer": peer * 1e3,
        "peer_name": peer_name,
        "ratio": peer / ours,
        "wanted": wanted,
    }
