"""Estimate the noise of places, and the chance of an exact repetition.

A new measurement then repeats the one before to the last digit.

Noise shows in differences of fourth order, which change sign from row to row; a smooth motion
hardly shows in them. If the noise is below the last digit of the file, as of a resting finger with
coarse digits, a repeat is likely. If it is far above, a repeat is an old value. Pinned by
tests/logs/test_old_pictures.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RARE = 0.01  # repeats by chance that are expected in a log: with fewer, each repeat is an old value
LEAST = 12  # rows: of fewer no noise is estimated
ORDER, SPREAD = 4, 70.0  # of the differences, and their variance for noise of variance 1
MEDIAN = 0.6745  # of the magnitude of normal noise of deviation 1
FLIPS = 0.65  # share of differences that change sign; 0.8 for noise, far less for a smooth motion


def is_improbable(columns: Array) -> bool:
    """Return whether no row of a log repeats the one before by chance.

    Args:
        columns: (rows, n) numbers as the file has them, in order of time, NaN where nothing was
            seen.
    """
    chance = 1.0
    for column in columns.T:
        noise, digit = noise_of(column), digit_of(column)
        chance *= min(1.0, digit / (2.0 * np.sqrt(np.pi) * noise)) if noise > 0 else 1.0
    return bool(len(columns) * chance < RARE)


def noise_of(column: Array) -> float:
    """Return the standard deviation of the noise of numbers (rows,).

    It is 0 where they are smooth or mostly the same.
    """
    change = np.diff(column, ORDER)
    change = change[np.isfinite(change)]
    size = float(np.median(np.abs(change))) if len(change) >= LEAST else 0.0
    if size == 0.0:
        return 0.0
    flips = np.sign(change[1:]) * np.sign(change[:-1])
    flips = flips[flips != 0]
    return size / (MEDIAN * np.sqrt(SPREAD)) if len(flips) and (flips < 0).mean() > FLIPS else 0.0


def digit_of(column: Array) -> float:
    """Return the step of the last digit of numbers (rows,): the least distance of two values."""
    step = np.diff(np.unique(column[np.isfinite(column)]))
    return float(step.min()) if len(step) else 0.0
