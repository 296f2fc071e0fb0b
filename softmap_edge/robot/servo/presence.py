"""Find the servos on a bus, and why one does not answer: baud rate, id, shared id, pings only.

Nothing is written to the bus. Pinned by tests/robot/test_presence.py.
"""

from __future__ import annotations

import shlex
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass

from softmap_edge import _core
from softmap_edge.errors import NoAnswer, NoSuchRate
from softmap_edge.robot.servo.bus import opened, patiently, pinged, pings_only, rates
from softmap_edge.robot.servo.known_state import ServoState, hardware, restart, setup_command

LOOKS = 3  # times that the finding must repeat: one glitch is no second servo
PINGS = 2  # pings at each other rate
SETTLES = 0.01  # s after which a second servo has answered too
ALONE = "connect one servo at a time and give each an id of its own"


@dataclass(frozen=True)
class Heard:
    """The servos that answer at a port at one rate, and a sentence for each fault of an answer.

    Also the ids that answer pings only, and a sentence for each servo with a hardware error.
    """

    found: tuple[ServoState, ...]
    remarks: tuple[str, ...]
    mute: tuple[int, ...] = ()
    errors: tuple[str, ...] = ()


def listened(port: str, baud: int) -> Heard:
    """Return the servos that answer at `port`, and the faults of their answers.

    Raises:
        ServoError: the port cannot be opened, or another program has it.
    """
    with opened(port, baud) as bus:
        found, unreadable = _scanned(bus)
        ids = [one.id for one in found]
        shared = sorted({id for id in ids if ids.count(id) > 1})
        remarks = [shares(bus, id) for id in shared]
        if unreadable and not shared:
            remarks.append(
                f"something answers at {baud} baud and cannot be read: {_unreadable(bus)}"
            )
        mute = tuple(id for id in ids if id not in shared and _silent_reads(bus, id))
        remarks += [f"servo {id} {pings_only(port, baud, id)}" for id in mute]
        readable = [one for one in found if one.id not in (*shared, *mute)]
        errors = tuple(filter(None, (_reported(bus, one) for one in readable)))
    return Heard(tuple(found), tuple(remarks), mute, errors)


def _reported(bus: _core.ServoBus, servo: ServoState) -> str:
    """Return the hardware errors of a servo and the remedy, "" if it reports none."""
    address, size, _ = _core.servo_registers()["hardware_error_status"]
    try:
        bits = int.from_bytes(patiently(bus.read, servo.id, address, size), "little")
    except NoAnswer:
        return f"servo {servo.id}: {muted(bus, servo.id)}"
    return f"servo {servo.id} reports {hardware(bits)}; {restart(servo, bits)}" if bits else ""


def why_silent(port: str, baud: int, id: int, listed: Collection[int] = ()) -> str:
    """Return why servo `id` does not answer at `port`: the finding and, after "; ", the remedy.

    Args:
        port: device of the bus
        baud: rate of the expected servo
        id: id of the expected servo
        listed: ids in the rig

    Raises:
        ServoError: the port cannot be opened, or another program uses it.
    """
    for rate in rates():
        if rate != baud and _answers_at(port, rate, id):
            run = setup_command(port, rate, id, f" --new-baud {baud}")
            return f"it answers at {rate} baud, not at {baud}; run {run}, or mend baud in the rig"
    heard = listened(port, baud)
    if any(one.id == id for one in heard.found):
        return (
            "it answered late: it had just started, or the bus is disturbed; run the same command "
            "again"
        )
    if heard.remarks and not heard.found:
        return heard.remarks[0]
    with opened(port, baud) as bus:
        if dirty(bus, lambda: bus.ping(id)):
            return f"something answers and cannot be read: {_unreadable(bus)}"
    strangers = [one.id for one in heard.found if one.id not in listed]
    other = ", ".join(map(str, strangers))
    if strangers and not listed:
        return f"no answer at {port}, {baud} baud, but id {other} answers; check which id it has"
    if strangers:
        run = setup_command(port, baud, strangers[0], f" --new-id {id} --rig FILE")
        return (
            f"no answer, but id {other} answers, which the rig does not list; if it got another "
            f"id, run {run}"
        )
    scan = f"`softmap servo scan --port {shlex.quote(port)}`"
    return f"no answer at {port}, {baud} baud; check power and wiring, {scan} lists who answers"


def muted(bus: _core.ServoBus, id: int) -> str:
    """Return why a servo on an open bus did not answer a read of its registers."""
    if shared(bus, id):
        return shares(bus, id)
    if _silent_reads(bus, id):
        return pings_only(bus.port, bus.baud, id)
    if pinged(bus, id) is not None:
        return (
            "its long answers are lost: the bus is disturbed, or two servos share its id; look at "
            "cables and ids"
        )
    return "no answer; check power and wiring, then run the same command again"


def shares(bus: _core.ServoBus, id: int) -> str:
    """Return the message on an id that two servos share."""
    run = setup_command(bus.port, bus.baud, id, " --new-id N")
    return f"two servos share id {id}: it is answered twice; {ALONE} ({run})"


def shared(bus: _core.ServoBus, id: int) -> bool:
    """Return whether a second servo repeatedly answers under the same id."""
    for _ in range(LOOKS):
        before = bus.counts()["unasked"]
        if bus.ping(id) is None:
            return False
        time.sleep(SETTLES)
        bus.ping(id)
        if bus.counts()["unasked"] == before:
            return False
    return True


def dirty(bus: _core.ServoBus, ask: Callable[[], object]) -> bool:
    """Return whether bytes that are not packets arrive each time `ask` is called."""
    return all(_skips(bus, ask) for _ in range(LOOKS))


def _skips(bus: _core.ServoBus, ask: Callable[[], object]) -> bool:
    before = _unread(bus)
    ask()
    time.sleep(SETTLES)
    bus.ping(0)  # waiting bytes are counted before the next request
    return _unread(bus) > before


def _unread(bus: _core.ServoBus) -> int:
    counts = bus.counts()
    return counts["damaged"] + counts["skipped"]


def _scanned(bus: _core.ServoBus) -> tuple[list[ServoState], bool]:
    """Return the servos that answer, and whether unreadable bytes came each time."""
    before, most = _unread(bus), bus.scan()
    unreadable = _unread(bus) > before
    for _ in range(LOOKS - 1):
        if not unreadable:
            break
        before, again = _unread(bus), bus.scan()
        unreadable = _unread(bus) > before
        most = max(most, again, key=len)
    return [ServoState(bus.port, bus.baud, *one) for one in most], unreadable


def _unreadable(bus: _core.ServoBus) -> str:
    run = setup_command(bus.port, bus.baud, 1, " --new-id N")
    return f"two servos share an id, or talk at another rate; {ALONE} ({run})"


def _silent_reads(bus: _core.ServoBus, id: int) -> bool:
    """Return whether a servo answers pings but no register read."""
    address, size, _ = _core.servo_registers()["id"]
    try:
        patiently(bus.read, id, address, size)
    except NoAnswer:
        return any(bus.ping(id) is not None for _ in range(LOOKS))
    return False


def _answers_at(port: str, rate: int, id: int) -> bool:
    try:
        with opened(port, rate) as bus:
            return any(bus.ping(id) is not None for _ in range(PINGS))
    except NoSuchRate:
        return False
