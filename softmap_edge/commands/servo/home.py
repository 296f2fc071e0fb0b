"""`softmap servo home`: home confirmed by its user, or by options without one.

Hooked into servo.py.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass

from softmap_edge.commands.commissioning import confirm
from softmap_edge.commands.output import check_file, next_command
from softmap_edge.errors import ServoError
from softmap_edge.robot.commissioning.home import prove, relax
from softmap_edge.robot.servo.rig import read_rig


@dataclass(frozen=True)
class HomeOptions:
    """Options of `softmap servo home`, as its parser declares them."""

    rig: str
    yes: bool
    new: bool
    json: bool


def home_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `servo home`."""
    parser.add_argument(
        "--rig", required=True, metavar="rig.toml", help="the bench; its homes are written into it"
    )
    parser.add_argument("--yes", action="store_true", help="the finger is straight: ask nothing")
    parser.add_argument(
        "--new", action="store_true", help="this is home, whatever was stored before"
    )


def home(args: HomeOptions) -> int:
    """Confirm home after a power-up; 0 when it is confirmed."""
    check_file("--rig", args.rig, ".toml")
    rig = read_rig(args.rig)
    relax(rig)
    confirmed = "by --yes"
    if not args.yes:
        if not confirm(
            "Torque is off. Let the finger hang straight and still. Is it straight?", "--yes"
        ):
            raise ServoError(
                "the robot is not homed: it was not confirmed that the finger is straight"
            )
        confirmed = "by the user at the terminal"
    homed = prove(rig, confirmed, new=args.new)
    homed.rig.note(args.rig)
    print(
        json.dumps(homed.to_dict() | {"rig": args.rig})
        if args.json
        else f"{homed}\n{args.rig}: home is confirmed\n"
        + next_command("servo", "pull", "--rig", args.rig)
    )
    return 0
