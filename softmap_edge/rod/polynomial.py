"""The polynomial rod in Python, and its fit.

The bending angles of its chords are a polynomial of the commands.

    v (rad) ≈ polynomial(q),   length (mm) ≈ quadratic(v),   q = (u_eff − centre)/scale

A command may pull one cable above 0 and another below. v may then be a polynomial of max(q, 0) and
max(−q, 0): a cable that becomes slack causes a kink there. Weights are found by ridge regression;
penalty: n · ridge · RIDGE[degree of the monomial] on all weights but the intercept, n frames. Basis
and ridge are those with the lowest cross-validation error (`regression.py`). Known limit: one
marker at the end of each chord, base to tip. tests/rod/test_rod.py and tests/rod/test_pulled_rod.py
pin exact recovery.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softmap_edge.errors import RunError, SoftmapError
from softmap_edge.model.basis import SPLINE_DEGREE, SQUARES, Basis
from softmap_edge.model.model import TIP_PER_NEWTON
from softmap_edge.model.polynomial_rod import PolynomialRodArrays
from softmap_edge.rod.covered_folds import covered_folds, search_folds
from softmap_edge.rod.fitted import Fitted
from softmap_edge.rod.memory.families import FEW_CHANNELS
from softmap_edge.rod.memory.memory import Memory
from softmap_edge.rod.memory.record import refined_memory
from softmap_edge.rod.memory.search import FRAMES, find_memory
from softmap_edge.rod.reference_run import ReferenceFrames
from softmap_edge.rod.regression import RIDGE_STEPS, Regression, choose_basis
from softmap_edge.rod.static_map import StaticMap
from softmap_edge.run.fields import unmasked

Floats = NDArray[np.float64]

DEGREES = (1, 2, 3)
# degree for a single command: the highest identified without a ridge
DEGREES_OF_ONE = (1, 2, 3, 4, 5)
CUBIC = 3
INTERVALS = 8  # spline intervals: eight make (8 + 3)² = 121 terms of two commands
SPLINED_CHANNELS = 2  # most commands for splines; three would have 1331 terms
# of the range of markers: a height below this is constant, an output; base of outputs
LEVEL, FAR_BELOW = 1e-6, 20.0


def fit_polynomial(
    seen: ReferenceFrames,
    blocks: int,
    gap_s: float,
    base: ArrayLike | None,
    degree: int | None,
    static: bool,
    seed: int,
) -> Fitted:
    """Fit a polynomial rod with memory: basis and ridge by cross-validation.

    `static` fits no memory.
    """
    parts, _ = covered_folds(seen, Basis(1), blocks, gap_s)
    bases = _bases(seen, min(len(train) for train, _ in parts), degree)
    # Coverage uses the terms of the richest polynomial. For one command, or for many, it uses
    # squares, because no log covers all terms.
    richest = (
        [b for b in bases if not b.intervals][-1]
        if 1 < seen.drive.channels <= FEW_CHANNELS
        else SQUARES
    )
    parts, gap_s = covered_folds(seen, richest, blocks, gap_s)
    fit = Regression(seen.markers, _base(base, seen.markers), parts)
    memory = Memory() if static else _memory(seen, richest, fit, bases, seed)
    u = memory.acting(seen.drive)
    ridges = RIDGE_STEPS if seen.drive.channels > 1 else RIDGE_STEPS[:1]
    chosen, ridge = choose_basis(fit, u, bases, ridges)
    if memory.names:
        memory = refined_memory(
            memory, seen, StaticMap(_plane(fit), search_folds(seen, richest), chosen, ridge), seed
        )
        u = memory.acting(seen.drive)
    weights = fit.weights(u, chosen, ridge)
    rod = PolynomialRodArrays(
        fit.base,
        weights.centre,
        weights.scale,
        chosen.degree,
        weights.angles,
        weights.lengths,
        _nominal(fit.lengths),
        pulled=chosen.pulled,
        intervals=chosen.intervals,
    )
    residuals = fit.cross_validate(u, chosen, ridge)
    made_from = {
        "degree": chosen.degree,
        "pulled": chosen.pulled,
        "intervals": chosen.intervals,
        "ridge": ridge,
    }
    made_from["gap_s"] = round(gap_s, 6)
    return Fitted(
        rod, memory, residuals, parts, made_from, basis=chosen if chosen.pulled else SQUARES
    )


def _bases(seen: ReferenceFrames, smallest: int, degree: int | None) -> tuple[Basis, ...]:
    """Return the bases that `smallest` frames can identify.

    They include pulls if several commands move to both sides of 0.
    """
    channels, commands = seen.drive.channels, seen.drive.commands
    some = (DEGREES if channels > 1 else DEGREES_OF_ONE) if degree is None else (degree,)
    bases = [Basis(d) for d in some]
    if channels > 1 and np.any((commands.min(axis=0) < 0) & (commands.max(axis=0) > 0)):
        bases += [
            Basis(d, True) for d in some if d < (CUBIC if channels > FEW_CHANNELS else CUBIC + 1)
        ]
    found = tuple(basis for basis in bases if 2 * basis.count(channels) < smallest)
    found = found if channels > 1 else found[-1:]
    splines = Basis(SPLINE_DEGREE, intervals=INTERVALS)
    if degree is None and channels <= SPLINED_CHANNELS and splines.count(channels) < smallest:
        # their smoothness is chosen, so they need fewer frames than without a ridge
        found = (*found, splines)
    if not any(not basis.pulled and not basis.intervals for basis in found):
        raise RunError(
            f"{len(seen.t)} usable frames leave {smallest} to learn from outside a block, too few "
            f"for a polynomial of {channels} commands; record longer, use fewer blocks or a "
            "smaller gap_s"
        )
    return found


def _memory(
    seen: ReferenceFrames, richest: Basis, fit: Regression, bases: tuple[Basis, ...], seed: int
) -> Memory:
    """Find the memory with the map of the commands alone, or with a richer form if that shows.

    Polynomials have the highest degree for few channels.
    """
    chosen, ridge = choose_basis(fit, seen.drive.commanded, bases)
    thinned = seen.every(-(-len(seen.t) // FRAMES))
    parts = search_folds(thinned, richest)
    plane = _plane(Regression(thinned.markers, fit.base, parts))
    most = max(chosen.degree, CUBIC if thinned.drive.channels <= FEW_CHANNELS else 1)
    forms = [
        max(
            (b for b in bases if (b.intervals, b.pulled) == form and b.degree <= most),
            key=lambda basis: basis.degree,
        )
        for form in sorted({(basis.intervals, basis.pulled) for basis in bases})
        if form >= (chosen.intervals, chosen.pulled)
    ]
    first, *richer = [
        StaticMap(plane, parts, basis, ridge if chosen.intervals else RIDGE_STEPS[0])
        for basis in forms
    ]
    return find_memory(thinned, first, seed, richer=richer)


def _plane(fit: Regression) -> Floats:
    """Return chords as plane coordinates (n, 2K) mm.

    Each marker has Σ length × angle over the chords below it.
    """
    turned = fit.angles.reshape(len(fit.angles), -1, 2) * fit.lengths.mean(axis=0)[:, None]
    return np.asarray(np.cumsum(turned, axis=1).reshape(len(turned), -1))


def _base(base: ArrayLike | None, markers: Floats) -> Floats:
    """Return the first chord's start: a given point, the origin, or far below an output.

    Markers of constant height are outputs and do not bend. From far below, a chord's angle is
    linear in them.
    """
    if base is None:
        wide = float(np.ptp(markers[..., :2], axis=0).max(initial=0.0))
        level = float(np.ptp(markers[..., 2], axis=0).max(initial=0.0)) < LEVEL * wide
        return np.array([0.0, 0.0, float(markers[0, 0, 2]) - FAR_BELOW * wide if level else 0.0])
    point = np.array(unmasked(base))
    if point.shape != (3,) or not np.all(np.isfinite(point)):
        raise SoftmapError(f"base of shape {point.shape}: expected three finite numbers in mm")
    return point


def _nominal(lengths: Floats) -> float:
    """Return the nominal compliance c (N⁻¹·mm⁻²).

    1 N across straight locked chords moves the tip by c·Σ l_k³/12.
    """
    mean = lengths.mean(axis=0)
    return float(12.0 * TIP_PER_NEWTON * mean.sum() / (mean**3).sum())
