"""`softmap servo reboot`: restart a servo that has shut itself down. Registered in servo.py."""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass

from softmap_edge.commands.output import next_command
from softmap_edge.errors import ServoError
from softmap_edge.robot.commissioning.reboot import restart
from softmap_edge.robot.commissioning.setup import scan
from softmap_edge.robot.servo.bus import ports
from softmap_edge.robot.servo.rig import read_rig


@dataclass(frozen=True)
class RebootOptions:
    """Options of `softmap servo reboot`, as its parser declares them."""

    id: int
    rig: str | None
    port: str | None
    baud: int | None
    json: bool


def reboot_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `servo reboot`."""
    parser.add_argument("--id", type=int, required=True, metavar="ID", help="the servo")
    parser.add_argument("--rig", metavar="rig.toml", help="the bench whose port it is")
    parser.add_argument(
        "--port", metavar="PORT", help="a serial port; every one of this machine without it"
    )
    parser.add_argument(
        "--baud", type=int, metavar="BAUD", help="one rate; every known one without it"
    )


def reboot(args: RebootOptions) -> int:
    """Restart one servo, torque off first; return 0 if it reports no error afterwards."""
    if not 0 <= args.id <= 252:
        raise ServoError(f"--id {args.id}; allowed are 0 to 252")
    port, baud = _where(args)
    done = restart(port, baud, args.id)
    if args.json:
        print(json.dumps(done.to_dict()))
    else:
        print(f"{done}\n{next_command('servo', 'home', '--rig', args.rig or 'FILE')}")
    return 0


def _where(args: RebootOptions) -> tuple[str, int]:
    """Return port and baud rate of the selected servo."""
    port, baud = args.port, args.baud
    if args.rig:
        rig = read_rig(args.rig)
        ids = [servo.id for servo in rig.servos]
        if args.id not in ids:
            raise ServoError(f"the rig has no servo {args.id}; it has {', '.join(map(str, ids))}")
        port, baud = port or rig.port, baud or rig.baud
    if port and baud:
        return port, baud
    found = [
        one
        for name in ([port] if port else ports())
        for one in scan(name, baud)
        if one.id == args.id
    ]
    if len(found) != 1:
        raise ServoError(
            f"{len(found) or 'no'} servos of id {args.id} answer; say where it is with --rig, or "
            "--port and --baud"
        )
    return found[0].port, found[0].baud
