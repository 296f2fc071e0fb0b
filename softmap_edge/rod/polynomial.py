"""The polynomial rod as Python holds it, and its fit: chords whose bending angles are a polynomial of the commands.

    v (rad) ≈ polynomial(q),   length (mm) ≈ quadratic(v),   q = (u_eff − centre)/scale

Its weights are found by ridge regression; penalty: n · ridge · RIDGE[degree of the monomial] on all weights but the
intercept, n frames. Degree and ridge are those with the lowest cross-validation error (`regression.py`).
Known limit: one marker at the end of each chord, base to tip. tests/test_rod.py pins exact recovery.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softmap_edge import _core
from softmap_edge.errors import RunError, SoftmapError
from softmap_edge.model import TIP_PER_NEWTON
from softmap_edge.rod.covered_folds import covered_folds, search_folds
from softmap_edge.rod.memory import FEW_CHANNELS, FRAMES, Memory, find_memory, refined_memory
from softmap_edge.rod.reference_run import Fitted, Seen
from softmap_edge.rod.regression import RIDGE, RIDGE_STEPS, Regression, choose_degree, normalise
from softmap_edge.rod.static_map import StaticMap

Floats = NDArray[np.float64]
Arrays = dict[str, NDArray[np.generic]]

DEGREES = (1, 2, 3)
DEGREES_OF_ONE = (1, 2, 3, 4, 5)  # of a single command: the highest that the frames identify, without a ridge
CUBIC = 3
LEVEL, FAR_BELOW = 1e-6, 20.0  # of the range of markers: a height below this is constant, an output; base of outputs
LOCK = 1.0  # the servos hold, so a load bends each chord into an S and leaves its ends' directions alone


@dataclass(frozen=True, eq=False)
class RodParameters:
    """The numbers of a rod.

    `base` (3,) mm, `centre` and `scale` (C,) in command units, `degree`, `angles` (1 + F, 2K) rad, `lengths` (1 + G, K)
    mm, the nominal `compliance` of its load fields in N⁻¹·mm⁻² and their `lock`: how far the tendons hold each chord's
    mean bending against a load, 0 (not at all) to 1 (motors that hold, tendons that do not stretch).
    """

    base: Floats
    centre: Floats
    scale: Floats
    degree: int
    angles: Floats
    lengths: Floats
    compliance: float
    lock: float = LOCK

    def compiled(self) -> _core.Rod:
        """Return the compiled rod: commands (n, C) to markers (n, 3K) mm."""
        return _core.Rod(self.base, self.centre, self.scale, self.degree, self.angles, self.lengths)

    def fields(self) -> dict[str, _core.RodField]:
        """Return its load fields by name: mm per N of tip force, mm per g for a nominal weight of 1 N."""
        rod = self.compiled()
        return {name: _core.RodField(rod, name, self.compliance, self.lock) for name in _core.LOADS}

    def to_arrays(self) -> Arrays:
        """Return the arrays of `prior.npz`."""
        arrays: Arrays = {name: getattr(self, name) for name in ("base", "centre", "scale", "angles", "lengths")}
        single = {"degree": self.degree, "compliance": self.compliance, "lock": self.lock}
        return arrays | {name: np.array([value]) for name, value in single.items()}

    def __str__(self) -> str:
        """Say in a line what it is."""
        return f"rod of {self.lengths.shape[1]} chords, degree {self.degree}"

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[np.generic]]) -> RodParameters:
        """Read the arrays of `prior.npz`.

        Raises:
            SoftmapError: an array is missing or has the wrong number of axes.
        """
        axes = {"base": 1, "centre": 1, "scale": 1, "angles": 2, "lengths": 2, "degree": 1, "compliance": 1, "lock": 1}
        values: dict[str, Floats] = {}
        for name, ndim in axes.items():
            if name not in arrays or np.ndim(arrays[name]) != ndim:
                got = f"of {np.ndim(arrays[name])} axes" if name in arrays else "missing"
                raise SoftmapError(f"rod: array '{name}' is {got}, expected {ndim} axes; learn the bundle again")
            values[name] = np.ascontiguousarray(arrays[name], float)
        single = {name: values.pop(name).tolist() for name in ("degree", "compliance", "lock")}
        for name, value in single.items():
            if len(value) != 1:
                raise SoftmapError(f"rod: '{name}' holds {len(value)} numbers, expected one; learn the bundle again")
        (degree,), (compliance,), (lock,) = single.values()
        if degree not in range(1, len(RIDGE) + 1):
            raise SoftmapError(f"rod: degree {degree}, expected 1 to {len(RIDGE)}; learn the bundle again")
        return cls(degree=int(degree), compliance=compliance, lock=lock, **values)


def fit_polynomial(
    seen: Seen, blocks: int, gap_s: float, base: ArrayLike | None, degree: int | None, static: bool, seed: int
) -> Fitted:
    """Fit a polynomial rod with its memory: degree and ridge by cross-validation, `static` for no memory."""
    parts, gap_s = covered_folds(seen, blocks, gap_s)
    fit = Regression(seen.markers, _base(base, seen.markers), parts)
    degrees = _degrees(seen, min(len(train) for train, _ in parts), degree)
    memory = Memory()
    if not static:
        step = -(-len(seen.t) // FRAMES)
        memory = _memory(seen, seen.every(step), fit, degrees, seed)
    u = memory.acting(seen.drive)
    ridges = RIDGE_STEPS if seen.drive.channels > 1 else RIDGE_STEPS[:1]
    chosen, ridge = choose_degree(fit, u, degrees, ridges)
    if memory.names:
        memory = refined_memory(memory, seen, StaticMap(_plane(fit), search_folds(seen), chosen, ridge), seed)
        u = memory.acting(seen.drive)
    weights = fit.weights(u, chosen, ridge)
    rod = RodParameters(
        fit.base, weights.centre, weights.scale, chosen, weights.angles, weights.lengths, _nominal(fit.lengths)
    )
    residuals = fit.cross_validate(normalise(u), chosen, ridge)
    return Fitted(rod, memory, residuals, parts, {"degree": chosen, "ridge": ridge, "gap_s": round(gap_s, 6)})


def _degrees(seen: Seen, smallest: int, degree: int | None) -> tuple[int, ...]:
    """Return the degrees that `smallest` frames can identify."""
    channels = seen.drive.channels
    some = DEGREES if channels > 1 else DEGREES_OF_ONE
    degrees = tuple(d for d in (some if degree is None else (degree,)) if 2 * _terms(channels, d) < smallest)
    degrees = degrees if channels > 1 else degrees[-1:]
    if not degrees:
        raise RunError(
            f"{len(seen.t)} usable frames leave {smallest} to learn from outside a block, too few for a polynomial "
            f"of {channels} commands; record longer, use fewer blocks or a smaller gap_s"
        )
    return degrees


def _terms(channels: int, degree: int) -> int:
    return len(_core.monomial_degrees(channels, degree))


def _memory(seen: Seen, thinned: Seen, fit: Regression, degrees: tuple[int, ...], seed: int) -> Memory:
    """Find the memory with the map of the commands alone, or with a richer one for few channels."""
    chosen, _ = choose_degree(fit, seen.drive.commanded, degrees)
    richest = max(d for d in degrees if d <= max(chosen, CUBIC if seen.drive.channels <= FEW_CHANNELS else 1))
    few = Regression(thinned.markers, fit.base, search_folds(thinned))
    return find_memory(thinned, StaticMap(_plane(few), few.folds, richest), seed)


def _plane(fit: Regression) -> Floats:
    """Return chords as plane coordinates (n, 2K) mm: for each marker Σ length × angle over the chords below it."""
    turned = fit.angles.reshape(len(fit.angles), -1, 2) * fit.lengths.mean(axis=0)[:, None]
    return np.asarray(np.cumsum(turned, axis=1).reshape(len(turned), -1))


def _base(base: ArrayLike | None, markers: Floats) -> Floats:
    """Return the point from which the first chord starts: the given one, the origin, or far below an output.

    Markers of constant height are outputs and do not bend: seen from far below, a chord's angle is linear in them.
    """
    if base is None:
        wide = float(np.ptp(markers[..., :2], axis=0).max(initial=0.0))
        level = float(np.ptp(markers[..., 2], axis=0).max(initial=0.0)) < LEVEL * wide
        return np.array([0.0, 0.0, float(markers[0, 0, 2]) - FAR_BELOW * wide if level else 0.0])
    point = np.array(base, float)
    if point.shape != (3,) or not np.all(np.isfinite(point)):
        raise SoftmapError(f"base of shape {point.shape}: expected three finite numbers in mm")
    return point


def _nominal(lengths: Floats) -> float:
    """Return the nominal compliance c (N⁻¹·mm⁻²): 1 N across straight locked chords moves the tip by c·Σ l_k³/12."""
    mean = lengths.mean(axis=0)
    return float(12.0 * TIP_PER_NEWTON * mean.sum() / (mean**3).sum())
