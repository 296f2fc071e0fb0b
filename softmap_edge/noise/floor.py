"""The noise floor of a run: a point's distance from its mean while only the camera changes.

The first method that the run allows is used:

1. Frames of one dwell about their drift, and for jitter of the frame also visits of one pose in
   several dwells (`noise_model.py`). `check` and `diagnose` use the same estimate.
2. What no command can make of the body's shape (`shape_manifold.py`), or settled frames of the same
   command: the root of the pooled variance, where the memory of the robot counts as noise. The
   smaller of both is taken.
3. Roughness of the residual over the body: the remainder after (1, x, y) times a polynomial of
   degree 5 in z, frame by frame.
4. Second differences of the residual: sqrt(mean |r(k) - (r(k-1) + r(k+1))/2|² / 1.5), an upper
   bound.

All are in mm, over visible points, as a distance in space (√3 times the noise of one coordinate).

Limits: method 1 detects noise that is constant in a dwell only if poses are visited again. Method 3
does not detect noise that moves the complete body. Method 4 counts motion that the model misses as
noise. Pinned by tests/comparison/test_compare.py with known noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.noise.memoryless import Repeats, repeats_of
from softmap_edge.noise.noise_model import ENOUGH, measure_noise, noise_off_shapes
from softmap_edge.noise.repeats import SETTLED, dwell_degrees, settled_dwells
from softmap_edge.run.conditions import Conditions, conditions
from softmap_edge.run.run import Run, known

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

POINTS = 40  # a sample that shows the noise of all points
MIN_PAIRS = 15  # replicates; fewer do not give the noise
DEGREE = 5  # along the body, of the smooth part of a residual
SAME = 0.01  # of the largest command: commands that differ by less are equal
BOUND = "an upper bound"  # suffix of the source of a floor that includes more than noise


def noise_floor(
    state: Conditions, seen: Floats, visible: Mask, predicted: Floats, rest: Floats | None = None
) -> tuple[float | None, str]:
    """Return the RMS distance of a seen point from its own mean, and the source of the estimate.

    Args:
        state: conditions of the K frames.
        seen: measured points, (K, N, 3) mm.
        visible: which points were seen, (K, N).
        predicted: predicted points, (K, N, 3) mm; used by the estimates from the residual.
        rest: template at rest, (N, 3) mm; None for markers.

    Returns:
        tuple[float | None, str]: the noise floor in mm (None if no estimate is possible), and a
            sentence on its source.
    """
    repeated = replicates(state, seen, visible)
    if repeated is not None:
        return repeated.mm, repeated.source
    rough = None if rest is None else _roughness(seen - predicted, visible, rest)
    if rough is not None:
        return (
            rough,
            "no replicates: from the roughness of the residual over the body, independent noise "
            "only",
        )
    if len(seen) < MIN_PAIRS + 2:
        return None, f"not known: no replicates, and {len(seen)} frames are too few"
    residual = seen - predicted
    bend = np.sum((residual[1:-1] - 0.5 * (residual[2:] + residual[:-2])) ** 2, axis=2)
    complete = visible[1:-1] & visible[2:] & visible[:-2]
    if not complete.any():
        return None, "not known: no replicates, and no point is visible in three successive frames"
    return rms(
        bend[complete] / 1.5
    ), f"no replicates: from the residual's high-frequency part, {BOUND}"


def rms(squares: Floats) -> float:
    """Return the root mean square of `squares`; NaN if there are none."""
    return math.sqrt(float(np.mean(squares))) if len(squares) else math.nan


@dataclass(frozen=True)
class PointNoise:
    """The noise of a point.

    Attributes:
        mm: RMS distance from its own mean, mm.
        source: how it was estimated, as a sentence.
    """

    mm: float
    source: str


def noise_of_points(run: Run) -> PointNoise | None:
    """Return the noise of a run's points from its repeats; None without enough of them.

    It depends on the run alone. `check` and `compare` report this number.
    """
    seen, command = run.places, commanded(run)
    if seen is None or not command.shape[1] or not len(seen):
        return None
    visible = known(run, seen)
    return replicates(conditions(run, command), np.where(visible[..., None], seen, 0.0), visible)


def noise_of_runs(runs: Sequence[object]) -> list[float | None]:
    """Return `noise_of_points` of each run in mm, for a diagnosis document; None if unknown."""
    found = [noise_of_points(run) if isinstance(run, Run) else None for run in runs]
    return [None if one is None else one.mm for one in found]


def commanded(run: Run) -> Floats:
    """Return the commands (T, C) in the run's unit, or in ticks if it has no commands.

    Commands do not flicker like encoders do.
    """
    rows = run.command if run.command is not None else run.ticks
    return np.zeros((len(run.t), 0)) if rows is None else np.asarray(rows, float)


def replicates(state: Conditions, seen: Floats, visible: Mask) -> PointNoise | None:
    """Return the noise of points from repeats, or from what no command can make.

    Args:
        state: conditions of the K frames.
        seen: measured points, (K, N, 3) mm.
        visible: which points were seen, (K, N).

    Returns:
        PointNoise | None: None if the frames are too few for all methods.
    """
    if len(seen) < 2:
        return None
    some = some_points(visible)
    values = np.where(visible[:, some, None], seen[:, some], np.nan).reshape(len(seen), -1)
    places = np.ones(len(some), bool)
    if dwell_degrees(settled_dwells(state)) >= ENOUGH:
        found = measure_noise(values, values, places, state.time, state)
        return PointNoise(found.rms_mm(places), f"frames of one dwell: {found.source}")
    off = noise_off_shapes(values, state)
    bounds = [] if off is None else [PointNoise(off.rms_mm(places), off.source)]
    groups = _replicates(state, ~state.moving & (state.dwell >= SETTLED))
    if sum(len(group) - 1 for group in groups) >= MIN_PAIRS:
        value = _within(groups, seen, visible)
        if value is not None:
            text = (
                f"{len(groups)} commands seen repeatedly; memory of the robot counts as noise "
                f"here: {BOUND}"
            )
            bounds.append(PointNoise(value, text))
    return min(bounds, key=lambda one: one.mm, default=None)


def some_points(visible: Mask) -> NDArray[np.intp]:
    """Return a sample of the points, spread evenly over those that are seen most often."""
    often = np.flatnonzero(visible.sum(axis=0) >= 0.5 * visible.sum(axis=0).max(initial=0))
    return np.asarray(
        often[np.unique(np.linspace(0, len(often) - 1, min(len(often), POINTS)).astype(int))],
        np.intp,
    )


def memoryless_floor(run: Run, state: Conditions, seen: Floats, visible: Mask) -> Repeats | None:
    """Return the RMS scatter of points over repeated commands: the floor of all memoryless models.

    Args:
        run: the run; its load separates the commands.
        state: conditions of the K frames.
        seen: measured points, (K, N, 3) mm.
        visible: which points were seen, (K, N).

    Returns:
        Repeats | None: None if too few commands are repeated.
    """
    some = some_points(visible)
    values = np.where(visible[:, some, None], seen[:, some], np.nan).reshape(len(seen), -1)
    load = run.load
    return repeats_of(values, state, None if load is None else np.interp(state.time, run.t, load))


def _roughness(residual: Floats, visible: Mask, rest: Floats) -> float | None:
    """Return the RMS of a residual about a smooth field, in frames that show all points."""
    frames = visible.all(axis=1)
    z = 2.0 * (rest[:, 2] - rest[:, 2].min()) / max(float(np.ptp(rest[:, 2])), 1e-9) - 1.0
    across = np.column_stack([np.ones(len(rest)), rest[:, 0] / 10.0, rest[:, 1] / 10.0])
    along = np.polynomial.legendre.legvander(z, DEGREE)
    basis = np.einsum("na,nb->nab", across, along).reshape(len(rest), -1)
    freedom = len(rest) - basis.shape[1]
    if freedom < len(rest) // 2 or not frames.any():
        return None
    q, _ = np.linalg.qr(basis)
    kept = residual[frames]
    left = np.sum(kept**2) - np.sum(np.einsum("np,knc->kpc", q, kept) ** 2)
    return math.sqrt(max(float(left), 0.0) / (freedom * len(kept)))


def _replicates(state: Conditions, settled: Mask) -> list[NDArray[np.int64]]:
    """Return groups of settled frames that share their command."""
    top = float(np.max(np.abs(state.command), initial=0.0))
    index = np.flatnonzero(settled)
    if len(index) == 0:
        return []
    key = np.round(state.command[index] / (SAME * top)) if top > 0 else np.zeros((len(index), 1))
    _, which = np.unique(key, axis=0, return_inverse=True)
    which = which.reshape(-1)
    groups = [index[which == g] for g in range(int(which.max()) + 1)]
    return [group for group in groups if len(group) > 1]


def _within(groups: list[NDArray[np.int64]], seen: Floats, visible: Mask) -> float | None:
    """Return the pooled RMS deviation of points from their group's mean.

    Each mean takes one degree of freedom.
    """
    total, freedom = 0.0, 0
    for group in groups:
        x, v = seen[group], visible[group]
        count = v.sum(axis=0)
        known = count > 1
        mean = x.sum(axis=0) / np.maximum(count, 1)[:, None]
        deviation = np.where(v[..., None], x - mean, 0.0)[:, known]
        total += float(np.sum(deviation**2))
        freedom += int(np.sum(count[known] - 1))
    return math.sqrt(total / freedom) if freedom else None
