"""Find frames with a shortened list of markers, where columns show their neighbours' markers.

Trackers without labels write the visible markers one after the other. If one is lost, all later
columns move up, and the last column is empty or repeats the one before. In other lists the first
column is empty. In such a log the visible markers always fill the first columns, or the last ones.
Two markers at the same position to the last digit are one measurement, unless they come as close
as the digits of the file.

In a frame with all markers the columns are right. From there each next frame is matched in order,
with the least total distance to the last positions. A marker counts as found in another column if
it moved by at most `CLEAR` of the distance between the two. Two columns with one position and an
unclear marker are both not seen. Limit: frames so far apart that markers move farther are not
tested. Pinned by tests/logs/test_shifted.py.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.files.printable import listed

Array = NDArray[np.float64]
Whole = NDArray[np.intp]

# of the distance between two markers: largest motion of a marker found in another column
CLEAR = 0.3
NEAR = 10.0  # digits of the file: markers closer than this may round to one position
NOWHERE = -1  # a column that repeats another marker's position
MOST = 64  # markers of a list: the cost of matching is quadratic
_LISTED = 5


@dataclass(frozen=True)
class Shifted:
    """Which marker each column shows: `shows` (K, M).

    It is the column's own number where right, else another one or `NOWHERE`.
    """

    shows: Whole

    @property
    def wrong(self) -> NDArray[np.bool_]:
        """Return which columns (K, M) show another marker."""
        return np.asarray(self.shows != np.arange(self.shows.shape[1]))

    def mended(self, points: Array) -> Array:
        """Return points (K, M, D) with each position in the column of its marker."""
        right = points.copy()
        right[self.wrong] = np.nan
        k, column = np.nonzero(self.wrong & (self.shows != NOWHERE))
        right[k, self.shows[k, column]] = points[k, column]
        return right

    def lines(self, labels: Sequence[str], remedy: str) -> list[str]:
        """Return the sentences on these columns."""
        lines = []
        moved = self.wrong & (self.shows != NOWHERE)
        if moved.any():
            lines.append(
                f"{int(moved.any(axis=1).sum())} of {len(moved)} frames list fewer markers, and a "
                f"column shows the neighbour of its marker: {_named(moved, labels)}; {remedy}"
            )
        twice = self.shows == NOWHERE
        if twice.any():
            lines.append(
                f"{int(twice.any(axis=1).sum())} of {len(twice)} frames give two markers one "
                f"place to the last digit, which is one measurement: {_named(twice, labels)} "
                "taken as not seen"
            )
        return lines


def _named(columns: NDArray[np.bool_], labels: Sequence[str]) -> str:
    found = np.flatnonzero(columns.any(axis=0))
    return listed((labels[m] for m in found.tolist()), _LISTED)


def find_shifted(points: Array) -> Shifted | None:
    """Find frames with a shortened list, and columns that repeat another marker's position.

    Args:
        points: (K, M, D) in order of time, NaN where nothing was seen.

    Returns:
        Shifted: which marker each column shows, or None if every column shows its own.
    """
    count = points.shape[1]
    if not 2 <= count <= MOST:
        return None
    column, seen = np.arange(count), np.asarray(np.isfinite(points).all(axis=2))
    number, first = seen.sum(axis=1), _first_of(points)
    twice = np.asarray((first != column).any(axis=1))
    listed = (seen == (column < number[:, None])).all() or (
        seen == (column >= count - number[:, None])
    ).all()
    doubtful: NDArray[np.bool_] = np.asarray(
        twice | (listed & (number > 0) & (number < count)), np.bool_
    )
    full = np.flatnonzero((number == count) & ~twice)
    if not doubtful.any() or not (len(full) or twice.any()):
        return None
    shows = np.where(first != column, NOWHERE, column)
    if len(full):
        shows = np.tile(column, (len(points), 1))
        for frames in (range(int(full[0]), len(points)), range(int(full[0]), -1, -1)):
            _follow(points, seen, first, doubtful, shows, frames)
    found = Shifted(np.where(seen, shows, column))
    return found if found.wrong.any() else None


def _first_of(points: Array) -> Whole:
    """Return the first column (K, M) with the same position to the last digit, perhaps itself."""
    count = points.shape[1]
    first = np.tile(np.arange(count), (len(points), 1))
    for b in range(1, count):
        same = (points[:, :b] == points[:, b : b + 1]).all(axis=2)
        for a in np.flatnonzero(same.any(axis=0)):
            if _apart(points[:, a], points[:, b], same[:, a]):
                first[:, b] = np.where(
                    same[:, a], np.minimum(first[:, b], first[:, a]), first[:, b]
                )
    return first


def _apart(one: Array, other: Array, same: NDArray[np.bool_]) -> bool:
    """Return whether two markers (K, D) are otherwise too far apart to round to one position."""
    away = np.linalg.norm(one - other, axis=1)[~same]
    away = away[np.isfinite(away)]
    steps = [np.diff(np.unique(np.r_[a, b])) for a, b in zip(one.T, other.T)]
    digit = max((float(step[step > 0].min()) for step in steps if (step > 0).any()), default=0.0)
    return not len(away) or bool(away.min() > NEAR * digit)


def _follow(
    points: Array,
    seen: NDArray[np.bool_],
    first: Whole,
    doubtful: NDArray[np.bool_],
    shows: Whole,
    frames: Iterable[int],
) -> None:
    """Write which marker each column shows, starting from a frame with all markers."""
    last = np.full(points.shape[1:], np.nan)
    # columns of the previous frame, and the markers that they show
    before: tuple[Whole, Whole] | None = None
    for k in frames:
        columns = _one_of_each(points[k], last, first[k], seen[k])
        if not len(columns):
            continue
        if doubtful[k]:
            own = (
                before[1] if before is not None and np.array_equal(before[0], columns) else columns
            )
            away = np.linalg.norm(points[k, columns][:, None] - last[None], axis=2)
            markers = _matched(away, last, own)
            _write(
                shows[k],
                first[k],
                columns,
                markers,
                _clear_groups(away, last, first[k], columns, markers),
            )
            before = columns, markers
        else:
            before = columns, columns
        right = np.flatnonzero(seen[k] & (shows[k] != NOWHERE))
        last[shows[k, right]] = points[k, right]


def _one_of_each(here: Array, last: Array, first: Whole, seen: NDArray[np.bool_]) -> Whole:
    """Return one column for each position (M, D).

    Of equal columns it is the one whose marker was nearest.
    """
    column = np.arange(len(last))
    if (first == column).all():
        return np.flatnonzero(seen)
    away = np.linalg.norm(here - last, axis=1)
    groups = [np.flatnonzero(first == c) for c in np.flatnonzero(seen & (first == column))]
    return np.array(sorted(group[away[group].argmin()] for group in groups), np.intp)


def _clear_groups(
    away: Array, last: Array, first: Whole, columns: Whole, markers: Whole
) -> list[bool]:
    """Return for each position (n, M) whether the marker that its columns show is clear."""
    clear = []
    for i, (column, marker) in enumerate(zip(columns, markers)):
        group = np.flatnonzero(first == first[column])
        others = group[group != marker]
        apart = (
            np.linalg.norm(last[others] - last[marker], axis=1)
            if len(others)
            else np.array([np.inf])
        )
        clear.append(len(group) == 1 or bool(away[i, marker] <= CLEAR * apart.min()))
    return clear


def _write(shows: Whole, first: Whole, columns: Whole, markers: Whole, clear: list[bool]) -> None:
    """Write which marker (M,) each column of a frame shows."""
    for column, marker, known in zip(columns, markers, clear):
        group = np.flatnonzero(first == first[column])
        shows[group] = NOWHERE
        if known:
            shows[marker if marker in group else column] = marker


def _matched(away: Array, last: Array, own: Whole) -> Whole:
    """Return which marker each position shows, in rising order.

    It is chosen by distances (n, M) from the last positions of all markers.
    """
    nearest = away.argmin(axis=1)
    best = nearest if (np.diff(nearest) > 0).all() else _in_order(away)
    moved = best != own
    apart = np.linalg.norm(last[own[moved]] - last[best[moved]], axis=1)
    return best if bool((away[moved, best[moved]] <= CLEAR * apart).all()) else own


def _in_order(away: Array) -> Whole:
    """Return the rising choice of columns for the rows (n, M) with the smallest sum."""
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
