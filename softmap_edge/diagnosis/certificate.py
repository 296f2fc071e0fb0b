"""Certificates: an e-value for each claim of a search, from blocks of the run that took no part in it.

    log e = T (chi²₀ - chi²₁) / (2 φ) + k/2 · ln(1 - T),  T = 1/2

chi²₁ is that of the withheld frames under everything found, with the numbers of the search. chi²₀ is the same without
the claim, all other numbers maximised again on the withheld frames (universal inference: Wasserman, Ramdas,
Balakrishnan 2020, doi:10.1073/pnas.1922664117). Both are whitened with noise, the model's own error and the robot's
ordinary imperfections, at the level that the search estimates, in the covariance. φ >= 1 is the over-dispersion of the
frames of the search.

The split alone makes noise harmless, but a model's own error is the same in all blocks. Whatever k numbers are chosen,
2 ln LR is at most chi²(k) under the null, and E exp(T chi²(k) / 2) = (1 - T)^(-k/2). With T and the last term e stays
an e-value even if the claim was fitted to just this error.

e-BH (Wang and Ramdas 2022, doi:10.1111/rssb.12489) over all m candidates controls the false discovery rate: the k
claims of largest e are certified, for the largest k whose claims all reach m / (0.05 k). It holds for dependent claims.
Limits: the maximum without a claim is one linear step from the search's own; noise that is correlated for longer than
the gap between blocks is accounted for by its inflation only. Pinned by tests/test_certificates.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis.families import (
    Body,
    Columns,
    Representative,
    State,
    applied,
    families,
)
from softmap_edge.diagnosis.findings import Certificate
from softmap_edge.diagnosis.fit import Fit, Problem
from softmap_edge.diagnosis.noise import command_kernel
from softmap_edge.diagnosis.outcome import Outcome, shifted
from softmap_edge.diagnosis.record import Record
from softmap_edge.folds import Withheld

Floats = NDArray[np.float64]

LEVEL = 0.05  # false discovery rate
TEMPER = 0.5  # power of the likelihood ratio; at 1/2 the price of a number is a factor of 1.4
FREE = 1e-6  # ridge of numbers that are maximised again: none but to round off


@dataclass(frozen=True, eq=False)
class Certified:
    """The laws of a search fitted to all frames, and certificates by name of the effect or of the family."""

    fit: Fit
    effects: Mapping[str, Certificate]
    families: Mapping[str, Certificate]


def certified(outcome: Outcome, fit: Fit, record: Record, kept: Withheld) -> Certified:
    """Certify what a search found, and fit it once more to all frames.

    Args:
        outcome: a search of the frames `kept.chosen`.
        fit: the laws that stand, after demotion.
        record: all frames.
        kept: which frames were withheld.
    """
    named, open_ = list(fit.effects), [one.family.name for one in outcome.state.beside]
    if not len(kept.rows):
        none = Certificate(reason=kept.reason)
        return Certified(fit, dict.fromkeys(named, none), dict.fromkeys(open_, none))
    whole = _on_all_frames(outcome, record, kept)
    body = Body(whole, outcome.body.candidates)
    evidence = _Evidence(outcome, fit, body)
    logs = [evidence.log10_e(name) for name in named] + [evidence.log10_e(None, name) for name in open_]
    found = certificates(logs, len(outcome.fits.candidates) + len(families()), kept)
    final = _refitted(whole, evidence.state, fit)
    return Certified(final, dict(zip(named, found)), dict(zip(open_, found[len(named) :])))


def certificates(logs: Sequence[float], candidates: int, kept: Withheld) -> list[Certificate]:
    """Return certificates of claims by their log10 e (n,), of so many candidates, by the rule of e-BH."""
    order = np.sort(np.asarray(logs, float))[::-1]
    needs = np.log10(candidates / LEVEL / np.arange(1, len(order) + 2))  # of the k largest, for k = 1, 2, …
    count = max((k for k in range(1, len(order) + 1) if order[k - 1] >= needs[k - 1]), default=0)
    least = float(needs[max(count, 1) - 1])
    found = []
    for log in logs:
        sure = bool(count and log >= order[count - 1])
        needed = least if sure else float(needs[count])
        found.append(Certificate(float(log), needed, len(kept.rows), kept.blocks, sure))
    return found


def _on_all_frames(outcome: Outcome, record: Record, kept: Withheld) -> Problem:
    """Return a problem on all frames with the noise of the search; its folds are the frames chosen and withheld.

    Ordinary imperfections are smooth in the commands like the model's own error, and add to it.
    """
    problem = outcome.body.problem
    kernel = command_kernel(record.command, record.spread, record.leaning)
    larger = 1.0 + (outcome.ordinary_mm / max(record.form_mm, 1e-9)) ** 2
    wide = replace(problem.whitener, kernel=kernel, form=larger * problem.whitener.form)
    whole = Problem(record, problem.noise, wide, problem.base)
    whole.folds = [(rows, rows) for rows in (kept.chosen, kept.rows)]
    return whole


def _refitted(whole: Problem, state: State, fit: Fit) -> Fit:
    """Return the laws of a search fitted to all frames, from its own numbers."""
    problem = shifted(whole, state.shift) if state.beside else whole
    return problem.fit(fit.effects, [fit.x], split=fit.space.split)


class _Evidence:
    """What the withheld frames say about each claim of a search."""

    def __init__(self, outcome: Outcome, fit: Fit, body: Body) -> None:
        self.outcome, self.fit, self.body = outcome, fit, body
        self.beside = self._beside(outcome.state.beside)
        self.state = self._state(fit, self.beside)
        chosen, self.chi2 = self._chi2(self.state, again=False)
        self.dispersion = max(1.0, chosen / max(1.0, outcome.body.problem.numbers))

    def log10_e(self, effect: str | None, family: str = "") -> float:
        """Return log10 e of an effect, or of a family that stands without a law."""
        if effect is not None:
            own = [label for label in self.fit.space.free_labels if label.split(".")[0] == effect]
            without, numbers = self._state(self.outcome.fits.without(self.fit, effect), self.beside), float(len(own))
        else:
            numbers = sum(one.numbers for one in self.beside if one.family.name == family)
            without = self._state(self.fit, [one for one in self.beside if one.family.name != family])
        fall = (self._chi2(without, again=True)[1] - self.chi2) / self.dispersion
        return float((0.5 * TEMPER * fall + 0.5 * numbers * np.log(1.0 - TEMPER)) / np.log(10.0))

    def _chi2(self, state: State, again: bool) -> tuple[float, float]:
        """Return chi² of the frames chosen and withheld under a state; `again`: the least over its numbers on each."""
        level = self.body.level()
        names, ridges = state.blocks(level) if again else ([], [])
        level.close(np.ascontiguousarray(self.body.modes(state.residual)))
        chosen, withheld = level.losses(names, [FREE if name == "fit" else r for name, r in zip(names, ridges)])
        return float(chosen), float(withheld)

    def _state(self, fit: Fit, beside: Sequence[Representative]) -> State:
        """Return what a fit and representatives predict on all frames."""
        whole = self.body.problem
        modes = whole.at(fit.space, fit.x[None])[0]
        there = Fit(whole, fit.effects, fit.space, fit.x, fit.cost, fit.chi2, modes)
        return State(self.body, there, beside)

    def _beside(self, every: Sequence[Representative]) -> list[Representative]:
        """Return representatives with their columns on all frames."""
        body, found = self.body, []
        commands = body.effective(self.fit)
        for one in every:
            columns = body.columns(one.family, commands, body.slopes(commands)) if len(one.theta) else None
            if columns is None:  # a law stands in its place
                none = np.zeros((0, *body.record.seen.shape))
                columns = Columns(none, np.zeros(0, np.intp), np.zeros((0, len(body.record))), 0)
            found.append(replace(one, columns=columns))
            commands = applied(body, found[-1], commands)[0]
        return found
