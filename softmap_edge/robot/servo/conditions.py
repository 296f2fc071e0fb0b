"""Servo readings that keep the guard from starting: temperature, voltage, position.

The doctor, `softmap servo read` and denied requests take the value, the limit and the remedy from
here, so that they agree. The limits are those of the guard (`rust/servo/guard/servo.rs`). Pinned by
tests/robot/test_conditions.py.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from softmap_edge.robot.servo.known_state import PER_VOLT, Asked, ServoState, Values, usual
from softmap_edge.robot.servo.loop_types import LoopLimits, LoopReport, ServoLimits

JOG_TRAVEL = 300.0  # largest turn of one jog, ticks
COOL_DOWN = (
    "let it cool with torque off, and find why it got warm: a load, little air, a high current cap"
)
LOOSEN = "find what holds the finger; `softmap servo limits` lists what caps the current"
HELD = f"{LOOSEN}, `softmap servo pull` measures the current that the stroke needs"
POWER = "check the power supply and its cable"


def unfit(found: ServoState, values: Values, asked: Asked | None, homed: bool) -> list[str]:
    """Return a sentence for each reading for which the guard refuses to start.

    Each has the finding and, after "; ", the remedy.

    Args:
        found: the servo
        values: its registers
        asked: the requirements of the rig; None for the usual ones
        homed: whether the servo is homed; otherwise its position is not checked
    """
    if found.model is None:
        return []
    asked = usual(found.model) if asked is None else asked
    lines = [
        too_hot(values["present_temperature"], asked.hot),
        undersupplied(values["present_input_voltage"] / PER_VOLT, asked.voltage),
    ]
    if homed and asked.window is not None:
        lines.append(outside(found.id, values["present_position"], asked.window))
    return [f"it {line}" for line in lines if line]


def too_hot(temperature: float, hot: float | None) -> str:
    """Return what is wrong with a temperature (°C), "" if nothing is."""
    if hot is None or temperature < hot:
        return ""
    return f"is too hot: {temperature:.0f} °C, allowed is below {hot:g} °C; {COOL_DOWN}"


def undersupplied(voltage: float, allowed: tuple[float, float] | None) -> str:
    """Return what is wrong with a supply voltage (V), "" if nothing is."""
    if allowed is None or allowed[0] - 1e-9 <= voltage <= allowed[1] + 1e-9:
        return ""
    return (
        f"has a supply voltage of {voltage:.1f} V, allowed are {allowed[0]:g} to {allowed[1]:g} "
        f"V; {POWER}"
    )


def outside(id: int, position: float, window: tuple[float, float]) -> str:
    """Return what is wrong with the position (ticks) of servo `id`, "" inside its window."""
    low, high = window
    if low <= position <= high:
        return ""
    # a jog may end some ticks short of its goal
    inside = min(max(position, low + JOG_TRAVEL / 10), high - JOG_TRAVEL / 10)
    return (
        f"stands at {position:.0f} ticks, outside its window of {low:.0f} to {high:.0f}; turn it "
        f"back by {jogs(id, (inside if low < inside < high else (low + high) / 2) - position)}"
    )


def jogs(id: int, ticks: float, most: float = JOG_TRAVEL) -> str:
    """Return the command that turns a servo, and how often to run it.

    Args:
        id: id of the servo
        ticks: signed turn
        most: largest turn of one jog, ticks
    """
    times = max(1, math.ceil(abs(ticks) / min(most, JOG_TRAVEL)))
    step = round(ticks / times)
    often = "" if times == 1 else f", {times} times"
    return f"`softmap servo move --servo {id} --by {step or 1:+d} --rig FILE`{often}"


def denied_for(cause: str, report: LoopReport, limits: LoopLimits | None) -> str:
    """Return servo, value, limit and remedy of servos with the `cause`; "" if there is none.

    Args:
        cause: `hot`, `voltage` or `outside`
        report: newest report of the loop
        limits: table of the guard
    """
    servos = [] if limits is None else limits["servos"]
    ids = report.get("ids") or list(range(1, len(servos) + 1))
    lines = [
        f"servo {id} {line}"
        for k, (id, allowed) in enumerate(zip(ids, servos))
        if (line := _reading(cause, report, k, id, allowed))
    ]
    return "; ".join(lines)


def _reading(cause: str, report: LoopReport, k: int, id: int, allowed: ServoLimits) -> str:
    def sensed(values: Sequence[float | None] | None) -> float | None:
        return values[k] if values is not None and k < len(values) else None

    if cause == "hot" and (warmth := sensed(report.get("temperature_C"))) is not None:
        return too_hot(warmth, allowed["hot"])
    if cause == "voltage" and (volts := sensed(report.get("voltage_V"))) is not None:
        return undersupplied(volts, allowed["voltage"])
    if cause == "outside" and (at := sensed(report.get("position"))) is not None:
        return outside(id, at, (allowed["low"], allowed["high"]))
    return ""
