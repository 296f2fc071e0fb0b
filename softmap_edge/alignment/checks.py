"""Checks that reject an alignment: other units, mirrors, collinear points, other robots.

Every error states its number and its remedy. Units: mm, rad. Pinned by
tests/alignment/test_align_refuses.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import AlignError
from softmap_edge.geometry.rigid import RigidPose, robust
from softmap_edge.geometry.sections import UNITS

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

LINE = 0.02  # of their length: points closer than this to one line do not show the turn about it
SHORTEST = 1.0  # mm: base points closer together than this do not define a frame
WORST_TURN = np.radians(5.0)  # rad: a rotation with a larger uncertainty counts as unknown
REFUSED = 0.1  # deviation of the distances between points that is too much
MIRRORED = 0.5  # of the residual: a mirrored frame with a smaller one is the true one
SOUND = 0.9  # of the points, the nearest ones, used to measure the fit
SHAPE = 0.12  # of the extent: largest residual between points and model of the same robot
# 97.5 %, 1 to 10 degrees of freedom
STUDENT = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228)


def check_points_match(predicted: Floats, shape: tuple[int, ...]) -> None:
    """Reject a model that predicts other points than the run shows, or none.

    Args:
        predicted: (K, N, 3) mm.
        shape: shape of the seen points.

    Raises:
        AlignError: their numbers differ, or a prediction is not finite.
    """
    if predicted.shape[1:] != shape[1:] or not np.isfinite(predicted).all():
        raise AlignError(
            f"the model predicts {predicted.shape[1]} points at home, the run shows {shape[1]}; "
            "give the bundle of this robot"
        )


def check_places(places: Floats) -> None:
    """Reject fewer than three places (N, 3) mm, or places on one line.

    Raises:
        AlignError: the fault.
    """
    if len(places) < 3:
        raise AlignError(f"{len(places)} base points; a frame needs three that are not on one line")
    if not np.isfinite(places).all():
        raise AlignError(
            "a place of a base point is not a finite number; give three numbers in mm for each"
        )
    _check_line(places, "the base points", "name one more next to that line")


def _check_line(points: Floats, what: str, remedy: str) -> None:
    centred = points - points.mean(axis=0)
    _, size, axes = np.linalg.svd(centred, full_matrices=False)
    if size[0] < SHORTEST:
        raise AlignError(f"{what} lie within {size[0]:.2g} mm of each other; {remedy}")
    if size[1] < LINE * size[0]:
        axis = axes[0] * np.sign(axes[0][int(np.argmax(np.abs(axes[0])))])
        name = "xyz"[int(np.argmax(np.abs(axis)))]
        raise AlignError(
            f"{what} lie on one line along ({axis[0]:.2f}, {axis[1]:.2f}, {axis[2]:.2f}), so the "
            f"rotation about it (about {name}) is unknown; {remedy}"
        )


def check_turns(points: Floats, sigma: Floats, answer: Floats) -> None:
    """Reject points that leave a rotation unknown.

    Args:
        points: (N, 3) mm.
        sigma: standard deviation of the rotations, (3,) rad.
        answer: response of the pose to the points, from `gain`.

    Raises:
        AlignError: the axis of the unknown rotation, and the remedy.
    """
    remedy = (
        "name three base markers that are not on one line (--base), or see more points away from "
        "the axis"
    )
    _check_line(points, "the points", remedy)
    if not np.isfinite(answer).all() or sigma.max() > WORST_TURN:
        worst = int(np.argmax(sigma))
        raise AlignError(
            f"the rotation about {'xyz'[worst]} is known to ± {np.degrees(sigma[worst]):.2g} deg "
            f"only, {np.degrees(WORST_TURN):.0f} is the most that is of use; {remedy}"
        )


def check_scale(source: Floats, target: Floats, seen: Mask, what: str, left: float = 0.0) -> float:
    """Return the ratio of point distances to the right ones, the median over pairs.

    Args:
        source: measured points, (G, N, 3) mm.
        target: points with the right distances, (G, N, 3) mm.
        seen: which points are known, (G, N).
        what: name of the target, for the message.
        left: RMS distance after the pose, mm.

    Raises:
        AlignError: the points are in another unit, or of another robot.
    """
    ratios = []
    rng = np.random.default_rng(0)
    for s, q, known in zip(source, target, seen):
        index = np.flatnonzero(known)
        if len(index) < 2:
            continue
        a, b = np.triu_indices(len(index), 1)
        if len(a) > 4000:
            pick = rng.choice(len(a), 4000, replace=False)
            a, b = a[pick], b[pick]
        distance = np.linalg.norm(q[index[a]] - q[index[b]], axis=1)
        far = distance > 0.3 * distance.max(initial=0.0)
        ratios.append(
            np.linalg.norm(s[index[a]] - s[index[b]], axis=1)[far] / np.maximum(distance[far], 1e-9)
        )
    ratio = float(np.median(np.concatenate(ratios))) if ratios else 1.0
    unit = next(
        (name for factor, name in UNITS.items() if abs(ratio / factor - 1.0) < REFUSED), None
    )
    if unit is not None:
        raise AlignError(
            f"wrong units: distances between the points are {ratio:.3g} times those of {what}, "
            f"which looks like {unit}; convert the points to mm"
        )
    if abs(ratio - 1.0) > REFUSED:
        raise AlignError(
            f"distances between the points are {ratio:.3g} times those of {what}, 0.9 to 1.1 is "
            "possible; another robot, other units, or markers in another order"
        )
    extent = float(np.ptp(target.reshape(-1, 3), axis=0).max())
    if left > SHAPE * extent:
        raise AlignError(
            f"after the best rigid transform the points are still {left:.3g} mm RMS off {what} "
            f"({extent:.0f} mm long); another robot, or markers in another order"
        )
    return ratio


def check_mirror(
    source: Floats, target: Floats, sigma: Floats, seen: Mask, pose: RigidPose, what: str
) -> None:
    """Reject points that a mirrored frame fits much better than any rotation.

    Args:
        source: measured points, (N, 3) mm.
        target: points that they correspond to, (N, 3) mm.
        sigma: standard deviation of a coordinate, (N,) mm.
        seen: which points are known, (N,).
        pose: the best rigid pose.
        what: name of the target, for the message.

    Raises:
        AlignError: the frame is mirrored.
    """
    flipped = source * [1.0, 1.0, -1.0]
    mirror, _ = robust(flipped, target, sigma, seen)
    count = max(3, int(SOUND * seen.sum()))
    as_is, mirrored = (
        float(np.sort(np.linalg.norm(p(s) - target, axis=1)[seen])[:count].mean())
        for p, s in ((pose, source), (mirror, flipped))
    )
    extent = float(np.ptp(target[seen], axis=0).max())
    if mirrored < MIRRORED * as_is and as_is > 0.01 * extent:
        raise AlignError(
            f"the frame is mirrored: the points are {as_is:.3g} mm off {what}, but {mirrored:.3g} "
            "mm if one axis is turned round; correct the sign of one axis, or swap two, where "
            "the log is imported (`axes` of the mapping)"
        )


def student(freedom: int) -> float:
    """Return the factor that widens a sigma from few groups, so that ± 2 of it hold 95 %.

    It is Student's 97.5 % quantile over 1.96.
    """
    if freedom < 1:
        return STUDENT[0] / 1.96
    return (STUDENT[freedom - 1] if freedom <= len(STUDENT) else 1.96 + 2.4 / (freedom - 1)) / 1.96
