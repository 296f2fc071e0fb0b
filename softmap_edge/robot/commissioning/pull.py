"""The pull test: measure the current of each servo at the stroke of the finger, in slow moves.

Each servo goes alone, the others at home, in the guard's commissioning state: from home to one end
of its effective window, to the other end, and home. A standing servo draws less current than a
turning one, so the larger value counts. The ceiling is MARGIN times that, plus IDLE of the stall
current for motor and gears at speed.

The finger would spring back if torque went off between two legs. So each side is a single leg of at
most FARTHEST_LEG ticks. For a slightly longer stroke the current is extrapolated linearly; a much
longer stroke is rejected. Pinned by tests/robot/test_pull.py.
"""

from __future__ import annotations

import time
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import ServoError
from softmap_edge.files.atomic import Document
from softmap_edge.robot.commissioning.jog import EVERY, Deadman, Jog, most_travel
from softmap_edge.robot.servo import status_words as words
from softmap_edge.robot.servo.bus import opened
from softmap_edge.robot.servo.home_mark import check_confirmed
from softmap_edge.robot.servo.limits import IDLE, EffectiveLimits
from softmap_edge.robot.servo.models import servo_model
from softmap_edge.robot.servo.rig import Rig, RigServo

Floats = NDArray[np.float64]

MARGIN = 1.25  # ceiling as a multiple of the current at the stroke
FARTHEST_LEG = _core.limit_ranges()["jog_travel"][1]  # ticks from home, of one move
BEYOND = 1.25  # times the travel that was reached: the current is extrapolated up to there
SHORT = 0.05  # share of a leg by which a servo may miss its goal, but at least LEAST_SHORT
LEAST_SHORT = 25.0  # ticks
LEAST_READ = 5  # readings of the current at an end
PATIENCE = 3.0  # s for further readings, and for a servo to come to rest
STILL = 3.0  # ticks by which a servo at rest may move
STANDS = 0.6  # s at an end over which the current is measured
OUTER = 0.9  # share of a leg from which the current in motion counts
# least rise of the current from home to the stroke, in steps of its sensor, at rest
RISES = 2.0


@dataclass(frozen=True)
class Leg:
    """One side of a pull test.

    The stroke and the travel reached, ticks about home; `mA` there, and `rises` mA above home; and
    the readings on the way (n, 2), ticks about home and mA.
    """

    stroke: float
    reached: float
    mA: float
    rises: float
    read: Floats


@dataclass(frozen=True)
class Pulled:
    """The result for one servo, at `slew` ticks/s: both sides, and the resulting ceiling."""

    servo: RigServo
    slew: float
    legs: tuple[Leg, Leg]
    ceiling_mA: float

    def to_dict(self) -> Document:
        """Return it as a document."""
        legs = [
            {
                "stroke_ticks": leg.stroke,
                "reached_ticks": leg.reached,
                "mA": leg.mA,
                "read": leg.read.tolist(),
            }
            for leg in self.legs
        ]
        return {"id": self.servo.id, "legs": legs, "current_mA": self.ceiling_mA}

    def __str__(self) -> str:
        low, high = self.legs
        return (
            f"servo {self.servo.id}: {_leg_text(low)}, {_leg_text(high)}; its ceiling is "
            f"{self.ceiling_mA:g} mA"
        )

    def provenance(self, when: str) -> str:
        """Return how its ceiling was found, as text."""
        low, high = self.legs
        return (
            f"{when}: {_leg_text(low)}, {_leg_text(high)}, at {self.slew:g} ticks/s; "
            f"times {MARGIN:g}, and {IDLE:g} of stall"
        )


def _leg_text(leg: Leg) -> str:
    how = (
        ""
        if abs(leg.reached) >= abs(leg.stroke) - LEAST_SHORT
        else f" (by a straight line from {leg.reached:+.0f})"
    )
    return f"{leg.mA:.0f} mA at {leg.stroke:+.0f} ticks{how}"


def strokes(found: EffectiveLimits) -> list[tuple[float, float]]:
    """Return the stroke of each servo, (low, high) ticks about home: its effective window."""
    sides = [{limit.name: limit for limit in limits} for limits in found.servos]
    return [(float(one["low"].number), float(one["high"].number)) for one in sides]


def pull(
    found: EffectiveLimits,
    hand: Deadman,
    ids: Sequence[int] = (),
    progress: Callable[[str, float], None] = lambda what, share: None,
    tell: Callable[[str], None] = lambda line: None,
) -> list[Pulled]:
    """Pull each servo of the rig (or of `ids`) to both ends of its window while `hand` holds.

    Args:
        found: effective limits; `[ceiling]` of the rig may bound `jog_slew`, `jog_current` and
            `jog_travel`
        progress: called with the moving part and the completed share of the test
        tell: called with each line for the user on the servos and the bus

    Raises:
        ServoError: a servo reports no current or is not homed, the finger does not reach its
            stroke, the current does not rise, or the user stopped it; there is no result then.
    """
    rig, numbers = (
        found.rig,
        [k for k, one in enumerate(found.rig.servos) if not ids or one.id in ids],
    )
    missing = [id for id in ids if id not in [servo.id for servo in rig.servos]]
    if missing:
        raise ServoError(
            f"the rig has no servo {missing[0]}; it has "
            f"{', '.join(str(one.id) for one in rig.servos)}"
        )
    for k in numbers:
        _check_measures(rig.servos[k])
    ends = strokes(found)
    allowed = most_travel(rig, FARTHEST_LEG)
    for k in numbers:
        _check_reach(rig.servos[k], ends[k], allowed)
    with opened(rig.port, rig.baud) as bus:
        check_confirmed(bus, [(servo.id, servo.home) for servo in rig.servos])
    inside = tuple(
        replace(one, low=round(low), high=round(high)) for one, (low, high) in zip(rig.servos, ends)
    )
    most = min(allowed, max(abs(end) for k in numbers for end in ends[k]) + LEAST_SHORT)
    done: list[Pulled] = []
    for k in numbers:
        name, share = f"servo {rig.servos[k].id}", len(done) / len(numbers)
        with Jog(replace(rig, servos=inside), travel=most, tell=tell) as jog:
            progress(f"{name}, low end", share)
            low = _leg(jog, k, ends[k][0], most, hand)
            progress(f"{name}, high end", share + 0.4 / len(numbers))
            high = _leg(jog, k, ends[k][1], most, hand)
            progress(f"{name}, home", share + 0.8 / len(numbers))
            _go(jog, k, 0.0, hand, [])
            jog.stop()
        done.append(
            Pulled(rig.servos[k], jog.slew, (low, high), _allowed(rig.servos[k], (low, high)))
        )
    return done


def noted(rig: Rig, done: Sequence[Pulled]) -> Rig:
    """Return the rig with the measured ceilings and their provenance."""
    by_id, when = (
        {one.servo.id: one for one in done},
        datetime.now(UTC).isoformat(timespec="seconds"),
    )
    servos = tuple(
        replace(servo, current_mA=by_id[servo.id].ceiling_mA) if servo.id in by_id else servo
        for servo in rig.servos
    )
    provenance = {f"servo_{id}": one.provenance(when) for id, one in by_id.items()}
    return replace(
        rig,
        servos=servos,
        made={**rig.made, "pulled": {**rig.made.get("pulled", {}), **provenance}},
    )


def _check_measures(servo: RigServo) -> None:
    if servo_model(servo.model)["current_unit_mA"] is None:
        raise ServoError(
            f"servo {servo.id}, a {servo.model}, reports no current: its PWM is capped instead "
            "(softmap servo limits), a pull test finds nothing; give --servo ID for those that do"
        )


def _check_reach(servo: RigServo, ends: tuple[float, float], allowed: float) -> None:
    longest = max(abs(end) for end in ends)
    if longest > BEYOND * allowed:
        raise ServoError(
            f"servo {servo.id}: its stroke of {longest:.0f} ticks is beyond {BEYOND:g} times the "
            f"{allowed:.0f} that a move of commissioning may do; narrow low and high of this "
            f"servo in rig.toml, or raise jog_travel in its [ceiling], to {FARTHEST_LEG:.0f} at "
            "most"
        )


def _leg(jog: Jog, k: int, stroke: float, most: float, hand: Deadman) -> Leg:
    """Go to one end, stay there, and return the current."""
    servo, near = jog.rig.servos[k], 1.0 - LEAST_SHORT / most
    target = float(np.sign(stroke)) * min(abs(stroke), near * most)
    read: list[tuple[float, float]] = []
    _go(jog, k, 0.0, hand, [])
    rest = float(np.median([abs(mA) for _, mA in _stand(jog, k, hand)]))
    _go(jog, k, target, hand, read)
    stood = _stand(jog, k, hand)
    reached = float(np.median([away for away, _ in stood]))
    if abs(reached - target) > max(LEAST_SHORT, SHORT * abs(target)):
        raise ServoError(
            f"servo {servo.id} was sent to {target:+.0f} ticks about home and came to "
            f"{reached:+.0f} under {_most_current(jog, k):g} mA: look what holds it, or raise "
            "jog_current in [ceiling], or its current_mA, knowingly"
        )
    way = np.array(read + stood)
    side = way[way[:, 0] * np.sign(stroke) > 0.0]
    outer = side[np.abs(side[:, 0]) >= OUTER * abs(reached), 1]
    end = max(
        float(np.median([abs(mA) for _, mA in stood])),
        float(np.median(np.abs(outer))) if len(outer) else 0.0,
    )
    rises = float(np.median([abs(mA) for _, mA in stood])) - rest
    return Leg(stroke, reached, round(_at(stroke, reached, end, side), 1), rises, np.round(side, 1))


def _most_current(jog: Jog, k: int) -> float:
    limits = jog.robot.limits
    return min(float(limits["jog_current"]), float(limits["servos"][k]["current"]))


def _stand(jog: Jog, k: int, hand: Deadman) -> list[tuple[float, float]]:
    """Wait at most PATIENCE until a servo is still; return the readings of the last STANDS."""
    servo = jog.rig.servos[k]
    stood: list[tuple[float, float]] = []
    times: list[float] = []
    held, last = 0.0, time.monotonic()  # time counts only while the key is held
    while True:
        jog.obey(hand)
        if hand.stopped or jog.robot.state != "commissioning":
            raise ServoError(_ended(jog, servo))
        now = time.monotonic()
        if hand.held():
            held += now - last
            jog.keep()
            new = _now(jog, k)
            stood, times = stood + new, times + [held] * len(new)
        last = now
        lately = stood[min(bisect_right(times, held - STANDS), max(len(stood) - LEAST_READ, 0)) :]
        complete = held >= STANDS and len(lately) >= LEAST_READ
        if complete and (
            np.ptp([away for away, _ in lately]) <= STILL or held >= STANDS + PATIENCE
        ):
            return lately
        if held >= STANDS + PATIENCE:
            raise ServoError(
                f"servo {servo.id} does not report its current; look at the wiring of the bus"
            )
        time.sleep(EVERY)


def _at(stroke: float, reached: float, mA: float, side: Floats) -> float:
    """Return the current at the stroke; extrapolate the outer half of a leg that ended early."""
    outer = side[np.abs(side[:, 0]) >= 0.5 * abs(reached)]
    if abs(stroke) <= abs(reached) or len(outer) < 3:
        return mA
    slope = float(np.polyfit(np.abs(outer[:, 0]), np.abs(outer[:, 1]), 1)[0])
    return mA + max(slope, 0.0) * (abs(stroke) - abs(reached))


def _go(jog: Jog, k: int, away: float, hand: Deadman, read: list[tuple[float, float]]) -> None:
    """Turn a servo to `away` ticks about home, and add its readings on the way."""
    servo = jog.rig.servos[k]

    def seen(_: Jog) -> bool:
        read.extend(_now(jog, k))
        return False

    jog.by(k, float(servo.home or 0) + away - float(jog.position[k]), hand, seen)
    if hand.stopped or jog.robot.state != "commissioning":
        raise ServoError(_ended(jog, servo))


def _now(jog: Jog, k: int) -> list[tuple[float, float]]:
    """Return a servo's ticks about home and its mA; nothing in periods that lack one."""
    now = float(jog.position[k]) - float(jog.rig.servos[k].home or 0), float(jog.current[k])
    return [now] if np.isfinite(now).all() else []


def _ended(jog: Jog, servo: RigServo) -> str:
    return (
        f"the pull of servo {servo.id} was stopped before its end, "
        f"{words.where(jog.robot.report, jog.robot.limits)}; nothing was written"
    )


def _allowed(servo: RigServo, legs: tuple[Leg, Leg]) -> float:
    """Return the ceiling, mA.

    Raises:
        ServoError: on one side the current does not rise towards the stroke.
    """
    entry = servo_model(servo.model)
    for leg in legs:
        if not leg.rises > RISES * (entry["current_unit_mA"] or 0.0):
            raise ServoError(
                f"servo {servo.id} draws {leg.mA:.0f} mA at {leg.stroke:+.0f} ticks, "
                f"{leg.rises:+.1f} against home: it pulls nothing there; look for a torn or slack "
                "tendon, or a stroke that is too short to measure"
            )
    stroke = max(leg.mA for leg in legs)
    return round(MARGIN * stroke + IDLE * float(entry["stall_current_mA"]), 1)
