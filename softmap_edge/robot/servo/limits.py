"""The effective limits, each with its origin: servo data, rig ceiling, safety, calibration.

The ceiling (`rig.toml`) replaces softmap's own defaults. The finger's `safety.toml`, the
calibration's window and the servo's data only tighten it.

Limits of commands become limits of servos by u = A (ticks − home) + b. The result is a box of ticks
with all corners inside the command window, and rates at which no command exceeds its own, however
the servos move together. So each servo first gets what it may do alone; then all are scaled by the
same factor until they may move at once.

A tension becomes a current by the horn's radius and the stall torque of the servo's manual, plus
IDLE of the stall current for motor and gears. This is a bound on the tension, not a measurement (a
pull test is one). For a servo without a current cap, the PWM is capped by the same share, which
also slows it down. Pinned by tests/robot/test_limits.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final, cast

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import LimitError, ServoError
from softmap_edge.files.atomic import Document
from softmap_edge.model.model import Model
from softmap_edge.model.safety import Safety, derived, held_to
from softmap_edge.model.servo_calibration import TURN, Calibration
from softmap_edge.robot.servo.loop_limits import (
    COOL,
    RATE,
    following,
    loop_limits,
    servo_limits,
    slowed,
    strongest,
)
from softmap_edge.robot.servo.loop_types import LoopLimits, ServoLimits
from softmap_edge.robot.servo.models import ServoModel, servo_model
from softmap_edge.robot.servo.rig import Rig, RigServo
from softmap_edge.robot.servo.rig_ceiling import AT_LEAST, RANGES, Value

Floats = NDArray[np.float64]

IDLE = 0.05  # of a servo's stall current: used by motor and gears without a load
# of the window: largest distance, besides full turns, of the rig's home from the calibration's
ASTRAY = 0.03
FINGER = "safety.toml"
CEILING = "rig.toml"
DATA = "the servo's data"
OWN = "softmap"
# None: unit of the commands
UNITS = {name: unit for name, (_, _, unit) in _core.limit_ranges().items()}
_SIMPLE: Final = (
    "stale", "hold", "slacken", "late", "silent", "grace", "ramp", "jog_travel", "jog_slew",
    "jog_current", "band", "turns", "burst",
)  # fmt: skip


@dataclass(frozen=True)
class Limit:
    """One effective limit: its value, its unit, who set it, and how, as text."""

    name: str
    value: Value
    unit: str
    by: str
    why: str = ""

    @property
    def number(self) -> float:
        """The value of a limit that is one number."""
        assert not isinstance(self.value, tuple)
        return self.value

    def to_dict(self) -> Document:
        """Return it as a document."""
        return {
            "name": self.name,
            "value": self.value,
            "unit": self.unit,
            "by": self.by,
            "why": self.why,
        }


@dataclass(frozen=True)
class EffectiveLimits:
    """The effective limits on a rig: of each servo and of the robot.

    Attributes:
        low, high: ticks about home
        calibration: the bundle's on this rig: home is moved by full turns, and its window is that
            of the limits
        safety: limits of the finger
        derived: the bundle had no limits, so they were derived from its model
    """

    rig: Rig
    calibration: Calibration
    safety: Safety
    derived: bool
    rate: float
    servos: tuple[tuple[Limit, ...], ...]
    robot: tuple[Limit, ...]

    def table(self) -> LoopLimits:
        """Return the table that the guard checks and enforces.

        Raises:
            ServoError: a servo has no home, or a limit is out of the guard's range; the message
                says who set it.
        """
        missing = [servo.id for servo in self.rig.servos if servo.home is None]
        if missing:
            from softmap_edge.robot.servo.home_mark import no_home

            raise ServoError(no_home(missing))
        servos: list[ServoLimits] = []
        for servo, limits in zip(self.rig.servos, self.servos):
            assert servo.home is not None
            values = {limit.name: limit.value for limit in limits}
            values |= {name: servo.home + _of(limits, name).number for name in ("low", "high")}
            servos.append(cast(ServoLimits, {"home": servo.home} | values))
        try:
            return loop_limits(
                servos, self.rate, **{limit.name: limit.value for limit in self.robot}
            )
        except LimitError as fault:
            limits = self.robot if fault.servo is None else self.servos[fault.servo]
            by = [f" ({limit.by} says so)" for limit in limits if limit.name == fault.name]
            raise ServoError(f"{fault}{''.join(by)}") from None

    @property
    def _shown(self) -> list[list[Limit]]:
        entries = [servo_model(servo.model) for servo in self.rig.servos]
        return [
            [shown(one, entry) for one in limits] for limits, entry in zip(self.servos, entries)
        ]

    @property
    def _robot_shown(self) -> list[Limit]:
        """The limits of the robot; the current of a jog as each kind of servo applies it."""
        limits = []
        for limit in self.robot:
            kinds = {
                model: servo_model(model)
                for model in sorted({servo.model for servo in self.rig.servos})
            }
            if limit.name == "jog_current":
                limits += list(dict.fromkeys(shown(limit, entry) for entry in kinds.values()))
            else:
                limits.append(limit)
        return limits

    def to_dict(self) -> Document:
        """Return the document softmap.limits/1."""
        return {
            "schema": "softmap.limits/1",
            "rate_per_s": self.rate,
            "command_unit": self.safety.unit,
            "safety": {
                "derived": self.derived,
                "edited": self.safety.edited,
                "assumes": self.safety.assumes,
                "simulated": dict(self.safety.simulated),
            },
            "servos": [
                {
                    "id": servo.id,
                    "model": servo.model,
                    "home": servo.home,
                    "limits": [one.to_dict() for one in limits],
                }
                for servo, limits in zip(self.rig.servos, self._shown)
            ],
            "robot": [one.to_dict() for one in self._robot_shown],
            "emergency": str(self.rig.emergency),
        }

    def __str__(self) -> str:
        lines = []
        for servo, limits in zip(self.rig.servos, self._shown):
            home = "not known" if servo.home is None else f"{servo.home} ticks"
            lines += [f"servo {servo.id}, {servo.model}, home {home}", *map(_line, limits)]
        lines += [f"the robot, {self.rate:g} periods a second", *map(_line, self._robot_shown)]
        what = "derived from the model, the bundle has none" if self.derived else "of the bundle"
        edited = ", edited since the bundle was written" if self.safety.edited else ""
        lines.append(f"safety.toml: {what}{edited}; {self.safety.assumes}")
        lines.append(
            f"emergency stops: {self.rig.emergency}; and any program's Controller.emergency"
        )
        return "\n".join(lines)


def effective_limits(
    rig: Rig, model: Model, calibration: Calibration | None = None, rate: float = RATE
) -> EffectiveLimits:
    """Return the effective limits on the rig `rig`, for the finger of `model`.

    Args:
        calibration: between ticks and commands, by default the model's
        rate: periods of the loop per second

    Raises:
        ServoError: the bundle has no calibration or another number of servos, the effective command
            at home is outside the window, or the rig's home is not the calibration's.
        BundleError: safety.toml allows a tension far beyond those of the simulation.
    """
    found = calibration or calibration_of(model)
    if len(found.b) != len(rig.servos):
        raise ServoError(
            f"the rig has {len(rig.servos)} servos, the calibration {len(found.b)}; they must agree"
        )
    kept = model.safety.within(model.command_range) if model.safety is not None else None
    safety = derived(model) if kept is None else held_to(kept, model)
    if safety is None or len(safety.low) != len(found.b):
        raise ServoError(
            f"the model takes {model.channels} commands, the calibration is of {len(found.b)} "
            "servos"
        )
    box = _box(found, safety)
    here = _at_home(rig, found, box)
    rates = _alike(found.A)
    off = [
        0.0 if servo.home is None else float(here.home[k]) - servo.home
        for k, servo in enumerate(rig.servos)
    ]
    servos = tuple(
        _servo(rig, k, found, safety, box[k], off[k], rates[k]) for k in range(len(rig.servos))
    )
    window = tuple(
        fit(float(_of(one, name).number) - by for one, by in zip(servos, off))
        for name, fit in (("low", max), ("high", min))
    )
    return EffectiveLimits(
        rig,
        replace(here, window=(window[0], window[1])),
        safety,
        kept is None,
        rate,
        servos,
        _robot(rig, safety, rates, servos, rate),
    )


def calibration_of(model: Model) -> Calibration:
    """Return the model's calibration.

    Raises:
        ServoError: it has none.
    """
    if model.calibration is None:
        raise ServoError(
            "the bundle holds no calibration of the servos; make one with `softmap servo "
            "calibrate`, or from a run by `softmap model calibrate`"
        )
    return model.calibration


def _box(calibration: Calibration, safety: Safety) -> Floats:
    """Return ticks about home (servo, 2) whose combinations all stay in the command window."""
    b, window = calibration.b, np.array([safety.low, safety.high]).T
    if np.any(b < window[:, 0]) or np.any(b > window[:, 1]):
        raise ServoError(
            f"at home {np.round(b, 3).tolist()} {safety.unit} act, outside the window "
            f"{window.tolist()} of {FINGER}; calibrate again about a straight finger, or widen "
            "the window as far as the model goes"
        )
    away, back = window - b[:, None], np.linalg.inv(calibration.A)
    sides = np.stack([back * away[:, 0], back * away[:, 1]])  # (2, servo, C)
    alone = np.stack([sides.min(axis=0).sum(axis=1), sides.max(axis=0).sum(axis=1)], axis=1)
    ends = np.stack([calibration.A * alone[:, 0], calibration.A * alone[:, 1]])  # (2, C, servo)
    least, most = ends.min(axis=0).sum(axis=1), ends.max(axis=0).sum(axis=1)
    share = min(
        1.0,
        float(np.min(away[:, 1] / np.maximum(most, 1e-300))),
        float(np.min(away[:, 0] / np.minimum(least, -1e-300))),
    )
    inside = share * alone
    ticks = np.stack([np.ceil(inside[:, 0] - 1e-6), np.floor(inside[:, 1] + 1e-6)], axis=1)
    if np.any(ticks[:, 0] > -1.0) or np.any(ticks[:, 1] < 1.0):
        raise ServoError(
            f"the window of {FINGER} leaves servos {ticks.tolist()} ticks about home, less than "
            "one each way; calibrate again about a straight finger"
        )
    return ticks


def _at_home(rig: Rig, calibration: Calibration, box: Floats) -> Calibration:
    """Return the calibration with its home moved by the full turns between it and the rig's home.

    A servo that lost its turns and was homed again is off by full turns; the remainder must be
    small.
    """
    homes = [
        calibration.home[k] if servo.home is None else servo.home
        for k, servo in enumerate(rig.servos)
    ]
    here = calibration.turned(homes)
    for k, servo in enumerate(rig.servos):
        left, most = abs(homes[k] - here.home[k]), ASTRAY * float(np.ptp(box[k]))
        if left > most:
            raise ServoError(
                f"servo {servo.id}: home of the rig is {servo.home}, the calibration was made "
                f"about {calibration.home[k]:g}: {left:g} ticks apart, whole turns removed, "
                f"allowed are {most:.0f}; home it again where the finger is straight, or "
                "calibrate again"
            )
    return here


def _alike(slope: Floats) -> Floats:
    """Return, per servo, the most ticks per unit of command if all servos move at once."""
    alone = 1.0 / np.maximum(np.abs(slope).max(axis=0), 1e-300)
    return np.asarray(alone / max(1.0, float((np.abs(slope) @ alone).max())))


def _servo(
    rig: Rig,
    k: int,
    calibration: Calibration,
    safety: Safety,
    box: Floats,
    off: float,
    worth: float,
) -> tuple[Limit, ...]:
    """Return the limits of servo `k`.

    Its home in the calibration is `off` ticks from that of the rig.
    """
    servo, unit = rig.servos[k], safety.unit
    entry = servo_model(servo.model)
    start = servo_limits(servo.model, 0, (-1.0, 1.0))
    allowed = rig_limits(rig, servo)
    through = "through the calibration"
    limits = []
    for side, name in enumerate(("low", "high")):
        most = [
            (
                float(box[side]) + off,
                FINGER,
                f"{getattr(safety, name)[k]:g} {unit} {through}, with all servos at once",
            )
        ]
        if calibration.window is not None:
            most.append((float(calibration.window[side]) + off, "the calibration", "its window"))
        if (end := allowed(name)) is not None:
            most.append(end)
        value, by, why = (max if name in AT_LEAST else min)(most, key=lambda one: one[0])
        limits.append(Limit(name, int(np.trunc(value)), UNITS[name], by, why))

    def least(name: str, *others: tuple[float, str, str], of: str | None = None) -> None:
        data = name in ("warm", "hot")
        own = (cast(Mapping[str, float], start)[name], DATA if data else OWN, "")
        set_here = allowed(of or name) or own
        value, by, why = min(
            [set_here, *([own] if data else []), *others], key=lambda one: float(one[0])
        )
        limits.append(Limit(name, value, UNITS[name], by, why))

    own = (strongest(entry), DATA, "its own limit")
    pulled = [] if safety.tension is None else [_current(safety, entry, calibration, k)]
    least("current", own, *pulled, of="current_mA")
    current = limits.pop()
    real = (slowed(entry, current.number), DATA, "its fastest turn")
    if by_pwm(entry):
        real = (real[0], DATA, "its fastest turn, in proportion to its PWM")
    least("slew", real, (safety.slew * worth, FINGER, f"{safety.slew:g} {unit}/s {through}"))
    least(
        "acceleration",
        (safety.acceleration * worth, FINGER, f"{safety.acceleration:g} {unit}/s² {through}"),
    )
    limits.append(current)
    limits.append(
        Limit(
            "fastest",
            start["fastest"],
            "ticks/s",
            DATA,
            "half above its fastest turn is not believed",
        )
    )
    start["following"] = following(_of(limits, "slew").number)
    for name in ("following", "warm", "hot"):
        least(name)
    limits.append(Limit("voltage", start["voltage"], "V", DATA))
    return tuple(limits)


def by_pwm(entry: ServoModel) -> bool:
    """Return whether a servo has no current cap, so that its PWM is capped by the same share."""
    return bool(entry["capped_by"] == "goal_pwm")


def shown(limit: Limit, entry: ServoModel) -> Limit:
    """Return a limit as applied: for a servo without a current cap, the share of its PWM."""
    if limit.name not in ("current", "jog_current") or not by_pwm(entry):
        return limit
    stall = entry["stall_current_mA"]
    share = round(100.0 * min(1.0, limit.number / stall), 1)
    why = f"goal PWM for {limit.number:g} mA of {stall:g} mA at stall" + (
        f": {limit.why}" if limit.why else ""
    )
    return Limit("pwm" if limit.name == "current" else "jog_pwm", share, "%", limit.by, why)


def _current(
    safety: Safety, entry: ServoModel, calibration: Calibration, k: int
) -> tuple[float, str, str]:
    """Return the current (mA) at which servo `k` pulls its tendon with the finger's limit."""
    assert safety.tension is not None
    if safety.unit != "mm":
        return np.inf, FINGER, ""
    radius = float(np.abs(calibration.A[:, k]).max()) * TURN / (2.0 * np.pi)  # mm
    torque, stall = entry["stall_torque_Nm"], entry["stall_current_mA"]
    load, idle = safety.tension * radius * 1e-3 / torque * stall, IDLE * stall
    why = (
        f"{safety.tension:g} N on a horn of {radius:.3g} mm is {load:.0f} mA by its stall torque, "
        f"and {idle:.0f} mA for motor and gears"
    )
    return round(load + idle, 1), FINGER, why


def _robot(
    rig: Rig, safety: Safety, rates: Floats, servos: Iterable[tuple[Limit, ...]], rate: float
) -> tuple[Limit, ...]:
    """Return the limits that hold for all servos together."""
    ends = [(float(_of(one, "low").number), float(_of(one, "high").number)) for one in servos]
    placed = [servo_limits(servo.model, 0, end) for servo, end in zip(rig.servos, ends)]
    usual = loop_limits(placed, rate)
    allowed = rig_limits(rig)
    ceiling = rig.ceiling.get("jump")
    ticks = (float(safety.jump[0] * rates.min()), float(safety.jump[1] * rates.min()))
    jump = [
        (ceiling, CEILING, "its [ceiling]")
        if isinstance(ceiling, tuple)
        else (usual["jump"], OWN, ""),
        (ticks, FINGER, f"{safety.jump[0]:g} and {safety.jump[1]:g} {safety.unit}"),
    ]
    warned = min(jump, key=lambda one: one[0][0])
    refused = min(jump, key=lambda one: one[0][1])
    limits = [
        Limit(
            "jump", (min(warned[0][0], refused[0][1]), refused[0][1]), "ticks", warned[1], warned[2]
        )
    ]
    for name in _SIMPLE:
        found = [allowed(name) or (usual[name], OWN, "")]
        if hasattr(safety, name):
            found.append((getattr(safety, name), FINGER, ""))
        value, by, why = (max if name in AT_LEAST else min)(found, key=lambda one: float(one[0]))
        limits.append(Limit(name, value, UNITS[name] or safety.unit, by, why))
    return tuple(limits)


def rig_limits(
    rig: Rig, servo: RigServo | None = None
) -> Callable[[str], tuple[float, str, str] | None]:
    """Return a look-up of the strictest value that the rig sets: value, who, how.

    It covers what the rig sets for all servos and for this one. A ceiling of `hot` without `warm`
    also lowers `warm`, by the distance in the servo's data.
    """

    def look(name: str) -> tuple[float, str, str] | None:
        own: float | None = getattr(servo, name, None)
        values = [(rig.ceiling.number(name), "its [ceiling]"), (own, "its [[servo]]")]
        there = [(value, CEILING, why) for value, why in values if value is not None]
        hot = rig.ceiling.number("hot")
        if name == "warm" and not there and hot is not None:
            by = COOL[0] - COOL[1]
            there = [
                (max(hot - by, RANGES["warm"][0]), CEILING, f"{by:g} °C below hot of its [ceiling]")
            ]
        return (max if name in AT_LEAST else min)(there, key=lambda one: one[0]) if there else None

    return look


def _of(limits: Iterable[Limit], name: str) -> Limit:
    return next(limit for limit in limits if limit.name == name)


def _line(limit: Limit) -> str:
    value = limit.value
    numbers = " to ".join(f"{v:g}" for v in value) if isinstance(value, tuple) else f"{value:g}"
    why = f": {limit.why}" if limit.why else ""
    return f"  {limit.name:<13} {numbers + ' ' + limit.unit:<24} {limit.by}{why}"
