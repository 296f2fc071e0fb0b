"""Open, query and release a bus of servos from Python while no control loop runs on it.

Pinned by tests/robot/test_servo_verbs.py and tests/robot/test_nobody_watches.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import ParamSpec, TypeVar

from softmap_edge import _core
from softmap_edge.errors import NoAnswer, NoSuchRate, PortLost, ServoError
from softmap_edge.robot.servo.known_state import SIGNED, setup_command

P = ParamSpec("P")
T = TypeVar("T")

PATTERNS = ("serial/by-id/*", "ttyUSB*", "ttyACM*", "ttyAMA*", "ttyTHS*")
TRIES = 10  # requests before a servo is reported as not answering
ASKED = 10  # requests for the state of a servo's torque


def ports(root: Path = Path("/dev")) -> list[str]:
    """Return the serial ports of this machine, each once, by persistent names if they have any."""
    seen: dict[Path, str] = {}
    for pattern in PATTERNS:
        for file in sorted(root.glob(pattern)):
            seen.setdefault(file.resolve(), str(file))
    return list(seen.values())


@contextmanager
def opened(port: str, baud: int, *, shared: bool = False) -> Iterator[_core.ServoBus]:
    """Open a bus and close it again.

    Args:
        port: device
        baud: rate
        shared: accept that another program has the device open without a lock, so that torque can
            always be switched off

    Raises:
        ServoError: the port cannot be opened, or another program uses it; the message names that
            program.
    """
    if not shared:
        from softmap_edge.robot.servo.holders import check_alone

        check_alone(port)
    bus = _core.ServoBus(port, baud)
    try:
        yield bus
    finally:
        bus.close()


def patiently(ask: Callable[P, T], *args: P.args, **named: P.kwargs) -> T:
    """Repeat a request without an answer: a single lost answer does not mean a missing servo."""
    for _ in range(TRIES - 1):
        with suppress(NoAnswer):
            return ask(*args, **named)
    return ask(*args, **named)


def pinged(bus: _core.ServoBus, id: int) -> tuple[int, int] | None:
    """Return model number and firmware of a servo; None if repeated pings are not answered."""
    return next((number for _ in range(TRIES) if (number := bus.ping(id)) is not None), None)


def heard(bus: _core.ServoBus, id: int, address: int, size: int) -> bytes:
    """Return `size` bytes of the registers of a servo; repeat the request if no answer comes.

    Raises:
        NoAnswer: the servo does not answer; the message names it and the remedy.
        ServoError: the servo refuses.
    """
    try:
        return patiently(bus.read, id, address, size)
    except NoAnswer:
        raise _diagnosed(bus, id) from None


def write_registers(bus: _core.ServoBus, id: int, address: int, data: bytes) -> None:
    """Write registers of a servo; repeat the request if no answer comes.

    Raises:
        NoAnswer: the servo does not answer; the message names it and the remedy.
        ServoError: the servo refuses; the message names servo and register.
    """
    try:
        patiently(bus.write, id, address, data)
    except NoAnswer:
        raise _diagnosed(bus, id) from None
    except PortLost:
        raise
    except ServoError as fault:
        raise ServoError(f"servo {id}, register {address}: {fault}") from None


def _diagnosed(bus: _core.ServoBus, id: int) -> NoAnswer:
    """Return the error for a servo that does not answer: why, and the remedy."""
    from softmap_edge.robot.servo.presence import muted

    message = muted(bus, id)
    fault = NoAnswer(f"servo {id}{'' if message.startswith('answers') else ':'} {message}")
    fault.why = message
    return fault


def pings_only(port: str, baud: int, id: int) -> str:
    """Return the message on a servo that answers pings and nothing else."""
    return (
        f"answers pings only: its status return level is 0; run {setup_command(port, baud, id)}, "
        "which sets it"
    )


def registers(bus: _core.ServoBus, id: int) -> dict[str, int]:
    """Return the values of all registers in use, by name.

    Raises:
        NoAnswer: the servo does not answer; the message names it.
    """
    memory = heard(bus, id, 0, 64) + heard(bus, id, 64, 83)
    return {
        name: int.from_bytes(
            memory[address : address + size], "little", signed=name in SIGNED and size > 1
        )
        for name, (address, size, _) in _core.servo_registers().items()
    }


def rates() -> list[int]:
    """Return every baud rate that some servo supports, the usual ones first."""
    every = sorted({rate for model in _core.servo_models() for rate in model["baud_rates"]})
    usual = [57_600, 1_000_000]
    return usual + [rate for rate in every if rate not in usual]


def kept_torque(bus: _core.ServoBus, ids: Iterable[int]) -> list[int]:
    """Switch the torque of every servo off; return those of `ids` that did not confirm it.

    Each servo is asked several times.
    """
    address, size, _ = _core.servo_registers()["torque_enable"]
    left = list(ids)
    for _ in range(ASKED):
        bus.release()
        still = []
        for id in left:
            try:
                if any(bus.read(id, address, size)):
                    still.append(id)
            except PortLost:
                raise
            except ServoError:
                still.append(id)
        left = still
        if not left:
            break
    return left


def release(
    port: str, baud: int | None = None, ids: Iterable[int] = ()
) -> tuple[list[int], list[int]]:
    """Switch the torque of every servo at `port` off, at one rate or at all of them.

    Args:
        ids: servos that must be there.

    Returns:
        The ids of those that confirmed it, and of those that did not.

    Raises:
        ServoError: the port cannot be opened.
    """
    there: set[int] = set()
    kept: set[int] = set()
    missing = set(ids)
    for rate in rates() if baud is None else [baud]:
        try:
            with opened(port, rate, shared=True) as bus:
                kept_torque(bus, ())
                found = {id for _ in range(3) for id, _, _ in bus.scan()} | (
                    set(ids) if baud is not None else set()
                )
                left = set(kept_torque(bus, sorted(found)))
                there, kept, missing = there | (found - left), kept | left, missing - found
        except NoSuchRate:
            if baud is not None:
                raise
    return sorted(there), sorted(kept | missing)
