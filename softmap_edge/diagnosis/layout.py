"""The parameters of a chain as a run has them: labels, units, nulls, starts and bounds, for one run or several.

What belongs to a session rather than to the robot (PER_RUN: where the base stood in the camera's frame, how it drifted,
how far the clocks were apart) has numbers of its own for each run, labelled `mount.turn_x@2` from the second on. Beside
the parameters of effects stand the numbers of the prior that are open with them.

Numbers that channels share are one parameter of the layout, `backlash.gap`, unless the layout splits their effect:
then each channel has its own, `backlash.gap[0]`. `spread` says where all numbers of the runs' chains stand in it.
Pinned by tests/test_fit.py, tests/test_several_runs.py and tests/test_shared_numbers.py.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import SoftmapError

Floats = NDArray[np.float64]

REACH_MM = 16.0  # of the finger whose commands the declared bounds in mm were chosen for
PER_RUN = ("mount", "camera_drift", "clock_shift")


@dataclass(frozen=True)
class Layout:
    """The parameters of a chain as a record has them: arrays (L,), and where each run's own chain finds its numbers.

    All numbers of the runs' chains, those of each channel by itself, are a full set (N,).
    """

    names: tuple[str, ...]
    labels: list[str]
    groups: list[str]  # labels that stand for all channels of a parameter; its own where it is not split
    units: list[str]
    null: Floats
    start: Floats
    low: Floats
    high: Floats
    log: NDArray[np.bool_]
    integer: NDArray[np.bool_]
    instant: NDArray[np.bool_]  # times within the run
    spread: NDArray[np.intp]  # parameter (N,) that each number of the full set is
    columns: list[NDArray[np.intp]]  # of each run, (chain's P,) in the full set
    declared: NDArray[np.bool_]  # parameters of effects; the others are numbers of the prior that are open with them

    @property
    def middle(self) -> Floats:
        """Mid-range (P,): halfway from null to the far end, or the start where the scale is logarithmic."""
        far = np.where(self.high > self.null, self.high, self.low)
        return np.where(self.declared, np.where(self.log, self.start, 0.5 * (self.null + far)), self.null)

    def full(self, params: Floats) -> Floats:
        """Return the full sets (..., N) of parameter sets (..., L); full sets unchanged."""
        width = params.shape[-1]
        if width not in (len(self.labels), len(self.spread)):
            raise SoftmapError(f"{len(self.labels)} parameters wanted ({', '.join(self.labels)}), got {width}")
        return params if width == len(self.spread) else params[..., self.spread]

    def values(self, params: Mapping[str, float], absent: Floats | None = None) -> Floats:
        """Return parameters (L,) by label; what only another run has is taken from its first.

        A label without an index stands for all channels. Where there is none, `absent` (L,) is taken.

        Raises:
            SoftmapError: no such parameter, or channels with different numbers where this layout has one for all.
        """
        found = [_found(params, label, group) for label, group in zip(self.labels, self.groups)]
        if absent is not None:
            return np.array([rest if value is None else value for value, rest in zip(found, absent)], float)
        if None in found:
            raise SoftmapError(f"no {self.labels[found.index(None)]} among {', '.join(params) or 'no parameters'}")
        return np.array(found, float)


def _found(params: Mapping[str, float], label: str, group: str) -> float | None:
    """Return a parameter by its label, that of the first run, that of all channels, or what all channels have."""
    for name in (label, label.split("@")[0], group):
        if name in params:
            return params[name]
    channels = {value for name, value in params.items() if label == group and name.startswith(f"{group}[")}
    if len(channels) > 1:
        raise SoftmapError(f"the channels have different numbers of {group} ({channels}); split {group.split('.')[0]}")
    return channels.pop() if channels else None


def layout_of(
    names: Sequence[str],
    chain: Any,
    changes: Sequence[Any],
    factor: Floats,
    runs: int,
    seconds: tuple[float, float],
    split: Collection[str] = (),
) -> Layout:
    """Return the parameters of a chain of `names`, those of the effects in PER_RUN once for each of `runs`.

    Args:
        names: the effects. chain: the compiled chain of them.
        changes: numbers of the prior that are open with them.
        factor: what multiplies declared starts and bounds (P,), from `per_mm`.
        runs: how many there are.
        seconds: between which an instant has enough of every run on both sides.
        split: effects whose shared parameters have a number for each channel.
    """
    count = len(chain.labels)
    own = [i for i, label in enumerate(chain.labels) if label.split(".")[0] in PER_RUN]
    source, suffix, columns = list(range(count)), [""] * count, [np.arange(count)]
    for run in range(2, runs + 1):
        column = np.arange(count)
        for i in own:
            column[i] = len(source)
            source.append(i)
            suffix.append(f"@{run}")
        columns.append(column)
    alone = [_alone(chain, i, split) for i in range(count)]
    each = [(chain.labels if alone[i] else chain.group_labels)[i] + run for i, run in zip(source, suffix)]
    labels, first, spread = _firsts(each)
    source, groups = [source[i] for i in first], [chain.group_labels[source[i]] + suffix[i] for i in first]
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
        columns = [np.append(column, len(spread) + np.arange(len(changes))) for column in columns]
        spread = np.append(spread, len(labels) + np.arange(len(changes)))
        labels, units = labels + [c.label for c in changes], units + [c.unit for c in changes]
        groups = groups + [c.label for c in changes]
        null, start = (np.append(a, [c.null for c in changes]) for a in (null, start))
        low, high = np.append(low, [c.low for c in changes]), np.append(high, [c.high for c in changes])
        log = np.append(log, np.array([c.factor for c in changes], bool))
        integer, within = (np.append(a, np.zeros(len(changes), bool)) for a in (integer, within))
    return Layout(
        tuple(names), labels, groups, units, null, start, low, high, log, integer, within, spread, columns, declared
    )


def _alone(chain: Any, i: int, split: Collection[str]) -> bool:
    """Whether a number of a chain is a parameter by itself because its effect is split."""
    return chain.labels[i].split(".")[0] in split and list(chain.tie).count(chain.tie[i]) > 1


def _firsts(labels: Sequence[str]) -> tuple[list[str], list[int], NDArray[np.intp]]:
    """Return the different ones of `labels` in order, where each comes first, and which of them each label is."""
    place = {label: k for k, label in enumerate(dict.fromkeys(labels))}
    first = {label: i for i, label in reversed([*enumerate(labels)])}
    return list(place), [first[label] for label in place], np.array([place[label] for label in labels], np.intp)


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
