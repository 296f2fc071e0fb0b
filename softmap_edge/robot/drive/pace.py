"""The times at which the rows of a command file are played on servos.

Each row follows the one before after the time in the file, or later if the slew limit and the
following error of the servos require it. A *rest* is a stretch of rows with one command, of `LEAST`
s or more. The clock of the file stands at its first row until the robot has settled. A *stop* is a
row from which on something must be done by hand (a note, another gravity or load).

The robot has settled if, over `SPAN` s, no servo moves by more than `TICKS` ticks, and the frames
move by no more than `STILL` mm (RMS over the points) beyond their noise. After `PATIENCE` s playing
goes on anyway, because a body that creeps never settles. Pinned by
tests/robot/test_record_robot.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import SoftmapError
from softmap_edge.model.servo_calibration import Calibration
from softmap_edge.robot.link.frames import Frame
from softmap_edge.robot.servo.loop_types import ServoLimits
from softmap_edge.run.protocol import Protocol

Floats = NDArray[np.float64]

LEAST = 0.5  # s: shortest rest
# settled: s of observation, ticks of servo motion, mm RMS of motion in the frames
SPAN, TICKS, STILL = 0.3, 3, 0.05
PATIENCE = 3.0  # s after which a rest ends, settled or not
SHARE = 0.9  # share of the slew limit at which a file is played at most
# s of assumed servo delay (the trunk's: 0.24), which is a following error in motion
ANSWER = 0.25
BEHIND = 0.75  # share of the allowed following error that is used
FEWEST = 3  # frames in each half of a span that are needed to detect motion


@dataclass(frozen=True, eq=False)
class Pace:
    """The schedule of a command file.

    Attributes:
        made: the file
        t: (T,) s at which its rows are due, without waiting
        rests: (T,) bool, first rows of rests
        stops: row → what must be done by hand there
        looks: (K,) s at which a frame is required
    """

    made: Protocol
    t: Floats
    rests: NDArray[np.bool_]
    stops: dict[int, str]
    looks: Floats

    def command(self, now: float) -> Floats:
        """Return the command (C,) at time `t`."""
        return np.array([np.interp(now, self.t, column) for column in self.made.command.T])

    def row(self, now: float) -> int:
        """Return the row that is effective at time `t`."""
        return int(np.clip(np.searchsorted(self.t, now, side="right") - 1, 0, len(self.t) - 1))


def pace(made: Protocol, calibration: Calibration, servos: Sequence[ServoLimits]) -> Pace:
    """Return the schedule of a command file on `servos` (their limits: low, high, slew, following).

    Raises:
        SoftmapError: the file has another number of commands or another unit, or a command is
            outside the servos' window.
    """
    channels = made.command.shape[1]
    if channels != len(calibration.b) or made.unit != calibration.unit:
        raise SoftmapError(
            f"the command file has {channels} commands in {made.unit}, the robot takes "
            f"{len(calibration.b)} in {calibration.unit}; write one for it with `softmap next "
            "--bundle`"
        )
    ticks = calibration.ticks(made.command).astype(float)
    low, high, slew, following = (
        np.array([one[name] for one in servos], float)
        for name in ("low", "high", "slew", "following")
    )
    outside = np.maximum(low - ticks, ticks - high)
    if outside.max() > 1.0:
        k, c = np.unravel_index(int(np.argmax(outside)), outside.shape)
        raise SoftmapError(
            f"row {k + 1}: command {made.command[k, c]:g} {made.unit} is tick {ticks[k, c]:.0f} "
            f"of servo {c}, its window is {low[c]:.0f} to {high[c]:.0f}; write a file of a "
            "smaller range, or measure the window again"
        )
    fastest = np.minimum(SHARE * slew, BEHIND * following / ANSWER)
    least = (np.abs(np.diff(ticks, axis=0)) / fastest).max(axis=1)
    step = np.diff(made.t)
    # A step is commanded at once; the guard plans the path between.
    t = np.concatenate([[0.0], np.cumsum(np.maximum(step, least))])
    return Pace(made, t, _rests(made), _stops(made), np.interp(made.t_seen, made.t, t))


def _rests(made: Protocol) -> NDArray[np.bool_]:
    still = np.all(np.abs(np.diff(made.command, axis=0)) < 1e-9, axis=1)
    begins = np.flatnonzero(still & ~np.concatenate([[False], still[:-1]]))
    rests = np.zeros(len(made.t), bool)
    for k in begins:
        moves = np.flatnonzero(~still[k:])
        end = k + int(moves[0]) if len(moves) else len(made.t) - 1
        rests[k] = made.t[end] - made.t[k] >= LEAST
    return rests


def _stops(made: Protocol) -> dict[int, str]:
    """Return rows with a note, and rows where a condition changes without one.

    Conditions are compared with those of the last capture.
    """
    stops = {
        int(np.clip(np.searchsorted(made.t, t - 1e-9), 0, len(made.t) - 1)): text
        for t, text in made.notes
    }
    load = np.zeros(len(made.t)) if made.load is None else made.load
    changes = np.any(np.abs(np.diff(made.gravity, axis=0)) > 1e-6, axis=1) | (
        np.abs(np.diff(load)) > 1e-9
    )
    for k in np.flatnonzero(changes) + 1:
        looked = made.t_seen[made.t_seen < made.t[k]]
        since = looked[-1] if len(looked) else -np.inf
        if not any(since < made.t[row] <= made.t[k] for row in stops):
            stops[int(k)] = f"from here on: {condition(made, int(k))}"
    return stops


def condition(made: Protocol, row: int) -> str:
    """Return the orientation and load of the robot at a row, as text."""
    down = " ".join(f"{g:.2f}" for g in made.gravity[row])
    load = 0.0 if made.load is None else made.load[row]
    return f"gravity points along {down}, {load:g} g hang at the tip"


def servos_still(history: Sequence[tuple[float, Sequence[float]]], now: float) -> bool:
    """Return whether no servo moved over the last `SPAN` s of the (s, ticks) readings."""
    last = [ticks for t, ticks in history if t >= now - SPAN]
    enough = bool(history) and history[0][0] <= now - SPAN and len(last) >= FEWEST
    return enough and bool(np.all(np.ptp(np.array(last), axis=0) <= TICKS))


def view_still(frames: Sequence[Frame], since: float, now: float) -> bool:
    """Return whether the frames show no motion.

    It uses frames that arrived after `since`, within about the last `SPAN` s.
    """
    last = [frame.points for frame in frames if frame.arrived > max(since, now - 3 * SPAN)][
        -4 * FEWEST :
    ]
    half = len(last) // 2
    if half < FEWEST:
        return False
    early, late = np.array(last[:half], float), np.array(last[half:], float)
    shown = np.isfinite(early).all(axis=(0, 2)) & np.isfinite(late).all(axis=(0, 2))
    if not shown.any():
        return False
    early, late = early[:, shown], late[:, shown]
    moved = float(np.mean(np.sum((late.mean(axis=0) - early.mean(axis=0)) ** 2, axis=1)))
    scatter = [part.var(axis=0, ddof=1).sum(axis=1).mean() / len(part) for part in (early, late)]
    return moved - float(sum(scatter)) <= STILL**2
