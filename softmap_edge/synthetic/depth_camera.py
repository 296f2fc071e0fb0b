"""Depth cameras for hidden effects: clouds of the visible sides of a surface.

Clouds have noise, outliers and gaps.

Points are drawn uniformly over the surface, or more densely towards its end. A point is visible to
a camera if the surface faces it and nothing occludes it (rays, `_core.Surface`). Units: mm.
Randomness only from the generator.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core

Floats = NDArray[np.float64]

FAR, HIGH = 400.0, 60.0  # mm from the finger's axis, and above its base
AROUND = 15.0  # margin of the box of outliers around the finger, mm
DRAWN = 6  # points drawn per required point; half or more are hidden


@dataclass(frozen=True)
class DepthCameras:
    """Cameras around a finger: `views` directions (deg about its axis; none: all points visible).

    `sigma_mm` is the noise per coordinate; `outliers` the share of random points nearby; `uneven`
    the density ratio of end to base; `hole_mm` the radius of a hidden patch about a point drawn for
    each frame.
    """

    views: tuple[float, ...] = (0.0, 90.0)
    points: int = 10_000
    sigma_mm: float = 0.5
    outliers: float = 0.0
    uneven: float = 1.0
    hole_mm: float = 0.0

    def look(
        self, vertices: Floats, triangles: NDArray[np.int32], rng: np.random.Generator
    ) -> Floats:
        """Return the cameras' cloud of a surface (M, 3) mm, M ≤ `points`."""
        seen = self._seen(vertices, triangles, rng)[: self.points]
        if self.hole_mm:
            middle = seen[rng.integers(len(seen))]
            seen = seen[np.linalg.norm(seen - middle, axis=1) > self.hole_mm]
        cloud = seen + self.sigma_mm * rng.normal(size=seen.shape)
        wrong = rng.choice(len(cloud), int(self.outliers * len(cloud)), replace=False)
        low, high = vertices.min(axis=0) - AROUND, vertices.max(axis=0) + AROUND
        cloud[wrong] = rng.uniform(low, high, (len(wrong), 3))
        return cloud

    def _seen(
        self, vertices: Floats, triangles: NDArray[np.int32], rng: np.random.Generator
    ) -> Floats:
        corners = vertices[triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(normals, axis=1)
        normals /= area[:, None]
        height = (corners.mean(axis=1)[:, 2] - vertices[:, 2].min()) / max(
            float(np.ptp(vertices[:, 2])), 1e-9
        )
        weight = area * (1.0 + (self.uneven - 1.0) * height)
        count = self.points * (DRAWN if self.views else 1)
        where = rng.choice(len(triangles), count, p=weight / weight.sum())
        root, other = np.sqrt(rng.random(count)), rng.random(count)
        share = np.stack([1.0 - root, root * (1.0 - other), root * other], axis=1)
        points, out = np.einsum("nc,ncd->nd", share, corners[where]), normals[where]
        if not self.views:
            return np.asarray(points)
        surface, turns = (
            _core.Surface(vertices, np.asarray(triangles).tolist()),
            np.radians(self.views),
        )
        eyes = np.stack(
            [FAR * np.cos(turns), FAR * np.sin(turns), np.full(len(turns), HIGH)], axis=1
        )
        return np.asarray(
            points[np.any([surface.seen(eye.tolist(), points, out) for eye in eyes], axis=0)]
        )


FULL = DepthCameras(views=(), sigma_mm=0.3)
TWO = DepthCameras(outliers=0.05)
HALF = DepthCameras(views=(0.0,))
HARD = DepthCameras(views=(0.0,), sigma_mm=1.0, outliers=0.05, uneven=10.0)
