"""Set up the servos of a rig: find them, read them, and write the registers that driving needs.

The required register values are in one list (`robot/servo/known_state.py`), which each start checks
again. Pinned by tests/robot/test_servo_verbs.py and tests/robot/test_set_up.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

from softmap_edge import _core
from softmap_edge.errors import NoAnswer, NoSuchRate, ServoError
from softmap_edge.robot.servo.bus import (
    heard,
    opened,
    patiently,
    pinged,
    rates,
    registers,
    write_registers,
)
from softmap_edge.robot.servo.home_mark import set_mark
from softmap_edge.robot.servo.known_state import (
    ALWAYS,
    GAINS,
    OLD,
    Asked,
    ServoState,
    Values,
    brought_by,
    complaints,
    differing,
    hardware,
    holds,
    most,
    needs,
    passing,
    restart,
    setup_command,
    too_old,
)
from softmap_edge.robot.servo.models import ServoModel, manual_gains
from softmap_edge.robot.servo.presence import Heard, listened

__all__ = ["Asked", "ServoState", "complaints", "gains", "needs", "registers", "scan", "set_up"]

POSITION = 3  # operating mode
ZERO = ("operating_mode", "drive_mode", "homing_offset")  # registers that set zero and direction
UNANSWERED = 3  # repetitions of a write that may get no answer


@dataclass(frozen=True)
class SetUp:
    """A servo after its set-up.

    Attributes:
        servo: its new state
        changed: the registers that were written, among them `id` and `baud_rate`
        recounted: whether its turns are counted from zero again, so that it must be homed
    """

    servo: ServoState
    changed: frozenset[str] = frozenset()
    recounted: bool = False

    @property
    def moved(self) -> list[str]:
        """The changed registers that set zero or direction: its earlier home is not valid."""
        return [name for name in ZERO if name in self.changed]


def scan(port: str, baud: int | None = None) -> Iterator[ServoState]:
    """Yield every servo that answers at `port`, at one rate or at all of them.

    Raises:
        ServoError: the port cannot be opened; rates that the adapter lacks are skipped.
    """
    for heard_there in scanned(port, baud):
        yield from heard_there.found


def scanned(port: str, baud: int | None = None) -> Iterator[Heard]:
    """Yield the answers at `port` and their faults, rate by rate.

    Raises:
        ServoError: the port cannot be opened; rates that the adapter lacks are skipped.
    """
    for rate in rates() if baud is None else [baud]:
        try:
            yield listened(port, rate)
        except NoSuchRate:
            if baud is not None:
                raise


def gains(found: ServoState) -> list[int]:
    """Return the current gains of a servo in the order of GAINS."""
    with opened(found.port, found.baud) as bus:
        values = registers(bus, found.id)
    return [values[name] for name in GAINS]


def set_up(
    found: ServoState,
    new_id: int | None = None,
    new_baud: int | None = None,
    tell: Callable[[str], None] = lambda line: None,
    asked: Asked | None = None,
) -> SetUp:
    """Set up one servo, verify it by reading back, and return its new state.

    A servo that needs no change keeps its turns and its home.

    Args:
        found: the servo
        new_id: its new id, if it changes
        new_baud: its new rate, if it changes
        tell: called with a line for each correction
        asked: requirements of the rig; without a rig the servo's limits become the factory settings

    Raises:
        ServoError: its model is unknown, its firmware has no watchdog, the id or rate is not
            possible, another servo would receive the same writes, it reports a hardware error, or
            it does not keep the values.
    """
    model = found.model
    if model is None:
        raise ServoError(str(found) + ": this model is not known and is left as it is")
    if found.firmware < OLD:
        raise ServoError(f"{found}: it is left as it is, {too_old(found)}")
    id = found.id if new_id is None else new_id
    baud = found.baud if new_baud is None else new_baud
    if not 0 <= id <= 252:
        raise ServoError(f"id {id}; allowed are 0 to 252")
    if baud not in model["baud_rates"]:
        raise ServoError(
            f"{model['name']} has no rate of {baud} baud; it has "
            f"{', '.join(map(str, model['baud_rates']))}"
        )
    asked = most(model) if asked is None else asked  # without a rig the factory limits apply
    with opened(found.port, found.baud) as bus:
        if id != found.id:
            _check_free(bus, found, id)
        _answering(bus, found.id, tell)
        before = registers(bus, found.id)
        _check_sound(bus, found, before, asked)
        known = asked.gains or manual_gains(model)
        asked = replace(asked, gains=())  # the servo sets them
        changed = {need.register for need in differing(model, before, asked)}
        changed |= {"id"} if id != found.id else set()
        # a servo sets its gains when its mode is chosen, and counts its turns from zero again
        gained = tuple(before[name] for name in GAINS) != known
        recounted = gained or not changed.isdisjoint((*ZERO, "id"))
        if recounted:
            set_mark(bus, found.id, None)
        _made_ready(bus, found, model, before, tell, asked, choose=recounted)
        if id != found.id:
            _write(bus, found.id, "id", id)
        if baud != found.baud:
            # The answer may already come at the new rate; finding the servo there is sufficient.
            with suppress(NoAnswer):
                address, size, _ = _core.servo_registers()["baud_rate"]
                code = model["baud_rates"].index(baud)
                patiently(bus.write, id, address, code.to_bytes(size, "little"))
    changed |= {"baud_rate"} if baud != found.baud else set()
    done = _proved(ServoState(found.port, baud, id, found.number, found.firmware), asked)
    return SetUp(done, frozenset(changed), recounted)


def _proved(now: ServoState, asked: Asked | None) -> ServoState:
    """Return the servo if its registers hold the required values; raise ServoError otherwise."""
    with opened(now.port, now.baud) as bus:
        if pinged(bus, now.id) is None:
            raise ServoError(f"{now} does not answer after it was set up; scan again")
        values = registers(bus, now.id)
    left = complaints(now, values, asked) + [need.register for need in passing(now, values, asked)]
    if left:
        raise ServoError(f"{now}: {'; '.join(left)}")
    return now


def _check_free(bus: _core.ServoBus, found: ServoState, id: int) -> None:
    """Check that no other servo has the new id or would receive it as well.

    Raises:
        ServoError: another servo has it, or would receive it.
    """
    if pinged(bus, id) is not None:
        raise ServoError(
            f"id {id} is taken by another servo on this bus; connect one servo at a time"
        )
    address, size, _ = _core.servo_registers()["secondary_id"]
    for other in {one for one, _, _ in bus.scan()} - {found.id}:
        if heard(bus, other, address, size) == bytes([found.id]):
            raise ServoError(
                f"servo {other} obeys id {found.id} too (its secondary id), so that it would get "
                f"id {id} as well; run {setup_command(found.port, found.baud, other)} first"
            )


def _answering(bus: _core.ServoBus, id: int, tell: Callable[[str], None]) -> None:
    """Set the status return level to answer every request; this write may get no answer itself."""
    address, size, _ = _core.servo_registers()["status_return_level"]
    try:
        level = int.from_bytes(patiently(bus.read, id, address, size), "little")
    except NoAnswer:
        if pinged(bus, id) is None:
            raise NoAnswer(
                f"servo {id}: no answer; check power and wiring, then run the same command again"
            ) from None
        level = None
    if level == ALWAYS:
        return
    for _ in range(UNANSWERED):
        with suppress(NoAnswer):
            bus.write(id, address, bytes([ALWAYS]))
            break
    was = (
        "it answered pings only (status return level 0)"
        if level is None
        else f"status return level is {level}"
    )
    tell(f"{was}: it becomes {ALWAYS}")


def _check_sound(bus: _core.ServoBus, found: ServoState, before: Values, asked: Asked) -> None:
    """Check that a servo reports no hardware error; a restart clears it, and would end a set-up.

    Its own limits are corrected if they may be the cause: no restart would help against them.

    Raises:
        ServoError: it reports an error; the message names the error and the way out.
    """
    bits = before["hardware_error_status"]
    if not bits:
        return
    lines = []
    for need in brought_by(found, before, asked):
        _write(bus, found.id, "torque_enable", 0)
        _write(bus, found.id, need.register, need.value)
        lines.append(
            f"{holds(found, need.register, before[need.register])}: it becomes {need.value}"
        )
    corrected = f" ({', '.join(lines)})" if lines else ""
    raise ServoError(
        f"servo {found.id} reports {hardware(bits)}{corrected}, so that it is not set up; "
        f"{restart(found, bits)}, then run the same command again"
    )


def _made_ready(
    bus: _core.ServoBus,
    found: ServoState,
    model: ServoModel,
    before: Values,
    tell: Callable[[str], None],
    asked: Asked,
    *,
    choose: bool,
) -> None:
    """Write registers that differ from those `before`, with torque off.

    With `choose`, the operating mode is chosen again, so that the servo sets its gains.
    """
    if before["torque_enable"]:
        tell("its torque was on: it is off")
    _write(bus, found.id, "torque_enable", 0)
    mode = model["operating_mode"]
    for need in differing(model, before, asked):
        if need.passing:
            continue
        if need.register != "operating_mode":
            _write(bus, found.id, need.register, need.value)
        tell(f"{holds(found, need.register, before[need.register])}: it becomes {need.value}")
    other = POSITION if before["operating_mode"] == mode else before["operating_mode"]
    for one in (other, mode) if choose else ():
        _write(bus, found.id, "operating_mode", one)
    for need in passing(found, registers(bus, found.id), asked):
        _write(bus, found.id, need.register, need.value)
    after = registers(bus, found.id)
    for name in dict.fromkeys(
        [*GAINS, *(need.register for need in needs(model, asked) if need.passing)]
    ):
        if after[name] != before[name]:
            tell(f"{holds(found, name, before[name])}: it becomes {after[name]}")


def _write(bus: _core.ServoBus, id: int, name: str, value: int) -> None:
    address, size, _ = _core.servo_registers()[name]
    write_registers(bus, id, address, value.to_bytes(size, "little", signed=value < 0))
