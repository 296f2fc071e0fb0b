"""Refit a model's own effects to a run.

Pinned by tests/diagnosis/test_diagnosis.py, tests/diagnosis/test_several_runs.py and
tests/model/test_shared_numbers.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from softmap_edge.diagnosis.clean import clean_record
from softmap_edge.diagnosis.findings import Number, plain
from softmap_edge.diagnosis.fit import Fit, Problem
from softmap_edge.diagnosis.fits import carried
from softmap_edge.diagnosis.fitted import parameters
from softmap_edge.diagnosis.prepare import problem_of
from softmap_edge.errors import SoftmapError
from softmap_edge.files.atomic import Document
from softmap_edge.model.learned_in import LearnedNumber

if TYPE_CHECKING:
    from softmap_edge.model.model import Model
    from softmap_edge.run.run import Run

# fall of the held-out error by a refit above which the model's own parameters are in doubt
OWN_FALL = 0.7


@dataclass(frozen=True)
class RefitReport:
    """The result of a refit of a model's own effects.

    Attributes:
        params: the new parameters by label.
        before_rms_mm: error of the model as it was, mm RMS.
        after_held_out_rms_mm: error with the new parameters on held-out blocks, mm RMS.
    """

    params: dict[str, Number]
    before_rms_mm: float
    after_held_out_rms_mm: float

    @property
    def doubts_model(self) -> bool:
        """Whether the error falls so far that the model's own parameters are in doubt."""
        return self.after_held_out_rms_mm <= OWN_FALL * self.before_rms_mm

    def to_dict(self) -> Document:
        """Return the report in document form."""
        return {
            "params": plain(self.params),
            "before_rms_mm": self.before_rms_mm,
            "after_held_out_rms_mm": self.after_held_out_rms_mm,
        }


def refit(model: Model, run: Run | Sequence[Run]) -> tuple[Model, RefitReport]:
    """Refit a model's own effects to a run, per channel if that is far better.

    Args:
        model: a model with effects.
        run: the measured run, or several of one robot.

    Returns:
        tuple: the model with new parameters, and a report with the parameters and both errors.

    Raises:
        SoftmapError: the model has no effects.
    """
    own = tuple(model.chain_names)
    if not own:
        raise SoftmapError(
            "the model has no effects to refit; `softmap diagnose` finds out which it lacks"
        )
    record, _ = clean_record(model, run)
    problem = problem_of(record, list(own))
    space = problem.space(own, free=own)
    now = space.scaled(record.own()[space.free])
    before = problem.null()
    fit = problem.fit(own, [now, space.start], free=own)
    after = problem.held_out_mm(problem.fold_predictions(fit))
    each = _for_each_channel(problem, fit)
    if (apart := problem.held_out_mm(problem.fold_predictions(each))) <= OWN_FALL * after:
        fit, after = each, apart
    sigma = problem.uncertainty(fit, max(1.0, fit.chi2 / max(1.0, problem.numbers)))
    numbers = parameters(record, fit, sigma, own)
    error = record.rms_mm(record.seen - before.predicted)
    refitted = _relearned(model.with_effects(own, shared(fit)), numbers)
    return refitted, RefitReport(numbers, error, after)


def shared(fit: Fit) -> dict[str, float]:
    """Return a model's fitted parameters, without those of single later runs."""
    return {label: value for label, value in fit.params.items() if "@" not in label}


def _for_each_channel(problem: Problem, fit: Fit) -> Fit:
    """Return a fit of a model's own effects with one parameter per channel."""
    space = problem.space(fit.effects, free=fit.effects, split=fit.effects)
    if space.free_labels == fit.space.free_labels:
        return fit
    return problem.fit(fit.effects, [carried(fit, space)], free=fit.effects, split=fit.effects)


def _relearned(model: Model, numbers: Mapping[str, Number]) -> Model:
    """Update the parameters in a model's record of learned effects from a later fit."""
    fresh = [
        LearnedNumber(label, n.value, n.sigma or 0.0, n.unit, n.at_bound)
        for label, n in numbers.items()
    ]
    records = [
        replace(
            one, params=tuple(n for n in fresh if n.label.split(".")[0] == one.name) or one.params
        ).to_dict()
        for one in model.learned_in
    ]
    return (
        replace(model, made_from={**model.made_from, "learned_in": records}) if records else model
    )
