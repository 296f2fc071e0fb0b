"""The parameters of a chain as a run has them: labels, units, nulls, starts and bounds, for one run or several.

What belongs to a session rather than to the robot (PER_RUN: where the base stood in the camera's frame, how it drifted,
how far the clocks were apart) has numbers of its own for each run, labelled `mount.turn_x@2` from the second on. Beside
the parameters of effects stand the numbers of the prior that are open with them. Pinned by tests/test_fit.py and
tests/test_several_runs.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

REACH_MM = 16.0  # of the finger whose commands the declared bounds in mm were chosen for
PER_RUN = ("mount", "camera_drift", "clock_shift")


@dataclass(frozen=True)
class Layout:
    """The parameters of a chain as a record has them: arrays (P,), and where each run's own chain finds its numbers."""

    names: tuple[str, ...]
    labels: list[str]
    units: list[str]
    null: Floats
    start: Floats
    low: Floats
    high: Floats
    log: NDArray[np.bool_]
    integer: NDArray[np.bool_]
    instant: NDArray[np.bool_]  # times within the run
    columns: list[NDArray[np.intp]]  # of each run, (chain's P,)
    declared: NDArray[np.bool_]  # parameters of effects; the others are numbers of the prior that are open with them

    @property
    def middle(self) -> Floats:
        """Mid-range (P,): halfway from null to the far end, or the start where the scale is logarithmic."""
        far = np.where(self.high > self.null, self.high, self.low)
        return np.where(self.declared, np.where(self.log, self.start, 0.5 * (self.null + far)), self.null)

    def values(self, params: Mapping[str, float]) -> Floats:
        """Return parameters (P,) by label; what only another run has is taken from its first."""
        return np.array([params[label] if label in params else params[label.split("@")[0]] for label in self.labels])


def layout_of(
    names: Sequence[str], chain: Any, changes: Sequence[Any], factor: Floats, runs: int, seconds: tuple[float, float]
) -> Layout:
    """Return the parameters of a chain of `names`, those of the effects in PER_RUN once for each of `runs`.

    Args:
        names: the effects. chain: the compiled chain of them.
        changes: numbers of the prior that are open with them.
        factor: what multiplies declared starts and bounds (P,), from `per_mm`.
        runs: how many there are.
        seconds: between which an instant has enough of every run on both sides.
    """
    count = len(chain.labels)
    own = [i for i, label in enumerate(chain.labels) if label.split(".")[0] in PER_RUN]
    source, labels, columns = list(range(count)), list(chain.labels), [np.arange(count)]
    for run in range(2, runs + 1):
        column = np.arange(count)
        for i in own:
            column[i] = len(source)
            source.append(i)
            labels.append(f"{chain.labels[i]}@{run}")
        columns.append(column)
    start, low, high = ((factor * np.asarray(x, float))[source] for x in (chain.start, chain.low, chain.high))
    within = np.asarray(chain.instant, bool)[source]
    if np.any(within) and seconds[0] < seconds[1]:
        low, high = np.where(within, seconds[0], low), np.where(within, seconds[1], high)
        start = np.clip(start, low, high)
    null = np.asarray(chain.null, float)[source]
    integer = np.asarray(chain.integer, bool)[source]
    log, units = np.asarray(chain.log, bool)[source], [chain.units[i] for i in source]
    declared = np.arange(len(labels) + len(changes)) < len(labels)
    if changes:
        columns = [np.concatenate([column, np.flatnonzero(~declared)]) for column in columns]
        labels, units = labels + [c.label for c in changes], units + [c.unit for c in changes]
        null, start = (np.append(a, [c.null for c in changes]) for a in (null, start))
        low, high = np.append(low, [c.low for c in changes]), np.append(high, [c.high for c in changes])
        log = np.append(log, np.array([c.factor for c in changes], bool))
        integer, within = (np.append(a, np.zeros(len(changes), bool)) for a in (integer, within))
    return Layout(tuple(names), labels, units, null, start, low, high, log, integer, within, columns, declared)


def per_mm(model: Any, library: Any, chain: Any) -> Floats:
    """Return by what (P,) to multiply declared starts and bounds: those in mm of command, where commands are not mm.

    They are declared for tendons that move by REACH_MM to each side. A drive in degrees, radians or ticks moves by
    another number, and its play may be that many times larger.
    """
    factor, reach = np.ones(len(chain.labels)), np.asarray(getattr(model, "command_range", np.zeros((0, 2))), float)
    if getattr(model, "command_unit", "mm") in ("mm", "N") or not len(reach):
        return factor
    half = float(np.median(0.5 * np.ptp(reach, axis=1)))
    in_commands = {e["name"] for e in library.effects() if e["role"] == "channel"}
    commanded = [
        unit.startswith("mm") and label.split(".")[0] in in_commands for label, unit in zip(chain.labels, chain.units)
    ]
    return np.where(commanded, half / REACH_MM, factor) if half > 0 else factor
