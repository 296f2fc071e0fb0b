"""The command `train`: train a prior on simulated shapes, or a residual on a recording.

Both write a bundle.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from softmap_edge.commands.output import bundle_arguments, check_bundle, next_command
from softmap_edge.commands.own import effects_argument, load_own, open_model
from softmap_edge.commands.parser import Action, add_actions, run_action
from softmap_edge.commands.progress import Bar
from softmap_edge.model.model import Model
from softmap_edge.robot.drive.recorded import open_run
from softmap_training.baselines import NAMES as BASELINES
from softmap_training.choices import PriorKind, ResidualKind
from softmap_training.errors import TrainingError

FITTED = ("linear", *(name for name in BASELINES if name != "deepsoro"))  # fitted without epochs
WORK = ".training"  # suffix of the folder of checkpoints and logs, next to the bundle


@dataclass(frozen=True)
class _TrainOptions:
    """Options of both actions of `softmap train`."""

    bundle: str | None
    effects: list[str]
    trust_onnx: bool
    out: str
    force: bool
    work: str | None
    epochs: int | None
    seed: int | None
    device: str
    tensorboard: bool
    json: bool


@dataclass(frozen=True)
class PriorOptions(_TrainOptions):
    """Options of `softmap train prior`, as its parser declares them."""

    set: str
    model: str


@dataclass(frozen=True)
class ResidualOptions(_TrainOptions):
    """Options of `softmap train residual`, as its parser declares them."""

    runs: list[str]
    model: ResidualKind


def train_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `train` and of its actions."""
    add_actions(parser, ACTIONS)


def train(args: argparse.Namespace) -> int:
    """Train a prior or a residual network."""
    return run_action(ACTIONS, args)


def _prior_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("set", help="simulated shapes of `softmap model sweep` (.zarr or .npz)")
    parser.add_argument(
        "--model",
        choices=(*get_args(PriorKind), *BASELINES),
        default="modes",
        help=(
            "ours, to a few modes (default); the paper's network, with dropout or without; its "
            "layers to Laplacian coordinates or to rotations; least squares; as a table in the "
            "bundle: radial functions, a Gaussian process, boosted trees; a decoder whose points "
            "are its own (to compare in `softmap track --table`)"
        ),
    )
    _shared_arguments(parser)


def _residual_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "runs", nargs="+", metavar="run", help="recordings (.npz), clouds or vertices"
    )
    parser.add_argument(
        "--model",
        choices=get_args(ResidualKind),
        default="modes",
        help="ours (default), or the paper's network",
    )
    _shared_arguments(parser)


def _shared_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--bundle", metavar="DIR", help="the model that it joins; the built-in finger without it"
    )
    effects_argument(parser)
    bundle_arguments(parser)
    parser.add_argument(
        "--work", metavar="DIR", help="checkpoints and log.csv; the bundle's name + .training"
    )
    parser.add_argument("--epochs", type=int, help="another number of epochs")
    parser.add_argument("--seed", type=int, help="draws the first weights and the order (0)")
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="where to train")
    parser.add_argument(
        "--tensorboard", action="store_true", help="write events for TensorBoard next to the log"
    )


def _train_prior(args: PriorOptions) -> int:
    """Train a prior and write its bundle."""
    if args.model in FITTED:
        _check_fitted(args, args.model)
    if args.model == "deepsoro" and (args.device != "cpu" or args.tensorboard):
        raise TrainingError(
            "'deepsoro' is trained on the processor, without TensorBoard; leave these out"
        )
    base = _opened(args)
    work = None if args.model in FITTED else _work_of(args)
    resumed = _has_checkpoint(work)
    with Bar(args.json) as bar:
        model, report = _prior(args, base, work, bar)
    _write(args, "prior", model, report, work, resumed)
    return 0


def _train_residual(args: ResidualOptions) -> int:
    """Train a residual and write its bundle; return 1 if it does not lower the error."""
    base = _opened(args)
    work = _work_of(args)
    resumed = _has_checkpoint(work)
    with Bar(args.json) as bar:
        model, report = _residual(args, base, work, bar)
    _write(args, "residual", model, report, work, resumed)
    return int(report["held_out_after_mm"] >= report["held_out_before_mm"])


ACTIONS: dict[str, Action] = {
    "prior": Action(
        "from a simulated set: commands → shapes", _prior_arguments, _train_prior, PriorOptions
    ),
    "residual": Action(
        "from a recording: what the model misses, by command",
        _residual_arguments,
        _train_residual,
        ResidualOptions,
    ),
}


def _opened(args: _TrainOptions) -> Model:
    """Check the options and return the model that the network is added to."""
    torch = checked_torch()
    if args.device == "cuda" and not torch.cuda.is_available():
        raise TrainingError(
            "--device cuda: torch sees no GPU here; leave it out to train on the processor"
        )
    if args.epochs is not None and not 1 <= args.epochs <= 1_000_000:
        raise TrainingError(f"--epochs {args.epochs}: give 1 to 1000000")
    if args.seed is not None and not 0 <= args.seed < 2**32:
        raise TrainingError(f"--seed {args.seed}: give 0 to 4294967295")
    check_bundle(args.out, args.force)
    load_own(args)
    return open_model(args.bundle)


def _check_fitted(args: _TrainOptions, model: str) -> None:
    """Reject options that a directly fitted model does not use."""
    given = {"--epochs": args.epochs, "--work": args.work, "--tensorboard": args.tensorboard}
    given |= {"--device": args.device if args.device != "cpu" else None}
    unused = [name for name, value in given.items() if value]
    if unused:
        raise TrainingError(
            f"{', '.join(unused)}: '{model}' is fitted at once, without epochs; leave that out"
        )


def _work_of(args: _TrainOptions) -> Path:
    return Path(args.work or f"{Path(args.out)}{WORK}")


def _has_checkpoint(work: Path | None) -> bool:
    return work is not None and any(work.rglob("checkpoint.pt"))


def _write(
    args: _TrainOptions,
    what: str,
    model: Model,
    report: dict[str, Any],
    work: Path | None,
    resumed: bool,
) -> None:
    """Save the bundle and print the report."""
    from softmap_edge.model.bundle import save_bundle

    save_bundle(model, args.out)
    document = {
        "schema": "softmap.train/1",
        "bundle": args.out,
        "what": what,
        "resumed": resumed,
        **report,
    }
    document |= {} if work is None else {"work": str(work)}
    after = next_command(
        *(("compare", "RUN") if what == "residual" else ("evaluate", args.out, "--set", "SET")),
        bundle=args.out if what == "residual" else None,
    )
    print(json.dumps(document) if args.json else f"{_text(document)}\n{after}")


def checked_torch() -> Any:
    """Return torch. Raises TrainingError if it or onnx is not installed."""
    try:
        import onnx  # noqa: F401
        import torch
    except ImportError:
        raise TrainingError(
            "torch or onnx is not installed: pip install 'softmap-training[torch]'"
        ) from None
    return torch


def _prior(
    args: PriorOptions, base: Model, work: Path | None, bar: Bar
) -> tuple[Model, dict[str, Any]]:
    from softmap_training import choices
    from softmap_training.prior import (
        Surface,
        check_set,
        decoder_model,
        fit_prior,
        train_prior,
        with_prior,
    )
    from softmap_training.simulated import SimulatedSet

    data = SimulatedSet.load(args.set)
    parts = data.split(choices.SPLIT_SEED)
    points = data.shapes(range(len(data.command))).reshape(len(data.command), -1).astype(float)
    check_set(base, data.command, points)
    split, test_part = (
        (parts.train, parts.validation, parts.test),
        (data.command[parts.test], points[parts.test]),
    )
    if args.model == "deepsoro":
        return decoder_model(
            base,
            data.command,
            points,
            split,
            args.epochs,
            args.seed or 0,
            work,
            lambda share: bar("training", share),
        )
    if args.model in BASELINES:
        fitted = fit_prior(base, data.command, points, split, args.model, args.seed or 0)
        return with_prior(base, fitted, *test_part), fitted.report
    recipe = choices.prior_recipe(args.model)
    trained = train_prior(
        data.command,
        points,
        split,
        args.model,
        Surface.of(base),
        recipe.with_(epochs=args.epochs, seed=args.seed),
        work,
        lambda share, line: bar("training", share),
        args.device,
        args.tensorboard,
    )
    return with_prior(base, trained, *test_part), trained.report


def _residual(
    args: ResidualOptions, base: Model, work: Path | None, bar: Bar
) -> tuple[Model, dict[str, Any]]:
    from softmap_training import choices
    from softmap_training.residual import train_residual

    recipe = choices.residual_recipe(args.model)
    runs = [open_run(path, base) for path in args.runs]
    return train_residual(
        base,
        runs,
        args.model,
        recipe.with_(epochs=args.epochs, seed=args.seed),
        work,
        lambda share, line: bar("training", share),
        args.device,
        args.tensorboard,
    )


def _text(document: dict[str, Any]) -> str:
    """Return the report of a training for a terminal."""
    head, took = f"{document['bundle']}: {document['what']}", f"{document['seconds']:.0f} s"
    lines = [f"{head} table ({document['kind']}), {took}"]
    if "parity_mm" in document:
        done, planned = document["epochs"], document["planned_epochs"]
        epochs = (
            f"{done} epochs"
            if done == planned
            else f"{done} of {planned} epochs (more help no held-out frame)"
        )
        lines = [
            f"{head} network ({document['kind']}), {epochs} in {took}; torch, onnxruntime and the "
            f"core agree to {document['parity_mm']:.1g} mm"
        ]
    if document["kind"] == "deepsoro":
        lines = [
            f"{head} decoder in the manner of DeepSoRo, {took}; it is read through onnxruntime, "
            f"as a table that is {document['table_off_mm']:.1g} mm off it",
            f"  {document['test_chamfer_mm']:.2f} mm Chamfer distance from the simulated vertices "
            f"(both directions, test part, held out); {document['parameters']} numbers learned "
            f"from {document['samples']} shapes. Its points are no vertices: it is compared with "
            "models in `softmap track --table`",
        ]
    elif document["what"] == "prior":
        lines.append(
            f"  {document['test_vertex_mm']:.3f} mm from the simulated vertices, mean of the test "
            f"part (held out); {document['parameters']} numbers learned from "
            f"{document['samples']} shapes"
        )
    else:
        lines.append(
            f"  {document['held_out_before_mm']:.2f} mm without it, "
            f"{document['held_out_after_mm']:.2f} mm with it (mean distance from the vertices "
            f"that were seen, held-out frames); learned from {document['frames']} frames; moves "
            f"what the clamp holds by {document['clamp_moves_mm']:.2f} mm"
        )
        lines += [f"  look at: {text}" for text in document["warnings"]]
        if document["held_out_after_mm"] >= document["held_out_before_mm"]:
            lines.append("  look at: it does not lower the error of what was held out")
    if document["resumed"]:
        lines.append(f"  went on from what a training before had left in {document['work']}")
    return "\n".join(lines)
