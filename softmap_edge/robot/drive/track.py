"""Move the tip along a figure: path, timing, commands, motion on servos, and tip error.

A small move at the start measures the response of the servos (delay, lag), which is then previewed.
The control loop compensates the effects of the model from the commands that were sent. If a camera
sees the tip, the remaining error can be fed back (`observe`). Pinned by tests/robot/test_track.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import SoftmapError
from softmap_edge.files.atomic import Document
from softmap_edge.model.servo_calibration import Calibration
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.control.recording import read_recording
from softmap_edge.robot.drive.response import response_of
from softmap_edge.robot.link.frames import Frame, HostClock, Seen, on_host
from softmap_edge.robot.motion.figures import even, figure
from softmap_edge.robot.motion.kinematics import AXES, Kinematics, Plan, early
from softmap_edge.robot.motion.timing import timed

Floats = NDArray[np.float64]
T = TypeVar("T")

PATH_POINTS = 600  # points of a figure at which it is timed
LEAD = 2.0  # s: least duration of the way from rest to the figure
SENT = 100.0  # commands per second
SETTLED = 1.5  # s of waiting after engaging and after the figure
ARRIVED = 0.3  # s after the figure until all of its frames have arrived
PROBE = (140.0, 3.0)  # ticks and s of the move that measures the servos
AVERAGED = 0.2  # s over which the observed error is averaged before it is fed back
MOST_BACK = 5.0  # mm: largest correction by feedback
GONE = 0.5  # s without the tip after which it counts as not seen
FADES = 1.0  # s: time constant with which feedback decays when the tip is not seen


@dataclass(frozen=True)
class Course:
    """A plan, and which of its waypoints (T,) belong to the figure; the others lead to it.

    The shortest possible duration of the figure is `quickest` s.
    """

    plan: Plan
    counts: NDArray[np.bool_]
    quickest: float


def course(
    kinematics: Kinematics,
    name: str,
    *,
    amplitude: float,
    duration: float,
    rate: float,
    slew: Sequence[float],
    acceleration: Sequence[float],
    calibration: Calibration,
    method: str = "exact",
) -> Course:
    """Plan a figure around the tip at rest, in the first two of the axes that count.

    Args:
        name: a figure or a file (`figures.figure`)
        amplitude: mm
        duration: s; longer where the limits require it
        rate: waypoints per second
        slew: (C,) ticks/s of the servos
        acceleration: (C,) ticks/s² of the servos
        calibration: from commands to ticks

    Raises:
        SoftmapError: a rate or duration is invalid, fewer than two axes count, or as `figure`.
    """
    if not (0 < duration <= 3600 and 1 <= rate <= 1000):
        raise SoftmapError(
            f"{duration:g} s at {rate:g} waypoints a second; up to 3600 s and 1 to 1000 are allowed"
        )
    plane = [AXES.index(axis) for axis in kinematics.axes][:2]
    if len(plane) < 2:
        raise SoftmapError(f"axes '{kinematics.axes}': a figure needs two, as xy")
    rest = np.asarray(kinematics.tip.evaluate(kinematics.home[None]))[0]

    def placed(points: Floats) -> Floats:
        path = np.tile(rest, (len(points), 1))
        path[:, plane] += points
        return path

    line = figure(name, amplitude)
    way = placed(even(line, PATH_POINTS))
    lead = placed(even(np.stack([np.zeros(2), line[0]]), max(3, PATH_POINTS // 4)))
    back = np.linalg.inv(calibration.A).T

    def waypoints(
        points: Floats, least: float, start: Floats | None, fine: bool
    ) -> tuple[Floats, Floats, float]:
        acting = kinematics.solve(points, start).acting
        line = np.concatenate([acting @ back, points], axis=1)
        line = even(line, 2 * len(line)) if fine else line
        profile = timed(line[:, :-3], slew, acceleration, least)
        t = np.arange(0.0, profile.t[-1] + 1e-9, 1.0 / rate)
        along = np.linspace(0.0, 1.0, len(line))
        found = np.stack([np.interp(profile.at(t), along, column) for column in line.T], axis=1)
        return found[:, -3:], found[:, :-3] @ calibration.A.T, profile.quickest

    def complete_path(fine: bool) -> tuple[Floats, Floats, NDArray[np.bool_], float]:
        to, first, _ = waypoints(lead, LEAD, None, fine)
        figures, then, quickest = waypoints(way, duration, first[-1], fine)
        counts = np.arange(len(to) + len(figures)) >= len(to)
        return np.concatenate([to, figures]), np.concatenate([first, then]), counts, quickest

    targets, _, counts, quickest = complete_path(fine=False)
    plan = kinematics.plan(targets, np.arange(len(targets)) / rate, method=method)
    # While a tendon hangs slack, a full mm of command may lie between two waypoints, which no servo
    # can follow. Then the path is timed evenly in ticks, and the timed commands are the effective
    # ones, although the tip leaves its path while the slack is taken up.
    if (
        method == "exact"
        and (np.abs(np.diff(plan.acting @ back, axis=0)) * rate > np.asarray(slew)).any()
    ):
        targets, acting, counts, quickest = complete_path(fine=True)
        t = np.arange(len(targets)) / rate
        reached = kinematics.solve(targets).distance
        plan = replace(kinematics.plan(targets, t, acting=acting), unreachable=reached)
    return Course(plan, counts, quickest)


@dataclass(frozen=True)
class Tracked:
    """The result of tracking.

    Attributes:
        tip: (K, 3) mm, observed positions at `t` (K,) s of the plan
        target: (K, 3) mm, target positions at these times
        error: (K,) mm along the axes that count
        response: (delay, lag) s of the servos; None if it was not measured
        unseen: s of the figure without camera frames
    """

    t: Floats
    target: Floats
    tip: Floats
    error: Floats
    response: tuple[float, float] | None
    unseen: float = 0.0


def track(
    robot: Controller,
    kinematics: Kinematics,
    course: Course,
    seen: Seen | None = None,
    *,
    observe: bool = False,
    late: float = 0.0,
    progress: Callable[[str, float], None] | None = None,
) -> Tracked:
    """Follow a course on an entered `robot` that records, and measure its error with `seen`.

    If the tip is not seen for `GONE` s, its feedback decays; nothing else changes. `late` s is the
    delay of the fastest frame. `progress` is called with the current step and the completed share.

    Raises:
        SoftmapError: the robot records nothing, there is feedback without a camera, or the guard
            stopped.
    """
    if robot.recording is None or (observe and seen is None):
        raise SoftmapError(
            "tracking needs a robot that records, and a camera where what it sees is fed back"
        )
    home = kinematics.home
    robot.engage(home)
    say = progress or (lambda what, share: None)
    _play(robot, lambda t: home, SETTLED)
    slope = robot.calibration.A  # command per tick
    _play(
        robot,
        lambda t: home + slope @ _probe(t, len(home)),
        PROBE[1] + SETTLED,
        partial(say, "measuring servos"),
    )
    measured = _meanwhile(robot, home, partial(_response, robot.recording))
    robot.check_recorded()  # an interrupted recording has no measurement
    delay, lag = measured or (0.0, 0.0)
    plan = course.plan
    delays, lags = (own + more for own, more in zip((delay, lag), kinematics.delays))  # (C,) s
    asked = early(plan.acting, plan.t, delays, lags)
    feedback = _Feedback(kinematics, plan, float(np.max(delays + lags)), late) if observe else None
    begun = robot.time.now()

    def command(t: float) -> Floats:
        u = np.array([np.interp(t, plan.t, column) for column in asked.T])
        if feedback is not None and seen is not None:
            u = u + feedback(u, t, begun, seen())
        return u

    _play(robot, command, float(plan.t[-1]) + 1.0 / SENT, partial(say, "tracking"))
    _play(robot, lambda t: asked[-1], ARRIVED)
    frames = [] if seen is None else seen()
    _play(robot, lambda t: asked[-1], SETTLED - ARRIVED)
    return _errors_of(kinematics, course, frames, begun, measured, late)


def spread(error: Floats) -> Document:
    """Return mean, standard deviation, maximum and number of errors, as in documents."""
    return {
        "mean": float(error.mean()),
        "sd": float(error.std()),
        "max": float(error.max()),
        "n": len(error),
    }


def _play(
    robot: Controller,
    command: Callable[[float], Floats],
    seconds: float,
    say: Callable[[float], None] | None = None,
) -> None:
    """Send `command` of the elapsed time at `SENT` Hz; pass the completed share to `say`."""
    begun = due = robot.time.now()
    reported = -1.0
    while (now := robot.time.now()) - begun < seconds:
        robot.target(command(now - begun))
        if say is not None and now - reported >= 0.1:
            reported = now
            say((now - begun) / seconds)
        due = max(due + 1.0 / SENT, now)
        robot.time.sleep(max(0.0, due - robot.time.now()))


def _meanwhile(robot: Controller, command: Floats, work: Callable[[], T]) -> T:
    """Send `command` while a thread does `work`.

    So the guard keeps receiving targets on a slow computer.
    """
    if robot.time.stepped:
        return work()  # simulated time stands meanwhile
    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(work)
        while not done.done():
            robot.target(command)
            robot.time.sleep(1.0 / SENT)
        return done.result()


def _response(recording: Path) -> tuple[float, float] | None:
    return response_of(read_recording(recording).periods)


def _probe(t: float, channels: int) -> Floats:
    """Return the turn (C,) ticks of each servo from home at `t` s of the measuring move."""
    if t > PROBE[1]:
        return np.zeros(channels)
    rise = np.sin(np.pi * t / PROBE[1]) ** 2
    return np.array(
        [PROBE[0] * rise * np.sin(2 * np.pi * (1.0 + 0.3 * (c % 3)) * t) for c in range(channels)]
    )


def _tips(kinematics: Kinematics, frames: Sequence[Frame]) -> Floats:
    """Return the observed tips (K, 3) mm; NaN where a tip was not completely seen."""
    index = kinematics.model.tip_indices
    return np.array(
        [np.asarray(frame.points, float)[index].mean(axis=0) for frame in frames]
    ).reshape(-1, 3)


def _errors_of(
    kinematics: Kinematics,
    course: Course,
    frames: Sequence[Frame],
    begun: float,
    response: tuple[float, float] | None,
    late: float,
) -> Tracked:
    t, tip = on_host(frames, late) - begun, _tips(kinematics, frames)
    plan = course.plan
    first, last = float(plan.t[course.counts][0]), float(plan.t[-1])
    during = (t >= first) & (t <= last) & np.isfinite(tip).all(axis=1)
    t, tip = t[during], tip[during]
    target = np.stack([np.interp(t, plan.t, column) for column in plan.targets.T], axis=1)
    error = np.linalg.norm((tip - target)[:, kinematics.counted], axis=1)
    gaps = np.diff(np.concatenate([[first], t, [last]]))
    return Tracked(t, target, tip, error, response, float(gaps[gaps > GONE].sum()))


class _Feedback:
    """A disturbance observer: the observed error as a change of the effective command.

    The disturbance is the observed tip, minus the target, minus the corrections effective at
    exposure. It is averaged over `AVERAGED` s and subtracted at once. Corrections in transit are
    known, so feedback need not wait for the response of the servos. Errors shorter than that
    response, as at a reversal, are not corrected. While the tip is not seen, the correction decays.
    """

    def __init__(self, kinematics: Kinematics, plan: Plan, answer: float, late: float) -> None:
        self._kinematics, self._plan, self._answer = kinematics, plan, answer
        self._clock = HostClock(late)
        self._off, self._last = np.zeros(3), -np.inf
        self._seen, self._asked_at = -np.inf, -np.inf  # s of the plan
        self._counts = kinematics.counted
        self._asked: list[tuple[float, Floats]] = [(-np.inf, np.zeros(3))]

    def __call__(self, u: Floats, t: float, begun: float, frames: Sequence[Frame]) -> Floats:
        """Return the change (C,) mm of the effective command at `t` s of the plan."""
        new = self._clock.add(frames)
        for frame, taken in zip(new, self._clock.times(new) - begun):
            tip = _tips(self._kinematics, [frame])[0] if taken >= 0 else np.full(3, np.nan)
            if not np.isfinite(tip).all():
                continue
            plan = self._plan
            target = np.array([np.interp(taken, plan.t, column) for column in plan.targets.T])
            there = next(c for then, c in reversed(self._asked) if then <= taken - self._answer)
            off = np.where(self._counts, tip - target - there, 0.0)
            step = (
                min(frame.stamp - self._last, AVERAGED) if np.isfinite(self._last) else AVERAGED / 6
            )
            self._off += (1.0 - np.exp(-step / AVERAGED)) * (off - self._off)
            self._last, self._seen = frame.stamp, t
        if t - self._seen > GONE:
            self._off *= np.exp(-(t - max(self._asked_at, self._seen)) / FADES)
        self._asked_at = t
        correction = np.clip(-self._off, -MOST_BACK, MOST_BACK)
        self._asked.append((t, correction))
        slopes = np.asarray(self._kinematics.tip.jacobian(u[None]))[0][self._counts]
        return np.asarray(np.linalg.lstsq(slopes, correction[self._counts], rcond=0.05)[0])
