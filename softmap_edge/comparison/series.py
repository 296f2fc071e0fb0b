"""Data for the figures of a report: errors over time, body and commands, and some poses.

Nothing is evaluated here; `comparison.py` has the figures. Units: mm, s. Pinned by
tests/comparison/test_compare.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.comparison.comparison import aligned, mean_root, template, tips
from softmap_edge.errors import ComparisonError
from softmap_edge.noise.floor import BOUND, commanded, noise_floor
from softmap_edge.run.conditions import conditions

if TYPE_CHECKING:
    from softmap_edge.model.model import Model
    from softmap_edge.run.output import Output
    from softmap_edge.run.run import Run

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

POSES = 5  # poses drawn per run


@dataclass(frozen=True, eq=False)
class ExamplePose:
    """A measured frame to draw: points (N, 3) mm, NaN where hidden, and errors (N,) mm."""

    frame: int
    points: Floats
    before: Floats
    after: Floats | None


@dataclass(frozen=True, eq=False)
class Loop:
    """An output, or the tip, against one command at frames (K,): measured, before and after.

    `after` is None where there is one model. `others` are the commands of the other channels at the
    same frames.
    """

    name: str
    command: Floats
    seen: Floats  # in the output's unit, mm for the tip; NaN if missing
    before: Floats
    after: Floats | None
    others: Floats | None = None  # (K, C - 1)


@dataclass(frozen=True)
class Series:
    """Errors of a run for figures: per frame and per point, mm.

    They are of one model, or of two (before, after).
    """

    # "held out", "fitted", or "measured" if unknown
    kind: str
    t_seen: Floats  # (K,) s
    before: Floats  # (K,) RMS over the points of a frame
    after: Floats | None  # (K,)
    point_before: Floats  # (N,) RMS over the frames of a point
    point_after: Floats | None  # (N,)
    template: Floats  # (N, 3) drawn positions of the points
    triangles: NDArray[np.int64] | None  # (F, 3); None for markers
    noise_floor_mm: float | None
    floor_is_bound: bool
    tip_seen: Floats  # (K, 3)
    tip_before: Floats  # (K, 3)
    tip_after: Floats | None  # (K, 3)
    command: Floats  # (K, C) at the frames
    command_unit: str
    poses: list[ExamplePose]
    output: Output | None = None  # meaning of the markers, if they are not positions
    loops: tuple[Loop, ...] = ()  # each output, or the tip along each command
    timeless: bool = False  # `t_seen` counts rows


def series(run: Run, before: Model, after: Model | None = None, kind: str = "held out") -> Series:
    """Collect the data for figures of a run, for one model or before and after a change.

    Args:
        run: as for `compare`.
        before: the model, or the model before the change.
        after: the model after the change, or None.
        kind: whether the run took part in the fit: "held out", "fitted", or "measured" if unknown.

    Returns:
        Series: errors over time and over the body, template and tip paths.

    Raises:
        ComparisonError: as for `compare`, or an unknown `kind`.
    """
    if kind not in ("held out", "fitted", "measured"):
        raise ComparisonError(
            f"kind is {kind!r}; it is 'held out', 'fitted' or 'measured' (not known)"
        )
    predicted, seen, visible = aligned(before, run)
    squared = np.where(visible, np.sum((predicted - seen) ** 2, axis=2), 0.0)
    tip_seen, tip_before = tips(before, predicted, seen, visible)
    frame_after = point_after = tip_after = squared_after = predicted_after = None
    if after is not None:
        predicted_after, _, _ = aligned(after, run)
        squared_after = np.where(visible, np.sum((predicted_after - seen) ** 2, axis=2), 0.0)
        frame_after, point_after = (
            mean_root(squared_after, visible, 1),
            mean_root(squared_after, visible, 0),
        )
        tip_after = tips(after, predicted_after, seen, visible)[1]
    drawn, triangles = _drawn(before, seen, visible)
    state = conditions(run, before.commands(run))
    stands = conditions(run, commanded(run))
    floor, kind_of_floor = noise_floor(stands, seen, visible, predicted, template(before, seen))
    return Series(
        kind=kind,
        t_seen=np.asarray(run.t_seen, float),
        before=mean_root(squared, visible, 1),
        after=frame_after,
        point_before=mean_root(squared, visible, 0),
        point_after=point_after,
        template=drawn,
        triangles=triangles,
        noise_floor_mm=floor,
        floor_is_bound=kind_of_floor.endswith(BOUND),
        tip_seen=tip_seen,
        tip_before=tip_before,
        tip_after=tip_after,
        command=state.command,
        command_unit=before.command_unit,
        poses=[]
        if before.output is not None
        else _poses(state.command, seen, visible, squared, squared_after),
        output=before.output,
        timeless=run.timeless,
        loops=tip_loops(state.command, tip_seen, tip_before, tip_after)
        if before.output is None
        else _loops(before, state.command, seen, visible, predicted, predicted_after),
    )


def _loops(
    model: Model, command: Floats, seen: Floats, visible: Mask, before: Floats, after: Floats | None
) -> tuple[Loop, ...]:
    """Return each output against the command that it follows best, for a model of outputs."""
    if model.output is None or not command.shape[1]:
        return ()
    shown = np.where(visible, model.output.values(seen), np.nan)
    predicted = [
        None if points is None else model.output.values(points) for points in (before, after)
    ]
    loops = []
    for q, name in enumerate(model.output.names):
        known = visible[:, q] & (np.ptp(command, axis=0).max() > 0)
        strength = [
            abs(_correlation(command[known, c], shown[known, q])) for c in range(command.shape[1])
        ]
        column = command[:, int(np.argmax(strength))]
        rows = [None if values is None else values[:, q] for values in predicted]
        assert rows[0] is not None
        loops.append(Loop(name, column, shown[:, q], rows[0], rows[1]))
    return tuple(loops)


def tip_loops(
    command: Floats, seen: Floats, before: Floats, after: Floats | None
) -> tuple[Loop, ...]:
    """Return the tip's displacement along the direction in which each command moves it.

    A linear regression of the measured tip on all commands gives the directions, and the tip at
    command 0 as origin. Constant commands, and those that do not move the tip, have no loop.

    Args:
        command: (K, C).
        seen: the measured tip (K, 3) mm, NaN where hidden.
        before: the predicted tip (K, 3) mm, before the diagnosis.
        after: the predicted tip (K, 3) mm, after it.
    """
    known = np.isfinite(seen).all(axis=1) & np.isfinite(command).all(axis=1)
    design = np.column_stack([np.ones(len(command)), command])
    if known.sum() <= design.shape[1]:
        return ()
    rest, *slopes = np.linalg.lstsq(design[known], seen[known], rcond=None)[0]
    found = []
    for c, slope in enumerate(slopes):
        size = float(np.linalg.norm(slope))
        if not np.ptp(command[known, c]) > 0 or not size > 0:
            continue
        along = [
            None if path is None else (path - rest) @ (slope / size)
            for path in (seen, before, after)
        ]
        assert along[0] is not None and along[1] is not None
        others = np.delete(command, c, axis=1)
        found.append(Loop(f"tip, channel {c}", command[:, c], along[0], along[1], along[2], others))
    return tuple(found)


def _correlation(x: Floats, y: Floats) -> float:
    """Return the correlation of two columns; 0 if one of them is constant."""
    if len(x) < 2 or not np.ptp(x) > 0 or not np.ptp(y) > 0:
        return 0.0
    return float(np.corrcoef(x, y)[0, 1])


def _drawn(model: Model, seen: Floats, visible: Mask) -> tuple[Floats, NDArray[np.int64] | None]:
    """Return where to draw the points: on the template, or at the markers' mean positions."""
    rest = template(model, seen)
    if rest is not None and len(model.triangles):
        return rest, np.asarray(model.triangles, np.int64)
    count = np.maximum(visible.sum(axis=0), 1)
    return seen.sum(axis=0) / count[:, None], None


def _poses(
    command: Floats, seen: Floats, visible: Mask, before: Floats, after: Floats | None
) -> list[ExamplePose]:
    """Return frames with distant commands, among those with the most visible points.

    Convert squares (K, N) mm² to errors.
    """
    count = visible.sum(axis=1)
    complete = np.flatnonzero(count >= 0.9 * count.max())
    span = np.ptp(command, axis=0)
    place = command[complete] / np.where(span > 0, span, np.inf)
    chosen = [int(np.argmin(np.linalg.norm(place, axis=1)))]
    far = np.linalg.norm(place - place[chosen[0]], axis=1)
    while len(chosen) < POSES and far.size and far.max() > 0.1:
        chosen.append(int(np.argmax(far)))
        far = np.minimum(far, np.linalg.norm(place - place[chosen[-1]], axis=1))

    def shown(values: Floats, k: int) -> Floats:
        return np.where(visible[k], np.sqrt(values[k]), np.nan)

    frames = sorted(int(complete[i]) for i in chosen)
    points = [np.where(visible[k][:, None], seen[k], np.nan) for k in frames]
    return [
        ExamplePose(k, p, shown(before, k), None if after is None else shown(after, k))
        for k, p in zip(frames, points)
    ]
