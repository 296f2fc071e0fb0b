"""The search in two levels: family after family, each with its law where one is resolved, then all together again.

    rank families about what is known -> accept the best -> ask those near it for their laws -> take one -> again

If the best family is not accepted none is: the next best would only stand in for it. A resolved law joins the fit, an
unresolved family stays beside it as its representative. Where that leaves a family open, one law or two of different
families are looked for at once, and stand if they leave no more. Pinned by tests/test_two_levels.py, test_decision.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis import decision as rule
from softmap_edge.diagnosis.decision import difference, near, seen_to_fall
from softmap_edge.diagnosis.families import (
    RIDGES,
    Body,
    Columns,
    Family,
    Ranking,
    Representative,
    State,
    families,
    ranked,
)
from softmap_edge.diagnosis.fit import Fit, Problem
from softmap_edge.diagnosis.fits import Fits
from softmap_edge.diagnosis.laws import WINDING, Answer, Law, answered, law_of
from softmap_edge.diagnosis.record import Record

Floats = NDArray[np.float64]

CATCH_ALL = "static shape"  # can be any static law; taken where no other family is
BACKGROUND = ("static map", "static shape", "frame", "load")  # what ordinary imperfections look like
MOST = 4  # families that are taken
ASKED = 3  # families whose laws are asked where the best representative is not accepted
TOGETHER = 6  # laws beside which a second one is looked for, and families that are asked for it
SIMPLER = {"static": 1, "memory": 2, "condition": 2, "time": 3}  # order in which near families are taken


@dataclass(frozen=True, eq=False)
class Step:
    """One family that was taken: what level 2 says of it, other families that cannot be told from it here."""

    answer: Answer
    others: tuple[Answer, ...]

    @property
    def family(self) -> Family:
        """The family."""
        return self.answer.family


@dataclass(eq=False)
class Outcome:
    """What a search found: steps in the order found, the joint fit, what stands beside it, and what hints at more."""

    body: Body
    fits: Fits
    plain: Fits  # without what stands beside
    state: State
    null: Floats  # (folds,) held-out loss of the model alone
    loss: Floats  # (folds,) held-out loss of what was found
    steps: list[Step] = field(default_factory=list)
    hint: Representative | None = None  # the best family, if it was not accepted but falls

    @property
    def ordinary_mm(self) -> float:
        """Ordinary static imperfections of the robot, RMS, beside what was found."""
        return self.body.ordinary_mm

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
        """Share that is left of what stood above the noise, in loss or in mean square, the larger."""
        problem, record = self.body.problem, self.body.record
        noise = rule.ABOVE_NOISE * problem.numbers
        in_loss = (self.loss.sum() - noise) / max(float(self.null.sum()) - noise, 0.25 * noise)
        own = max(record.form_mm**2 + self.ordinary_mm**2, problem.noise.rms_mm(record.positions) ** 2)
        start = record.rms_mm(record.seen - self.fits.null.predicted) ** 2
        residual = self.state.residual  # whitened as it is, what imperfections explain may be more in mm
        now = min(record.rms_mm(residual), record.rms_mm(residual - self.state.ordinary)) ** 2
        return float(max(0.0, in_loss, (now - own) / max(start - own, own)))


def search(
    problem: Problem,
    candidates: Sequence[str],
    progress: Callable[[str], None] | None = None,
    visible: float = rule.VISIBLE_MM,
) -> Outcome:
    """Find the families that a model lacks on a problem, and their laws.

    Args:
        problem: the record with its noise. candidates: effects that may be a law.
        progress: hears a line per family.
        visible: least RMS displacement that counts, mm or the unit of what is seen.
    """
    tell = progress or (lambda _: None)
    body, fits = Body(problem, candidates), Fits(problem, candidates)
    state = State(body, fits.null)
    null = ranked(state, [], []).found
    outcome = Outcome(body, fits, fits, state, null, null)
    _one_by_one(outcome, tell, visible)
    outcome = _reconsidered(outcome, tell, visible)
    _ask_again(outcome)
    outcome.loss = _loss(outcome)
    return outcome


def _one_by_one(outcome: Outcome, tell: Callable[[str], None], visible: float) -> None:
    """Take families on top of what was found until none is accepted."""
    body, every, more = outcome.body, families(), True
    while more and len(outcome.steps) < MOST:
        state, taken = outcome.state, [step.family for step in outcome.steps]
        ranking = ranked(state, every, taken)
        if body.record.model.kind != "rod":  # a rod's own error is its noise
            body.ordinary_mm = ordinary(state, ranking, every)
        if _is_ordinary(ranking, state):
            state = State(body, state.fit, state.beside, [f for f in every if f.name in BACKGROUND])
            ranking = ranked(state, [f for f in every if f.kind != "static"], taken)
        outcome.state, outcome.loss = state, ranking.found
        step = None if outcome.steps else _miswired(ranking, state, outcome.fits)
        step = step or _next(ranking, state, outcome.fits, outcome, visible)
        more = step is not None
        if step is not None:
            law = step.answer.law
            tell(f"{len(taken) + 1}: {step.family.name}, {law.name if law else 'law open'}")
            outcome.steps.append(step)
            outcome.state, outcome.fits = _taken(state, outcome.fits, step.answer)


def _loss(outcome: Outcome) -> Floats:
    """Return the held-out loss (folds,) of what was found, with families of imperfections beside it if they help."""
    state = outcome.state
    ways = [state, State(state.body, state.fit, state.beside)] if state.background else [state]
    return min((ranked(way, [], []).found for way in ways), key=lambda loss: float(loss.sum()))


def _reconsidered(outcome: Outcome, tell: Callable[[str], None], visible: float) -> Outcome:
    """Return what one law or two at once explain, and what comes after, where that stands for what was found so far.

    A first family that takes the share of another one keeps it; two laws at once share what is theirs.
    """
    steps, rod = outcome.steps, outcome.body.record.model.kind == "rod"
    hinted = bool(steps) or (rod and outcome.hint is not None)  # one family alone is small beside a rod's own error
    if not hinted or MOST < 2 or _one_pose(outcome.body) or any(step.family.name == "wiring" for step in steps):
        return outcome
    clear = len(steps) == 1 and steps[0].answer.resolved and not steps[0].others
    if clear and outcome.left <= rule.LEFT:
        return outcome
    outcome.loss, ordinary_mm = _loss(outcome), outcome.body.ordinary_mm
    other = _with_few(outcome, visible)
    if other is not None:
        other.loss = _loss(other)
        stands = _stands_for(other, outcome)
        _one_by_one(other, tell, visible)
        other.loss = _loss(other)
        if stands or _stands_for(other, outcome):
            return _with_others(other, outcome)
    outcome.body.ordinary_mm = ordinary_mm
    return outcome


def _with_others(other: Outcome, outcome: Outcome) -> Outcome:
    """Return an outcome with what stands beside each law: families that do as well, those it replaces among them."""
    laws = [law for step in other.steps if (law := step.answer.law) is not None and law.fit is not None]
    if len(laws) < len(other.steps):
        return other
    split = [e for law in laws for e in law.effects if law.fit is not None and e in law.fit.space.split]
    known = {step.family for step in other.steps}
    for i, (step, own) in enumerate(zip(other.steps, laws)):
        rest = [e for law in laws if law is not own for e in law.effects]
        state = State(other.body, other.plain.get(rest, split))
        ranking = ranked(state, [f for f in families() if f not in known or f == step.family], [])
        rows = [row for row in ranking.rows if row.family != step.family]
        rows = [row for row in rows if near(row.loss, step.answer.loss, ranking.found)][:ASKED]
        beside = [answered(state, other.plain, row, ranking.found, pairs=False) for row in rows]
        if len(other.steps) == len(outcome.steps) == 1:
            beside += [a for a in (outcome.steps[0].answer, *outcome.steps[0].others) if a.family != step.family]
        beside = [a for a in beside if a.law is None or a.law.effects != own.effects]
        others = {a.family: a for a in beside if _stands_beside(a, step.answer, ranking, state)}
        other.steps[i] = Step(step.answer, tuple(others.values()))
    return other


def _stands_for(other: Outcome, outcome: Outcome) -> bool:
    """Whether one outcome stands for another: it leaves far less, or no more with more of its families resolved."""
    if _falls_on(outcome.loss, other.loss, outcome.body) and other.open <= outcome.open:
        return True
    fewer = other.open < outcome.open or (other.open == outcome.open and len(other.steps) < len(outcome.steps))
    return fewer and rule.reaches(other.loss, outcome.loss, float(outcome.null.sum() - outcome.loss.sum()))


def _falls_on(before: Floats, after: Floats, body: Body, share: float = rule.FALL_NEXT) -> bool:
    """Whether a loss (folds,) is seen to fall, by a `share` of what stood above the noise.

    Where no more than noise stands, noise is told too large or nothing is missing: it is a share of the whole.
    """
    fall, total = difference(before, after), float(before.sum())
    least = rule.FALL_FIRST * total if total <= body.problem.numbers else rule.FALL * total
    above = max(0.0, total - rule.ABOVE_NOISE * body.problem.numbers)
    return seen_to_fall(fall) and fall.fall >= max(least, share * above)


def _with_few(outcome: Outcome, visible: float) -> Outcome | None:
    """Return the one law or two that leave least together as an outcome, each asked with the other in place.

    Nothing stands for ordinary imperfections meanwhile: it would take the share of static laws.
    """
    body, plain = outcome.body, outcome.plain
    few = _few_laws(outcome)
    if few is None:
        return None
    most = float(outcome.null.sum() - outcome.loss.sum())
    together = rule.reaches(few.loss, outcome.loss, most)  # then neither may be off for itself
    other = Outcome(body, plain, plain, outcome.state, outcome.null, outcome.loss)
    for name in few.effects:
        state = State(body, plain.get([e for e in few.effects if e != name]))
        answer = _in_place(state, plain, name)
        if answer is not None and answer.law is None and together:
            best = answer.tried[0]  # a law that is nobody's effect would leave it open
            answer = replace(answer, law=best, equals=()) if best.effects == (name,) else answer
        if answer is None or answer.law is None or not _falls_on(answer.before, answer.law.loss, body):
            return None
        if len(few.effects) > 1 and answer.representative.moved_mm < visible:
            return None
        other.steps.append(Step(answer, ()))
    laws = [step.answer.law for step in other.steps if step.answer.law is not None]
    split = [e for law in laws if law.fit is not None for e in law.effects if e in law.fit.space.split]
    other.state = State(body, plain.get([e for law in laws for e in law.effects], split))
    return other


def _home(effect: str) -> Family:
    """Return the first family that an effect may be a law of."""
    return next(f for f in families() if effect in f.members)


def _in_place(without: State, fits: Fits, name: str) -> Answer | None:
    """Ask the family of an effect for its law about all the others."""
    ranking = ranked(without, [_home(name)], [])
    if not ranking.rows:
        return None
    return answered(without, fits, ranking.rows[0], ranking.found, pairs=False)


def _few_laws(outcome: Outcome) -> Law | None:
    """Return the law, or the two laws of different families, that leave least; one if a second adds too little."""
    body, fits, before = outcome.body, outcome.plain, outcome.null
    null = State(body, fits.null)
    named = {name for family in families() for name in family.members}
    singles = [law_of(null, fits, (name,), before) for name in fits.candidates if name in named]
    singles.sort(key=lambda law: float(law.loss.sum()))
    found: list[tuple[Law, State, Ranking, Representative]] = []
    for first in singles[:TOGETHER]:
        assert first.fit is not None
        state = State(body, first.fit)
        ranking = ranked(state, families(), [])
        found += [(first, state, ranking, row) for row in ranking.rows]
    pairs: dict[frozenset[str], Law] = {}
    for first, state, ranking, row in sorted(found, key=lambda one: float(one[3].loss.sum()))[:TOGETHER]:
        for name in row.family.members:
            both = frozenset((*first.effects, name))
            apart = _home(first.effects[0]) != _home(name)  # two laws of one family are what it asks for itself
            if name in fits.candidates and apart and both not in pairs:
                law = law_of(state, fits, (name,), ranking.found)
                pairs[both] = replace(law, effects=(*first.effects, name), numbers=first.numbers + law.numbers)
    one, two = _least(singles, before), _least(list(pairs.values()), before)
    return two if one is None or (two is not None and _falls_on(one.loss, two.loss, body)) else one


def _least(laws: Sequence[Law], before: Floats) -> Law | None:
    """Return the law that leaves least; one with an eccentric pulley, which does for many maps, only if it must be."""
    order = sorted(laws, key=lambda law: float(law.loss.sum()))
    plain = [law for law in order if WINDING not in law.effects]
    if plain and near(plain[0].loss, order[0].loss, before):
        order = plain
    return order[0] if order else None


def _ask_again(outcome: Outcome) -> None:
    """Ask the families without a law once more, with all others in place: what was not known then explains no more."""
    for i, step in enumerate(outcome.steps):
        if step.answer.law is not None:
            continue
        state, family = outcome.state, step.family
        others = [one for one in state.beside if one.family.name != family.name]
        fits = outcome.plain
        if others:
            shift = State(state.body, state.fit, others).shift
            fits = Fits(_shifted(outcome.plain.problem, shift), outcome.plain.candidates)
        fit = fits.get(state.fit.effects, state.fit.space.split)
        mimics = family.kind == "static"  # what stands for ordinary imperfections would take all of its share
        without = State(state.body, fit, others, () if mimics else state.background)
        ranking = ranked(without, [family], [])
        if not ranking.rows:
            continue
        answer = answered(without, fits, ranking.rows[0], ranking.found, pairs=True)
        if answer.law is not None or answer.open:
            outcome.steps[i] = Step(answer, step.others)
            outcome.state, outcome.fits = _taken(without, fits, answer)


def _taken(state: State, fits: Fits, answer: Answer) -> tuple[State, Fits]:
    """Return state and fits with a family taken: its law joins the fit, else its representative stands beside it."""
    if answer.law is not None and answer.law.fit is not None:
        return State(state.body, answer.law.fit, state.beside, state.background), fits
    beside = (*state.beside, answer.representative)
    there = State(state.body, state.fit, beside)
    shifted = Fits(_shifted(state.body.problem, there.shift), fits.candidates)
    return State(state.body, shifted.get(state.fit.effects, state.fit.space.split), beside, state.background), shifted


def _shifted(problem: Problem, shift: Floats) -> Problem:
    """Return a problem with a shift (K, F) mm taken off what is seen."""
    moved = copy(problem)
    moved.record = copy(problem.record)
    moved.record.seen = problem.record.seen - shift
    return moved


def _one_pose(body: Body) -> bool:
    """Whether the commands never change: one shape is seen, and two laws are one too many."""
    return not np.any(np.ptp(body.record.command, axis=0))


def _miswired(ranking: Ranking, state: State, fits: Fits) -> Step | None:
    """Return exchanged or turned servos as a step where they explain as much as the best family without a free number.

    They are asked for only where the model is off by a good part of the motion.
    """
    record = state.body.record
    off, motion = record.rms_mm(state.residual), _motion_mm(record)
    if "servo_swap" not in fits.candidates or off < rule.MISWIRED * motion or not ranking.rows:
        return None
    law = law_of(state, fits, ("servo_swap",), ranking.found)
    best = ranking.rows[0]
    if law.loss.sum() > best.loss.sum() + rule.FORM * (ranking.found.sum() - best.loss.sum()):
        return None
    family = Family("wiring", "static", "Servos are exchanged or turn the other way.", ("servo_swap",), (), (), ())
    stand_in = _stand_in(family, law, fits)
    return Step(Answer(family, stand_in, ranking.found, law, (), False, (law,), (law,)), ())


def _stand_in(family: Family, law: Law, fits: Fits) -> Representative:
    """Return a law in the place of the representative of its family."""
    record = fits.problem.record
    none = Columns(np.zeros((0, *record.seen.shape)), np.zeros(0, np.intp), np.zeros((0, len(record))), 0)
    assert law.fit is not None
    moved = record.rms_mm(fits.displacement(law.fit, law.effects[0]))
    return Representative(family, np.zeros(0), RIDGES[0], law.loss, law.numbers, none, moved)


def _best_law(family: Family, ranking: Ranking, state: State, fits: Fits) -> Law | None:
    """Return the single law of a family that leaves least on top of what was found."""
    names = [n for n in family.members if n in fits.candidates and n not in state.fit.effects]
    laws = [law_of(state, fits, (name,), ranking.found) for name in names]
    return min(laws, key=lambda law: float(law.loss.sum()), default=None)


def _by_law(row: Representative, ranking: Ranking, state: State, fits: Fits) -> Representative:
    """Return a family with its best single law in the place of its representative, where that leaves less."""
    best = _best_law(row.family, ranking, state, fits)
    if best is None or best.fit is None or best.loss.sum() >= row.loss.sum():
        return row
    moved = state.body.record.rms_mm(fits.displacement(best.fit, best.effects[0]))
    return replace(row, loss=best.loss, numbers=best.numbers, moved_mm=moved)


def _is_ordinary(ranking: Ranking, state: State) -> bool:
    """Whether the best family is static, and all static misfit no more than ordinary imperfections may be."""
    best = ranking.rows[0].family.kind if ranking.rows else ""
    return best == "static" and state.body.ordinary_mm > 0.0 and not _beyond_ordinary(ranking, state)


def _beyond_ordinary(ranking: Ranking, state: State) -> bool:
    """Whether the static misfit is more than ordinary imperfections of the robot."""
    return _static_mm(ranking, state) >= rule.DOMINATES * state.body.ordinary_mm


def _static_mm(ranking: Ranking, state: State) -> float:
    record = state.body.record
    return record.rms_mm(np.where(np.isfinite(record.seen), ranking.static, np.nan))


def _next(ranking: Ranking, state: State, fits: Fits, outcome: Outcome, visible: float) -> Step | None:
    """Return the next family to take, or None; the outcome keeps a hint where the best was not accepted."""
    if not ranking.rows:
        return None
    later = bool(outcome.steps)
    every = ranking.rows
    if _one_pose(state.body):  # any free shape does here: only laws can be compared
        laws = [(row.family, _best_law(row.family, ranking, state, fits)) for row in every]
        every = [_stand_in(family, law, fits) for family, law in laws if law is not None]
    if not every:
        return None
    rows = sorted(every, key=lambda row: (row.family.name == CATCH_ALL, float(row.loss.sum())))
    gains = [float(ranking.before.sum() - row.loss.sum()) for row in rows]
    if rows[-1].family.name == CATCH_ALL and gains[-1] > rule.DOMINATES * gains[0]:
        rows = [rows[-1], *rows[:-1]]
    able = [row for row in rows if _accepted(row, ranking, state, later, visible)]
    best = rows[0]
    if best not in able:  # what happens once, or only far from any column, no representative may show
        by_law = [_by_law(row, ranking, state, fits) for row in rows[:ASKED]]
        able = [row for row in by_law if _accepted(row, ranking, state, later, visible)]
        best = min((best, *able), key=lambda row: float(row.loss.sum()))
        able.sort(key=lambda row: float(row.loss.sum()))
    gain = float(ranking.before.sum() - best.loss.sum())
    if not able or (able[0] is not best and float(able[0].loss.sum() - best.loss.sum()) > 0.1 * gain):
        outcome.hint = best if gain > 0.1 * float(ranking.before.sum()) else None
        return None
    tied = [row for row in able if near(row.loss, able[0].loss, ranking.before) or _ordinary_apart(row, able[0], state)]
    one_pose = _one_pose(state.body)  # in which imperfections of the robot cannot be told from its law
    if one_pose:
        explained = float(ranking.before.sum() - able[0].loss.sum())
        tied = [row for row in able if rule.reaches(row.loss, able[0].loss, explained, rule.FORM_MOST)]
    if any(row.family.name == CATCH_ALL for row in tied):  # a law may do what a spline does not do quite as well
        tied += [row for row in able if row.family.kind == "static" and row not in tied]
    answers = [answered(state, fits, row, ranking.found, pairs=False) for row in tied]
    above = max(0.0, float(ranking.found.sum()) - rule.ABOVE_NOISE * state.body.problem.numbers)
    least = max(rule.FALL_FIRST * above, rule.FALL * float(ranking.found.sum()))
    answers = [a for a in answers if float(ranking.found.sum() - a.loss.sum()) >= least]
    if not answers:
        return None
    best_loss = min((a.loss for a in answers), key=lambda loss: float(loss.sum()))
    if not one_pose:  # a law may do far more than its family
        answers = [a for a in answers if near(a.loss, best_loss, ranking.found)]
    first, *rest = sorted(answers, key=lambda a: (
        not a.resolved, _beaten(a, answers), _order(a.family), a.numbers, float(a.loss.sum())
    ))  # fmt: skip
    return Step(first, tuple(a for a in rest if _stands_beside(a, first, ranking, state)))


def _beaten(one: Answer, others: Sequence[Answer]) -> bool:
    """Whether a law with no more numbers is seen to leave less: then simplicity is no reason to take this one."""
    laws = [a for a in others if a.resolved and a.numbers <= one.numbers]
    return any(seen_to_fall(difference(one.loss, law.loss)) for law in laws)


def _ordinary_apart(one: Representative, other: Representative, state: State) -> bool:
    """Whether two static families do the same but for ordinary imperfections."""
    if {one.family.kind, other.family.kind} != {"static"}:
        return False
    record = state.body.record
    apart = one.columns.shift(one.theta) - other.columns.shift(other.theta)
    return record.rms_mm(np.where(np.isfinite(record.seen), apart, np.nan)) <= state.body.ordinary_mm


def _order(family: Family) -> int:
    return 0 if family.name == "static map" else SIMPLER[family.kind]


def _accepted(row: Representative, ranking: Ranking, state: State, later: bool, visible: float) -> bool:
    """Whether a family is seen: its loss falls far enough, in enough folds, and it moves the body far enough."""
    problem = state.body.problem
    if not _falls_on(ranking.before, row.loss, state.body, rule.FALL_NEXT if later else rule.FALL_FIRST):
        return False
    noise = problem.noise.rms_mm(problem.record.positions) / np.sqrt(3.0) if problem.noise.replicates else 0.0
    static = row.family.kind == "static"
    if static and not _beyond_ordinary(ranking, state):
        return False
    record, rod = state.body.record, state.body.record.model.kind == "rod"
    if static and rod and difference(ranking.before, row.loss).fall < rule.FALL_NEXT * float(ranking.before.sum()):
        return False  # what a rod errs on any run is static too, and in its noise
    return row.moved_mm >= max(visible, float(noise), record.form_mm if static and not rod else 0.0)


def _motion_mm(record: Record) -> float:
    """Return how far the body moves about its mean, mm RMS; what is never seen has no mean and does not count."""
    seen = np.isfinite(record.seen)
    mean = np.where(seen, record.seen, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    return record.rms_mm(record.seen - mean)


def ordinary(state: State, ranking: Ranking, every: Sequence[Family]) -> float:
    """Return the level of the robot's ordinary static imperfections, mm RMS.

    Where one effect dominates the static misfit it is what that effect leaves, else all of it: many small things. What
    is more than ordinary is another effect.
    """
    body, record = state.body, state.body.record
    seen, level = np.isfinite(record.seen), state.body.level()
    static = [f for f in every if f.kind == "static"]
    names = dict.fromkeys(e for f in static for e in f.members if e in body.candidates and e != WINDING)
    singles = {name: own for name in names if (own := body.single(name)) is not None}
    singles |= body.curves(state.commands, state.slopes)
    for name, own in singles.items():
        body.add(level, name, own)
    level.close(np.ascontiguousarray(body.modes(state.residual)))

    def size(shift: Floats) -> float:
        return record.rms_mm(np.where(seen, shift, np.nan))

    total = size(ranking.static)
    crossed = [row.columns.shift(row.theta) for row in ranking.rows if row.family.name == "coupling"]
    shifts = crossed + [own.shift(np.asarray(level.theta([n], [RIDGES[0]])[0])) for n, own in singles.items()]
    pairs = [(size(ranking.static - shift), size(shift)) for shift in shifts]
    left, moved = min(pairs, default=(total, 0.0))
    motion = _motion_mm(record)
    level_mm = min(left if moved >= rule.DOMINATES * left else total, rule.ORDINARY * motion)
    return float(max(level_mm, record.frame_mm))  # a frame is as ordinary as its alignment says


def _stands_beside(other: Answer, first: Answer, ranking: Ranking, state: State) -> bool:
    """Whether a family cannot be told from the first one: not if it leaves more than noise, and the first does not."""
    if rule.leaves_cause(other.loss, first.loss, state.body.problem.numbers):
        return False
    if other.resolved and first.resolved:
        return near(other.loss, first.loss, ranking.before) and other.numbers <= first.numbers + 2
    if first.resolved and first.family.kind == "static" and other.family.name == CATCH_ALL:
        return False  # it can be any static law, this one too
    reference = first.loss if first.resolved else first.representative.loss
    if not near(other.representative.loss, reference, ranking.before):
        return False
    return not (_order(first.family) < _order(other.family) and _does_the_same(other, first, ranking, state))


def _does_the_same(other: Answer, first: Answer, ranking: Ranking, state: State) -> bool:
    """Whether what a family does here is what a static map of the commands, or the first one, can do as well."""
    body = state.body
    theta = ranking.level.theta([*ranking.names, other.family.name], [*ranking.ridges, other.representative.ridge])[-1]
    target = np.asarray(ranking.level.fitted(other.family.name, theta))
    names = dict.fromkeys(("static map", "coupling", first.family.name))
    rows = []
    for family in families():
        if family.name in names and (columns := body.columns(family, state.commands, state.slopes)) is not None:
            rows.append(body.modes(columns.base)[columns.which] * columns.weight[:, :, None])
    x = np.concatenate(rows).reshape(sum(map(len, rows)), -1)
    gram = x @ x.T
    gram.flat[:: len(gram) + 1] += RIDGES[0]
    z = target.ravel()
    return bool(1.0 - np.sum((z - np.linalg.solve(gram, x @ z) @ x) ** 2) / max(float(z @ z), 1e-300) > rule.MIMIC)
