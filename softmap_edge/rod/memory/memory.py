"""The memory of a robot, as a search found it.

Pinned by tests/rod/test_learned_memory.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from softmap_edge.model.learned_in import LearnedIn
from softmap_edge.rod.regression import Drive

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Memory:
    """The memory of a robot: a chain of effects, and what is known of each.

    Attributes:
        names: the effects of the chain.
        params: their parameters by label.
        learned_in: the record of each effect, and of a family without a law.
        noise_mm: noise of a target, mm; None if it was not estimated.
        notes: remarks for the user.
    """

    names: tuple[str, ...] = ()
    params: Mapping[str, float] = field(default_factory=dict)
    learned_in: tuple[LearnedIn, ...] = ()
    noise_mm: float | None = None
    notes: tuple[str, ...] = ()

    def acting(self, drive: Drive) -> Floats:
        """Return the effective commands (n, C) at the frame times."""
        return drive.acting(self.names, self.params)
