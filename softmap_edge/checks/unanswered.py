"""Find runs whose points contradict the commands, without a model.

The points move although no command changes, or stay still although commands change. A diagnosis
detects both with the model (`sound.stray`, `belongs.still`). Pinned by
tests/checks/test_unanswered.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from softmap_edge.checks.leverage import answered, noise, power
from softmap_edge.checks.match import MOTION, spread
from softmap_edge.checks.remembered import centred
from softmap_edge.noise.floor import commanded
from softmap_edge.run.run import Run, known

Array = NDArray[np.float64]

LEAST = 30  # frames; with fewer, nothing is reported
NOISE = 5.0  # times the noise: larger is motion
STILL = 1.15  # times the noise: smaller is not a motion
ROUNDING = 1e-9  # of the largest coordinate: a smaller motion is an error of rounding
ENGAGED = (
    "check that the drive is engaged (power, torque, tendons attached), and that the frames are of "
    "this recording"
)
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
    moved, chance = spread(np.nan_to_num(places), visible), noise(places)
    if not np.ptp(u, axis=0).any():
        if _other_cause(run) or not moved > max(MOTION * _length(places), NOISE * chance):
            return None
        return (
            f"the commands never change, but the points move by {moved:.3g} mm RMS: commands and "
            "frames are not of one recording, or something else moves the robot; look at the "
            "columns of the commands"
        )
    rounding = ROUNDING * float(np.nanmax(np.abs(places)))
    if moved > rounding and (moved > STILL * chance or _follows(run, u, places)):
        return None
    return (
        f"the commands change, but the points do not move: by {moved:.2g} mm RMS, which is their "
        f"noise; {ENGAGED}"
    )


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
    visible = np.asarray(np.isfinite(places).all(axis=2), np.bool_)
    places = np.nan_to_num(places)
    total = power(centred(places, visible), visible)
    share = power(answered(at, places, visible), visible) / max(total, 1e-300)
    return total > 0 and share > min(CHANCE * 2 * at.shape[1] / len(at), 0.5)
