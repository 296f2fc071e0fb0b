"""Find markers that stand still to the last digit while the robot moves: a tracker that repeats the last place.

A marker that repeats its place is compared with what the others do. Its place is predicted from theirs by least squares
over the frames in which it is fresh. If the prediction moves on, far beyond its error and the digits of the file, the
marker was lost. If all markers stand still together, only a recording with noise shows it: no sensor repeats
its noise, but a simulation in a play does. Then commands that move meanwhile make the frames not seen.
Limit: a marker that is lost while the robot rests is not found, and does no harm. Pinned by tests/test_not_seen.py.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST = 2  # repetitions of all markers in a row: a coarse picture may be the same twice
BEYOND = 5.0  # of the error of the prediction, RMS, and of the digits of the file
MOVED = 0.02  # of the extent of the marker, likewise
OTHERS = 4  # markers from which a place is predicted
ROWS = 4  # fresh frames for each column of the prediction
DRIVEN = 0.05  # of the range of a command
NOISY = 0.02  # of the pairs of frames outside that repeat: a recording with noise has no more


@dataclass(frozen=True)
class Held:
    """Frames (n,) in which marker `marker` repeats its last place while the robot moves."""

    marker: int
    frames: NDArray[np.intp]


def held_places(points: Array, u: Array | None) -> list[Held]:
    """Find the frames in which a marker was lost and its last place repeated.

    Args:
        points: (K, M, D), NaN where nothing was seen. u: (K, C) commands, each in its range; None where unknown.
    """
    if len(points) < 2:
        return []
    again = np.zeros(points.shape[:2], bool)
    again[1:] = (points[1:] == points[:-1]).all(axis=2)
    found = [one for m in range(points.shape[1]) for one in _against_others(points, again, m)]
    return found or _against_commands(points, again, u)


def _runs(again: Mask, least: int) -> Iterator[tuple[int, int]]:
    """Yield the first repetition of each stretch of `least` or more (K,), and the frame after its last one."""
    edges = np.flatnonzero(np.diff(np.r_[False, again, False].astype(int)))
    for first, end in edges.reshape(-1, 2):
        if end - first >= least:
            yield int(first), int(end)


def _against_others(points: Array, again: Mask, m: int) -> Iterator[Held]:
    """Yield where one marker stands still while what the others do says that it moves."""
    stretches = list(_runs(again[:, m], 1))
    if not stretches or points.shape[1] < 2:
        return
    predicted, error = _predicted(points, again, m)
    if predicted is None:
        return
    fresh = points[np.isfinite(points[:, m]).all(axis=1) & ~again[:, m], m]
    extent = float(np.linalg.norm(np.ptp(fresh, axis=0)))
    least = max(BEYOND * error, BEYOND * _digit(fresh), MOVED * extent)
    for first, end in stretches:
        moved = np.linalg.norm(predicted[first:end] - predicted[first - 1], axis=1)
        if np.isfinite(moved).any() and float(np.nanmax(moved)) > least:
            yield Held(m, np.arange(first, end))


def _predicted(points: Array, again: Mask, m: int) -> tuple[Array | None, float]:
    """Return where a marker should be (K, D) by the others, and the RMS error of that; None where they do not say."""
    known = np.asarray(np.isfinite(points).all(axis=2), np.bool_)
    others = [n for n in np.argsort(np.abs(np.arange(points.shape[1]) - m), kind="stable") if n != m]
    others = [n for n in others if known[:, n].any() and (again[:, n] & again[:, m]).sum() < again[:, m].sum()]
    chosen = others[:OTHERS]
    if not chosen:
        return None, 0.0
    there = np.asarray(known[:, chosen].all(axis=1), np.bool_)
    fit = there & known[:, m] & ~again[:, m]
    columns = np.column_stack([np.ones(len(points)), points[:, chosen].reshape(len(points), -1)])
    if fit.sum() < ROWS * columns.shape[1]:
        return None, 0.0
    middle, scale = columns[fit].mean(axis=0), np.maximum(columns[fit].std(axis=0), 1e-9)
    middle[0], scale[0] = 0.0, 1.0
    columns = (columns - middle) / scale
    weights = np.linalg.lstsq(columns[fit], points[fit, m], rcond=1e-6)[0]
    predicted = np.where(there[:, None], columns @ weights, np.nan)
    left = predicted[fit] - points[fit, m]
    return predicted, float(np.sqrt(np.mean(np.sum(left**2, axis=1))))


def _digit(places: Array) -> float:
    """Return the step of the last digit of places (n, D): the least distance between two different numbers."""
    steps = [np.diff(np.unique(column)) for column in places.T]
    found = [float(step.min()) for step in steps if len(step)]
    return max(found, default=0.0)


def _against_commands(points: Array, again: Mask, u: Array | None) -> list[Held]:
    """Return where all markers that are seen stand still while the commands move, in a recording with noise."""
    known = np.asarray(np.isfinite(points).all(axis=2), np.bool_)
    frozen = np.asarray(again.any(axis=1) & (again | ~known).all(axis=1), np.bool_)
    if u is None or not frozen.any():
        return []
    stretches = [(a, b) for a, b in _runs(frozen, LEAST) if np.ptp(u[a - 1 : b], axis=0).max() > DRIVEN]
    outside = np.ones(len(points), bool)
    for a, b in stretches:
        outside[a:b] = False
    outside[0] = False
    still = outside & (np.abs(np.diff(u, axis=0, prepend=u[:1])).max(axis=1) < 1e-6)
    if not stretches or still.sum() < 2 * LEAST or frozen[still].mean() > NOISY or frozen[outside].mean() > NOISY:
        return []
    frames = np.concatenate([np.arange(a, b) for a, b in stretches])
    return [Held(int(m), frames[known[frames, m]]) for m in np.flatnonzero(known[frames].any(axis=0))]
