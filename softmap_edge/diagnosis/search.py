"""The two-level search: families one after another, then all again together.

Each family has a law if one is identified.

    rank families about the state -> accept the best -> find the laws of those near it ->
    take one -> repeat

If the best family is not accepted, none is: the next best would only replace it. If a family stays
open, one or two laws at once are tried instead (`together.py`). Pinned by
tests/diagnosis/test_two_levels.py, test_decision.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from softmap_edge.diagnosis import acceptance
from softmap_edge.diagnosis import decision as rule
from softmap_edge.diagnosis.decision import difference, near, seen_to_fall
from softmap_edge.diagnosis.families import Columns, Family, FeatureBody, families
from softmap_edge.diagnosis.fit import Problem
from softmap_edge.diagnosis.fits import Fits
from softmap_edge.diagnosis.laws import Answer, Law, answered, law_of
from softmap_edge.diagnosis.outcome import (
    Outcome,
    Step,
    fits_alongside,
    held_out_loss,
    name_candidates,
    with_family,
)
from softmap_edge.diagnosis.representatives import (
    RIDGES,
    Ranking,
    Representative,
    State,
    linearised,
    ranked,
)
from softmap_edge.diagnosis.together import completed

HINT = 0.1  # share of the loss that makes an unaccepted family a hint


def search(
    problem: Problem,
    candidates: Sequence[str],
    progress: Callable[[str], None] | None = None,
    visible: float | None = None,
) -> Outcome:
    """Find the families that a model lacks on a problem, and their laws.

    Args:
        problem: the record with its noise.
        candidates: names of the candidate laws.
        progress: called with one line per family.
        visible: least effect size that counts, RMS, in mm or the unit of the output; VISIBLE_MM by
            default.
    """
    report = progress or (lambda _: None)
    visible = rule.VISIBLE_MM if visible is None else visible
    more = partial(_one_by_one, report=report, visible=visible)
    body, fits = FeatureBody(problem, candidates), Fits(problem, candidates)
    state = State(body, fits.null)
    null = ranked(state, [], []).found
    outcome = Outcome(body, fits, fits, state, null, null)
    more(outcome, 1)
    outcome = completed(outcome, more, visible)
    if _ask_again(outcome) and outcome.state.without_background() is not outcome.state:
        # with other laws, the static misfit may exceed ordinary imperfections
        more(outcome, acceptance.MOST)
    name_candidates(outcome)
    outcome.loss = held_out_loss(outcome)
    return outcome


def _one_by_one(outcome: Outcome, most: int, report: Callable[[str], None], visible: float) -> None:
    """Take families on top of those found until none is accepted, at most `most` in all."""
    body, every, more = outcome.body, families(), True
    while more and len(outcome.steps) < most:
        before, taken = outcome.state, [step.family for step in outcome.steps]
        state = before.without_background()
        ranking = ranked(state, every, taken)
        # a rod with known tendons has no own level
        if body.free_map or not body.record.error_is_noise:
            body.ordinary_mm = acceptance.ordinary(state, ranking, every)
        ordinary = acceptance.is_ordinary(ranking, state)
        if ordinary or (state is not before and not acceptance.beyond_ordinary(ranking, state)):
            state = State(
                body,
                state.fit,
                state.representatives,
                [f for f in every if f.name in acceptance.BACKGROUND],
            )
            ranking = ranked(state, [f for f in every if f.kind != "static"], taken)
        outcome.state, outcome.loss = state, ranking.found
        step = None if outcome.steps else _miswired(ranking, state, outcome.fits)
        step = step or _next(ranking, state, outcome.fits, outcome, visible)
        more = step is not None
        if step is not None:
            step = Step(_split(step.answer, state, outcome.fits), step.others)
            law = step.answer.law
            report(f"{len(taken) + 1}: {step.family.name}, {law.name if law else 'law open'}")
            outcome.steps.append(step)
            outcome.state, outcome.fits = with_family(state, outcome.fits, step.answer)


def _next(
    ranking: Ranking, state: State, fits: Fits, outcome: Outcome, visible: float
) -> Step | None:
    """Return the next family to take, or None; the outcome keeps a rejected best one as a hint."""
    single = acceptance.one_pose(state.body)
    rows = _in_order(
        _laws_alone(ranking, state, fits) if single else _static_settled(ranking, state), ranking
    )
    if not rows:
        return None
    later, best = bool(outcome.steps), rows[0]
    able = [row for row in rows if acceptance.accepted(row, ranking, state, later, visible)]
    noisy = state.body.record.error_is_noise  # another law may explain part of it
    if best not in able and (noisy or acceptance.stands_out(ranking.before, state.body, later)):
        # an event, or a law unlike every column: the representative may not show it
        by_law = [_by_law(row, ranking, state, fits) for row in rows[: acceptance.ASKED]]
        able = [row for row in by_law if acceptance.accepted(row, ranking, state, later, visible)]
        best = min((best, *able), key=lambda row: row.left)
        able.sort(key=lambda row: row.left)
    gain = float(ranking.before.sum()) - best.left
    if not able or (able[0] is not best and able[0].left - best.left > HINT * gain):
        outcome.hint = best if gain > HINT * float(ranking.before.sum()) else None
        return None
    answers = [
        answered(state, fits, row, ranking.found, pairs=False)
        for row in _tied(able, ranking, state, single)
    ]
    above = max(0.0, float(ranking.found.sum()) - rule.ABOVE_NOISE * state.body.problem.numbers)
    least = max(rule.FALL_FIRST * above, rule.FALL * float(ranking.found.sum()))
    answers = [a for a in answers if float(ranking.found.sum()) - a.left >= least]
    if not answers:  # the family falls to first order alone
        outcome.hint = best
        return None
    best_loss = min((a.least for a in answers), key=np.sum)
    if not single:  # a law may explain far more than its family
        answers = [a for a in answers if near(a.least, best_loss, ranking.found)]
    answers = [a for a in answers if not _excluded(a, answers, ranking, state)]
    answers = [a for a in answers if not _static_alone(a, answers, ranking, state)]
    first, *rest = sorted(
        answers,
        key=lambda a: (
            not a.identified,
            _beaten(a, answers),
            acceptance.order_of(a.family),
            a.numbers,
            a.left,
        ),
    )
    return Step(first, tuple(a for a in rest if acceptance.indistinct(a, first, ranking, state)))


def _split(answer: Answer, state: State, fits: Fits) -> Answer:
    """Return the result with parameters per channel or cable, if that law leaves far less."""
    law, body = answer.law, state.body
    if (
        law is None
        or not answer.identified
        or law.split
        or not acceptance.stands_out(law.loss, body, laws=True)
    ):
        return answer
    each = law_of(state, fits, law.effects, answer.before, law.effects)
    if each.numbers == law.numbers or not acceptance.falls_on(law.loss, each.loss, body, laws=True):
        return answer
    equals = tuple(
        one
        for one in answer.equals
        if not acceptance.falls_on(one.loss, each.loss, body, laws=True)
    )
    return replace(
        answer,
        law=each,
        equals=equals,
        reaching=(*answer.reaching, each),
        tried=(each, *answer.tried),
    )


def _static_settled(ranking: Ranking, state: State) -> list[Representative]:
    """Return the ranked families, with static ones linearised about themselves.

    Only those that may explain more than their first step are linearised again.

    A large effect on commands is not linear in its columns. Another family that is linear would
    replace it.
    """
    rows, body = ranking.rows, state.body
    doubtful = [rows[0].loss if rows[0].family.kind == "static" else ranking.before] if rows else []
    if not any(acceptance.stands_out(loss, body, laws=True) for loss in doubtful):
        return rows
    static = [
        row
        for row in rows
        if row.family.kind == "static" and row.columns.commanded and np.any(row.theta)
    ]
    settled = {row.family: linearised(state, row)[0] for row in static}
    return [min((row, settled.get(row.family, row)), key=lambda one: one.left) for row in rows]


def _laws_alone(ranking: Ranking, state: State, fits: Fits) -> list[Representative]:
    """Return the best single law of each family in place of its representative.

    One pose fits any free shape.
    """
    laws = [(row.family, _best_law(row.family, ranking, state, fits)) for row in ranking.rows]
    return [_stand_in(family, law, fits) for family, law in laws if law is not None]


def _in_order(rows: Sequence[Representative], ranking: Ranking) -> list[Representative]:
    """Return rows with the least loss first, the free static shape last.

    It keeps its rank if it explains far more than the others.
    """
    ordered = sorted(rows, key=lambda row: (row.family.name == acceptance.CATCH_ALL, row.left))
    gains = [float(ranking.before.sum()) - row.left for row in ordered]
    if (
        ordered
        and ordered[-1].family.name == acceptance.CATCH_ALL
        and gains[-1] > rule.DOMINATES * gains[0]
    ):
        ordered = [ordered[-1], *ordered[:-1]]
    return ordered


def _tied(
    able: list[Representative], ranking: Ranking, state: State, single: bool
) -> list[Representative]:
    """Return the accepted families near the best one, whose laws are searched."""
    best = able[0].loss
    if single:  # imperfections of the robot and a law look alike in one pose
        explained = float(ranking.before.sum() - best.sum())
        tied = [row for row in able if rule.reaches(row.loss, best, explained, rule.FORM_MOST)]
    else:
        tied = [
            row
            for row in able
            if near(row.loss, best, ranking.before) or _ordinary_apart(row, able[0], state)
        ]
    # a law may bend more sharply than a spline
    if any(row.family.name == acceptance.CATCH_ALL for row in tied):
        tied += [row for row in able if row.family.kind == "static" and row not in tied]
    return tied


def _beaten(one: Answer, others: Sequence[Answer]) -> bool:
    """Whether a law with no more parameters leaves less: then simplicity does not decide.

    Nor does it decide between families without a law that have different inputs.
    """
    laws = [a for a in others if a.identified and a.numbers <= one.numbers]
    if not one.identified:
        laws += [a for a in others if not a.identified and a.family.kind != one.family.kind]
    return any(seen_to_fall(difference(one.loss, law.loss)) for law in laws)


def _excluded(one: Answer, others: Sequence[Answer], ranking: Ranking, state: State) -> bool:
    """Whether a family leaves more than noise, with any law, and another does not.

    The other has a different input.

    A family that static columns can reproduce here does not exclude a static family.
    """
    if not acceptance.stands_out(one.least, state.body, laws=True):
        return False
    clear = [a for a in others if rule.clears(a.least, one.least, state.body.problem.numbers)]
    apart = [a for a in clear if a.family.kind != one.family.kind]
    return any(
        one.family.kind != "static" or not acceptance.does_the_same(a, one, ranking, state)
        for a in apart
    )


def _static_alone(one: Answer, others: Sequence[Answer], ranking: Ranking, state: State) -> bool:
    """Whether a static map reproduces a family of another kind in this run.

    A static family must be near it.
    """
    static = [a for a in others if a.family.kind == "static"]
    return one not in static and any(
        acceptance.does_the_same(one, other, ranking, state) for other in static
    )


def _ordinary_apart(one: Representative, other: Representative, state: State) -> bool:
    """Whether two static families agree up to ordinary imperfections."""
    if {one.family.kind, other.family.kind} != {"static"}:
        return False
    record = state.body.record
    apart = one.columns.shift(one.theta) - other.columns.shift(other.theta)
    return (
        record.rms_mm(np.where(np.isfinite(record.seen), apart, np.nan)) <= state.body.ordinary_mm
    )


def _ask_again(outcome: Outcome) -> bool:
    """Search the laws of families without one again, with all others present.

    Return whether a result changed.
    """
    changed = False
    for i, step in enumerate(outcome.steps):
        state, family, law = outcome.state, step.family, step.answer.law
        if law is not None and (
            not step.answer.rough or set(law.effects) <= set(state.fit.effects)
        ):
            continue
        others = [one for one in state.representatives if one.family.name != family.name]
        fits = fits_alongside(outcome.plain, state, others)
        fit = fits.get(state.fit.effects, state.fit.space.split)
        mimics = family.kind == "static"  # the background would explain its complete share
        without = State(state.body, fit, others, () if mimics else state.background)
        ranking = ranked(without, [family], [])
        if not ranking.rows:
            continue
        answer = answered(without, fits, ranking.rows[0], ranking.found, pairs=True)
        if answer.law is not None or answer.open:
            outcome.steps[i], changed = Step(answer, step.others), True
            outcome.state, outcome.fits = with_family(without, fits, answer)
    return changed


def _miswired(ranking: Ranking, state: State, fits: Fits) -> Step | None:
    """Return exchanged or reversed servos if they explain as much as the best family.

    They have no free parameters.

    They are tested only if the model error is a large part of the motion.
    """
    record = state.body.record
    off, motion = record.rms_mm(state.residual), acceptance.motion_mm(record)
    if "servo_swap" not in fits.candidates or off < rule.MISWIRED * motion or not ranking.rows:
        return None
    law = law_of(state, fits, ("servo_swap",), ranking.found)
    best = ranking.rows[0]
    if law.left > best.left + rule.FORM * (float(ranking.found.sum()) - best.left):
        return None
    family = Family("wiring", "static", ("servo_swap",))
    stand_in = _stand_in(family, law, fits)
    return Step(Answer(family, stand_in, ranking.found, law, (), False, (law,), (law,)), ())


def _stand_in(family: Family, law: Law, fits: Fits) -> Representative:
    """Return a law in place of the representative of its family."""
    record = fits.problem.record
    none = Columns(
        np.zeros((0, *record.seen.shape)), np.zeros(0, np.intp), np.zeros((0, len(record))), 0
    )
    assert law.fit is not None
    moved = record.rms_mm(fits.displacement(law.fit, law.effects[0]))
    return Representative(family, np.zeros(0), RIDGES[0], law.loss, law.numbers, none, moved)


def _best_law(family: Family, ranking: Ranking, state: State, fits: Fits) -> Law | None:
    """Return the single law of a family with the least loss on top of the effects found."""
    names = [n for n in family.members if n in fits.candidates and n not in state.fit.effects]
    laws = [law_of(state, fits, (name,), ranking.found) for name in names]
    return min(laws, key=lambda law: law.left, default=None)


def _by_law(row: Representative, ranking: Ranking, state: State, fits: Fits) -> Representative:
    """Return a family with its best single law as representative, if that leaves less."""
    best = _best_law(row.family, ranking, state, fits)
    if best is None or best.fit is None or best.left >= row.left:
        return row
    moved = state.body.record.rms_mm(fits.displacement(best.fit, best.effects[0]))
    return replace(row, loss=best.loss, numbers=best.numbers, moved_mm=moved)
