"""The command `model calibrate`: fit the map from servo ticks to commands to a run.

The run has ticks and shapes."""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass

from softmap_edge.calibration.calibration import calibrate as find
from softmap_edge.calibration.found import Calibrated
from softmap_edge.commands.output import bundle_arguments, check_bundle, check_picture, next_command
from softmap_edge.commands.own import effects_argument, load_own, open_model
from softmap_edge.errors import CalibrationError
from softmap_edge.files.atomic import write_atomically
from softmap_edge.model.bundle import save_bundle
from softmap_edge.robot.drive.recorded import open_run

NOT_AFFINE = 1  # exit code


@dataclass(frozen=True)
class CalibrateOptions:
    """Options of `softmap model calibrate`, as its parser declares them."""

    run: str
    bundle: str | None
    effects: list[str]
    trust_onnx: bool
    out: str
    force: bool
    home: list[float] | None
    window: list[float] | None
    grid: bool
    plot: str | None
    json: bool


def calibrate_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `model calibrate`."""
    parser.add_argument(
        "run", help="a run (.npz or .mcap) with ticks and points, in the base frame"
    )
    parser.add_argument(
        "--bundle", metavar="DIR", help="the model of this robot (default: the built-in finger)"
    )
    effects_argument(parser)
    bundle_arguments(parser)
    parser.add_argument(
        "--home",
        nargs="+",
        type=float,
        metavar="TICKS",
        help=(
            "the home ticks of the rig, one per servo (default: the position at which the run "
            "rests most often)"
        ),
    )
    parser.add_argument(
        "--window",
        nargs=2,
        type=float,
        metavar=("LOW", "HIGH"),
        help="ticks about home that each servo may take",
    )
    parser.add_argument(
        "--grid",
        action="store_true",
        help="match to the nearest shape of a grid only, as in the paper",
    )
    parser.add_argument("--plot", metavar="FILE.svg", help="draw matched pairs and their residuals")


def calibrate(args: CalibrateOptions) -> int:
    """Fit u = A (ticks − home) + b and write the bundle; return 1 if it is clearly not affine."""
    check_picture("--plot", args.plot)
    check_bundle(args.out, args.force)
    if args.window is not None and not args.window[0] < 0.0 < args.window[1]:
        raise CalibrationError(
            f"--window {args.window[0]:g} {args.window[1]:g}: expected LOW < 0 < HIGH, ticks "
            "about home"
        )
    load_own(args)
    window = None if args.window is None else (args.window[0], args.window[1])
    found = find(open_model(args.bundle), open_run(args.run), args.home, window, not args.grid)
    if args.plot:
        _plot(found, args.plot)
    folder = save_bundle(found.model, args.out)
    if args.json:
        print(json.dumps(found.to_dict() | {"bundle": str(folder)}, ensure_ascii=False))
    else:
        print(f"{found}\n{folder}: runs with ticks are taken as commands from here on")
        print(next_command("compare", args.run, bundle=str(folder)))
    return 0 if found.affine else NOT_AFFINE


def _plot(found: Calibrated, path: str) -> None:
    from softmap_edge.report.calibration_figure import calibration_figure

    write_atomically(path, calibration_figure(found))
