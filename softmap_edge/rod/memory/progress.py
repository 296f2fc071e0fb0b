"""The state of a search for a memory: its data, its steps, and the loss they leave.

Pinned by tests/rod/test_learned_memory.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.rod.memory.chain_fit import ChainFit
from softmap_edge.rod.memory.evidence import FIRST, LATER, Evidence
from softmap_edge.rod.memory.free_chain import FittedChain
from softmap_edge.rod.memory.step import Step
from softmap_edge.rod.reference_run import ReferenceFrames
from softmap_edge.rod.static_map import StaticMap

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SearchData:
    """The frames of a search, the fit of chains with the static map, and what counts as evidence.

    The evidence is that of the first map: its noise hardly depends on the map.
    """

    seen: ReferenceFrames
    fit: ChainFit
    evidence: Evidence

    @classmethod
    def of(cls, seen: ReferenceFrames, static: StaticMap, seed: int) -> SearchData:
        """Return the data of a search with a static map; `seed` is that of the scans."""
        fit = ChainFit(seen.drive, static, seed, seen.unit)
        return cls(seen, fit, Evidence.of(seen, static))

    @property
    def static(self) -> StaticMap:
        """The static map that is solved with every chain."""
        return self.fit.static

    def with_map(self, static: StaticMap) -> SearchData:
        """Return the data with another static map."""
        fit = ChainFit(self.fit.drive, static, self.fit.seed, self.fit.unit)
        return replace(self, fit=fit)


@dataclass(frozen=True, eq=False)
class Progress:
    """The search after some steps.

    Attributes:
        data: what is compared.
        steps: the steps so far.
        acting: effective commands (n, C) after them.
        losses: held-out loss (folds,) of the static map on these commands, mm².
    """

    data: SearchData
    steps: tuple[Step, ...]
    acting: Floats
    losses: Floats

    @classmethod
    def after(cls, data: SearchData, steps: Sequence[Step]) -> Progress:
        """Return the state of a search after some steps."""
        acting = steps[-1].fitted.acting if steps else data.seen.drive.commanded
        return cls(data, tuple(steps), acting, data.static.losses(acting))

    @property
    def last(self) -> FittedChain | None:
        """The chain of all steps; None before the first."""
        return self.steps[-1].fitted if self.steps else None

    @property
    def names(self) -> list[str]:
        """The effects of all steps."""
        return [name for step in self.steps for name in step.names]

    def falls(self, losses: Floats) -> bool:
        """Whether a held-out loss (folds,) is far enough below the present one for a step."""
        return self.data.evidence.falls(self.losses, losses, LATER if self.steps else FIRST)

    def near(self, losses: Floats, best: Floats) -> bool:
        """Whether a held-out loss (folds,) equals the best one."""
        return self.data.evidence.near(losses, best, self.losses)
