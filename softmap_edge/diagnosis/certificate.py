"""Certificates: an e-value for each claim, from blocks withheld from its fit.

    log e = T (chi²₀ - chi²₁) / (2 φ) + k/2 · ln(1 - T),  T = 1/2

chi²₁ is that of the withheld frames under all effects found, with parameters fitted to the other
frames. chi²₀ is the same without the claim, with all other parameters fitted to the withheld frames
themselves (universal inference: Wasserman, Ramdas, Balakrishnan 2020, doi:10.1073/pnas.1922664117).
The covariance holds noise, model error and the robot's ordinary imperfections, at the level that
the search estimates. φ is the dispersion of the other frames, at least 1 except for a rod.

The split accounts for noise, but a model error is the same in all blocks. For any k fitted
parameters, 2 ln LR is at most chi²(k) under the null. There, E exp(T chi²(k) / 2) = (1 - T)^(-k/2).
So T and the last term keep e an e-value even if the claim was fitted to this error.

The search uses all frames, so its choice needs a multiplicity correction. Every set of r claims
among N candidates, and each of its members, is a hypothesis. It has an e-value, zero if it was not
chosen. Set sizes share the level, so r claims count m = 4 r C(N, r). e-BH (Wang and Ramdas 2022,
doi:10.1111/rssb.12489) over all of them controls the false discovery rate. The k claims of largest
e are certified, for the largest k whose claims all reach m / (0.05 k). It holds for dependent
claims. Limits: both fits are one linear step from that of all frames. Only the inflation accounts
for noise that is correlated over more than the gap between blocks. Pinned by
tests/diagnosis/test_certificates.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from math import comb

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis.families import FeatureBody, families
from softmap_edge.diagnosis.findings import Certificate
from softmap_edge.diagnosis.fit import Fit, Problem
from softmap_edge.diagnosis.outcome import Outcome
from softmap_edge.diagnosis.representatives import Representative, State
from softmap_edge.run.folds import Withheld

Floats = NDArray[np.float64]

LEVEL = 0.05  # false discovery rate
TEMPER = 0.5  # power of the likelihood ratio; at 1/2, each parameter costs a factor of 1.4
FREE = 1e-6  # ridge of refitted parameters, against rounding errors only
SIZES = 4  # sizes of sets of claims that share the level


@dataclass(frozen=True, eq=False)
class Certified:
    """Certificates by name of the effect, and of each family without a law."""

    effects: Mapping[str, Certificate]
    families: Mapping[str, Certificate]


def certified(outcome: Outcome, fit: Fit, kept: Withheld) -> Certified:
    """Certify what a search found.

    Args:
        outcome: the search.
        fit: the accepted laws, after demotion.
        kept: frames for fitting the parameters of the claims, and frames for testing.
    """
    named, open_ = list(fit.effects), [one.family.name for one in outcome.state.representatives]
    claims = [*named, *open_]
    if not len(kept.rows) or not claims:
        none = Certificate(reason=kept.reason)
        return Certified(dict.fromkeys(named, none), dict.fromkeys(open_, none))
    evidence = _Evidence(outcome, fit, kept)
    logs = [evidence.of_effect(name) for name in named] + [
        evidence.of_family(name) for name in open_
    ]
    candidates = len(outcome.fits.candidates) + len(families())
    found = certificates(logs, hypotheses(candidates, len(claims)), kept)
    return Certified(dict(zip(named, found)), dict(zip(open_, found[len(named) :])))


def hypotheses(candidates: int, claims: int) -> int:
    """Return the number of hypotheses for a number of claims.

    Each member of each set counts, weighted by the share of its set size.
    """
    return max(SIZES, claims) * claims * comb(candidates, claims)


def certificates(logs: Sequence[float], count: int, kept: Withheld) -> list[Certificate]:
    """Return e-BH certificates of claims by their log10 e (n,), of `count` hypotheses."""
    order = np.sort(np.asarray(logs, float))[::-1]
    # of the k largest, for k = 1, 2, …
    needs = np.log10(count / LEVEL / np.arange(1, len(order) + 2))
    sure = max((k for k in range(1, len(order) + 1) if order[k - 1] >= needs[k - 1]), default=0)
    found = []
    for log in logs:
        good = bool(sure and log >= order[sure - 1])
        needed = float(needs[sure - 1] if good else needs[sure])
        found.append(Certificate(float(log), needed, len(kept.rows), kept.blocks, good))
    return found


class _Evidence:
    """Tests of each claim of a search on the withheld frames."""

    def __init__(self, outcome: Outcome, fit: Fit, kept: Withheld) -> None:
        self.outcome, self.fit, self.representatives = (
            outcome,
            fit,
            list(outcome.state.representatives),
        )
        self.body = FeatureBody(_split(outcome, kept), outcome.fits.candidates)
        self.chi2, _, chosen = self._chi2(fit, self.representatives)
        share = len(kept.chosen) / len(outcome.body.record)
        scale = chosen / max(1.0, share * outcome.body.problem.numbers - len(fit.x))
        # A rod's noise is its error on the run. It contains the tested effect, so it may be too
        # large.
        self.dispersion = scale if outcome.body.record.error_is_noise else max(1.0, scale)

    def of_effect(self, name: str) -> float:
        """Return log10 e of an effect."""
        numbers = int(self.fit.space.of((name,)).sum())
        return self._log10_e(
            self.outcome.fits.without(self.fit, name), self.representatives, numbers
        )

    def of_family(self, name: str) -> float:
        """Return log10 e of a family without a law."""
        numbers = sum(one.numbers for one in self.representatives if one.family.name == name)
        return self._log10_e(
            self.fit, [one for one in self.representatives if one.family.name != name], numbers
        )

    def _log10_e(
        self, fit: Fit, representatives: Sequence[Representative], numbers: float
    ) -> float:
        """Return log10 e of a claim with a number of parameters, against the rest without it."""
        fall = (self._chi2(fit, representatives)[1] - self.chi2) / self.dispersion
        return float((0.5 * TEMPER * fall + 0.5 * numbers * np.log(1.0 - TEMPER)) / np.log(10.0))

    def _chi2(
        self, fit: Fit, representatives: Sequence[Representative]
    ) -> tuple[float, float, float]:
        """Return chi² of the withheld frames, fitted to the others or to themselves.

        The third value is the chi² of the others.
        """
        problem = self.body.problem
        there = Fit(
            problem,
            fit.effects,
            fit.space,
            fit.x,
            fit.cost,
            fit.chi2,
            problem.at(fit.space, fit.x[None])[0],
        )
        state, level = State(self.body, there, representatives), self.body.level()
        names, ridges = state.blocks(level)
        residual = state.residual
        # a representative is refitted completely, not only its change
        for one in representatives:
            columns = (
                self.body.columns(one.family, state.commands, state.slopes)
                if len(one.theta)
                else None
            )
            residual = residual if columns is None else residual + columns.shift(one.theta)
        level.close(np.ascontiguousarray(self.body.modes(residual)))
        held_out, withheld, chosen = level.losses(
            names, [FREE if n == "fit" else r for n, r in zip(names, ridges)]
        )
        return float(held_out), float(withheld), float(chosen)


def _split(outcome: Outcome, kept: Withheld) -> Problem:
    """Return a search's problem with the withheld frames as folds.

    The parameters are fitted to the other frames or to the withheld ones.

    Ordinary imperfections are smooth in the commands, like the model error, and add to it.
    """
    problem = copy(outcome.body.problem)
    larger = 1.0 + (outcome.body.ordinary_mm / max(problem.record.form_mm, 1e-9)) ** 2
    problem.whitener = replace(problem.whitener, form=larger * problem.whitener.form)
    problem.folds = [(kept.chosen, kept.rows), (kept.rows, kept.rows), (kept.chosen, kept.chosen)]
    problem.__dict__.pop("fold_kernels", None)
    return problem
