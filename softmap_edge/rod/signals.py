"""Signals of the memory families, which `learn` may add to a static map.

A *family* is everything that depends on the same history of the commands, whatever its law. The
core declares the families, their signals and their members among the effects (rust/families/).
Signals are plays, Dahl elements, shifts, poles, velocities, softening and time. The B-splines of
the command, which have no memory, are the control. Limit: one channel at a time; products of
channels are left to the laws. Pinned by tests/model/test_families.py and
tests/rod/test_learned_memory.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.model.effect_info import registry
from softmap_edge.rod.regression import Record

Floats = NDArray[np.float64]

CONTROL = "static map"
DRIFT = "time"
LAWLESS = (CONTROL, DRIFT)
FAST = ("delay", "rate")  # families that only frames close in time can show
TIMED = (*FAST, "creep", DRIFT)  # families that a log without time cannot show


@dataclass(frozen=True)
class Family:
    """A family: its `name` and `members`, the library's effects that act on commands."""

    name: str
    members: tuple[str, ...]

    @property
    def static(self) -> bool:
        """Whether it is the control, which has no memory."""
        return self.name == CONTROL

    @property
    def fast(self) -> bool:
        """Whether only frames close in time can show it."""
        return self.name in FAST

    @property
    def timed(self) -> bool:
        """Whether only a log with times can show it."""
        return self.name in TIMED

    def signals(self, record: Record, acting: Floats, middle: Floats, half: Floats) -> Floats:
        """Return signals (n, J) of a run's effective commands (T, C), at its seen times."""
        series = _core.Series(np.ascontiguousarray(acting), record.t, middle, half)
        return np.asarray(
            _core.Bank(self.name, acting.shape[1]).signals(series, record.t_seen, wide=True)[1].T
        )


def families() -> tuple[Family, ...]:
    """Return the families that have signals.

    The map represents the members of the control. A change with time is not a memory and is only
    reported.
    """
    on_commands = {info.name for info in registry().values() if info.on_commands and not info.needs}
    return tuple(
        Family(
            one["name"],
            () if one["name"] in LAWLESS else tuple(m for m in one["members"] if m in on_commands),
        )
        for one in _core.families()
        if one["signals"]
    )


def splines(acting: Floats, middle: Floats, half: Floats) -> Floats:
    """Return the B-splines (n, J) of effective commands (n, C), without memory."""
    series = _core.Series(np.ascontiguousarray(acting), np.arange(float(len(acting))), middle, half)
    at = np.arange(float(len(acting)))
    return np.asarray(_core.Bank(CONTROL, acting.shape[1]).signals(series, at, wide=True)[1].T)
