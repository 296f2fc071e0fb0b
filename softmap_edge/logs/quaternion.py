"""Recognise unit quaternions by their values: four columns whose length is 1 in every row."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_UNIT = 1e-2  # of the length: how far it may be from 1


def is_unit_quaternion(rows: NDArray[np.float64]) -> bool:
    """Return whether columns are unit quaternions in all rows in which they are known.

    Args:
        rows: (T, C) numbers; NaN where a cell is missing. Only C = 4 can be quaternions.
    """
    known = rows[np.isfinite(rows).all(axis=1)]
    if rows.shape[1] != 4 or len(known) < 2:
        return False
    return bool((np.abs(np.linalg.norm(known, axis=1) - 1.0) < _UNIT).all())
