"""Remove pixels without depth from a cloud: not finite, at 0, 0, 0, or all at one other place.

Depth cameras save a pixel without depth as one fixed triple, and a transform moves all of them
alike. A single point at 0, 0, 0 is a measurement. A place that repeats bit for bit far more often
than others is not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

MOST_REPEATS = 10  # of one place in a cloud of distinct points,
OFTEN = 10.0  # and by how much more often than the median place of a cloud whose points repeat


def left_out(points: Floats) -> tuple[NDArray[np.bool_], str]:
    """Return which points (M, 3) are measurements, and a sentence on the others, or ""."""
    finite = np.isfinite(points).all(axis=1)
    zero = finite & (points == 0.0).all(axis=1)
    zero &= np.count_nonzero(zero) > 1
    good: NDArray[np.bool_] = np.asarray(finite & ~zero)
    repeated, places = _repeated(points, good)
    good &= ~repeated
    parts = [
        (~finite, "not finite"),
        (zero, "at exactly 0, 0, 0 (pixels without depth)"),
        (repeated, f"at {places}, which repeats bit for bit (pixels without depth)"),
    ]
    there = [(int(which.sum()), what) for which, what in parts if which.any()]
    if not there:
        return good, ""
    total = f"{(~good).sum()} of {len(points)} points are"
    if len(there) == 1:
        return good, f"{total} {there[0][1]} and are left out"
    return good, f"{total} left out: {', '.join(f'{count} {what}' for count, what in there)}"


def _repeated(points: Floats, good: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], str]:
    """Return points at places that repeat too often to be measured, and these places in words."""
    rows = np.flatnonzero(good)
    order = rows[np.lexsort(points[rows].T)]
    new = (
        np.r_[True, np.any(points[order][1:] != points[order][:-1], axis=1)]
        if len(order)
        else np.zeros(0, bool)
    )
    first = np.flatnonzero(new)
    counts = np.diff(np.r_[first, len(order)])
    most = max(float(MOST_REPEATS), OFTEN * float(np.median(counts))) if len(counts) else 0.0
    often = counts > most
    which = np.zeros(len(points), bool)
    which[order[np.repeat(often, counts)]] = True
    places = [f"({', '.join(f'{v:g}' for v in points[order[k]])})" for k in first[often][:3]]
    return which, ", ".join(places)
