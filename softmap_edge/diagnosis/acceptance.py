"""Decide whether a family is accepted.

Criteria: its fall on held-out folds, ordinary imperfections, and families like it.

Units: mm. Pinned by tests/diagnosis/test_decision.py and tests/diagnosis/test_two_levels.py.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis import decision as rule
from softmap_edge.diagnosis.decision import difference, near, seen_to_fall
from softmap_edge.diagnosis.families import Family, FeatureBody, families
from softmap_edge.diagnosis.laws import WINDING, Answer
from softmap_edge.diagnosis.record import Record
from softmap_edge.diagnosis.representatives import RIDGES, Ranking, Representative, State

Floats = NDArray[np.float64]

# it fits any static law, so it is taken only if no other family is accepted
CATCH_ALL = "static shape"
# families of ordinary imperfections
BACKGROUND = ("static map", "static shape", "frame", "load")
MOST = 4  # most families that are taken
ASKED = 3  # most near families whose laws are tried
# order in which near families are taken
SIMPLER = {"static": 1, "memory": 2, "condition": 2, "time": 3}


def falls_on(
    before: Floats, after: Floats, body: FeatureBody, share: float | None = None, laws: bool = False
) -> bool:
    """Whether a loss (folds,) clearly falls, by a `share` of the loss above the noise.

    `share` is FALL_NEXT by default.

    If the loss is no more than noise, the noise estimate is too large or nothing is missing. Then
    the share is of the complete loss. `laws`: laws were found before, which add model-form error.
    """
    fall, total = difference(before, after), float(before.sum())
    least = (rule.FALL if stands_out(before, body, laws) else rule.FALL_FIRST) * total
    above = max(0.0, total - rule.ABOVE_NOISE * body.problem.numbers)
    return seen_to_fall(fall) and fall.fall >= max(
        least, (rule.FALL_NEXT if share is None else share) * above
    )


def stands_out(loss: Floats, body: FeatureBody, laws: bool) -> bool:
    """Whether a loss (folds,) exceeds the noise; the form of found `laws` may add to it."""
    return float(loss.sum()) > body.problem.numbers * (rule.ABOVE_NOISE if laws else 1.0)


def accepted(
    row: Representative, ranking: Ranking, state: State, later: bool, visible: float
) -> bool:
    """Whether a family is accepted: its loss falls enough, and its effect size is visible.

    The loss must fall in enough folds, too.
    """
    problem = state.body.problem
    if not falls_on(
        ranking.before, row.loss, state.body, rule.FALL_NEXT if later else rule.FALL_FIRST, later
    ):
        return False
    measured = problem.noise.measured and not problem.record.error_is_noise
    noise = problem.noise.rms_mm(problem.record.positions) / np.sqrt(3.0) if measured else 0.0
    static = row.family.kind == "static"
    if row.family.kind == "time" and rule.in_one_fold(ranking.before, row.loss):
        return False  # an event also affects later folds
    if static and not beyond_ordinary(ranking, state):
        return False
    record = state.body.record
    # Model error that imperfections do not explain is noise for a memory family, too.
    if record.error_is_noise and (
        row.family.kind in ("static", "time") or state is not state.without_background()
    ):
        if difference(ranking.before, row.loss).fall < rule.FALL_NEXT * float(ranking.before.sum()):
            return False
        if not exceeds_model_error(row.family, row.moved_mm, state):
            return False
    own = state is not state.without_background() if record.error_is_noise else static
    return row.moved_mm >= max(visible, float(noise), record.form_mm if own else 0.0)


def exceeds_model_error(family: Family, moved_mm: float, state: State) -> bool:
    """Whether a static effect, or a drift, of size `moved_mm` exceeds the model error.

    It applies to a freely learned map.

    Such a map contains every static effect of the training robot. A new effect adds to the model
    error. The test allows for the standard errors of this run and of the mean over the folds. The
    run counts as that many folds. `state` is the state without the effect.
    """
    record = state.body.record
    if family.kind not in ("static", "time") or not state.body.free_map:
        return True
    folds = np.square(record.model.made_from.get("per_fold_mm", ()))
    scatter = float(folds.std(ddof=1)) if len(folds) > 1 else 0.0
    own = record.form_mm**2 + rule.SCATTER * scatter * float(np.sqrt(2.0 / max(1, len(folds))))
    return moved_mm**2 <= rule.DOMINATES * (record.rms_mm(state.residual) ** 2 - own)


def is_ordinary(ranking: Ranking, state: State) -> bool:
    """Whether a static family is best, or near it, with ordinary imperfections only.

    Ordinary imperfections may then explain all static misfit.
    """
    best = ranking.rows[0].loss if ranking.rows else ranking.before
    static = any(
        row.family.kind == "static" and near(row.loss, best, ranking.before) for row in ranking.rows
    )
    return static and ordinary_level(state.body) > 0.0 and not beyond_ordinary(ranking, state)


def beyond_ordinary(ranking: Ranking, state: State) -> bool:
    """Whether the static misfit exceeds the ordinary imperfections of the robot."""
    return _static_mm(ranking, state) >= rule.DOMINATES * ordinary_level(state.body)


def ordinary_level(body: FeatureBody) -> float:
    """Return the level of ordinary imperfections, mm RMS.

    Static effects from `DOMINATES` times it are discoveries.

    A map learned from the robot itself contains its imperfections. A single small change since
    then, such as a refitted servo, would stand out like an effect. There, the level is a share of
    the motion.
    """
    return (
        rule.ORDINARY / rule.DOMINATES * motion_mm(body.record)
        if body.free_map
        else body.ordinary_mm
    )


def _static_mm(ranking: Ranking, state: State) -> float:
    record = state.body.record
    return record.rms_mm(np.where(np.isfinite(record.seen), ranking.static, np.nan))


def ordinary(state: State, ranking: Ranking, every: Sequence[Family]) -> float:
    """Return the level of the robot's ordinary static imperfections, mm RMS.

    If one effect dominates the static misfit, the level is the rest of the misfit. Otherwise it is
    the complete misfit, the sum of many small imperfections. It is limited to a share of the
    motion: anything larger is an effect.
    """
    body, record = state.body, state.body.record
    seen, level = np.isfinite(record.seen), state.body.level()
    static = [f for f in every if f.kind == "static"]
    names = dict.fromkeys(
        e for f in static for e in f.members if e in body.candidates and e != WINDING
    )
    singles = {name: own for name in names if (own := body.single(name)) is not None}
    singles |= body.curves(state.commands, state.slopes)
    for name, own in singles.items():
        body.add(level, name, own)
    level.close(np.ascontiguousarray(body.modes(state.residual)))

    def size(shift: Floats) -> float:
        return record.rms_mm(np.where(seen, shift, np.nan))

    total = size(ranking.static)
    crossed = [
        row.columns.shift(row.theta) for row in ranking.rows if row.family.name == "coupling"
    ]
    shifts = crossed + [
        own.shift(np.asarray(level.theta([n], [RIDGES[0]])[0])) for n, own in singles.items()
    ]
    pairs = [(size(ranking.static - shift), size(shift)) for shift in shifts]
    left = min((left for left, moved in pairs if moved >= rule.DOMINATES * left), default=total)
    level_mm = min(left, rule.ORDINARY * motion_mm(record))
    return float(max(level_mm, record.frame_mm))  # the alignment states its error


def motion_mm(record: Record) -> float:
    """Return the body's motion about its mean, mm RMS, over features that are ever seen."""
    seen = np.isfinite(record.seen)
    mean = np.where(seen, record.seen, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    return record.rms_mm(record.seen - mean)


def one_pose(body: FeatureBody) -> bool:
    """Whether the commands never change: one shape cannot support two laws."""
    return not np.any(np.ptp(body.record.command, axis=0))


def order_of(family: Family) -> int:
    """Return the place of a family among equals: the simplest first."""
    return 0 if family.name == "static map" else SIMPLER[family.kind]


def indistinct(other: Answer, first: Answer, ranking: Ranking, state: State) -> bool:
    """Whether a family cannot be distinguished from the first one.

    It can be distinguished only if it alone leaves more than noise.
    """
    if rule.leaves_cause(other.loss, first.loss, state.body.problem.numbers):
        return False
    if other.identified and first.identified:
        laws = [law for law in other.tried if law.effects and law.numbers <= first.numbers + 2]
        return any(near(law.loss, first.loss, ranking.before) for law in laws)
    if first.identified and rule.clears(first.loss, other.loss, state.body.problem.numbers):
        return False  # free columns have more parameters than a law that leaves noise
    if first.identified and first.family.kind == "static" and other.family.name == CATCH_ALL:
        return False  # it fits any static law, including this one
    reference = first.loss if first.identified else first.representative.loss
    if not near(other.representative.loss, reference, ranking.before):
        return False
    return not (
        order_of(first.family) < order_of(other.family)
        and does_the_same(other, first, ranking, state)
    )


def does_the_same(other: Answer, first: Answer, ranking: Ranking, state: State) -> bool:
    """Whether a static map of the commands, or the first family, can reproduce a family."""
    body = state.body
    theta = ranking.level.theta(
        [*ranking.names, other.family.name], [*ranking.ridges, other.representative.ridge]
    )[-1]
    target = np.asarray(ranking.level.fitted(other.family.name, theta))
    names = dict.fromkeys(("static map", "coupling", first.family.name))
    rows = []
    for family in families():
        if (
            family.name in names
            and (columns := body.columns(family, state.commands, state.slopes)) is not None
        ):
            rows.append(body.modes(columns.base)[columns.which] * columns.weight[:, :, None])
    x = np.concatenate(rows).reshape(sum(map(len, rows)), -1)
    gram = x @ x.T
    gram.flat[:: len(gram) + 1] += RIDGES[0]
    z = target.ravel()
    return bool(
        1.0 - np.sum((z - np.linalg.solve(gram, x @ z) @ x) ** 2) / max(float(z @ z), 1e-300)
        > rule.MIMIC
    )
