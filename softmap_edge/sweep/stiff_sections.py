"""Predict the shape of an imported sweep's body with a stiffer section.

The prediction follows from the curvature of its own centreline.

Tendons of given shortening fix the total bend of a body. A stiffer section bends less, all others
more, in proportion to their bend. With κ(s) the curvature of the line minus that at rest, in frames
carried along it without twist, and a(s) the change of the logarithm of the modulus,

    δκ(s) = −(a(s) − lock ā) κ(s),   ā = K·∫a κ ds / K·K,   K = ∫κ ds      (rad/mm)

moves the points as in `bending.py`. A uniformly stiffer body does not change. Bending by gravity
counts as bending by tendons. On the bank's tapered rod this explains 76 to 97 % of the squared
shift when hanging, 63 to 96 % at a lean (tests/sweep/test_stretches.py). A curvature at rest has no
such field: it does not act on tendons made for the bent body, those made for the straight one
remove half of it, and shapes do not show the difference. A line does not show sides and twist.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.geometry.centreline import Centreline, carried
from softmap_edge.sweep.bending import moved

Floats = NDArray[np.float64]

NAMES = tuple(name for name in _core.FIELDS if name.removeprefix("stiff_").isdigit())
STRAIGHT = 1e-6  # rad²: a body with less total bend is not bent


def stretch_fields(
    line: Centreline, points: Floats, rest: Floats, lock: float
) -> dict[str, Floats]:
    """Return displacements (n, N, 3) mm of shapes `points` (n, N, 3) mm.

    Displacements are per unit of the logarithm of the modulus.

    Args: `rest` (N, 3) mm; `lock` 1 where tendons keep their length, 0 where they slide.
    Returns: by field, `stiff_0` … from the base to the tip.
    """
    stations = line.stations(points)
    chord = np.diff(stations, axis=1)
    length = np.linalg.norm(chord, axis=2)
    frames, curvature = _curvature(stations)
    curvature = curvature - _curvature(line.stations(rest[None]))[1]
    # At the start, the middle and the end of each chord, as `moved` integrates them by Simpson's
    # rule.
    nodes = [curvature[:, :-1], 0.5 * (curvature[:, :-1] + curvature[:, 1:]), curvature[:, 1:]]
    weights = [part * np.diff(line.arc) for part in (1 / 6, 4 / 6, 1 / 6)]
    total_bend = sum(np.einsum("j,kjb->kb", w, node) for w, node in zip(weights, nodes))
    size = np.maximum(np.sum(total_bend**2, axis=1), STRAIGHT)
    arcs, found = (line.arc[:-1], 0.5 * (line.arc[:-1] + line.arc[1:]), line.arc[1:]), {}
    for k, name in enumerate(NAMES):
        away = [arc / line.length * (len(NAMES) - 1) - k for arc in arcs]
        hats = [np.where(np.abs(a) < 1.0, np.cos(0.5 * np.pi * a) ** 2, 0.0) for a in away]
        part = sum(
            np.einsum("j,kjb->kb", w * hat, node) for w, hat, node in zip(weights, hats, nodes)
        )
        mean = lock * np.sum(total_bend * part, axis=1)[:, None, None] / size[:, None, None]
        bends = [-(hat[:, None] - mean) * node for hat, node in zip(hats, nodes)]
        bending = [np.einsum("kjab,kjb->kja", frames, bend) for bend in bends]
        found[name] = moved(line, points, stations, length, bending)
    return found


def _curvature(stations: Floats) -> tuple[Floats, Floats]:
    """Return the frames (n, J, 3, 3) of the chords, and the curvature (n, J + 1, 3) rad/mm.

    The curvature is in these frames, at the stations.
    """
    chord = np.diff(stations, axis=1)
    length = np.maximum(np.linalg.norm(chord, axis=2), 1e-12)
    tangent = chord / length[..., None]
    frames = carried(tangent)
    if chord.shape[1] < 2:  # one point beyond the base shows no bend
        return frames, np.zeros((len(stations), stations.shape[1], 3))
    turn = np.cross(tangent[:, :-1], tangent[:, 1:])
    sine = np.clip(np.linalg.norm(turn, axis=2), 1e-12, 1.0)
    turn *= (np.arcsin(sine) / sine / (0.5 * (length[:, :-1] + length[:, 1:])))[..., None]
    inside = np.einsum("kjab,kja->kjb", frames[:, :-1], turn)
    return frames, np.concatenate([inside[:, :1], inside, inside[:, -1:]], axis=1)
