"""Restart a servo that has shut down: torque off, errors before and after, then homing.

A restart clears hardware errors, but also the counted turns of a servo, its mark of home and all
volatile registers. Pinned by tests/robot/test_reboot.py.
"""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass

from softmap_edge import _core
from softmap_edge.errors import NoAnswer, ServoError
from softmap_edge.files.atomic import Document
from softmap_edge.robot.servo.bus import heard, kept_torque, opened, pinged, registers
from softmap_edge.robot.servo.home_mark import set_mark
from softmap_edge.robot.servo.known_state import (
    ServoState,
    brought_by,
    differs,
    hardware,
    setup_command,
    ways_out,
)
from softmap_edge.robot.servo.presence import why_silent
from softmap_edge.robot.servo.status_words import kept_words

WAITS = 3.0  # s within which a restarted servo answers again
TRIES = 3  # repetitions of the request


@dataclass(frozen=True)
class Restarted:
    """A restarted servo at `port`, and its earlier hardware error bits (register 70)."""

    port: str
    baud: int
    id: int
    reported: int

    def __str__(self) -> str:
        was = hardware(self.reported) if self.reported else "no error"
        return (
            f"servo {self.id} was restarted: it reported {was} before, and no error now; torque "
            "is off and its turns are lost"
        )

    def to_dict(self) -> Document:
        """Return the document softmap.restarted/1."""
        errors = hardware(self.reported)
        return {
            "schema": "softmap.restarted/1",
            "port": self.port,
            "baud": self.baud,
            "id": self.id,
            "reported": errors,
        }


def restart(port: str, baud: int, id: int) -> Restarted:
    """Switch the torque of every servo off and restart servo `id`; home the robot again afterwards.

    A control loop holds the port exclusively, so no servo can restart while it drives.

    Args:
        port: port of the servo
        baud: its baud rate
        id: its id

    Raises:
        ServoError: the port is in use, the servo does not answer, keeps its torque, or still
            reports an error.
    """
    try:
        return _restarted(port, baud, id)
    except NoAnswer as fault:
        if "pings only" in fault.why:
            raise
        raise NoAnswer(f"servo {id}: {why_silent(port, baud, id)}") from None


def _restarted(port: str, baud: int, id: int) -> Restarted:
    with opened(port, baud) as bus:
        reported = _errors(bus, id)
        if left := kept_torque(bus, [id]):
            raise ServoError(f"nothing was restarted: {kept_words(left)}")
        with suppress(ServoError):
            set_mark(bus, id, None)
        _rebooted(bus, id)
        kept_torque(bus, [id])
        now = _errors(bus, id)
        if now:
            raise ServoError(f"servo {id} was restarted and still reports {_still(bus, id, now)}")
    return Restarted(port, baud, id, reported)


def _still(bus: _core.ServoBus, id: int, bits: int) -> str:
    """Return errors that a restart did not clear, and the remedy."""
    found = ServoState(bus.port, bus.baud, id, *(pinged(bus, id) or (0, 0)))
    values = registers(bus, id)
    if causes := [differs(found, one, values[one.register]) for one in brought_by(found, values)]:
        setup = setup_command(bus.port, bus.baud, id)
        return f"{hardware(bits)}: {', '.join(causes)}; run {setup}, which corrects it"
    return (
        f"{hardware(bits)}; {ways_out(bits)}, then run the same command again; if it stays, switch "
        "its supply off and on"
    )


def _errors(bus: _core.ServoBus, id: int) -> int:
    address, size, _ = _core.servo_registers()["hardware_error_status"]
    return int.from_bytes(heard(bus, id, address, size), "little")


def _rebooted(bus: _core.ServoBus, id: int) -> None:
    """Restart a servo, repeating the request, and wait until it answers again.

    Raises:
        ServoError: it does not answer in time.
    """
    for _ in range(TRIES):
        with suppress(NoAnswer):  # the servo may restart before it answers
            bus.reboot(id)
            break
    until = time.monotonic() + WAITS
    while time.monotonic() < until:
        time.sleep(0.1)
        if pinged(bus, id) is not None:
            return
    raise ServoError(f"servo {id} does not answer after its restart; switch its supply off and on")
