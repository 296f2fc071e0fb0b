"""Predict the response to loads of a body of unknown stiffness.

Its own centreline bends with one compliance.

A load turns every cross-section by its bending moment M(s). With c = 1/(E·I) (N⁻¹·mm⁻², uniform) a
point attached to the line at arc s_i moves, to first order, by

    δp_i = d(s_i) + θ(s_i) × (p_i − r(s_i)),   θ(s) = c ∫₀ˢ m dr,   d(s) = c ∫₀ˢ m × (r(s) − r) dr
        (mm)

M(s) = (r_tip − r(s)) × F for a force F on the tip, and the first moment of the weight beyond s for
a uniform weight. m = [M]⊥ (twist is stiff) minus the part carried by the tendons. Holding motors
keep each tendon's length. So the share `lock` (1: of fixed length, 0: free to slide) of the mean of
m over the body, in frames carried along it without twist, is subtracted. Facts for lock = 1: the
built-in finger moves 3 mm under 20 g at its tip, 3.5 by this formula, 14 with free tendons. The
line consists of chords between stations; the integrand is at most cubic on each, so Simpson's rule
is exact. The same law for a fitted rod, chord by chord: rust/rod/field.rs. Limits: linear in the
load; no axial or shear stiffness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import SoftmapError
from softmap_edge.geometry.centreline import Centreline, carried
from softmap_edge.model.model import TIP_PER_NEWTON

Floats = NDArray[np.float64]

LOCK = 1.0  # default if no load is known
NOMINAL_WEIGHT = 1.0  # N
_SIMPSON = ((0.0, 1.0 / 6.0), (0.5, 4.0 / 6.0), (1.0, 1.0 / 6.0))


@dataclass(frozen=True)
class Stiffness:
    """The scale of the fields: `compliance` N⁻¹·mm⁻², `lock` 0 to 1, own `weight` N, and fit.

    The fit is the agreement with a known load.

    `known` is false for nominal numbers; `residual_mm` RMS remains of the motion `moved_mm` RMS by
    the known load.
    """

    compliance: float
    lock: float
    weight: float
    known: bool
    moved_mm: float = 0.0
    residual_mm: float = 0.0

    @classmethod
    def nominal(cls, line: Centreline) -> Stiffness:
        """Return default values if no load is known.

        1 N then moves the tip of the straight body by a tenth.
        """
        return cls(12.0 * TIP_PER_NEWTON / line.length**2, LOCK, NOMINAL_WEIGHT, False)


def fields(line: Centreline, points: Floats, stiffness: Stiffness) -> dict[str, Floats]:
    """Return displacements (n, N, 3) mm of shapes `points` (n, N, 3) mm by field.

    They are per 1 g of gravity, and per 1 N on the tip.
    """
    found = {}
    for name in _core.LOADS:
        force = np.eye(3)["xyz".index(name[-1])]
        spread = name.startswith("gravity")
        free, held = _answers(line, points, np.broadcast_to(force, (len(points), 3)), spread)
        scale = stiffness.compliance * (stiffness.weight if spread else 1.0)
        found[name] = scale * (free - stiffness.lock * held)
    return found


def weigh(
    line: Centreline,
    unloaded: Floats,
    loaded: Floats,
    force: Floats,
    mass: float,
    own_error_mm: float,
) -> Stiffness:
    """Find compliance and lock from shapes under a known load.

    Args: shapes (L, N, 3) mm without and with the load; `force` (L, 3) N on the tip; `mass` g of
    the body; `own_error_mm` of the unloaded shapes.

    Raises:
        SoftmapError: the load moves the body too little, or against its direction.
    """
    moved = loaded - unloaded
    free, held = _answers(line, unloaded, force, False)
    size = float(np.sqrt(np.mean(np.sum(moved**2, axis=2))))
    if size < 3.0 * own_error_mm:
        raise SoftmapError(
            f"effect size of the known load {size:.3g} mm RMS, error of the unloaded model "
            f"{own_error_mm:.3g} mm; hang on more, in a pose where it bends the body"
        )
    both = np.stack([free.ravel(), -held.ravel()], axis=1)
    (a, b), *_ = np.linalg.lstsq(both, moved.ravel(), rcond=1e-9)
    if not 0.0 <= b <= a:
        fits = []
        for lock in (0.0, 1.0):
            shape = both @ np.array([1.0, lock])
            gain = float(shape @ moved.ravel()) / max(float(shape @ shape), 1e-300)
            fits.append((float(np.sum((moved.ravel() - gain * shape) ** 2)), gain, gain * lock))
        _, a, b = min(fits)
    if a <= 0.0:
        raise SoftmapError(
            "the known load moves the body against its own direction; check `gravity`, `load` (g) "
            "and which shapes are loaded"
        )
    rest = moved.ravel() - both @ np.array([a, b])
    residual = float(np.sqrt(np.sum(rest**2) / (moved.size / 3)))
    return Stiffness(
        float(a), float(b / a), mass * 1e-3 * _core.STANDARD_GRAVITY, True, size, residual
    )


def _answers(
    line: Centreline, points: Floats, force: Floats, spread: bool
) -> tuple[Floats, Floats]:
    """Return displacements (n, N, 3) for c = 1 by free tendons, and the held tendons' part.

    Held tendons subtract that part.

    `force` (n, 3) N acts at the tip, or uniformly over the body with `spread`.
    """
    stations = line.stations(points)
    chord = np.diff(stations, axis=1)  # (n, J, 3)
    length = np.linalg.norm(chord, axis=2)
    tangent = chord / np.maximum(length, 1e-12)[..., None]
    frames = carried(tangent)
    moments = [_moment(stations, chord, length, share, force, spread) for share, _ in _SIMPSON]
    bending = [m - tangent * np.sum(m * tangent, axis=2, keepdims=True) for m in moments]
    inside = np.zeros_like(chord)
    for (_, weight), moment in zip(_SIMPSON, bending):
        inside += weight * length[..., None] * np.einsum("kjab,kja->kjb", frames, moment)
    mean = np.sum(inside, axis=1) / np.sum(length, axis=1)[:, None]
    even = np.einsum("kjab,kb->kja", frames, mean)
    held = [even - tangent * np.sum(even * tangent, axis=2, keepdims=True)] * len(_SIMPSON)
    return moved(line, points, stations, length, bending), moved(
        line, points, stations, length, held
    )


def _moment(
    stations: Floats, chord: Floats, length: Floats, share: float, force: Floats, spread: bool
) -> Floats:
    """Return the moment (n, J, 3) of the load at this share of each chord."""
    at = stations[:, :-1] + share * chord
    if not spread:
        return np.cross(stations[:, -1:] - at, force[:, None])
    middle = stations[:, :-1] + 0.5 * chord
    hanging = (
        np.cumsum((length[..., None] * middle)[:, ::-1], axis=1)[:, ::-1]
        - length[..., None] * middle
    )
    weight = np.cumsum(length[:, ::-1], axis=1)[:, ::-1] - length
    rest = length * (1.0 - share)
    arm = (
        rest[..., None] * (stations[:, :-1] + 0.5 * (1.0 + share) * chord - at)
        + hanging
        - weight[..., None] * at
    )
    return np.cross(arm / np.sum(length, axis=1)[:, None, None], force[:, None])


def moved(
    line: Centreline, points: Floats, stations: Floats, length: Floats, bending: list[Floats]
) -> Floats:
    """Carry the points (n, N, 3) by the bending (n, J, 3) at the nodes of each chord."""
    count = stations.shape[1]
    turn, shift = np.zeros_like(stations), np.zeros_like(stations)
    for j in range(count - 1):
        here, ahead = stations[:, j], stations[:, j + 1]
        turn[:, j + 1] = turn[:, j]
        shift[:, j + 1] = shift[:, j] + np.cross(turn[:, j], ahead - here)
        for (share, part), moment in zip(_SIMPSON, bending):
            more = part * length[:, j, None] * moment[:, j]
            turn[:, j + 1] += more
            shift[:, j + 1] += np.cross(more, (1.0 - share) * (ahead - here))
    after = np.clip(np.searchsorted(line.arc, line.along, side="left"), 1, count - 1)
    low = line.arc[after - 1]
    between = np.clip((line.along - low) / np.maximum(line.arc[after] - low, 1e-12), 0.0, 1.0)[
        :, None
    ]

    def at(values: Floats) -> Floats:
        return np.asarray(values[:, after - 1] * (1.0 - between) + values[:, after] * between)

    return np.asarray(at(shift) + np.cross(at(turn), points - at(stations)))
