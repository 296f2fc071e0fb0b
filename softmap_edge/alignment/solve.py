"""Fit one pose to groups of frames, and estimate its uncertainty.

    Σ = T² · max(scatter of the groups' poses, sensor noise)/groups + shape
        six numbers: rotations, then shifts
    T       widens for few groups: Student's 97.5 % over 1.96, so that ± 2 σ holds 95 %
    shape   of home frames: the model error, correlated along the body and scaled to the misfit;
            of base points: the misfit over the coordinates that the pose does not use (3 N − 6),
            independent for each point

Units: mm and rad; degrees in reports. Pinned by tests/alignment/test_align.py over many seeds.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from softmap_edge.alignment.checks import check_mirror, check_scale, check_turns, student
from softmap_edge.alignment.groups import Groups, Moved, find_motion, small_pose
from softmap_edge.alignment.result import Alignment
from softmap_edge.errors import AlignError
from softmap_edge.geometry.rigid import RigidPose, gain, kabsch, refined, robust
from softmap_edge.noise.noise_model import form_covariance

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


def solve(
    groups: Groups,
    form: Floats,
    section: NDArray[np.int64],
    method: str,
    what: str,
    motion: Callable[[RigidPose], Moved | None] | None = None,
    measured: bool = False,
) -> Alignment:
    """Fit one pose to all groups and one to each, weighted by their information.

    Args:
        groups: points averaged over groups of frames.
        form: model error at places along the body, (S, 3) mm.
        section: place of each point, (N,).
        method: what the alignment is from, in words.
        what: name of the target, for messages.
        motion: returns the motion of the base, given the pose.
        measured: whether the target points were measured one by one, as with a ruler.

    Raises:
        AlignError: fewer than three points, or as for the functions of `checks.py`.
    """
    # A median of frames is 1.25 times as uncertain as their mean.
    sensor = 1.2533 * groups.noise / np.sqrt(np.maximum(groups.count, 1))
    own = np.sqrt((form**2).mean(axis=1))[section]  # (N,) mm a coordinate
    seen = groups.count > 0
    if seen.any(axis=0).sum() < 3:
        raise AlignError(
            "fewer than three points are seen; three that are not on one line give a frame"
        )
    check_scale(groups.source, groups.target, seen, what)
    flat = groups.source.reshape(-1, 3), groups.target.reshape(-1, 3)
    sigma = np.sqrt(sensor**2 + own**2)
    pose, _ = robust(*flat, sigma.ravel(), seen.ravel())
    check_mirror(*flat, sigma.ravel(), seen.ravel(), pose, what)
    tukey = refined(groups.source, groups.target, sigma, seen, pose)[1]
    # Points that wander between visits, as the tip of a robot with play does, locate the base
    # poorly; and points of one place along the body err together, so that many of them count like
    # one.
    wander = _wander(groups, tukey > 0, pose)
    tukey = refined(groups.source, groups.target, np.sqrt(sigma**2 + wander**2), seen, pose)[1]
    together = np.bincount(section, seen.any(axis=0))[section]
    inlier, weight = tukey > 0, tukey / (sensor**2 + together * (own**2 + wander**2))
    pose = kabsch(*flat, weight.ravel())
    residual = np.where(inlier[..., None], pose(groups.source) - groups.target, 0.0)
    left = float(np.sqrt((residual**2).sum() / max(1, inlier.sum())))
    scale = check_scale(groups.source, groups.target, inlier, what, left)
    poses = np.stack([small_pose(groups, g, weight[g], pose) for g in range(len(weight))])
    place = (groups.target * seen[..., None]).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)[:, None]
    answer = gain(place, weight.mean(axis=0))  # (6, N, 3)
    noise = np.einsum("inc,n,jnc->ij", answer, (sensor**2).mean(axis=0), answer)  # of one group
    number = int(np.isfinite(poses).all(axis=1).sum())
    scatter = np.cov(poses[np.isfinite(poses).all(axis=1)].T) if number > 1 else np.zeros((6, 6))
    spread = np.maximum(np.diag(scatter), np.diag(noise))
    shape = (
        _ruler_covariance(answer, residual, inlier)
        if measured
        else _shape_covariance(answer, form, section, residual, inlier)
    )
    variance = student(number - 1) ** 2 * spread / max(1, number) + np.diag(shape)
    check_turns(place[seen.any(axis=0)], np.sqrt(variance[:3]), answer)
    moved = find_motion(poses, noise, groups.t, place, "home")
    notes: list[str] = []
    if motion is not None:
        home, moved = moved, motion(pose)
        if moved is None and home is not None:
            notes.append(
                f"home wanders by {home.farthest_mm:.2f} mm at the far end, the base does not: "
                "creep or play; --base clamped takes the frame from the base alone"
            )
    if moved is not None:
        # which of its places is meant is not known better than they scatter
        variance = variance + spread
    units = np.r_[np.full(3, np.degrees(1.0)), np.ones(3)]
    wrong = [
        int(n)
        for n in np.flatnonzero(seen.any(axis=0) & (inlier.sum(axis=0) < 0.5 * seen.sum(axis=0)))
    ]
    return Alignment(
        pose,
        np.sqrt(variance) * units,
        method,
        number,
        int(groups.count.max(axis=1).sum()),
        int(seen.any(axis=0).sum()),
        wrong,
        left,
        float(groups.noise * np.sqrt(3.0)),
        scale,
        moved,
        notes,
    )


def _wander(groups: Groups, inlier: Mask, pose: RigidPose) -> Floats:
    """Return the scatter (N,) mm a coordinate of points between the groups, after the pose."""
    count = inlier.sum(axis=0)
    left = np.where(inlier[..., None], pose(groups.source) - groups.target, 0.0)
    mean = left.sum(axis=0) / np.maximum(count, 1)[:, None]
    square = np.where(inlier[..., None], (left - mean) ** 2, 0.0).sum(axis=(0, 2)) / 3.0
    return np.asarray(np.sqrt(square / np.maximum(count - 1, 1)))


def _shape_covariance(
    answer: Floats, form: Floats, section: NDArray[np.int64], residual: Floats, inlier: Mask
) -> Floats:
    """Return the covariance (6, 6) by the different shapes of model and robot.

    It is scaled to the error that remains after the pose.
    """
    # (N, 3) mean over the groups
    left = residual.sum(axis=0) / np.maximum(inlier.sum(axis=0), 1)[:, None]
    places = form_covariance(form, np.ones(len(form), bool), np.arange(len(form)))
    onto = np.zeros((len(form), 3, 6))
    np.add.at(onto, section, np.moveaxis(answer, 0, -1))
    expected = float((form[section] ** 2).sum(axis=1)[inlier.any(axis=0)].mean())
    found = float((left**2).sum(axis=1)[inlier.any(axis=0)].mean())
    flat = onto.reshape(-1, 6)
    return np.asarray(found / max(expected, 1e-12) * flat.T @ places @ flat)


def _ruler_covariance(answer: Floats, residual: Floats, inlier: Mask) -> Floats:
    """Return the covariance (6, 6) by places that were measured one by one, from the residual.

    The pose uses six of the 3 N coordinates, so with three or four places the residual shows only a
    small part of their error.
    """
    known = inlier.any(axis=0)
    # (N, 3) mean over the groups
    left = residual.sum(axis=0) / np.maximum(inlier.sum(axis=0), 1)[:, None]
    freedom = max(1, 3 * int(known.sum()) - 6)
    square = student(freedom) ** 2 * float((left[known] ** 2).sum()) / freedom
    return np.asarray(square * np.einsum("inc,jnc->ij", answer[:, known], answer[:, known]))
