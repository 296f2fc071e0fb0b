"""A step of the search for a memory: effects that join the chain together, and what they replace.

Pinned by tests/rod/test_learned_memory.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.model.learned_in import Certainty
from softmap_edge.rod.memory.evidence import MOST_FOLDS
from softmap_edge.rod.memory.free_chain import FittedChain
from softmap_edge.rod.regression import standard_error
from softmap_edge.rod.signals import Family

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FittedFamily:
    """A family, and the held-out loss (folds,) mm² of its signals together with the map."""

    family: Family
    losses: Floats

    @property
    def loss(self) -> float:
        """The held-out loss over all folds, mm²."""
        return float(self.losses.sum())


@dataclass(frozen=True, eq=False)
class FittedEffect:
    """An effect `name` as the law of a family, and the fitted chain that ends with it."""

    family: Family
    name: str
    fitted: FittedChain

    @property
    def losses(self) -> Floats:
        """The held-out loss (folds,) mm²."""
        return self.fitted.losses

    @property
    def loss(self) -> float:
        """The held-out loss over all folds, mm²."""
        return self.fitted.loss


@dataclass(frozen=True, eq=False)
class Step:
    """Effects that join the chain together.

    Attributes:
        family: their family.
        names: the effects.
        fitted: the chain with them.
        before: held-out loss (folds,) without them, mm².
        alternatives: other effects, and families without a law, that fit as well.
        short: they do not reach the best of all.
        weak: they explain a small part of the loss.
        more: the signals of their family, on top of them, lower the remaining loss clearly.
        rest: a good part of the first loss remains unexplained.
    """

    family: Family
    names: tuple[str, ...]
    fitted: FittedChain
    before: Floats
    alternatives: tuple[FittedEffect | FittedFamily, ...]
    short: bool
    weak: bool
    more: bool = False
    rest: bool = False

    @property
    def certainty(self) -> Certainty:
        """Whether the law is identified.

        It must be strong, not at a bound, without an equal alternative, and leave little error.
        """
        if self.short or self.more or self.rest or self.fitted.bounded.any():
            return "open"
        alike = any(self._is_as_good(other) for other in self.alternatives)
        return "ambiguous" if alike or self.weak else "identified"

    def _is_as_good(self, other: FittedEffect | FittedFamily) -> bool:
        """Whether an alternative is of another family, has as few numbers, or fits better."""
        if other.family.name != self.family.name or isinstance(other, FittedFamily):
            return True
        if count_numbers(other.fitted) <= count_numbers(self.fitted):
            return True
        fall = self.fitted.losses - other.losses
        return float(fall.sum()) > standard_error(fall) and float((fall > 0).mean()) >= MOST_FOLDS


def count_numbers(fitted: FittedChain) -> int:
    """Return how many free numbers a chain has; those for each channel count as one."""
    return len({label.partition("[")[0] for label in fitted.chain.labels})
