"""Motion of the base of a robot, from markers that are fixed to it; it bounds `mount` and `camera_drift`.

    pose_k = argmin Σ |R x + s − b_k|²     base markers b_k on their reference x, about the origin
    moved  = RMS over frames of pose_k less its noise; placed = mean of pose_k, where the reference is another run

If the run was aligned by these markers (`softmap align`), `placed` is the remaining error of that alignment.
Units: mm, deg. Limit: a turn needs three markers that are not on a line. Pinned by tests/test_base_motion.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.alignment.result import base_markers
from softmap_edge.alignment.rigid import kabsch
from softmap_edge.run import Run

Floats = NDArray[np.float64]

LEAST_MARKERS, LEAST_FRAMES = 3, 8
WIDE = 0.05  # of their extent: base markers nearer to one line than this show no turn
SLOW_FRAMES = 20.0  # frames of one mean that count as independent: errors of neighbouring frames are correlated


@dataclass(frozen=True)
class BaseMotion:
    """Motion of the base against a reference, about the origin of the base frame, with one standard deviation.

    `shift_mm`, `turn_deg` (3,) are the mean pose against the reference (another run, or the run's first frames).
    `moved_mm`, `turned_deg` are RMS over the frames about that mean, with the noise subtracted.
    """

    shift_mm: tuple[float, float, float]
    turn_deg: tuple[float, float, float]
    shift_sigma_mm: tuple[float, float, float]
    turn_sigma_deg: tuple[float, float, float]
    moved_mm: float
    turned_deg: float
    frames: int

    def __str__(self) -> str:
        shift, turn = np.linalg.norm(self.shift_mm), np.linalg.norm(self.turn_deg)
        return (
            f"base markers: the base is {shift:.2g} ± {np.linalg.norm(self.shift_sigma_mm):.1g} mm and {turn:.2g} ± "
            f"{np.linalg.norm(self.turn_sigma_deg):.1g}° from its reference, and moves by {self.moved_mm:.2g} mm and "
            f"{self.turned_deg:.2g}° RMS"
        )

    def allows(self, shift_mm: Floats, turn_deg: Floats, sigmas: float = 3.0) -> bool:
        """Return whether a misalignment (3,) mm and (3,) deg lies within so many standard deviations of the markers."""
        off = np.abs(np.r_[np.asarray(shift_mm) - self.shift_mm, np.asarray(turn_deg) - self.turn_deg])
        return bool(np.all(off <= sigmas * np.r_[self.shift_sigma_mm, self.turn_sigma_deg]))


def base_motion(run: Run, reference: Run | None = None) -> BaseMotion | None:
    """Measure the pose and motion of the base of a run; return None if its markers do not show it.

    Args:
        run: a run with `base_markers` (K, B, 3) mm.
        reference: a run with the same markers, for example the one that the model was learned from. None compares with
            the first frames of the run itself.

    Returns:
        BaseMotion: None with fewer than three markers off one line, or fewer than eight frames that show them.

    Raises:
        AlignError: the field has another shape.
    """
    points = _whole(base_markers(run))
    other = points if reference is None else _whole(base_markers(reference))
    if (
        points.shape[1:] != other.shape[1:]
        or points.shape[1] < LEAST_MARKERS
        or min(len(points), len(other)) < LEAST_FRAMES
    ):
        return None
    place = (other[: max(LEAST_FRAMES, len(other) // 10)] if reference is None else other).mean(axis=0)
    size = np.linalg.svd(place - place.mean(axis=0), compute_uv=False)
    if size[1] < WIDE * size[0]:
        return None
    found = kabsch(np.broadcast_to(place, points.shape), points, np.ones(points.shape[:2]))
    poses = found.vector()  # (K, 6) rad, mm
    left = found(np.broadcast_to(place, points.shape)) - points
    freedom = max(1, 3 * points.shape[1] - 6)
    sigma = _sigma(place, np.sqrt(float(np.sum(left**2)) / (freedom * len(points))))
    mean, scatter = poses.mean(axis=0), poses.var(axis=0, ddof=1)
    own = np.maximum(scatter - sigma**2, 0.0)
    error = np.sqrt(scatter / min(len(points), SLOW_FRAMES) + (sigma**2 / min(len(other), SLOW_FRAMES)))
    degrees = np.r_[np.full(3, 180.0 / np.pi), np.ones(3)]
    mean, own, error = mean * degrees, own * degrees**2, error * degrees
    return BaseMotion(
        _three(mean[3:]), _three(mean[:3]), _three(error[3:]), _three(error[:3]),
        float(np.sqrt(own[3:].sum())), float(np.sqrt(own[:3].sum())), len(points),
    )  # fmt: skip


def _whole(points: Floats) -> Floats:
    """Return the frames that show every base marker."""
    return points[np.isfinite(points).all(axis=(1, 2))]


def _sigma(place: Floats, noise: float) -> Floats:
    """Return the standard deviation (6,) of one frame's turn (rad) and shift (mm), from the markers' white noise."""
    x, y, z = place.T
    zero, one = np.zeros(len(place)), np.ones(len(place))
    rows = [
        np.stack([zero, z, -y, one, zero, zero], axis=1),
        np.stack([-z, zero, x, zero, one, zero], axis=1),
        np.stack([y, -x, zero, zero, zero, one], axis=1),
    ]
    columns = np.concatenate(rows)
    return np.asarray(noise * np.sqrt(np.diag(np.linalg.inv(columns.T @ columns))))


def _three(values: Floats) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
