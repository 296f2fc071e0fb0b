"""Find the most rows of a log whose times rise: what is left when stray times are taken out."""

from __future__ import annotations

from bisect import bisect_left

import numpy as np
from numpy.typing import NDArray


def longest_rise(t: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which rows (rows,) form the longest series of rising times; O(n log n).

    Args:
        t: (rows,) s, finite.
    """
    ends: list[float] = []  # the least last time of a rising series of each length
    rows: list[int] = []  # its row
    before = np.full(len(t), -1, np.intp)
    for row, time in enumerate(t.tolist()):
        k = bisect_left(ends, time)
        before[row] = rows[k - 1] if k else -1
        ends[k : k + 1] = [time]
        rows[k : k + 1] = [row]
    kept = np.zeros(len(t), bool)
    row = rows[-1] if rows else -1
    while row >= 0:
        kept[row] = True
        row = int(before[row])
    return kept
