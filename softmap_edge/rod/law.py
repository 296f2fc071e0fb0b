"""Fit laws of memory, computed by the chain, with the static map solved again.

The map is solved for every parameter set.

    minimise over x:  Σ |seen − map solved at v(x)|²,   v(x) = rollout of the chain

Parameters are scaled to 0 … 1 over their range, logarithmically for a positive range. Play is not
smooth. So a scan of the held-out loss over the complete range comes first, then a bounded
Levenberg-Marquardt from the best few points. Ranges declared in mm are those of a drive of ±16 mm
and scale with the drive. A gap may be nearly the complete range, and the held-back share may be all
of the motion, because an output may be a force. σ is the larger of that of the linearised fit and
that of the jackknife over the folds. Pinned by tests/rod/test_learned_memory.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.model.chain_labels import named, readings
from softmap_edge.model.learned_in import LearnedNumber
from softmap_edge.model.parameter_layout import REACH_MM
from softmap_edge.rod.descent import Term, descend
from softmap_edge.rod.regression import Drive
from softmap_edge.rod.static_map import StaticMap

Floats = NDArray[np.float64]
Index = NDArray[np.intp]

WIDEST = 1.95  # half ranges: a wider gap would never transmit motion
# share of the motion held back: at this value the held-back part is the complete response
HELD_BACK = 30.0
SCAN = 24  # sets per parameter of a scan
SCAN_ALONG = 12  # sets of one parameter while the others are fixed
TOGETHER = 24  # sets rolled out at a time
REFINED = 2  # best sets of a scan that are refined
MOST_STEPS, ENOUGH = 15, 1e-4  # tolerance: play is not smooth, and folds differ by more
STEP = 1e-3  # of the range, step for slopes: wider than the kinks of sampled play
BOUND = 1e-3  # of the range: distance within which a parameter is at its bound
IDLE = 0.02  # of half the range: a parameter with a smaller effect on the commands is inactive


@dataclass(frozen=True, eq=False)
class Law:
    """A chain of effects, the free number (D,) of each parameter (P,), and ranges."""

    names: tuple[str, ...]
    chain: _core.Chain
    labels: tuple[str, ...]
    of: Index
    low: Floats
    high: Floats
    log: NDArray[np.bool_]

    def values(self, x: Floats) -> Floats:
        """Return the free numbers (…, D) in user units from x in 0 … 1."""
        low = np.where(self.log, self.low, 1.0)
        return np.where(
            self.log, low * (self.high / low) ** x, self.low + (self.high - self.low) * x
        )

    def params(self, x: Floats) -> Floats:
        """Return parameters (…, P) of the chain."""
        return np.ascontiguousarray(self.values(x)[..., self.of])

    def at(self, values: Mapping[str, float]) -> Floats:
        """Return x (D,) of values by label; missing ones are at the middle of the range."""
        x = np.full(len(self.labels), 0.5)
        for i, label in enumerate(self.labels):
            value = next(
                (values[name] for name in readings(label, label.split("[")[0]) if name in values),
                None,
            )
            if value is not None:
                low, high = float(self.low[i]), float(self.high[i])
                share = (
                    np.log(value / low) / np.log(high / low)
                    if self.log[i]
                    else (value - low) / (high - low)
                )
                x[i] = np.clip(share, 0.0, 1.0)
        return x


def law(names: Sequence[str], drive: Drive, each: Sequence[str] = ()) -> Law:
    """Return the law of a chain with one number for all channels.

    The effects in `each` have one for each channel or cable.
    """
    chain = _core.Chain(list(names), drive.channels)
    median = float(np.median(drive.half))
    labels: list[str] = []
    of, low, high = [], [], []
    declared = zip(chain.labels, chain.group_labels, chain.units, chain.low, chain.high)
    for one, group, unit, least, most in declared:
        label = one if one.split(".")[0] in each else group
        if label not in labels:
            half = (
                float(drive.half[int(label.partition("[")[2].rstrip("+-]"))])
                if "[" in label
                else median
            )
            bounds = _range(group, unit, float(least), float(most), half)
            labels.append(label)
            low.append(bounds[0])
            high.append(bounds[1])
        of.append(labels.index(label))
    lowest = np.array(low)
    return Law(
        tuple(chain.names),
        chain,
        tuple(labels),
        np.array(of, np.intp),
        lowest,
        np.array(high),
        lowest > 0,
    )


def _range(effect: str, unit: str, low: float, high: float, half: float) -> tuple[float, float]:
    if unit.startswith("mm"):
        low, high = low * half / REACH_MM, high * half / REACH_MM
    if effect == "backlash.gap":
        high = WIDEST * half
    if effect == "hysteresis.strength":
        high = HELD_BACK
    return low, high


@dataclass(frozen=True, eq=False)
class FittedLaw:
    """A law with free numbers x (D,) in 0 … 1, effective commands (n, C), held-out loss.

    The loss is (folds,) mm².

    Numbers without effect at their bound are `idle` (D,): a channel may have no play.
    """

    law: Law
    x: Floats
    acting: Floats
    losses: Floats
    idle: NDArray[np.bool_]

    @property
    def params(self) -> dict[str, float]:
        """The parameters by label, as a model holds them."""
        return named(self.law.chain, self.law.params(self.x))

    @property
    def numbers(self) -> dict[str, float]:
        """The free numbers by label."""
        return dict(zip(self.law.labels, self.law.values(self.x).tolist()))

    @property
    def bounded(self) -> NDArray[np.bool_]:
        """Which free numbers (D,) are at a bound of their range with an effect there."""
        return _at_bound(self.x) & ~self.idle


def _at_bound(x: Floats) -> NDArray[np.bool_]:
    return np.asarray((x < BOUND) | (x > 1.0 - BOUND))


class LawFit:
    """The data of a law's fit: a drive, in its unit, and a static map.

    The map is solved again for every parameter set.
    """

    def __init__(self, drive: Drive, static: StaticMap, seed: int, unit: str = "mm") -> None:
        self.drive, self.static, self.seed, self.unit = drive, static, seed, unit
        self._refits: dict[FittedLaw, Floats] = {}

    def scanned(self, law: Law, known: Mapping[str, float]) -> FittedLaw:
        """Fit a law from a scan of all numbers, except those `known` by label.

        Known numbers start at their value.
        """
        start = law.at(known)
        open_ = [i for i, label in enumerate(law.labels) if label not in known]
        sets = np.tile(start, (SCAN * max(1, len(open_)), 1))
        if len(open_) == 1:
            sets[:, open_[0]] = np.linspace(0.0, 1.0, len(sets))
        else:
            sets[:, open_] = np.random.default_rng(self.seed).uniform(size=(len(sets), len(open_)))
        sums = np.concatenate(
            [
                [self.static.scanned(v) for v in self.drive.rolled(law.chain, law.params(some))]
                for some in np.array_split(sets, -(-len(sets) // TOGETHER))
            ]
        )
        return self.refined(law, sets[np.argsort(sums)[:REFINED]])

    def scanned_along(self, law: Law, start: Floats, i: int) -> Floats:
        """Return `start` with its number `i` at the best of a scan; others are near their best."""
        sets = np.tile(start, (SCAN_ALONG + 1, 1))
        sets[1:, i] = np.linspace(0.0, 1.0, SCAN_ALONG)
        rolled = self.drive.rolled(law.chain, law.params(sets))
        return np.asarray(
            sets[int(np.argmin([float((self.static.residual(v) ** 2).sum()) for v in rolled]))]
        )

    def refined(self, law: Law, starts: Floats) -> FittedLaw:
        """Fit a law from some starts (S, D) and return the best."""
        zero, one = np.zeros(len(law.labels)), np.ones(len(law.labels))
        ends = [
            descend(self._term(law, None), start, zero, one, MOST_STEPS, ENOUGH) for start in starts
        ]
        x = min(ends, key=lambda end: end[1])[0]
        acting = self.drive.rolled(law.chain, law.params(x)[None])[0]
        return FittedLaw(law, x, acting, self.static.losses(acting), self._idle(law, x, acting))

    def _idle(self, law: Law, x: Floats, acting: Floats) -> NDArray[np.bool_]:
        """Return the numbers at a bound with no more effect on the commands (n, C) than at null."""
        idle = _at_bound(x)
        for i in np.flatnonzero(idle):
            without = np.where(law.of == i, law.chain.null, law.params(x))
            change = np.abs(self.drive.rolled(law.chain, without[None])[0] - acting)
            idle[i] = np.all(change.max(axis=0) <= IDLE * self.drive.half)
        return idle

    def refits(self, fitted: FittedLaw) -> Floats:
        """Return the free numbers (folds, D), in 0 … 1, refitted without each fold."""
        if fitted not in self._refits:
            zero, one = np.zeros(len(fitted.x)), np.ones(len(fitted.x))
            terms = [self._term(fitted.law, train) for train, _ in self.static.parts]
            self._refits[fitted] = np.stack(
                [descend(term, fitted.x, zero, one, MOST_STEPS, ENOUGH)[0] for term in terms]
            )
        return self._refits[fitted]

    def refitted_losses(self, fitted: FittedLaw) -> Floats:
        """Return the held-out loss (folds,) mm² with the numbers refitted without each fold.

        The losses of `fitted` use numbers that have seen all frames.
        """
        law, sets = fitted.law, self.refits(fitted)
        rolled = self.drive.rolled(law.chain, law.params(sets))
        return np.array([self.static.losses(v)[i] for i, v in enumerate(rolled)])

    def fitted_numbers(self, fitted: FittedLaw) -> dict[str, LearnedNumber]:
        """Return the free numbers with their uncertainty, by label."""
        law, x = fitted.law, fitted.x
        residual, slopes = self._term(law, None)(x, True)
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
            law.log,
            law.values(x) * np.log(law.high / np.where(law.log, law.low, 1.0)),
            law.high - law.low,
        )
        sigma = np.maximum(linear, jackknife) * scale
        # any value down to zero
        sigma = np.where(fitted.idle, np.maximum(sigma, law.values(x)), sigma)
        units = {
            label.partition("[")[0]: self.unit + unit.removeprefix("mm")
            if unit.startswith("mm")
            else unit
            for label, unit in zip(law.chain.labels, law.chain.units)
        }
        return {
            label: LearnedNumber(
                label, float(value), float(s), units[label.partition("[")[0]], bool(bound)
            )
            for label, value, s, bound in zip(law.labels, law.values(x), sigma, fitted.bounded)
        }

    def _term(self, law: Law, rows: Index | None) -> Term:
        """Return residuals of the frames `rows`, and their slopes by differences in range."""
        kept = slice(None) if rows is None else rows

        def at(x: Floats, slopes_needed: bool) -> tuple[Floats, Floats]:
            steps = np.where(x > 1.0 - STEP, -STEP, STEP)
            sets = np.vstack([x, x + np.diag(steps)]) if slopes_needed else x[None]
            rolled = self.drive.rolled(law.chain, law.params(sets))
            found = [self.static.residual(v, rows)[kept].ravel() for v in rolled]
            slopes = (
                np.stack([(ahead - found[0]) / step for ahead, step in zip(found[1:], steps)])
                if slopes_needed
                else None
            )
            return found[0], np.zeros((0, len(x))) if slopes is None else slopes.T

        return at
