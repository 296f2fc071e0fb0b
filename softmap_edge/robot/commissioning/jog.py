"""Jogs: small slow moves of single servos under little current, homed or not.

They take place in the guard's commissioning state.

    with Jog(rig) as jog:
        jog.by(0, 100, Held())     # as long as it is held: who lets go stops it

Whatever is sent passes the guard: `travel` ticks from where a jog began, `slew`, `current`; it
brakes when no key is held, and torque goes off after the limit `hold`. The limits of the rig
(`[ceiling]` and each `[[servo]]`) bind a jog like a drive, the ticks only once it is homed.
Pinned by tests/robot/test_move.py.
"""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Literal, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import GuardStopped, ServoError
from softmap_edge.model.servo_calibration import Calibration
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.control.emergency_key import PRESSED
from softmap_edge.robot.servo import status_words as words
from softmap_edge.robot.servo.bus import opened
from softmap_edge.robot.servo.conditions import JOG_TRAVEL
from softmap_edge.robot.servo.home_mark import forget, marked
from softmap_edge.robot.servo.limits import of_bench
from softmap_edge.robot.servo.loop_limits import JOG_SLEW, loop_limits, servo_limits, strongest
from softmap_edge.robot.servo.loop_types import LoopLimits, ServoLimits
from softmap_edge.robot.servo.models import servo_model
from softmap_edge.robot.servo.rig import FARTHEST, Rig

Ticks = NDArray[np.float64]

EVERY = 0.02  # s between two orders
AHEAD = 0.4  # s of its slew that a held key aims ahead
ARRIVED = 3.0  # ticks of the goal from where it was sent
SETTLES = 0.4  # s that a servo may be behind its goal
WAITS = 3.0  # s beyond the time that a jog should take


class Deadman(Protocol):
    """What is held while anything moves: a key (`keys.Keys`) that repeats, or `Held`.

    A key counts from its first repetition on.
    """

    how: str  # it is let go, in words

    @property
    def stopped(self) -> bool:
        """Whether somebody asked to stop; it stays so."""

    @property
    def emergency(self) -> bool:
        """Whether somebody stopped by the emergency stop; it stays so."""

    def held(self) -> bool:
        """Whether it is held now."""


class Held:
    """An enable key that the program holds as long as it runs; Ctrl-C releases it."""

    how, stopped, emergency = "Ctrl-C lets go", False, False

    def held(self) -> bool:
        """Always."""
        return True


class Jog:
    """The servos of `rig`, jogged one at a time; from entering to leaving.

    Args:
        travel, slew, current: ticks, ticks/s and mA of a jog, by default the rig's or softmap's;
            the rig's also limit the given values. tell: called with each line for the user on the
            servos and the bus.

    Raises:
        ServoError: the port cannot be opened, the loop cannot start, or a servo is not as the rig
            says.
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
        """The positions (C,) of the servos, ticks, by the last period that read each.

        One lost answer does not count as a position.
        """
        return self.robot.position

    @property
    def goal(self) -> Ticks:
        """Where they are sent (C,), ticks; where they stand without torque."""
        goal = self.robot.report.get("goal") or [None]
        return self.position if None in goal else np.array(goal, float)

    @property
    def current(self) -> Ticks:
        """What they draw (C,), mA; NaN of those that do not measure it."""
        return np.array(
            [np.nan if one is None else one for one in self.robot.report["current_mA"]], float
        )

    def press(self, servo: int, ticks: float) -> Literal["", "window", "travel"]:
        """Aim servo number `servo` (from 0) at `ticks`, the others at their positions.

        This counts as a pressed enable key.

        Torque comes on with the first. Ticks beyond the servo's window or the travel of the jog are
        cut off; returns which of the two it has come to the end of.

        Raises:
            ServoError: there is no such servo, `ticks` is not finite, the guard denies it, or a
                fault ended the jog.
        """
        self._check(servo, ticks)
        state = self.robot.state
        if state not in ("commissioning", "connected"):
            report = self.robot.report
            bench = self.rig.file is not None
            where, onward = (
                words.where(report, self.robot.limits),
                words.onward(report, terminal=True, bench=bench),
            )
            raise GuardStopped.by(
                f"the guard ended the jog: the robot is {where}; {onward}", report.get("cause")
            )
        if state == "connected":
            self.robot.request("commission")
            self._began, self._target = self.goal, None
        began = self.position if self._began is None else self._began
        target = self.goal if self._target is None else self._target.copy()
        # Within the guard's limits, so that the target can be reached.
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
        """Let servo number `servo` turn in a direction, ±1, as long as this is called again.

        This counts as a pressed enable key, as `press` does.
        """
        return self.press(servo, self.goal[servo] + direction * self.slew * AHEAD)

    def keep(self) -> None:
        """Keep everything where it is, with the enable key pressed."""
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
        """Press the robot's emergency stop if `hand` did so.

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

        The servo is still under torque if the key is held.

        Args:
            seen: is shown this jog each time; True ends the move where it is.

        Raises:
            ServoError: there is no such servo, `ticks` is not finite, a fault or the emergency stop
                ended it, or it did not arrive in time.
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
                        f"{self.position[servo] - begin:+.0f} in time; look what holds it"
                    )
            self.robot.time.sleep(EVERY)
        self.robot.time.there(driving=False)
        self.obey(hand)
        return float(self.position[servo] - begin)

    def _check(self, servo: int, ticks: float) -> None:
        """Raise ServoError if a jog names no servo of the rig, or no finite number of ticks."""
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
    """Return how far one jog may go, ticks: the limit of the rig, or `otherwise`."""
    return float((of_bench(rig)("jog_travel") or (otherwise,))[0])


def _limits(rig: Rig, asked: dict[str, float | None]) -> LoopLimits:
    """Return the limits of jogs: what is `asked` for, as far as the rig allows it.

    All other limits are those of the rig.
    """
    robot, servos = of_bench(rig), _servos(rig)
    anywhere = (float(FARTHEST),) * 2  # a goal of a jog may jump: its travel and its slew bound it
    names = [
        name
        for name in loop_limits(servos, jump=anywhere)
        if name not in ("servos", "period", "jump")
    ]
    table = {name: found[0] for name in names if (found := robot(name))}
    for name, value in asked.items():
        if value is not None:
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise ServoError(f"{name} is '{value!s:.20}'; give a number")
            table[name] = min(value, table.get(name, value))
    # All servos keep to the slowest, so that how long a jog takes is known.
    table["jog_slew"] = min(table.get("jog_slew", JOG_SLEW), *(one["slew"] for one in servos))
    return loop_limits(servos, jump=anywhere, **table)


def _allowed(limit: tuple[float, str, str] | None, otherwise: float) -> float:
    """Return the value of a rig's limit (`of_bench`), `otherwise` if the rig has none."""
    return otherwise if limit is None else float(limit[0])


def _servos(rig: Rig) -> list[ServoLimits]:
    """Return the limits of each servo: its ticks about home if homed, else no window."""
    found = []
    with opened(rig.port, rig.baud) as bus:
        for servo in rig.servos:
            bench = of_bench(rig, servo)
            low, high = ((bench(side) or (None,))[0] for side in ("low", "high"))
            limits = servo_limits(servo.model, 0, (-float(FARTHEST), float(FARTHEST)))
            if (
                servo.home is not None
                and (low, high) != (None, None)
                and marked(bus, servo.id, servo.home)
            ):
                low = -FARTHEST - servo.home if low is None else low
                high = FARTHEST - servo.home if high is None else high
                limits = servo_limits(servo.model, servo.home, (low, high))
            limits["slew"] = _allowed(bench("slew"), limits["slew"])
            limits["acceleration"] = _allowed(bench("acceleration"), limits["acceleration"])
            limits["following"] = _allowed(bench("following"), limits["following"])
            limits["warm"] = min(limits["warm"], _allowed(bench("warm"), limits["warm"]))
            limits["hot"] = min(limits["hot"], _allowed(bench("hot"), limits["hot"]))
            own = strongest(servo_model(servo.model))
            limits["current"] = min(own, _allowed(bench("current_mA"), limits["current"]))
            found.append(limits)
    return found
