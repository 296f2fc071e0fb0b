"""Find where a clock was set back or forward: time jumps, but the values continue smoothly.

Rows out of order also fall in time, but the earlier time is soon reached again. A pause also leaps
in time, but the robot rests before or after it, or is at another position. Pinned by
tests/logs/test_clock.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.logs.readers.columns import Array

Rows = NDArray[np.int64]

LONG = 3.0  # usual steps: the fall of a set clock is longer
# times the 95th percentile of the steps: a longer forward step is a pause or a set clock
LEAP = 50.0
LEAST_LEAP = 1.0  # s, likewise
NEAR = 20  # rows on either side that show the usual change per row
ON = 3.0  # usual changes: mean over moving columns of a value that continues
APART = 8.0, 0.02  # usual changes, and range of a column: a value that does not continue
# difference of the halves of `NEAR` rows, in usual changes times the square root of the rows
MOVING = 7.0


@dataclass(frozen=True)
class Jump:
    """The rows where a clock falls or leaps.

    Attributes:
        rows: the first row after each jump.
        size_s: change of time there relative to the previous row, s.
        period_s: period (s) of a clock that rolls over; None for a set clock.
        period: the period as text.
    """

    rows: Rows
    size_s: Array
    period_s: float | None
    period: str = ""


def usual_step(t: Array) -> float:
    """Return the median (s) of the forward steps of times (rows,) s."""
    step = np.diff(t)
    return float(np.median(step[step > 0]))


def set_back(t: Array, values: Array) -> Jump | None:
    """Return the falls of a set clock; None if one of them may have another cause.

    Args:
        t: (rows,) s.
        values: (rows, columns) without time columns.
    """
    step = np.diff(t)
    rows = np.flatnonzero(step < 0) + 1
    if not len(rows) or not (step > 0).any():
        return None
    usual = usual_step(t)
    if not all(-step[k - 1] > LONG * usual and not _soon_reached(t, int(k), usual) for k in rows):
        return None
    if any(
        returns(step, int(k), float(-step[k - 1])) or goes_on(values, int(k)) is False for k in rows
    ):
        return None
    return Jump(rows, step[rows - 1], None)


def set_forward(t: Array, values: Array) -> Jump | None:
    """Return the leaps of a set clock; else None.

    The values move, and continue as if no time had passed.

    Args:
        t: (rows,) s.
        values: (rows, columns) without time columns.
    """
    step = np.diff(t)
    forward = step[step > 0]
    if len(forward) < 2 * NEAR:
        return None
    high = np.flatnonzero(step > max(LEAP * float(np.quantile(forward, 0.95)), LEAST_LEAP)) + 1
    rows = np.array([k for k in high if goes_on(values, int(k))], np.int64)
    return Jump(rows, step[rows - 1], None) if len(rows) else None


def both(one: Jump | None, other: Jump | None) -> Jump | None:
    """Return the steps of two findings, in row order."""
    if one is None or other is None:
        return one or other
    rows = np.r_[one.rows, other.rows]
    order = np.argsort(rows)
    return Jump(rows[order], np.r_[one.size_s, other.size_s][order], None)


def _soon_reached(t: Array, row: int, usual: float) -> bool:
    """Return whether the time before a fall is reached again much sooner than at the usual step."""
    later = np.flatnonzero(t[row:] > t[row - 1])
    return bool(len(later) and later[0] < min(0.5 * (t[row - 1] - t[row]) / usual, NEAR))


def returns(step: Array, row: int, size: float) -> bool:
    """Return whether the step next to a fall of `size` reverses it: a stray time, such as 0."""
    near = [step[k] for k in (row - 2, row) if 0 <= k < len(step)]
    return bool(near) and max(near) > 0.5 * size


def goes_on(values: Array, row: int) -> bool | None:
    """Return whether values (rows, columns) continue smoothly from the previous row to `row`.

    None if nothing moves there.
    """
    first, last = max(row - NEAR, 0), min(row + NEAR, len(values))
    before, after = values[first:row], values[row:last]
    moves = np.abs(np.r_[np.diff(before, axis=0), np.diff(after, axis=0)])
    leap, span = np.abs(values[row] - values[row - 1]), _span(values)
    known = np.isfinite(leap) & np.isfinite(moves).any(axis=0) & (span > 0)
    if not known.any():
        return None
    usual, leap, span = np.nanmean(moves[:, known], axis=0), leap[known], span[known]
    if (leap > np.maximum(APART[0] * usual, APART[1] * span)).any():
        return False
    moving = _moves(before[:, known], usual) & _moves(after[:, known], usual)
    if not moving.any():
        return None
    return bool(np.mean(leap[moving] / usual[moving]) <= ON)


def _span(values: Array) -> Array:
    shown = np.where(np.isfinite(values), values, np.nan)
    empty = ~np.isfinite(shown).any(axis=0)
    shown[:, empty] = 0.0
    return np.asarray(np.nanmax(shown, axis=0) - np.nanmin(shown, axis=0))


def _moves(side: Array, usual: Array) -> NDArray[np.bool_]:
    """Return which columns (rows, columns) move steadily: their halves differ beyond noise."""
    half = len(side) // 2
    if half < 2:
        return np.zeros(side.shape[1], np.bool_)
    apart = np.abs(side[-half:].mean(axis=0) - side[:half].mean(axis=0))
    return np.asarray((usual > 0) & (apart > MOVING * usual / np.sqrt(len(side))), np.bool_)
