"""The regression behind `learn`: chords to angles, ridge on a polynomial, blocked cross-validation.

All computations use sums of products. The sums of all frames minus those of the omitted frames give
the system of each fold. The effects themselves compute the effective commands, so fit and chain
agree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.model.basis import Basis, commanded_range
from softmap_edge.model.chain_labels import valued
from softmap_edge.model.polynomial_rod import Weights, compiled
from softmap_edge.run.folds import Folds

Floats = NDArray[np.float64]

RIDGE_STEPS = (1e-7, 1e-3, 1e-2, 0.1, 1.0 / 3.0, 1.0, 3.0, 10.0)
LENGTH_RIDGE = 1e-10


def normalise(u: Floats) -> Floats:
    """Return q (n, C): commands within −1 … 1 over their own range."""
    centre, scale = commanded_range(u)
    return np.ascontiguousarray((u - centre) / scale)


def _angles(markers: Floats, base: Floats) -> tuple[Floats, Floats]:
    """Return angles (n, 2K) rad and lengths (n, K) mm of the chords through the markers.

    Chords start at `base` and go through `markers` (n, K, 3).
    """
    first = np.broadcast_to(base, (len(markers), 1, 3))
    chord = np.diff(np.concatenate([first, markers], axis=1), axis=1)
    across = np.linalg.norm(chord[..., :2], axis=2)
    turn = np.arctan2(across, chord[..., 2]) / np.where(across > 0, across, 1.0)
    return (turn[..., None] * chord[..., :2]).reshape(len(markers), -1), np.linalg.norm(
        chord, axis=2
    )


def _ridge(features: Floats, targets: Floats, penalty: Floats, folds: Folds) -> list[Floats]:
    """Return weights (1 + F, outputs) for each fold's training frames, then for all frames."""
    rows = np.concatenate([np.ones((len(features), 1)), features], axis=1)
    square, mixed = rows.T @ rows, rows.T @ targets
    weights = []
    for train, _ in [*folds, (np.arange(len(rows)), None)]:
        left_out = np.ones(len(rows), bool)
        left_out[train] = False
        gone = rows[left_out]
        system = square - gone.T @ gone + np.diag(np.concatenate([[0.0], penalty * len(train)]))
        weights.append(np.linalg.solve(system, mixed - gone.T @ targets[left_out]))
    return weights


class Regression:
    """Markers as chords from a base point, and the regression on them."""

    def __init__(self, markers: Floats, base: Floats, folds: Folds) -> None:
        self.markers, self.base, self.folds = markers, base, folds
        self.angles, self.lengths = _angles(markers, base)
        quadratic = _core.monomials(self.angles, 2)
        self.length_weights = _ridge(
            quadratic, self.lengths, np.full(quadratic.shape[1], LENGTH_RIDGE), folds
        )

    def angle_weights(self, u: Floats, basis: Basis, ridge: float) -> list[Floats]:
        """Return the weights (1 + F, 2K) of each fold, then of all frames."""
        return _ridge(basis.columns(u), self.angles, ridge * basis.penalty(u.shape[1]), self.folds)

    def cross_validate(self, u: Floats, basis: Basis, ridge: float) -> Floats:
        """Return predicted − seen (n, K, 3) mm, each frame by the fit without its block.

        A frame that no fold tests is NaN.
        """
        residuals = np.full_like(self.markers, np.nan)
        centre, scale = basis.span(u)
        for (_, test), angles, lengths in zip(
            self.folds, self.angle_weights(u, basis, ridge), self.length_weights
        ):
            rod = compiled(
                Weights(centre, scale, basis.in_core(angles, u.shape[1]), lengths), self.base, basis
            )
            rows = np.ascontiguousarray(u[test])
            residuals[test] = rod.evaluate(rows).reshape(len(test), -1, 3) - self.markers[test]
        return residuals

    def losses(self, u: Floats, basis: Basis, ridge: float) -> Floats:
        """Return the cross-validation loss (folds,) in mm², summed over frames and markers."""
        squares = np.asarray((self.cross_validate(u, basis, ridge) ** 2).sum(axis=(1, 2)))
        return np.array([squares[test].sum() for _, test in self.folds])

    def weights(self, u: Floats, basis: Basis, ridge: float) -> Weights:
        """Return the rod fitted on all frames."""
        angles = basis.in_core(self.angle_weights(u, basis, ridge)[-1], u.shape[1])
        return Weights(*basis.span(u), angles, self.length_weights[-1])


def rms(residuals: Floats) -> float:
    """Return the root of the mean squared length of residuals (…, 3) mm."""
    return float(np.sqrt((residuals**2).sum(axis=-1).mean()))


# --- commands and basis -----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Record:
    """The commands of one run: `u` (T, C) at `t` (T,) s, evaluated at `t_seen` (n,) s.

    `backward`: effects see the run from its end to its start, so they read the future.
    """

    u: Floats
    t: Floats
    t_seen: Floats
    backward: bool = False

    def rolled(self, chain: _core.Chain, params: Floats) -> Floats:
        """Return effective commands (B, T, C) of a chain for parameter sets (B, P)."""
        sets = np.ascontiguousarray(params)
        if not self.backward:
            return chain.rollout(sets, self.u, self.t)
        u, t = np.ascontiguousarray(self.u[::-1]), np.ascontiguousarray(self.t[-1] - self.t[::-1])
        return chain.rollout(sets, u, t)[:, ::-1]

    def read(self, rows: Floats) -> Floats:
        """Interpolate rows (B, T, C) at the frame times (B, n, C): linear, constant outside."""
        after = np.clip(np.searchsorted(self.t, self.t_seen), 1, len(self.t) - 1)
        share = (self.t_seen - self.t[after - 1]) / (self.t[after] - self.t[after - 1])
        before = rows[:, after - 1]
        inside = np.clip(share, 0.0, 1.0)[:, None]
        return np.asarray(before + inside * (rows[:, after] - before), float)


class Drive:
    """The commands of one or several runs after a chain of effects, at the frame times.

    Memory begins in equilibrium in each run.
    """

    def __init__(self, *records: Record) -> None:
        self.records = records
        self.channels = records[0].u.shape[1]
        self.commands = np.concatenate([record.u for record in records])

    @cached_property
    def commanded(self) -> Floats:
        """The commands (n, C) at the frame times, before any effect."""
        read: list[Floats] = [record.read(record.u[None])[0] for record in self.records]
        return np.concatenate(read)

    @property
    def middle(self) -> Floats:
        """Middle (C,) of each channel's range."""
        middle: Floats = 0.5 * (self.commands.min(axis=0) + self.commands.max(axis=0))
        return middle

    @property
    def half(self) -> Floats:
        """Half (C,) of each channel's range; 1 for a channel that does not move."""
        half = 0.5 * np.ptp(self.commands, axis=0)
        return np.asarray(np.where(half > 0, half, 1.0), float)

    def rolled(self, chain: _core.Chain, params: Floats) -> Floats:
        """Return effective commands (B, n, C) for parameter sets (B, P) of a chain."""
        return np.concatenate([r.read(r.rolled(chain, params)) for r in self.records], axis=1)

    def acting(self, names: Sequence[str], params: Mapping[str, float]) -> Floats:
        """Return effective commands (n, C) of a chain of `names`.

        Parameters are given by label; the others stay at null.
        """
        if not names:
            return self.commanded
        chain = _core.Chain(list(names), self.channels)
        return np.asarray(self.rolled(chain, valued(chain, params, chain.null)[None])[0])


def choose_basis(
    fit: Regression, u: Floats, bases: Sequence[Basis], ridges: Sequence[float] = RIDGE_STEPS
) -> tuple[Basis, float]:
    """Return the basis and the ridge with the lowest cross-validation error.

    A richer form, pulls and then splines, must lower it by more than one standard error. The ridge
    of splines is always chosen; it sets their smoothness.
    """
    found: tuple[Floats, Basis, float] | None = None
    for form in sorted({(basis.intervals, basis.pulled) for basis in bases}):
        alike = [basis for basis in bases if (basis.intervals, basis.pulled) == form]
        every = [
            (fit.losses(u, *choice), *choice)
            for choice in product(alike, RIDGE_STEPS if form[0] else ridges)
        ]
        best = min(every, key=lambda one: float(one[0].sum()))
        if found is None or float((found[0] - best[0]).sum()) > standard_error(found[0] - best[0]):
            found = best
    assert found is not None
    return found[1:]


def standard_error(differences: Floats) -> float:
    """Return one standard error of the sum of paired differences (folds,)."""
    return float(differences.std(ddof=1) * np.sqrt(len(differences)))
