"""A chain of effects with free numbers, each scaled to 0 … 1 over its range.

The scale is logarithmic if the range is positive. Ranges declared in mm are those of a drive of ±16
mm, and scale with the drive. The registry declares how far a number may go while a static map is
fitted as well. Pinned by tests/rod/test_free_chain.py and tests/rod/test_learned_memory.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.model.chain_labels import named, readings
from softmap_edge.model.parameter_layout import REACH_MM
from softmap_edge.rod.regression import Drive, Record

Floats = NDArray[np.float64]
Index = NDArray[np.intp]

BOUND = 1e-3  # of the range: distance within which a number is at its bound


@dataclass(frozen=True, eq=False)
class FreeChain:
    """A chain of effects whose numbers are free within ranges.

    Attributes:
        core: the compiled chain, with P parameters.
        labels: labels of the D free numbers.
        of: the free number (P,) of each parameter.
        low, high: range (D,) of each free number.
        log: whether the scale of a free number (D,) is logarithmic.
    """

    core: _core.Chain
    labels: tuple[str, ...]
    of: Index
    low: Floats
    high: Floats
    log: NDArray[np.bool_]

    @classmethod
    def of_effects(cls, names: Sequence[str], drive: Drive, split: Sequence[str] = ()) -> FreeChain:
        """Return a chain with one free number for all channels.

        The effects in `split` have one for each channel or cable.
        """
        core = _core.Chain(list(names), drive.channels)
        every = [
            label if label.split(".")[0] in split else group
            for label, group in zip(core.labels, core.group_labels)
        ]
        labels = tuple(dict.fromkeys(every))
        low, high = _ranges(core, every, drive)
        first = [every.index(label) for label in labels]
        of = np.array([labels.index(label) for label in every], np.intp)
        return cls(core, labels, of, low[first], high[first], low[first] > 0)

    @property
    def names(self) -> tuple[str, ...]:
        """The effects in the order of the chain."""
        return tuple(self.core.names)

    @property
    def split(self) -> list[str]:
        """The effects that have a number per channel or cable."""
        return sorted({label.split(".")[0] for label in self.labels if "[" in label})

    def values(self, x: Floats) -> Floats:
        """Return the free numbers (…, D) in user units from x in 0 … 1."""
        low = np.where(self.log, self.low, 1.0)
        return np.where(
            self.log, low * (self.high / low) ** x, self.low + (self.high - self.low) * x
        )

    def params(self, x: Floats) -> Floats:
        """Return parameters (…, P) of the chain."""
        return np.ascontiguousarray(self.values(x)[..., self.of])

    def at(self, values: Mapping[str, float]) -> Floats:
        """Return x (D,) of values by label; missing ones are at the middle of the range."""
        x = np.full(len(self.labels), 0.5)
        for i, label in enumerate(self.labels):
            value = next(
                (values[name] for name in readings(label, label.split("[")[0]) if name in values),
                None,
            )
            if value is not None:
                low, high = float(self.low[i]), float(self.high[i])
                share = (
                    np.log(value / low) / np.log(high / low)
                    if self.log[i]
                    else (value - low) / (high - low)
                )
                x[i] = np.clip(share, 0.0, 1.0)
        return x


def _ranges(core: _core.Chain, labels: Sequence[str], drive: Drive) -> tuple[Floats, Floats]:
    """Return the lowest and the highest value (P,) of the parameters of a chain.

    A label with an index has the half range of its channel, any other the median one.
    """
    median = float(np.median(drive.half))
    half = np.array(
        [
            float(drive.half[int(label.partition("[")[2].rstrip("+-]"))])
            if "[" in label
            else median
            for label in labels
        ]
    )
    in_mm = np.array([unit.startswith("mm") for unit in core.units], bool)
    low = np.where(in_mm, core.low * half / REACH_MM, core.low)
    high = np.where(in_mm, core.high * half / REACH_MM, core.high)
    high = np.where(core.map_high > 0, core.map_high, high)
    return low, np.where(core.map_half_ranges > 0, core.map_half_ranges * half, high)


@dataclass(frozen=True, eq=False)
class FittedChain:
    """A chain with fitted numbers.

    Attributes:
        chain: the chain and the ranges of its numbers.
        x: free numbers (D,) in 0 … 1.
        acting: effective commands (n, C) at the frame times.
        losses: held-out loss (folds,) mm².
        idle: numbers (D,) at their bound without effect: a channel may have no play.
    """

    chain: FreeChain
    x: Floats
    acting: Floats
    losses: Floats
    idle: NDArray[np.bool_]

    @property
    def loss(self) -> float:
        """The held-out loss over all folds, mm²."""
        return float(self.losses.sum())

    @property
    def params(self) -> dict[str, float]:
        """The parameters by label, as a model holds them."""
        return named(self.chain.core, self.chain.params(self.x))

    @property
    def numbers(self) -> dict[str, float]:
        """The free numbers by label."""
        return dict(zip(self.chain.labels, self.chain.values(self.x).tolist()))

    @property
    def bounded(self) -> NDArray[np.bool_]:
        """Which free numbers (D,) are at a bound of their range with an effect there."""
        return at_bound(self.x) & ~self.idle

    def effective(self, record: Record) -> Floats:
        """Return the effective commands (T, C) of a run."""
        return np.asarray(record.rolled(self.chain.core, self.chain.params(self.x)[None])[0])


def at_bound(x: Floats) -> NDArray[np.bool_]:
    """Return which numbers in 0 … 1 are at a bound."""
    return np.asarray((x < BOUND) | (x > 1.0 - BOUND))
