"""Average points over groups of frames, fit a pose to each group, and find motion between them.

The motion is the largest displacement of the robot's farthest point between two groups. It counts
if it is far above the noise of the groups and large enough to matter. This noise is sensor noise
and the difference between neighbouring groups. Units: mm, rad, s. Pinned by
tests/alignment/test_align.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.files.atomic import Document
from softmap_edge.geometry.rigid import RigidPose, gain, jacobian, kabsch, refined, rotation
from softmap_edge.run.run import Run

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

GROUP_FRAMES = 3  # least frames of a group
INSTANTS = 120  # groups of time at most in which a motion of the base is looked for
# frames to each side over which poses of the base may be averaged
WINDOWS = (1, 2, 4, 8, 16, 32, 64)
LEVER = 100.0  # mm from the base at which a turn of it is weighed against a shift
MOVED_TURN, MOVED_MM = np.radians(0.25), 0.25  # what a base may do unsaid
MOVED_CHI2 = 50.0  # of six numbers: by chance in one of 10⁸


@dataclass(frozen=True, eq=False)
class Groups:
    """Points averaged over groups of frames.

    Attributes:
        source: measured points, (G, N, 3) mm.
        target: the same points in the base frame, (G, N, 3) mm.
        count: number of frames that show each point, (G, N).
        t: times of the first and last frame, (G, 2) s.
        noise: standard deviation of one coordinate in one frame, mm.
    """

    source: Floats
    target: Floats
    count: NDArray[np.int64]
    t: Floats
    noise: float


@dataclass(frozen=True)
class Moved:
    """A motion of the base or of home within a run.

    Attributes:
        what: "the base" or "home".
        turn_deg: rotation, degrees.
        shift_mm: shift at the origin, mm.
        farthest_mm: displacement of the robot's farthest point, mm.
        from_s: time at which it begins, s.
        to_s: time at which it ends, s.
        gradual: False if more than 60 % of it happens between two neighbouring groups of frames.
    """

    what: str
    turn_deg: float
    shift_mm: float
    farthest_mm: float
    from_s: float
    to_s: float
    gradual: bool

    def to_dict(self) -> Document:
        """Return it as plain numbers and texts."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    def __str__(self) -> str:
        how = "gradually between" if self.gradual else "between"
        text = (
            f"{self.what} MOVED within the run, {how} {self.from_s:.2f} s and {self.to_s:.2f} s: "
            f"by {self.turn_deg:.2f} deg and {self.shift_mm:.2f} mm, {self.farthest_mm:.2f} mm at "
            "the far end"
        )
        if self.what == "home":
            return (
                text + ". The base moved, or the robot did not come home (creep, play); "
                "base markers would distinguish them"
            )
        return (
            text + ". Base markers take it out frame by frame (--follow-base); "
            "or fix the base and record again"
        )


def group(
    run: Run, seen: Floats, visible: Mask, target: Floats, parts: Sequence[NDArray[np.int64]]
) -> Groups:
    """Average each point over each group: the median, which one bad frame hardly changes.

    Args:
        run: its times and declared noise are used.
        seen: measured points, (K, N, 3) mm.
        visible: which points were seen, (K, N).
        target: the same points in the base frame, (K, N, 3) mm.
        parts: the frames of each group.
    """
    shape = (len(parts), seen.shape[1], 3)
    source = np.zeros(shape)
    targets = np.zeros(shape)
    squares = 0.0
    freedom = 0
    count = np.array([visible[frames].sum(axis=0) for frames in parts])
    for g, frames in enumerate(parts):
        look = np.where(visible[frames][..., None], seen[frames], np.nan)
        known = count[g] > 0
        source[g, known] = np.nanmedian(look[:, known], axis=0)
        targets[g, known] = np.nanmean(
            np.where(np.isnan(look), np.nan, target[frames])[:, known], axis=0
        )
        step = np.diff(look, axis=0)
        step = np.abs(step[np.isfinite(step)])
        if len(step):
            squares += len(step) * (float(np.median(step)) / 0.6745) ** 2 / 2.0
            freedom += len(step)
    noise = float(np.sqrt(squares / freedom)) if freedom else 0.0
    if run.sigma is not None:
        noise = max(noise, float(np.median(run.sigma)))
    t = np.array([[run.t_seen[frames[0]], run.t_seen[frames[-1]]] for frames in parts])
    return Groups(source, targets, count, t, max(noise, 1e-6))


def small_pose(groups: Groups, g: int, weight: Floats, pose: RigidPose) -> Floats:
    """Return the small rotation (rad) and shift (mm) of a group against the common pose, (6,).

    It is NaN if fewer than three points of the group have a weight.
    """
    if (weight > 0).sum() < 3:
        return np.full(6, np.nan)
    own = kabsch(groups.source[g], groups.target[g], weight)
    return own.after(pose.inverse()).vector()


def base_motion(
    run: Run, points: Floats, known: Mask, target: Floats, far: Floats, pose: RigidPose
) -> Moved | None:
    """Return the motion of the base within a run; None without one.

    Args:
        run: its times and declared noise are used.
        points: points of the base, (K, B, 3) mm.
        known: which of them were seen, (K, B).
        target: their places in the base frame, (B, 3) mm.
        far: points of the robot, (N, 3) mm, whose farthest displacement is reported.
        pose: near the poses of all groups.
    """
    usable = np.flatnonzero(known.sum(axis=1) >= 3)
    if len(target) < 3 or len(usable) < 2 * GROUP_FRAMES:
        return None
    parts = np.array_split(usable, min(INSTANTS, len(usable) // GROUP_FRAMES))
    groups = group(run, points, known, np.broadcast_to(target, points.shape), parts)
    seen, sigma = groups.count > 0, np.full(len(target), groups.noise)
    weight = refined(groups.source, groups.target, sigma, seen, pose)[1] / groups.noise**2
    poses = np.stack([small_pose(groups, g, weight[g], pose) for g in range(len(parts))])
    good = np.isfinite(poses).all(axis=1)
    poses, t = poses[good], groups.t[good]
    # A marker that is mistaken for another leaves a mark in one group or two; a motion stays.
    around = np.clip(np.arange(len(poses))[:, None] + np.arange(-2, 3), 0, max(len(poses) - 1, 0))
    poses = np.median(poses[around], axis=1)
    answer = gain(target, weight.mean(axis=0))
    variance = 1.57 * groups.noise**2 / np.maximum(groups.count, 1).mean(axis=0)
    noise = np.einsum("inc,n,jnc->ij", answer, variance, answer)
    return find_motion(poses, noise, t, far, "the base")


def find_motion(poses: Floats, noise: Floats, t: Floats, points: Floats, what: str) -> Moved | None:
    """Return the largest displacement between groups of frames; None if it does not matter.

    Args:
        poses: small rotations (rad) and shifts (mm), (G, 6).
        noise: covariance of one pose, (6, 6).
        t: times of the first and last frame of each group, (G, 2) s.
        points: (N, 3) mm, whose farthest displacement is reported.
        what: "the base" or "home".
    """
    known = np.flatnonzero(np.isfinite(poses).all(axis=1))
    if len(known) < 2:
        return None
    poses, t = poses[known], t[known]
    # cameras tremble more slowly than a frame: what neighbours differ by, but for a steady drift
    if len(poses) > 4:
        step = np.diff(poses, axis=0)
        tremble = 1.4826 * np.median(np.abs(step - np.median(step, axis=0)), axis=0) / np.sqrt(2.0)
        noise = noise + np.diag(np.maximum(tremble**2 - np.diag(noise), 0.0))
    delta = poses[None] - poses[:, None]  # (G, G, 6) from a to b
    travel = np.linalg.norm(np.einsum("nci,abi->abnc", jacobian(points), delta), axis=-1).max(
        axis=-1
    )
    scaled = np.linalg.pinv(2.0 * noise + np.diag([1e-12] * 3 + [1e-9] * 3), hermitian=True)
    chi2 = np.einsum("abi,ij,abj->ab", delta, scaled, delta)
    turn, shift = np.linalg.norm(delta[..., :3], axis=-1), np.linalg.norm(delta[..., 3:], axis=-1)
    large = ((turn > MOVED_TURN) | (shift > MOVED_MM)) & (chi2 > MOVED_CHI2)
    if not large.any():
        return None
    pair = np.unravel_index(int(np.argmax(np.where(large, travel, 0.0))), travel.shape)
    a, b = int(min(pair)), int(max(pair))
    steps = np.array([travel[i, i + 1] for i in range(a, b)])
    jump = int(np.argmax(steps))
    gradual = bool(steps[jump] < 0.6 * travel[a, b])
    first, last = (a, b) if gradual else (a + jump, a + jump + 1)
    return Moved(
        what,
        float(np.degrees(turn[a, b])),
        float(shift[a, b]),
        float(travel[a, b]),
        float(t[first].mean()),
        float(t[last].mean()),
        gradual,
    )


def follow(
    points: Floats, known: Mask, target: Floats, noise_mm: float, pose: RigidPose
) -> tuple[RigidPose, str]:
    """Return a pose for each frame, and a sentence on the noise that the poses add.

    The poses are smoothed as far as the motion of the base allows. Frames that show too few points
    use the poses of their neighbours.

    Args:
        points: points of the base, (K, B, 3) mm.
        known: which of them were seen, (K, B).
        target: their places in the base frame, (B, 3) mm.
        noise_mm: noise of one point in one frame, RMS mm.
        pose: near the poses of all frames.
    """
    noise = max(noise_mm / np.sqrt(3.0), 1e-6)
    poses, weight = refined(points, target, np.full(len(target), noise), known, pose)
    index = np.flatnonzero((weight > 0).sum(axis=1) >= 3)
    small = poses.after(pose.inverse()).vector()
    k = np.arange(len(points))
    small = np.stack([np.interp(k, index, small[index, i]) for i in range(6)], axis=1)
    answer = gain(target, np.full(len(target), noise**-2.0))
    one = noise**2 * np.einsum("inc,inc->i", answer, answer)  # (6,) variance of one frame's pose
    half = _window(small, one)
    smooth = _smoothed(small, half)
    every = RigidPose(rotation(smooth[:, :3]), smooth[:, 3:]).after(pose)
    turn = float(np.sqrt(one[:3].sum() / (2 * half + 1)))
    note = (
        f"the base is held still frame by frame, smoothed over {2 * half + 1} frames; that adds "
        "noise of "
    )
    note += f"{np.degrees(turn):.2g} deg, {100 * turn:.2g} mm for each 100 mm from the base"
    gaps = len(points) - len(index)
    note += (
        f"; {gaps} frames showed too few base points and took their neighbours' pose"
        if gaps
        else ""
    )
    return every, note


def _smoothed(small: Floats, half: int) -> Floats:
    """Return the running mean of (K, 6) over `half` frames to each side, fewer at the ends."""
    total = np.concatenate([np.zeros((1, small.shape[1])), np.cumsum(small, axis=0)])
    k = np.arange(len(small))
    reach = np.minimum(np.minimum(k, len(small) - 1 - k), half)
    return np.asarray((total[k + reach + 1] - total[k - reach]) / (2 * reach + 1)[:, None])


def _window(small: Floats, one: Floats) -> int:
    """Return the number of frames per side over which the mean of poses (K, 6) predicts best.

    `one` (6,) is the variance of one frame's pose by sensor noise. It is 0 for a motion that
    neighbours do not predict better than this noise.
    """
    unit = np.array([LEVER] * 3 + [1.0] * 3)
    best, least = 0, 2.0 * float(np.sum(one * unit**2))
    for half in WINDOWS:
        if len(small) < 4 * half + 2:
            break
        mean = (_smoothed(small, half) * (2 * half + 1) - small) / (2 * half)
        error = float(np.mean(np.sum(((small - mean) * unit)[half:-half] ** 2, axis=1)))
        if error < 0.99 * least:
            best, least = half, error
    return best
