"""Play a command file on a robot that records, and make a run of its commands and frames.

The clock of the file stands while the robot settles at a rest, while the guard holds, and while the
camera is lost. For a step by hand, the finger goes home, torque goes off, and the user confirms
when to go on. Each capture of the file gets the nearest frame. However playing ends, the commands
and frames so far are stored. Pinned by tests/robot/test_record_robot.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import ServoError, SoftmapError
from softmap_edge.model.model import Model
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.control.recording import read_recording
from softmap_edge.robot.drive.observations import LATELY, Kept, Pair, vertices_of
from softmap_edge.robot.drive.pace import PATIENCE, SPAN, Pace, condition, servos_still, view_still
from softmap_edge.robot.drive.recorded import with_seen
from softmap_edge.robot.link.frames import Frame, HostClock, Seen
from softmap_edge.robot.servo import status_words as words
from softmap_edge.run.run import Run

Floats = NDArray[np.float64]

SENT = 50.0  # commands per second
NEAR = 0.1  # s: largest distance of a frame from its capture
WAIT = 0.5  # s after a capture until the frames around it have arrived
# s without a frame after which the clock of the file stands, and after which playing fails
GONE, LOST = 0.5, 15.0
BACK = 15.0  # s within which torque is off after a stop was requested
BEGIN = 8.0  # s within which the robot reaches the first command of the file


@dataclass
class Played(Kept):
    """The result: frames, time spent settling, and whether the complete file was played."""

    waited: float = 0.0  # s
    unsettled: int = 0  # rests that ended before all was still
    whole: bool = False


class Player:
    """Play a schedule on an entered `robot` that records, with frames from `seen`.

    Args:
        ask: called with a step to do by hand; returns when it is done
        tell: called with the completed share
        late: s from exposure to arrival of the fastest frame
        keep: called repeatedly with new data (`Keeper.add`)
    """

    def __init__(
        self,
        robot: Controller,
        pace: Pace,
        seen: Seen,
        *,
        ask: Callable[[str], None],
        tell: Callable[[float], None] = lambda share: None,
        late: float = 0.0,
        keep: Callable[
            [list[Pair], list[tuple[int, Frame]], list[Frame]], None
        ] = lambda clock, taken, came: None,
    ) -> None:
        self._robot, self._pace, self._seen = robot, pace, seen
        self._ask, self._tell, self._keep = ask, tell, keep
        self.played = Played(camera=HostClock(late))
        self._looks: list[tuple[float, int]] = []  # (host s, number of the capture)
        self._history: list[tuple[float, list[float]]] = []
        self._newest, self._looked, self._kept = -np.inf, 0, 0

    def play(self) -> Played:
        """Play the file to its end.

        Raises:
            SoftmapError: the guard stopped, or the camera is lost.
        """
        pace = self._pace
        self._await_camera()
        self._ask(f"it begins so: {pace.stops.get(0) or condition(pace.made, 0)}")
        self._engage(0.0)
        at, last, row = 0.0, self._robot.time.now(), -1
        while True:
            now = self._robot.time.now()
            self._send(at, now)
            here = pace.row(at)
            for passed in range(row + 1, here + 1):
                if passed in pace.stops and passed > 0:
                    self._by_hand(pace.stops[passed], at)
                if pace.rests[passed]:
                    self._settle(at)
            row, fresh = max(row, here), self._robot.time.now()
            self._gather(fresh)
            if at >= pace.t[-1]:
                break
            runs = self._robot.state == "engaged" and self._camera_there(fresh)
            begun = fresh if fresh - now > 2.0 / SENT else last
            step = min(fresh - begun, 2.0 / SENT) if runs else 0.0
            upto = min(at + step, float(pace.t[-1]))
            while self._looked < len(pace.looks) and pace.looks[self._looked] <= upto:
                self._looks.append((fresh - (upto - pace.looks[self._looked]), self._looked))
                self._looked += 1
            self.played.clock += [(fresh - step, at), (fresh, upto)]
            at, last = upto, fresh
            self._tell(at / float(pace.t[-1]) if pace.t[-1] else 1.0)
            self._robot.time.sleep(max(0.0, 1.0 / SENT - (self._robot.time.now() - now)))
        self._rest(at, WAIT + 0.1)
        self.played.whole = True
        return self.played

    def _engage(self, at: float) -> None:
        self._robot.engage(self._pace.command(at))
        self._history.clear()
        self._settle(at, BEGIN)

    def _send(self, at: float, now: float) -> None:
        self._robot.target(self._pace.command(at))
        position = self._robot.report.get("position") or []
        heard = [float(p) for p in position if p is not None]
        if (
            position
            and len(heard) == len(position)
            and (not self._history or now > self._history[-1][0])
        ):
            self._history.append((now, heard))
            while len(self._history) > 2 and self._history[1][0] < now - 2 * SPAN:
                self._history.pop(0)

    def _rest(self, at: float, seconds: float) -> None:
        """Hold the current command for a while."""
        end = self._robot.time.now() + seconds
        while (now := self._robot.time.now()) < end:
            self._send(at, now)
            self._gather(now)
            self._robot.time.sleep(1.0 / SENT)

    def _settle(self, at: float, patience: float = PATIENCE) -> None:
        """Hold until servos and frames are still, at most `PATIENCE`."""
        begun = self._robot.time.now()
        still_since: float | None = None
        self._history.clear()
        while (now := self._robot.time.now()) - begun < patience:
            self._send(at, now)
            if servos_still(self._history, now):
                still_since = still_since or now
                if view_still(self._seen()[-60:], still_since - SPAN, now):
                    break
            else:
                still_since = None
            self._gather(now)
            self._robot.time.sleep(1.0 / SENT)
        else:
            self.played.unsettled += 1
        self.played.waited += self._robot.time.now() - begun
        self.played.clock += [(begun, at), (self._robot.time.now(), at)]

    def _by_hand(self, what: str, at: float) -> None:
        """Switch torque off, have a step done by hand, and return to the same command."""
        self._rest(at, WAIT + 0.1)
        self._robot.request("stop")
        end = self._robot.time.now() + BACK
        while self._robot.state != "ready":
            if self._robot.time.now() > end:
                raise ServoError(
                    f"the finger did not stop within {BACK:g} s ({words.where(self._robot.report)})"
                )
            self._robot.time.sleep(0.05)
        begun = self._robot.time.now()
        self._ask(what)
        self.played.clock += [(begun, at), (self._robot.time.now(), at)]
        self._engage(at)

    def _camera_there(self, now: float) -> bool:
        """Return whether frames arrive.

        Raises:
            SoftmapError: none has arrived for `LOST` s.
        """
        silent = now - self._newest
        if silent > LOST:
            raise SoftmapError(
                f"the camera is gone: no frame for {silent:.0f} s; see to its program and the "
                "network, then record again"
            )
        return silent <= GONE

    def _await_camera(self) -> None:
        end = self._robot.time.now() + LOST
        while not self._seen():
            if self._robot.time.now() > end:
                raise SoftmapError(
                    f"no frame came within {LOST:g} s; start the camera's program and check "
                    "address and key (docs/do/camera.md)"
                )
            self._robot.time.sleep(0.05)
        self._gather(self._robot.time.now())

    def _gather(self, now: float) -> None:
        """Record new arrivals, and select the frames of captures that are old enough."""
        frames = self._seen()[-LATELY:]
        came = self.played.camera.add(frames)
        before = len(self.played.taken)
        if frames:
            self._newest = frames[-1].arrived
        while frames and self._looks and self._looks[0][0] < now - WAIT:
            when, look = self._looks.pop(0)
            taken = self.played.camera.times(frames)
            k = int(np.argmin(np.abs(taken - when)))
            earlier = self.played.taken[-1][1].stamp if self.played.taken else -np.inf
            if abs(taken[k] - when) <= NEAR and frames[k].stamp > earlier:
                self.played.taken.append((look, frames[k]))
        self._keep(self.played.clock[self._kept :], self.played.taken[before:], came)
        self._kept = len(self.played.clock)


def merged(recording: Path, model: Model, pace: Pace, played: Kept) -> Run:
    """Return the run of a loop's recording and the frames seen meanwhile.

    Raises:
        RunError: torque was never on, or the frames do not fit the model.
    """
    recorded = read_recording(recording)
    looks, frames = [look for look, _ in played.taken], [frame for _, frame in played.taken]
    run, inside = with_seen(recorded, frames, played.camera, vertices_of(model))
    host = run.t + recorded.begun
    clock = np.array(played.clock or [(host[0], 0.0)])
    at = np.interp(host, clock[:, 0], clock[:, 1])
    rows = np.clip(np.searchsorted(pace.t, at, side="right") - 1, 0, len(pace.t) - 1)
    made = pace.made
    return replace(
        run,
        gravity=made.gravity[rows],
        load=None if made.load is None else made.load[rows],
        block=np.array([str(made.block[look]) for look in looks])[inside] if run.frames else None,
        robot=model.robot,
    )
