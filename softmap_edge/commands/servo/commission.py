"""The actions `servo home`, `servo calibrate` and `servo pull`: commission a rig, in this order."""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace

from softmap_edge.commands.output import (
    bundle_arguments,
    check_bundle,
    check_file,
    next_command,
    to_stderr,
)
from softmap_edge.commands.own import effects_argument, load_own, open_model
from softmap_edge.commands.progress import Bar
from softmap_edge.commands.robot import announce_edited_limits
from softmap_edge.commands.servo.move import announce, confirm, deadman, hold_argument
from softmap_edge.errors import CalibrationError, ServoError
from softmap_edge.model.bundle import save_bundle
from softmap_edge.model.model import Model
from softmap_edge.robot.commissioning.first_calibration import (
    COUPLING,
    bends,
    pulley_calibration,
    radius,
)
from softmap_edge.robot.commissioning.first_calibration import document as calibration_document
from softmap_edge.robot.commissioning.home import prove, relax
from softmap_edge.robot.commissioning.jog import Jog
from softmap_edge.robot.commissioning.pull import MARGIN, noted, pull
from softmap_edge.robot.servo.limits import IDLE, effective_limits
from softmap_edge.robot.servo.rig import Rig, read_rig

JOGGED = 200.0  # ticks: visible, and within the travel of a jog
MOVES = 0.5  # least share of JOGGED that a servo must turn


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
        "--rig", required=True, metavar="FILE.toml", help="the rig; its homes are written into it"
    )
    parser.add_argument(
        "--yes", action="store_true", help="do not ask whether the finger is straight"
    )
    parser.add_argument(
        "--new", action="store_true", help="take the current position as the new home"
    )


def home(args: HomeOptions) -> int:
    """Home the robot after a power-up and write its homes into the rig; return 0."""
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


@dataclass(frozen=True)
class CalibrateOptions:
    """Options of `softmap servo calibrate`, as its parser declares them."""

    rig: str
    pulley_mm: float
    signs: str | None
    ruler: str | None
    bundle: str | None
    effects: list[str]
    trust_onnx: bool
    out: str
    force: bool
    hold: bool
    json: bool


def calibrate_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `servo calibrate`."""
    parser.add_argument("--rig", required=True, metavar="FILE.toml", help="the rig, homed before")
    parser.add_argument(
        "--pulley-mm",
        required=True,
        type=float,
        metavar="R",
        help="radius at which tendon is wound",
    )
    parser.add_argument(
        "--signs", metavar="+,-", help="bending direction of each servo (default: jog it and ask)"
    )
    parser.add_argument(
        "--ruler",
        metavar="TICKS=MM",
        help="length of tendon wound by these ticks, measured with a ruler",
    )
    parser.add_argument(
        "--bundle", metavar="DIR", help="the model of this robot (default: the built-in finger)"
    )
    effects_argument(parser)
    bundle_arguments(parser)
    hold_argument(parser)


def calibrate(args: CalibrateOptions) -> int:
    """Write the bundle with a first calibration; return 0."""
    check_bundle(args.out, args.force)
    load_own(args)
    rig, model = read_rig(args.rig), open_model(args.bundle)
    pulley = radius(args.pulley_mm, _reading(args.ruler))
    given = [1] * len(rig.servos) if args.signs is None else _signs(args.signs)
    found = pulley_calibration(rig, model, pulley, given)  # raises an error before anything moves
    if args.signs is None:
        found = pulley_calibration(rig, model, pulley, _jogged(args, rig, model))
    warnings = [
        f"no coupling is known: servos are taken to pull one command each, within {COUPLING:g} of "
        "their own",
        "held out is what the deviations expect; nothing was seen: calibrate with a camera for "
        "more",
    ]
    if args.ruler is None:
        warnings.append(
            "the radius is the pulley's alone; one reading of a ruler (--ruler TICKS=MM) measures "
            "it better"
        )
    folder = save_bundle(replace(model, calibration=found), args.out)
    if args.json:
        print(
            json.dumps(
                calibration_document(found, model, warnings) | {"bundle": str(folder)},
                ensure_ascii=False,
            )
        )
        return 0
    print(f"A first calibration: {found.run}; radius {pulley.mm:.3f} ± {pulley.sigma:.3f} mm")
    for k, servo in enumerate(rig.servos):
        print(
            f"  servo {servo.id}: u{k} {found.A[k, k]:+.6f} ± {found.sigma_A[k, k]:.6f} mm a "
            f"tick, straight at {found.home[k]:.0f} ticks ± {found.sigma_b[k]:.2f} mm"
        )
    print("\n".join([*(f"  look at: {line}" for line in warnings), f"{folder}: written"]))
    print(next_command("servo", "doctor", "--rig", args.rig, bundle=str(folder)))
    return 0


def _reading(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        ticks, mm = (float(part) for part in text.split("="))
    except ValueError:
        raise CalibrationError(f"--ruler '{text:.40}': give TICKS=MM, as 2048=7.3") from None
    return ticks, mm


def _signs(text: str) -> list[int]:
    known = {"+": 1, "-": -1}
    parts = text.split(",")
    if not all(part in known for part in parts):
        raise CalibrationError(f"--signs '{text:.40}': give + or - for each servo, as --signs=+,-")
    return [known[part] for part in parts]


def _jogged(args: CalibrateOptions, rig: Rig, model: Model) -> list[int]:
    """Jog each servo back and forth, and ask which way the finger bent; return the signs."""
    signs = []
    for k, servo in enumerate(rig.servos):
        way = bends(model, k)
        with Jog(rig, tell=to_stderr) as jog:
            with deadman(args.hold) as hand:
                announce(
                    args,
                    f"servo {servo.id} turns by {JOGGED:+.0f} ticks and back; watch the tip",
                    hand,
                )
                came = jog.by(k, JOGGED, hand)
                if not hand.stopped:
                    jog.by(k, -came, hand)
            jog.stop()
        if hand.stopped or abs(came) < MOVES * JOGGED:
            why = "a key that stops was pressed" if hand.stopped else "look what holds it"
            raise ServoError(
                f"servo {servo.id} came {came:+.0f} of {JOGGED:+.0f} ticks, so nothing is known "
                f"of its sign: {why}"
            )
        if confirm(
            f"Did servo {servo.id} bend the tip towards {way} of the base first?", "--signs"
        ):
            signs.append(1)
        elif confirm("Did it bend the tip the other way?", "--signs"):
            signs.append(-1)
        else:
            raise ServoError(
                f"servo {servo.id} bends the tip neither to {way} nor the other way; servo "
                f"{k + 1} of the rig has to pull command {k + 1}: look at its tendon, or at the "
                "order in rig.toml"
            )
    return signs


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
        "--rig", required=True, metavar="FILE.toml", help="the rig; ceilings are written into it"
    )
    parser.add_argument(
        "--bundle",
        metavar="DIR",
        help="the model, with its calibration (default: the built-in finger)",
    )
    effects_argument(parser)
    parser.add_argument("--servo", type=int, metavar="ID", help="this servo alone (default: all)")
    hold_argument(parser)


def pull_test(args: PullOptions) -> int:
    """Measure the current at the stroke and write the ceilings into the rig; return 0."""
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
