"""Fit the numbers of a chain of effects, with the static map solved again for every set.

    minimise over x:  Σ |seen − map solved at v(x)|²,   v(x) = rollout of the chain

Play is not smooth. So a scan of the held-out loss over the complete range comes first. Then a
bounded Levenberg-Marquardt refines the best few sets. σ is the larger of two: of the linearised
fit, and of the jackknife over the folds. Pinned by tests/rod/test_learned_memory.py.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from softmap_edge.model.learned_in import LearnedNumber
from softmap_edge.rod.descent import Term, descend
from softmap_edge.rod.memory.free_chain import FittedChain, FreeChain, at_bound
from softmap_edge.rod.regression import Drive
from softmap_edge.rod.static_map import StaticMap

Floats = NDArray[np.float64]
Index = NDArray[np.intp]

SCAN = 24  # sets per number of a scan
SCAN_ALONG = 12  # sets of one number while the others are fixed
TOGETHER = 24  # sets rolled out at a time
REFINED = 2  # best sets of a scan that are refined
MOST_STEPS, ENOUGH = 15, 1e-4  # tolerance: play is not smooth, and folds differ by more
STEP = 1e-3  # of the range, step for slopes: wider than the kinks of sampled play
IDLE = 0.02  # of half the range: a number with a smaller effect on the commands is inactive


class ChainFit:
    """The data of a fit: a drive, in its unit, and a static map.

    The map is solved again for every parameter set.
    """

    def __init__(self, drive: Drive, static: StaticMap, seed: int, unit: str = "mm") -> None:
        self.drive, self.static, self.seed, self.unit = drive, static, seed, unit
        self._refits: dict[FittedChain, Floats] = {}

    def scanned(self, chain: FreeChain, known: Mapping[str, float]) -> FittedChain:
        """Fit a chain from a scan of all numbers, except those `known` by label.

        Known numbers start at their value.
        """
        start = chain.at(known)
        open_ = [i for i, label in enumerate(chain.labels) if label not in known]
        sets = np.tile(start, (SCAN * max(1, len(open_)), 1))
        if len(open_) == 1:
            sets[:, open_[0]] = np.linspace(0.0, 1.0, len(sets))
        else:
            sets[:, open_] = np.random.default_rng(self.seed).uniform(size=(len(sets), len(open_)))
        sums = np.concatenate(
            [
                [self.static.scanned(v) for v in self.drive.rolled(chain.core, chain.params(some))]
                for some in np.array_split(sets, -(-len(sets) // TOGETHER))
            ]
        )
        return self.refined(chain, sets[np.argsort(sums)[:REFINED]])

    def scanned_along(self, chain: FreeChain, start: Floats, i: int) -> Floats:
        """Return `start` with its number `i` at the best of a scan; others are near their best."""
        sets = np.tile(start, (SCAN_ALONG + 1, 1))
        sets[1:, i] = np.linspace(0.0, 1.0, SCAN_ALONG)
        rolled = self.drive.rolled(chain.core, chain.params(sets))
        return np.asarray(
            sets[int(np.argmin([float((self.static.residual(v) ** 2).sum()) for v in rolled]))]
        )

    def refined(self, chain: FreeChain, starts: Floats) -> FittedChain:
        """Fit a chain from some starts (S, D) and return the best."""
        zero, one = np.zeros(len(chain.labels)), np.ones(len(chain.labels))
        ends = [
            descend(self._term(chain, None), start, zero, one, MOST_STEPS, ENOUGH)
            for start in starts
        ]
        x = min(ends, key=lambda end: end[1])[0]
        acting = self.drive.rolled(chain.core, chain.params(x)[None])[0]
        return FittedChain(
            chain, x, acting, self.static.losses(acting), self._idle(chain, x, acting)
        )

    def _idle(self, chain: FreeChain, x: Floats, acting: Floats) -> NDArray[np.bool_]:
        """Return the numbers at a bound with no more effect on the commands (n, C) than at null."""
        idle = at_bound(x)
        for i in np.flatnonzero(idle):
            without = np.where(chain.of == i, chain.core.null, chain.params(x))
            change = np.abs(self.drive.rolled(chain.core, without[None])[0] - acting)
            idle[i] = np.all(change.max(axis=0) <= IDLE * self.drive.half)
        return idle

    def refits(self, fitted: FittedChain) -> Floats:
        """Return the free numbers (folds, D), in 0 … 1, refitted without each fold."""
        if fitted not in self._refits:
            zero, one = np.zeros(len(fitted.x)), np.ones(len(fitted.x))
            terms = [self._term(fitted.chain, train) for train, _ in self.static.parts]
            self._refits[fitted] = np.stack(
                [descend(term, fitted.x, zero, one, MOST_STEPS, ENOUGH)[0] for term in terms]
            )
        return self._refits[fitted]

    def refitted_losses(self, fitted: FittedChain) -> Floats:
        """Return the held-out loss (folds,) mm² with the numbers refitted without each fold.

        The losses of `fitted` use numbers that have seen all frames.
        """
        chain, sets = fitted.chain, self.refits(fitted)
        rolled = self.drive.rolled(chain.core, chain.params(sets))
        return np.array([self.static.losses(v)[i] for i, v in enumerate(rolled)])

    def fitted_numbers(self, fitted: FittedChain) -> dict[str, LearnedNumber]:
        """Return the free numbers with their uncertainty, by label."""
        chain, x = fitted.chain, fitted.x
        residual, slopes = self._term(chain, None)(x, True)
        variance = float(residual @ residual) / max(1, len(residual) - len(x))
        # if not observable, as wide as the range
        information = slopes.T @ slopes / max(variance, 1e-12) + np.eye(len(x))
        linear = np.sqrt(np.diag(np.linalg.inv(information)))
        refits = self.refits(fitted)
        folds = len(refits)
        jackknife = np.sqrt(
            (folds - 1.0) / folds * ((refits - refits.mean(axis=0)) ** 2).sum(axis=0)
        )
        scale = np.where(
            chain.log,
            chain.values(x) * np.log(chain.high / np.where(chain.log, chain.low, 1.0)),
            chain.high - chain.low,
        )
        sigma = np.maximum(linear, jackknife) * scale
        # any value down to zero
        sigma = np.where(fitted.idle, np.maximum(sigma, chain.values(x)), sigma)
        units = {
            label.partition("[")[0]: self.unit + unit.removeprefix("mm")
            if unit.startswith("mm")
            else unit
            for label, unit in zip(chain.core.labels, chain.core.units)
        }
        return {
            label: LearnedNumber(
                label, float(value), float(s), units[label.partition("[")[0]], bool(bound)
            )
            for label, value, s, bound in zip(chain.labels, chain.values(x), sigma, fitted.bounded)
        }

    def _term(self, chain: FreeChain, rows: Index | None) -> Term:
        """Return residuals of the frames `rows`, and their slopes by differences in range."""
        kept = slice(None) if rows is None else rows

        def at(x: Floats, slopes_needed: bool) -> tuple[Floats, Floats]:
            steps = np.where(x > 1.0 - STEP, -STEP, STEP)
            sets = np.vstack([x, x + np.diag(steps)]) if slopes_needed else x[None]
            rolled = self.drive.rolled(chain.core, chain.params(sets))
            found = [self.static.residual(v, rows)[kept].ravel() for v in rolled]
            slopes = (
                np.stack([(ahead - found[0]) / step for ahead, step in zip(found[1:], steps)])
                if slopes_needed
                else None
            )
            return found[0], np.zeros((0, len(x))) if slopes is None else slopes.T

        return at
