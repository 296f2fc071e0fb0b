"""Examine the servos of a rig one by one.

This covers identity, faults that block a start, and registers that a start rewrites. Homing, the
doctor and each start (`control/loop_process.py`) use this module, so their findings agree. Pinned
by tests/robot/test_known_state.py and tests/robot/test_presence.py.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from softmap_edge import _core
from softmap_edge.errors import NoAnswer, ServoError
from softmap_edge.robot.remedies import parted
from softmap_edge.robot.servo.bus import opened, pinged, registers, write_registers
from softmap_edge.robot.servo.conditions import unfit
from softmap_edge.robot.servo.home_mark import marked
from softmap_edge.robot.servo.known_state import (
    Asked,
    Need,
    ServoState,
    Values,
    complaints,
    gains_of,
    passing,
    usual,
)
from softmap_edge.robot.servo.models import numbered, servo_model
from softmap_edge.robot.servo.presence import muted, shared, shares, why_silent

if TYPE_CHECKING:
    from softmap_edge.robot.servo.loop_types import LoopLimits
    from softmap_edge.robot.servo.rig import Rig


@dataclass(frozen=True)
class Member:
    """An expected servo: its id, its model number and its requirements."""

    id: int
    number: int
    asked: Asked


@dataclass(frozen=True)
class ExaminedServo:
    """The servo that answers in an expected place (None: none), and its faults.

    Each fault is a sentence: the finding and, after "; ", the remedy. `passing` are registers that
    a start rewrites. `unfit` are faults of present readings: they block driving, but not homing.
    """

    id: int
    found: ServoState | None
    wrong: tuple[str, ...]
    passing: tuple[Need, ...] = ()
    values: Values = field(default_factory=dict)
    unfit: tuple[str, ...] = ()


def members(rig: Rig) -> list[Member]:
    """Return the servos of a rig, each with its requirements."""
    from softmap_edge.robot.servo.limits import rig_limits

    found = []
    for servo, (id, number) in zip(rig.servos, rig.numbers):
        of_rig, plain = rig_limits(rig, servo), usual(servo_model(servo.model))
        current = (of_rig("current_mA") or (plain.current_mA,))[0]
        slew = (of_rig("slew") or (plain.slew,))[0]
        hot = min(
            float(one[0])
            for one in (of_rig("hot"), (plain.hot,))
            if one is not None and one[0] is not None
        )
        sides = [(of_rig(side) or (None,))[0] for side in ("low", "high")]
        window = None if servo.home is None else _window(servo.home, *sides)
        asked = Asked(
            float(current),
            float(slew),
            gains_of(rig.made, id),
            hot,
            plain.voltage,
            window,
            servo.home,
        )
        found.append(Member(id, number, asked))
    return found


def members_of(
    servos: Sequence[Sequence[int]], limits: LoopLimits, gains: Sequence[Sequence[int]]
) -> list[Member]:
    """Return the servos (id, model number) of a loop with guard limits `limits`.

    `gains` are those of the rig.
    """
    known = [tuple(one) for one in gains] or [()] * len(servos)
    found = []
    for (id, number), one, own in zip(servos, limits["servos"], known):
        model = numbered(number)
        most = (
            one["current"]
            if model is None or one["current"] is not None
            else usual(model).current_mA
        )
        window = float(one["low"]), float(one["high"])
        low, high = one["voltage"]
        asked = Asked(
            float(most),
            float(one["slew"]),
            own,
            hot=one["hot"],
            voltage=(low, high),
            window=window,
            home=one["home"],
        )
        found.append(Member(id, number, asked))
    return found


def _window(home: int, low: float | None, high: float | None) -> tuple[float, float] | None:
    """Return the window (ticks) of a servo in its rig; None if there is none.

    An open side is infinite.
    """
    if low is None and high is None:
        return None
    return home + (-math.inf if low is None else low), home + (math.inf if high is None else high)


def examined(
    port: str, baud: int, asked: Sequence[Member], *, release: bool = False
) -> list[ExaminedServo]:
    """Read identity and registers of the servos expected at `port`.

    Args:
        port: device of the bus
        baud: rate of the bus
        asked: expected servos
        release: switch the torque of all of them off first

    Raises:
        ServoError: the port cannot be opened, another program uses it, or it fails.
    """
    with opened(port, baud) as bus:
        for _ in range(3 if release else 0):
            bus.release()
        seen = [_one(bus, member) for member in asked]
    listed = [member.id for member in asked]
    return [
        one
        if one.found is not None or one.wrong
        else ExaminedServo(one.id, None, (why_silent(port, baud, one.id, listed),))
        for one in seen
    ]


def refusal(seen: Sequence[ExaminedServo]) -> str:
    """Return one line on the faults that block a start and their remedies; "" if there are none."""
    lines = []
    for one in seen:
        by_remedy: dict[str, list[str]] = {}
        for text in one.wrong:
            found, do = parted(text)
            by_remedy.setdefault(do, []).append(found)
        parts = [", ".join(found) + (f"; {do}" if do else "") for do, found in by_remedy.items()]
        lines += [
            f"servo {one.id}{'' if part.startswith('answers') else ':'} {part}" for part in parts
        ]
    return "; ".join(lines)


def started(port: str, baud: int, asked: Sequence[Member]) -> list[str]:
    """Check the servos before a start, and restore their volatile registers.

    Returns:
        A line for each register that was rewritten.

    Raises:
        ServoError: a servo does not meet its requirements or does not answer; the message names the
            remedy.
    """
    seen = examined(port, baud, asked)
    if message := refusal(seen):
        raise ServoError(message)
    if not any(one.passing for one in seen):
        return []
    with opened(port, baud) as bus:
        return [_written(bus, one, need) for one in seen for need in one.passing]


def _one(bus: _core.ServoBus, member: Member) -> ExaminedServo:
    before = bus.counts()["unasked"]
    if (answer := pinged(bus, member.id)) is None:
        return ExaminedServo(member.id, None, ())
    found = ServoState(bus.port, bus.baud, member.id, *answer)
    if found.number != member.number:
        name = found.model["name"] if found.model else "an unknown model"
        listed = numbered(member.number)
        wrong_model = (
            f"it is {name} ({found.number}), the rig lists "
            f"{listed['name'] if listed else 'another model'} ({member.number}); correct the rig, "
            "or connect the servo that it lists"
        )
        return ExaminedServo(member.id, found, (wrong_model,))
    try:
        values = registers(bus, member.id)
    except NoAnswer as fault:
        return ExaminedServo(member.id, found, (fault.why or muted(bus, member.id),))
    wrong = complaints(found, values, member.asked)
    if bus.counts()["unasked"] > before and shared(bus, member.id):
        wrong.insert(0, shares(bus, member.id))
    homed = member.asked.window is not None and marked(bus, member.id, member.asked.home)
    sensed = tuple(unfit(found, values, member.asked, homed))
    return ExaminedServo(
        member.id, found, tuple(wrong), tuple(passing(found, values, member.asked)), values, sensed
    )


def _written(bus: _core.ServoBus, one: ExaminedServo, need: Need) -> str:
    """Write a volatile register, and return the line that reports it."""
    address, size, _ = _core.servo_registers()[need.register]
    write_registers(
        bus, one.id, address, need.value.to_bytes(size, "little", signed=need.value < 0)
    )
    name = need.register.replace("_", " ")
    return (
        f"servo {one.id}: {name} was {one.values[need.register]}, left by another program: it is "
        f"{need.value} now"
    )
