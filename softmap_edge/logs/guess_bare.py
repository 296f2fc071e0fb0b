"""Find positions among columns without names, from their values alone.

Three adjacent columns are a position if a unit quaternion follows them, as in a pose. They are one
too if they move smoothly at a nearly constant distance from the origin, as points of a robot do,
and no other moving column remains. Commands start at home and do not match. Pinned by
tests/logs/test_guess_time.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from softmap_edge.logs.drive_roles import is_unit_quaternion
from softmap_edge.logs.guess_sheets import Sheet

Array = NDArray[np.float64]
_SMOOTH = 0.35  # of the spread of a column: largest usual step between rows
_STEADY = 0.34  # of the distance from the origin: its largest change


def places_by_value(sheet: Sheet, spent: set[str]) -> list[list[str]]:
    """Return the triples of columns that are positions; [] if the values do not decide.

    Args:
        sheet: a log without a header.
        spent: columns with another meaning: time, text.
    """
    free = [name for name in sheet.names if name not in spent and name not in sheet.texts]
    posed = [
        free[k : k + 3]
        for k in range(len(free) - 6)
        if is_unit_quaternion(sheet.rows_of(free[k + 3 : k + 7]))
    ]
    posed = [triple for triple in posed if np.isfinite(sheet.rows_of(triple)).all(axis=1).any()]
    if posed:
        return [
            triple
            for triple in posed
            if not any(_quaternion_part(sheet, name, free) for name in triple)
        ]
    moving = [name for name in free if _varies(sheet.column(name))]
    if not moving or len(moving) % 3 or _places(sheet, moving) != list(range(len(moving))):
        return []
    triples = [moving[k : k + 3] for k in range(0, len(moving), 3)]
    return triples if all(_is_place(sheet.rows_of(triple)) for triple in triples) else []


def _places(sheet: Sheet, names: list[str]) -> list[int]:
    """Return the numbers of columns, counted from the first."""
    at = [sheet.names.index(name) for name in names]
    return [k - at[0] for k in at]


def _varies(values: Array) -> bool:
    known = values[np.isfinite(values)]
    return len(known) > 1 and float(np.ptp(known)) > 0


def _quaternion_part(sheet: Sheet, name: str, free: list[str]) -> bool:
    k = free.index(name)
    starts = range(max(0, k - 3), min(k, len(free) - 4) + 1)
    return any(is_unit_quaternion(sheet.rows_of(free[j : j + 4])) for j in starts)


def _is_place(rows: Array) -> bool:
    """Return whether columns (rows, 3) are a position: smooth, with nearly constant distance."""
    known = rows[np.isfinite(rows).all(axis=1)]
    if len(known) < 10:
        return False
    distance = np.linalg.norm(known, axis=1)
    steady = float(np.ptp(distance)) < _STEADY * float(np.median(distance))
    spread, step = np.ptp(known, axis=0), np.median(np.abs(np.diff(known, axis=0)), axis=0)
    return steady and bool((step[spread > 0] < _SMOOTH * spread[spread > 0]).all())
