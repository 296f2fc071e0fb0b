"""Fit laws of different families at once if the stepwise search leaves one open.

The laws replace the stepwise result if they leave far less. They also do if they leave no more, and
more families are identified. Pinned by tests/diagnosis/test_two_levels.py.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis import acceptance
from softmap_edge.diagnosis import decision as rule
from softmap_edge.diagnosis.decision import near
from softmap_edge.diagnosis.families import Family, FeatureBody, families, home
from softmap_edge.diagnosis.fits import Fits
from softmap_edge.diagnosis.laws import WINDING, Answer, Law, answered, law_of, winds
from softmap_edge.diagnosis.outcome import Outcome, Step, held_out_loss
from softmap_edge.diagnosis.representatives import Ranking, Representative, State, ranked

Floats = NDArray[np.float64]

TOGETHER = 6  # pairs of a law and a second family whose laws are searched
# of the best family's fall on training frames: least for cross-validation
PROMISING = 0.5


More = Callable[[Outcome, int], None]  # continues up to a number of families, in place


def completed(outcome: Outcome, more: More, visible: float) -> Outcome:
    """Add the other families to the first, one by one or a few laws at once.

    In a stepwise search, the first of two families also explains and keeps part of the second's
    share. Laws fitted at once separate their shares. They are used first if they leave no more than
    noise; otherwise they may replace the stepwise result.

    Args:
        outcome: the first family, if one was found.
        more: continues the family search.
        visible: least effect size that counts, mm RMS.
    """
    few, tried = _few_laws(outcome), []
    if outcome.steps:
        several = not acceptance.one_pose(outcome.body) and outcome.steps[0].family.name != "wiring"
        for laws in few if several and _left_with_imperfections(outcome) > rule.LEFT else ():
            tried.append(laws)
            found = _explained(laws, outcome, more, visible)
            if found is not None:
                return found
        more(outcome, acceptance.MOST)
    return _reconsidered(outcome, chain(tried, few), more, visible)


def _left_with_imperfections(outcome: Outcome) -> float:
    """Return the unexplained share after the families of ordinary imperfections."""
    background = [family for family in families() if family.name in acceptance.BACKGROUND]
    other = replace(
        outcome, state=State(outcome.body, outcome.fit, outcome.state.representatives, background)
    )
    other.loss = held_out_loss(other)
    return other.left


def _explained(laws: Law, outcome: Outcome, more: More, visible: float) -> Outcome | None:
    """Return a few laws as an outcome if they leave only noise.

    Ordinary imperfections are included, and each law is confirmed.

    One of them must be of the first family. No other may depend on time, because an event or a
    drift can reproduce much of other families. Otherwise families are searched one by one first.
    """
    body, ordinary_mm = outcome.body, outcome.body.ordinary_mm
    first, homes = outcome.steps[0].family, {home(name) for name in laws.effects}
    if first not in homes or any(
        family is not None and family.kind == "time" for family in homes - {first}
    ):
        return None
    assert laws.fit is not None
    if (
        _left_with_imperfections(replace(outcome, state=State(body, laws.fit), steps=[]))
        > rule.LEFT
    ):
        return None
    other = _confirmed(laws, outcome, visible, True)
    if other is not None:
        more(other, acceptance.MOST)
        other.loss = held_out_loss(other)
        if not other.open and other.left <= rule.LEFT:
            return _with_others(other, outcome)
    body.ordinary_mm = ordinary_mm
    return None


def _reconsidered(outcome: Outcome, few: Iterable[Law], more: More, visible: float) -> Outcome:
    """Return the outcome of a `few` laws at once, if it replaces the stepwise result."""
    steps = outcome.steps
    # one family alone is small relative to the noise
    hinted = outcome.body.record.error_is_noise and outcome.hint is not None
    if (
        not (steps or hinted)
        or acceptance.one_pose(outcome.body)
        or any(step.family.name == "wiring" for step in steps)
    ):
        return outcome
    best, best.loss = outcome, held_out_loss(outcome)
    explained = float(outcome.null.sum() - outcome.loss.sum())
    excluded = _excluded_by(outcome)
    if (
        len(steps) == 1
        and steps[0].answer.identified
        and not steps[0].others
        and outcome.left <= rule.LEFT
    ):
        # A law that explains nearly everything is not replaced.
        few = () if excluded is None else filter(excluded, few)
    for laws in few:
        ordinary_mm = outcome.body.ordinary_mm
        other = _confirmed(laws, outcome, visible, rule.reaches(laws.loss, outcome.loss, explained))
        if other is None:
            continue
        other.loss = held_out_loss(other)
        stands = (excluded is not None and excluded(laws)) or _stands_for(other, best)
        more(other, acceptance.MOST)
        other.loss = held_out_loss(other)
        if not stands and not _stands_for(other, best):
            outcome.body.ordinary_mm = ordinary_mm
            continue
        best = other
        if best.left <= rule.LEFT:
            break
    return best if best is outcome else _with_others(best, outcome)


def _excluded_by(outcome: Outcome) -> Callable[[Law], bool] | None:
    """Return whether laws at once exclude the single law found.

    They include another law of its family, and leave only noise while it leaves more. The part that
    imperfections may explain counts as unexplained, because they can hide a second effect. None if
    no laws can.
    """
    if len(outcome.steps) != 1 or not outcome.fit.effects:
        return None
    first, numbers = set(outcome.fit.effects), outcome.body.problem.numbers
    alone = held_out_loss(replace(outcome, state=outcome.state.without_background()))
    if not acceptance.stands_out(alone, outcome.body, laws=True):
        return None
    family = outcome.steps[0].family

    def excludes(laws: Law) -> bool:
        others = {home(effect) for effect in set(laws.effects) - first}
        return (
            family in others
            and not first & set(laws.effects)
            and rule.clears(laws.loss, alone, numbers)
        )

    return excludes


def _with_others(other: Outcome, outcome: Outcome) -> Outcome:
    """Return an outcome with the alternatives to each of its laws.

    They include the families that it replaces.
    """
    laws = [
        law for step in other.steps if (law := step.answer.law) is not None and law.fit is not None
    ]
    if len(laws) < len(other.steps):
        return other
    split = [e for law in laws for e in law.split]
    known = {step.family for step in other.steps}
    for i, (step, own) in enumerate(zip(other.steps, laws)):
        rest = [e for law in laws if law is not own for e in law.effects]
        state = State(other.body, other.plain.get(rest, split))
        ranking = ranked(
            state, [f for f in families() if f not in known or f == step.family], [], PROMISING
        )
        rows = [row for row in ranking.rows if row.family != step.family]
        rows = [row for row in rows if near(row.loss, step.answer.loss, ranking.found)][
            : acceptance.ASKED
        ]
        answers = [answered(state, other.plain, row, ranking.found, pairs=False) for row in rows]
        if len(other.steps) == len(outcome.steps) == 1:
            answers += [
                a
                for a in (outcome.steps[0].answer, *outcome.steps[0].others)
                if a.family != step.family
            ]
        answers = [a for a in answers if a.law is None or a.law.effects != own.effects]
        others = {
            a.family: a for a in answers if acceptance.indistinct(a, step.answer, ranking, state)
        }
        other.steps[i] = Step(step.answer, tuple(others.values()))
    return other


def _stands_for(other: Outcome, outcome: Outcome) -> bool:
    """Whether an outcome replaces another: it leaves far less, or no more and is simpler.

    If static families suffice, no other kind is accepted: an event can reproduce much of a static
    map.
    """
    if acceptance.falls_on(outcome.loss, other.loss, outcome.body) and other.open <= outcome.open:
        return True
    fewer = other.open < outcome.open or (
        other.open == outcome.open and len(other.steps) < len(outcome.steps)
    )
    kinds, known = ({_kind(step.family) for step in one.steps} for one in (other, outcome))
    if kinds != known and rule.leaves_cause(other.loss, outcome.loss, outcome.body.problem.numbers):
        return False
    if any(_changes(step.family) and not step.answer.identified for step in outcome.steps):
        known |= {_kind(family) for family in families() if family.kind in ("time", "condition")}
    explained = float(outcome.null.sum() - outcome.loss.sum())
    # a family without a law also explains the model-form error of another law
    form = rule.FORM * max(1, outcome.open)
    return (
        fewer
        and kinds <= {"static", *known}
        and rule.reaches(other.loss, outcome.loss, explained, form)
    )


def _changes(family: Family) -> bool:
    """Whether a family depends on time, or on an input that changes with time in the run.

    Such an input is a condition, or the orientation.
    """
    return family.kind in ("time", "condition") or family.name == "load"


def _kind(family: Family) -> str:
    """Return the input of a family; an event and a drift are of different kinds."""
    return family.name if family.kind == "time" else family.kind


def _confirmed(few: Law, outcome: Outcome, visible: float, together: bool) -> Outcome | None:
    """Return a few laws as an outcome if each is confirmed with the others present.

    Each is confirmed as the law of its family.

    If they explain everything `together`, a small misfit of one does not count. Families of
    ordinary imperfections are excluded: they would take the share of static laws.
    """
    body, plain = outcome.body, outcome.plain
    other = Outcome(body, plain, plain, outcome.state, outcome.null, outcome.loss)
    names = list(few.effects)
    for name in few.effects:
        state = State(body, plain.get([e for e in names if e != name]))
        answer = _in_place(state, plain, name)
        if answer is not None and together and (answer.law is None or answer.rough):
            answer = _reached(answer, name)
        if (
            answer is None
            or answer.law is None
            or answer.law.fit is None
            or not (answer.identified or answer.open)
        ):
            return None
        moved = body.record.rms_mm(plain.displacement(answer.law.fit, answer.law.effects[0]))
        # as for ordinary imperfections, or from some time on
        lasting = answer.family.kind in ("static", "time")
        least = max(visible, acceptance.ordinary_level(body) * lasting)
        if moved < least or not acceptance.falls_on(answer.before, answer.law.loss, body):
            return None
        if not acceptance.exceeds_model_error(
            answer.family, moved, _without_map(body, plain, names)
        ):
            return None
        other.steps.append(Step(answer, ()))
        # With the others present, another law of the family may be the best.
        names = [*(n for n in names if n != name), *answer.law.effects]
    laws = [step.answer.law for step in other.steps if step.answer.law is not None]
    split = [e for law in laws for e in law.split]
    other.state = State(body, plain.get([e for law in laws for e in law.effects], split))
    return other


def _reached(answer: Answer, name: str) -> Answer:
    """Return the result with an effect as its law, if it is the best.

    It leaves least, or no more than a law with more parameters.

    If a generic law leaves less, the result stays unchanged.
    """
    first = answer.tried[0]
    law = next((law for law in answer.tried if law.effects == (name,)), None)
    if law is None:
        return answer
    simpler = (
        bool(first.effects)
        and law.numbers < first.numbers
        and near(law.loss, first.loss, answer.before)
    )
    return (
        replace(answer, law=law, equals=(), open=False, reaching=(law,))
        if law is first or simpler
        else answer
    )


def _without_map(body: FeatureBody, fits: Fits, names: Collection[str]) -> State:
    """Return the state without static laws and drifts, which together alter a map."""
    kinds = {e: family.kind for e in names if (family := home(e)) is not None}
    return State(body, fits.get([e for e in names if kinds.get(e) not in ("static", "time")]))


def _in_place(without: State, fits: Fits, name: str) -> Answer | None:
    """Find the law of an effect's family, with all other effects present."""
    family = home(name)
    ranking = None if family is None else ranked(without, [family], [])
    if ranking is None or not ranking.rows:
        return None
    return answered(without, fits, ranking.rows[0], ranking.found, pairs=False)


def _few_laws(outcome: Outcome) -> Iterator[Law]:
    """Yield the laws of different families with the least loss.

    They are the best two, more if these add enough, and the best one.
    """
    body, fits, before = outcome.body, outcome.plain, outcome.null
    null = State(body, fits.null)
    firsts = _best_singles(null, fits, before)
    found: list[tuple[Law, State, Ranking, Representative]] = []
    for known, first in firsts.items():
        assert first.fit is not None
        state = State(body, first.fit)
        ranking = ranked(state, [f for f in families() if f != known], [], PROMISING)
        found += [(first, state, ranking, row) for row in ranking.rows]
    pairs: dict[frozenset[str], Law] = {}
    for first, state, ranking, row in sorted(found, key=lambda one: one[3].left)[:TOGETHER]:
        if pairs and not near(row.loss, min(pairs.values(), key=lambda law: law.left).loss, before):
            continue  # no law of this family will explain more
        own = home(first.effects[0])  # pairs within a family are tried at its own level 2
        names = [
            n
            for n in row.family.members
            if home(n) != own and frozenset((*first.effects, n)) not in pairs
        ]
        for law in _laws_on(state, fits, names, ranking.found):
            pairs[frozenset((*first.effects, *law.effects))] = _joined(first, law)
    one, two = (
        min(laws, key=lambda law: law.left, default=None)
        for laws in (firsts.values(), pairs.values())
    )
    alone = (
        one is not None and two is not None and not acceptance.falls_on(one.loss, two.loss, body)
    )
    if alone or acceptance.MOST < 2:
        two = None
    if two is not None:
        yield two
        if (more := _more_laws(two, body, fits)) is not None:
            yield more
    if one is not None:
        yield one


def _best_singles(null: State, fits: Fits, before: Floats) -> dict[Family, Law]:
    """Return families with their best laws, by loss, best first.

    Families are searched in the order of their fall. The search ends where a law would have to
    explain far more than its family. Another law of the family may replace it in the end.
    """
    total = float(before.sum())
    laws: list[Law] = []
    firsts: dict[Family, Law] = {}
    for row in ranked(null, families(), []).rows:
        gain, most = total - row.left, max((law.left for law in firsts.values()), default=0.0)
        if gain < rule.FALL * total or (
            len(firsts) == acceptance.ASKED and rule.DOMINATES * gain < total - most
        ):
            break
        known = {name for law in laws for name in law.effects}
        laws += _laws_on(
            null, fits, [name for name in row.family.members if name not in known], before
        )
        homes: dict[Family, Law] = {}
        for law in sorted(laws, key=lambda law: law.left):
            if (family := home(law.effects[0])) is not None:
                homes.setdefault(family, law)
        firsts = dict(list(homes.items())[: acceptance.ASKED])
    return firsts


def _more_laws(few: Law, body: FeatureBody, fits: Fits) -> Law | None:
    """Add laws of more families to a set if they lower its loss enough; else return None."""
    found = few
    while len(found.effects) < acceptance.MOST:
        assert found.fit is not None
        state, taken = State(body, found.fit), {home(name) for name in found.effects}
        ranking = ranked(state, [f for f in families() if f not in taken], [], PROMISING)
        best = found
        for row in ranking.rows[: acceptance.ASKED]:
            if not near(row.loss, best.loss, ranking.found):
                continue  # no law of this family will explain more
            names = [n for n in row.family.members if home(n) == row.family]
            best = min(
                [best, *_laws_on(state, fits, names, ranking.found)], key=lambda law: law.left
            )
        if best is found or not acceptance.falls_on(found.loss, best.loss, body):
            break
        found = _joined(found, best)
    return None if found is few else found


def _laws_on(state: State, fits: Fits, names: Collection[str], before: Floats) -> list[Law]:
    """Fit each named candidate on top of the effects found.

    A pulley that fits any smooth map is excluded.
    """
    laws = [law_of(state, fits, (name,), before) for name in fits.candidates if name in names]
    return [law for law in laws if WINDING not in law.effects or winds(law, state.body)]


def _joined(first: Law, second: Law) -> Law:
    """Return the second law, fitted on top of the first, as the law of both."""
    return replace(
        second, effects=(*first.effects, *second.effects), numbers=first.numbers + second.numbers
    )
