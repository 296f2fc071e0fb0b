"""Commands that make a model: build, learn, sweep."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from softmap_edge.commands.output import (
    bundle_arguments,
    check_bundle,
    check_file,
    check_no_run,
    next_command,
)
from softmap_edge.commands.progress import Bar
from softmap_edge.errors import SoftmapError
from softmap_edge.fem.finger import Finger
from softmap_edge.model.bundle import save_bundle
from softmap_edge.robot.drive.recorded import open_run

if TYPE_CHECKING:
    from softmap_edge.rod.learn import LearnedRod

TRAINING = "pip install softmap-training"  # installs the module that `_stored` imports


@dataclass(frozen=True)
class BuildOptions:
    """Options of `softmap build`, as its parser declares them."""

    finger: str | None
    out: str
    force: bool
    steps: int | None
    json: bool


def build_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `build`."""
    parser.add_argument(
        "finger",
        nargs="?",
        help="finger.toml, or a sweep (.npz) of `softmap model sweep` or of another simulator "
        "(docs/do/import_sweep.md; default: the built-in finger)",
    )
    bundle_arguments(parser)
    parser.add_argument(
        "--steps", type=int, help="commands per channel in the sweep (41; for three channels 13)"
    )


def build(args: BuildOptions) -> int:
    """Simulate a finger, or read an existing sweep, and write the bundle."""
    _check_steps(args.steps)
    check_bundle(args.out, args.force)
    if args.finger is not None and Path(args.finger).suffix in (".mcap", ".db3", ".bag"):
        raise SoftmapError(
            f"{args.finger}: a recording; a model is learned from recordings with `softmap learn`"
        )
    made, how = None, "another mesh, modulus ±10 %"
    with Bar(args.json) as bar:
        if args.finger is not None and Path(args.finger).suffix == ".npz":
            from softmap_edge.sweep.build import model_from_file

            model = model_from_file(args.finger, bar)
            made = model.made_from.get("commands")
            how = how if made is None else "interpolation of the sweep, by leaving out"
        else:
            from softmap_edge.fem.build import build_model

            model = build_model(_finger(args.finger), args.steps, bar)
    commands = made or int(model.made_from["steps"]) ** model.channels
    folder = save_bundle(model, args.out)
    size = sum(file.stat().st_size for file in folder.iterdir())
    result = {
        "schema": "softmap.build/1",
        "bundle": str(args.out),
        "kind": model.kind,
        "vertices": len(model.rest),
        "handles": len(model.rest if model.handles is None else model.handles),
        "commands": commands,
        "held_out_error_mm": round(model.vertex_error_mm, 4),
        "bytes": size,
    }
    handles = "" if model.handles is None else f" ({len(model.handles)} handles)"
    text = (
        f"{args.out}: {model.kind} of {model.robot}, {len(model.rest)} vertices{handles}, "
        f"{commands} command{'s' if commands != 1 else ''}, own held-out error "
        f"{model.vertex_error_mm:.2f} mm RMS ({how}), {size / 1000:.0f} kB"
    )
    notes, mark = model.made_from.get("notes", []), "look at: " if made is None else ""
    print(
        json.dumps(result | {"notes": notes})
        if args.json
        else "\n".join(
            [
                text,
                *(f"  {mark}{n}" for n in notes),
                next_command("compare", "RUN", bundle=str(args.out)),
            ]
        )
    )
    return 0


@dataclass(frozen=True)
class LearnOptions:
    """Options of `softmap learn`, as its parser declares them."""

    run: list[str]
    out: str
    force: bool
    static: bool
    robot: str | None
    input: Literal["goal", "present"] | None
    hold_out: list[str]
    json: bool


def learn_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `learn`."""
    parser.add_argument(
        "run",
        nargs="+",
        help="reference run (.npz or .mcap); give several of one robot to learn from all of them",
    )
    bundle_arguments(parser)
    parser.add_argument(
        "--static",
        action="store_true",
        help="learn the static map alone, and leave all memory to `softmap diagnose`",
    )
    parser.add_argument(
        "--robot", metavar="FILE.toml", help="robot.toml: its tendons, for a rod that knows them"
    )
    parser.add_argument(
        "--input",
        choices=["goal", "present"],
        help="what moves the model (default: present if recorded)",
    )
    parser.add_argument(
        "--hold-out",
        action="append",
        default=[],
        metavar="T0:T1",
        help="seconds to keep from the fit; may be repeated",
    )


def learn(args: LearnOptions) -> int:
    """Fit a rod to reference runs and write its bundle."""
    from softmap_edge.rod.learn import learn as fit
    from softmap_edge.rod.learn import learned_model
    from softmap_edge.rod.robot import Robot
    from softmap_edge.run.in_unit import words_in_unit

    check_bundle(args.out, args.force)
    held_out = [_interval(text) for text in args.hold_out]
    robot = None if args.robot is None else Robot.load(args.robot)
    runs = [open_run(path) for path in args.run]
    for text, (low, high) in zip(args.hold_out, held_out):
        if not any(np.any((run.t_seen >= low) & (run.t_seen < high)) for run in runs):
            spans = "; ".join(_span(run.t_seen) for run in runs)
            raise SoftmapError(f"--hold-out {text}: no frame is seen then; the run is seen {spans}")
    learned = fit(runs, args.input, hold_out=held_out, robot=robot, static=args.static)
    model = learned_model(runs, learned)
    save_bundle(model, args.out)
    output = model.output
    result = {
        "schema": "softmap.learn/1",
        "bundle": str(args.out),
        "kind": "rod",
        "runs": len(runs),
        "channels": model.channels,
        "command_unit": model.command_unit,
        "markers": len(model.rest),
        "held_out_error_mm": round(model.vertex_error_mm, 4),
        **({} if output is None else {"output": output.to_dict()}),
        "params": model.params,
        "learned_in": [one.to_dict() for one in learned.learned_in],
        "numbers": [number.to_dict() for number in learned.numbers],
        "notes": list(learned.notes),
    }
    seen = f"{len(model.rest)} markers" if output is None else f"outputs {', '.join(output.names)}"
    lines = [
        f"{args.out}: rod model of '{model.robot}', {model.channels} channels in "
        f"{model.command_unit}, {seen}, own blocked cross-validation error "
        f"{model.vertex_error_mm:.2f} mm RMS (held out)"
    ]
    lines += _memory(learned, args.static)
    lines += [f"  {number}" for number in learned.numbers]
    lines += [next_command("diagnose", "ANOTHER_RUN", bundle=str(args.out))]
    print(json.dumps(result) if args.json else words_in_unit("\n".join(lines), output))
    for note in learned.notes:
        print(f"softmap learn: {words_in_unit(note, output)}", file=sys.stderr)
    return 0


def _memory(learned: LearnedRod, static: bool) -> list[str]:
    """Return the fitted memory effects as lines."""
    if static:
        return ["  memory: not tested (--static); `softmap diagnose` names it from a run"]
    if not learned.learned_in:
        return ["  memory: none found; the chain is empty"]
    return [f"  {line}" for one in learned.learned_in for line in str(one).splitlines()]


@dataclass(frozen=True)
class SweepOptions:
    """Options of `softmap model sweep`, as its parser declares them."""

    finger: str | None
    out: str
    steps: int | None
    dask: str | None
    chunk: int | None
    json: bool


def sweep_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `model sweep`."""
    parser.add_argument("finger", nargs="?", help="finger.toml (default: the built-in finger)")
    parser.add_argument(
        "--out",
        required=True,
        help=(
            "sweep to write: a file (.npz), or a Zarr store (.zarr); the same command continues a "
            f"store after an interruption, and at most one chunk is lost (a .zarr needs {TRAINING})"
        ),
    )
    parser.add_argument(
        "--steps", type=int, help="commands per channel (41; for three channels 13)"
    )
    parser.add_argument(
        "--dask",
        metavar="ADDRESS",
        help="of a Dask cluster's scheduler, tcp://HOST:8786, that solves the chunks",
    )
    parser.add_argument(
        "--chunk", type=int, metavar="ROWS", help="commands solved and stored together (256)"
    )


def sweep(args: SweepOptions) -> int:
    """Simulate a grid of commands and write commands and vertices."""
    from softmap_edge.fem.build import grid_axes, handles_of, simulator_of
    from softmap_edge.fem.doubts import doubts, lost_in_tendons

    _check_steps(args.steps)
    if Path(args.out).suffix == ".zarr":
        return _stored(args)
    if args.dask is not None or args.chunk is not None:
        raise SoftmapError(
            f"--out {args.out}: --dask and --chunk are for a store; give a name that ends in .zarr"
        )
    check_file("--out", args.out, ".npz")
    check_no_run("--out", args.out)
    finger = _finger(args.finger)
    axes = grid_axes(finger, args.steps)
    simulator = simulator_of(finger)
    handles_of(finger, simulator.template.vertices)  # `build` would reject its sweep
    with Bar(args.json) as bar:
        result = simulator.sweep(axes, progress=lambda share: bar("sweep", share))
    result.save(Path(args.out))
    document = {
        "schema": "softmap.sweep/1",
        "sweep": str(args.out),
        "commands": len(result.command),
        "failed": 0,
    }
    notes = [*doubts(finger), *filter(None, [lost_in_tendons(finger, result.command, result.pull)])]
    text = "\n".join(
        [
            f"{args.out}: {len(result.command)} commands, none failed",
            *(f"  look at: {n}" for n in notes),
            next_command("build", args.out, "--out", "model"),
        ]
    )
    print(json.dumps(document | {"notes": notes}) if args.json else text)
    return 0


def _stored(args: SweepOptions) -> int:
    """Simulate a grid of commands into a Zarr store, or resume one.

    The package softmap-training does this.
    """
    from softmap_edge.fem.build import grid_axes

    out = Path(args.out)
    if args.chunk is not None and args.chunk < 1:
        raise SoftmapError(f"--chunk {args.chunk}: give 1 command or more")
    if not out.parent.is_dir():
        raise SoftmapError(f"--out {args.out}: there is no folder {out.parent}; make it first")
    try:
        sweeps = import_module("softmap_training.sweeps")
    except ImportError as error:
        raise SoftmapError(
            f"--out {args.out}: a Zarr store is written by another package ({error}): {TRAINING}"
        ) from None
    finger = _finger(args.finger)
    axes = grid_axes(finger, args.steps)
    with Bar(args.json) as bar:
        store, solved = sweeps.sweep_to_zarr(
            finger, out, axes, args.chunk, args.dask, lambda share: bar("sweep", share)
        )
    count = len(store.command)
    document = {
        "schema": "softmap.sweep/1",
        "sweep": args.out,
        "commands": count,
        "failed": 0,
        "solved": solved,
        "chunks": len(store.done),
    }
    there = f", {count - solved} of them were there" if solved < count else ""
    after = next_command("train", "prior", args.out, "--out", "prior")
    text = f"{args.out}: {count} commands, none failed{there}\n{after}"
    print(json.dumps(document) if args.json else text)
    return 0


def _finger(path: str | None) -> Finger:
    return Finger.builtin() if path is None else Finger.load(Path(path))


def _check_steps(steps: int | None) -> None:
    if steps is not None and not 5 <= steps <= 201:
        raise SoftmapError(f"--steps {steps}: give 5 to 201 commands per channel")


def _interval(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        raise SoftmapError(f"--hold-out '{text}': expected T0:T1 in seconds, as 60:120") from None
    if not low < high:
        raise SoftmapError(
            f"--hold-out '{text}': it ends before it begins; give T0:T1 in seconds, as 60:120"
        )
    return low, high


def _span(t_seen: NDArray[np.float64]) -> str:
    return f"from {t_seen[0]:g} to {t_seen[-1]:g} s" if len(t_seen) else "at no time"
