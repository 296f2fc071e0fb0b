"""Repeats of a run: dwells, their scatter about a drift, visits of one pose in several dwells.

    dwell      frames of one uninterrupted stay at one command, from SETTLED s after the last motion
    scatter    remainder of a dwell after a quadratic in time (a line if it is short): creep in a
               dwell is not noise
    pose       dwells of one command (within SAME of its range), in one orientation, under one load

`check`, `compare` and `diagnose` take their noise from these. Units: mm, s. Limit: noise that is
constant in a dwell is detected only between visits of one pose (`jitter.py`). Pinned by
tests/noise/test_noise.py and tests/noise/test_one_noise.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from softmap_edge.run.conditions import NEAR, Conditions

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Ints = NDArray[np.int64]

SETTLED = 0.5  # s after the last motion from which a frame counts as a repeat
# frames of a dwell that show noise besides a linear, and a quadratic, drift
LEAST_DWELL, LONG_DWELL = 3, 6
SAME = 0.01  # of the range of a command: closer than this counts as the same command
RUN = 40  # bits of a dwell's number below the number of its run (`records.py`)


@dataclass(frozen=True)
class Scatter:
    """Scatter of dwells about their drifts.

    Attributes:
        squares: sums of squares and products, (F, F) mm².
        degrees: degrees of freedom.
        rho: correlation of neighbouring frames.
    """

    squares: Floats
    degrees: int
    rho: float


def settled_dwells(state: Conditions) -> Ints:
    """Return the number of the dwell of each settled frame, (K,); -1 for all other frames."""
    return np.where(state.dwell >= SETTLED, state.visit, -1)


def rows_of(dwell: Ints, least: int = 1) -> list[NDArray[np.intp]]:
    """Return the frames of each dwell that has at least `least` of them, in order of time."""
    order = np.argsort(dwell, kind="stable")
    cuts = np.flatnonzero(np.diff(dwell[order])) + 1
    return [rows for rows in np.split(order, cuts) if len(rows) >= least and dwell[rows[0]] >= 0]


def undrifted(dwell: Floats) -> tuple[Floats, int]:
    """Return a dwell (K, F) without its drift, and the number of fitted terms.

    The drift is a quadratic in time, or a line if the dwell is short. Creep in a dwell is not
    noise.
    """
    basis = drift(len(dwell))
    return np.asarray(dwell - basis @ (basis.T @ dwell)), basis.shape[1]


@lru_cache(maxsize=256)
def drift(frames: int) -> Floats:
    """Return the orthonormal drift (K, order) that is fitted to a dwell of K frames."""
    tau, order = np.linspace(-1.0, 1.0, frames), 3 if frames >= LONG_DWELL else 2
    return np.asarray(np.linalg.qr(np.vander(tau, order))[0])


def dwell_scatter(values: Floats, dwell: Ints) -> Scatter:
    """Return the scatter of values (K, F) mm about the drift of each dwell (K,); NaN is ignored."""
    features = values.shape[1]
    scatter, degrees, lag = np.zeros((features, features)), 0, [0.0, 0.0]
    inside = dwell >= 0
    shown = (
        np.maximum(np.isfinite(values[inside]).mean(axis=0), 1e-3)
        if inside.any()
        else np.ones(features)
    )
    for frames in rows_of(dwell, LEAST_DWELL):
        rest, order = undrifted(filled(values[frames]))
        rest = np.where(np.isfinite(values[frames]), rest, 0.0)
        scatter += rest.T @ rest
        degrees += len(frames) - order
        lag[0] += float(np.sum(rest[1:] * rest[:-1])) + float(np.sum(rest**2)) * order / len(frames)
        lag[1] += float(np.sum(rest**2))
    return Scatter(scatter / np.sqrt(np.outer(shown, shown)), degrees, lag[0] / max(lag[1], 1e-300))


def dwell_degrees(dwell: Ints) -> int:
    """Return the degrees of freedom of the scatter of dwells (K,)."""
    return sum(len(rows) - drift(len(rows)).shape[1] for rows in rows_of(dwell, LEAST_DWELL))


def filled(values: Floats) -> Floats:
    """Return values (K, F) in which unseen ones are interpolated in time.

    Without this, a marker that is hidden now and then would jump, and the model error would count
    as noise.
    """
    seen = np.isfinite(values)
    if seen.all():
        return values
    count = len(values)
    frame = np.arange(count)[:, None]
    before = np.maximum.accumulate(np.where(seen, frame, -1))
    after = np.minimum.accumulate(np.where(seen, frame, count)[::-1])[::-1]
    low = np.clip(np.where(before < 0, after, before), 0, count - 1)
    high = np.clip(np.where(after == count, before, after), 0, count - 1)
    first, last = (np.take_along_axis(values, at, axis=0) for at in (low, high))
    between = first + (last - first) / np.maximum(high - low, 1) * (frame - low)
    return np.where(seen.any(axis=0), between, 0.0)


def poses(state: Conditions, dwell: Ints) -> list[list[NDArray[np.intp]]]:
    """Return the frames of each visit, for every pose that was visited in two dwells or more.

    Dwells of different runs are never one pose, because the base may stand differently in each run.
    """
    visits = rows_of(dwell)
    span = np.ptp(state.command, axis=0) if len(state.command) else np.zeros(0)
    scale = np.where(span > 0, SAME * span, 1.0)
    centres: list[tuple[Floats, Floats, int]] = []
    found: list[list[NDArray[np.intp]]] = []
    for rows in visits:
        place = np.median(state.command[rows], axis=0) / scale
        lean = np.zeros(3) if state.gravity is None else state.gravity[rows[0]]
        run = int(dwell[rows[0]]) >> RUN
        for known, (where, gravity, one) in enumerate(centres):
            if one == run and np.all(np.abs(place - where) <= 1.0) and same_way(lean, gravity):
                found[known].append(rows)
                break
        else:
            centres.append((place, lean, run))
            found.append([rows])
    return [pose for pose in found if len(pose) > 1]


def same_way(some: Floats, other: Floats) -> Mask:
    """Return whether vectors (..., 3) point as another (3,) does; a zero vector points anywhere."""
    size = np.linalg.norm(some, axis=-1) * np.linalg.norm(other)
    return np.asarray((size == 0.0) | (some @ other > NEAR * size))
