"""The regression behind `learn`: chords to angles, ridge on a polynomial, blocked cross-validation, and the searches.

All is linear algebra on sums of products: the sums of all frames less those of the frames left out give every fold its
system. Delay and lag are computed by the effects themselves, so that what is fitted is what the chain will do.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.folds import Folds

Floats = NDArray[np.float64]
Error = Callable[[Floats], float]  # commands u_eff (n, C) → mm

RIDGE = (3e-5, 9e-4, 3e-4, 3e-4)  # by degree 1…4, for |q| ≤ 1
RIDGE_STEPS = (1e-7, 0.1, 1.0 / 3.0, 1.0, 3.0, 10.0)
LENGTH_RIDGE = 1e-10
DELAYS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4)  # s, coarse search
LAGS = (0.0, 0.03, 0.06, 0.12, 0.24)  # s
WORTH = 0.01  # delay or lag enter the chain only if the cross-validation error falls by this share


@dataclass(frozen=True, eq=False)
class Weights:
    """A fitted rod: `centre` and `scale` (C,) of the commands, `angles` (1 + F, 2K) rad, `lengths` (1 + G, K) mm."""

    centre: Floats
    scale: Floats
    angles: Floats
    lengths: Floats


def normalise(u: Floats) -> Floats:
    """Return q (n, C): commands within −1 … 1 over their own range."""
    centre, scale = _span(u)
    return np.ascontiguousarray((u - centre) / scale)


def _span(u: Floats) -> tuple[Floats, Floats]:
    low, high = u.min(axis=0), u.max(axis=0)
    return (low + high) / 2.0, np.where(high > low, (high - low) / 2.0, 1.0)


def _angles(markers: Floats, base: Floats) -> tuple[Floats, Floats]:
    """Return angles (n, 2K) rad and lengths (n, K) mm of the chords from `base` through `markers` (n, K, 3)."""
    first = np.broadcast_to(base, (len(markers), 1, 3))
    chord = np.diff(np.concatenate([first, markers], axis=1), axis=1)
    across = np.linalg.norm(chord[..., :2], axis=2)
    turn = np.arctan2(across, chord[..., 2]) / np.where(across > 0, across, 1.0)
    return (turn[..., None] * chord[..., :2]).reshape(len(markers), -1), np.linalg.norm(chord, axis=2)


def _ridge(features: Floats, targets: Floats, penalty: Floats, folds: Folds) -> list[Floats]:
    """Return the weights (1 + F, outputs) for the training frames of each fold, then for all frames."""
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
        self.length_weights = _ridge(quadratic, self.lengths, np.full(quadratic.shape[1], LENGTH_RIDGE), folds)

    def angle_weights(self, q: Floats, degree: int, ridge: float) -> list[Floats]:
        """Return the polynomial's weights (1 + F, 2K) of each fold, then of all frames."""
        degrees = np.array(_core.monomial_degrees(q.shape[1], degree))
        return _ridge(_core.monomials(q, degree), self.angles, ridge * np.array(RIDGE)[degrees - 1], self.folds)

    def cross_validate(self, q: Floats, degree: int, ridge: float) -> Floats:
        """Return predicted − seen (n, K, 3) mm, each frame predicted by the fit that left out its block."""
        residuals = np.empty_like(self.markers)
        centre, scale = np.zeros(q.shape[1]), np.ones(q.shape[1])
        for (_, test), angles, lengths in zip(self.folds, self.angle_weights(q, degree, ridge), self.length_weights):
            rod = _core.Rod(self.base, centre, scale, degree, angles, lengths)
            residuals[test] = rod.evaluate(q[test]).reshape(len(test), -1, 3) - self.markers[test]
        return residuals

    def error(self, u: Floats, degree: int, ridge: float) -> float:
        """Return the cross-validation error in mm, RMS over frames and markers."""
        return rms(self.cross_validate(normalise(u), degree, ridge))

    def weights(self, u: Floats, degree: int, ridge: float) -> Weights:
        """Return the rod fitted on all frames."""
        return Weights(*_span(u), self.angle_weights(normalise(u), degree, ridge)[-1], self.length_weights[-1])


def rms(residuals: Floats) -> float:
    """Return the root of the mean squared length of residuals (…, 3) mm."""
    return float(np.sqrt((residuals**2).sum(axis=-1).mean()))


# --- delay, lag, degree -----------------------------------------------------------------------


class Drive:
    """The commands after delay and lag, as the chain computes them, at the seen times."""

    def __init__(self, u: Floats, t: Floats, t_seen: Floats) -> None:
        self.u, self.t = u, t
        self.after = np.clip(np.searchsorted(t, t_seen), 1, len(t) - 1)
        share = (t_seen - t[self.after - 1]) / (t[self.after] - t[self.after - 1])
        self.share = np.clip(share, 0.0, 1.0)[:, None]
        self.chain = _core.Chain(["latency", "lag"], u.shape[1])
        bounds = dict(zip(self.chain.group_labels, zip(self.chain.low, self.chain.high)))
        self.low = {label: float(low) for label, (low, _) in bounds.items()}
        self.high = {label: float(high) for label, (_, high) in bounds.items()}

    def admissible(self, delay: float, lag: float) -> tuple[float, float]:
        """Return the nearest values that the effects allow; below half of the lower bound is none."""
        pair = []
        for label, value in (("latency.delay", delay), ("lag.tau", lag)):
            low, high = self.low[label], self.high[label]
            pair.append(0.0 if value < low / 2 else min(max(value, low), high))
        return pair[0], pair[1]

    def at(self, pairs: Sequence[tuple[float, float]]) -> Floats:
        """Return u_eff (B, n, C) for pairs of (delay, lag) in s."""
        values = {"latency.delay": [p[0] for p in pairs], "lag.tau": [p[1] for p in pairs]}
        params = np.array([values[label] for label in self.chain.group_labels]).T.copy()
        rolled = self.chain.rollout(params, self.u, self.t)
        before = rolled[:, self.after - 1]
        return before + self.share * (rolled[:, self.after] - before)


def fit_drive(error: Error, drive: Drive) -> tuple[float, float]:
    """Return the delay and lag (s) of a grid whose commands have the least error."""
    best, pair = np.inf, (0.0, 0.0)
    for delay in DELAYS:
        pairs = [drive.admissible(delay, lag) for lag in LAGS]
        for candidate, u in zip(pairs, drive.at(pairs)):
            reached = error(u)
            if reached < best:
                best, pair = reached, candidate
    return pair


def choose_degree(fit: Regression, u: Floats, degrees: Sequence[int]) -> tuple[int, float]:
    """Return the degree and the ridge with the lowest cross-validation error."""
    return min(product(degrees, RIDGE_STEPS), key=lambda choice: fit.error(u, *choice))


def refine_drive(error: Error, drive: Drive, delay: float, lag: float) -> tuple[float, float]:
    """Refine delay and lag, then drop each that is not worth its place in the chain."""

    def at(x: Floats) -> float:
        return error(drive.at([drive.admissible(float(x[0]), float(x[1]))])[0])

    # Along (1, −1) delay and lag trade places and the error hardly changes, so that direction is searched too.
    found = _descend(at, np.array([delay, lag]), np.array([[0.02, 0.0], [0.0, 0.02], [0.02, -0.02]]), halvings=4)
    candidates = [(0.0, 0.0), (float(found.sum()), 0.0), (0.0, float(found.sum())), tuple(found)]
    pairs = [drive.admissible(max(float(a), 0.0), max(float(b), 0.0)) for a, b in candidates]
    errors = [at(np.array(pair)) for pair in pairs]
    for pair, reached in zip(pairs, errors):  # simplest first
        if reached <= min(errors) * (1.0 + WORTH):
            return pair
    return pairs[-1]


def _descend(error: Callable[[Floats], float], start: Floats, steps: Floats, halvings: int) -> Floats:
    """Minimise by steps (D, n) to and fro, halved when none of them helps."""
    at, lowest = start, error(start)
    for _ in range(halvings + 1):
        moved = True
        while moved:
            moved = False
            for step in [*steps, *-steps]:
                reached = error(at + step)
                if reached < lowest * (1.0 - 1e-6):
                    at, lowest, moved = at + step, reached, True
        steps = steps / 2.0
    return at
