"""Find markers whose position is frozen to the last digit while the robot moves.

The tracker has lost such a marker and repeats its last position. Each repeating marker is compared
with the others: its position is predicted from each of them by least squares over the frames in
which it is new. If its noise makes a repeat improbable (`chance`), all repeats count in which
another marker is new. If most predictions move, far beyond their error and the digits of the file,
the marker was lost. If all markers freeze together while the commands move, the noise decides. In
a noisy recording they were lost, because no sensor repeats its noise, while a simulation within a
play does. In a recording without noise they were lost if they jump afterwards to their commanded
positions, because a body that leaves a play or a stop does not jump. Limit: a marker lost while the
robot rests is not found, which is harmless. Pinned by tests/logs/test_not_seen.py.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.logs.chance import digit_of, is_improbable
from softmap_edge.run.stretches import stretches_of

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST = 2  # consecutive repeats of all markers: a coarse picture may occur twice
BEYOND = 5.0  # times the RMS error of the prediction, and the digits of the file
MOVED = 0.02  # of the extent of the marker: the least such motion
PART = 0.2  # of the frames of a stretch that must show it
OTHERS = 4  # markers from which a position is predicted
ROWS = 4  # new frames for each column of the prediction
MOST = 20_000  # frames of a fit
DRIVEN = 0.05  # of the range of a command
SQUARES = 6  # commands; up to here their products also predict a position
SLOW = 0.5  # of the new pictures that repeat: the camera is slower than the log
NOISY = 0.02  # of the frame pairs outside that repeat: a noisy recording has no more


@dataclass(frozen=True)
class Held:
    """Frames (n,) in which marker `marker` repeats its last position while the robot moves."""

    marker: int
    frames: NDArray[np.intp]


def held_places(points: Array, u: Array | None) -> list[Held]:
    """Find the frames in which a lost marker repeats its last position.

    Args:
        points: (K, M, D), NaN where nothing was seen.
        u: (K, C) commands relative to their ranges; None if unknown.
    """
    if len(points) < 2:
        return []
    again = np.zeros(points.shape[:2], bool)
    again[1:] = (points[1:] == points[:-1]).all(axis=2)
    found = [one for m in range(points.shape[1]) for one in _against_others(points, again, m)]
    return found or _against_commands(points, again, u)


def _runs(again: Mask, least: int) -> Iterator[tuple[int, int]]:
    """Yield each stretch of at least `least` repeats: its first, and the frame after it."""
    for first, end in stretches_of(again):
        if end - first >= least:
            yield first, end


def _against_others(points: Array, again: Mask, m: int) -> Iterator[Held]:
    """Yield where one marker is frozen although most other markers indicate motion."""
    rows = np.flatnonzero(again[:, m])
    if not len(rows) or points.shape[1] < 2:
        return
    known = np.asarray(np.isfinite(points).all(axis=2), np.bool_)
    if is_improbable(points[:, m]):
        rows = rows[np.delete(known & ~again, m, axis=1)[rows].any(axis=1)]
        if len(rows):
            yield Held(m, rows)
        return
    fresh = known[:, m] & ~again[:, m]
    # where each position is new
    since = np.maximum.accumulate(np.where(again[:, m], 0, np.arange(len(points))))[rows]
    least = max(
        BEYOND * _digit(points[fresh, m]),
        MOVED * float(np.linalg.norm(np.ptp(points[fresh, m], axis=0))),
    )
    votes = np.zeros(len(rows))
    for n in _others(known, again, m):
        predicted, error = _fitted(points[:, n], points[:, m], known[:, n], fresh)
        if predicted is not None:
            moved = np.linalg.norm(predicted[rows] - predicted[since], axis=1)
            votes += np.where(
                moved > max(BEYOND * error, least), 1.0, np.where(np.isnan(moved), 0.0, -1.0)
            )
    _, stretch = np.unique(since, return_inverse=True)
    share = np.bincount(stretch, votes > 0) / np.bincount(stretch)
    if (share > PART).any():
        yield Held(m, rows[share[stretch] > PART])


def _others(known: Mask, again: Mask, m: int) -> list[int]:
    """Return the nearest listed markers that are not always frozen together with marker `m`."""
    order = [
        int(n) for n in np.argsort(np.abs(np.arange(known.shape[1]) - m), kind="stable") if n != m
    ]
    both = (again & again[:, m : m + 1]).sum(axis=0)
    return [n for n in order if known[:, n].any() and both[n] < again[:, m].sum()][:OTHERS]


def _fitted(columns: Array, places: Array, there: Mask, fresh: Mask) -> tuple[Array | None, float]:
    """Return positions (K, D) from a linear fit to the columns (K, n), and its RMS error.

    The fit uses new frames; all other frames are NaN.
    """
    fit = there & fresh
    if fit.sum() < ROWS * (columns.shape[1] + 1):
        return None, 0.0
    scaled = (columns - columns[fit].mean(axis=0)) / np.maximum(columns[fit].std(axis=0), 1e-9)
    scaled = np.column_stack([np.ones(len(columns)), scaled])
    some = np.flatnonzero(fit)[:: max(1, int(fit.sum()) // MOST)]
    weights = np.linalg.lstsq(scaled[some], places[some], rcond=1e-6)[0]
    predicted = np.where(there[:, None], scaled @ weights, np.nan)
    left = predicted[fit] - places[fit]
    return predicted, float(np.sqrt(np.mean(np.sum(left**2, axis=1))))


def _digit(places: Array) -> float:
    """Return the last digit's step of positions (n, D): the smallest difference of two numbers."""
    return max(map(digit_of, places.T), default=0.0)


def _against_commands(points: Array, again: Mask, u: Array | None) -> list[Held]:
    """Return where all visible markers are frozen while the commands move.

    In a recording without noise, the markers must also jump afterwards to their commanded
    positions.
    """
    known = np.asarray(np.isfinite(points).all(axis=2), np.bool_)
    frozen = np.asarray(again.any(axis=1) & (again | ~known).all(axis=1), np.bool_)
    if u is None or not frozen.any() or frozen[1:][~frozen[:-1]].mean() > SLOW:
        return []
    stretches = [
        (a, b) for a, b in _runs(frozen, LEAST) if np.ptp(u[a - 1 : b], axis=0).max() > DRIVEN
    ]
    if not stretches:
        return []
    if not _noisy(frozen, stretches, u):
        m = int(known.sum(axis=0).argmax())
        stretches = list(_jumped(points[:, m], known[:, m] & ~frozen, stretches, u))
    frames = np.array([k for a, b in stretches for k in range(a, b)], np.intp)
    return [
        Held(int(m), frames[known[frames, m]]) for m in np.flatnonzero(known[frames].any(axis=0))
    ]


def _noisy(frozen: Mask, stretches: list[tuple[int, int]], u: Array) -> bool:
    """Return whether the recording has noise.

    Then no picture repeats outside the stretches, not even while the commands rest.
    """
    outside = np.ones(len(frozen), bool)
    for a, b in stretches:
        outside[a:b] = False
    outside[0] = False
    still = outside & (np.abs(np.diff(u, axis=0, prepend=u[:1])).max(axis=1) < 1e-6)
    return bool(
        still.sum() >= 2 * LEAST
        and frozen[still].mean() <= NOISY
        and frozen[outside].mean() <= NOISY
    )


def _jumped(
    places: Array, fresh: Mask, stretches: list[tuple[int, int]], u: Array
) -> Iterator[tuple[int, int]]:
    """Yield stretches after which a marker (K, D) jumps to its commanded position."""
    squares = np.column_stack(
        [u, *(u[:, i] * u[:, j] for i in range(u.shape[1]) for j in range(i + 1))]
    )
    columns = squares if u.shape[1] <= SQUARES else u
    predicted, error = _fitted(columns, places, np.ones(len(u), bool), fresh)
    if predicted is None:
        return
    seen = places[fresh]
    extent = float(np.linalg.norm(np.ptp(seen, axis=0)))
    least = max(BEYOND * error, BEYOND * _digit(seen), MOVED * extent)
    for a, b in stretches:
        if b < len(u) and fresh[b]:
            moved = predicted[b] - predicted[a - 1]
            jump = places[b] - places[a - 1]
            if np.linalg.norm(moved) > least and np.linalg.norm(
                jump - moved
            ) < 0.5 * np.linalg.norm(moved):
                yield a, b
