"""Convert a finished search to a diagnosis: findings, parameters, alternatives, open points.

Nothing is searched here. Units: mm. Pinned by tests/diagnosis/test_diagnosis.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis import decision as rule
from softmap_edge.diagnosis.alternatives import alternatives_of, named_by
from softmap_edge.diagnosis.behind_residual import ResidualConfounds
from softmap_edge.diagnosis.certificate import Certified
from softmap_edge.diagnosis.changing import Change, changing
from softmap_edge.diagnosis.document import Diagnosis
from softmap_edge.diagnosis.evidence import (
    by_condition,
    ladder,
    not_testable,
    unexplained_structure,
)
from softmap_edge.diagnosis.families import families
from softmap_edge.diagnosis.findings import (
    Alternative,
    Certificate,
    Displacement,
    ErrorLadder,
    FamilyFinding,
    Finding,
    NextBlock,
    Number,
    Untestable,
    Where,
)
from softmap_edge.diagnosis.fit import Fit
from softmap_edge.diagnosis.fits import Fits
from softmap_edge.diagnosis.fitted import parameters, refitted, shift_on
from softmap_edge.diagnosis.outcome import Outcome, Step
from softmap_edge.diagnosis.prepare import load_seen
from softmap_edge.diagnosis.record import Record
from softmap_edge.diagnosis.separate import mended, next_blocks, refits
from softmap_edge.diagnosis.wording import (
    OwnMisfit,
    at_bounds,
    sentence_of,
    unconfirmed,
    verdict_of,
)
from softmap_edge.files.atomic import Document
from softmap_edge.model.effect_info import Registry, registry
from softmap_edge.model.learned_in import Certainty
from softmap_edge.model.user_effect import hashes
from softmap_edge.noise.floor import noise_of_runs
from softmap_edge.noise.memoryless import repeats_of
from softmap_edge.noise.motion_at_rest import MotionAtRest
from softmap_edge.noise.noise_model import motion_left
from softmap_edge.run.folds import labelled

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Context:
    """Data from outside the search.

    An independent run, effects dropped or not tried, and certificates.
    """

    other: Record | None = None
    demoted: Sequence[str] = ()
    impossible: Sequence[Untestable] = ()
    own: OwnMisfit | None = None
    masked: ResidualConfounds | None = None
    proof: Certified | None = None


@dataclass(frozen=True, eq=False)
class _Claims:
    """What a search claims.

    Attributes:
        order: the named effects, faults first, then by explained error.
        findings: their findings, in this order.
        families: the detected families.
        alternatives: what cannot be excluded.
        error: the error ladder.
        residual: the remaining error (K, F) mm.
        moving: the motion at rest.
        changes: laws whose parameters change with a condition.
        unknown: whether an unknown error remains.
    """

    order: list[str]
    findings: list[Finding]
    families: tuple[FamilyFinding, ...]
    alternatives: list[Alternative]
    error: ErrorLadder
    residual: Floats
    moving: Sequence[MotionAtRest]
    changes: list[Change]
    unknown: bool


def conclude(outcome: Outcome, fit: Fit, context: Context) -> Diagnosis:
    """Convert a finished search to a diagnosis without remarks, servos and model.

    Args:
        outcome: the search.
        fit: the accepted laws, after demotion.
        context: data from outside the search.
    """
    fits, known, own = outcome.fits, registry(), context.own
    record = outcome.body.problem.record
    standing = [s for s in outcome.steps if not set(named_by(s)) & set(context.demoted)]
    claims = _claims(outcome, fit, context, standing, known)
    left = replace(
        unexplained_structure(outcome.body.problem, claims.residual, len(fit.x)),
        ordinary_mm=_ordinary_mm(outcome) or None,
    )
    faults = tuple(f for f in claims.findings if known[f.name].is_fault)
    physics = tuple(f for f in claims.findings if not known[f.name].is_fault)
    refit_first = own is not None and own.after_mm <= claims.error.after
    doubts = [
        *([str(own)] if own is not None and not refit_first else []),
        *at_bounds(claims.findings),
        *record.doubts,
        *map(str, claims.changes),
        *unconfirmed([*claims.findings, *claims.families]),
    ]
    behind = [] if context.masked is None else context.masked.untestable()
    hidden = [*behind, *context.impossible]
    hidden += [h for h in not_testable(fits, fit) if h.name not in {b.name for b in hidden}]
    is_open = any(s.answer.open for s in standing)
    # A limit of the model is not a limit of the run.
    recordable, others = (
        sum(not h.of_model for h in every) for every in (hidden, context.impossible)
    )
    verdict = verdict_of(
        physics or (faults if _physical(claims.alternatives, known) or is_open else ()),
        faults,
        refit_first or bool(claims.alternatives or doubts or is_open),
        claims.unknown,
        bool(claims.families),
        recordable,
        len(fits.candidates) + others,
    )
    if verdict == "nothing" and behind:
        verdict, hidden = "cannot_tell", behind
    sentence = sentence_of(
        verdict,
        physics,
        faults,
        claims.families,
        claims.alternatives,
        left,
        hidden,
        claims.error,
        context.demoted,
        "" if outcome.hint is None else outcome.hint.family.name,
    )
    return Diagnosis(
        verdict=verdict,
        sentence=_with_doubts(sentence, context, refit_first, doubts, claims.moving),
        effects=physics,
        faults=faults,
        families=_with_motion(claims.families, claims.moving),
        alternatives=tuple(claims.alternatives),
        not_testable=tuple(hidden),
        where=Where(
            by_condition(record, record.seen - fits.null.predicted),
            by_condition(record, claims.residual),
        ),
        error=claims.error,
        unexplained=left,
        next=(
            *mended(faults),
            *refits(own),
            *(NextBlock(*one.experiment, one.effects) for one in claims.changes),
            *next_blocks(claims.alternatives, hidden, known, claims.order, claims.families),
        ),
        made_from=_made_from(outcome, claims.order, context, known),
    )


def _claims(
    outcome: Outcome, fit: Fit, context: Context, standing: Sequence[Step], known: Registry
) -> _Claims:
    """Return what a search claims; `standing` are its steps after demotion."""
    order = _order(outcome.fits, fit, known)
    alternatives = alternatives_of(
        outcome, fit, standing, known, context.demoted, context.impossible, context.own
    )
    residual = _residual(outcome, fit)
    dropped = outcome.steps if not standing and context.other is None else []  # all that was found
    moving = _moving(outcome, residual, explained=bool(order))
    changes = [one for one in changing(outcome) if not set(one.effects) & set(context.demoted)]
    unknown = bool(moving or changes) or _unknown(
        outcome, fit, context.own, standing, bool(dropped)
    )
    findings = [
        _finding(outcome, fit, name, context, alternatives, unknown, known) for name in order
    ]
    families = tuple(_family(outcome, s, context.proof, changes) for s in standing)
    families += tuple(
        replace(_family(outcome, s, None, ()), law="unknown", effects=()) for s in dropped
    )
    if unknown and not families:
        families = _hints(outcome, residual)
    error = _error(outcome, order, context.other)
    return _Claims(
        order, findings, families, alternatives, error, residual, moving, changes, unknown
    )


def _residual(outcome: Outcome, fit: Fit) -> Floats:
    """Return the error (K, F) mm that the accepted laws leave."""
    record = outcome.body.problem.record
    residual = record.seen - fit.predicted - outcome.state.shift
    if not record.remapped:
        return residual
    # the re-solved map cancels part of each representative
    ways = (residual, residual - outcome.state.ordinary, record.seen - fit.predicted)
    return min(ways, key=record.rms_mm)


def _moving(outcome: Outcome, residual: Floats, explained: bool) -> Sequence[MotionAtRest]:
    """Return the motion at rest; slow settling also moves at rest, until it is `explained`."""
    problem = outcome.body.problem
    record, moving = problem.record, problem.noise.moving
    if not moving or not explained:
        return moving
    return motion_left(residual, record.seen, record.positions, record.t_seen, record.state).found


def _hints(outcome: Outcome, residual: Floats) -> tuple[FamilyFinding, ...]:
    """Return the nearest family of an unknown error that no family was detected for, if any."""
    hints = _memoryless(outcome.body.problem.record, residual)
    if (near := outcome.hint) is not None:
        share = 1.0 - near.left / max(float(outcome.null.sum()), 1e-300)
        hints.append(
            FamilyFinding(near.family.name, near.family.kind, "unknown", (), share, near.moved_mm)
        )
    return tuple(sorted(hints, key=lambda one: -one.share)[:1])


def _with_doubts(
    sentence: str,
    context: Context,
    refit_first: bool,
    doubts: Sequence[str],
    moving: Sequence[MotionAtRest],
) -> str:
    """Return the sentence of a diagnosis with its doubts, and what must be done before."""
    first = f"Refit first: {context.own}. The findings below may be due to it. "
    return (
        (first if refit_first else "")
        + sentence
        + "".join(f" But {doubt}." for doubt in doubts)
        + "".join(f" Moreover, {motion}." for motion in moving)
        + ("" if context.masked is None else f" {context.masked}.")
    )


def _order(fits: Fits, fit: Fit, known: Registry) -> list[str]:
    """Return the effects of a fit: faults first, then by explained error."""
    weight = {e: max(fits.share(fit, e), 0.0) for e in fit.effects}
    return sorted(fit.effects, key=lambda e: (not known[e].is_fault, -weight[e], e))


def _unknown(
    outcome: Outcome, fit: Fit, own: OwnMisfit | None, standing: Sequence[Step], dropped: bool
) -> bool:
    """Whether an unknown error remains.

    It has no law and is not part of the named effects, or far exceeds the model error.
    """
    if own is not None and own.after_mm <= outcome.fits.held_out_mm(fit):
        return False  # other parameters of the model's own effects explain the unexplained error
    if dropped or any(
        s.answer.law is None or (s.answer.rough and not s.answer.open) for s in standing
    ):
        return True
    if standing:
        return outcome.left > rule.LEFT
    problem, record = outcome.body.problem, outcome.body.record
    floor = max(record.form_mm, problem.noise.rms_mm(record.positions))
    return (
        record.rms_mm(outcome.state.residual - outcome.state.ordinary) > rule.UNKNOWN_TIMES * floor
    )


def _family(
    outcome: Outcome, step: Step, proof: Certified | None, changes: Sequence[Change]
) -> FamilyFinding:
    """Return the finding of one family."""
    answer, null = step.answer, float(outcome.null.sum())
    explained = max(null - float(outcome.loss.sum()), 1e-300)
    own = float(answer.before.sum()) - answer.representative.left
    laws = [law for law in answer.tried if law.effects]
    best = min((law.left for law in laws), default=None)
    named = [answer.law] if answer.law is not None else []
    others = () if answer.identified else answer.equals
    effects = [e for law in (*named, *others) for e in law.effects]
    law: Certainty = "open" if answer.open else "unknown"
    if answer.identified and not any(set(one.effects) & set(effects) for one in changes):
        law = "identified"
    return FamilyFinding(
        answer.family.name,
        answer.family.kind,
        law,
        tuple(dict.fromkeys(effects)),
        float(np.clip(own / explained, 0.0, 1.0)),
        answer.representative.moved_mm,
        None
        if best is None
        else float(np.clip((float(answer.before.sum()) - best) / max(own, 1e-300), 0.0, 1.0)),
        tuple(law.name for law in answer.reaching if not law.effects),
        tuple(a.family.name for a in step.others),
        None if proof is None else proof.families.get(answer.family.name),
    )


def _memoryless(record: Record, residual: Floats) -> list[FamilyFinding]:
    """Return the unexplained error as an unknown static map, if it is one.

    It is one if repeated commands show the same error; otherwise return nothing.

    Its form may be too fine for the columns of the static family.
    """
    places = residual.reshape(len(residual), -1, 3)[:, record.positions].reshape(len(residual), -1)
    again = repeats_of(places, record.state, load_seen(record))
    left = 0.0 if again is None else record.rms_mm(residual, again.rows)
    if again is None or again.mm**2 > 0.5 * left**2:
        return []
    moved = float(np.sqrt(left**2 - again.mm**2))
    return [FamilyFinding("static map", "static", "unknown", (), (moved / left) ** 2, moved)]


def _with_motion(
    families: Sequence[FamilyFinding], moving: Sequence[MotionAtRest]
) -> tuple[FamilyFinding, ...]:
    """Insert the unexplained motion at rest into the families, by size.

    No effect or family of the library describes it.
    """
    found = list(families)
    for one in moving:
        name = "motion at rest" if one.frequency_hz is None else "hum"
        place = next(
            (i for i, family in enumerate(found) if family.moved_mm < one.rms_mm), len(found)
        )
        found.insert(place, FamilyFinding(name, "time", "unknown", (), 0.0, one.rms_mm))
    return tuple(found)


def _finding(
    outcome: Outcome,
    fit: Fit,
    name: str,
    context: Context,
    alternatives: Sequence[Alternative],
    unknown: bool,
    known: Registry,
) -> Finding:
    """Return the finding of one effect."""
    fits, problem = outcome.fits, outcome.body.problem
    record, other = problem.record, context.other
    sigma = problem.uncertainty(fit, fits.dispersion(fit))
    is_fault = known[name].is_fault
    alike = [e for e in fit.effects if known[e].is_fault == is_fault]
    total = sum(max(fits.share(fit, e), 0.0) for e in alike)
    step = next((s for s in outcome.steps if name in named_by(s)), None)
    numbers = parameters(record, fit, sigma, (name,))
    certificate = None if context.proof is None else context.proof.effects.get(name)
    return Finding(
        name=name,
        family=step.family.name if step else known[name].family,
        stage=known[name].stage,
        params=numbers,
        displacement_mm=Displacement(
            record.rms_mm(fits.displacement(fit, name)),
            None if other is None else other.rms_mm(shift_on(fit, other, name)),
        ),
        share=max(fits.share(fit, name), 0.0) / max(total, 1e-300),
        probability=None
        if record.model.kind == "rod"
        else _probability(step, name, numbers, alternatives, unknown, certificate),
        refitted=refitted(fits, fit, sigma, name),
        certificate=certificate,
    )


def _probability(
    step: Step | None,
    name: str,
    numbers: Mapping[str, Number],
    alternatives: Sequence[Alternative],
    unknown: bool,
    certificate: Certificate | None = None,
) -> float:
    """Return the probability of an effect, or an equivalent one, from the odds against it."""
    doubts = (
        sum(a.member == name for a in alternatives)
        + any(p.at_bound for p in numbers.values())
        + unknown
    )
    doubts += certificate is not None and certificate.refuted
    odds = rule.ODDS_BASE + rule.ODDS_DOUBT * doubts
    if step is not None and not step.answer.identified:
        # all fitting laws are equally likely, and so is an untried one
        odds += 1.0 + len(step.answer.reaching)
    return 1.0 / (1.0 + odds)


def _physical(alternatives: Sequence[Alternative], known: Registry) -> bool:
    """Whether an alternative, or a law of its family, is physics, not a measurement fault."""
    members = {family.name: family.members for family in families()}
    laws = (
        name
        for a in alternatives
        for name in a.effects or members.get(a.family, ())
        if name in known
    )
    return any(not known[name].is_fault for name in laws)


def _ordinary_mm(outcome: Outcome) -> float:
    """Return the size of the robot's ordinary static imperfections, mm RMS.

    It is the part that they explain, or else their level.
    """
    state = outcome.state
    explained = state is not state.without_background()
    return outcome.body.record.rms_mm(state.ordinary) if explained else outcome.body.ordinary_mm


def _error(outcome: Outcome, order: Sequence[str], other: Record | None) -> ErrorLadder:
    """Return the error ladder, with its floors."""
    problem, fits = outcome.body.problem, outcome.plain
    record = problem.record
    split = outcome.fit.space.split
    model, static, rungs, both, per_fold = ladder(fits, order, split, other)
    noise, form = problem.noise.rms_mm(record.positions), record.form_mm
    apart = not record.error_is_noise
    measured = apart and problem.noise.measured
    kind = "labelled blocks" if labelled(record.block) else "blocks"
    on = f"{kind} of the run that was fitted" if other is None else "an independent run"
    return ErrorLadder(
        model,
        static,
        rungs,
        both,
        per_fold,
        noise_floor=noise if apart else None,
        model_floor=form,
        floor=noise if measured else form,
        floor_kind="measured noise" if measured else "the model's own held-out error",
        held_out_on=on + ("" if record.replay is None else ", relative to the reference"),
    )


def _made_from(
    outcome: Outcome, order: Sequence[str], context: Context, known: Registry
) -> Document:
    from softmap_edge.version import __version__

    problem, other = outcome.body.problem, context.other
    record = problem.record
    return {
        "softmap": __version__,
        "run": record.recorded_runs[0].hash()
        if len(record.recorded_runs) == 1
        else [run.hash() for run in record.recorded_runs],
        "held_out": None if other is None else other.recorded_runs[0].hash(),
        "reference": None if record.replay is None else asdict(record.replay),
        "residual": None if context.masked is None else asdict(context.masked),
        "frames": len(record),
        "robot": record.model.robot,
        "own_effects": list(record.model.chain_names),
        "python_effects": hashes([*record.model.chain_names, *outcome.fits.candidates]),
        "candidates": outcome.fits.candidates,
        "demoted": list(context.demoted),
        "noise": problem.noise.source,
        "noise_of_points_mm": noise_of_runs(record.recorded_runs),
        "inflation": problem.noise.inflation,
        "modes": len(problem.whitener.form),
        "references": {name: known[name].reference for name in order},
    }
