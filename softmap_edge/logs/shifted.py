"""Find frames in which a list of markers gets shorter, so that each column after the lost marker shows its neighbour.

Trackers without labels write the markers that they see one after the other. If one is lost, all later columns move up
and the last column is empty. In such a log the markers that are seen always fill the first columns. In a frame with
all markers the columns are right. From it, each next frame is matched in order, with the least total distance to the
last places; a marker counts as found in another column if it moved by at most `CLEAR` of the distance between the two.
Limit: frames so far apart that markers move farther are not tested. Pinned by tests/test_shifted.py.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Whole = NDArray[np.intp]

CLEAR = 0.3  # of the distance between two markers: what a marker may have moved when it is found in another column
MOST = 64  # markers of a list: matching takes their square
_LISTED = 5


@dataclass(frozen=True)
class Shifted:
    """Which marker each column shows: `shows` (K, M), the column's own number where it is right."""

    shows: Whole

    @property
    def wrong(self) -> NDArray[np.bool_]:
        """Which columns (K, M) show another marker."""
        return np.asarray(self.shows != np.arange(self.shows.shape[1]))

    def mended(self, points: Array) -> Array:
        """Return points (K, M, D) with each place in the column of its marker."""
        right = points.copy()
        right[self.wrong] = np.nan
        k, column = np.nonzero(self.wrong)
        right[k, self.shows[k, column]] = points[k, column]
        return right

    def line(self, labels: Sequence[str], remedy: str) -> str:
        """Return the sentence that reports the shifted columns."""
        wrong = self.wrong
        columns = np.flatnonzero(wrong.any(axis=0))
        named = ", ".join(labels[m] for m in columns[:_LISTED])
        named += f" and {len(columns) - _LISTED} more" if len(columns) > _LISTED else ""
        return (
            f"{int(wrong.any(axis=1).sum())} of {len(wrong)} frames list fewer markers, and a column after the lost "
            f"one shows the next marker: {named}; {remedy}"
        )


def find_shifted(points: Array) -> Shifted | None:
    """Find frames of a list that got shorter.

    Args:
        points: (K, M, D) in order of time, NaN where nothing was seen.

    Returns:
        Shifted: which marker each column shows, or None where every column shows its own.
    """
    count = points.shape[1]
    seen = np.isfinite(points).all(axis=2)
    number = seen.sum(axis=1)
    if not 2 <= count <= MOST or (seen != (np.arange(count) < number[:, None])).any():
        return None  # a gap between markers that are seen: each column keeps its marker
    full = np.flatnonzero(number == count)
    if not len(full) or len(full) == len(points):
        return None
    shows = np.tile(np.arange(count), (len(points), 1))
    _follow(points, number, shows, range(int(full[0]), len(points)))
    _follow(points, number, shows, range(int(full[0]), -1, -1))
    found = Shifted(np.where(seen, shows, np.arange(count)))
    return found if found.wrong.any() else None


def _follow(points: Array, number: Whole, shows: Whole, frames: Iterable[int]) -> None:
    """Write which marker each column of each frame shows, beginning with a frame of all markers."""
    count, before = points.shape[1], -1
    last = np.full(points.shape[1:], np.nan)
    for k in frames:
        n = int(number[k])
        if 0 < n < count:
            kept = shows[before] if before >= 0 and number[before] == n else None
            shows[k, :n] = _matched(points[k, :n], last, None if kept is None else kept[:n])
        if n:
            last[shows[k, :n]] = points[k, :n]
            before = k


def _matched(here: Array, last: Array, kept: Whole | None) -> Whole:
    """Return which marker each place (n, D) shows, in rising order, by the last places (M, D) of all."""
    n = len(here)
    away = np.linalg.norm(here[:, None] - last[None], axis=2)
    own = np.arange(n) if kept is None else kept
    nearest = away.argmin(axis=1)
    best = nearest if (np.diff(nearest) > 0).all() else _in_order(away)
    if (best == own).all():
        return own
    moved = best != own
    apart = np.linalg.norm(last[own[moved]] - last[best[moved]], axis=1)
    clear = away[moved, best[moved]] <= CLEAR * apart
    return best if bool(clear.all()) else own


def _in_order(away: Array) -> Whole:
    """Return the rising choice of a column for each row (n, M) with the least sum."""
    n, count = away.shape
    total = np.full((n + 1, count + 1), np.inf)
    total[0] = 0.0
    for i in range(1, n + 1):
        for j in range(i, count - (n - i) + 1):
            total[i, j] = min(total[i, j - 1], total[i - 1, j - 1] + away[i - 1, j - 1])
    chosen, j = np.zeros(n, np.intp), count
    for i in range(n, 0, -1):
        while j > i and total[i, j] == total[i, j - 1]:
            j -= 1
        chosen[i - 1] = j - 1
        j -= 1
    return chosen
