"""Find columns of one quantity that are in different units although the log states none.

Places of one body are of one size. Markers that are about 1000 times nearer to the origin than the
others, and move about 1000 times less, but in time with them, are in m where the others are in mm.
A marker at rest near the origin does not move in time with the others, or would not keep its
distance to them in m, so it is none of these.
Whole numbers beyond a turn next to fractions within a turn are ticks next to degrees. Nothing is
converted: the import asks for `scale`. Pinned by tests/logs/test_mixed_units.py.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softmap_edge.files.printable import listed

Array = NDArray[np.float64]
_METRE = 1000.0
_SMALLER = 0.02  # of the size and of the motion of the largest: others are in another unit
_SIZES = (0.05, 4.0)  # of the largest distance from the origin, once they are converted
_MOTIONS = (0.02, 4.0)  # of the largest motion, once they are converted
_TOGETHER = 0.7  # correlation of the motion of markers on one body
_STRAIN = 0.15  # of the largest motion: change of the distance between neighbours
_MARKERS = 64  # others that are compared
_FRAMES = 10  # frames that show both
_MOST = 20_000  # frames examined
_TURN = 360.0  # degrees: commands beyond it are ticks if they are whole numbers
_DISTINCT = 5  # ticks that a column holds at least
_LISTED = 6  # names in a message


def places_in_metres(points: Array) -> NDArray[np.intp]:
    """Return the markers that seem to be in m where the others are in mm; none if all are alike.

    Args:
        points: (K, M, 3) in one unit; NaN where nothing was seen.
    """
    points = points[:: max(1, len(points) // _MOST)]
    known = np.asarray(np.isfinite(points).all(axis=2), np.bool_)
    size, motion = np.zeros((2, points.shape[1]))
    for m in np.flatnonzero(known.sum(axis=0) >= _FRAMES):
        place = points[known[:, m], m]
        size[m] = np.median(np.linalg.norm(place, axis=1))
        motion[m] = np.linalg.norm(np.subtract(*np.quantile(place, (0.95, 0.05), axis=0)))
    small = (size > 0) & (motion > 0)
    for one, (low, high) in ((size, _SIZES), (motion, _MOTIONS)):
        ratio = one / max(float(one.max(initial=0.0)), 1e-300)
        small &= (ratio < _SMALLER) & (low < _METRE * ratio) & (_METRE * ratio < high)
    others = np.flatnonzero(~small & (motion > 0))
    if not small.any() or not len(others):
        return np.zeros(0, np.intp)
    moving = others[np.argsort(-motion[others], kind="stable")]
    found = [
        m
        for m in np.flatnonzero(small)
        if any(_together(points[:, m], points[:, n]) for n in moving[:2])
    ]
    near = [points[:, n] for n in moving[:_MARKERS]]
    fits = any(_fits(points[:, m], near, float(motion.max())) for m in found)
    return np.array(found if fits else [], np.intp)


def _fits(one: Array, others: Sequence[Array], motion: float) -> bool:
    """Return whether a marker (K, 3) in m keeps its distance to some other on a bending body.

    Args:
        one: the marker, as it is.
        others: markers (K, 3) in mm.
        motion: of the marker that moves most, mm.
    """
    strains = [
        min(float(np.nanstd(np.linalg.norm(factor * one - other, axis=1))) for other in others)
        for factor in (1.0, _METRE)
    ]
    return strains[1] <= max(_STRAIN * motion, 3.0 * strains[0])


def _together(one: Array, other: Array) -> bool:
    """Return whether two markers (K, 3) move in time with each other."""
    both = np.isfinite(one).all(axis=1) & np.isfinite(other).all(axis=1)
    if both.sum() < _FRAMES:
        return False
    columns = [part[both] - part[both].mean(axis=0) for part in (one, other)]
    first = columns[0] @ np.linalg.svd(columns[0], full_matrices=False)[2][0]  # its main motion
    length = np.linalg.norm(columns[1], axis=0) * np.linalg.norm(first)
    with np.errstate(invalid="ignore", divide="ignore"):
        return bool(np.nanmax(np.abs(first @ columns[1]) / length, initial=0.0) > _TOGETHER)


def places_question(points: Array, labels: Sequence[str]) -> str | None:
    """Return what to ask about markers (K, M, 3) in mixed units; None if they are alike."""
    small = places_in_metres(points)
    if not len(small):
        return None
    names = listed((labels[m] if labels else str(m) for m in small), _LISTED)
    count = points.shape[1]
    return (
        f"{names}: {len(small)} of {count} markers are about 1000 times nearer to the origin than "
        "the others and move about 1000 times less, in time with them, which looks like m where "
        "the others are in mm: set scale of markers, a factor for each column (1000 for these, 1 "
        "for the others), or scale = 1.0 if they are right"
    )


def drives_question(name: str, values: Array, labels: Sequence[str]) -> str | None:
    """Return what to ask about drives in ticks next to degrees; None if they are alike.

    Args:
        name: the key in the mapping, such as `command`.
        values: (T, C) as in the log.
        labels: names of the C columns.
    """
    ticks, others = [], []
    for label, column in zip(labels, values.T):
        known = column[np.isfinite(column)]
        whole = known == np.rint(known)
        peak = float(np.abs(known).max(initial=0.0))
        if whole.all() and peak > _TURN and len(np.unique(known[:_MOST])) >= _DISTINCT:
            ticks.append(label)
        elif len(known) and whole.mean() < 0.5 and peak <= _TURN:
            others.append(label)
    if not ticks or not others:
        return None
    return (
        f"{name}: {listed(ticks, _LISTED)} look like ticks (whole numbers beyond {_TURN:g}), and "
        f"{listed(others, _LISTED)} like degrees or lengths (fractions within {_TURN:g}): set "
        f"scale and offset of {name}, a number for each column, so that all have one unit, or "
        "scale = 1.0 if they do"
    )
