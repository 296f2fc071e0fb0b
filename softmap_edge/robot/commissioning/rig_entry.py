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
from softmap_edge.robot.servo.bus import opened, registers
from softmap_edge.robot.servo.examined import members
from softmap_edge.robot.servo.known_state import SET_UP, Asked, ServoState, differing
from softmap_edge.robot.servo.rig import Rig, RigServo


@dataclass(frozen=True)
class Entry:
    """A servo's place in `rig` (None: a new rig): the id listed there, None if appended."""

    rig: Rig | None
    listed: int | None

    @property
    def asked(self) -> Asked | None:
        """The rig's requirements for this servo, except gains, which set-up determines."""
        known = {} if self.rig is None else {one.id: one.asked for one in members(self.rig)}
        found = None if self.listed is None else known.get(self.listed)
        return None if found is None else replace(found, gains=())


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


def entered(entry: Entry, done: ServoState, gains: Sequence[int]) -> Rig:
    """Return the rig with the servo in its place; home and ceiling must be measured again.

    Args:
        entry: its place
        done: the servo after set-up
        gains: its gains, in the order of `known_state.GAINS`
    """
    assert done.model is not None
    name = done.model["name"]
    servo, old = RigServo(done.id, name), entry.rig
    if old is None:
        return Rig(done.port, done.baud, (servo,), made={SET_UP: {f"servo_{done.id}": list(gains)}})
    servos = [
        replace(one, id=done.id, model=name, home=None, current_mA=None)
        if one.id == entry.listed
        else one
        for one in old.servos
    ]
    if entry.listed is None:
        servos.append(servo)
    kept = {
        key: value
        for key, value in old.made.get(SET_UP, {}).items()
        if key != f"servo_{entry.listed}"
    }
    made = {**old.made, SET_UP: {**kept, f"servo_{done.id}": list(gains)}}
    return replace(old, port=done.port, servos=tuple(servos), made=made)


def changes(entry: Entry, found: ServoState, done: ServoState, file: str | Path) -> list[str]:
    """Return a line for each change in the rig `file`."""
    if entry.rig is None:
        return []
    ids = [servo.id for servo in entry.rig.servos]
    said = []
    for one in entry.rig.servos:
        held = (
            {"home": one.home, "measured current": one.current_mA} if one.id == entry.listed else {}
        )
        if names := [name for name, value in held.items() if value is not None]:
            said.append(f"{file} held its {' and '.join(names)}: taken out, to be found again")
    if found.id != done.id and entry.listed == found.id:
        said.append(
            f"{file}: servo {found.id} is servo {done.id} now and keeps its place, command "
            f"{ids.index(found.id) + 1}"
        )
    elif found.id != done.id and found.id in ids:
        said.append(
            f"{file} keeps its servo {found.id}: this one was not set up yet, so that it is "
            "another servo"
        )
    return said


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
    fixed = [
        need for need in differing(found.model, values) if not need.passing and need.least is None
    ]
    return not [need for need in fixed if need.register != "status_return_level"]
