"""What a search holds: the families taken, their joint fit, representatives alongside.

A resolved law joins the fit. A family without a law stays as its representative: what that explains
is taken off what is seen before the next fit. Pinned by tests/diagnosis/test_two_levels.py.
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
    """One family that was taken: its answer at level 2, and its alternatives.

    These are the families that this run cannot distinguish from it.
    """

    answer: Answer
    others: tuple[Answer, ...]

    @property
    def family(self) -> Family:
        """The family."""
        return self.answer.family


@dataclass(eq=False)
class Outcome:
    """What a search found: its steps in order, the joint fit, and a hint at more.

    Representatives stand alongside the fit.
    """

    body: FeatureBody
    fits: Fits
    plain: Fits  # without the representatives
    state: State
    null: Floats  # (folds,) held-out loss of the model alone
    loss: Floats  # (folds,) held-out loss of what was found
    steps: list[Step] = field(default_factory=list)
    hint: Representative | None = None  # the best family, if it was not accepted but falls

    @property
    def fit(self) -> Fit:
        """The laws that were found, fitted together."""
        return self.state.fit

    @property
    def open(self) -> int:
        """How many families have no law."""
        return sum(not step.answer.resolved for step in self.steps)

    @property
    def left(self) -> float:
        """Unexplained share of what was above the noise: the larger of loss and mean square."""
        problem, record = self.body.problem, self.body.record
        noise = rule.ABOVE_NOISE * problem.numbers
        in_loss = (self.loss.sum() - noise) / max(float(self.null.sum()) - noise, 0.25 * noise)
        own = max(
            record.form_mm**2 + self.body.ordinary_mm**2,
            problem.noise.rms_mm(record.positions) ** 2,
        )
        start = record.rms_mm(record.seen - self.fits.null.predicted) ** 2
        # it is whitened: in mm, imperfections may explain more than is there
        residual = self.state.residual
        now = min(record.rms_mm(residual), record.rms_mm(residual - self.state.ordinary)) ** 2
        return float(max(0.0, in_loss, (now - own) / max(start - own, own)))


def held_out_loss(outcome: Outcome) -> Floats:
    """Return the held-out loss (folds,) of what was found.

    Families of imperfections are included where they lower it.

    A family without a law counts with its columns, whether a candidate is in the fit or not.
    """
    state = outcome.state
    ways = (
        [state, State(state.body, state.fit, state.representatives)]
        if state.background
        else [state]
    )
    open_ = [step.family for step in outcome.steps if not step.answer.resolved]
    loss = min((ranked(way, open_, open_).before for way in ways), key=np.sum)
    for step in outcome.steps:
        if step.answer.law is not None:
            loss = capped_at_events(loss, step.answer.before, state.fit, step.answer.law.effects)
    return loss


def with_family(state: State, fits: Fits, answer: Answer) -> tuple[State, Fits]:
    """Return state and fits with a family taken.

    Its law joins the fit, or else its representative stands alongside.
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
    """Put candidates in the place of the representatives that stood for their families."""
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
    """Return fits of what is seen less what representatives explain about a state.

    `plain` are those without any.
    """
    if not alongside:
        return plain
    return Fits(
        _shifted(plain.problem, State(state.body, state.fit, alongside).shift), plain.candidates
    )


def _shifted(problem: Problem, shift: Floats) -> Problem:
    """Return a problem with a shift (K, F) mm taken off what is seen."""
    moved = copy(problem)
    moved.record = copy(problem.record)
    moved.record.seen = problem.record.seen - shift
    return moved
