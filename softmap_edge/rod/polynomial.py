"""The polynomial rod as Python holds it, and its fit: chords whose bending angles are a polynomial of the commands.

    v (rad) ≈ polynomial(q),   length (mm) ≈ quadratic(v),   q = (u_eff − centre)/scale

Where a command pulls one cable above 0 and another one below, v may be a polynomial of max(q, 0) and max(−q, 0): a
cable that falls slack puts a kink there. Weights are found by ridge regression; penalty: n · ridge · RIDGE[degree of
the monomial] on all weights but the intercept, n frames. Basis and ridge are those with the lowest cross-validation
error (`regression.py`).
Known limit: one marker at the end of each chord, base to tip. tests/test_rod.py and tests/test_pulled_rod.py pin exact
recovery.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softmap_edge import _core
from softmap_edge.errors import RunError, SoftmapError
from softmap_edge.model.model import TIP_PER_NEWTON
from softmap_edge.rod.covered_folds import covered_folds, search_folds
from softmap_edge.rod.memory import FEW_CHANNELS, FRAMES, Memory, find_memory, refined_memory
from softmap_edge.rod.reference_run import Fitted, Seen
from softmap_edge.rod.regression import (
    RIDGE,
    RIDGE_STEPS,
    SPLINE_DEGREE,
    SQUARES,
    Basis,
    Regression,
    Weights,
    choose_basis,
    compiled,
)
from softmap_edge.rod.static_map import StaticMap
from softmap_edge.run.folds import Folds

Floats = NDArray[np.float64]
Arrays = dict[str, NDArray[np.generic]]

DEGREES = (1, 2, 3)
DEGREES_OF_ONE = (1, 2, 3, 4, 5)  # of a single command: the highest that the frames identify, without a ridge
CUBIC = 3
INTERVALS, MOST_INTERVALS = 8, 64  # of splines: eight make (8 + 3)² = 121 terms of two commands
SPLINED_CHANNELS = 2  # up to here splines are tried; of three commands they would have 1331 terms
LEVEL, FAR_BELOW = 1e-6, 20.0  # of the range of markers: a height below this is constant, an output; base of outputs
LOCK = 1.0  # the servos hold, so a load bends each chord into an S and leaves its ends' directions alone


@dataclass(frozen=True, eq=False)
class RodParameters:
    """The numbers of a rod.

    `base` (3,) mm, `centre` and `scale` (C,) in command units, `degree`, `angles` (1 + F, 2K) rad, `lengths` (1 + G, K)
    mm, the nominal `compliance` of its load fields in N⁻¹·mm⁻² and their `lock`: how far the tendons hold each chord's
    mean bending against a load, 0 (not at all) to 1 (motors that hold, tendons that do not stretch). `pulled` says that
    the polynomial is one of the pulls of two cables a command; with `intervals` it is a sum of splines of so many.
    """

    base: Floats
    centre: Floats
    scale: Floats
    degree: int
    angles: Floats
    lengths: Floats
    compliance: float
    lock: float = LOCK
    pulled: bool = False
    intervals: int = 0

    @property
    def basis(self) -> Basis:
        """The terms of its map."""
        return Basis(self.degree, self.pulled, self.intervals)

    def compiled(self) -> _core.Rod:
        """Return the compiled rod: commands (n, C) to markers (n, 3K) mm."""
        return compiled(Weights(self.centre, self.scale, self.angles, self.lengths), self.base, self.basis)

    def fields(self) -> dict[str, _core.RodField]:
        """Return its load fields by name: mm per N of tip force, mm per g for a nominal weight of 1 N."""
        rod = self.compiled()
        return {name: _core.RodField(rod, name, self.compliance, self.lock) for name in _core.LOADS}

    def to_arrays(self) -> Arrays:
        """Return the arrays of `prior.npz`."""
        arrays: Arrays = {name: getattr(self, name) for name in ("base", "centre", "scale", "angles", "lengths")}
        single = {name: getattr(self, name) for name in ("degree", "compliance", "lock", "pulled", "intervals")}
        return arrays | {name: np.array([value]) for name, value in single.items()}

    def __str__(self) -> str:
        """Say in a line what it is."""
        return f"rod of {self.lengths.shape[1]} chords, {self.basis}"

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[np.generic]]) -> RodParameters:
        """Read the arrays of `prior.npz`.

        Raises:
            SoftmapError: an array is missing or has the wrong number of axes.
        """
        axes = {"base": 1, "centre": 1, "scale": 1, "angles": 2, "lengths": 2, "degree": 1, "compliance": 1, "lock": 1}
        axes |= {name: 1 for name in ("pulled", "intervals") if name in arrays}  # earlier versions have none
        values: dict[str, Floats] = {}
        for name, ndim in axes.items():
            if name not in arrays or np.ndim(arrays[name]) != ndim:
                got = f"of {np.ndim(arrays[name])} axes" if name in arrays else "missing"
                raise SoftmapError(f"rod: array '{name}' is {got}, expected {ndim} axes; learn the bundle again")
            values[name] = np.ascontiguousarray(arrays[name], float)
        single = {name: values.pop(name).tolist() for name in ("degree", "compliance", "lock")}
        single |= {name: values.pop(name, np.zeros(1)).tolist() for name in ("pulled", "intervals")}
        for name, value in single.items():
            if len(value) != 1:
                raise SoftmapError(f"rod: '{name}' holds {len(value)} numbers, expected one; learn the bundle again")
        (degree,), (compliance,), (lock,), (pulled,), (intervals,) = single.values()
        if not 0 <= intervals <= MOST_INTERVALS or intervals % 1:
            raise SoftmapError(f"rod: {intervals:g} intervals, expected 0 to {MOST_INTERVALS}; learn the bundle again")
        if degree not in range(1, len(RIDGE) + 1):
            raise SoftmapError(f"rod: degree {degree}, expected 1 to {len(RIDGE)}; learn the bundle again")
        return cls(
            degree=int(degree),
            compliance=compliance,
            lock=lock,
            pulled=pulled == 1.0,
            intervals=int(intervals),
            **values,
        )


def fit_polynomial(
    seen: Seen, blocks: int, gap_s: float, base: ArrayLike | None, degree: int | None, static: bool, seed: int
) -> Fitted:
    """Fit a polynomial rod with its memory: basis and ridge by cross-validation, `static` for no memory."""
    parts, _ = covered_folds(seen, Basis(1), blocks, gap_s)
    bases = _bases(seen, min(len(train) for train, _ in parts), degree)
    # Blocks are covered in the terms of the richest polynomial; of one command, or of many, in squares: no log has all.
    richest = [b for b in bases if not b.intervals][-1] if 1 < seen.drive.channels <= FEW_CHANNELS else SQUARES
    parts, gap_s = covered_folds(seen, richest, blocks, gap_s)
    fit = Regression(seen.markers, _base(base, seen.markers), parts)
    memory = Memory()
    if not static:
        step = -(-len(seen.t) // FRAMES)
        thinned = seen.every(step)
        memory = _memory(thinned, search_folds(thinned, richest), fit, seen.drive.commanded, bases, seed)
    u = memory.acting(seen.drive)
    ridges = RIDGE_STEPS if seen.drive.channels > 1 else RIDGE_STEPS[:1]
    chosen, ridge = choose_basis(fit, u, bases, ridges)
    if memory.names:
        memory = refined_memory(memory, seen, StaticMap(_plane(fit), search_folds(seen, richest), chosen, ridge), seed)
        u = memory.acting(seen.drive)
    weights = fit.weights(u, chosen, ridge)
    rod = RodParameters(
        fit.base, weights.centre, weights.scale, chosen.degree, weights.angles, weights.lengths, _nominal(fit.lengths),
        pulled=chosen.pulled, intervals=chosen.intervals,
    )  # fmt: skip
    residuals = fit.cross_validate(u, chosen, ridge)
    made_from = {"degree": chosen.degree, "pulled": chosen.pulled, "intervals": chosen.intervals, "ridge": ridge}
    made_from["gap_s"] = round(gap_s, 6)
    return Fitted(rod, memory, residuals, parts, made_from, basis=chosen if chosen.pulled else SQUARES)


def _bases(seen: Seen, smallest: int, degree: int | None) -> tuple[Basis, ...]:
    """Return the bases that `smallest` frames can identify; pulls where several commands move to both sides of 0."""
    channels, commands = seen.drive.channels, seen.drive.commands
    some = (DEGREES if channels > 1 else DEGREES_OF_ONE) if degree is None else (degree,)
    bases = [Basis(d) for d in some]
    if channels > 1 and np.any((commands.min(axis=0) < 0) & (commands.max(axis=0) > 0)):
        bases += [Basis(d, True) for d in some if d < (CUBIC if channels > FEW_CHANNELS else CUBIC + 1)]
    found = tuple(basis for basis in bases if 2 * basis.count(channels) < smallest)
    found = found if channels > 1 else found[-1:]
    splines = Basis(SPLINE_DEGREE, intervals=INTERVALS)
    if degree is None and channels <= SPLINED_CHANNELS and splines.count(channels) < smallest:
        found = (*found, splines)  # their smoothness is chosen, so they need fewer frames than numbers without a ridge
    if not any(not basis.pulled and not basis.intervals for basis in found):
        raise RunError(
            f"{len(seen.t)} usable frames leave {smallest} to learn from outside a block, too few for a polynomial "
            f"of {channels} commands; record longer, use fewer blocks or a smaller gap_s"
        )
    return found


def _memory(
    thinned: Seen, parts: Folds, fit: Regression, commanded: Floats, bases: tuple[Basis, ...], seed: int
) -> Memory:
    """Find the memory with the map of the commands alone, or with a richer one for few channels."""
    chosen, ridge = choose_basis(fit, commanded, bases)
    plane = _plane(Regression(thinned.markers, fit.base, parts))
    if chosen.intervals:
        return find_memory(thinned, StaticMap(plane, parts, chosen, ridge), seed)
    most = max(chosen.degree, CUBIC if thinned.drive.channels <= FEW_CHANNELS else 1)
    alike = [one for one in bases if one.pulled == chosen.pulled and one.degree <= most and not one.intervals]
    return find_memory(thinned, StaticMap(plane, parts, max(alike, key=lambda basis: basis.degree)), seed)


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
