"""Compare how far commands move a body with how far they should.

    leverage = RMS of A(s) / RMS of A(p)     s measured, p predicted points; A the part of their
                                             motion that commands and their squares explain

A body hardly follows its commands if its leverage is smaller than any gain can be and the commands
explain its motion. A dead zone or a play of nearly the full range has a small leverage too, but its
motion takes another course than the commands. Pinned by tests/checks/test_leverage.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from softmap_edge.checks.remembered import centred
from softmap_edge.logs.chance import noise_of

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

LARGER = 4.0  # times the expected motion, or its inverse: no gain is that wrong
ALIKE = 0.8  # share of the motion that must be explained to name a cause


def hardly_follows(u: Floats, seen: Floats, visible: Mask, expected: Floats) -> str | None:
    """Report a body that moves by a small part of what its commands should move it.

    Args:
        u: commands (K, C) at the frames.
        seen: measured points (K, N, 3) mm.
        visible: which points were seen, (K, N).
        expected: predicted points (K, N, 3) mm.

    Returns:
        str | None: the finding with its numbers; None if the body follows, or if the commands do
        not explain its motion.
    """
    total = power(centred(seen, visible), visible)
    required = power(centred(expected, visible), visible)
    if LARGER**2 * total >= required:
        return None
    by_commands = power(answered(u, seen, visible), visible)
    should = power(answered(u, expected, visible), visible)
    if LARGER**2 * by_commands >= should:
        return None
    if by_commands < ALIKE * (total - noise(np.where(visible[..., None], seen, np.nan)) ** 2):
        return None
    return (
        f"the commands should move its points by {np.sqrt(required):.3g} mm RMS, and they move by "
        f"{np.sqrt(total):.2g} mm RMS, which is {100 * np.sqrt(by_commands / should):.2g} % of the "
        "motion for each command"
    )


def answered(u: Floats, points: Floats, visible: Mask) -> Floats:
    """Return the motion of points (K, N, 3) that commands (K, C) and their squares explain.

    It is 0 where a point is not visible, and has no mean over the frames that show it.
    """
    moved, found = centred(points, visible), np.zeros(points.shape)
    scaled = (u - u.mean(axis=0)) / np.maximum(u.std(axis=0), 1e-12)
    columns = np.column_stack([np.ones(len(u)), scaled, scaled**2])
    for n in range(points.shape[1]):
        rows = visible[:, n]
        if rows.sum() > columns.shape[1]:
            fit = np.linalg.lstsq(columns[rows], moved[rows, n], rcond=1e-9)[0]
            found[rows, n] = columns[rows] @ fit
    return centred(found, visible)


def noise(places: Floats) -> float:
    """Return the noise of a point (RMS, mm) from places (K, N, 3), NaN where it was not seen."""
    each = [[noise_of(column) for column in point.T] for point in places.transpose(1, 0, 2)]
    return float(np.sqrt(np.mean(np.sum(np.square(each), axis=1))))


def power(moved: Floats, visible: Mask) -> float:
    """Return the mean square (mm²) of a motion (K, N, 3) over its visible points."""
    return float(np.sum(moved**2)) / max(int(visible.sum()), 1)
