"""Effects that a model's residual may hide.

They are static effects that look like it and do not contradict the run.

A diagnosis removes the residual. If laws of the library explain the learned part, the diagnosis
names them. If not, a static field of its size is not evidence: it may be model error or an effect.
`problem_of` adds model-form error in the same directions; a rod's is noise. Effects of memory,
orientation or load are then found as without a residual.

This module diagnoses the residual itself: each effect is fitted to it alone. An effect may have
been learned if it explains HIDES of the residual's mean square. It must also not increase the
misfit of the run. Only a run in which the two differ can decide. A residual hides nothing if it is
within the model error, or does not lower this run's error. Units: mm. Limit: effects are fitted to
the residual one by one. Pinned by tests/adaptation/test_residual.py.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis.decision import VISIBLE_MM
from softmap_edge.diagnosis.findings import Untestable
from softmap_edge.diagnosis.fit import Fit, Problem
from softmap_edge.diagnosis.fits import Fits
from softmap_edge.diagnosis.record import Record
from softmap_edge.model.effect_info import registry
from softmap_edge.noise.noise_model import form_covariance

Floats = NDArray[np.float64]

OWN = 1.5  # least size of a residual that can hide an effect, times the model error
HIDES = 0.6  # of the residual's mean square: least share that a hidden effect explains
LOOKED_AT = 8  # best-fitting effects that are compared with the residual
AGAINST = 9.0  # of the objective over the over-dispersion: three standard deviations


@dataclass(frozen=True)
class ResidualConfounds:
    """What a removed residual may contain.

    It holds its size on the run before and after the effects found. It holds the run's error with
    and without it. It also holds the effects that it may contain (share), and the part that may be
    model error.
    """

    size_mm: float
    left_mm: float
    with_mm: float
    without_mm: float
    may_be: tuple[tuple[str, float], ...]
    own_mm: float

    def untestable(self) -> list[Untestable]:
        """Return the effects that the residual may hide, with the experiment to record."""
        return [
            Untestable(
                name,
                f"the model's residual of {self.size_mm:.2f} mm RMS may be it: it explains "
                f"{100 * share:.0f} % of that",
                *_other_conditions(name),
            )
            for name, share in self.may_be
        ]

    def __str__(self) -> str:
        size = (
            f"The model's residual of {self.size_mm:.2f} mm RMS was taken out (error on this run "
            f"{self.with_mm:.2f} mm RMS with it, {self.without_mm:.2f} mm RMS without, nothing "
            "fitted)"
        )
        if self.may_be:
            which = ", ".join(f"{name} ({100 * share:.0f} % of it)" for name, share in self.may_be)
            return f"{size}; it may hide {which}"
        if self.with_mm >= self.without_mm:
            return f"{size}; it does not lower the error of this run"
        if self.left_mm <= self.own_mm:
            return (
                f"{size}; {self.left_mm:.2f} mm RMS of it are unexplained (fitted), up to "
                f"{self.own_mm:.2f} mm RMS may be model error"
            )
        return (
            f"{size}; no single effect explains the remaining {self.left_mm:.2f} mm RMS of it "
            "(fitted)"
        )


def masked(fits: Fits, fit: Fit) -> ResidualConfounds | None:
    """Return what the removed residual may hide besides the effects of a fit.

    None without a residual.
    """
    record = fits.problem.record
    if record.static is None:
        return None
    shift = fit.predicted - fits.null.predicted
    left = min((record.static, record.static - shift), key=record.rms_mm)
    size, without = record.rms_mm(record.static), record.rms_mm(record.seen - fits.null.predicted)
    with_mm = record.rms_mm(record.seen - fits.null.predicted - record.static)
    # independent of the noise of this run: it was learned from another
    own = max(VISIBLE_MM, OWN * record.form_mm)
    may_be = _may_be(fits, fit, left) if record.rms_mm(left) > own and with_mm < without else []
    return ResidualConfounds(size, record.rms_mm(left), with_mm, without, tuple(may_be), own)


def _may_be(fits: Fits, fit: Fit, left: Floats) -> list[tuple[str, float]]:
    record = fits.problem.record
    known = registry()
    missing = [e for e in fits.candidates if e not in fit.effects and not known[e].is_fault]
    if not missing:
        return []
    alone = Fits(_as_if_seen(fits, left), missing)
    best = sorted((alone.get((effect,)) for effect in missing), key=lambda one: one.cost)[
        :LOOKED_AT
    ]
    found = []
    for one in best:
        (effect,) = one.effects
        share = (
            1.0 - (record.rms_mm(left - alone.displacement(one, effect)) / record.rms_mm(left)) ** 2
        )
        if share >= HIDES and not _against(fits, fit, one, effect):
            found.append((effect, float(share)))
    return sorted(found, key=lambda pair: -pair[1])


def _as_if_seen(fits: Fits, field: Floats) -> Problem:
    """Return the problem in which `field` (K, F) mm is the only error of the model.

    The problem has no model-form error.
    """
    problem = fits.problem
    record: Record = copy(problem.record)
    record.static = None
    record.seen = np.where(np.isfinite(record.seen), fits.null.predicted + field, np.nan)
    own = form_covariance(record.form_error, record.positions, record.section) * (
        not record.error_is_noise
    )
    form = np.einsum("mf,fg,mg->m", problem.whitener.project, own, problem.whitener.project)
    return Problem(record, problem.noise, replace(problem.whitener, form=form), problem.base)


def _against(fits: Fits, fit: Fit, alone: Fit, effect: str) -> bool:
    """Whether the run contradicts an effect with the parameters fitted to the residual."""
    problem, record = fits.problem, fits.problem.record
    space = problem.space((*fit.effects, effect))
    params = np.array([[(fit.params | alone.params)[label] for label in space.labels]])
    params[0, space.free] = np.clip(
        params[0, space.free], *(space.values(x) for x in (space.low, space.high))
    )
    x = space.scaled(params[0, space.free])
    predicted = record.predict(space.names, space.params(x[None]))
    cost = float(problem.costs(problem.modes(predicted), x[None])[0][0])
    worse = (cost - fit.cost) / fits.dispersion(fit) > AGAINST
    return bool(
        worse
        or record.rms_mm(record.seen - predicted[0]) >= record.rms_mm(record.seen - fit.predicted)
    )


def _other_conditions(name: str) -> tuple[str, float]:
    """Return what to record to separate an effect from a static field.

    For a weight, this is another orientation.
    """
    info = registry()[name]
    return ("another orientation", 1.0) if info.family == "dead load" else info.experiment
