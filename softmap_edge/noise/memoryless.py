"""The floor of every memoryless model: scatter of one pose over repeats of the same command.

    σ² = between passages of a cell + within passages    one-way analysis of variance, pooled over
                                                         the cells

A cell holds the frames of one command (within CELL of its range), orientation, load and
temperature. A passage is an uninterrupted stay in a cell. A smooth map of the commands is
subtracted inside each cell first, so the width of a cell does not count. Units: mm, °C, g. Limit:
commands of many channels that never repeat show nothing. Pinned by tests/noise/test_memoryless.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.noise.jitter import polynomial
from softmap_edge.noise.repeats import RUN, filled
from softmap_edge.run.conditions import Conditions

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CELL = 0.01  # of the range of each command
TURNED = 0.1  # change of the unit gravity vector, six degrees: another orientation
WARMER = 2.0  # °C: another temperature
HEAVIER = 1.0  # g: another load
ENOUGH = 8  # passages beyond the first of each cell


@dataclass(frozen=True)
class Repeats:
    """Scatter of repeated poses.

    Attributes:
        variance: of one frame within a pose, (F,) mm².
        poses: number of poses.
        passages: number of passages through them.
        rows: the frames of these passages, (n,).
    """

    variance: Floats
    poses: int
    passages: int
    rows: Ints
    lowest_mm: float = float("nan")  # RMS distance of these frames from the mean of their pose

    @property
    def mm(self) -> float:
        """RMS distance in mm, if all features are places."""
        return float(np.sqrt(np.nanmean(self.variance.reshape(-1, 3).sum(axis=1))))


def repeats_of(values: Floats, state: Conditions, load: Floats | None = None) -> Repeats | None:
    """Return the scatter of repeated poses.

    Args:
        values: (K, F) mm; NaN where unseen.
        state: conditions of the frames.
        load: declared load of each frame, (K,) g; None without a declaration.

    Returns:
        Repeats | None: None if too few commands are repeated.
    """
    if not len(values) or not state.command.shape[1]:
        return None
    cell = _cells(state, load)
    passage = np.cumsum(np.r_[True, np.diff(cell) != 0]) - 1
    first = np.unique(passage, return_index=True)[1]
    of = cell[first]  # of each passage
    kinds, counts = np.unique(of, return_counts=True)
    again = kinds[counts > 1]
    if int((counts[counts > 1] - 1).sum()) < ENOUGH:
        return None
    rows = np.flatnonzero(np.isin(cell, again))
    columns = polynomial(state.command)
    part = values - columns @ np.linalg.lstsq(columns, filled(values), rcond=None)[0]
    variance = _variance(part[rows], passage[rows], cell[rows])
    lowest = _about_means(part[rows], cell[rows])
    return Repeats(variance, len(again), len(np.unique(passage[rows])), rows, lowest)


def _about_means(values: Floats, cell: Ints) -> float:
    """Return the RMS distance of places (n, F) from the mean place of their cell, mm.

    No function of the cell has a smaller error on these frames. `Repeats.mm` estimates the scatter
    of further visits, which is larger: a mean of two passages lies between them.
    """
    _, of = np.unique(cell, return_inverse=True)
    seen = np.isfinite(values)
    count, total = _sums(seen.astype(float), of), _sums(np.where(seen, values, 0.0), of)
    squares = np.where(seen, values - (total / np.maximum(count, 1.0))[of], 0.0) ** 2
    places = np.count_nonzero(seen) / 3.0
    return float(np.sqrt(squares.sum() / places)) if places else float("nan")


def _cells(state: Conditions, load: Floats | None) -> Ints:
    """Return the cell of each frame, (K,)."""
    span = np.ptp(state.command, axis=0)
    keys = [np.rint(state.command / np.where(span > 0, CELL * span, np.inf))]
    if state.gravity is not None:
        keys.append(np.rint(state.gravity / TURNED))
    for values, step in ((state.temperature, WARMER), (load, HEAVIER)):
        if values is not None:
            keys.append(np.rint(values / step)[:, None])
    keys.append((np.maximum(state.visit, 0) >> RUN)[:, None].astype(float))
    return np.asarray(
        np.unique(np.concatenate(keys, axis=1), axis=0, return_inverse=True)[1].reshape(-1),
        np.int64,
    )


def _variance(values: Floats, passage: Ints, cell: Ints) -> Floats:
    """Return the variance (F,) of one frame in a pose: between passages plus within them."""
    _, p = np.unique(passage, return_inverse=True)
    owner = np.zeros(p.max() + 1, np.int64)
    owner[p] = np.unique(cell, return_inverse=True)[1].reshape(-1)
    seen = np.isfinite(values)
    count, total = _sums(seen.astype(float), p), _sums(np.where(seen, values, 0.0), p)  # (P, F)
    mean = total / np.maximum(count, 1.0)
    within = np.where(seen, values - mean[p], 0.0)
    freedom = np.maximum(count - 1.0, 0.0).sum(axis=0)
    noise = np.sum(within**2, axis=0) / np.maximum(freedom, 1.0)
    there = (count > 0).astype(float)
    passages = _sums(there, owner)
    middle = _sums(mean * there, owner) / np.maximum(passages, 1.0)
    between = np.sum(((mean - middle[owner]) * there) ** 2, axis=0) / np.maximum(
        (passages - 1.0).clip(0).sum(axis=0), 1.0
    )
    share = np.sum(there / np.maximum(count, 1.0), axis=0) / np.maximum(there.sum(axis=0), 1.0)
    return np.asarray(np.where(there.any(axis=0), between + noise * (1.0 - share), np.nan))


def _sums(values: Floats, group: Ints) -> Floats:
    """Return the sums (G, F) of values (n, F) over the groups (n,)."""
    out = np.zeros((int(group.max()) + 1, values.shape[1]))
    np.add.at(out, group, values)
    return out
