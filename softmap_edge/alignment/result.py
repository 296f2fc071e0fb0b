"""The result of an alignment as text and document, and the transform of a run to its frame.

Rotations and shifts are small. They are about the axes and the origin of the base frame, as in the
effect `mount`. Units: deg, mm.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from softmap_edge.alignment.groups import Moved
from softmap_edge.errors import AlignError
from softmap_edge.files.atomic import Document
from softmap_edge.geometry.rigid import RigidPose, rotation_vector
from softmap_edge.run.fields import SEEN
from softmap_edge.run.run import BASE_MARKERS, Run

Floats = NDArray[np.float64]

SCHEMA = "softmap.align/1"


@dataclass(frozen=True, eq=False)
class Alignment:
    """A rigid transform p_base = rotation · p_seen + shift; `to_dict()` is softmap.align/1.

    It prints as text.

    Attributes:
        pose: the transform.
        sigma: standard deviations of the rotations about x, y, z of the base frame (deg) and of the
            shifts (mm), (6,).
        method: what it is from, in words.
        groups: number of groups of frames.
        used_frames: number of frames.
        points: number of points.
        wrong_points: numbers of the points that were left out as wrong.
        residual_mm: RMS distance between points and places after the transform, mm.
        noise_mm: noise of a point in one frame, mm.
        scale: ratio of the measured point distances to the right ones.
        moved: motion of the base or of home within the run; None without one.
        notes: remarks, each a sentence.
        frames: a pose for each frame, on request.
    """

    pose: RigidPose
    sigma: Floats
    method: str
    groups: int
    used_frames: int
    points: int
    wrong_points: list[int]
    residual_mm: float
    noise_mm: float
    scale: float
    moved: Moved | None
    notes: list[str] = field(default_factory=list)
    frames: RigidPose | None = None

    def apply(self, run: Run) -> Run:
        """Return the run in the base frame, with transform and sigma as `frame`, `frame_sigma`."""
        return in_frame(run, self.pose, self.sigma, self.frames)

    def to_dict(self) -> Document:
        """Return the document softmap.align/1."""
        turn = np.degrees(rotation_vector(self.pose.rotation))
        return {
            "schema": SCHEMA,
            "method": self.method,
            "groups": self.groups,
            "frames": self.used_frames,
            "points": self.points,
            "wrong_points": self.wrong_points,
            "transform": {
                "rotation": self.pose.rotation.tolist(),
                "turn_deg": turn.tolist(),
                "shift_mm": self.pose.shift.tolist(),
            },
            "sigma": {"turn_deg": self.sigma[:3].tolist(), "shift_mm": self.sigma[3:].tolist()},
            "residual_mm": self.residual_mm,
            "noise_mm": self.noise_mm,
            "scale": self.scale,
            "moved": None if self.moved is None else self.moved.to_dict(),
            "removed_by_frame": self.frames is not None,
            "notes": self.notes,
        }

    def __str__(self) -> str:
        turn, s = np.degrees(rotation_vector(self.pose.rotation)), self.sigma
        wrong = f"; left aside as wrong: {len(self.wrong_points)}" if self.wrong_points else ""
        lines = [
            f"Aligned by {self.method}: {self.used_frames} frames in {self.groups} groups, "
            f"{self.points} points{wrong}",
            f"  {'':<8}{'x':>18}{'y':>18}{'z':>18}",
            "  turned  "
            + "".join(f"{a:10.3f} ± {b:<5.2g}" for a, b in zip(turn, s[:3]))
            + " deg, rotation vector",
            "  shifted "
            + "".join(f"{a:10.3f} ± {b:<5.2g}" for a, b in zip(self.pose.shift, s[3:]))
            + " mm",
            f"  left between points and places {self.residual_mm:.3f} mm RMS; noise of a frame "
            f"{self.noise_mm:.3f} mm",
        ]
        if self.moved is not None:
            lines.append(f"  {self.moved}")
        return "\n".join([*lines, *(f"  {note}" for note in self.notes)])


def in_frame(run: Run, pose: RigidPose, sigma: Floats, frames: RigidPose | None = None) -> Run:
    """Return the run with all that was seen, and all that is on the base, moved by a pose.

    The fields `frame` and `frame_sigma` of the result record it.

    Args:
        run: the run.
        pose: the transform.
        sigma: standard deviations of the pose, (6,), deg and mm.
        frames: a pose for each frame, used for what is seen in it instead of `pose`.
    """
    change: Document = {}
    for name in SEEN:
        seen = run.array(name)
        if seen is not None:
            change[name] = (frames or pose)(seen) if seen.ndim == 3 else pose(seen)
    base = base_markers(run)
    if base.shape[1]:
        change["extra"] = run.extra | {BASE_MARKERS: (frames or pose)(base)}
    # they look from where they stood, at points that have other numbers now
    if run.cameras is not None:
        looking = RigidPose(run.cameras[:, :, :3], run.cameras[:, :, 3]).after(pose.inverse())
        change["cameras"] = np.concatenate([looking.rotation, looking.shift[:, :, None]], axis=2)
    before = (
        RigidPose(np.eye(3), np.zeros(3))
        if run.frame is None
        else RigidPose(run.frame[:, :3], run.frame[:, 3])
    )
    combined = pose.after(before)
    change |= {"frame": np.column_stack([combined.rotation, combined.shift]), "frame_sigma": sigma}
    return dataclasses.replace(run, **change)


def base_markers(run: Run) -> Floats:
    """Return the markers on the base (K, B, 3) mm that an import stored; B = 0 without any.

    Raises:
        AlignError: the field has another shape.
    """
    base = run.extra.get(BASE_MARKERS)
    if base is None:
        return np.zeros((run.frames, 0, 3))
    if (
        base.ndim != 3
        or base.shape[0] != run.frames
        or base.shape[2] != 3
        or base.dtype.kind != "f"
    ):
        raise AlignError(
            f"{BASE_MARKERS}: {base.dtype} of shape {base.shape}, expected ({run.frames}, B, 3) mm"
        )
    return np.asarray(base, float)
