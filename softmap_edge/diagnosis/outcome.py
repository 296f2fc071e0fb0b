"""The state of a search: the families taken, their joint fit, and representatives.

An identified law joins the fit. A family without a law keeps its representative. Its contribution
is subtracted from the measurement before the next fit. Pinned by
tests/diagnosis/test_two_levels.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis import decision as rule
from softmap_edge.diagnosis.families import Family, FeatureBody
from softmap_edge.diagnosis.fit import Fit, Problem
from softmap_edge.diagnosis.fits import Fits
from softmap_edge.diagnosis.laws import Answer, capped_at_events
from softmap_edge.diagnosis.representatives import Representative, State, ranked

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Step:
    """A family that was taken: its level-2 result, and its alternatives.

    Alternatives are families that this run cannot distinguish from it.
    """

    answer: Answer
    others: tuple[Answer, ...]

    @property
    def family(self) -> Family:
        """The family."""
        return self.answer.family


@dataclass(eq=False)
class Outcome:
    """The result of a search: its steps in order, the joint fit, and a hint.

    Representatives are kept alongside the fit.
    """

    body: FeatureBody
    fits: Fits
    plain: Fits  # without the representatives
    state: State
    null: Floats  # (folds,) held-out loss of the model alone
    loss: Floats  # (folds,) held-out loss of the effects found
    steps: list[Step] = field(default_factory=list)
    hint: Representative | None = None  # the best family, if its loss falls but it was not accepted

    @property
    def fit(self) -> Fit:
        """The laws that were found, fitted together."""
        return self.state.fit

    @property
    def open(self) -> int:
        """The number of families without a law."""
        return sum(not step.answer.identified for step in self.steps)

    @property
    def left(self) -> float:
        """Unexplained share of the error above the noise: the larger of loss and mean square."""
        problem, record = self.body.problem, self.body.record
        noise = rule.ABOVE_NOISE * problem.numbers
        in_loss = (self.loss.sum() - noise) / max(float(self.null.sum()) - noise, 0.25 * noise)
        own = max(
            record.form_mm**2 + self.body.ordinary_mm**2,
            problem.noise.rms_mm(record.positions) ** 2,
        )
        start = record.rms_mm(record.seen - self.fits.null.predicted) ** 2
        # whitened: in mm, imperfections may explain more than the error
        residual = self.state.residual
        now = min(record.rms_mm(residual), record.rms_mm(residual - self.state.ordinary)) ** 2
        return float(max(0.0, in_loss, (now - own) / max(start - own, own)))


def held_out_loss(outcome: Outcome) -> Floats:
    """Return the held-out loss (folds,) of the effects found.

    Families of imperfections are included if they lower it.

    A family without a law counts with its columns, even if a candidate is in the fit.
    """
    state = outcome.state
    ways = (
        [state, State(state.body, state.fit, state.representatives)]
        if state.background
        else [state]
    )
    open_ = [step.family for step in outcome.steps if not step.answer.identified]
    loss = min((ranked(way, open_, open_).before for way in ways), key=np.sum)
    for step in outcome.steps:
        if step.answer.law is not None:
            loss = capped_at_events(loss, step.answer.before, state.fit, step.answer.law.effects)
    return loss


def with_family(state: State, fits: Fits, answer: Answer) -> tuple[State, Fits]:
    """Return state and fits with a family taken.

    Its law joins the fit, or its representative is added.
    """
    if answer.law is not None and answer.law.fit is not None and not answer.rough:
        return State(state.body, answer.law.fit, state.representatives, state.background), fits
    representatives = (*state.representatives, answer.representative)
    fits = fits_alongside(Fits(state.body.problem, fits.candidates), state, representatives)
    return State(
        state.body,
        fits.get(state.fit.effects, state.fit.space.split),
        representatives,
        state.background,
    ), fits


def name_candidates(outcome: Outcome) -> None:
    """Replace the representatives by the candidates of their families."""
    state, rough = outcome.state, [step.answer for step in outcome.steps if step.answer.rough]
    laws = [
        a.law
        for a in rough
        if a.law is not None and not set(a.law.effects) <= set(state.fit.effects)
    ]
    if not laws:
        return
    replaced = {answer.family.name for answer in rough}
    representatives = [one for one in state.representatives if one.family.name not in replaced]
    fits = fits_alongside(outcome.plain, state, representatives)
    effects = [*state.fit.effects, *(e for law in laws for e in law.effects)]
    fit = fits.get(effects, [*state.fit.space.split, *(e for law in laws for e in law.split)])
    outcome.fits, outcome.state = fits, State(state.body, fit, representatives, state.background)


def fits_alongside(plain: Fits, state: State, alongside: Sequence[Representative]) -> Fits:
    """Return fits of the measurement minus the representatives of a state.

    `plain` are the fits without representatives.
    """
    if not alongside:
        return plain
    return Fits(
        _shifted(plain.problem, State(state.body, state.fit, alongside).shift), plain.candidates
    )


def _shifted(problem: Problem, shift: Floats) -> Problem:
    """Return a problem with a shift (K, F) mm subtracted from the measurement."""
    moved = copy(problem)
    moved.record = copy(problem.record)
    moved.record.seen = problem.record.seen - shift
    return moved
