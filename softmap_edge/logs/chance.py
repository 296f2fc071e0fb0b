"""Estimate the noise of positions, and the probability that a measurement repeats exactly.

An exact repeat equals the previous measurement to the last digit. Noise appears in fourth-order
differences, which change sign from row to row; smooth motion contributes little to them. If the
noise is below the last digit of the file, as for a resting finger with coarse digits, repeats are
likely. If it is far above, a repeat is an old value. Pinned by tests/logs/test_old_pictures.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RARE = 0.01  # expected number of chance repeats in a log; below it, each repeat is an old value
LEAST = 12  # rows; with fewer, no noise is estimated
ORDER, SPREAD = 4, 70.0  # order of the differences, and their variance for noise of variance 1
MEDIAN = 0.6745  # median magnitude of normal noise with standard deviation 1
FLIPS = 0.65  # share of differences that change sign: 0.8 for noise, far less for smooth motion


def is_improbable(columns: Array) -> bool:
    """Return whether chance repeats of the previous row are improbable in a log.

    Args:
        columns: numbers as in the file, shape (rows, n), in order of time; NaN where nothing was
            seen.
    """
    chance = 1.0
    for column in columns.T:
        noise, digit = noise_of(column), digit_of(column)
        chance *= min(1.0, digit / (2.0 * np.sqrt(np.pi) * noise)) if noise > 0 else 1.0
    return bool(len(columns) * chance < RARE)


def noise_of(column: Array) -> float:
    """Return the standard deviation of the noise of numbers (rows,).

    It is 0 if they are smooth or mostly equal.
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
    """Return the last digit's step of numbers (rows,): the smallest difference of two values."""
    step = np.diff(np.unique(column[np.isfinite(column)]))
    return float(step.min()) if len(step) else 0.0
