"""A mark in each servo: it was homed at this tick since power-up.

In modes 4 and 5 a servo counts turns and loses them without power, and no register shows that. So
homing writes a mark into memory that power-up and reboot clear and that is otherwise unused: the
first eight indirect addresses (registers 168 to 183, RAM on every X-series servo). They have no
effect while indirect data are not read.

The mark is computed from id and home, so the mark of another servo or of another home is not valid.
Its values are addresses that every model can map (120 to 135, four bits each). A servo that
restores its RAM at power-up (startup configuration, register 60) is rejected, because its mark
would survive. Pinned by tests/robot/test_home.py.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Sequence
from contextlib import suppress

from softmap_edge import _core
from softmap_edge.errors import ServoError
from softmap_edge.robot.servo.bus import heard, opened, write_registers
from softmap_edge.robot.servo.known_state import setup_command

# first register of the mark; lowest address in it; number of registers, four bits each
MARK, MAPPABLE, DIGITS = 168, 120, 8
SIZE = 2 * DIGITS  # bytes
AGAIN = "home the robot with `softmap servo home --rig FILE`"


def mark(id: int, home: int) -> bytes:
    """Return the mark of servo `id` that was homed at `home`."""
    number = zlib.crc32(f"softmap home {id} {home}".encode())
    return b"".join(
        (MAPPABLE + (number >> 4 * k & 15)).to_bytes(2, "little") for k in range(DIGITS)
    )


def set_mark(bus: _core.ServoBus, id: int, home: int | None) -> None:
    """Write the mark of `home` into a servo and read it back; None clears it.

    Raises:
        ServoError: the servo does not answer or does not keep the mark.
    """
    digits = MAPPABLE.to_bytes(2, "little") * DIGITS if home is None else mark(id, home)
    write_registers(bus, id, MARK, digits)
    if heard(bus, id, MARK, SIZE) != digits:
        raise ServoError(
            f"servo {id} does not keep the mark of its home (registers {MARK} on); nothing can "
            "prove it"
        )


def forget(port: str, baud: int, ids: Iterable[int]) -> None:
    """Clear the marks of servos, so that they must be homed again.

    A servo that does not answer keeps its mark.
    """
    with suppress(ServoError), opened(port, baud, shared=True) as bus:  # the port may be gone
        for id in ids:
            with suppress(ServoError):
                set_mark(bus, id, None)


def marked(bus: _core.ServoBus, id: int, home: int | None) -> bool:
    """Return whether servo `id` was homed at `home` since power-up."""
    return home is not None and heard(bus, id, MARK, SIZE) == mark(id, home)


def no_home(ids: Sequence[int]) -> str:
    """Return the message on servos without a home."""
    which = f"servo {ids[0]} has" if len(ids) == 1 else f"servos {', '.join(map(str, ids))} have"
    return f"{which} no home; {AGAIN}"


def check_confirmed(bus: _core.ServoBus, servos: Sequence[tuple[int, int | None]]) -> None:
    """Raise ServoError for servos (id, home) without a home, or not homed since power-up.

    Raises:
        ServoError: there is one, or one does not answer.
    """
    for id, home in servos:
        if home is None:
            raise ServoError(no_home([id]))
        if restores(bus, id):
            raise ServoError(
                f"servo {id} restores its memory at power-up (startup configuration), so that no "
                f"proof of its home can be believed; run {setup_command(bus.port, bus.baud, id)}, "
                f"then {AGAIN}"
            )
        if not marked(bus, id, home):
            raise ServoError(
                f"servo {id}: not homed since power-up (turns are lost without power; a fault, "
                "a set-up that changes it and another home in the rig need homing again too); let "
                f"the finger hang straight and {AGAIN}"
            )


def restores(bus: _core.ServoBus, id: int) -> bool:
    """Return whether a servo restores its RAM at power-up."""
    address, size, _ = _core.servo_registers()["startup_configuration"]
    return any(heard(bus, id, address, size))
