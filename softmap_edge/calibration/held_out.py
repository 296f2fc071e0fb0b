"""Group the frames of a run by held command, so that each command counts once.

Frames of one dwell share their disturbances, and dwells at one command share the model error there.
So the rows of a calibration are held commands: places in ticks, with the mean of their matches. If
a run does not dwell enough, places are small cells of ticks and include frames in motion. Units:
ticks, s, and those of the commands.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.calibration.matching import Matches
from softmap_edge.run.conditions import STILL, conditions
from softmap_edge.run.run import Run

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

SAME = 0.005  # of the span of the ticks: dwells closer than this are one place
CELL = 0.04  # of the span: size of a place without dwells
# times as many places as coefficients of a channel; with fewer dwells, frames in motion are used
ENOUGH = 3
WINDOW = 0.5  # s over which the direction of a servo is determined


@dataclass(frozen=True, eq=False)
class HeldOut:
    """The held commands of a run.

    Attributes:
        ticks: (n, C).
        u: matched commands, (n, C).
        covariance: of the matched commands, (n, C, C).
        observed: commands that move the shape there, (n, C).
        place: number of the place, (n,).
        direction: signs of the last motion before, (n, m); m = 0 if they were not requested.
        frames: numbers of the frames of each held command.
        still: whether the held commands are dwells.
    """

    ticks: Floats
    u: Floats
    covariance: Floats
    observed: Mask
    place: Index
    direction: Floats
    frames: list[Index]
    still: bool

    def __len__(self) -> int:
        return len(self.ticks)


@dataclass(frozen=True, eq=False)
class SeenMarkers:
    """The usable frames of a run and their places.

    Attributes:
        frame: numbers of the frames, (k,).
        ticks: (k, C).
        place: number of the place, (k,).
        still: whether the robot rests in all of them.
    """

    frame: Index
    ticks: Floats
    place: Index
    still: bool


def places(run: Run, ticks: Floats, usable: Mask) -> SeenMarkers:
    """Return the places of the usable frames of a run.

    Args:
        run: the run.
        ticks: of its record, (T, C).
        usable: which frames may be used, (K,).
    """
    state = conditions(run, ticks)
    span = np.maximum(np.ptp(ticks, axis=0), 1.0)
    still = np.flatnonzero(usable & ~state.moving)
    number = _places(state.command[still], state.visit[still], span)
    if len(np.unique(number)) >= ENOUGH * (ticks.shape[1] + 1):
        return SeenMarkers(still, state.command[still], number, True)
    frame = np.flatnonzero(usable)
    cells = np.rint(state.command[frame] / (CELL * span)).astype(np.int64)
    number = np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1) if len(frame) else frame
    return SeenMarkers(frame, state.command[frame], number, False)


def gather(seen: SeenMarkers, matches: Matches, direction: Floats | None = None) -> HeldOut:
    """Return the held commands of a run: one for each place.

    Args:
        seen: the usable frames and their places.
        matches: commands of all frames.
        direction: sign of the last motion before each frame, (K, m); with it, there is one held
            command for each place and direction.
    """
    way = np.zeros((len(seen.frame), 0)) if direction is None else direction[seen.frame]
    keys = np.column_stack([seen.place, way])
    groups = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
    parts = [np.flatnonzero(groups == g) for g in range(groups.max(initial=-1) + 1)]
    parts.sort(key=lambda part: int(part[0]))
    rows = [seen.frame[part] for part in parts]
    return HeldOut(
        ticks=np.array([seen.ticks[part].mean(axis=0) for part in parts]),
        u=np.array([np.median(matches.command[row], axis=0) for row in rows]),
        covariance=np.array([matches.covariance[row].mean(axis=0) / len(row) for row in rows]),
        observed=np.array([matches.observed[row].mean(axis=0) > 0.5 for row in rows]),
        place=np.array([seen.place[part[0]] for part in parts]),
        direction=np.array([way[part[0]] for part in parts]),
        frames=rows,
        still=seen.still,
    )


def visits(run: Run, ticks: Floats, seen: SeenMarkers) -> Index:
    """Return the number of dwells at each place, by the number of the place."""
    visit = conditions(run, ticks).visit[seen.frame]
    pairs = np.unique(np.column_stack([seen.place, visit]), axis=0)
    return np.bincount(pairs[:, 0])


def directions(run: Run, drive: Floats) -> Floats:
    """Return the sign of the last motion of each column before each frame.

    Args:
        run: the run.
        drive: positions of servos, or commands, (T, m).

    Returns:
        Floats: signs (K, m); 0 before the first motion.
    """
    t, past = run.t, np.maximum(run.t - WINDOW, run.t[0])
    moved = np.column_stack([column - np.interp(past, t, column) for column in drive.T])
    moved /= np.maximum(t - past, 1e-9)[:, None]
    sign = np.where(
        np.abs(moved) > STILL * np.maximum(np.ptp(drive, axis=0), 1e-12), np.sign(moved), 0.0
    )
    last = np.maximum.accumulate(np.where(sign != 0, np.arange(len(t))[:, None], 0), axis=0)
    held = np.take_along_axis(sign, last, axis=0)
    return np.asarray(
        held[np.clip(np.searchsorted(t, run.t_seen, side="right") - 1, 0, len(t) - 1)]
    )


def _places(ticks: Floats, visit: Index, span: Floats) -> Index:
    """Return the number (k,) of each frame's place.

    Dwells whose medians lie within SAME of the first one are at one place.
    """
    number = np.zeros(len(ticks), np.int64)
    leaders = np.zeros((0, ticks.shape[1]))
    for v in dict.fromkeys(visit.tolist()):
        rows = np.flatnonzero(visit == v)
        middle = np.median(ticks[rows], axis=0)
        near = np.flatnonzero((np.abs(leaders - middle) <= SAME * span).all(axis=1))
        if not len(near):
            leaders, near = np.vstack([leaders, middle]), np.array([len(leaders)])
        number[rows] = near[0]
    return number
