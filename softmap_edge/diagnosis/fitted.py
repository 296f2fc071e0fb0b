"""Results of a fit for one effect.

Its parameters, the prior parameters fitted with it, and its size at other commands.

Units: those of the parameters, mm. Pinned by tests/diagnosis/test_diagnosis.py.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.diagnosis.evidence import at_bound
from softmap_edge.diagnosis.findings import Number, Refitted
from softmap_edge.diagnosis.fit import Fit
from softmap_edge.diagnosis.fits import Fits
from softmap_edge.diagnosis.record import Record
from softmap_edge.diagnosis.spools import RADIUS
from softmap_edge.model.effect_info import effects_that

Floats = NDArray[np.float64]


def parameters(
    record: Record, fit: Fit, sigma: Floats, names: Sequence[str], declared: bool = True
) -> dict[str, Number]:
    """Return the fitted parameters of the effects `names` by label.

    These are the parameters of the effects, or those of the prior that were free with them. A
    parameter that encodes a case has its `meaning` in words.
    """
    values, bound = fit.space.values(fit.x), at_bound(fit)
    in_commands = effects_that("channel")
    found = {}
    for j, i in enumerate(fit.space.free):
        label, unit = fit.space.labels[i], fit.space.units[i]
        if label.split(".")[0] not in names or fit.space.declared[j] != declared:
            continue
        if unit == "g" and not record.model.structure.stiffness_known:
            unit = "of the model's own load scale"  # a value in grams would be unfounded
        if label.split(".")[0] in in_commands:
            unit = unit.replace("mm", record.model.command_unit)
        meaning = None
        if fit.space.integer[j]:
            chain = _core.Chain([label.split(".")[0]], record.model.channels)
            meaning = (
                dict(zip(chain.labels, chain.meanings([fit.params[own] for own in chain.labels])))[
                    label
                ]
                or None
            )
        found[label] = Number(float(values[j]), float(sigma[j]), unit, bool(bound[j]), meaning)
    if (
        declared
        and record.spool is not None
        and RADIUS in fit.space.labels
        and RADIUS.split(".")[0] in names
    ):
        unit = record.model.command_unit
        found[RADIUS] = Number(fit.params[RADIUS], record.spool.sigma, unit, False, None)
    return found


def refitted(fits: Fits, fit: Fit, sigma: Floats, name: str) -> Refitted | None:
    """Return changes of the prior's parameters fitted with an effect, and the new error.

    The error (F,) mm of each feature is on held-out blocks. With other parameters the model is
    different; a rod's next diagnosis uses this error as noise.
    """
    problem, record = fits.problem, fits.problem.record
    changes = parameters(record, fit, sigma, (name,), declared=False)
    if not changes:
        return None
    squares = np.full_like(record.seen, np.nan)
    for prediction, (_, test) in zip(fits.losses(fit)[1], problem.folds):
        squares[test] = (record.seen[test] - prediction[test]) ** 2
    error = np.sqrt(np.nanmean(squares, axis=0))
    if record.replay is not None:  # errors common with the reference remain
        own = [np.ravel(part.model.run_form_error(part.run)) for part in record.parts]
        error = np.maximum(error, np.sqrt(np.mean(np.square(own), axis=0)))
    return Refitted(changes, tuple(map(float, error)))


def shift_on(fit: Fit, other: Record, name: str) -> Floats:
    """Return the contribution (K, F) mm of one effect on another run, with the others present."""
    layout = other.layout(fit.space.names, fit.space.split)
    params = layout.values(fit.params)
    mine = np.array([label.split(".")[0] == name for label in layout.labels])
    both = np.stack([params, np.where(mine, layout.null, params)])
    shift = other.predict(fit.space.names, layout.full(both))
    return np.asarray(shift[0] - shift[1])
