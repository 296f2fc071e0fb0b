"""Families, candidates and found laws of the search for a memory, with their losses.

Pinned by tests/rod/test_learned_memory.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.model.effect_info import registry
from softmap_edge.model.learned_in import Law as Certainty
from softmap_edge.rod.evidence import MOST_FOLDS
from softmap_edge.rod.law import FittedLaw
from softmap_edge.rod.regression import standard_error
from softmap_edge.rod.signals import Family

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Represented:
    """A family with the held-out loss (folds,) of its signals together with the map."""

    family: Family
    losses: Floats


@dataclass(frozen=True, eq=False)
class Candidate:
    """A candidate: an effect `name` as a family's law, or a family without one.

    It holds the held-out loss (folds,).
    """

    family: Family
    name: str
    losses: Floats
    fitted: FittedLaw | None = None

    @property
    def law(self) -> FittedLaw:
        """The fitted law of an effect."""
        assert self.fitted is not None
        return self.fitted

    @property
    def numbers(self) -> int:
        """The count of free numbers; those per channel, if evidence requires, count as one."""
        return 0 if self.fitted is None else count_numbers(self.fitted)


@dataclass(frozen=True, eq=False)
class FoundLaw:
    """Effects that were accepted together, the loss before them, and the alternatives.

    They are `short` if they do not reach the best of all, and `weak` if they explain a small part
    of the loss. Their family explains `more` if its signals, on top of them, lower the remainder
    clearly. They leave a `rest` if a good part of the first loss remains unexplained.
    """

    family: Family
    names: tuple[str, ...]
    fitted: FittedLaw
    before: Floats
    alternatives: tuple[Candidate, ...]
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

    def _is_as_good(self, other: Candidate) -> bool:
        """Whether an alternative is of another family, has as few numbers, or fits better."""
        if other.family.name != self.family.name or other.numbers <= count_numbers(self.fitted):
            return True
        fall = self.fitted.losses - other.losses
        return float(fall.sum()) > standard_error(fall) and float((fall > 0).mean()) >= MOST_FOLDS


def in_place_of(
    mine: Candidate, pairs: Sequence[tuple[Candidate, Candidate, FittedLaw]]
) -> dict[str, Candidate]:
    """Return other laws of its family by name, each with the lowest loss of its pairs."""
    found: dict[str, Candidate] = {}
    for *laws, both in sorted(pairs, key=lambda pair: -float(pair[2].losses.sum())):
        for other in laws:
            if other.family.name == mine.family.name and other.name != mine.name:
                found[other.name] = replace(other, losses=both.losses, fitted=both)
    return found


def count_numbers(fitted: FittedLaw) -> int:
    """Return how many numbers a law has; those for each channel count as one."""
    return len({label.partition("[")[0] for label in fitted.law.labels})


def twins(name: str) -> list[str]:
    """Return the effects that no run can distinguish from the effect `name`."""
    return [info.name for info in registry().values() if info.alike.get(name) == "never"]
