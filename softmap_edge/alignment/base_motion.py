"""Motion of a robot's base, from markers fixed to it; it bounds `mount` and `camera_drift`.

    pose_k = argmin Σ |R x + s − b_k|²     base markers b_k against their reference x, about the
                                           origin
    moved  = RMS over frames of pose_k, without its noise
    placed = mean of pose_k, if the reference is another run

If the run was aligned by these markers (`softmap run align`), `placed` is the remaining error of
that alignment. In a diagnosis the reference is an earlier run (`--reference`), or the place that
`softmap learn` stored in `made_from`. The parameters of `mount` are then fitted within SIGMAS of
the measured pose. `mount` and `camera_drift` are not candidates if the markers show that the base
cannot have moved the body visibly. A place that repeats to the last digit in all frames was not
measured in them (a log of tip minus base, a typed place), so it bounds nothing. Units: mm, deg.
Limit: a rotation needs three markers that are not on a line. Pinned by
tests/alignment/test_base_motion.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.alignment.result import base_markers
from softmap_edge.files.atomic import Document, finite
from softmap_edge.geometry.rigid import kabsch
from softmap_edge.model.parameter_layout import Layout
from softmap_edge.run.run import Run, as_runs

if TYPE_CHECKING:
    from softmap_edge.model.model import Model

Floats = NDArray[np.float64]

# the entry of `made_from` that keeps where a learned model's base markers were
PLACES = "base_markers_mm"
FRAME = tuple(f"mount.{kind}_{axis}" for kind in ("turn", "shift") for axis in "xyz")
SIGMAS = 3.0  # standard deviations within which the markers allow a pose of the base
MOST_MARKERS = 64
LEAST_MARKERS, LEAST_FRAMES = 3, 8
WIDE = 0.05  # of their extent: base markers nearer to one line than this show no turn
# frames of one mean that count as independent: errors of neighbouring frames are correlated
SLOW_FRAMES = 20.0


def moved_at(shift_mm: float, turn_deg: float, reach_mm: float) -> float:
    """Return the largest motion (mm) of a point, `reach_mm` from the origin, by a base motion."""
    return float(shift_mm + np.radians(turn_deg) * reach_mm)


@dataclass(frozen=True)
class BaseMotion:
    """Motion of the base against a reference, about the origin of the base frame.

    The reference is another run, or the first frames of the run.

    Attributes:
        shift_mm: mean shift along x, y, z, mm.
        turn_deg: mean rotation vector, degrees.
        shift_sigma_mm: standard deviation of the shift, mm.
        turn_sigma_deg: standard deviation of the rotation, degrees.
        moved_mm: RMS shift over the frames about the mean, without the noise, mm.
        turned_deg: RMS rotation over the frames about the mean, without the noise, degrees.
        frames: number of frames that show all base markers.
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
            f"base markers: the base is {shift:.2g} ± {np.linalg.norm(self.shift_sigma_mm):.1g} "
            f"mm and {turn:.2g} ± {np.linalg.norm(self.turn_sigma_deg):.1g}° from its reference, "
            f"and moves by {self.moved_mm:.2g} mm and {self.turned_deg:.2g}° RMS"
        )

    def at_rest(self, reach_mm: float) -> float:
        """Return how far (mm) a base at its reference may still move the body.

        It is infinite if the markers show that the base moved.

        Args:
            reach_mm: distance of the farthest point of the body from the origin, mm.
        """
        if not self.allows(np.zeros(3), np.zeros(3)):
            return float(np.inf)
        shift, turn = np.linalg.norm(self.shift_sigma_mm), np.linalg.norm(self.turn_sigma_deg)
        return SIGMAS * moved_at(float(shift), float(turn), reach_mm)

    def interval(self) -> tuple[Floats, Floats]:
        """Return the lowest and highest rotation (deg) and shift (mm) that the markers allow.

        Both are (6,), in the order of FRAME.
        """
        pose, sigma = (
            np.r_[self.turn_deg, self.shift_mm],
            np.r_[self.turn_sigma_deg, self.shift_sigma_mm],
        )
        return pose - SIGMAS * sigma, pose + SIGMAS * sigma

    def allows(self, shift_mm: Floats, turn_deg: Floats, sigmas: float = SIGMAS) -> bool:
        """Return whether a misalignment lies within a number of standard deviations of the markers.

        Args:
            shift_mm: (3,) mm.
            turn_deg: rotation vector, (3,) degrees.
            sigmas: number of standard deviations.
        """
        off = np.abs(
            np.r_[np.asarray(shift_mm) - self.shift_mm, np.asarray(turn_deg) - self.turn_deg]
        )
        return bool(np.all(off <= sigmas * np.r_[self.shift_sigma_mm, self.turn_sigma_deg]))


def base_motion(run: Run, reference: Run | None = None) -> BaseMotion | None:
    """Measure the pose and motion of the base of a run.

    Args:
        run: a run with `base_markers`, (K, B, 3) mm.
        reference: a run with the same markers, for example the one that the model was learned from.
            None compares with the first frames of the run.

    Returns:
        BaseMotion | None: None if fewer than eight frames show three markers that are not on a
            line, or if a marker is at one place to the last digit in all of them.

    Raises:
        AlignError: the field has another shape.
    """
    points = _complete(base_markers(run))
    if reference is None:
        begin = points[: max(LEAST_FRAMES, len(points) // 10)]
        return (
            _measured(points, begin.mean(axis=0), len(points))
            if len(points) >= LEAST_FRAMES
            else None
        )
    other = _complete(base_markers(reference))
    known = len(other) >= LEAST_FRAMES and not _constant(other)
    return _measured(points, other.mean(axis=0), len(other)) if known else None


def _measured(points: Floats, place: Floats, count: int) -> BaseMotion | None:
    """Measure base markers (K, B, 3) mm against `place` (B, 3) mm, the mean over `count` frames."""
    if (
        points.shape[1:] != place.shape
        or points.shape[1] < LEAST_MARKERS
        or len(points) < LEAST_FRAMES
        or _constant(points)
    ):
        return None
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
    error = np.sqrt(scatter / min(len(points), SLOW_FRAMES) + (sigma**2 / min(count, SLOW_FRAMES)))
    degrees = np.r_[np.full(3, 180.0 / np.pi), np.ones(3)]
    mean, own, error = mean * degrees, own * degrees**2, error * degrees
    return BaseMotion(
        _three(mean[3:]),
        _three(mean[:3]),
        _three(error[3:]),
        _three(error[:3]),
        float(np.sqrt(own[3:].sum())),
        float(np.sqrt(own[:3].sum())),
        len(points),
    )


# --- what they allow in a diagnosis ---------------------------------------------------------------


def kept_places(runs: Sequence[Run]) -> Document:
    """Return the places of the first run's base markers, for `made_from` of a model; or {}."""
    points = _complete(base_markers(runs[0]))
    if points.shape[1] < LEAST_MARKERS or len(points) < LEAST_FRAMES or _constant(points):
        return {}
    return {PLACES: np.round(points.mean(axis=0), 4).tolist()}


def base_of(
    model: Model, run: Run, reference: Run | Sequence[Run] | None = None
) -> BaseMotion | None:
    """Return the pose of a run's base against the reference, or else the runs of the model.

    Args:
        model: its `made_from` holds the places of base markers.
        run: the run.
        reference: an earlier run, or None. With several, the result is None.
    """
    if reference is not None:
        several = as_runs(reference)
        return base_motion(run, several[0]) if len(several) == 1 else None
    place = _place(model.made_from)
    return (
        None if place is None else _measured(_complete(base_markers(run)), place, int(SLOW_FRAMES))
    )


def bounded(layout: Layout, bases: Sequence[BaseMotion | None]) -> Layout:
    """Return a layout in which base markers bound the `mount` of each run."""
    low, high, limit = layout.low.copy(), layout.high.copy(), layout.limit.copy()
    start = layout.start.copy()
    for number, base in enumerate(bases, 1):
        if base is None:
            continue
        names = [label if number == 1 else f"{label}@{number}" for label in FRAME]
        for name, least, most in zip(names, *base.interval()):
            if name in layout.labels:
                i = layout.labels.index(name)
                low[i], high[i] = min(0.0, max(low[i], least)), max(0.0, min(high[i], most))
                limit[i], start[i] = high[i], np.clip(start[i], low[i], high[i])
    return replace(layout, low=low, high=high, limit=limit, start=start)


def excluded(
    runs: Sequence[Run], bases: Sequence[BaseMotion | None], reach_mm: float, least_mm: float
) -> dict[str, str]:
    """Return the frame effects that base markers exclude, and why.

    Args:
        runs: the runs.
        bases: pose of the base in each run against its reference.
        reach_mm: distance of the farthest point of the body from the origin, mm.
        least_mm: least displacement of the body that counts, mm.

    Returns:
        dict[str, str]: the reason, by effect.
    """
    found = {}
    at_rest = [base for base in bases if base is not None and base.at_rest(reach_mm) < least_mm]
    if len(at_rest) == len(runs):
        found["mount"] = f"a mount of {least_mm:.2g} mm at the body is excluded; {at_rest[0]}"
    own = [base_motion(run) for run in runs]
    still = [
        b for b in own if b is not None and moved_at(b.moved_mm, b.turned_deg, reach_mm) < least_mm
    ]
    if len(still) == len(runs):
        moved = f"{still[0].moved_mm:.2g} mm and {still[0].turned_deg:.2g}° RMS"
        found["camera_drift"] = (
            f"camera_drift is excluded; base markers: the base moves by {moved} during the run"
        )
    return found


def _place(made_from: Mapping[str, object]) -> Floats | None:
    """Return the places (B, 3) mm of base markers in a manifest; None without a valid table."""
    kept = made_from.get(PLACES)
    if not isinstance(kept, list) or not LEAST_MARKERS <= len(kept) <= MOST_MARKERS:
        return None
    rows = [row for row in kept if isinstance(row, list) and len(row) == 3]
    if len(rows) < len(kept) or not all(finite(x, 1e6) for row in rows for x in row):
        return None
    return np.array(rows, float)


def _complete(points: Floats) -> Floats:
    """Return the frames that show every base marker."""
    return points[np.isfinite(points).all(axis=(1, 2))]


def _constant(points: Floats) -> bool:
    """Return whether a marker of (K, B, 3) is at one place to the last digit in all frames."""
    return bool((points == points[:1]).all(axis=(0, 2)).any())


def _sigma(place: Floats, noise: float) -> Floats:
    """Return the standard deviation (6,) of one frame's rotation (rad) and shift (mm).

    It follows from the markers' white noise (mm).
    """
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
