"""Find a coordinate that was not measured: points that lie in one plane to the last digit, in every frame.

A planar robot seen by one camera has x and y, and its third coordinate is constant. Motion across that plane is not
measured, so effects there cannot be tested. Noise of a real third coordinate is far larger than `EXACT`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.run import Run

Floats = NDArray[np.float64]
EXACT = 1e-5  # of the extent of the points, RMS: rounding of a number, never noise of a measurement
NEAR_MM = 1e-3  # mm from the origin, within which a plane goes through it
ALONG = 0.999  # cosine from which a normal is an axis
SAMPLE = 20_000  # points that are tested


@dataclass(frozen=True)
class Plane:
    """A plane that holds all points: its `normal` (3,) and its `distance` mm from the origin."""

    normal: Floats
    distance: float

    def __str__(self) -> str:
        axis = int(np.argmax(np.abs(self.normal)))
        plane = "xyz".replace("xyz"[axis], "") + " plane" if abs(self.normal[axis]) > ALONG else "plane"
        across = ", ".join(f"{x + 0.0:.2f}" for x in self.normal)
        where = "through the origin" if self.distance < NEAR_MM else f"{self.distance:.4g} mm from the origin"
        text = f"all points lie in one {plane} {where} (normal {across}): nothing across it was measured"
        if axis == 2 and abs(self.normal[2]) > ALONG:
            text += "; the robot's axis is z by definition, so set frame.axes in the mapping"
        return text


def plane_of(run: Run) -> Plane | None:
    """Return the plane that holds all points of a run; None if they fill space or lie on one line."""
    seen = run.vertices if run.vertices is not None else run.markers
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
