"""The command `servo doctor`: is everything here that a robot needs, and what to do where it is not."""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass

from softmap_edge.commands.output import next_command

WELL, UNWELL = 0, 1


@dataclass(frozen=True)
class DoctorOptions:
    """Options of `softmap servo doctor`, as its parser declares them."""

    rig: str | None
    bundle: str | None
    camera: str | None
    json: bool


def doctor_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `doctor`."""
    parser.add_argument(
        "--rig", metavar="rig.toml", help="ask the servos of this rig too; nothing moves"
    )
    parser.add_argument("--bundle", metavar="DIR", help="look at this bundle too")
    parser.add_argument("--camera", metavar="N|/dev/…", help="take a picture of this camera")


def doctor(args: DoctorOptions) -> int:
    """Look at everything; 1 if something is at fault."""
    from softmap_edge.robot.doctor import examine

    found = examine(args.rig, args.bundle, args.camera)
    print(json.dumps(found.to_dict()) if args.json else found)
    if found.well and args.rig and not args.json:
        print(next_command("track", "S", "--rig", args.rig, bundle=args.bundle))
    return WELL if found.well else UNWELL
