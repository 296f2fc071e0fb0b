"""The commands `servo doctor`, `servo limits` and `servo replay`: checks that move nothing."""

from __future__ import annotations

import argparse
import json
import warnings
from dataclasses import dataclass

from softmap_edge.commands.output import (
    check_file,
    check_no_run,
    next_command,
    to_stderr,
    with_files,
)
from softmap_edge.commands.own import effects_argument, load_own, open_model
from softmap_edge.errors import RecordingWarning, ServoError
from softmap_edge.robot.control.recording import read_recording
from softmap_edge.robot.drive.recorded import run_of
from softmap_edge.robot.servo import status_words as words
from softmap_edge.robot.servo.limits import effective_limits
from softmap_edge.robot.servo.loop_limits import RATE
from softmap_edge.robot.servo.rig import read_rig

WELL = 0
FAULT = 1  # exit code: a fault, limits that allow no motion, a decision that differs


@dataclass(frozen=True)
class DoctorOptions:
    """Options of `softmap servo doctor`, as its parser declares them."""

    rig: str | None
    bundle: str | None
    camera: str | None
    json: bool


def doctor_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `servo doctor`."""
    parser.add_argument(
        "--rig", metavar="FILE.toml", help="also read the servos of this rig; nothing moves"
    )
    parser.add_argument("--bundle", metavar="DIR", help="also check this bundle")
    parser.add_argument("--camera", metavar="N|/dev/…", help="take a picture of this camera")


def doctor(args: DoctorOptions) -> int:
    """Check the computer and, with `--rig`, the rig; return 1 if there is a fault."""
    from softmap_edge.robot.doctor import examine

    found = examine(args.rig, args.bundle, args.camera)
    print(json.dumps(found.to_dict()) if args.json else found)
    if found.well and args.rig and not args.json:
        print(next_command("track", "S", "--rig", args.rig, bundle=args.bundle))
    return WELL if found.well else FAULT


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
        "--rig", required=True, metavar="FILE.toml", help="the rig: its servos, ceiling and stops"
    )
    parser.add_argument(
        "--bundle",
        metavar="DIR",
        help="the model, with its calibration (default: the built-in finger)",
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
    """Print the limits; return 1, with the reason, if they allow no motion."""
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
    return WELL if refused is None else FAULT


@dataclass(frozen=True)
class ReplayOptions:
    """Options of `softmap servo replay`, as its parser declares them."""

    recording: str
    run: str | None
    force: bool
    json: bool


def replay_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `servo replay`."""
    parser.add_argument("recording", help="recording of the control loop (.mcap)")
    parser.add_argument(
        "--run", metavar="RUN", help="also write it as a run, with the camera frames"
    )
    parser.add_argument("--force", action="store_true", help="overwrite an existing run")


def replay(args: ReplayOptions) -> int:
    """Replay a recording through the guard.

    Returns:
        1 if a decision differs or the recording is incomplete, else 0.
    """
    check_file("--run", args.run, ".npz")
    check_no_run("--run", args.run, args.force)
    recording = read_recording(args.recording)
    differ, lacks = recording.replay(), recording.incomplete
    if args.run:
        run, lacks = run_of(recording)
        run.save(args.run)
    first, last = recording.periods[0], recording.periods[-1]
    seconds = (last["now"] - first["now"]) * 1e-9
    if args.json:
        document = {
            "schema": "softmap.replay/1",
            "periods": len(recording.periods),
            "seconds": seconds,
        }
        document |= {"bus": recording.bus}
        print(
            json.dumps(document | {"otherwise": differ, "short": recording.short, "run": args.run})
        )
    else:
        text = (
            "every one decided alike"
            if not differ
            else f"{len(differ)} decided otherwise, the first is {differ[0]}"
        )
        print(f"{args.recording}: {len(recording.periods)} periods in {seconds:.1f} s, {text}")
        if args.run:
            print(f"{args.run}: written")
    if lacks:
        warnings.warn(RecordingWarning(lacks), stacklevel=2)
    if text := words.bus(recording.bus):
        to_stderr(f"softmap servo replay: {text}")
    return FAULT if differ or recording.short else WELL
