"""The command `model adapt`: from recordings to a calibrated bundle with effects and a residual."""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass

from softmap_edge.adaptation.adapt import adapt as learn
from softmap_edge.commands.output import bundle_arguments, check_bundle, check_file, next_command
from softmap_edge.commands.own import effects_argument, load_own, open_model
from softmap_edge.commands.progress import Elapsed
from softmap_edge.commands.understand import warn_outside, write_page
from softmap_edge.model.bundle import save_bundle
from softmap_edge.robot.drive.recorded import open_run

WORSE = 1  # exit code


@dataclass(frozen=True)
class AdaptOptions:
    """Options of `softmap model adapt`, as its parser declares them."""

    runs: list[str]
    bundle: str | None
    held_out: str | None
    residual_only: bool
    effects: list[str]
    trust_onnx: bool
    out: str
    force: bool
    html: str | None
    json: bool


def adapt_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `softmap model adapt`."""
    parser.add_argument(
        "runs",
        nargs="+",
        metavar="run",
        help="a run (.npz or .mcap) of points or clouds; several teach together",
    )
    parser.add_argument("--bundle", metavar="DIR", help="the model (default: the built-in finger)")
    parser.add_argument(
        "--held-out", metavar="RUN", help="a recording for validation only, not for learning"
    )
    parser.add_argument(
        "--residual-only",
        action="store_true",
        help="add no effects; learn the residual alone",
    )
    effects_argument(parser)
    bundle_arguments(parser)
    parser.add_argument(
        "--html", metavar="FILE.html", help="write one self-contained page with pictures"
    )


def adapt(args: AdaptOptions) -> int:
    """Calibrate, diagnose, add, learn a residual, validate; 1 if the held-out error stays."""
    check_bundle(args.out, args.force)
    check_file("--html", args.html, ".html")
    load_own(args)
    model = open_model(args.bundle)
    runs = [open_run(path, model) for path in args.runs]
    held_out = None if args.held_out is None else open_run(args.held_out, model)
    with Elapsed("adapting the model", silent=args.json) as progress:
        found = learn(model, runs, held_out, not args.residual_only, progress)
    for run in found.runs:
        warn_outside("model adapt", found.before, run)
    folder = save_bundle(found.model, args.out)
    print(
        json.dumps(found.to_dict() | {"bundle": str(folder)}, indent=1)
        if args.json
        else f"{folder}\n{found}\n{next_command('compare', 'ANOTHER_RUN', bundle=str(folder))}"
    )
    if args.html:
        kind = "fitted" if held_out is None else "held out"
        left_out = (
            "" if found.model.residual is not None else "; the residual is left out of the bundle"
        )
        ways = found.error, found.error_on + left_out
        write_page(
            args.html, found.validation, found.before, found.model, found.diagnosis, kind, ways
        )
    return 0 if found.fall > 0.0 else WORSE
