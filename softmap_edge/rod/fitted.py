"""The result of a fit of a rod to a reference run.

Pinned by tests/rod/test_elastic.py and tests/rod/test_rod.py.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.files.atomic import Document
from softmap_edge.model.basis import SQUARES, Basis
from softmap_edge.model.polynomial_rod import RodArrays
from softmap_edge.rod.memory.memory import Memory
from softmap_edge.run.folds import Folds

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class FittedNumber:
    """A fitted number: `value` ± `sigma` (one standard deviation) in `unit`.

    If it is not identified, `note` is the reason.
    """

    label: str
    value: float
    sigma: float
    unit: str
    at_bound: bool
    note: str = ""

    def to_dict(self) -> Document:
        """Return it in document form, with six digits."""
        return asdict(self) | {
            "value": float(f"{self.value:.6g}"),
            "sigma": float(f"{self.sigma:.3g}"),
        }

    def __str__(self) -> str:
        text = f"{self.label:<14} {self.value:9.3f} ± {self.sigma:<8.3g} {self.unit:<6}"
        return " ".join([text, "at its bound" if self.at_bound else "", self.note]).rstrip()


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fitted rod with its memory.

    Attributes:
        rod: the rod.
        memory: the memory in series with it.
        residuals: predicted − seen (n, K, 3) mm, held out.
        parts: the folds that gave them.
        made_from: how it was fitted, for the manifest of a bundle.
        numbers: the fitted numbers of an elastic rod.
        basis: the terms for the coverage of commands.
    """

    rod: RodArrays
    memory: Memory
    residuals: Floats
    parts: Folds
    made_from: Document
    numbers: tuple[FittedNumber, ...] = ()
    basis: Basis = SQUARES
