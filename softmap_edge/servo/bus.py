"""A bus of servos, opened, asked and released from Python: while no loop drives, and when one has died.

Pinned by tests/test_servo_verbs.py and tests/test_nobody_watches.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import ParamSpec, TypeVar

from softmap_edge import _core
from softmap_edge.errors import NoAnswer, NoSuchRate, PortLost, ServoError

P = ParamSpec("P")
T = TypeVar("T")

PATTERNS = ("serial/by-id/*", "ttyUSB*", "ttyACM*", "ttyAMA*", "ttyTHS*")
TRIES = 10  # of a question, before a servo is said not to answer
ASKED = 10  # times that a servo is asked whether its torque is off


def ports(root: Path = Path("/dev")) -> list[str]:
    """Return the serial ports of this machine, each once, by their lasting names where they have one."""
    seen: dict[Path, str] = {}
    for pattern in PATTERNS:
        for file in sorted(root.glob(pattern)):
            seen.setdefault(file.resolve(), str(file))
    return list(seen.values())


@contextmanager
def opened(port: str, baud: int) -> Iterator[_core.ServoBus]:
    """Open a bus and close it again."""
    bus = _core.ServoBus(port, baud)
    try:
        yield bus
    finally:
        bus.close()


def patiently(ask: Callable[P, T], *args: P.args, **named: P.kwargs) -> T:
    """Ask again where there is no answer: one glitch is no absence."""
    for _ in range(TRIES - 1):
        with suppress(NoAnswer):
            return ask(*args, **named)
    return ask(*args, **named)


def pinged(bus: _core.ServoBus, id: int) -> tuple[int, int] | None:
    """Return model number and firmware of a servo; None if it does not answer, several times asked."""
    return next((told for _ in range(TRIES) if (told := bus.ping(id)) is not None), None)


def rates() -> list[int]:
    """Return every baud rate that some servo knows, the usual ones first."""
    every = sorted({rate for model in _core.servo_models() for rate in model["baud_rates"]})
    usual = [57_600, 1_000_000]
    return usual + [rate for rate in every if rate not in usual]


def kept_torque(bus: _core.ServoBus, ids: Iterable[int]) -> list[int]:
    """Switch the torque of every servo off; returns those of `ids` that have not confirmed it, several times asked."""
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


def release(port: str, baud: int | None = None, ids: Iterable[int] = ()) -> tuple[list[int], list[int]]:
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
            with opened(port, rate) as bus:
                kept_torque(bus, ())
                found = {id for _ in range(3) for id, _, _ in bus.scan()} | (set(ids) if baud is not None else set())
                left = set(kept_torque(bus, sorted(found)))
                there, kept, missing = there | (found - left), kept | left, missing - found
        except NoSuchRate:
            if baud is not None:
                raise
    return sorted(there), sorted(kept | missing)
