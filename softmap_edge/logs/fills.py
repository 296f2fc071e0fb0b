"""Treat numbers that a program writes for missing values as missing.

The largest number of a type stands for "not seen": 3.4028e38 of float32, 1.7977e308 of float64. So
does another number beyond `LARGEST` that occurs several times in a column to the last digit, such
as 1e30 or 9.96921e36. A number beyond `LARGEST` that occurs once is a fault of the file.

Columns of a drive have no neighbouring positions to compare with. There the numbers of `MARKS`
(-999, 9999, the largest integers) stand for a missing value if they exceed every other number of
the column by the factor `FAR`. Ticks of exactly 0 or -1 far from all others are only reported.
Pinned by tests/logs/test_fills.py.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.files.printable import listed
from softmap_edge.logs.not_seen import not_seen
from softmap_edge.logs.readers.columns import Array, Cells

LARGEST = 1e20  # of any cell, whatever its unit: times in nanoseconds since 1970 are 2e18
# magnitudes that programs write into a command column for a missing value
MARKS = tuple(
    [10.0**k - 1.0 for k in range(3, 10)]
    + [999.9, 999.99, 9999.9, 9999.99, 1e9, 1e10, 1e12]
    + [2.0**k - one for k in (15, 16, 31, 32, 53, 63, 64) for one in (0.0, 1.0)]
)
FAR = 10.0  # times the largest other number of the column: no wrong command reaches farther
_UNREAD = (0.0, -1.0)  # ticks reported for a servo that did not answer
_MAXIMA = (float(np.finfo(np.float32).max), float(np.finfo(np.float64).max))
_DIGITS = 1e-3  # relative tolerance: programs write three digits or more
_AGAIN = 3  # occurrences of the number
_KINDS = 2  # different fill numbers in one column
_NAMED = 6  # columns that are listed


def without_fills(cells: Cells, names: list[str], drives: Collection[int] = ()) -> Cells:
    """Return cells with fill numbers replaced by NaN, and a note on them.

    Args:
            cells: the requested columns.
            names: of the columns.
            drives: indices of columns that hold commands or readings of a drive.
    """
    wild = np.abs(cells.numbers) > LARGEST  # NaN is a missing cell
    marks = {j: mask for j in drives if (mask := marked_missing(cells.numbers[:, j])).any()}
    if not marks and not wild.any():
        return cells
    numbers, found = cells.numbers.copy(), []
    for j in range(numbers.shape[1]):
        filled = wild[:, j] & _stand_for_missing(numbers[:, j], wild[:, j])
        filled |= marks.get(j, False)
        if filled.any():
            found.append(
                f"{names[j]} {numbers[filled, j][0]:.6g} in {int(filled.sum())} of {len(numbers)} "
                "rows"
            )
            numbers[filled, j] = np.nan
    if not found:
        return cells
    note = f"numbers that stand for missing values are taken as missing: {listed(found, _NAMED)}"
    return replace(cells, numbers=numbers, notes=(*cells.notes, note))


def marked_missing(column: Array) -> NDArray[np.bool_]:
    """Return which numbers (rows,) of a drive are `MARKS` far beyond every other number."""
    size = np.abs(column)
    marks = np.isin(size, MARKS)
    if not marks.any():
        return np.asarray(marks, np.bool_)
    others = size[np.isfinite(size) & ~marks & (size <= LARGEST)]
    largest = float(others.max(initial=0.0))
    return np.asarray(marks & (size > FAR * largest) & (largest > 0.0), np.bool_)


def unread_ticks(rows: Array) -> NDArray[np.bool_]:
    """Return which ticks (rows, C) are 0 or -1, far from all others and reached by jumps.

    Drivers write these numbers for a servo that did not answer. They are reported but kept, because
    a servo may be sent there.
    """
    fillers = np.isin(rows, _UNREAD)
    if not fillers.any() or fillers.all():
        return np.zeros(rows.shape, np.bool_)
    return np.asarray(fillers & not_seen(rows[:, :, None]).mask, np.bool_)


def _stand_for_missing(column: Array, wild: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which numbers (rows,) are the largest of a type, or occur repeatedly."""
    found = np.zeros(len(column), bool)
    with np.errstate(over="ignore"):
        for largest in _MAXIMA:
            found |= np.abs(np.abs(column) / largest - 1.0) < _DIGITS
    rest = wild & ~found
    values, count = np.unique(column[rest], return_counts=True)
    if len(values) <= _KINDS:
        found |= rest & np.isin(column, values[count >= _AGAIN])
    return found
