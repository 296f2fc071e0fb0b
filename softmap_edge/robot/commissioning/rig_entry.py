"""Enter a servo that was set up into its rig; it keeps its place if its id changes.

Servos have no serial number. A servo that was set up before and answers at the rate of the rig is
assumed to be the one listed under its old id. A servo with factory settings is a new one. Pinned by
tests/robot/test_set_up.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from softmap_edge.errors import ServoError
from softmap_edge.robot.commissioning.setup import SetUp
from softmap_edge.robot.servo.bus import opened, registers
from softmap_edge.robot.servo.examined import members
from softmap_edge.robot.servo.known_state import SET_UP, Asked, ServoState, differing
from softmap_edge.robot.servo.rig import Rig, RigServo

AS_DELIVERED = ("operating_mode", "return_delay_time")  # registers that every set-up changes


@dataclass(frozen=True)
class Entry:
    """A servo's place in `rig` (None: a new rig): the id listed there, None if appended."""

    rig: Rig | None
    listed: int | None

    @property
    def asked(self) -> Asked | None:
        """The rig's requirements for this servo; None if it is not listed."""
        known = {} if self.rig is None else {one.id: one.asked for one in members(self.rig)}
        return None if self.listed is None else known.get(self.listed)

    def invalidated(self, done: SetUp) -> str:
        """Return what makes the measured values of the listed servo invalid, "" if they stay."""
        kept = [] if self.rig is None else [s for s in self.rig.servos if s.id == self.listed]
        changed = [name for name in ("id",) if name in done.changed]
        if kept and done.servo.model is not None and kept[0].model != done.servo.model["name"]:
            changed.append("model")
        return " and ".join([*changed, *(name.replace("_", " ") for name in done.moved)])


def entry_of(rig: Rig | None, found: ServoState, new_id: int | None, new_baud: int | None) -> Entry:
    """Return the place in `rig` of a servo that is about to be set up.

    Args:
        rig: the rig; None if there is none yet
        found: the servo as it answers now
        new_id: its new id
        new_baud: its new baud rate

    Raises:
        ServoError: its rate would differ from the rig's, or the rig lists its new id for another
            servo.
    """
    id, baud = (found.id if new_id is None else new_id), new_baud or found.baud
    if rig is None:
        return Entry(None, None)
    if rig.baud != baud:
        raise ServoError(
            f"the rig runs at {rig.baud} baud, servo {found.id} at {baud}; give --new-baud "
            f"{rig.baud}"
        )
    ids = [servo.id for servo in rig.servos]
    if id != found.id and found.id in ids and _known(rig, found):
        if id in ids:
            raise ServoError(
                f"the rig lists servo {found.id}, which this is, and another servo {id}; give an "
                f"id that it does not list, or take servo {id} out of it first"
            )
        return Entry(rig, found.id)
    return Entry(rig, id if id in ids else None)


def entered(entry: Entry, done: SetUp, gains: Sequence[int]) -> Rig:
    """Return the rig with the servo in its place.

    Its home and measured current stay, unless the set-up changed what they were measured with.

    Args:
        entry: its place
        done: the servo after set-up
        gains: its gains, in the order of `known_state.GAINS`
    """
    now = done.servo
    assert now.model is not None
    name = now.model["name"]
    servo, old = RigServo(now.id, name), entry.rig
    if old is None:
        return Rig(now.port, now.baud, (servo,), made={SET_UP: {f"servo_{now.id}": list(gains)}})
    servos = list(old.servos)
    if entry.invalidated(done):
        servos = [
            replace(one, id=now.id, model=name, home=None, current_mA=None)
            if one.id == entry.listed
            else one
            for one in servos
        ]
    if entry.listed is None:
        servos.append(servo)
    kept = {
        key: value
        for key, value in old.made.get(SET_UP, {}).items()
        if key != f"servo_{entry.listed}"
    }
    made = {**old.made, SET_UP: {**kept, f"servo_{now.id}": list(gains)}}
    return replace(old, port=now.port, servos=tuple(servos), made=made)


def changes(entry: Entry, found: ServoState, done: SetUp, file: str | Path) -> list[str]:
    """Return a line for each change in the rig `file`, and for a home that must be confirmed."""
    if entry.rig is None:
        return []
    ids, id = [servo.id for servo in entry.rig.servos], done.servo.id
    sentences = []
    for one in entry.rig.servos:
        if one.id == entry.listed:
            sentences += _measured(one, entry.invalidated(done), done.recounted, file)
    if found.id != id and entry.listed == found.id:
        sentences.append(
            f"{file}: servo {found.id} is servo {id} now and keeps its place, command "
            f"{ids.index(found.id) + 1}"
        )
    elif found.id != id and found.id in ids:
        sentences.append(
            f"{file} keeps its servo {found.id}: this one was not set up yet, so that it is "
            "another servo"
        )
    return sentences


def _measured(servo: RigServo, changed: str, recounted: bool, file: str | Path) -> list[str]:
    """Return a line if measured values of a servo must be measured or confirmed again."""
    held = {
        "home": (servo.home, "`softmap servo home --rig FILE`"),
        "measured current": (servo.current_mA, "`softmap servo pull --rig FILE`"),
    }
    names = [name for name, (value, _) in held.items() if value is not None]
    if changed and names:
        again = " and ".join(held[name][1] for name in names)
        return [
            f"{file} held its {' and '.join(names)}: taken out, because its {changed} changed; "
            f"measure again with {again}"
        ]
    if recounted and servo.home is not None:
        return [
            f"{file} keeps its home; its turns are counted again, so home the robot with "
            "`softmap servo home --rig FILE`"
        ]
    return []


def _known(rig: Rig, found: ServoState) -> bool:
    """Return whether a servo may be the one that `rig` lists under its id.

    It must be set up, and at the baud rate of the rig.
    """
    listed = dict(rig.numbers)[found.id]
    if found.baud != rig.baud or found.model is None or found.number != listed:
        return False
    try:
        with opened(found.port, found.baud) as bus:
            values = registers(bus, found.id)
    except ServoError:
        return False
    # as delivered, a servo differs in these alone; whatever else differs, another program left
    left = {need.register for need in differing(found.model, values)}
    return left.isdisjoint(AS_DELIVERED)
