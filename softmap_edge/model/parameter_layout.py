"""Parameters of a chain for one run or several: labels, units, nulls, starts and bounds.

Parameters of a session, not of the robot (PER_RUN: the pose of the base in the camera's frame, its
drift, the offset of the clocks), have separate numbers for each run, labelled `mount.turn_x@2` from
the second on. The free numbers of the prior are listed with the parameters of effects.

Numbers shared by channels are one parameter of the layout, `backlash.gap`, unless the layout splits
their effect. Then each channel or cable has its own, `backlash.gap[0]`. `spread` maps the layout to
the numbers of the runs' chains. Pinned by tests/diagnosis/test_fit.py,
tests/diagnosis/test_several_runs.py and tests/model/test_shared_numbers.py.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import SoftmapError
from softmap_edge.model.chain_labels import readings
from softmap_edge.model.effect_info import effects_that

if TYPE_CHECKING:
    from softmap_edge.model.elastic_rod import Change
    from softmap_edge.model.model import Model

Floats = NDArray[np.float64]

REACH_MM = 16.0  # reach of the finger for which the declared bounds in mm were chosen
PER_RUN = ("mount", "camera_drift", "clock_shift")


@dataclass(frozen=True, eq=False)
class Ranges:
    """Start and search range (P,) of the fits of a chain, and their `limit` beyond `high`."""

    start: Floats
    low: Floats
    high: Floats
    limit: Floats


@dataclass(frozen=True)
class Layout:
    """The parameters of a chain: arrays (L,), and their positions in each run's chain.

    A full set (N,) holds all numbers of the runs' chains, one per channel.
    """

    names: tuple[str, ...]
    labels: list[str]
    groups: list[str]  # label for all channels of a parameter; its own label if not split
    units: list[str]
    null: Floats
    start: Floats
    low: Floats
    high: Floats
    limit: Floats  # beyond `high`, for parameters that may exceed the plausible range
    log: NDArray[np.bool_]
    integer: NDArray[np.bool_]
    instant: NDArray[np.bool_]  # time within the run
    spread: NDArray[np.intp]  # parameter for each number of the full set, (N,)
    columns: list[NDArray[np.intp]]  # positions (P,) of each run's numbers in the full set
    # parameters of effects; the others are free numbers of the prior
    declared: NDArray[np.bool_]

    @property
    def middle(self) -> Floats:
        """Typical strength (P,), halfway from null to the far end.

        It is the start for a logarithmic scale.
        """
        far = np.where(self.high > self.null, self.high, self.low)
        return np.where(
            self.declared, np.where(self.log, self.start, 0.5 * (self.null + far)), self.null
        )

    def full(self, params: Floats) -> Floats:
        """Return the full sets (..., N) of parameter sets (..., L); full sets are unchanged."""
        width = params.shape[-1]
        if width not in (len(self.labels), len(self.spread)):
            raise SoftmapError(
                f"{len(self.labels)} parameters expected ({', '.join(self.labels)}), got {width}"
            )
        return params if width == len(self.spread) else params[..., self.spread]

    def values(self, params: Mapping[str, float], absent: Floats | None = None) -> Floats:
        """Return parameters (L,) by label; numbers missing for a run are those of the first run.

        A label without an index applies to all channels. Missing labels take `absent` (L,).

        Raises:
            SoftmapError: there is no such parameter, or channels have different numbers where this
                layout has one for all.
        """
        found = [_found(params, label, group) for label, group in zip(self.labels, self.groups)]
        if absent is not None:
            return np.array(
                [rest if value is None else value for value, rest in zip(found, absent)], float
            )
        if None in found:
            raise SoftmapError(
                f"no {self.labels[found.index(None)]} among {', '.join(params) or 'no parameters'}"
            )
        return np.array(found, float)


def _found(params: Mapping[str, float], label: str, group: str) -> float | None:
    """Return a parameter by its label, that of the first run, or that of all channels.

    If there is none, return the values of the channels.
    """
    for name in (label, *readings(label.split("@")[0], group)):
        if name in params:
            return params[name]
    each = {
        value for name, value in params.items() if label == group and name.startswith(f"{group}[")
    }
    if len(each) > 1:
        raise SoftmapError(
            f"the channels have different numbers of {group} ({each}); split {group.split('.')[0]}"
        )
    return each.pop() if each else None


def layout_of(
    names: Sequence[str],
    chain: _core.Chain,
    changes: Sequence[Change],
    ranges: Ranges,
    runs: int,
    seconds: tuple[float, float],
    split: Collection[str] = (),
) -> Layout:
    """Return the parameters of a chain of `names`; effects in PER_RUN have theirs once per run.

    Args:
        names: the effects.
        chain: the compiled chain of them.
        changes: free numbers of the prior.
        ranges: search ranges of its numbers on this robot, from `ranges_of`.
        runs: number of runs.
        seconds: interval in which an instant leaves enough of every run on both sides.
        split: effects whose shared parameters have a number per channel or cable.
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
    each = [
        (chain.labels if alone[i] else chain.group_labels)[i] + run
        for i, run in zip(source, suffix)
    ]
    labels, first, spread = _firsts(each)
    source, groups = (
        [source[i] for i in first],
        [chain.group_labels[source[i]] + suffix[i] for i in first],
    )
    start, low, high, limit = (
        a[source] for a in (ranges.start, ranges.low, ranges.high, ranges.limit)
    )
    within = np.asarray(chain.instant, bool)[source]
    if np.any(within) and seconds[0] < seconds[1]:
        low, (high, limit) = (
            np.where(within, seconds[0], low),
            (np.where(within, seconds[1], a) for a in (high, limit)),
        )
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
        low = np.append(low, [c.low for c in changes])
        high, limit = (np.append(a, [c.high for c in changes]) for a in (high, limit))
        log = np.append(log, np.array([c.factor for c in changes], bool))
        integer, within = (np.append(a, np.zeros(len(changes), bool)) for a in (integer, within))
    flags = (log, integer, within)
    return Layout(
        tuple(names),
        labels,
        groups,
        units,
        null,
        start,
        low,
        high,
        limit,
        *flags,
        spread,
        columns,
        declared,
    )


def _alone(chain: _core.Chain, i: int, split: Collection[str]) -> bool:
    """Return whether a chain's number is a separate parameter because its effect is split."""
    return chain.labels[i].split(".")[0] in split and list(chain.tie).count(chain.tie[i]) > 1


def _firsts(labels: Sequence[str]) -> tuple[list[str], list[int], NDArray[np.intp]]:
    """Return the distinct `labels` in order, their first positions, and each label's index."""
    place = {label: k for k, label in enumerate(dict.fromkeys(labels))}
    first = {label: i for i, label in reversed([*enumerate(labels)])}
    return (
        list(place),
        [first[label] for label in place],
        np.array([place[label] for label in labels], np.intp),
    )


def ranges_of(model: Model, chain: _core.Chain) -> Ranges:
    """Return the search ranges of a chain's fits on this robot.

    Ranges declared in mm of command are for tendons that move by REACH_MM on each side. They scale
    with the range of the robot, in any unit. If the data require it, a fit may go further: to a
    number of half ranges, or to a weight given by its displacement of this body, in the model's own
    scale of loads.
    """
    half = _half_range(model)
    in_commands = effects_that("channel")
    commanded = [
        unit.startswith("mm") and label.split(".")[0] in in_commands
        for label, unit in zip(chain.labels, chain.units)
    ]
    factor = np.where(commanded, half / REACH_MM, 1.0)
    start, low, high = (factor * np.asarray(x, float) for x in (chain.start, chain.low, chain.high))
    farthest = np.maximum(
        np.asarray(chain.half_ranges) * half, np.asarray(chain.lengths) * model.weight_per_length
    )
    return Ranges(start, low, high, np.maximum(high, farthest))


def _half_range(model: Model) -> float:
    """Return half the command range of a model, in its unit; REACH_MM if it has none."""
    reach = model.command_range
    half = float(np.median(0.5 * np.ptp(reach, axis=1))) if len(reach) else 0.0
    return half if half > 0 else REACH_MM
