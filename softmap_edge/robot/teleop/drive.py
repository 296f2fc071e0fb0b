"""Drive a robot by hand or knob: observation, filter, clutch, target point, command.

One thread polls the inputs, takes the newest observation and sends one target, at least SENT times
a second. Nothing is queued. A hand in view never starts motion: the operator must hold the enable
key (`keys`). A lost hand or a gesture only ends it (`clutch`). When the key is released, the guard
holds, then releases tension (docs/reference/safety.md). Pinned by tests/robot/test_teleop_drive.py
through the real loop on emulated servos.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import SupportsFloat

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import ServoError
from softmap_edge.files.atomic import Document
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.motion.kinematics import Kinematics
from softmap_edge.robot.servo import status_words as words
from softmap_edge.robot.servo.loop_types import LoopReport
from softmap_edge.robot.teleop.busy import Busy
from softmap_edge.robot.teleop.clutch import Clutch
from softmap_edge.robot.teleop.gesture import Deadman, Rule
from softmap_edge.robot.teleop.hand import Hand, HandMap
from softmap_edge.robot.teleop.hand_source import SEEN, HandObservation, HandSource
from softmap_edge.robot.teleop.keys import Controls, Input
from softmap_edge.robot.teleop.mapping import HandMapping
from softmap_edge.robot.teleop.one_euro import OneEuro, OneEuroState
from softmap_edge.robot.teleop.own_hand import ANOTHER, OwnHand

Floats = NDArray[np.float64]

SENT = 100.0  # least number of targets per second while driving
DRIVABLE = ("engaged", "hold")  # guard states that follow targets, or return to it
BEGINS = ("ready", *DRIVABLE)  # guard states in which a press may start driving
GONE = ("gone", "error", "rescued")  # keys of a report after which the control loop has ended
MOST_KEPT = 200_000  # latencies that are kept: an hour and a half at 30 frames/s


@dataclass
class DriveSummary:
    """Summary of a session: frames taken, with a hand, and used to drive; times; how it ended.

    Includes the seconds in each state, and why driving ended.
    """

    states: dict[str, float] = field(default_factory=dict)  # s in each state
    engaged_s: float = 0.0
    busy_s: float = 0.0  # s for which a busy computer held up a simulated robot
    presses: int = 0
    lost: Counter[str] = field(default_factory=Counter)
    latency: list[float] = field(default_factory=list)  # s from a frame to the target sent for it
    ended: str = ""
    failed: bool = False

    def to_dict(self) -> Document:
        """Return it as entries of the document."""
        ms = 1e3 * np.array(self.latency or [np.nan])
        several = len(self.latency) > 0
        return {
            "driven_from": len(self.latency),
            "latency_ms": {"median": _round(np.median(ms)), "p95": _round(np.quantile(ms, 0.95))}
            if several
            else None,
            "states_s": {state: round(seconds, 3) for state, seconds in self.states.items()},
            "driving_s": round(self.engaged_s, 3),
            "busy_s": round(self.busy_s, 3),
            "presses": self.presses,
            "lost": dict(self.lost),
            "ended": self.ended,
        }


def _round(number: SupportsFloat) -> float:
    return round(float(number), 2)


@dataclass(frozen=True, eq=False)
class DriveState:
    """What the page and the terminal show.

    The report of the guard, the clutch, the active input, the newest observation, the filtered
    (c_f, c_r), the knob, the actual and target position in the plane (mm), and the age (s) of the
    observation in use.
    """

    t: float
    report: LoopReport
    clutch: Clutch
    controls: Controls
    sight: HandObservation | None
    seen: Floats | None
    here: Floats
    led: Floats | None
    age: float | None
    lacking: str
    busy: str = ""  # line on a busy computer that holds up a simulated robot; else empty


class Drive:
    """Drive an entered `robot` until something ends it.

    Args:
        robot: entered robot
        kinematics: of the model that the robot's commands are meant for
        aim: mapping to the plane
        eyes: entered source of observations
        inputs: inputs with an enable key; the first held key counts
        reach: as in `HandMap`
        flip: axes of the hand that change their sign
        rule: gesture required in addition to the key
        stays: after the camera is lost, go on with the knob
        sent: called with the time of each frame used to drive, and its command
        show: called with each `DriveState`; must not block
        say: called with each new line
    """

    def __init__(
        self,
        robot: Controller,
        kinematics: Kinematics,
        aim: HandMapping,
        eyes: HandSource,
        inputs: Sequence[Input],
        *,
        reach: tuple[float, float] = HandMap.reach,
        flip: tuple[bool, bool] = (False, False),
        rule: Rule = "fist releases",
        stays: bool = False,
        sent: Callable[[float, Floats], None] | None = None,
        show: Callable[[DriveState], None] | None = None,
        say: Callable[[str], None] | None = None,
    ) -> None:
        self._robot = robot
        self._aim = aim
        self._eyes = eyes
        self._inputs = list(inputs)
        self._map = HandMap(aim.box, reach, flip)
        self._kinematics, self._settled = kinematics, kinematics.inverse()
        self._clutch, self._gesture, self._filter = Clutch(), Deadman(rule), OneEuro()
        self._stays = stays
        self._sent = sent
        self._show = show
        self._say = say
        self._smooth: OneEuroState | None = None
        self._last_sight = -1
        self._own = OwnHand()  # the hand followed since the press
        self._hand: Hand | None = None  # driving hand in the newest observation
        self._held_by: Hand | None = None  # hand that the filter was last updated with
        # hand or knob, and finger, at the press
        self._start = (np.zeros(2), np.zeros(2))
        self._source, self._led, self._driven = "", np.zeros(2), -np.inf
        self._line = ""
        self._busy = Busy(robot.time, self._note)
        self.account = DriveSummary()

    def run(self, seconds: float | None = None) -> DriveSummary:
        """Drive until `seconds`, the file, the loop or an input ends it; then release tension."""
        begun = before = time.monotonic()
        try:
            while not self.account.ended:
                now = time.monotonic()
                self._count(now - before)
                before = now
                self._busy.round(now)
                self._once(now)
                if seconds is not None and now - begun >= seconds:
                    self.account.ended = f"after {seconds:g} s, as asked"
                self._eyes.wait(self._last_sight, 1.0 / SENT)
        except KeyboardInterrupt:
            self.account.ended = "interrupted"
        finally:
            if self._clutch.stage == "driving":
                self._robot.release()
            self._busy.end()
            self.account.busy_s = self._busy.seconds
        return self.account

    # --- one round ----------------------------------------------------------------------

    def _once(self, now: float) -> None:
        state = self._robot.state
        report = self._robot.report
        sight = self._take()
        who, controls = self._holding(now)
        lacking = self._lacking(now, state, controls, bool(who))
        before = self._clutch
        if controls.source != self._source:  # another input must not take over a motion in progress
            self._clutch = self._clutch.lose(f"the {controls.source} was chosen")
            self._source = controls.source
        self._clutch = self._clutch.step(now, who, lacking)
        self._wishes(state)
        if self._clutch.stage == "driving":
            try:
                if before.stage != "driving":
                    self._press(state, report, controls)
                self._target(controls)
            except ServoError as fault:
                self._clutch = self._clutch.lose(str(fault))
        if before.stage == "driving" and self._clutch.stage != "driving":
            self._robot.release()
        if self._clutch.stage == "lost" and before.stage != "lost":
            self.account.lost[self._clutch.why] += 1
        self._over(report)
        here = self._here(report)
        if self._clutch.stage != "driving":
            for one in self._inputs:
                one.rest(self._knob(here))
        self._tell(report)
        if self._show is not None:
            seen = (
                None if self._smooth is None or self._old(self._smooth.t, now) else self._smooth.x
            )
            age = None if sight is None else now - sight.t
            led = self._led if self._clutch.stage == "driving" else None
            busy = self._busy.line(now)
            self._show(
                DriveState(
                    now, report, self._clutch, controls, sight, seen, here, led, age, lacking, busy
                )
            )

    def _take(self) -> HandObservation | None:
        """Filter the newest observation, once."""
        sight = self._eyes.newest()
        if sight is None or sight.number == self._last_sight:
            return sight
        self._last_sight = sight.number
        self._hand = (
            self._own.among(sight.hands, sight.t) if self._clutch.stage == "driving" else sight.hand
        )
        seen = self._eyes.view.projection(self._hand)
        if seen is not None:
            self._smooth, self._held_by = self._filter.step(self._smooth, sight.t, seen), self._hand
        return sight

    def _holding(self, now: float) -> tuple[str, Controls]:
        """Return the holder of the key, and the input in use: the holder's, or the first one."""
        states = [(one.name, one.controls(now)) for one in self._inputs]
        for name, controls in states:
            if controls.held:
                return name, controls
        return "", states[0][1] if states else Controls()

    def _lacking(self, now: float, state: str, controls: Controls, key: bool) -> str:
        """Return what driving lacks, as text; empty if nothing."""
        sight = self._eyes.newest()
        shown = None if sight is None or self._old(sight.t, now) else sight
        gesture = self._gesture.held(key, None if shown is None else self._hand, now)
        if state not in (DRIVABLE if self._clutch.stage == "driving" else BEGINS):
            return words.sentence(self._robot.report)
        if controls.source == "knob":
            return ""
        if self._eyes.gone:
            return self._eyes.gone
        if shown is None:
            return f"{self._eyes.name}: no picture" + (
                " yet" if sight is None else f" for {now - sight.t:.1f} s"
            )
        if self._smooth is None or self._old(self._smooth.t, now):
            return (
                ANOTHER
                if self._clutch.stage == "driving" and self._own.other
                else "no hand is seen"
            )
        return "" if gesture or not key else f"the hand lets go ({self._gesture.rule})"

    def _old(self, t: float, now: float) -> bool:
        return self._busy.age(t, now) > SEEN

    def _press(self, state: str, report: LoopReport, controls: Controls) -> None:
        """Begin: the current observation corresponds to the current position of the finger."""
        self.account.presses += 1
        self._own.begin(self._held_by, -np.inf if self._smooth is None else self._smooth.t)
        at = np.zeros(2) if state == "ready" else self._here(report)
        self._start = (self._pointed(controls), at)
        if state == "ready":
            self._robot.engage(self._aim.command(at))

    def _pointed(self, controls: Controls) -> Floats:
        if controls.source == "knob":
            return np.array(controls.knob)
        assert self._smooth is not None  # `_lacking` has checked it
        return self._smooth.x

    def _target(self, controls: Controls) -> None:
        """Send the newest target."""
        pointed, (begin, at) = self._pointed(controls), self._start
        low, high = self._aim.box.T
        if controls.source == "knob":
            moved = pointed - begin
            led = at + np.where(moved < 0, -low, high) * moved
        else:
            led = at + self._map.command(pointed, begin)
        self._led = np.clip(led, low, high)
        u = self._aim.command(self._led)
        self._robot.target(u)
        if (
            controls.source == "hand"
            and self._smooth is not None
            and self._smooth.t != self._driven
        ):
            self._driven = self._smooth.t
            if len(self.account.latency) < MOST_KEPT:
                self.account.latency.append(time.monotonic() - self._smooth.t)
            if self._sent is not None:
                self._sent(self._smooth.t, u)

    def _wishes(self, state: str) -> None:
        wishes = [(one.name, wish) for one in self._inputs if (wish := one.asked())]
        for name, wish in wishes:
            if wish == "end":
                self.account.ended = f"ended at {name}"
                continue
            if wish == "acknowledge":
                self._acknowledge(state)
                continue
            self._clutch = self._clutch.lose(f"{wish} at {name}")
            try:
                if wish == "emergency":
                    self._robot.emergency()
                else:
                    self._robot.request("stop")
            except ServoError as fault:
                self._note(str(fault))

    def _acknowledge(self, state: str) -> None:
        try:
            if state == "fault":
                # only the stop pressed here; a stop by a line or heartbeat of the rig stays
                self._robot.emergency(False)
                self._robot.request("acknowledge")
            if self._robot.state == "homed":
                self._robot.request("arm")
        except ServoError as fault:
            self._line = ""
            self._note(str(fault))

    # --- what is shown -------------------------------------------------------------------

    def _here(self, report: LoopReport) -> Floats:
        """Return the position of the finger in the plane.

        It follows from the last goals if they were sent, else from the servo positions.
        """
        ticks: list[int] = []
        for values in (report.get("position"), report.get("goal")):
            known = [one for one in values or [] if one is not None]
            ticks = known if known and len(known) == len(values or []) else ticks
        if not ticks:
            return np.zeros(2)
        u = self._robot.calibration.commands([ticks])[0]
        acting = self._settled.settle(np.clip(u, *self._kinematics.bounds.T))
        return np.clip(self._aim.point(acting), *self._aim.box.T)

    def _knob(self, here: Floats) -> tuple[float, float]:
        low, high = self._aim.box.T
        x, y = np.clip(here / np.where(here < 0, -low, high), -1.0, 1.0)
        return float(x), float(y)

    def _count(self, passed: float) -> None:
        state = self._robot.state
        self.account.states[state] = self.account.states.get(state, 0.0) + passed
        self.account.engaged_s += passed if self._clutch.stage == "driving" else 0.0

    def _over(self, report: LoopReport) -> None:
        why = next((str(value) for key in GONE if (value := report.get(key))), "")
        if why:
            self.account.ended, self.account.failed = why, True
        elif self._eyes.over:
            self.account.ended = f"{self._eyes.name}: has ended"
        elif (
            self._eyes.gone
            and not self._stays
            and self._robot.state not in ("engaged", "hold", "safe_stop")
        ):
            self.account.ended, self.account.failed = self._eyes.gone, True  # tension is released

    def _tell(self, report: LoopReport) -> None:
        text = words.sentence(report)
        if self._clutch.stage == "lost":
            text += f"; {words.lost(report, self._clutch.why)}"
        elif self._clutch.stage == "waiting" and self._clutch.why:
            text += f"; waiting: {self._clutch.why}"
        if text != self._line:
            self._note(text)

    def _note(self, text: str) -> None:
        self._line = text
        if self._say is not None:
            self._say(text)
