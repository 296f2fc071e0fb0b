"""`softmap servo limits`: every limit in force on a bench, and who set it. Hooked into servo.py."""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass

from softmap_edge.commands.output import with_files
from softmap_edge.commands.own import effects_argument, load_own, open_model
from softmap_edge.errors import ServoError
from softmap_edge.robot.servo.limits import effective_limits
from softmap_edge.robot.servo.loop_limits import RATE
from softmap_edge.robot.servo.rig import read_rig

REFUSED = 1  # exit code: with these limits nothing is driven


@dataclass(frozen=True)
class LimitsOptions:
    """Options of `softmap servo limits`, as its parser declares them."""

    rig: str
    bundle: str | None
    effects: list[str]
    trust_onnx: bool
    rate: float
    json: bool


def limits_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `servo limits`."""
    parser.add_argument(
        "--rig", required=True, metavar="rig.toml", help="the bench: its servos, ceiling and stops"
    )
    parser.add_argument(
        "--bundle", metavar="DIR", help="the finger, with its calibration (the built-in one)"
    )
    effects_argument(parser)
    parser.add_argument(
        "--rate",
        type=float,
        default=RATE,
        metavar="HZ",
        help=f"periods of the loop a second ({RATE:g})",
    )


def limits(args: LimitsOptions) -> int:
    """Print the limits; 1 when nothing can be driven with them, and why."""
    load_own(args)
    model = open_model(args.bundle)
    found = effective_limits(read_rig(args.rig), model, rate=args.rate)
    refused = None
    try:
        found.table()
    except ServoError as fault:
        refused = with_files(str(fault), args)
    if args.json:
        print(json.dumps(found.to_dict() | {"refused": refused}))
    else:
        print(found)
        if refused is not None:
            print(f"nothing is driven: {refused}")
    return 0 if refused is None else REFUSED
