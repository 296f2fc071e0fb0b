"""The command `run register`: from point clouds of a finger to the vertices of its template."""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from typing import Literal

from softmap_edge.alignment.clouds import read_clouds
from softmap_edge.alignment.register import PRINTED
from softmap_edge.alignment.register import register as lay
from softmap_edge.commands.output import check_file, check_no_run, next_command
from softmap_edge.commands.own import effects_argument, load_own, open_model
from softmap_edge.errors import RegistrationError

POOR = 1  # exit code where a frame has warnings


@dataclass(frozen=True)
class RegisterOptions:
    """Options of `softmap run register`, as its parser declares them."""

    clouds: list[str]
    bundle: str | None
    effects: list[str]
    trust_onnx: bool
    out: str
    mode: Literal["robust", "paper"]
    force: bool
    json: bool


def register_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `register`."""
    parser.add_argument(
        "clouds",
        nargs="+",
        help=(
            "a run with clouds (.npz), or one cloud a frame (PLY, PCD, CSV, XYZ, OBJ, NPY, NPZ), mm"
        ),
    )
    parser.add_argument(
        "--bundle", metavar="DIR", help="the model of this finger; the built-in finger without it"
    )
    effects_argument(parser)
    parser.add_argument("--out", required=True, metavar="RUN", help="the run of vertices (.npz)")
    parser.add_argument(
        "--mode",
        choices=("robust", "paper"),
        default="robust",
        help="robust, or the published objective",
    )
    parser.add_argument("--force", action="store_true", help="replace the run that stands at --out")


def register(args: RegisterOptions) -> int:
    """Lay the template onto each cloud, and write the run of its vertices."""
    check_file("--out", args.out, ".npz")
    check_no_run("--out", args.out, args.force)
    load_own(args)
    notes: list[str] = []
    model, run = open_model(args.bundle), read_clouds(args.clouds, notes)
    try:
        found = lay(model, run, args.mode)
    except RegistrationError as fault:  # a guess of columns may be the reason
        raise RegistrationError("; ".join([str(fault), *notes[:PRINTED]])) from None
    vertices = found.run(run)
    vertices.save(args.out)
    if args.json:
        print(
            json.dumps(found.to_dict() | {"notes": notes, "out": args.out, "hash": vertices.hash()})
        )
    else:
        lines = [f"  look at: {note}" for note in notes[:PRINTED]]
        lines += (
            [f"  and {len(notes) - PRINTED} more such files (--json)"]
            if len(notes) > PRINTED
            else []
        )
        after = next_command("compare", args.out, bundle=args.bundle)
        print("\n".join([str(found), *lines, f"written to {args.out}", after]))
    return POOR if any(row["warnings"] for row in found.frames) else 0
