"""Find positions with one coordinate that stands for "not seen", such as depth 0 or 65535.

Depth cameras give such values. The number is equal to the last digit in several frames, and farther
from all other numbers of the coordinate than their range. The marker jumps to and from it, or it
is not the position of a robot at rest. The other coordinates may continue, as for a pixel without
depth. Pinned by tests/logs/test_one_coordinate.py.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST = 5  # other frames of a marker
MOVES = 3  # distinct numbers of a moving coordinate
OFTEN = 2  # frames and markers that show the number
FAR = 1.0  # times the range of the other numbers
STEPS = 2.0  # times the longest of the other steps
MOST = 4  # numbers of one coordinate that are tested
AT_REST, MOVED = 0.05, 0.1  # of the range of each command: equal commands, and different ones
NAMES = "xyz"


@dataclass(frozen=True)
class Coordinate:
    """A "not seen" number: coordinate `axis` of marker `marker` is `number` in `frames` (n,)."""

    marker: int
    axis: int
    number: float
    frames: NDArray[np.intp]


def lost_coordinates(points: Array, u: Array | None) -> list[Coordinate]:
    """Find the coordinates that stand for "not seen".

    Args:
        points: (K, M, D), NaN where nothing was seen.
        u: (K, C) commands relative to their ranges; None if unknown.
    """
    found = []
    for axis in range(points.shape[2]) if points.shape[2] > 1 else ():
        part = points[..., axis]
        for number in _candidates(part):
            for m, frames in _of_markers(part, number, u):
                found.append(Coordinate(m, axis, number, frames))
    return found


def _candidates(part: Array) -> list[float]:
    """Return the repeated numbers of one coordinate (K, M) farthest from its median."""
    numbers, count = np.unique(part[np.isfinite(part)], return_counts=True)
    if len(numbers) < 1 + MOVES:
        return []
    several = numbers[count >= OFTEN]
    away = np.abs(several - np.nanmedian(part))
    return [float(x) for x in several[np.argsort(-away, kind="stable")[:MOST]]]


def _of_markers(
    part: Array, number: float, u: Array | None
) -> Iterator[tuple[int, NDArray[np.intp]]]:
    """Yield markers with a number for "not seen" in a coordinate (K, M), and the frames."""
    for m in np.flatnonzero((part == number).any(axis=0)):
        at, known = part[:, m] == number, np.isfinite(part[:, m])
        others = part[known & ~at, m]
        if len(others) < LEAST or len(np.unique(others)) < MOVES:
            continue
        far = np.abs(others - number).min() > FAR * float(np.ptp(others))
        if (
            far
            and _jumps(part[known, m], at[known])
            and not (u is not None and _rests(u, at, known & ~at))
        ):
            yield int(m), np.flatnonzero(at)


def _jumps(numbers: Array, at: Mask) -> bool:
    """Return whether a coordinate (n,) reaches and leaves its number by its longest steps."""
    step = np.abs(np.diff(numbers))
    usual, into = step[~at[1:] & ~at[:-1]], step[at[1:] != at[:-1]]
    return bool(len(usual) and len(into) and into.min() > STEPS * usual.max())


def _rests(u: Array, at: Mask, others: Mask) -> bool:
    """Return whether the robot may be at rest there.

    It then has this number under one command only, and others under other commands.
    """
    middle = np.median(u[at], axis=0)
    if np.abs(u[at] - middle).max() > AT_REST:
        return False
    return not bool((np.abs(u[others] - middle).max(axis=1) < MOVED).any())
