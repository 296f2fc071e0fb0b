"""Jog: move single servos slowly over short distances at low current, homed or not.

Jogs use the commissioning state of the guard.

    with Jog(rig) as jog:
        jog.by(0, 100, Held())     # as long as the key is held: releasing it stops the jog

All orders pass the guard, which limits `travel` (ticks from the start of the jog), `slew` and
`current`. It brakes when no key is held, and switches torque off after the limit `hold`. The limits
of the rig (`[ceiling]` and each `[[servo]]`) also apply to jogs; those in ticks only once the servo
is homed. Pinned by tests/robot/test_move.py.
"""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Literal, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import GuardStopped, ServoError
from softmap_edge.files.atomic import finite
from softmap_edge.model.servo_calibration import Calibration
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.control.emergency_key import PRESSED
from softmap_edge.robot.servo import status_words as words
from softmap_edge.robot.servo.bus import opened
from softmap_edge.robot.servo.conditions import JOG_TRAVEL, LOOSEN
from softmap_edge.robot.servo.home_mark import forget, marked
from softmap_edge.robot.servo.limits import rig_limits
from softmap_edge.robot.servo.loop_limits import JOG_SLEW, loop_limits, servo_limits, strongest
from softmap_edge.robot.servo.loop_types import LoopLimits, ServoLimits
from softmap_edge.robot.servo.models import servo_model
from softmap_edge.robot.servo.rig import FARTHEST, Rig

Ticks = NDArray[np.float64]

EVERY = 0.02  # s between two orders
AHEAD = 0.4  # s at full slew by which the goal of a held key leads the servo
ARRIVED = 3.0  # ticks: distance at which a goal counts as reached
SETTLES = 0.4  # s that a jog waits at its goal for the servo
WAITS = 3.0  # s beyond the expected duration of a jog


class Deadman(Protocol):
    """The enable key of a move: a key (`keys.Keys`) that repeats, or `Held`.

    A key counts from its first repetition on.
    """

    how: str  # how to release it, as text

    @property
    def stopped(self) -> bool:
        """Whether the user asked to stop; it stays set."""

    @property
    def emergency(self) -> bool:
        """Whether the user stopped by the emergency stop; it stays set."""

    def held(self) -> bool:
        """Whether the key is held now."""


class Held:
    """An enable key that the program holds while it runs; Ctrl-C releases it."""

    how, stopped, emergency = "Ctrl-C lets go", False, False

    def held(self) -> bool:
        """Whether the key is held: always."""
        return True


class Jog:
    """Jog the servos of `rig`, one at a time, from entering to leaving.

    Args:
        travel: ticks of a jog, by default the rig's or softmap's; the rig's limits also bound it
        slew: ticks/s, likewise
        current: mA, likewise
        tell: called with each line for the user on the servos and the bus

    Raises:
        ServoError: the port cannot be opened, the loop cannot start, or a servo does not match the
            rig.
    """

    def __init__(
        self,
        rig: Rig,
        *,
        travel: float | None = None,
        slew: float | None = None,
        current: float | None = None,
        tell: Callable[[str], None] = lambda line: None,
    ) -> None:
        count = len(rig.servos)
        limits = _limits(rig, {"jog_travel": travel, "jog_slew": slew, "jog_current": current})
        self.rig, self.travel, self.slew = rig, limits["jog_travel"], limits["jog_slew"]
        home = np.array([servo["home"] for servo in limits["servos"]], float)
        ticks = Calibration.stated(np.eye(count), home, home, "ticks as they are", unit="ticks")
        self.robot = Controller(rig, ticks, limits, commissioning=True, tell=tell)
        self.robot.at_terminal = True
        self._began: Ticks | None = None
        self._target: Ticks | None = None

    def __enter__(self) -> Self:
        self.robot.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.robot.time.there(driving=False)
        try:
            self.robot.__exit__(kind, fault, trace)
        finally:
            report = self.robot.report
            if report.get("state") == "fault" and report.get("cause") in words.LOSES_HOME:
                forget(self.rig.port, self.rig.baud, [servo.id for servo in self.rig.servos])

    @property
    def position(self) -> Ticks:
        """The positions (C,) of the servos, ticks, from the last period that read each.

        A single lost answer does not change them.
        """
        return self.robot.position

    @property
    def goal(self) -> Ticks:
        """The goals (C,), ticks; without torque, the positions."""
        goal = self.robot.report.get("goal") or [None]
        return self.position if None in goal else np.array(goal, float)

    @property
    def current(self) -> Ticks:
        """The currents (C,), mA; NaN for servos without a current sensor."""
        return np.array(
            [np.nan if one is None else one for one in self.robot.report["current_mA"]], float
        )

    def press(self, servo: int, ticks: float) -> Literal["", "window", "travel"]:
        """Move servo number `servo` (from 0) towards `ticks`; the others hold their positions.

        Each call counts as a pressed enable key. The first one switches torque on. Ticks beyond the
        servo's window or the travel of the jog are limited.

        Returns:
            Which of the two limits has been reached, if one has.

        Raises:
            ServoError: there is no such servo, `ticks` is not finite, the guard denies it, or a
                fault ended the jog.
        """
        self._check(servo, ticks)
        state = self.robot.state
        if state not in ("commissioning", "connected"):
            report = self.robot.report
            has_rig = self.rig.file is not None
            where, onward = (
                words.where(report, self.robot.limits),
                words.onward(report, terminal=True, has_rig=has_rig),
            )
            raise GuardStopped.by(
                f"the guard ended the jog: the robot is {where}; {onward}", report.get("cause")
            )
        if state == "connected":
            self.robot.request("commission")
            self._began, self._target = self.goal, None
        began = self.position if self._began is None else self._began
        target = self.goal if self._target is None else self._target.copy()
        # Within the guard's limits, so that the goal can be reached.
        limits, at = self.robot.limits["servos"][servo], float(began[servo])
        low, high = (
            max(at - self.travel, min(at, limits["low"])),
            min(at + self.travel, max(at, limits["high"])),
        )
        target[servo] = min(max(ticks, low), high)
        self._target = target
        self.robot.target(target)
        if low <= ticks <= high or abs(float(self.goal[servo]) - target[servo]) >= ARRIVED:
            return ""
        return "travel" if abs(target[servo] - at) >= self.travel - ARRIVED else "window"

    def push(self, servo: int, direction: int) -> Literal["", "window", "travel"]:
        """Turn servo number `servo` in a direction, ±1, for as long as this is called again.

        Each call counts as a pressed enable key, as for `press`.
        """
        return self.press(servo, self.goal[servo] + direction * self.slew * AHEAD)

    def keep(self) -> None:
        """Hold all servos, with the enable key pressed."""
        if self._target is not None:
            self.robot.target(self._target)

    def stop(self) -> None:
        """Switch torque off at once."""
        self._target = self._began = None
        if self.robot.state == "commissioning":
            self.robot.request("stop")
            until = self.robot.time.now() + WAITS
            while self.robot.state == "commissioning" and self.robot.time.now() < until:
                self.robot.time.sleep(EVERY)

    def obey(self, hand: Deadman) -> None:
        """Press the robot's emergency stop if `hand` did.

        Raises:
            ServoError: it did; torque is off.
        """
        if hand.emergency:
            self.robot.emergency()
            raise ServoError(PRESSED)

    def by(
        self, servo: int, ticks: float, hand: Deadman, seen: Callable[[Jog], bool] | None = None
    ) -> float:
        """Turn a servo by `ticks` while `hand` holds; return its move.

        The servo keeps its torque while the key is held.

        Args:
            seen: called with this jog in each step; returning True ends the move

        Raises:
            ServoError: there is no such servo, `ticks` is not finite, a fault or the emergency stop
                ended the move, or it did not finish in time.
        """
        self._check(servo, ticks)
        begin, left, settled = float(self.position[servo]), abs(ticks) / self.slew + WAITS, 0.0
        last = self.robot.time.now()
        while not hand.stopped and settled < SETTLES:
            self.robot.time.there()
            now = self.robot.time.now()
            spent, last = now - last, now
            if hand.held():
                left -= spent
                self.press(servo, begin + ticks)
                if seen is not None and seen(self):
                    self.press(servo, float(self.goal[servo]))
                    break
                if abs(self.goal[servo] - self._aim(servo)) < ARRIVED:
                    settled += spent
                elif left < 0:
                    raise ServoError(
                        f"servo {self.rig.servos[servo].id} was sent {ticks:+.0f} ticks and came "
                        f"{self.position[servo] - begin:+.0f} in time; {LOOSEN}"
                    )
            self.robot.time.sleep(EVERY)
        self.robot.time.there(driving=False)
        self.obey(hand)
        return float(self.position[servo] - begin)

    def _check(self, servo: int, ticks: float) -> None:
        """Raise ServoError if a jog names no servo of the rig, or the ticks are not finite."""
        count = len(self.rig.servos)
        if not 0 <= servo < count:
            raise ServoError(f"no servo number {servo}; the rig has {count}, counted from 0")
        if not np.isfinite(ticks):
            raise ServoError(
                f"a jog of {ticks} ticks; give a finite number of at most {FARTHEST:g}"
            )

    def _aim(self, servo: int) -> float:
        return float("nan") if self._target is None else float(self._target[servo])


def most_travel(rig: Rig, otherwise: float = JOG_TRAVEL) -> float:
    """Return the largest travel of a jog, ticks: the limit of the rig, or `otherwise`."""
    return float((rig_limits(rig)("jog_travel") or (otherwise,))[0])


def _limits(rig: Rig, asked: dict[str, float | None]) -> LoopLimits:
    """Return the limits of jogs: those in `asked`, reduced to what the rig allows.

    All other limits are those of the rig.
    """
    robot, servos = rig_limits(rig), _servos(rig)
    anywhere = (float(FARTHEST),) * 2  # the goal of a jog may jump: its travel and slew bound it
    names = [
        name
        for name in loop_limits(servos, jump=anywhere)
        if name not in ("servos", "period", "jump")
    ]
    table = {name: found[0] for name in names if (found := robot(name))}
    for name, value in asked.items():
        if value is not None:
            if not finite(value):
                raise ServoError(f"{name} is '{value!s:.20}'; give a finite number")
            table[name] = min(value, table.get(name, value))
    # All servos use the slowest slew, so that the duration of a jog is known.
    table["jog_slew"] = min(table.get("jog_slew", JOG_SLEW), *(one["slew"] for one in servos))
    return loop_limits(servos, jump=anywhere, **table)


def _allowed(limit: tuple[float, str, str] | None, otherwise: float) -> float:
    """Return the value of a rig's limit (`rig_limits`), or `otherwise` if the rig has none."""
    return otherwise if limit is None else float(limit[0])


def _servos(rig: Rig) -> list[ServoLimits]:
    """Return the limits of each servo, with its window about home only if it is homed."""
    found = []
    with opened(rig.port, rig.baud) as bus:
        for servo in rig.servos:
            of_rig = rig_limits(rig, servo)
            low, high = ((of_rig(side) or (None,))[0] for side in ("low", "high"))
            limits = servo_limits(servo.model, 0, (-float(FARTHEST), float(FARTHEST)))
            if (
                servo.home is not None
                and (low, high) != (None, None)
                and marked(bus, servo.id, servo.home)
            ):
                low = -FARTHEST - servo.home if low is None else low
                high = FARTHEST - servo.home if high is None else high
                limits = servo_limits(servo.model, servo.home, (low, high))
            limits["slew"] = _allowed(of_rig("slew"), limits["slew"])
            limits["acceleration"] = _allowed(of_rig("acceleration"), limits["acceleration"])
            limits["following"] = _allowed(of_rig("following"), limits["following"])
            limits["warm"] = min(limits["warm"], _allowed(of_rig("warm"), limits["warm"]))
            limits["hot"] = min(limits["hot"], _allowed(of_rig("hot"), limits["hot"]))
            own = strongest(servo_model(servo.model))
            limits["current"] = min(own, _allowed(of_rig("current_mA"), limits["current"]))
            found.append(limits)
    return found
