"""Take numbers that no sensor measures, and that a program writes for a missing value, as missing.

The largest number of a type stands for "not seen": 3.4028e38 of float32, 1.7977e308 of float64. So
does another number beyond `LARGEST` that a column holds several times to the last digit, such as
1e30 or 9.96921e36. A number beyond `LARGEST` that occurs once is a fault of the file. Pinned by
tests/logs/test_fills.py.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.files.printable import listed
from softmap_edge.logs.readers.columns import Array, Cells

LARGEST = 1e20  # of any cell, whatever its unit: times in nanoseconds since 1970 are 2e18
_MAXIMA = (float(np.finfo(np.float32).max), float(np.finfo(np.float64).max))
_DIGITS = 1e-3  # relative: programs write three digits or more
_AGAIN = 3  # times that a number is there
_KINDS = 2  # different numbers of one column that stand for missing values
_NAMED = 6  # columns that are named


def without_fills(cells: Cells, names: list[str]) -> Cells:
    """Return cells in which numbers that stand for missing values are NaN, with a note on them.

    Args:
        cells: the columns that were asked for.
        names: of the columns.
    """
    wild = np.abs(cells.numbers) > LARGEST  # NaN is an absent cell
    if not wild.any():
        return cells
    numbers, found = cells.numbers.copy(), []
    for j in np.flatnonzero(wild.any(axis=0)):
        filled = wild[:, j] & _stand_for_missing(numbers[:, j], wild[:, j])
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


def _stand_for_missing(column: Array, wild: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which numbers (rows,) are the largest of a type, or are there again and again."""
    found = np.zeros(len(column), bool)
    with np.errstate(over="ignore"):
        for largest in _MAXIMA:
            found |= np.abs(np.abs(column) / largest - 1.0) < _DIGITS
    rest = wild & ~found
    values, count = np.unique(column[rest], return_counts=True)
    if len(values) <= _KINDS:
        found |= rest & np.isin(column, values[count >= _AGAIN])
    return found
