"""Find markers that a log never saw: three equal numbers, such as 0, 0, 0, in every row.

A tracker writes such a place for a marker that it lost. The place 0, 0, 0 may also be the origin of
the log, where a base marker stands. No other marker repeats three equal numbers to the last digit.
Pinned by tests/logs/test_never_seen.py.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softmap_edge.files.printable import listed

Array = NDArray[np.float64]

LEAST = 5  # rows of a marker: fewer are not enough
_NAMED = 5  # markers that are named one by one


def never_seen(points: Array) -> NDArray[np.intp]:
    """Return the markers whose coordinates are one and the same number in every known row.

    Args:
        points: (K, M, D) places as the file has them, NaN where nothing was seen; none if D = 1.
    """
    if points.ndim != 3 or points.shape[2] < 2:
        return np.zeros(0, np.intp)
    return np.array(
        [m for m in range(points.shape[1]) if _is_one_number(points[:, m])], dtype=np.intp
    )


def _is_one_number(places: Array) -> bool:
    """Whether the known places (K, D) of one marker all consist of the same number."""
    known = places[np.isfinite(places).all(axis=1)]
    return len(known) >= LEAST and bool((known == known[0, 0]).all())


def at_one_number(points: Array, markers: Sequence[int], labels: Sequence[str]) -> list[str]:
    """Return for each number the phrase `m3 at exactly 0, 0, 0 in all 600 frames`.

    Args:
        points: (K, M, D), as of `never_seen`.
        markers: from `never_seen`.
        labels: a name for each of the M markers.
    """
    groups: dict[tuple[float, int], list[str]] = {}
    for m in markers:
        known = points[np.isfinite(points[:, m]).all(axis=1), m]
        groups.setdefault((float(known[0, 0]) + 0.0, len(known)), []).append(labels[m])
    phrases = []
    for (number, count), names in groups.items():
        place = ", ".join([f"{number:.10g}"] * points.shape[2])
        of = "" if count == len(points) else f" of {len(points)} known"
        phrases.append(f"{listed(names, _NAMED)} at exactly {place} in all {count}{of} frames")
    return phrases


def never_moving(points: Array) -> list[int]:
    """Return the markers of (K, M, D) that are at one place to the last digit in all known rows."""
    found = []
    for m in range(points.shape[1]):
        known = points[np.isfinite(points[:, m]).all(axis=1), m]
        if len(known) >= LEAST and bool((known == known[0]).all()):
            found.append(m)
    return found


def moving(points: Array) -> Array:
    """Return the points (K, M, 3) without markers that never move, if two or more others remain.

    A place that repeats to the last digit in every frame was not measured, so it does not show the
    axis along which a robot lies.
    """
    moves = np.ones(points.shape[1], bool)
    moves[never_moving(points)] = False
    return points[:, moves] if 2 <= moves.sum() < len(moves) else points
