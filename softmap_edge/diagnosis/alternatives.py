"""Find what a finished search cannot exclude: laws and families that fit as well or look alike.

Pinned by tests/diagnosis/test_diagnosis.py and tests/diagnosis/test_two_levels.py.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softmap_edge.checks.collinear import collinear_conditions
from softmap_edge.diagnosis import decision as rule
from softmap_edge.diagnosis.evidence import equivalents
from softmap_edge.diagnosis.findings import Alternative, Untestable
from softmap_edge.diagnosis.fit import Fit
from softmap_edge.diagnosis.fits import Fits
from softmap_edge.diagnosis.outcome import Outcome, Step
from softmap_edge.diagnosis.record import Record
from softmap_edge.diagnosis.wording import OwnMisfit
from softmap_edge.model.effect_info import Registry

Floats = NDArray[np.float64]

ALONG = "mount.shift_z"  # along the axis of the straight body, where bending does not move it


def named_by(step: Step) -> tuple[str, ...]:
    """Return the effects of the law of a step."""
    return step.answer.law.effects if step.answer.law is not None else ()


def alternatives_of(
    outcome: Outcome,
    fit: Fit,
    standing: Sequence[Step],
    known: Registry,
    demoted: Sequence[str],
    impossible: Sequence[Untestable],
    own: OwnMisfit | None,
) -> list[Alternative]:
    """Return what cannot be excluded: equally good laws and families, and those of equal form.

    Args:
        outcome: the search.
        fit: the accepted laws, after demotion.
        standing: the steps of the search after demotion.
        known: the declared effects.
        demoted: the effects that were dropped.
        impossible: the effects that were not tried.
        own: the model's own effects, if other parameters fit much better.
    """
    found: list[Alternative] = []
    dropped = set(demoted)

    def add(one: Alternative) -> None:
        known = any(
            set(one.effects) == set(a.effects) and one.family in ("", a.family) for a in found
        )
        same = set(one.effects) == set(fit.effects) and not one.family
        if not known and not dropped & set(one.effects) and not same:
            found.append(one)

    for step in standing:
        named = named_by(step)
        rest = [e for e in fit.effects if e not in named]
        member = named[0] if named else ""
        for law in step.answer.equals:
            add(
                Alternative(
                    (*rest, *law.effects),
                    _why(law.loss, step.answer.loss),
                    member,
                    step.family.name,
                )
            )
        for other in step.others:
            why, effects = (
                f"the family {other.family.name} cannot be distinguished from {step.family.name} "
                "here",
                rest,
            )
            if other.identified and other.law is not None:
                why, effects = _why(other.law.loss, step.answer.loss), [*rest, *other.law.effects]
            add(Alternative(tuple(effects), why, member, other.family.name))
    for step, family, why in _confounded(outcome, standing):
        named = named_by(step)
        add(
            Alternative(
                tuple(e for e in fit.effects if e not in named),
                why,
                named[0] if named else "",
                family,
            )
        )
    for member in fit.effects:
        for twin, why in _twins(outcome.fits, fit, member, known, impossible):
            add(Alternative(tuple(twin if e == member else e for e in fit.effects), why, member))
    if own is not None and fit.effects:
        found.insert(0, Alternative(tuple(own.names), str(own), next(iter(fit.effects))))
    return found


def _confounded(outcome: Outcome, standing: Sequence[Step]) -> list[tuple[Step, str, str]]:
    """Return steps of a condition that changes with time in every run.

    Each has the family it looks like, and the reason.
    """
    conditions = [
        {c.condition: c for c in collinear_conditions(part.run)} for part in outcome.body.parts
    ]
    found = []
    for step in standing:
        pairs = {"temperature": "time", "time": "temperature", "step": "temperature"}
        other = pairs.get(step.family.name)
        if other is None or not all("temperature" in known for known in conditions):
            continue
        why = "; ".join(dict.fromkeys(str(known["temperature"]) for known in conditions))
        found.append((step, other, why))
    return found


def _why(theirs: Floats, mine: Floats) -> str:
    gap = rule.difference(theirs, mine)
    share = 100.0 * float(theirs.sum() - mine.sum()) / max(float(mine.sum()), 1e-300)
    return (
        f"fits as well: held-out loss {share:+.1f} %, "
        f"{abs(gap.fall) / max(gap.error, 1e-300):.1f} σ"
    )


def _twins(
    fits: Fits, fit: Fit, member: str, known: Registry, impossible: Sequence[Untestable]
) -> list[tuple[str, str]]:
    """Return effects that look like a member under the run's conditions.

    Each has the reason why it cannot be excluded.
    """
    record, found = fits.problem.record, []
    never = {h.name for h in impossible}
    for twin in (*equivalents(record, member), *_unbased(record, fit, member, known, never)):
        by = known[member].alike.get(twin) or known[twin].alike.get(member)
        why = f"{twin} and {member} look alike under the conditions of this run"
        if twin in fit.effects or twin not in (*fits.candidates, *never):
            continue
        if by == "roll":
            why += ": no point shows a turn about the axis"  # and so it is not fitted either
        elif twin in fits.candidates:
            other = fits.get({*fit.effects, twin} - {member}, fit.space.split)
            rest = fits.without(fit, member)
            before, mine, theirs = (float(fits.losses(f)[0].sum()) for f in (rest, fit, other))
            done = (before - theirs) / max(before - mine, 1e-300)
            # load models are too inaccurate to exclude one
            if by != "orientation" and done < rule.STANDS_FOR:
                continue
            why += f"; fitted here it does {100.0 * min(max(done, 0.0), 1.0):.0f} % of it"
        elif twin in never:
            why += "; it was not tried"
        found.append((twin, why))
    return found


def _unbased(record: Record, fit: Fit, member: str, known: Registry, never: set[str]) -> list[str]:
    """Return effects that look like a member if no point of the base is visible.

    They are effects that the model does not have.

    Bending does not move a body along its axis.
    """
    lifted = abs(fit.params.get(ALONG, 0.0)) > rule.VISIBLE_MM
    if lifted or all(base is not None for base in record.bases):
        return []
    return [twin for twin, by in known[member].alike.items() if by == "base" and twin in never]
