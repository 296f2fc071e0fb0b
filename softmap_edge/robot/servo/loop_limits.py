"""The limits of a robot's servos: one table in ticks and seconds, enforced by the compiled guard.

docs/reference/safety.md explains each limit. Ticks are absolute; the window is about `home`. Pinned
by tests/robot/test_controller.py and, for the guard's use of it, by the tests of rust/servo/guard.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

from softmap_edge import _core
from softmap_edge.errors import ServoError
from softmap_edge.model.safety import BURST, HOLD, JUMP, RAMP, SLACKEN, STALE, TURNS_A_SECOND
from softmap_edge.robot.servo.conditions import JOG_TRAVEL
from softmap_edge.robot.servo.loop_types import LoopLimits, ServoLimits
from softmap_edge.robot.servo.models import ServoModel, servo_model

RATE = 100.0  # periods per second: one adapter at 1 Mbaud carries this with room to spare
SLEW = 2000.0  # ticks/s; 7 mm of tendon a second on a spool of 2.2 mm
ACCELERATION = 20_000.0  # ticks/s²
# s of servo delay that is allowed: 1.5 times that of the trunk (its recording)
BEHIND = 1.5 * 0.24
NEAR = 400.0  # ticks of following error that are always allowed
CURRENT = 0.35  # of a servo's own limit
FASTER = 1.5  # times the fastest turn of a servo: a faster reading is rejected
BAND = 0.02  # mm that a goal must reverse before its servo turns
JOG_SLEW, JOG_CURRENT = 200.0, 150.0  # ticks/s, mA: limits of a jog
# °C below its own limit at which a servo's current is reduced, and tension is released
COOL = (15.0, 5.0)


def servo_limits(model: str, home: int, window: tuple[float, float]) -> ServoLimits:
    """Return the limits of one servo from its model's data.

    Args:
        model: its name, as in `servo_model`
        home: ticks
        window: ticks about home, LOW < 0 < HIGH

    Raises:
        ServoError: no such model.
    """
    entry = servo_model(model)
    most = strongest(entry)
    return {
        "home": home,
        "low": home + round(window[0]),
        "high": home + round(window[1]),
        "slew": min(SLEW, slowed(entry, CURRENT * most)),
        "acceleration": ACCELERATION,
        "current": CURRENT * most,
        "fastest": FASTER * entry["fastest_ticks_per_s"],
        "following": following(SLEW),
        "warm": entry["temperature_limit_C"] - COOL[0],
        "hot": entry["temperature_limit_C"] - COOL[1],
        "voltage": entry["voltage_V"],
    }


def strongest(entry: ServoModel) -> float:
    """Return the current (mA) at which a servo has its highest allowed torque.

    It is its current limit, or its stall current if it has no limit.
    """
    return float(entry["current_limit_mA"] or entry["stall_current_mA"])


def slowed(entry: ServoModel, current: float) -> float:
    """Return the fastest turn (ticks/s) under a cap of `current` mA: less PWM is less speed."""
    real = float(entry["fastest_ticks_per_s"])
    return (
        real
        if entry["current_limit_mA"] is not None
        else real * min(1.0, current / entry["stall_current_mA"])
    )


def following(slew: float) -> float:
    """Return the allowed following error (ticks) of a goal that moves at up to `slew` (ticks/s).

    A real servo lags by its delay at each speed. A lower limit would drop the torque of a healthy
    finger, which must then be homed again. A blocked servo pulls for some tenths of a second
    longer, within its current cap.
    """
    return min(max(NEAR, BEHIND * slew), float(_core.limit_ranges()["following"][1]))


def loop_limits(servos: Sequence[ServoLimits], rate: float = RATE, **changes: object) -> LoopLimits:
    """Return the checked limits of a robot of `servos` (`servo_limits`), loop at `rate` (1/s).

    Raises:
        ServoError: a limit is out of range, or `changes` names no limit.
    """
    if not 10.0 <= rate <= 2000.0:
        raise ServoError(f"a rate of {rate:g} a second; allowed is 10 to 2000")
    period = 1.0 / rate
    window = max(float(one["high"] - one["low"]) for one in servos) if servos else 1.0
    table: LoopLimits = {
        "servos": [one.copy() for one in servos],
        "period": period,
        "stale": max(STALE, 3 * period),
        "hold": HOLD,
        "slacken": SLACKEN,
        "late": max(0.05, 4 * period),
        "silent": max(0.25, 6 * period),
        "grace": 0.5,
        "ramp": RAMP,
        "jump": (JUMP * window, window),
        "jog_travel": JOG_TRAVEL,
        "jog_slew": JOG_SLEW,
        "jog_current": JOG_CURRENT,
        "band": BAND,
        "turns": TURNS_A_SECOND,
        "burst": BURST,
    }
    unknown = [name for name in changes if name not in table]
    if unknown:
        raise ServoError(f"no limit '{unknown[0]}'; there are {', '.join(table)}")
    table = cast(LoopLimits, table | changes)
    _core.check_limits(table)
    return table
