"""Commands that show results: `model predict`, `model effects`."""

from __future__ import annotations

import argparse
import json
import sys
import textwrap
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from softmap_edge import _core
from softmap_edge.commands.output import check_file, check_no_run
from softmap_edge.commands.own import effects_argument, load_own, open_model
from softmap_edge.errors import SoftmapError, no_effect
from softmap_edge.files.atomic import write_atomically
from softmap_edge.files.npz import write_npz
from softmap_edge.files.numbers import WIDTH
from softmap_edge.model.model import Model
from softmap_edge.model.training_range import command_extrapolation
from softmap_edge.model.user_effect import template
from softmap_edge.robot.drive.recorded import RECORDING, open_run
from softmap_edge.run.run import Run


@dataclass(frozen=True)
class PredictOptions:
    """Options of `softmap model predict`, as its parser declares them."""

    input: str
    bundle: str | None
    effects: list[str]
    trust_onnx: bool
    out: str | None
    json: bool


def predict_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `model predict`."""
    parser.add_argument(
        "input",
        help=(
            "a run (.npz or .mcap), or one command in the unit of the model, comma-separated: 8,-3"
        ),
    )
    parser.add_argument("--bundle", metavar="DIR", help="the model (default: the built-in finger)")
    effects_argument(parser)
    parser.add_argument("--out", help="write the predicted points (K, N, 3) mm to this .npz")


def predict(args: PredictOptions) -> int:
    """Predict shapes for a run or one command."""
    check_file("--out", args.out, ".npz")
    check_no_run("--out", args.out)
    load_own(args)
    model = open_model(args.bundle)
    run = (
        open_run(args.input, model)
        if Path(args.input).suffix.lower() in (".npz", RECORDING)
        else _held(args.input, model)
    )
    for note in command_extrapolation(model, run):
        print(f"softmap model predict: {note}", file=sys.stderr)
    points = model.predict(run)
    tip = points[:, model.tip_indices].mean(axis=1)
    if args.out:
        write_npz(Path(args.out), {"points": points, "tip": tip})
    document = {
        "schema": "softmap.prediction/1",
        "frames": len(points),
        "points": points.shape[1],
        "tip_mm": np.round(tip, 4).tolist(),
    }
    if args.json:
        print(json.dumps(document))
        return 0
    shown = "\n".join(f"tip {x:8.2f} {y:8.2f} {z:8.2f} mm" for x, y, z in tip[:10])
    more = f"\n… {len(tip) - 10} more frames" if len(tip) > 10 else ""
    print(
        f"{len(points)} shape{'s' * (len(points) != 1)} of {points.shape[1]} points\n{shown}{more}"
    )
    return 0


@dataclass(frozen=True)
class EffectsOptions:
    """Options of `softmap model effects`, as its parser declares them."""

    name: str | None
    new_name: str | None
    effects: list[str]
    trust_onnx: bool
    json: bool


def effects_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `model effects`."""
    parser.add_argument(
        "name",
        nargs="?",
        help="show this effect in full; 'new' writes a file for an effect of your own",
    )
    parser.add_argument(
        "new_name", nargs="?", metavar="NAME", help="after 'new': its name; NAME.py is written here"
    )
    effects_argument(parser)


def effects(args: EffectsOptions) -> int:
    """List the effects of the library, show one, or write the template of a user-defined one."""
    if args.name == "new":
        return _new(args)
    load_own(args)
    known = {effect["name"]: effect for effect in _core.effects()}
    if args.name and args.name not in known:
        raise SoftmapError(no_effect(args.name, known))
    chosen = [known[args.name]] if args.name else list(known.values())
    if args.json:
        print(json.dumps({"schema": "softmap.effects/1", "effects": chosen}, ensure_ascii=False))
        return 0
    for effect in chosen:
        print(
            "\n".join(
                _hung(
                    f"{effect['name']:<20} {effect['stage']:<13} {effect['family']:<20} ",
                    effect["signature"],
                )
            )
        )
        if args.name:
            paragraphs = [
                _hung("  ", effect["doc"]),
                _hung("  ", effect["formula"]),
                _hung("  see: ", effect["reference"]),
            ]
            print("\n".join(["", *(line for part in paragraphs for line in part), ""]))
            for p in effect["parameters"]:
                head = (
                    f"  {p['name']:<12} {p['unit']:<6} null {p['null']:g}, {p['low']:g} … "
                    f"{p['high']:g}   "
                )
                print("\n".join(_hung(head, p["doc"])))
    return 0


def _new(args: EffectsOptions) -> int:
    if args.new_name is None:
        raise SoftmapError(
            "give the new effect a name: `softmap model effects new wobble` writes wobble.py"
        )
    text, file = template(args.new_name), Path(f"{args.new_name}.py")
    check_file("effects new", str(file))
    if file.exists():
        raise SoftmapError(f"{file} stands here already; give another name or remove it")
    write_atomically(file, text)
    if args.json:
        print(json.dumps({"schema": "softmap.effects/1", "written": str(file)}))
    else:
        print(
            f"{file}: runs as it is; write your law into it, then look for it: softmap diagnose "
            f"RUN --effects {file}"
        )
    return 0


def _hung(head: str, text: str) -> list[str]:
    """Return lines of at most 100 columns: the head, and the text to the right of it."""
    return textwrap.wrap(text, WIDTH, initial_indent=head, subsequent_indent=" " * len(head))


def _held(text: str, model: Model) -> Run:
    """Return a run of one command, held until all memory has settled."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise SoftmapError(
            f"'{text}' is neither a run (.npz, .mcap) nor a command such as 8,-3"
        ) from None
    if len(numbers) != model.channels or not np.all(np.isfinite(numbers)):
        raise SoftmapError(
            f"'{text}': {len(numbers)} numbers, this model takes {model.channels} finite commands "
            f"in {model.command_unit}"
        )
    return Run(
        t=np.zeros(1),
        command=np.array([numbers]),
        t_seen=np.zeros(1),
        command_unit=model.command_unit,
    )
