"""Identify the effects that a model lacks, with evidence, alternatives and errors.

Errors are given before and after.

    run → valid frames (clean.py) → candidates, noise, model error (prepare.py)
        → families, then their laws, accepted on held-out blocks (search.py, together.py) →
        certificates from withheld blocks (certificate.py) → findings, alternatives, verdict
        (conclusion.py)

The verdict is one of identified, ambiguous, partly_explained, nothing, cannot_tell,
measurement_fault. `diagnose` is deterministic: the same input gives the same document. Pinned by
tests/diagnosis/test_diagnosis.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.alignment.base_motion import excluded
from softmap_edge.checks.advice import missing_data
from softmap_edge.diagnosis.acceptance import motion_mm
from softmap_edge.diagnosis.behind_residual import masked
from softmap_edge.diagnosis.certificate import certified
from softmap_edge.diagnosis.clean import clean_record, commands_not_followed
from softmap_edge.diagnosis.conclusion import Context, conclude
from softmap_edge.diagnosis.decision import ORDINARY, UNKNOWN_TIMES, VISIBLE_MM
from softmap_edge.diagnosis.document import Diagnosis, with_error
from softmap_edge.diagnosis.evidence import detectability, equivalents, unseen
from softmap_edge.diagnosis.fit import Fit, Problem
from softmap_edge.diagnosis.fits import Fits
from softmap_edge.diagnosis.outcome import Outcome
from softmap_edge.diagnosis.prepare import candidates_of, problem_of
from softmap_edge.diagnosis.record import Record
from softmap_edge.diagnosis.records import record_of
from softmap_edge.diagnosis.refit import refit, shared
from softmap_edge.diagnosis.search import search
from softmap_edge.diagnosis.servo_lag import servos
from softmap_edge.diagnosis.taught import TaughtRuns, with_unknown
from softmap_edge.diagnosis.wording import OwnMisfit
from softmap_edge.diagnosis.wrong_declarations import strange, wrong_load, wrong_sign
from softmap_edge.errors import SoftmapError
from softmap_edge.files.atomic import Document
from softmap_edge.model.effect_info import registry
from softmap_edge.model.servo_calibration import converted
from softmap_edge.model.training_range import BEYOND
from softmap_edge.run.folds import withheld
from softmap_edge.run.run import as_runs

if TYPE_CHECKING:
    from softmap_edge.model.model import Model
    from softmap_edge.run.run import Run

Floats = NDArray[np.float64]

NAMING = ("identified", "ambiguous", "partly_explained")  # verdicts that name what is missing
UNSAID = 0.05  # share of frames that may lie outside the model's training range
# cosine of two whitened signatures above which their form does not distinguish them
ALIKE = 0.95
TWICE = (
    "the diagnosis is relative to a reference run: record each next block twice, once under the "
    "conditions of this run and once under those of the reference, and give the second with "
    "--reference"
)


def diagnose(
    model: Model,
    run: Run | Sequence[Run],
    held_out: Run | None = None,
    effects: Sequence[str] | None = None,
    progress: Callable[[str], None] | None = None,
    reference: Run | Sequence[Run] | None = None,
) -> Diagnosis:
    """Identify the effects that a model lacks.

    Args:
        model: a Model; its chain is kept and not searched again.
        run: the measured run, vertices or markers at K >= 8 seen frames; or several of one robot,
            which share all parameters except those of the camera's frame and clock.
        held_out: an independent run of another kind; effects that increase its error are dropped.
        effects: names of the candidates; all of the registry by default.
        progress: called with one line per stage.
        reference: a run of the same commands that measures the model error (paired replay). Effects
            common to both cancel, and every error is relative to it. Several may be given if runs
            (or `held_out`) play different commands: each uses the one whose commands agree.

    Returns:
        Diagnosis: verdict, families, effects with parameters and sigma, alternatives, untestable
        effects, held-out error ladder.

    Raises:
        SoftmapError: too few frames, unknown effects, a run of another robot, a reference of other
            commands.
    """
    _apart(run, held_out, reference)
    record, remarks = clean_record(model, run, reference)
    candidates, impossible = candidates_of(record, effects)
    fixed = _fixed(record)
    candidates = [name for name in candidates if name not in fixed]
    remarks += [text for name, text in fixed.items() if effects is None or name in effects]
    teacher = TaughtRuns.by(model, as_runs(run))
    problem, outcome = _searched(record, candidates, progress, teacher)
    held = teacher.hidden(record, candidates)
    candidates = [n for n in candidates if n not in {h.name for h in held}]
    other = None if held_out is None else _validation(model, held_out, reference)
    outcome, fit, demoted = _accepted(problem, outcome, candidates, other, progress)
    # wrong parameters of its own effects also cancel
    own = _own_misfit(record) if record.replay is None else None
    proof = certified(outcome, fit, withheld(record.t_seen, record.block, record.begins))
    hidden = [*impossible, *held]
    context = Context(other, demoted, hidden, own, masked(outcome.fits, fit), proof)
    found = conclude(outcome, fit, context)
    again = partial(_again, model, candidates=candidates)
    if (fault := _measurement_fault(record, outcome, fit, found, again)) is not None:
        fit, found = outcome.plain.null, _named_nothing(found, "measurement_fault", fault)
    elif found.verdict in NAMING and (why := _extrapolated(record, outcome)) is not None:
        fit, found = outcome.plain.null, _named_nothing(found, "cannot_tell", why)
    found = with_unknown(model, found, teacher)
    replay = "" if record.replay is None else f" {record.replay}."
    # how reports convert the model's mm to the output's unit
    output = {} if model.output is None else {"output": model.output.to_dict()}
    relearn = teacher.next(found.effects) if record.remapped else []
    runs = [converted(model, run) for run in record.recorded_runs]
    remarks += [] if record.replay is None else [TWICE]
    remarks += [str(teacher)] if teacher.runs else []
    remarks += missing_data(runs, len(record), problem.noise.measured)
    encoded = [run for run in runs if run.present is not None]
    behind = servos(encoded[0], [*candidates, *record.model.chain_names]) if encoded else []
    better = model.with_effects(fit.space.names, shared(fit)) if fit.effects else model
    return replace(
        found,
        sentence=found.sentence + _outside(record) + replay,
        made_from=found.made_from | output,
        next=(*relearn, *found.next),
        learned_in=model.learned_in,
        servo=tuple(behind),
        remarks=tuple(remarks),
        model=with_error(better, found.effects),
    )


def _fixed(record: Record) -> dict[str, str]:
    """Return the frame effects that base markers exclude, and why."""
    least_mm = max(VISIBLE_MM, ORDINARY * motion_mm(record))
    return excluded(record.recorded_runs, record.bases, _reach(record), least_mm)


def _accepted(
    problem: Problem,
    outcome: Outcome,
    candidates: Sequence[str],
    other: Record | None,
    progress: Callable[[str], None] | None,
) -> tuple[Outcome, Fit, list[str]]:
    """Drop effects that do not lower the error on an independent run, or on held-out blocks.

    Returns:
        tuple: the search, repeated if effects were dropped without an independent run; the fit of
        the accepted effects; the names of the dropped ones.
    """
    if other is not None:
        fit, demoted = _demote(outcome.fits, outcome.fit, lambda f: _error_on(f, other), 0.995)
        return outcome, fit, demoted
    # model-form error can hide a static effect's error on unseen blocks; mm show it
    fit, demoted = _demote(outcome.fits, outcome.fit, outcome.fits.held_out_mm, 1.0)
    if not demoted:
        return outcome, fit, demoted
    # search again for what it replaced
    outcome = search(problem, [name for name in candidates if name not in demoted], progress)
    fit, more = _demote(outcome.fits, outcome.fit, outcome.fits.held_out_mm, 1.0)
    return outcome, fit, [*demoted, *more]


def _measurement_fault(
    record: Record,
    outcome: Outcome,
    fit: Fit,
    found: Diagnosis,
    again: Callable[[Sequence[Run]], float],
) -> str | None:
    """Report commands that are not followed, and gravity or a load that is declared wrongly."""
    if not record.remapped:  # a static map follows its training runs as far as it can
        predicted = outcome.state.predicted if outcome.state.representatives else fit.predicted
        if (gone := commands_not_followed(record, predicted)) is not None:
            return gone
    loaded = any(run.load is not None and np.any(run.load) for run in record.recorded_runs)
    if not strange(found, loaded):
        return None
    error = outcome.fits.held_out_mm(fit)
    return wrong_sign(record, error, again) or wrong_load(record, error, again)


def _reach(record: Record) -> float:
    """Return the distance of the farthest measured point from the origin, mm."""
    places = record.seen.reshape(len(record), -1, 3)[:, record.positions]
    return float(np.sqrt(np.nanmax(np.sum(places**2, axis=2), initial=0.0)))


def _apart(
    run: Run | Sequence[Run], held_out: Run | None, reference: Run | Sequence[Run] | None
) -> None:
    """Reject a recording given twice: it would count twice, or validate its own fit."""
    runs = as_runs(run)
    others = as_runs(reference)
    hashes = [one.hash() for one in runs]
    if len(set(hashes)) < len(hashes):
        raise SoftmapError(
            "the same run is given twice, and its noise would count as half; give each recording "
            "once"
        )
    if held_out is not None and held_out.hash() in hashes:
        raise SoftmapError(
            "the held-out run is fitted too, so it validates nothing; give an independent run"
        )
    if set(hashes) & {one.hash() for one in others}:
        raise SoftmapError(
            "the reference is the run itself, so nothing differs; give a recording of before the "
            "change"
        )


def showing(model: Model, run: Run) -> list[Document]:
    """Predict, before any fit, which effects a run would show.

    Each effect at typical strength is compared with the noise.

    Returns:
        list: for each effect `{name, shows, moved_mm, deviations, why, alike, experiment,
        minutes}`: `deviations` is the size of its signature in standard deviations, `alike` the
        effects whose signature is the same here within 5 %, `experiment` the recording that shows
        or separates it.

    Raises:
        SoftmapError: as for `diagnose`.
    """
    record, _ = clean_record(model, run)
    candidates, impossible = candidates_of(record, None)
    problem = problem_of(record, candidates)
    seen = {name: detectability(problem, name) for name in candidates}
    size = {name: float(np.linalg.norm(white)) for name, (_, white) in seen.items()}
    keys = ("name", "shows", "moved_mm", "deviations", "why", "alike", "experiment", "minutes")
    rows: list[tuple[object, ...]] = [
        (h.name, False, None, None, h.why, [], h.experiment, h.minutes) for h in impossible
    ]
    for name, (moved, white) in seen.items():
        why = unseen(moved, size[name])
        twins = equivalents(record, name)
        for other in candidates if why is None else ():
            product = size[name] * size[other]
            if (
                other != name
                and product > 0
                and abs(float(white @ seen[other][1])) > ALIKE * product
            ):
                twins += [other] if other not in twins else []
        rows.append(
            (name, why is None, moved, size[name], why, twins, *registry()[name].experiment)
        )
    found = {row[0]: dict(zip(keys, row)) for row in rows}
    return [found[name] for name in registry() if name in found]


def _searched(
    record: Record,
    candidates: Sequence[str],
    progress: Callable[[str], None] | None,
    teacher: TaughtRuns,
) -> tuple[Problem, Outcome]:
    """Search a record for the effects that its model lacks.

    The learned part of a residual is an effect if laws of the library explain it. Otherwise it may
    be model error. A map learned with --static is solved again if a memory law then explains the
    run.
    """
    if record.static is not None and not record.error_is_noise:
        problem = problem_of(record, candidates, residual=False)
        outcome = search(problem, candidates, progress)
        if outcome.steps and not outcome.open:
            return problem, outcome
    problem = problem_of(record, candidates)
    record.remapped = teacher.remaps
    held = {h.name for h in teacher.hidden(record, candidates)}
    outcome = search(problem, [name for name in candidates if name not in held], progress)
    if record.remapped and not teacher.all and (outcome.open or not outcome.steps):
        record.remapped = False
        outcome = search(problem, candidates, progress)
    return problem, outcome


def _again(model: Model, runs: Sequence[Run], candidates: Sequence[str]) -> float:
    """Return the held-out error of a search on other runs, mm."""
    outcome = search(problem_of(record_of(model, runs), candidates), candidates)
    return outcome.plain.held_out_mm(
        outcome.plain.get(outcome.fit.effects, outcome.fit.space.split)
    )


def _validation(model: Model, held_out: Run, reference: Run | Sequence[Run] | None) -> Record:
    """Return the held-out run, relative to a reference if the others are."""
    try:
        return clean_record(model, held_out, reference)[0]
    except SoftmapError as fault:
        if reference is None:
            raise
        raise SoftmapError(
            f"the held-out run needs a reference of its own commands: {fault}; or leave "
            "--held-out out"
        ) from None


def _named_nothing(found: Diagnosis, verdict: str, why: str) -> Diagnosis:
    """Return a diagnosis without named effects, for a reason outside the search."""
    return replace(
        found,
        verdict=verdict,
        sentence=why,
        alternatives=(),
        effects=(),
        faults=(),
        families=(),
        error=replace(found.error, ladder=(), with_static_residual=None),
    )


def _extrapolated(record: Record, outcome: Outcome) -> str | None:
    """Return why an error is not meaningful if a map extrapolates in most frames.

    Return None if it is meaningful.

    It is meaningful if the other frames also show it, far above the model error.
    """
    coverage = record.model.coverage
    if (
        coverage is None
        or record.replay is not None
        or not isinstance(record.model.prior, _core.Rod)
    ):
        return None
    outside = np.asarray(coverage.outside(record.command), np.bool_)
    count, error, own = (
        int(outside.sum()),
        record.seen - outcome.plain.null.predicted,
        record.form_mm,
    )
    if 2 * count < len(record):
        return None
    near = None if count == len(record) else record.rms_mm(error, ~outside)
    if near is not None and near > UNKNOWN_TIMES * own:
        return None
    others = (
        ""
        if near is None
        else f"; in the others it is {near:.2f} mm off, with a model error of {own:.2f} mm"
    )
    return (
        f"{count} of {len(record)} frames are unlike what '{record.model.robot}' was learned "
        f"from, and its errors there are unknown{others}. So an error of "
        f"{record.rms_mm(error):.2f} mm names no effect: learn the model from a run that covers "
        "these commands."
    )


def _outside(record: Record) -> str:
    """Report the share of a run beyond the model's commands, where it extrapolates."""
    if not len(record):
        return ""
    low, high = np.asarray(record.model.command_range, float).T
    slack = BEYOND * (high - low)
    beyond = np.any((record.command < low - slack) | (record.command > high + slack), axis=1).mean()
    if beyond < UNSAID:
        return ""
    return (
        f" {100 * beyond:.0f} % of the frames lie beyond the commands that made the model; it "
        "extrapolates there."
    )


def _own_misfit(record: Record) -> OwnMisfit | None:
    """Return the gain from refitting the model's own effects, if it is large."""
    if not record.model.chain_names:
        return None
    report = refit(record.model, record.recorded_runs)[1]
    if not report.doubts_model:
        return None
    names = tuple(record.model.chain_names)
    return OwnMisfit(names, report.before_rms_mm, report.after_held_out_rms_mm)


def _error_on(fit: Fit, other: Record) -> float:
    """Return the error mm of a fit on an independent run."""
    return other.rms_mm(other.seen - fit.on(other))


def _demote(
    fits: Fits, fit: Fit, error: Callable[[Fit], float], share: float
) -> tuple[Fit, list[str]]:
    """Drop members, or all at once, while the `error` without them is at most `share`.

    The error is in mm, on held-out data.
    """
    demoted: list[str] = []
    while fit.effects:
        rests = [fits.null, *(fits.without(fit, e) for e in fit.effects)]
        best = min(rests, key=error)
        if error(best) > share * error(fit):
            break
        demoted += [e for e in fit.effects if e not in best.effects]
        fit = best
    return fit, demoted
