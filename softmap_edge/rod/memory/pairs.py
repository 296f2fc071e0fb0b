"""Two effects of different families that only together explain the loss.

One effect after the other may fail: the first one found may stand in for both. Pinned by
tests/rod/test_learned_memory.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

from softmap_edge.rod.memory import confirm
from softmap_edge.rod.memory.chain_fit import ChainFit
from softmap_edge.rod.memory.evidence import LATER, SURE
from softmap_edge.rod.memory.free_chain import FittedChain
from softmap_edge.rod.memory.laws import EACH_TRIED, extended, per_channel
from softmap_edge.rod.memory.progress import Progress
from softmap_edge.rod.memory.step import FittedEffect, Step, count_numbers


@dataclass(frozen=True, eq=False)
class _Pair:
    """Two effects, and the fitted chain of both."""

    one: FittedEffect
    other: FittedEffect
    both: FittedChain

    def per_channel(self, fit: ChainFit) -> _Pair:
        """Return the pair with a number per channel of each effect, if that is evident."""
        both = self.both
        for effect in (self.one, self.other):
            both = per_channel(fit, FittedEffect(effect.family, effect.name, both)).fitted
        return replace(self, both=both)


def steps_together(
    progress: Progress, alone: Step, good: Sequence[FittedEffect]
) -> tuple[Step, ...]:
    """Return two steps of different families, if they explain far more than one alone.

    Args:
        progress: the search so far.
        alone: the best single step.
        good: the effects that lower the loss, lowest first.

    Returns:
        tuple: two steps, or none.
    """
    data = progress.data
    pairs = [
        _Pair(one, other, extended(data.fit, one.fitted, [*one.fitted.chain.names, other.name]))
        for one, other in combinations(good, 2)
        if one.family.name != other.family.name
    ]
    if not pairs:
        return ()
    pairs.sort(key=lambda pair: pair.both.loss)
    pairs = [pair.per_channel(data.fit) if i < EACH_TRIED else pair for i, pair in enumerate(pairs)]
    lowest = min((pair.both for pair in pairs), key=lambda both: both.loss).losses
    reach = [pair for pair in pairs if progress.near(pair.both.losses, lowest)]
    best = min(reach, key=lambda pair: (count_numbers(pair.both), pair.both.loss))
    both = best.both
    if not data.evidence.falls(alone.fitted.losses, both.losses, LATER):
        return ()
    first, second = (
        Step(
            mine.family,
            (mine.name,),
            fitted,
            before,
            tuple(_in_place_of(mine, reach).values()),
            short=False,
            weak=not data.evidence.falls(before, both.losses, SURE),
        )
        for mine, fitted, before in (
            (best.one, best.one.fitted, progress.losses),
            (best.other, both, best.one.losses),
        )
    )
    joint = replace(second, names=(best.one.name, best.other.name), before=progress.losses)
    if confirm.unconfirmed(progress, joint):
        return ()
    between = Progress.after(data, [*progress.steps, first])
    return () if confirm.unconfirmed(between, second) else (first, second)


def _in_place_of(mine: FittedEffect, pairs: Sequence[_Pair]) -> dict[str, FittedEffect]:
    """Return other effects of its family by name, each with the lowest loss of its pairs."""
    found: dict[str, FittedEffect] = {}
    for pair in sorted(pairs, key=lambda pair: -pair.both.loss):
        for other in (pair.one, pair.other):
            if other.family.name == mine.family.name and other.name != mine.name:
                found[other.name] = replace(other, fitted=pair.both)
    return found
