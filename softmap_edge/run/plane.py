"""Markers in a plane: the coordinate across it is not measured, predicted or validated.

A run may declare this: its field `plane` holds the axis of the base frame that is not measured
("x", "y" or "z"), and that coordinate is 0. The model's prediction for such a run is 0 there too.
So error and effects across the plane are 0, and this coordinate neither supports nor excludes an
effect. Pinned by tests/run/test_plane.py.

An undeclared run may also lie in one plane to the last digit, in every frame (`plane_of`): a planar
robot seen by one camera, whose third coordinate is constant. Noise of a measured third coordinate
is far larger than `EXACT`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError

if TYPE_CHECKING:
    from softmap_edge.run.run import Run

Array = NDArray[np.float64]

PLANE = "plane"  # the field of a run with the axis that is not measured
AXES = "xyz"
EXACT = 1e-5  # of the extent of the points, RMS: rounding, smaller than any noise
NEAR_MM = 1e-3  # mm from the origin; within it a plane passes through the origin
ALONG = 0.999  # cosine; from here on a normal is parallel to an axis
SAMPLE = 20_000  # points tested at most


def unmeasured(run: Run) -> int | None:
    """Return the axis of the base frame (0, 1, 2) that a run's markers do not measure.

    None if they measure all.

    Raises:
        RunError: the field `plane` is not x, y or z.
    """
    field = run.extra.get(PLANE)
    if field is None or run.markers is None or field.dtype.kind != "U" or field.size != 1:
        return None  # an array of this name is a field of another program
    axis = str(field.reshape(-1)[0])
    if axis not in tuple(AXES):
        raise RunError(
            f'plane: {str(field)[:40]!r}, expected the axis that is not measured: "x", "y" or "z"'
        )
    return AXES.index(axis)


def flat(points: Array, run: Run) -> Array:
    """Return points (..., 3) mm with 0 in the coordinate that a run does not measure.

    They are unchanged if it measures all.
    """
    axis = unmeasured(run)
    if axis is None:
        return points
    points = np.array(points, float)
    points[..., axis] = 0.0
    return points


def unmeasured_parameters(run: Run) -> tuple[str, ...]:
    """Return the parameters of the base's pose that markers in a plane cannot identify."""
    axis = unmeasured(run)
    if axis is None:
        return ()
    return (
        f"mount.shift_{AXES[axis]}",
        *(f"mount.turn_{name}" for name in AXES if name != AXES[axis]),
    )


# --- found in the points -------------------------------------------------------------------
@dataclass(frozen=True)
class Plane:
    """A plane that holds all points: its `normal` (3,) and its `distance` mm from the origin."""

    normal: Array
    distance: float

    def __str__(self) -> str:
        axis = int(np.argmax(np.abs(self.normal)))
        plane = (
            "xyz".replace("xyz"[axis], "") + " plane" if abs(self.normal[axis]) > ALONG else "plane"
        )
        across = ", ".join(f"{x + 0.0:.2f}" for x in self.normal)
        where = (
            "through the origin"
            if self.distance < NEAR_MM
            else f"{self.distance:.4g} mm from the origin"
        )
        text = (
            f"all points lie in one {plane} {where} (normal {across}): nothing across it was "
            "measured"
        )
        if axis == 2 and abs(self.normal[2]) > ALONG:
            text += "; the robot's axis is z by definition, so set frame.axes in the mapping"
        return text


def plane_of(run: Run) -> Plane | None:
    """Return the plane of all points of a run; None if they fill space or lie on one line."""
    seen = run.places
    if seen is None or run.output is not None or not seen.size:
        return None
    points = seen if run.visible is None else seen[run.visible]
    points = points.reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    points = points[:: max(1, len(points) // SAMPLE)]
    if len(points) < 4:
        return None
    middle = points.mean(axis=0)
    _, size, axes = np.linalg.svd(points - middle, full_matrices=False)
    if size[1] <= EXACT * size[0] or size[2] > EXACT * size[0]:
        return None
    normal = axes[2] * np.sign(axes[2][int(np.argmax(np.abs(axes[2])))])
    return Plane(np.asarray(normal), abs(float(middle @ normal)))
