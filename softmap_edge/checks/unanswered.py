"""Find runs whose points contradict the commands, without a model.

The points move although no command changes, or stay still although commands change. A diagnosis
detects both with the model (`sound.stray`, `belongs.still`). Pinned by
tests/checks/test_unanswered.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from softmap_edge.checks.match import MOTION, spread
from softmap_edge.logs.chance import noise_of
from softmap_edge.noise.floor import commanded
from softmap_edge.run.run import Run, known

Array = NDArray[np.float64]

LEAST = 30  # frames; with fewer, nothing is reported
NOISE = 5.0  # times the noise: larger is motion
STILL = 1.15  # times the noise: smaller is no motion
CHANCE = 5.0  # times the share of the motion that commands explain by chance


def unanswered(run: Run) -> str | None:
    """Return a sentence if commands and motion contradict each other.

    Return None if they agree, or if the run does not show it.
    """
    points = run.places
    u = commanded(run)
    if points is None or run.output is not None or run.frames < LEAST or u.shape[1] == 0:
        return None
    visible = known(run, points)
    places = np.where(visible[..., None], points, np.nan)
    shown = np.asarray(visible.sum(axis=0) >= LEAST)
    if not shown.any():
        return None
    places, visible = places[:, shown], visible[:, shown]
    moved, noise = spread(np.nan_to_num(places), visible), _noise(places)
    if not np.ptp(u, axis=0).any():
        if _other_cause(run) or not moved > max(MOTION * _length(places), NOISE * noise):
            return None
        return (
            f"the commands never change, but the points move by {moved:.3g} mm RMS: commands and "
            "frames are not of one recording, or something else moves the robot; look at the "
            "columns of the commands"
        )
    if moved > STILL * noise or _follows(run, u, places):
        return None
    return (
        f"the commands change, but the points do not move: by {moved:.2g} mm RMS, which is their "
        "noise; check that the drive is engaged (power, torque, tendons attached), and that the "
        "frames are of this recording"
    )


def _noise(places: Array) -> float:
    """Return the noise of a point (RMS, mm) from places (K, N, 3)."""
    each = [[noise_of(column) for column in point.T] for point in places.transpose(1, 0, 2)]
    return float(np.sqrt(np.mean(np.sum(np.square(each), axis=1))))


def _length(places: Array) -> float:
    """Return the extent (mm) of the mean places of points (K, N, 3).

    A single point is measured from the base.
    """
    middle = np.nanmedian(places, axis=0)
    return float(np.linalg.norm(np.ptp(middle, axis=0) if len(middle) > 1 else middle[0]))


def _other_cause(run: Run) -> bool:
    """Return whether the run declares another change: load, orientation or temperature."""
    given = [
        run.load,
        run.temperature,
        None if run.gravity is None or run.gravity.ndim < 2 else run.gravity,
    ]
    return any(
        value is not None and bool(np.ptp(np.asarray(value, float), axis=0).any())
        for value in given
    )


def _follows(run: Run, u: Array, places: Array) -> bool:
    """Return whether commands (T, C) explain more of the motion (K, N, 3) than chance does."""
    at = np.stack([np.interp(run.t_seen, run.t, column) for column in u.T], axis=1)
    at = (at - at.mean(axis=0)) / np.maximum(at.std(axis=0), 1e-12)
    columns = np.column_stack([np.ones(len(at)), at, at**2])
    total = left = 0.0
    for place in places.reshape(len(places), -1).T:
        seen = np.isfinite(place)
        value = place[seen] - place[seen].mean()
        fitted = columns[seen] @ np.linalg.lstsq(columns[seen], value, rcond=1e-9)[0]
        total, left = total + float(value @ value), left + float(np.sum((value - fitted) ** 2))
    chance = (columns.shape[1] - 1) / len(at)
    return total > 0 and 1.0 - left / total > min(CHANCE * chance, 0.5)
