"""Find the line through the middle of a body from its points alone.

No mesh is needed. The body may have any orientation and may be bent at rest. The order of points
along the body comes from distances over a graph of near neighbours, starting at the base. The line
is a polynomial curve, found by Gauss-Newton: the one whose distances to the points are nearest to a
smooth radius ρ(s). The z axis or a curve of lower degree is preferred if it fits nearly as well. (A
principal curve is only near the points, so it winds along the surface of a tube.) In another shape
of the same points, the line moves linearly with them, by least squares of

    p_i = c(s_i) + a(s_i) ρ_i cos φ_i + b(s_i) ρ_i sin φ_i

with polynomials c, a, b along the body. So points that are unevenly distributed around the line do
not shift it. Units: mm. Limits: the body must be at least some three radii long. Fewer than eight
points are taken as the line itself, in sequence. Pinned by tests/geometry/test_centreline.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from softmap_edge.errors import SoftmapError
from softmap_edge.geometry.sections import SECTIONS, BodyCoordinates, slices

Floats = NDArray[np.float64]

CHAIN = 8  # fewer points than this are a chain of markers
MARKERS = 24  # up to this many points each is a feature of its own
CHORDS = 24  # pieces of the line on which loads are carried
SLIM = 0.01  # of the length: points this close to the line are on it
AS_GOOD = 1.1  # a simpler line is taken if its unevenness is at most this multiple of the least
GRAPH = 1500  # points at most in the graph
NEIGHBOURS = 8
FAR = 0.5  # of the body's extent: if all points are farther from the base, they do not begin there
DEGREE = 8
SIDE_DEGREE = 3
CURVE_DEGREE = 4
RADIUS_DEGREE = 2
ROUNDS = 15
ONE_PLACE = 1e-6  # mm; rounding moves points by less


@dataclass(frozen=True, eq=False)
class Centreline:
    """The centreline of a body at rest, and the linear map from its points to the line's stations.

    Attributes:
        base: place of the base, (3,) mm.
        along: distance of each point from the base along the line, (N,) mm.
        angle: angle of each point about the line, (N,) rad; None if the points are the line.
        arc: arc length of the stations, base first, (J + 1,) mm.
        weights: weight of each point in each station, (J + 1, N).
        fixed: weight of the base in each station, (J + 1,).
        lean_deg: angle between z and the chord from end to end, degrees.
        bow_mm: largest distance of the line from that chord, mm.
    """

    base: Floats
    along: Floats
    angle: Floats | None
    arc: Floats
    weights: Floats
    fixed: Floats
    lean_deg: float
    bow_mm: float

    @property
    def length(self) -> float:
        """Length of the line, mm."""
        return float(self.arc[-1])

    def stations(self, points: Floats) -> Floats:
        """Return the stations (n, J + 1, 3) mm of shapes (n, N, 3) mm."""
        return np.asarray(
            np.einsum("jn,knc->kjc", self.weights, points) + self.fixed[:, None] * self.base
        )

    def body(self) -> BodyCoordinates | None:
        """Return the sections of the body; None if it has so few points that each is a feature."""
        if len(self.along) <= MARKERS:
            return None
        for count in range(SECTIONS, 0, -1):
            section = slices(self.along, count)
            if all(self._seen(section == s) for s in range(count)):
                return BodyCoordinates(section, self.along, self.angle)
        return BodyCoordinates(np.zeros(len(self.along), np.int64), self.along, None)

    def _seen(self, inside: NDArray[np.bool_]) -> bool:
        """Return whether a slice has enough points around the line for its features."""
        if self.angle is None:
            return bool(inside.any())
        around = np.stack([np.cos(self.angle[inside]), np.sin(self.angle[inside])])
        if around.shape[1] < 6:
            return False
        return bool(
            np.linalg.svd(around - around.mean(axis=1, keepdims=True), compute_uv=False)[-1] > 1.0
        )


def find_centreline(rest: Floats, base: Floats) -> Centreline:
    """Find the line through the points of a body at rest.

    Args:
        rest: points of the body, (N, 3) mm.
        base: place where it is clamped, (3,) mm.

    Raises:
        SoftmapError: the points do not begin at the base, or all lie in one place.
    """
    extent = float(np.linalg.norm(np.ptp(rest, axis=0)))
    nearest = float(np.linalg.norm(rest - base, axis=1).min())
    if extent <= ONE_PLACE and nearest <= ONE_PLACE:
        raise SoftmapError(
            "all points of the body at rest lie in one place, at its base; give points along the "
            "body"
        )
    if len(rest) >= CHAIN and nearest > FAR * extent:
        raise SoftmapError(
            f"the nearest point is {nearest:.4g} mm from the base at "
            f"{np.round(base, 3).tolist()}, the points extend over {extent:.4g} mm: they do not "
            "begin at the base; move them to the base frame (origin at the centre of the clamped "
            "base), or give `base` (3,) mm"
        )
    return _chain(rest, base) if len(rest) < CHAIN else _cloud(rest, base)


def _chain(rest: Floats, base: Floats) -> Centreline:
    """Return few points as the line itself, in their order from the base."""
    order, here, left = [], base, list(range(len(rest)))
    while left:
        order.append(min(left, key=lambda i: float(np.linalg.norm(rest[i] - here))))
        here = rest[order[-1]]
        left.remove(order[-1])
    line = np.vstack([base, rest[order]])
    arc = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))]
    if arc[-1] <= 0.0 or np.min(np.diff(arc)[1:], initial=np.inf) <= 0.0:
        raise SoftmapError("two of the points lie in one place at rest; give each marker once")
    if arc[1] <= SLIM * arc[-1]:  # the first marker is the base: it stands still
        arc[1] = 0.0
    along = np.empty(len(rest))
    along[order] = arc[1:]
    weights = np.zeros((len(rest) + 1, len(rest)))
    weights[np.arange(1, len(rest) + 1), order] = 1.0
    fixed = np.r_[1.0, np.zeros(len(rest))]
    return Centreline(base, along, None, arc, weights, fixed, *_posture(line))


def _cloud(rest: Floats, base: Floats) -> Centreline:
    curve = _Curve.best(rest, base)
    along, length = curve.along, float(curve.along.max())
    is_line = curve.radius <= SLIM * length
    arc = np.linspace(0.0, length, CHORDS + 1)
    side, up = curve.side()
    radius, turn = np.hypot(side, up), np.arctan2(up, side)
    distinct = len(np.unique(np.round(along / (0.02 * length))))
    degree, sides = min(DEGREE, distinct), min(SIDE_DEGREE, distinct - 1)
    while not is_line and degree + 1 + 2 * (sides + 1) > 0.8 * len(rest):
        degree, sides = (
            degree - (degree >= sides + 2 or sides == 0),
            max(0, sides - (degree < sides + 2)),
        )
    x = 2.0 * along / length - 1.0
    columns = [legendre.legvander(x, degree)]
    if not is_line:
        wide = legendre.legvander(x, sides)
        columns += [
            wide * (radius * np.cos(turn))[:, None],
            wide * (radius * np.sin(turn))[:, None],
        ]
    design = np.concatenate(columns, axis=1)
    held = np.sqrt(len(rest))  # the base is known better than any point
    pinned = np.zeros((1, design.shape[1]))
    pinned[0, : degree + 1] = legendre.legvander(np.array([-1.0]), degree)[0]
    inverse = np.linalg.pinv(np.vstack([design, held * pinned]), rcond=1e-8)[: degree + 1]
    stations = legendre.legvander(2.0 * arc / length - 1.0, degree) @ inverse
    weights, fixed = np.asarray(stations[:, :-1], float), np.asarray(stations[:, -1] * held, float)
    line = weights @ rest + fixed[:, None] * base
    return Centreline(base, along, None if is_line else turn, arc, weights, fixed, *_posture(line))


def _posture(line: Floats) -> tuple[float, float]:
    """Return the angle (degrees) between z and the chord from end to end, and the bow (mm)."""
    chord = line[-1] - line[0]
    unit = chord / max(float(np.linalg.norm(chord)), 1e-300)
    off = line - line[0]
    bow = np.linalg.norm(off - np.outer(off @ unit, unit), axis=1).max()
    return float(np.degrees(np.arccos(np.clip(unit[2], -1.0, 1.0)))), float(bow)


@dataclass(frozen=True, eq=False)
class _Curve:
    """A dense line with tangents, and the projections of points (N, 3) mm to it.

    `along` (N,) is their distance from the base, `offset` (N, 3) the vector from the line; both in
    mm.
    """

    tangent: Floats  # (N, 3) at each point's foot
    normal: Floats  # (N, 3) carried along the line without twist
    along: Floats
    offset: Floats

    @property
    def radius(self) -> float:
        """RMS distance of the points from the line, mm."""
        return float(np.sqrt(np.mean(np.sum(self.offset**2, axis=1))))

    def side(self) -> tuple[Floats, Floats]:
        """Return each point's offset along the carried normal and across it, (N,) mm each."""
        across = np.cross(self.tangent, self.normal)
        return np.sum(self.offset * self.normal, axis=1), np.sum(self.offset * across, axis=1)

    @classmethod
    def best(cls, rest: Floats, base: Floats) -> _Curve:
        """Return the simplest curve nearly as good as the best: the z axis, or degree 1 to 4."""
        some = rest if len(rest) <= GRAPH else rest[farthest(rest, GRAPH)]
        order = _order(some, base)
        length = float(np.ptp(order))
        distinct = len(np.unique(np.round(_unit(order) * 20.0)))
        top = float(rest[:, 2].max())
        fits = [
            np.array(
                [[*base[:2], (base[2] + top) / 2.0], [0.0, 0.0, max(top - base[2], 1e-9) / 2.0]]
            )
        ]
        fits += [
            _fitted(some, order, degree)
            for degree in range(1, max(1, min(CURVE_DEGREE, distinct - 2)) + 1)
        ]
        scores = [_unevenness(fit, some) for fit in fits]
        level = AS_GOOD * min(scores) + 0.1 * SLIM * length
        return cls._along(
            next(fit for fit, score in zip(fits, scores) if score <= level), rest, base
        )

    @classmethod
    def _along(cls, fit: Floats, rest: Floats, base: Floats) -> _Curve:
        """Project points to a curve."""
        foot, x = _feet(fit, rest)
        line = legendre.legval(SAMPLES, fit).T
        step = np.diff(line, axis=0)
        arc = np.r_[0.0, np.cumsum(np.linalg.norm(step, axis=1))]
        tangents = np.gradient(line, axis=0)
        tangents /= np.maximum(np.linalg.norm(tangents, axis=1, keepdims=True), 1e-300)
        place = _places(x, arc) - _places(_feet(fit, base[None])[1], arc)
        near = np.argmin(np.abs(x[:, None] - SAMPLES), axis=1)
        normals = carried(tangents[None])[0][:, :, 0]
        return cls(tangents[near], normals[near], np.maximum(place, 0.0), rest - foot)


def _fitted(points: Floats, order: Floats, degree: int) -> Floats:
    """Return the curve (degree + 1, 3) with the most even distances to ordered points."""
    fit: Floats = np.asarray(
        np.linalg.lstsq(legendre.legvander(_unit(order), degree), points, rcond=None)[0], float
    )
    score = _unevenness(fit, points)
    for _ in range(ROUNDS):
        foot, x = _feet(fit, points)
        offset = points - foot
        distance = np.linalg.norm(offset, axis=1)
        away = offset / np.maximum(distance, 1e-12)[:, None]
        x = np.clip(x, -1.0, 1.0)
        smooth = legendre.legvander(x, degree)
        moved = (away[:, :, None] * smooth[:, None]).reshape(len(points), -1)
        design = np.concatenate([moved, legendre.legvander(x, RADIUS_DEGREE)], axis=1)
        step = (
            np.linalg.lstsq(design, distance, rcond=1e-4)[0][: 3 * (degree + 1)]
            .reshape(3, degree + 1)
            .T
        )
        for share in (1.0, 0.5, 0.25, 0.1):
            ahead = _unevenness(fit + share * step, points)
            if ahead < 0.999 * score:
                fit, score = fit + share * step, ahead
                break
        else:
            break
    return np.asarray(fit)


def _unevenness(fit: Floats, points: Floats) -> float:
    """Return the RMS deviation (mm) of the points' distances from a smooth radius.

    A small part of the distance itself is added.
    """
    foot, x = _feet(fit, points)
    distance = np.linalg.norm(points - foot, axis=1)
    smooth = legendre.legvander(np.clip(x, -1.0, 1.0), RADIUS_DEGREE)
    rest = distance - smooth @ np.linalg.lstsq(smooth, distance, rcond=None)[0]
    return float(np.sqrt(np.mean(rest**2)) + SLIM * np.sqrt(np.mean(distance**2)))


SAMPLES = np.linspace(-1.0, 1.0, 401)  # at which a curve is sampled


def _unit(s: Floats) -> Floats:
    """Return s scaled to -1…1."""
    return np.asarray(2.0 * (s - s.min()) / max(float(np.ptp(s)), 1e-300) - 1.0)


def _places(x: Floats, arc: Floats) -> Floats:
    """Return places (mm) along a line for arc parameters x in -1…1.

    Beyond its ends, the line continues straight.
    """
    first, last = (
        (arc[1] - arc[0]) / (SAMPLES[1] - SAMPLES[0]),
        (arc[-1] - arc[-2]) / (SAMPLES[-1] - SAMPLES[-2]),
    )
    return np.asarray(
        np.interp(x, SAMPLES, arc)
        + np.minimum(x + 1.0, 0.0) * first
        + np.maximum(x - 1.0, 0.0) * last
    )


def _feet(fit: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Return the nearest places (N, 3) of a curve to points (N, 3), and their x (N,).

    Beyond its ends, the curve continues straight.
    """
    line = legendre.legval(SAMPLES, fit).T
    square = np.sum(points**2, axis=1)[:, None] - 2.0 * points @ line.T + np.sum(line**2, axis=1)
    near = np.argmin(square, axis=1)
    speed = np.gradient(line, SAMPLES, axis=0)[near]
    ahead = np.sum((points - line[near]) * speed, axis=1) / np.maximum(
        np.sum(speed**2, axis=1), 1e-300
    )
    inner = (near > 0) & (near < len(SAMPLES) - 1)
    cell = SAMPLES[1] - SAMPLES[0]
    ahead = np.where(inner, np.clip(ahead, -cell, cell), ahead)
    return line[near] + ahead[:, None] * speed, SAMPLES[near] + ahead


def carried(tangents: Floats) -> Floats:
    """Return frames that are carried without twist along a line.

    Args:
        tangents: unit tangents of n lines, (n, J, 3).

    Returns:
        Floats: rotation matrices (n, J, 3, 3) with the columns normal, binormal and tangent. The
            first normal is x if the tangent is z; otherwise it is rotated with the tangent.
    """
    frames = np.empty((*tangents.shape, 3))
    frame = _turn(np.broadcast_to([0.0, 0.0, 1.0], tangents[:, 0].shape), tangents[:, 0])
    frames[:, 0] = frame
    for j in range(1, tangents.shape[1]):
        frame = _turn(tangents[:, j - 1], tangents[:, j]) @ frame
        frames[:, j] = frame
    return frames


def _turn(start: Floats, end: Floats) -> Floats:
    """Return the smallest rotations (n, 3, 3) from unit vectors `start` to `end` (n, 3)."""
    axis, cosine = np.cross(start, end), np.sum(start * end, axis=1)
    cross = np.zeros((len(start), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        cross[:, j, k], cross[:, k, j] = -axis[:, i], axis[:, i]
    rotation = np.eye(3) + cross + cross @ cross / np.maximum(1.0 + cosine, 1e-9)[:, None, None]
    rotation[cosine < -1.0 + 1e-9] = np.diag([1.0, -1.0, -1.0])  # half a turn: about x
    return np.asarray(rotation)


def _order(points: Floats, base: Floats) -> Floats:
    """Return the distance (N,) mm of points from the base, over a graph of neighbours."""
    apart = distances(points, points)
    near = np.argsort(apart, axis=1)[:, : NEIGHBOURS + 1]
    edges = np.full(apart.shape, np.inf)
    rows = np.arange(len(points))[:, None]
    edges[rows, near] = apart[rows, near]
    edges = np.minimum(edges, edges.T)
    home = np.linalg.norm(points - base, axis=1)
    distance = np.where(home <= 1.1 * home.min() + 1e-9, 0.0, np.inf)
    open_ = np.ones(len(points), bool)
    for _ in range(len(points)):
        best = int(np.argmin(np.where(open_, distance, np.inf)))
        # a gap in the points: cross it where it is narrowest
        if not np.isfinite(distance[best]) or not open_[best]:
            reached = np.flatnonzero(~open_)
            gap = np.where(open_, apart[reached].min(axis=0), np.inf)
            best = int(np.argmin(gap))
            distance[best] = float(np.min(distance[reached] + apart[reached, best]))
        open_[best] = False
        distance = np.where(open_, np.minimum(distance, distance[best] + edges[best]), distance)
    return np.asarray(distance)


def distances(a: Floats, b: Floats) -> Floats:
    """Return the distances (n, m) between points (n, D) and (m, D)."""
    square = np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1) - 2.0 * a @ b.T
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def farthest(points: Floats, count: int) -> NDArray[np.intp]:
    """Return the sorted indices of `count` points (N, D), each the farthest from those before."""
    taken = [int(np.argmin(np.sum((points - points.mean(axis=0)) ** 2, axis=1)))]
    far = np.sum((points - points[taken[0]]) ** 2, axis=1)
    while len(taken) < min(count, len(points)) and far.max() > 0.0:
        taken.append(int(np.argmax(far)))
        far = np.minimum(far, np.sum((points - points[taken[-1]]) ** 2, axis=1))
    return np.sort(np.array(taken))
