"""Set servos up on a bench: find them, read them, make them ready to be driven.

Sources: the X-series control tables and their known traps: turns are counted in modes 4 and 5 only, a homing offset
makes a watchdog dangerous there on old firmware, a return delay costs bus time. Pinned by tests/test_servo_verbs.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass

from softmap_edge import _core
from softmap_edge.errors import NoAnswer, NoSuchRate, ServoError
from softmap_edge.servo.bus import opened, patiently, pinged, rates
from softmap_edge.servo.models import Entry, numbered
from softmap_edge.servo.proof import set_mark
from softmap_edge.servo.rig import Rig, RigServo

CLEAR = 42  # firmware below which a tripped watchdog lets the motor run on, in mode 4 with a homing offset
OLD = 38  # firmware below which there is no bus watchdog
NO_SHADOW = 255
ALWAYS = 2  # status return level: every question is answered
MODES = {
    0: "current", 1: "velocity", 3: "position", 4: "extended position", 5: "current-based position", 16: "PWM",
}  # fmt: skip
SIGNED = ("homing_offset", "goal_position", "present_position", "present_current", "present_velocity", "present_pwm",
          "goal_current", "goal_pwm")  # fmt: skip


@dataclass(frozen=True)
class Found:
    """A servo that answered: where, and what it is."""

    port: str
    baud: int
    id: int
    number: int
    firmware: int

    @property
    def model(self) -> Entry | None:
        """What is known of its model."""
        return numbered(self.number)

    def __str__(self) -> str:
        name = self.model["name"] if self.model else f"unknown model {self.number}"
        return f"{self.port} at {self.baud} baud: id {self.id}, {name}, firmware {self.firmware}"


def scan(port: str, baud: int | None = None) -> Iterator[Found]:
    """Give every servo that answers at `port`, at one rate or at all of them.

    Raises:
        ServoError: the port cannot be opened; a rate that the adapter lacks is passed over.
    """
    for rate in rates() if baud is None else [baud]:
        try:
            with opened(port, rate) as bus:
                for id, number, firmware in bus.scan():
                    yield Found(port, rate, id, number, firmware)
        except NoSuchRate:
            if baud is not None:
                raise


def registers(bus: _core.ServoBus, id: int) -> dict[str, int]:
    """Return the value of each register that is used, by its name.

    Raises:
        ServoError: the servo does not answer.
    """
    table = _core.servo_registers()
    low, high = bus.read(id, 0, 64), bus.read(id, 64, 83)
    memory = low + high
    return {
        name: int.from_bytes(memory[address : address + size], "little", signed=name in SIGNED and size > 1)
        for name, (address, size, _) in table.items()
    }


def wanted(model: Entry) -> dict[str, int]:
    """Return what a servo's registers must hold to be driven."""
    return {
        "operating_mode": model["operating_mode"],
        "homing_offset": 0,
        "return_delay_time": 0,
        "drive_mode": 0,
        "secondary_id": NO_SHADOW,
        "status_return_level": ALWAYS,
        "startup_configuration": 0,
    }


def complaints(found: Found, values: dict[str, int]) -> list[str]:
    """Return what keeps a servo from being driven, a sentence each."""
    model = found.model
    if model is None:
        return [f"model {found.number} is not known; known are {', '.join(m['name'] for m in _core.servo_models())}"]
    said = []
    for name, value in wanted(model).items():
        if values[name] != value:
            said.append(f"{_is(found, name, values[name])}, needed is {value}; `softmap servo setup`")
    if values["hardware_error_status"]:
        bits = [text for bit, text in _core.HARDWARE_ERRORS if values["hardware_error_status"] & bit]
        said.append(f"it reports {', '.join(bits) or values['hardware_error_status']}; find the cause, then restart it")
    if values["torque_enable"]:
        said.append("its torque is on; `softmap servo off` releases it")
    if found.firmware < OLD:
        said.append(_too_old(found))
    return said


def _is(found: Found, name: str, value: int) -> str:
    """Return in words what a register holds, and why that is dangerous where it is."""
    note = f" ({MODES.get(value, 'unknown')})" if name == "operating_mode" else ""
    if name == "homing_offset" and found.firmware < CLEAR:
        note = f" (with one, firmware {found.firmware} lets the motor run on when its watchdog trips in mode 4)"
    return f"{name.replace('_', ' ')} is {value}{note}"


def _too_old(found: Found) -> str:
    update = f"update it to {_core.FAST_FIRMWARE} with Dynamixel Wizard"
    return f"its firmware {found.firmware} has no bus watchdog; {update}"


def examined(bus: _core.ServoBus, rig: Rig) -> list[tuple[RigServo, Found | None, list[str]]]:
    """Return each servo of a bench with what answers in its place (None: nobody) and what keeps it from being driven.

    Servos are asked only; a sentence of the list says what was found, and behind "; " what to do.

    Raises:
        ServoError: one that answered does not go on to.
    """
    seen: list[tuple[RigServo, Found | None, list[str]]] = []
    for servo, (id, number) in zip(rig.servos, rig.numbers):
        if (told := pinged(bus, id)) is None:
            said = [
                f"no answer at {rig.port}, {rig.baud} baud; check power, wiring and baud rate, `softmap servo scan` "
                "lists who answers"
            ]
            seen.append((servo, None, said))
            continue
        found = Found(rig.port, rig.baud, id, *told)
        if found.number != number:
            name = found.model["name"] if found.model else "an unknown model"
            said = [
                f"it is {name} ({found.number}), the rig says {servo.model} ({number}); mend the rig, or connect the "
                "servo that it names"
            ]
        else:
            said = complaints(found, patiently(registers, bus, id))
        seen.append((servo, found, said))
    return seen


def set_up(
    found: Found,
    new_id: int | None = None,
    new_baud: int | None = None,
    tell: Callable[[str], None] = lambda line: None,
) -> Found:
    """Make one servo ready to be driven and prove it by reading back; returns it as it is then.

    Args:
        tell: is told each thing that was mended, a line each.

    Raises:
        ServoError: its model is unknown, its firmware has no watchdog, the id or rate is not one it can have, or it
            keeps other values.
    """
    model = found.model
    if model is None:
        raise ServoError(str(found) + ": this model is not known and is left as it is")
    if found.firmware < OLD:
        raise ServoError(f"{found}: it is left as it is, {_too_old(found)}")
    id = found.id if new_id is None else new_id
    baud = found.baud if new_baud is None else new_baud
    if not 0 <= id <= 252:
        raise ServoError(f"id {id}; allowed are 0 to 252")
    if baud not in model["baud_rates"]:
        raise ServoError(
            f"{model['name']} has no rate of {baud} baud; it has {', '.join(map(str, model['baud_rates']))}"
        )
    table = _core.servo_registers()

    def write(bus: _core.ServoBus, at: int, name: str, value: int) -> None:
        address, size, _ = table[name]
        bus.write(at, address, value.to_bytes(size, "little", signed=value < 0))

    with opened(found.port, found.baud) as bus:
        if id != found.id and bus.ping(id) is not None:
            raise ServoError(f"id {id} is taken by another servo on this bus; connect one servo at a time")
        before = patiently(registers, bus, found.id)
        if before["torque_enable"]:
            tell("its torque was on: it is off")
        write(bus, found.id, "torque_enable", 0)
        for name, value in wanted(model).items():
            if before[name] != value:
                write(bus, found.id, name, value)
                tell(f"{_is(found, name, before[name])}: it becomes {value}")
        set_mark(bus, found.id, None)  # another mode counts turns anew
        if id != found.id:
            write(bus, found.id, "id", id)
        if baud != found.baud:
            # Its answer may come at the new rate already: what counts is that it is found there.
            with suppress(NoAnswer):
                write(bus, id, "baud_rate", model["baud_rates"].index(baud))
    now = Found(found.port, baud, id, found.number, found.firmware)
    with opened(now.port, baud) as bus:
        if bus.ping(id) is None:
            raise ServoError(f"{now} does not answer after it was set up; scan again")
        left = complaints(now, registers(bus, id))
    if left:
        raise ServoError(f"{now}: {'; '.join(left)}")
    return now
