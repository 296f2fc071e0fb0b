"""The command `train`: a prior from simulated shapes, a residual from a recording.

Both end in a bundle.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any, get_args

from softmap_edge.commands.output import bundle_arguments, check_bundle
from softmap_edge.commands.own import effects_argument, load_own, open_model
from softmap_edge.commands.progress import Bar
from softmap_edge.robot.drive.recorded import open_run
from softmap_training.baselines import NAMES as BASELINES
from softmap_training.choices import PriorKind, ResidualKind
from softmap_training.errors import TrainingError

FITTED = ("linear", *(name for name in BASELINES if name != "deepsoro"))  # at once, without epochs
WORK = ".training"  # what the folder of checkpoints and logs ends in, next to the bundle


def train_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `train`."""
    what = parser.add_subparsers(dest="what", required=True, metavar="WHAT")
    prior = what.add_parser("prior", help="from a simulated set: commands → shapes")
    prior.add_argument("set", help="simulated shapes of `softmap model sweep` (.zarr or .npz)")
    prior.add_argument(
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
    residual = what.add_parser(
        "residual", help="from a recording: what the model misses, by command"
    )
    residual.add_argument(
        "runs", nargs="+", metavar="run", help="recordings (.npz), clouds or vertices"
    )
    residual.add_argument(
        "--model",
        choices=get_args(ResidualKind),
        default="modes",
        help="ours (default), or the paper's network",
    )
    for one in (prior, residual):
        one.add_argument(
            "--bundle",
            metavar="DIR",
            help="the model that it joins; the built-in finger without it",
        )
        effects_argument(one)
        bundle_arguments(one)
        one.add_argument(
            "--work", metavar="DIR", help="checkpoints and log.csv; the bundle's name + .training"
        )
        one.add_argument("--epochs", type=int, help="another number of epochs")
        one.add_argument("--seed", type=int, help="draws the first weights and the order (0)")
        one.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="where to train")
        one.add_argument(
            "--tensorboard",
            action="store_true",
            help="write events for TensorBoard next to the log",
        )
        one.add_argument(
            "--json", action="store_true", default=argparse.SUPPRESS, help="print one document"
        )


def train(args: argparse.Namespace) -> int:
    """Train a network and write the bundle that holds it."""
    _check_fitted(args)
    torch = checked_torch()
    if args.device == "cuda" and not torch.cuda.is_available():
        raise TrainingError(
            "--device cuda: torch sees no GPU here; leave it out to train on the processor"
        )
    if args.epochs is not None and not 1 <= args.epochs <= 1_000_000:
        raise TrainingError(f"--epochs {args.epochs}: give 1 to 1000000")
    if args.seed is not None and not 0 <= args.seed < 2**32:
        raise TrainingError(f"--seed {args.seed}: give 0 to 4294967295")
    from softmap_edge.model.bundle import save_bundle

    check_bundle(args.out, args.force)
    load_own(args)
    base = open_model(args.bundle)
    work = None if args.model in FITTED else Path(args.work or f"{Path(args.out)}{WORK}")
    resumed = work is not None and any(work.rglob("checkpoint.pt"))
    with Bar(args.json) as bar:
        model, report = (_prior if args.what == "prior" else _residual)(args, base, work, bar)
    save_bundle(model, args.out)
    document = {
        "schema": "softmap.train/1",
        "bundle": args.out,
        "what": args.what,
        "resumed": resumed,
        **report,
    }
    document |= {} if work is None else {"work": str(work)}
    print(json.dumps(document) if args.json else _text(document))
    if args.what == "residual":
        return int(report["held_out_after_mm"] >= report["held_out_before_mm"])
    return 0


def _check_fitted(args: argparse.Namespace) -> None:
    """Refuse what a model that is fitted at once does not use."""
    given = {"--epochs": args.epochs, "--work": args.work, "--tensorboard": args.tensorboard}
    given |= {"--device": args.device if args.device != "cpu" else None}
    unused = [name for name, value in given.items() if value]
    if args.model in FITTED and unused:
        raise TrainingError(
            f"{', '.join(unused)}: '{args.model}' is fitted at once, without epochs; leave that out"
        )
    if args.model == "deepsoro" and (args.device != "cpu" or args.tensorboard):
        raise TrainingError(
            "'deepsoro' is trained on the processor, without TensorBoard; leave these out"
        )


def checked_torch() -> Any:
    """Return torch. Raises TrainingError when it or onnx is not installed."""
    try:
        import onnx  # noqa: F401
        import torch
    except ImportError:
        raise TrainingError(
            "torch or onnx is not installed: pip install 'softmap-training[torch]'"
        ) from None
    return torch


def _prior(
    args: argparse.Namespace, base: Any, work: Path | None, bar: Bar
) -> tuple[Any, dict[str, Any]]:
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
    args: argparse.Namespace, base: Any, work: Path | None, bar: Bar
) -> tuple[Any, dict[str, Any]]:
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
