"""Jogs: small slow moves of single servos under little current, in the guard's commissioning state, home known or not.

    with Jog(rig) as jog:
        jog.by(0, 100, held)     # as long as held() is true: who lets go stops it

Whatever is sent passes the guard: `travel` ticks from where a jog began, `slew`, `current`; torque goes off when nobody
holds. Pinned by tests/test_jog.py.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import ServoError
from softmap_edge.servo.controller import Controller
from softmap_edge.servo.limits import loop_limits, servo_limits
from softmap_edge.servo.rig import FARTHEST, Rig
from softmap_edge.ticks import Calibration

Ticks = NDArray[np.float64]

TRAVEL, SLEW, CURRENT = 300.0, 200.0, 150.0  # ticks, ticks/s, mA: what a jog may do unless more is asked for
EVERY = 0.02  # s between two orders
AHEAD = 0.4  # s of its slew that a held key aims ahead
ARRIVED = 3.0  # ticks of the goal from where it was sent
SETTLES = 0.4  # s that a servo may be behind its goal
WAITS = 3.0  # s beyond the time that a jog should take


class Jog:
    """The servos of `rig`, jogged one at a time; from entering to leaving.

    Raises:
        ServoError: the loop cannot start, or a servo is not as the rig says.
    """

    def __init__(
        self,
        rig: Rig,
        *,
        travel: float = TRAVEL,
        slew: float = SLEW,
        current: float = CURRENT,
        rate: float = 100.0,
        record: str | Path | None = None,
    ) -> None:
        count, anywhere = len(rig.servos), (-float(FARTHEST), float(FARTHEST))
        self.rig, self.slew, self.travel = rig, slew, travel
        limits = loop_limits(
            [servo_limits(servo.model, 0, anywhere) for servo in rig.servos],
            rate,
            jump=anywhere[1:] * 2,
            jog_travel=travel,
            jog_slew=slew,
            jog_current=current,
        )
        none = np.zeros((count, count)), np.zeros(count)
        error = dict.fromkeys(("command", "shape_mm", "matched_shape_mm"), 0.0)
        ticks = Calibration(np.eye(count), none[1], none[1], *none, error, "ticks as they are", 0, 0, None, "ticks")
        self.robot = Controller(rig, ticks, limits, record=record, commissioning=True)
        self._began: Ticks | None = None

    def __enter__(self) -> Self:
        self.robot.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.robot.close()

    @property
    def position(self) -> Ticks:
        """Where the servos stand (C,), ticks."""
        return self._said("position")

    @property
    def goal(self) -> Ticks:
        """Where they are sent (C,), ticks; where they stand without torque."""
        goal = self.robot.report.get("goal") or [None]
        return self.position if None in goal else np.array(goal, float)

    @property
    def current(self) -> Ticks:
        """What they draw (C,), mA; NaN of those that do not measure it."""
        return self._said("current_mA")

    def _said(self, name: str) -> Ticks:
        return np.array([np.nan if one is None else one for one in self.robot.report[name]], float)

    def press(self, servo: int, ticks: float) -> None:
        """Aim servo number `servo` (from 0) at `ticks`, the others at where they are; counts as a pressed deadman.

        Torque comes on with the first. Ticks beyond the travel of the jog are cut off.

        Raises:
            ServoError: the guard denies it, or a fault ended the jog.
        """
        state = self.robot.state
        if state not in ("commissioning", "connected"):
            raise ServoError(f"the guard ended the jog: {state}, because of {self.robot.report.get('cause')}")
        if state == "connected":
            self.robot.request("commission")
            self._began, self._target = self.goal, None
        began = self.position if self._began is None else self._began
        target = self.goal if self._target is None else self._target.copy()
        target[servo] = min(max(ticks, began[servo] - self.travel), began[servo] + self.travel)
        self._target = target
        self.robot.target(target)

    def push(self, servo: int, direction: int) -> None:
        """Let servo number `servo` go on in a direction, ±1, as long as this is called again and again."""
        self.press(servo, self.goal[servo] + direction * self.slew * AHEAD)

    def keep(self) -> None:
        """Keep everything where it is, deadman pressed."""
        if self._target is not None:
            self.robot.target(self._target)

    def stop(self) -> None:
        """Switch torque off at once."""
        self._target = self._began = None
        if self.robot.state == "commissioning":
            self.robot.request("stop")

    def by(
        self, servo: int, ticks: float, held: Callable[[], bool], seen: Callable[[Jog], bool] | None = None
    ) -> float:
        """Turn a servo by `ticks` while `held()`; returns how far it came, still under torque if held.

        Args:
            seen: is shown this jog each time; True ends the move where it is.

        Raises:
            ServoError: a fault ended it, or it did not arrive in time.
        """
        begin, until = float(self.position[servo]), time.monotonic() + abs(ticks) / self.slew + WAITS
        to, arrived = begin + ticks, float("inf")
        while held() and time.monotonic() < arrived + SETTLES:
            self.press(servo, to)
            if seen is not None and seen(self):
                self.press(servo, float(self.goal[servo]))
                break
            if abs(self.goal[servo] - self._aim(servo)) < ARRIVED:
                arrived = min(arrived, time.monotonic())
            elif time.monotonic() > until:
                raise ServoError(
                    f"servo {self.rig.servos[servo].id} was sent {ticks:+.0f} ticks and its goal came "
                    f"{self.goal[servo] - begin:+.0f} in time; the deadman was not held throughout"
                )
            time.sleep(EVERY)
        return float(self.position[servo] - begin)

    def _aim(self, servo: int) -> float:
        return float("nan") if self._target is None else float(self._target[servo])

    _target: Ticks | None = None

    def warnings(self) -> list[Any]:
        """What the loop warned of when it started."""
        return list(self.robot.report.get("warnings") or [])
