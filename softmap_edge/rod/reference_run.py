"""The training data of a reference run: frames and their commands.

Frames are thinned and checked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.checks.unseen_markers import unseen_markers
from softmap_edge.errors import RunError
from softmap_edge.files.printable import listed
from softmap_edge.model.servo_calibration import from_home
from softmap_edge.rod.regression import Drive, Record, rms
from softmap_edge.run.run import Run, Source, known

if TYPE_CHECKING:
    from softmap_edge.run.output import Output

Floats = NDArray[np.float64]

SLOW = 0.25  # s between command samples above which delay and lag are not observable
APART = 1000.0  # s between training runs: more than any gap next to a block
STILL = 0.005  # of the robot's length: least motion of the markers about their mean


@dataclass(frozen=True, eq=False)
class ReferenceFrames:
    """The training data of one or several runs.

    `frames` (n_i,) of each run, their `markers` (n, K, 3) mm, and the commands behind them.
    """

    runs: tuple[Run, ...]
    source: Source
    frames: tuple[NDArray[np.intp], ...]
    markers: Floats
    drive: Drive

    @property
    def unit(self) -> str:
        """Unit of the commands."""
        return self.runs[0].command_unit

    @property
    def number(self) -> NDArray[np.intp]:
        """Which run (n,) each frame belongs to, from 0."""
        return np.repeat(np.arange(len(self.runs)), [len(index) for index in self.frames])

    @property
    def t(self) -> Floats:
        """Times (n,) s of the frames; runs follow each other with gaps of `APART`."""
        times: list[Floats] = []
        start = 0.0
        for run, index in zip(self.runs, self.frames):
            seen = run.t_seen[index]
            times.append(seen if not times else seen - run.t_seen[0] + start)
            start = float(times[-1][-1]) + APART if len(seen) else start
        return np.concatenate(times)

    @property
    def seconds(self) -> float:
        """The total recorded duration of the runs."""
        spans = [
            float(np.ptp(run.t_seen[index]))
            for run, index in zip(self.runs, self.frames)
            if len(index)
        ]
        return sum(spans)

    @property
    def labels(self) -> NDArray[np.generic] | None:
        """Return `block` labels (n,) of the frames; None if a run has none or all are the same."""
        blocks = [
            run.block[index] for run, index in zip(self.runs, self.frames) if run.block is not None
        ]
        if len(blocks) < len(self.runs):
            return None
        named = np.array(
            [f"{n} {label}" for n, block in enumerate(blocks) for label in block.tolist()]
        )
        return named if len(np.unique(named)) > len(self.runs) else None

    @property
    def slow(self) -> bool:
        """Whether delay and lag are unknown: no time in the log, or commands too far apart."""
        return self.timeless or any(float(np.median(np.diff(run.t))) > SLOW for run in self.runs)

    @property
    def timeless(self) -> bool:
        """Whether a log has no time, only an order."""
        return any(run.timeless for run in self.runs)

    @property
    def stray(self) -> float:
        """RMS distance of the markers from their mean, mm."""
        return rms(self.markers - self.markers.mean(axis=0))

    def every(self, step: int) -> ReferenceFrames:
        """Return the data with every `step`-th frame."""
        kept = np.concatenate([np.arange(len(index)) % step == 0 for index in self.frames])
        frames = tuple(index[::step] for index in self.frames)
        return ReferenceFrames(
            self.runs,
            self.source,
            frames,
            self.markers[kept],
            _drive(self.runs, self.source, frames),
        )


def _refuse_unseen(runs: Sequence[Run]) -> None:
    """Raise RunError if a run has a marker that no frame shows."""
    for run in runs:
        if names := unseen_markers(run):
            raise RunError(
                f"{listed(names, 4)}: seen in none of {run.frames} frames; leave "
                f"{'it' if len(names) == 1 else 'them'} out of `markers` in the mapping and import "
                "the log again"
            )


def observe(
    runs: Sequence[Run],
    input: Source | None,
    hold_out: Sequence[tuple[float, float]],
    rate_hz: float,
) -> ReferenceFrames:
    """Return the training frames; RunError if markers, commands or motion are missing."""
    runs = tuple(_in_scale(run, runs[0].output) for run in from_home(runs)[0])
    if len({run.hash() for run in runs}) < len(runs):
        raise RunError(
            "the same run is given twice, and its noise would count as half; give each recording "
            "once"
        )
    source: Source = input or ("goal" if any(run.present is None for run in runs) else "present")
    for run in runs:
        if run.markers is None or run.commands(source).shape[1] == 0 or len(run.t) < 2:
            raise RunError(
                "a rod is learned from markers and at least two rows of commands; this run lacks "
                "one of them"
            )
    _alike(runs, source)
    _refuse_unseen(runs)
    frames = tuple(_usable(run, hold_out, rate_hz) for run in runs)
    markers = np.concatenate(
        [np.asarray(run.markers, float)[index] for run, index in zip(runs, frames)]
    )
    drive = _drive(runs, source, frames)
    if not np.ptp(drive.commands, axis=0).any():
        raise RunError(
            f"nothing moves: each of the {drive.channels} commands stays as it is in all "
            f"{len(drive.commands)} rows (the first at {drive.commands[0, 0]:g} "
            f"{runs[0].command_unit}); record a run that goes through the robot's range"
        )
    if len(markers):
        stray, length = (
            rms(markers - markers.mean(axis=0)),
            float(np.linalg.norm(markers[:, -1].mean(axis=0))),
        )
        if stray < STILL * length:
            raise RunError(
                f"the robot hardly moves: its markers scatter by {stray:.3g} mm from their mean "
                f"(RMS), the last one is {length:.3g} mm from the base, and under {100 * STILL:g} "
                "% of that a model learns noise; record a run that goes through the robot's "
                "range, or correct the markers' unit"
            )
    return ReferenceFrames(runs, source, frames, markers, drive)


def _in_scale(run: Run, first: Output | None) -> Run:
    """Scale a run of outputs like the first one, if both have the same outputs."""
    own = run.output
    if (
        own is None
        or first is None
        or (own.names, own.unit) != (first.names, first.unit)
        or run.markers is None
    ):
        return run
    return replace(run, markers=own.rescaled(run.markers, first), output=first)


def _drive(runs: Sequence[Run], source: Source, frames: Sequence[NDArray[np.intp]]) -> Drive:
    records = [
        Record(
            np.ascontiguousarray(run.commands(source)),
            np.ascontiguousarray(run.t),
            run.t_seen[index],
        )
        for run, index in zip(runs, frames)
    ]
    return Drive(*records)


def _alike(runs: Sequence[Run], source: Source) -> None:
    """Raise RunError if the training runs are not of one robot."""
    first = runs[0]
    for number, run in enumerate(runs[1:], start=2):
        for what, one, other in (
            ("commands a row", first.commands(source).shape[1], run.commands(source).shape[1]),
            ("markers", first.seen_points.shape[1], run.seen_points.shape[1]),
            (
                "as its outputs",
                *(o and f"{', '.join(o.names)} in {o.unit}" for o in (first.output, run.output)),
            ),
            ("as the unit of its commands", first.command_unit, run.command_unit),
        ):
            if one != other:
                raise RunError(
                    f"run {number} has {other} {what}, the first run {one}; give runs of one "
                    "robot, in one unit"
                )


def _usable(run: Run, hold_out: Sequence[tuple[float, float]], rate_hz: float) -> NDArray[np.intp]:
    assert run.markers is not None
    keep = known(run, run.markers).all(axis=1)
    for low, high in hold_out:
        keep &= (run.t_seen < low) | (run.t_seen >= high)
    slot = np.floor((run.t_seen - run.t_seen[:1]) * rate_hz + 1e-6)
    index = np.flatnonzero(keep)
    if len(index):
        index = index[np.concatenate([[True], np.diff(slot[index]) > 0])]
    return index
