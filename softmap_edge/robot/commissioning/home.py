"""Home a robot: find each servo's turn with the finger straight, and mark it as homed.

The stored home stays; only its turn is found again. In modes 4 and 5 servos lose their turns
without power, so home again after each power-up; `home_mark.py` detects servos that were not.
Pinned by tests/robot/test_home.py.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import ServoError
from softmap_edge.files.atomic import Document
from softmap_edge.model.servo_calibration import TURN
from softmap_edge.robot.commissioning.jog import most_travel
from softmap_edge.robot.servo.bus import heard, opened
from softmap_edge.robot.servo.conditions import jogs
from softmap_edge.robot.servo.examined import examined, members, refusal
from softmap_edge.robot.servo.home_mark import marked, set_mark
from softmap_edge.robot.servo.rig import FARTHEST, Rig, RigServo

# ticks: largest distance of a straight finger from home: 0.5 mm on a spool of 2.2 mm
NEAR = 150
STEADY = 4  # ticks of encoder noise at rest that are tolerated; the play of an XM is 3
# s for which the finger must be still, and number of readings in that time
WATCHED, LOOKS = 1.0, 20


@dataclass(frozen=True)
class Homed:
    """The result of homing.

    The rig with its homes, the distance (ticks) of each servo from its home, and the turns by which
    each stored home was moved. `first` names servos that had no home.
    """

    rig: Rig
    away: tuple[int, ...]
    turns: tuple[int, ...]
    first: tuple[int, ...]

    def __str__(self) -> str:
        lines = []
        for servo, away, turns in zip(self.rig.servos, self.away, self.turns):
            how = (
                "set now"
                if servo.id in self.first
                else f"{away:+d} ticks from the stored one, {turns:+d} turns"
            )
            lines.append(f"servo {servo.id}: home at {servo.home} ({how})")
        return "\n".join(lines)

    def to_dict(self) -> Document:
        """Return the document softmap.home/1."""
        servos = [
            {
                "id": one.id,
                "home": one.home,
                "away_ticks": away,
                "turns": turns,
                "first": one.id in self.first,
            }
            for one, away, turns in zip(self.rig.servos, self.away, self.turns)
        ]
        return {"schema": "softmap.home/1", "servos": servos, "near_ticks": NEAR}


def relax(rig: Rig) -> list[int]:
    """Switch torque off and check the servos of `rig` and their set-up; return their firmware.

    Raises:
        ServoError: a servo does not answer, is another model, is not set up, or reports an error.
    """
    seen = examined(rig.port, rig.baud, members(rig), release=True)
    if message := refusal(seen):
        raise ServoError(message)
    return [one.found.firmware for one in seen if one.found is not None]


def prove(rig: Rig, confirmed: str, *, new: bool = False) -> Homed:
    """Home: check that the finger is still, find the turn nearest to each stored home, set marks.

    Args:
        rig: rig with relaxed servos (`relax`) and a finger that was found straight
        confirmed: by whom or how that was confirmed
        new: take the current position as home, whatever was stored

    Raises:
        ServoError: the finger moves, or is too far from the stored home; nothing is marked then.
    """
    firmware = relax(rig)
    with opened(rig.port, rig.baud) as bus:
        positions = _watched(bus, rig)
        known = [marked(bus, servo.id, servo.home) for servo in rig.servos]
        homes = []
        away = []
        turns = []
        far = []
        most = most_travel(rig)
        for servo, position, proved in zip(rig.servos, positions, known):
            fresh = new or servo.home is None
            stored = position if fresh or servo.home is None else servo.home
            turned = round((position - stored) / TURN)
            home = stored + turned * TURN
            far.append(_far(servo, position, home, turned if proved else 0, most))
            homes.append(home)
            away.append(position - home)
            turns.append(turned)
        _check_near([one for one in far if one])
        for servo, home in zip(rig.servos, homes):
            set_mark(bus, servo.id, home)
    first = tuple(servo.id for servo in rig.servos if new or servo.home is None)
    record = {
        "when": datetime.now(UTC).isoformat(timespec="seconds"),
        "how": "torque off, the finger straight, the turn nearest to the stored home",
        "confirmed": confirmed,
        "positions": positions,
        "away": away,
        "firmware": firmware,
        "first": list(first),
    }
    servos = tuple(replace(servo, home=home) for servo, home in zip(rig.servos, homes))
    changed = replace(rig, servos=servos, made={**rig.made, "homed": record})
    return Homed(changed, tuple(away), tuple(turns), first)


def _far(
    servo: RigServo, position: int, home: int, turned: int, most: float
) -> tuple[str, str] | None:
    """Return why a servo is not at its home, and commands that turn it back; None if it is.

    Raises:
        ServoError: no home is possible there.
    """
    if abs(home) > FARTHEST:
        raise ServoError(
            f"servo {servo.id}: home at {home} ticks; allowed is ±{FARTHEST}: make this home with "
            "--new"
        )
    if turned != 0:
        stands = (
            f"stands {turned:+d} turns from its home, which is still known: a tendon is wound up"
        )
        return f"servo {servo.id} {stands}", jogs(servo.id, home - turned * TURN - position, most)
    if abs(position - home) > NEAR:
        stands = (
            f"stands at {position}, {position - home:+d} ticks from the stored home within a turn"
        )
        return f"servo {servo.id} {stands}", jogs(servo.id, home - position, most)
    return None


def _check_near(far: Sequence[tuple[str, str]]) -> None:
    """Raise ServoError if servos are not at their homes; the message lists all of them."""
    if not far:
        return
    found, turns = (", ".join(texts) for texts in zip(*far))
    raise ServoError(
        f"{found}, allowed are {NEAR}; straighten the finger: {turns}, or look for a slipped "
        "tendon, then home it again. --new is for another finger or another mounting only: it "
        "makes this shape command 0, and calibrations made before no longer fit"
    )


def _watched(bus: _core.ServoBus, rig: Rig) -> list[int]:
    """Return the positions of servos without torque, ticks, after checking that they do not move.

    Raises:
        ServoError: a servo moves, or has torque.
    """
    table = _core.servo_registers()
    (at, size, _), (enable, _, _) = table["present_position"], table["torque_enable"]

    def positions() -> list[int]:
        ids = [servo.id for servo in rig.servos]
        return [int.from_bytes(heard(bus, id, at, size), "little", signed=True) for id in ids]

    seen = []
    for _ in range(LOOKS):
        seen.append(positions())
        time.sleep(WATCHED / LOOKS)
    looked: NDArray[np.int64] = np.array(seen, np.int64)
    for servo, moved in zip(rig.servos, np.ptp(looked, axis=0)):
        if moved > STEADY:
            raise ServoError(
                f"the finger moves: servo {servo.id} turned by {moved} ticks in {WATCHED:g} s, "
                f"allowed are {STEADY}; let it come to rest and home it again"
            )
        if heard(bus, servo.id, enable, 1) != b"\x00":
            raise ServoError(
                f"servo {servo.id} has torque: another program drives it; stop that first"
            )
    return [int(tick) for tick in np.rint(np.median(looked, axis=0))]
