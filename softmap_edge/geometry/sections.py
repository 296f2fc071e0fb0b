"""Features of a shape for fits: centroid and first moments of each section, or the markers.

A frame's features are V 3-vectors, linear in the points: `features = weights @ points`, so that
noise maps exactly. Section s with points p_i at rest angle φ_i about the body's axis gives a
centroid (1/n Σ p_i) and the directions 2/n Σ (cos φ_i − mean) p_i and 2/n Σ (sin φ_i − mean) p_i
(mm: radius times the section's director). A place moves under translation; a direction (weights sum
to zero) only rotates.
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

    `weights` (V, N), `positions` (V,) bool, `section` (V,) int.
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
    """How the points of a template lie along its body at rest, one entry a point.

    `section` (N,) int, base first · `along` (N,) mm from the base · `angle` (N,) rad about the
    centreline, None where the points lie on the centreline themselves, so that a section has a
    place and no direction.
    """

    section: NDArray[np.int64]
    along: Floats
    angle: Floats | None

    @property
    def count(self) -> int:
        """Number of sections."""
        return int(self.section.max()) + 1


def upright(rest: Floats) -> BodyCoordinates:
    """Return how vertices (N, 3) mm of a finger along z lie along it: slices of equal height."""
    return BodyCoordinates(sections_of(rest), rest[:, 2], np.arctan2(rest[:, 1], rest[:, 0]))


def sections_of(rest: Floats, count: int = SECTIONS) -> NDArray[np.int64]:
    """Return the section (N,) of rest vertices (N, 3) mm: `count` equal slices along z."""
    return slices(rest[:, 2], count)


def slices(along: Floats, count: int) -> NDArray[np.int64]:
    """Return which of `count` equal slices of the body each place `along` (N,) mm lies in."""
    low, high = float(along.min()), float(along.max())
    return np.clip(((along - low) / (high - low + 1e-9) * count).astype(np.int64), 0, count - 1)


def section_features(body: BodyCoordinates) -> FeatureMap:
    """Return the centroids and, off the centreline, first moments of each section of a template.

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
    """Return the map for `count` markers: each is a feature of its own."""
    return FeatureMap(np.eye(count), np.ones(count, bool), np.arange(count))


def other_unit(points: Floats, rest: Floats) -> tuple[float, str] | None:
    """Return how many times too large points are, and the unit that explains it; None if in mm.

    Args:
        points: (K, N, 3), NaN where one was not seen. rest: (N, 3) mm, the same points as they
            should be, in any pose.
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
    """Return weights (M, N) that carry `points` (M, 3) mm with a template at `rest` (N, 3) mm.

    Moving least squares, Gaussian about the point, as wide as `REACH` or as far as the template is:
    reproduces every affine motion, so a point off the surface moves with the body around it, and
    far enough that no weight exceeds one. Known limit: the body's strain is carried on outwards; at
    60° of bend a point 8 mm off the surface is 0.7 mm off a rigid stalk, one 20 mm off 1.7 mm.

    `names` of the points are for the message.

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
    """Return section features (K, V, 3) mm of residuals (K, N, 3) mm.

    Only the vertices `seen` (K, N) are known.

    Per frame and section, least squares of the residual on (1, cos φ, sin φ); a section with fewer
    than six seen vertices, or with all of them on one side, is NaN. Bodies without a side have
    means.
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
    """Return the tip's vertices: the 5 % that move most over a sweep (S, N, 3) mm.

    These are the highest if none move.
    """
    movement = np.linalg.norm(vertices - vertices.mean(axis=0), axis=2).mean(axis=0)
    movement = movement if movement.max() > 1e-6 else vertices[0, :, 2]
    count = max(1, round(TIP_SHARE * len(movement)))
    return np.sort(np.argsort(-movement, kind="stable")[:count])
