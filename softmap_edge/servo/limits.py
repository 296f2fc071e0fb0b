"""What the servos of a robot are allowed: one table, in ticks and seconds, that the compiled guard checks and keeps to.

docs/safety.md says what each limit does. Ticks are absolute; the window lies about `home`. Pinned by
tests/test_controller.py and, for what the guard makes of it, by the tests of rust/servo/guard.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from softmap_edge import _core
from softmap_edge.errors import ServoError
from softmap_edge.servo.models import servo_model

Table = dict[str, Any]

RATE = 100.0  # periods a second: what one adapter at 1 Mbaud carries with room to spare
SLEW = 2000.0  # ticks/s; 7 mm of tendon a second on a spool of 2.2 mm
ACCELERATION = 20_000.0  # ticks/s²
CURRENT = 0.35  # of a servo's own limit
FASTER = 1.5  # than a servo's own fastest turn is no position to believe
BUDGET = (0.02, 4.0, 4.0)  # mm that a goal comes back before its servo turns, turns a second, turns at once
BUDGETS = ((0.0, 100.0), (0.1, 100.0), (1.0, 100.0))  # what those may be
COOL = (15.0, 5.0)  # °C below its own limit at which a servo's current is cut back, and at which it slackens


def servo_limits(model: str, home: int, window: tuple[float, float]) -> Table:
    """Return the limits of one servo by its model's data.

    Args:
        model: its name, as `servo_model` knows it. home: ticks. window: ticks about home, LOW < 0 < HIGH.

    Raises:
        ServoError: no such model.
    """
    entry = servo_model(model)
    most = entry["current_limit_mA"]
    return {
        "home": home,
        "low": home + round(window[0]),
        "high": home + round(window[1]),
        "slew": SLEW,
        "acceleration": ACCELERATION,
        "current": None if most is None else CURRENT * most,
        "fastest": FASTER * entry["fastest_ticks_per_s"],
        "following": 400.0,
        "warm": entry["temperature_limit_C"] - COOL[0],
        "hot": entry["temperature_limit_C"] - COOL[1],
        "voltage": tuple(entry["voltage_V"]),
    }


def loop_limits(servos: Sequence[Table], rate: float = RATE, **changes: Any) -> Table:
    """Return the limits of a robot of `servos` (`servo_limits`) whose loop runs at `rate` (1/s), checked.

    Raises:
        ServoError: a limit is out of range, or `changes` names none.
    """
    if not 10.0 <= rate <= 2000.0:
        raise ServoError(f"a rate of {rate:g} a second; allowed is 10 to 2000")
    period = 1.0 / rate
    window = max(float(one["high"] - one["low"]) for one in servos) if servos else 1.0
    table: Table = {
        "servos": [dict(one) for one in servos],
        "period": period,
        "stale": max(0.25, 3 * period),
        "hold": 2.0,
        "slacken": 5.0,
        "late": max(0.05, 4 * period),
        "silent": max(0.25, 6 * period),
        "grace": 0.5,
        "ramp": 1.0,
        "jump": (0.25 * window, window),
        "jog_travel": 300.0,
        "jog_slew": 200.0,
        "jog_current": 150.0,
        **dict(zip(("band", "turns", "burst"), BUDGET)),
    }
    unknown = [name for name in changes if name not in table]
    if unknown:
        raise ServoError(f"no limit '{unknown[0]}'; there are {', '.join(table)}")
    table |= changes
    _core.check_limits(table)
    budget_of(table)
    return table


def budget_of(table: Mapping[str, Any]) -> tuple[float, float, float]:
    """Return dead band and reversals of a table of limits, if they are what the loop can keep to.

    Raises:
        ServoError: one is missing or out of range.
    """
    names = ("band", "turns", "burst")
    for name, (low, high) in zip(names, BUDGETS):
        if not low <= (value := float(table.get(name, np.nan))) <= high:  # also for what is no number
            raise ServoError(f"{name} is {value:g}; allowed is {low:g} to {high:g}")
    band, turns, burst = (float(table[name]) for name in names)
    return band, turns, burst
