"""Level 2 of the search for a memory: fit the effects of the families that lower the loss.

Each effect joins the chain of the steps before, with one number for all channels. The best ones are
also fitted with a number per channel. Pinned by tests/rod/test_learned_memory.py.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softmap_edge.rod.memory.chain_fit import ChainFit
from softmap_edge.rod.memory.evidence import LATER, MOST_FOLDS, SURE
from softmap_edge.rod.memory.free_chain import FittedChain, FreeChain
from softmap_edge.rod.memory.progress import Progress, SearchData
from softmap_edge.rod.memory.step import FittedEffect, FittedFamily
from softmap_edge.rod.regression import standard_error

EACH = 0.05  # of the loss: least gain from a number per channel over a shared one
EACH_TRIED = 3  # best laws with shared numbers that are tried with a number per channel
# of a law's remainder above the noise: a second law with less is model-form error
PAIR = 0.8


def falling_effects(progress: Progress, falling: Sequence[FittedFamily]) -> list[FittedEffect]:
    """Return the effects of some families that lower the loss as well, lowest first."""
    good = [one for one in _fitted_effects(progress, falling) if progress.falls(one.losses)]
    return sorted(good, key=lambda one: one.loss)


def _fitted_effects(progress: Progress, falling: Sequence[FittedFamily]) -> list[FittedEffect]:
    """Return the fitted effects of all families that fall, behind the steps before.

    A law behind a map of many channels may explain more than the signals of single channels. So the
    members of all these families are fitted, not only those of the nearest.
    """
    there, fit = progress.names, progress.data.fit
    alike = [
        FittedEffect(one.family, member, extended(fit, progress.last, [*there, member]))
        for one in falling
        for member in one.family.members
        if member not in there
    ]
    alike.sort(key=lambda one: one.loss)
    effects = [per_channel(fit, one) if i < EACH_TRIED else one for i, one in enumerate(alike)]
    best = min(effects, key=lambda one: one.loss, default=None)
    if best is None or not best.fitted.chain.split:
        return effects
    # Compare a law with a number per channel with others of the same kind.
    return [
        per_channel(fit, one, if_lower=True) if one.family.name == best.family.name else one
        for one in effects
    ]


def extended(fit: ChainFit, start: FittedChain | None, names: Sequence[str]) -> FittedChain:
    """Fit a chain of `names` from the numbers of a shorter one, if there is one."""
    if start is None:
        return fit.scanned(FreeChain.of_effects(names, fit.drive), {})
    chain = FreeChain.of_effects(names, fit.drive, start.chain.split)
    return fit.scanned(chain, start.numbers)


def per_channel(fit: ChainFit, effect: FittedEffect, if_lower: bool = False) -> FittedEffect:
    """Return an effect with a number per channel, if the evidence requires it.

    With `if_lower`, a lower loss is sufficient.
    """
    fitted, name = effect.fitted, effect.name
    chain = FreeChain.of_effects(fitted.chain.names, fit.drive, [*fitted.chain.split, name])
    if len(chain.labels) == len(fitted.chain.labels):
        return effect  # one channel, or an effect whose numbers belong to the robot
    start = chain.at(fitted.numbers)
    scanned = start
    for i, label in enumerate(chain.labels):
        if label.startswith(f"{name}.") and "[" in label:
            scanned = fit.scanned_along(chain, scanned, i)
    better = fit.refined(chain, np.stack([start, scanned]))
    fall = fitted.losses - better.losses
    least = 0.0 if if_lower else max(standard_error(fall), EACH * fitted.loss)
    in_most = if_lower or (better.losses < fitted.losses).mean() >= MOST_FOLDS
    if fall.sum() > least and in_most:
        return FittedEffect(effect.family, name, better)
    return effect


def with_second(data: SearchData, effect: FittedEffect) -> tuple[FittedChain, str, bool]:
    """Add a second member of an effect's family, if that explains the remaining loss.

    The pair must explain nearly all of it.

    Returns:
        tuple: the chain; the second member, or ""; whether a second member explains a good part of
        the remaining loss and none joined, so the form of the law alone is not right.
    """
    alone = effect.fitted
    left = data.evidence.above(alone.losses)
    best, second, more = alone, "", False
    for member in effect.family.members:
        if member in alone.chain.names:
            continue
        both = extended(data.fit, alone, [*alone.chain.names, member])
        fall = float((alone.losses - both.losses).sum())
        more = more or data.evidence.falls(alone.losses, both.losses, SURE)
        if (
            fall > PAIR * left
            and data.evidence.falls(alone.losses, both.losses, LATER)
            and both.losses.sum() < best.losses.sum()
        ):
            best, second = both, member
    return best, second, more and not second
