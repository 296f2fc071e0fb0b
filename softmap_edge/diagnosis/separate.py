"""Choose what to record next: to separate two families, and to resolve open questions.

Each family declares an experiment (`rust/families/`) that varies an input of this family only. Of
two families, the one with the more specific input is varied: a declared condition before time, time
before the command history. Of two families of one kind, it is the one declared later. So two speeds
separate delay from backlash, and a repeat after a rest separates creep from time. Two orientations
separate a load from the shape at rest. Pinned by tests/diagnosis/test_separate.py.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from softmap_edge.diagnosis.families import families, home
from softmap_edge.diagnosis.findings import (
    Alternative,
    FamilyFinding,
    Finding,
    NextBlock,
    Untestable,
)
from softmap_edge.diagnosis.wording import OwnMisfit
from softmap_edge.model.effect_info import Registry

REFIT = "`softmap model refit` on this run, then diagnose again"

# kinds of input; later ones are easier to vary alone
SPECIAL = ("static", "memory", "time", "condition")


def separating(one: str, other: str) -> tuple[str, float] | None:
    """Return the experiment that separates two families, and its minutes.

    Return None if neither declares one.

    Args:
        one: name of a family.
        other: name of another family.
    """
    every = families()
    rows = [
        (SPECIAL.index(f.kind), i, f)
        for i, f in enumerate(every)
        if f.name in (one, other) and f.experiment[0]
    ]
    return max(rows, key=lambda row: row[:2])[2].experiment if rows and one != other else None


def families_of(effects: Collection[str]) -> tuple[str, ...]:
    """Return the families that effects belong to, the first of each."""
    return tuple(dict.fromkeys(family.name for e in effects if (family := home(e)) is not None))


def mended(faults: Sequence[Finding]) -> list[NextBlock]:
    """Return what to correct manually before recording."""
    block = "correct the wiring, or the columns and signs in the mapping, and diagnose again: {}"
    cases = {f.name: p.meaning for f in faults for p in f.params.values() if p.meaning}
    return [NextBlock(block.format(case), 2.0, (name,)) for name, case in cases.items()]


def refits(own: OwnMisfit | None) -> list[NextBlock]:
    """Return the first step if the model's own effects do not fit."""
    return [] if own is None else [NextBlock(REFIT, 0.0, own.names)]


def next_blocks(
    alternatives: Sequence[Alternative],
    hidden: Sequence[Untestable],
    registry: Registry,
    named: Sequence[str],
    found: Sequence[FamilyFinding] = (),
) -> list[NextBlock]:
    """Return the blocks that resolve open questions: between families first, then between laws.

    `softmap next` simulates the separation.
    """
    blocks: dict[str, tuple[float, list[str]]] = {}

    def add(block: str, minutes: float, names: Sequence[str]) -> None:
        settles = blocks.setdefault(block, (minutes, []))[1]
        settles += [n for n in dict.fromkeys(names) if n and n not in settles]

    for pair in _near_families(found, alternatives):
        if (block := separating(*pair)) is not None:
            add(*block, pair)
    for one in alternatives:
        other = next((e for e in one.effects if e not in named), one.member)
        asked = one.member or other
        if asked in registry:
            add(*registry[asked].experiment, (one.member, other))
    for item in hidden:
        add(item.experiment, item.minutes, (item.name,))
    return [
        NextBlock(block, minutes, tuple(settles)) for block, (minutes, settles) in blocks.items()
    ]


def _near_families(
    found: Sequence[FamilyFinding], alternatives: Sequence[Alternative]
) -> list[tuple[str, str]]:
    """Return pairs of a detected family and a family that cannot be distinguished from it."""
    own = {effect: family.name for family in found for effect in family.effects}
    pairs = [(family.name, other) for family in found for other in family.alternatives]
    pairs += [
        (own[one.member], one.family) for one in alternatives if one.family and one.member in own
    ]
    return [pair for pair in dict.fromkeys(pairs) if pair[0] != pair[1]]
