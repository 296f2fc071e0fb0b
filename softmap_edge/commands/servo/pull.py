"""`softmap servo pull`: the current at the stroke becomes the ceiling in rig.toml.

Hooked into servo.py.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass

from softmap_edge.commands.commissioning import announce, deadman, hold_argument
from softmap_edge.commands.output import check_file, next_command, to_stderr
from softmap_edge.commands.own import effects_argument, load_own, open_model
from softmap_edge.commands.progress import Bar
from softmap_edge.commands.robot import announce_edited_limits
from softmap_edge.robot.commissioning.pull import MARGIN, noted, pull
from softmap_edge.robot.servo.limits import IDLE, effective_limits
from softmap_edge.robot.servo.rig import read_rig


@dataclass(frozen=True)
class PullOptions:
    """Options of `softmap servo pull`, as its parser declares them."""

    rig: str
    bundle: str | None
    effects: list[str]
    trust_onnx: bool
    servo: int | None
    hold: bool
    json: bool


def pull_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `servo pull`."""
    parser.add_argument(
        "--rig", required=True, metavar="rig.toml", help="the bench; ceilings are written into it"
    )
    parser.add_argument(
        "--bundle", metavar="DIR", help="the finger, with its calibration (the built-in one)"
    )
    effects_argument(parser)
    parser.add_argument(
        "--servo", type=int, metavar="ID", help="this servo alone; all of them without it"
    )
    hold_argument(parser)


def pull_test(args: PullOptions) -> int:
    """Measure and write the ceilings; 0 when all are found."""
    check_file("--rig", args.rig, ".toml")
    rig = read_rig(args.rig)
    load_own(args)
    model = open_model(args.bundle)
    announce_edited_limits(model)
    found = effective_limits(rig, model)
    with deadman(args.hold) as hand:
        announce(args, "each servo goes slowly to both ends of its window and back", hand)
        with Bar(args.json) as bar:
            done = pull(found, hand, () if args.servo is None else (args.servo,), bar, to_stderr)
    noted(rig, done).note(args.rig)
    if args.json:
        document = {"schema": "softmap.pull/1", "servos": [one.to_dict() for one in done]}
        print(json.dumps(document | {"margin": MARGIN, "idle_of_stall": IDLE, "rig": args.rig}))
    else:
        how = f"{MARGIN:g} times the most of both, and {IDLE:g} of the stall current"
        print(
            "\n".join(
                [
                    *map(str, done),
                    f"{args.rig}: the ceilings are written ({how}); torque is off",
                    next_command("servo", "doctor", "--rig", args.rig, bundle=args.bundle),
                ]
            )
        )
    return 0
