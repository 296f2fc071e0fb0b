"""Features of a shape for fits: centroid and first moments of each section, or the markers.

A frame's features are V 3-vectors, linear in the points: `features = weights @ points`. So noise is
mapped exactly. Section s with n points p_i at rest angles φ_i about the body's axis gives a
centroid (1/n Σ p_i) and two directions, 2/n Σ (cos φ_i − mean) p_i and 2/n Σ (sin φ_i − mean) p_i,
in mm (radius times the section's director). A place moves with a translation. A direction only
rotates, because its weights sum to zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import SoftmapError

Floats = NDArray[np.float64]
SECTIONS = 9
REACH = 8.0  # mm: about the distance between two rings of vertices
NEGLIGIBLE = 1e-4  # of the largest kernel value
# factors of distances that are in another unit than mm
TIP_SHARE = 0.05  # of the vertices: those that move most
UNITS = {
    1e-3: "metres",
    0.01: "tenths of a metre",
    0.1: "centimetres",
    1 / 25.4: "inches",
    10.0: "tenths of a mm",
}
# of the largest singular value: the least at which mean, cos and sin are distinguished
ALONE = 1e-3
UNIT_FRAMES = 60  # frames used to measure the size of a run's points
NEAR_UNIT = 0.3  # relative deviation from that number allowed for shapes that bend
STALK = 0.25  # of the template's extent: a marker farther away is not on the robot


@dataclass(frozen=True)
class FeatureMap:
    """Linear map from points to features.

    Attributes:
        weights: (V, N).
        positions: which features are places, (V,); the others are directions.
        section: section of each feature, (V,).
    """

    weights: Floats
    positions: NDArray[np.bool_]
    section: NDArray[np.int64]

    def __call__(self, points: Floats) -> Floats:
        """Return the features (..., V, 3) mm of `points` (..., N, 3) mm."""
        return np.asarray(self.weights @ points)

    def matrix(self) -> Floats:
        """Return the map as one matrix (3N, 3V) on flattened coordinates, for `Table.project`."""
        return np.ascontiguousarray(np.kron(self.weights.T, np.eye(3)))


@dataclass(frozen=True, eq=False)
class BodyCoordinates:
    """Coordinates of the points of a template along its body at rest.

    Attributes:
        section: section of each point, base first, (N,).
        along: distance from the base, (N,) mm.
        angle: angle about the centreline, (N,) rad; None if the points lie on the centreline, so
            that a section has a place and no direction.
    """

    section: NDArray[np.int64]
    along: Floats
    angle: Floats | None

    @property
    def count(self) -> int:
        """Number of sections."""
        return int(self.section.max()) + 1


def upright(rest: Floats) -> BodyCoordinates:
    """Return the body coordinates of vertices (N, 3) mm of a finger along z: equal slices."""
    return BodyCoordinates(sections_of(rest), rest[:, 2], np.arctan2(rest[:, 1], rest[:, 0]))


def sections_of(rest: Floats, count: int = SECTIONS) -> NDArray[np.int64]:
    """Return the section (N,) of rest vertices (N, 3) mm: `count` equal slices along z."""
    return slices(rest[:, 2], count)


def slices(along: Floats, count: int) -> NDArray[np.int64]:
    """Return which of `count` equal slices holds each place `along` (N,) mm; (N,)."""
    low, high = float(along.min()), float(along.max())
    return np.clip(((along - low) / (high - low + 1e-9) * count).astype(np.int64), 0, count - 1)


def section_features(body: BodyCoordinates) -> FeatureMap:
    """Return the map from the points of a template to the features of its sections.

    They are centroids and, for points off the centreline, first moments.

    Raises:
        SoftmapError: a section holds no vertex.
    """
    count, points = body.count, len(body.section)
    kinds = 1 if body.angle is None else 3
    weights = np.zeros((kinds * count, points))
    for s in range(count):
        inside = np.flatnonzero(body.section == s)
        n = len(inside)
        if n == 0:
            raise SoftmapError(
                f"section {s} of the {count} slices along the body holds none of the template's "
                f"{points} vertices; a finger has vertices all along"
            )
        weights[s, inside] = 1.0 / n
        if body.angle is not None:
            angle = body.angle[inside]
            for row, basis in ((count + s, np.cos(angle)), (2 * count + s, np.sin(angle))):
                weights[row, inside] = 2.0 / n * (basis - basis.mean())
    return FeatureMap(weights, np.arange(kinds * count) < count, np.tile(np.arange(count), kinds))


def marker_features(count: int) -> FeatureMap:
    """Return the map for `count` markers: each is a feature."""
    return FeatureMap(np.eye(count), np.ones(count, bool), np.arange(count))


def other_unit(points: Floats, rest: Floats) -> tuple[float, str] | None:
    """Return the unit of points that are not in mm.

    Args:
        points: (K, N, 3); NaN where one was not seen.
        rest: the same points in any pose, (N, 3) mm.

    Returns:
        tuple[float, str] | None: size of the points relative to `rest`, and the unit that explains
            it; None if they are in mm.
    """
    usable = np.flatnonzero(np.isfinite(points).all(axis=(1, 2)))
    sample = points[usable[:: max(1, len(usable) // UNIT_FRAMES)]]
    wide = float(rest.std(axis=0).max()) if len(rest) > 1 else 0.0
    if not len(sample) or not wide > 0:
        return None
    # about their middle, so that neither turns nor shifts count; a body that bends into a circle
    # halves it
    ratio = float(np.median(np.sqrt(sample.var(axis=1).sum(axis=1) / rest.var(axis=0).sum())))
    return next(
        ((ratio, name) for factor, name in UNITS.items() if abs(ratio / factor - 1.0) < NEAR_UNIT),
        None,
    )


def attach(points: Floats, rest: Floats, names: Sequence[str] = ()) -> Floats:
    """Return weights that carry points with a template.

    They are moving least squares with a Gaussian kernel about each point. The kernel is as wide as
    `REACH`, or as the distance to the template. Every affine motion is reproduced, so a point off
    the surface moves with the body around it. The width keeps each weight below one.

    Limit: the strain of the body is continued outwards. At 60° of bend, a point 8 mm off the
    surface is 0.7 mm away from its place on a rigid stalk, a point 20 mm off is 1.7 mm away.

    Args:
        points: (M, 3) mm.
        rest: template at rest, (N, 3) mm.
        names: names of the points, for the message.

    Returns:
        Floats: weights (M, N).

    Raises:
        SoftmapError: a point is farther from the template than a quarter of its extent.
    """
    weights = np.zeros((len(points), len(rest)))
    extent = float(np.ptp(rest, axis=0).max())
    for m, point in enumerate(points):
        offset = rest - point
        distance2 = np.einsum("nc,nc->n", offset, offset)
        nearest = float(np.sqrt(distance2.min()))
        if nearest > STALK * extent:
            x, y, z = point
            name = names[m] if names else f"marker {m + 1}"
            raise SoftmapError(
                f"{name} at ({x:.4g}, {y:.4g}, {z:.4g}) mm is {nearest:.3g} mm from the model, "
                f"which is {extent:.3g} mm long; at most {STALK * extent:.3g} mm is carried; give "
                "marker_rest in mm in the base frame, and leave out markers that are not on the "
                "robot"
            )
        width = max(REACH, float(np.sqrt(np.partition(distance2, 3)[3])))
        kernel = np.exp(-distance2 / (2 * width**2))
        near = np.flatnonzero(kernel > NEGLIGIBLE)
        kernel = kernel[near]
        # (n, 4), linear about the point
        basis = np.column_stack([np.ones(len(near)), offset[near]])
        gram = basis.T @ (kernel[:, None] * basis) + 1e-9 * np.diag([0.0, 1.0, 1.0, 1.0])
        weights[m, near] = kernel * (basis @ np.linalg.solve(gram, np.array([1.0, 0.0, 0.0, 0.0])))
    return weights


def seen_residual(residual: Floats, body: BodyCoordinates, seen: NDArray[np.bool_]) -> Floats:
    """Return section features of residuals, from the points that were seen.

    They are least squares of the residual on (1, cos φ, sin φ), for each frame and section. A body
    without angles has means instead.

    Args:
        residual: (K, N, 3) mm.
        body: coordinates of the points along the body.
        seen: which points are known, (K, N).

    Returns:
        Floats: (K, V, 3) mm; NaN for a section with fewer than six seen points, or with all of them
            on one side.
    """
    count, frames = body.count, len(residual)
    known = np.where(seen[..., None], residual, 0.0)
    kinds = 1 if body.angle is None else 3
    features = np.full((frames, kinds * count, 3), np.nan)
    for s in range(count):
        inside = np.flatnonzero(body.section == s)
        weight = seen[:, inside].astype(float)
        if body.angle is None:
            usable = weight.any(axis=1)
            features[usable, s] = (
                known[usable][:, inside].sum(axis=1) / weight[usable].sum(axis=1)[:, None]
            )
            continue
        angle = body.angle[inside]
        basis = np.column_stack([np.ones(len(inside)), np.cos(angle), np.sin(angle)])
        gram = np.einsum("kn,na,nb->kab", weight, basis, basis, optimize=True)
        size = np.linalg.eigvalsh(gram)
        usable = (weight.sum(axis=1) >= 6) & (size[:, 0] > ALONE**2 * size[:, -1])
        right = np.einsum("na,knc->kac", basis, known[usable][:, inside], optimize=True)
        features[usable, s::count] = np.linalg.solve(gram[usable], right)
    return features


def tip_of(vertices: Floats) -> NDArray[np.int64]:
    """Return the vertices of the tip: the 5 % that move most over a sweep (S, N, 3) mm.

    If none move, they are the highest ones.
    """
    movement = np.linalg.norm(vertices - vertices.mean(axis=0), axis=2).mean(axis=0)
    movement = movement if movement.max() > 1e-6 else vertices[0, :, 2]
    count = max(1, round(TIP_SHARE * len(movement)))
    return np.sort(np.argsort(-movement, kind="stable")[:count])
