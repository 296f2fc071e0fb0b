"""Rigid transforms between corresponding points: least squares, robust fits, and uncertainty.

    (R, t) = argmin Σ wₙ |R sₙ + t − qₙ|²      Kabsch 1976: SVD of Σ w (s − s̄)(q − q̄)ᵀ with the
                                               determinant set to +1
    J = [−[q]×  I]                             effect of a small rotation (rad) and shift (mm) of
                                               the target frame on a point q
    (Jᵀ W J)⁻¹                                 covariance of these six numbers

A robust fit starts from the triple of points whose pose has the smallest median residual, and
continues with Tukey's biweight. The six numbers of the covariance are those of the effect `mount`,
in the same frame. Units: mm, rad. Limits: three points cannot show an outlier; fewer than half of
the points may be outliers. Pinned by tests/alignment/test_align.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# triples tried at most: one of them is clean with 99.9 % where 30 % of the points are wrong
STARTS = 300
COMPARED = 400  # points on which a start is compared
TUKEY = 6.0  # robust standard deviations beyond which a point's distance counts as wrong
MEDIAN_3D = 1.538  # median length of a vector of three standard normal numbers
ROUNDS = 20
NARROW = 0.2  # of the width of all points: outliers may not take the rest with them


@dataclass(frozen=True, eq=False)
class RigidPose:
    """A rigid motion p = rotation · s + shift, for one set of points or for a batch.

    Attributes:
        rotation: (3, 3), or (B, 3, 3).
        shift: (3,) mm, or (B, 3) mm.
    """

    rotation: Floats
    shift: Floats

    def __call__(self, points: Floats) -> Floats:
        """Return points (..., N, 3) mm in the target frame."""
        return np.asarray(points @ np.swapaxes(self.rotation, -1, -2) + self.shift[..., None, :])

    def after(self, first: RigidPose) -> RigidPose:
        """Return the pose that applies `first`, then this one."""
        turned = np.einsum("...ij,...j->...i", self.rotation, first.shift)
        return RigidPose(self.rotation @ first.rotation, turned + self.shift)

    def inverse(self) -> RigidPose:
        """Return the inverse pose."""
        back = np.swapaxes(self.rotation, -1, -2)
        return RigidPose(back, -np.einsum("...ij,...j->...i", back, self.shift))

    def vector(self) -> Floats:
        """Return the rotation vector (rad) and the shift (mm), (..., 6)."""
        return np.concatenate([rotation_vector(self.rotation), self.shift], axis=-1)


def rotation(vector: Floats) -> Floats:
    """Return the rotation matrices (..., 3, 3) of rotation vectors (..., 3) rad (Rodrigues)."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    cross = _cross(np.asarray(vector, float))
    first, second = np.sinc(angle / np.pi), 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    return np.asarray(np.eye(3) + first * cross + second * (cross @ cross))


def rotation_vector(matrix: Floats) -> Floats:
    """Return the rotation vectors (..., 3) rad of rotation matrices (..., 3, 3).

    They are computed from quaternions, which are exact up to a half turn.
    """
    m = np.asarray(matrix, float)
    k = np.empty((*m.shape[:-2], 4, 4))
    k[..., :3, :3] = (
        m + np.swapaxes(m, -1, -2) - np.trace(m, axis1=-2, axis2=-1)[..., None, None] * np.eye(3)
    )
    k[..., :3, 3] = np.stack(
        [m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]],
        axis=-1,
    )
    k[..., 3, :3] = k[..., :3, 3]
    k[..., 3, 3] = np.trace(m, axis1=-2, axis2=-1)
    q = np.linalg.eigh(k)[1][..., -1]
    q = q * np.where(q[..., 3:] < 0, -1.0, 1.0)
    length = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(length, q[..., 3:])
    return np.asarray(
        np.where(length > 0, angle / np.where(length > 0, length, 1.0), 2.0) * q[..., :3]
    )


def kabsch(source: Floats, target: Floats, weight: Floats) -> RigidPose:
    """Return the weighted least-squares pose of one set of points onto another.

    Args:
        source: (..., N, 3) mm.
        target: corresponding points, (..., N, 3) mm.
        weight: (..., N).
    """
    share = (weight / np.maximum(weight.sum(axis=-1, keepdims=True), 1e-300))[..., None]
    from_, to = (share * source).sum(axis=-2), (share * target).sum(axis=-2)
    mixed = np.swapaxes(share * (source - from_[..., None, :]), -1, -2) @ (
        target - to[..., None, :]
    )
    left, _, right = np.linalg.svd(mixed)
    flip = np.ones(mixed.shape[:-1])
    flip[..., 2] = np.sign(np.linalg.det(left) * np.linalg.det(right))
    turn = np.swapaxes(left * flip[..., None, :] @ right, -1, -2)
    return RigidPose(turn, to - np.einsum("...ij,...j->...i", turn, from_))


def robust(source: Floats, target: Floats, sigma: Floats, seen: Mask) -> tuple[RigidPose, Mask]:
    """Return the pose of corresponding points without outliers.

    Args:
        source: (N, 3) mm.
        target: corresponding points, (N, 3) mm.
        sigma: expected standard deviation of a coordinate, (N,) mm.
        seen: which points are known, (N,).

    Returns:
        tuple[RigidPose, Mask]: the pose, and the points (N,) that it is from.
    """
    scale = np.maximum(sigma, 1e-9)
    start = kabsch(source, target, np.where(seen, scale**-2, 0.0))
    if seen.sum() > 3:
        start = _best_start(source[seen], target[seen], scale[seen], start)
    poses, weight = refined(source[None], target, scale, seen[None], start)
    kept = weight[0] > 0
    if _width(target[kept]) < NARROW * _width(
        target[seen]
    ):  # what is left is a line: the points left aside held the turn
        return kabsch(source, target, np.where(seen, scale**-2, 0.0)), seen
    return RigidPose(poses.rotation[0], poses.shift[0]), kept


def _width(points: Floats) -> float:
    """Return the spread of points (N, 3) mm across their longest direction, RMS mm."""
    if len(points) < 2:
        return 0.0
    return float(
        np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(points))
    )


def refined(
    source: Floats, target: Floats, sigma: Floats, seen: Mask, start: RigidPose
) -> tuple[RigidPose, Floats]:
    """Return the pose of each set of points, refined from a pose near all of them.

    Sets of three points or fewer are used without weights.

    Args:
        source: (B, N, 3) mm.
        target: corresponding points, (N, 3) or (B, N, 3) mm.
        sigma: expected standard deviation of a coordinate, (N,) or (B, N) mm.
        seen: which points are known, (B, N).
        start: one pose, near those of all sets.

    Returns:
        tuple[RigidPose, Floats]: the poses, and Tukey's weights of the points (B, N).
    """
    scale = np.broadcast_to(np.maximum(sigma, 1e-9), seen.shape)
    clean, aim = np.where(seen[..., None], source, 0.0), np.broadcast_to(target, source.shape)
    weighted = seen.sum(axis=1) > 3
    poses = RigidPose(
        np.tile(start.rotation, (len(clean), 1, 1)), np.tile(start.shift, (len(clean), 1))
    )
    weight = seen.astype(float)
    for _ in range(ROUNDS):
        distance = np.where(seen, np.linalg.norm(poses(clean) - aim, axis=-1) / scale, np.nan)
        weight = np.where(weighted[:, None], _biweight(distance), seen)
        before, poses = poses, kabsch(clean, aim, weight / scale**2)
        if (
            max(
                np.abs(poses.rotation - before.rotation).max(),
                np.abs(poses.shift - before.shift).max(),
            )
            < 1e-9
        ):
            break
    return poses, weight


def jacobian(points: Floats) -> Floats:
    """Return the effect (N, 3, 6) of a small rotation (rad) and shift (mm) on points (N, 3) mm."""
    return np.concatenate(
        [-_cross(points), np.broadcast_to(np.eye(3), (len(points), 3, 3))], axis=-1
    )


def gain(points: Floats, weight: Floats) -> Floats:
    """Return the change of the weighted pose per displacement of its target points.

    It holds for small displacements.

    Args:
        points: (N, 3) mm.
        weight: (N,).

    Returns:
        Floats: (6, N, 3), rotations first (rad per mm), then shifts (mm per mm).
    """
    j = jacobian(points)
    information = np.einsum("n,nci,ncj->ij", weight, j, j)
    # rad and mm in comparable units, for the pseudo-inverse
    length = np.array([1.0] * 3 + [100.0] * 3)
    inverse = np.linalg.pinv(information * np.outer(length, length), rcond=1e-12) * np.outer(
        length, length
    )
    return np.asarray(np.einsum("ij,n,ncj->inc", inverse, weight, j))


def _best_start(s: Floats, q: Floats, scale: Floats, start: RigidPose) -> RigidPose:
    """Return the pose with the smallest median distance: of a triple of points, or of all."""
    count = len(s)
    if count * (count - 1) * (count - 2) // 6 <= STARTS:
        triples = np.array(list(combinations(range(count), 3)))
    else:
        rng = np.random.default_rng(0)
        triples = np.stack([rng.choice(count, 3, replace=False) for _ in range(STARTS)])
    poses = kabsch(s[triples], q[triples], np.ones(triples.shape))
    every = RigidPose(
        np.concatenate([start.rotation[None], poses.rotation]),
        np.concatenate([start.shift[None], poses.shift]),
    )
    some = slice(None, None, 1 + count // COMPARED)
    median = np.median(
        np.linalg.norm(every(s[None, some]) - q[some], axis=-1) / scale[some], axis=-1
    )
    best = int(np.argmin(median))
    return RigidPose(every.rotation[best], every.shift[best])


def _biweight(distance: Floats) -> Floats:
    """Return Tukey's weights (B, N) of distances in standard deviations; NaN has the weight 0."""
    known = np.isfinite(distance)
    rows = np.where(np.any(known, axis=1, keepdims=True), distance, 0.0)
    spread = np.maximum(np.nanmedian(rows, axis=1, keepdims=True) / MEDIAN_3D, 1.0)
    ratio = np.where(known, distance, np.inf) / (TUKEY * spread)
    return np.where(ratio < 1.0, (1.0 - np.minimum(ratio, 1.0) ** 2) ** 2, 0.0)


def _cross(v: Floats) -> Floats:
    """Return the matrices (..., 3, 3) of v × · for vectors v (..., 3)."""
    zero = np.zeros(v.shape[:-1])
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    rows = [np.stack(row, axis=-1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))]
    return np.stack(rows, axis=-2)
