"""The command `evaluate`: bundles and fitted regressors, on simulated shapes and a recording."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from softmap_edge.calibration.matching import match
from softmap_edge.commands.output import check_file
from softmap_edge.commands.own import effects_argument, load_own, open_model
from softmap_edge.commands.progress import Bar
from softmap_edge.errors import SoftmapError
from softmap_edge.files.npz import read_npz
from softmap_edge.model.model import Model
from softmap_edge.model.training_range import command_extrapolation, shape_mismatch
from softmap_edge.robot.drive.recorded import open_run
from softmap_edge.run.run import Run
from softmap_edge.version import __version__
from softmap_training import choices
from softmap_training.baselines import NAMES as BASELINES
from softmap_training.choices import ResidualKind
from softmap_training.errors import TrainingError
from softmap_training.evaluate import (
    FALLS,
    PUBLISHED_REAL,
    SCHEMA,
    Recording,
    Row,
    fall,
    halfway,
    holds_shapes_of,
    is_decoder,
    on_shapes,
    size_of,
)
from softmap_training.evaluate_text import lines, samples
from softmap_training.train_command import checked_torch

if TYPE_CHECKING:
    from softmap_training.contenders import Plan

ALL = "all"
MODELS = (*choices.PRIORS, *BASELINES)
MOST_SEEDS = 100
WITHOUT = ", without residual"
BETWEEN = "given all nodes of its grid, so validated halfway between them"


@dataclass(frozen=True)
class EvaluateOptions:
    """Options of `softmap evaluate`, as its parser declares them."""

    bundles: list[str]
    effects: list[str]
    trust_onnx: bool
    set: str | None
    model: list[str]
    run: str | None
    truth: str | None
    train: list[str]
    residual: list[ResidualKind]
    no_decoder: bool
    seed: int
    seeds: int
    epochs: int | None
    work: str | None
    html: str | None
    json: bool


def evaluate_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `evaluate`."""
    parser.add_argument(
        "bundles",
        nargs="*",
        metavar="BUNDLE",
        help="models to validate; the built-in finger without any",
    )
    effects_argument(parser)
    parser.add_argument(
        "--set",
        metavar="SET",
        help="simulated shapes (.zarr or .npz): validated on their test part",
    )
    parser.add_argument(
        "--model",
        nargs="+",
        default=[],
        metavar="NAME",
        help=f"fit to the rest of the set and validate alongside: {', '.join(MODELS)}, or all",
    )
    parser.add_argument("--run", metavar="RUN", help="a recording of clouds that taught nothing")
    parser.add_argument(
        "--truth", metavar="FILE", help="its true vertices, of `softmap record --virtual --truth`"
    )
    parser.add_argument(
        "--train",
        nargs="+",
        default=[],
        metavar="RUN",
        help=(
            "recordings of clouds that teach a decoder, and residuals on the first BUNDLE from "
            "growing parts of them"
        ),
    )
    parser.add_argument(
        "--residual",
        nargs="+",
        choices=choices.RESIDUALS,
        default=list(choices.RESIDUALS),
        help="which of these residuals to train: ours (modes), the published one; both without it",
    )
    parser.add_argument(
        "--no-decoder", action="store_true", help="no decoder alongside; it takes longest"
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="the first that draws what is fitted here (0)"
    )
    parser.add_argument(
        "--seeds", type=int, default=1, help="how many: mean ± standard deviation over them (1)"
    )
    parser.add_argument(
        "--epochs", type=int, help="another number of epochs for the networks that are trained here"
    )
    parser.add_argument(
        "--work", metavar="DIR", help="keep checkpoints there: after a kill the same line goes on"
    )
    parser.add_argument(
        "--html",
        metavar="FILE.html",
        help="write a page of tables and pictures; pictures need softmap-edge[report]",
    )


def evaluate(args: EvaluateOptions) -> int:
    """Evaluate models and print their tables."""
    asked = _checked(args)
    load_own(args)
    names = [Path(path).name for path in args.bundles]
    if len(set(names)) < len(names):
        raise TrainingError(
            f"bundles {', '.join(names)}: two of one name would be one row; rename one of the "
            "folders"
        )
    models = {Path(path).name: open_model(path) for path in args.bundles} or {
        "built-in": open_model(None)
    }
    shapes: list[Row] = []
    seen: list[Row] = []
    curve: list[Row] = []
    warnings: list[str] = []
    run = None
    made_from: dict[str, Any] = {"softmap-edge": __version__, "seeds": _seeds(args)}
    with Bar(args.json) as bar:
        if args.set is not None:
            shapes = _on_set(args, models, asked, bar, warnings)
            made_from["set"] = args.set
        if args.run is not None:
            first = next(iter(models.values()))
            run, taught = open_run(args.run, first), [open_run(path, first) for path in args.train]
            seen, curve = _on_run(args, models, run, taught, bar, warnings)
            made_from |= {"run": run.hash(), "train": [one.hash() for one in taught]}
    warnings = list(dict.fromkeys(warnings))
    document: dict[str, Any] = {
        "schema": SCHEMA,
        "simulated": [row.to_dict() for row in shapes],
        "recorded": [row.to_dict() for row in seen],
        "falls": _falls(seen),
        "samples": [row.to_dict() for row in curve],
        "paper": {
            "recorded": {
                n: {"chamfer_mm": {"mean": m, "sd": s}} for n, (m, s) in PUBLISHED_REAL.items()
            }
        },
        "warnings": warnings,
        "made_from": made_from,
    }
    if args.html is not None:
        from softmap_training.evaluate_page import write_page

        write_page(
            args.html,
            document,
            shapes,
            seen,
            curve,
            None if run is None else np.asarray(run.t_seen),
        )
    print(
        json.dumps(document)
        if args.json
        else "\n".join([*lines(document), *(f"  ! {w}" for w in warnings)])
    )
    return 0


def _checked(args: EvaluateOptions) -> list[str]:
    """Check the options, and return the models to fit to the set."""
    if args.set is None and args.run is None:
        raise TrainingError("nothing to validate on; give --set SET, --run RUN or both")
    for name, given in (("truth", args.truth), ("train", args.train)):
        if given and args.run is None:
            raise TrainingError(f"--{name} goes with --run")
    asked = [*MODELS] if ALL in args.model else args.model
    if wrong := [name for name in asked if name not in MODELS]:
        raise TrainingError(f"--model {wrong[0]}: there are {', '.join(MODELS)}, and all")
    if asked and args.set is None:
        raise TrainingError("--model fits models to simulated shapes; give --set SET")
    for name, value, low, high in (
        ("seeds", args.seeds, 1, MOST_SEEDS),
        ("epochs", args.epochs, 1, 1_000_000),
        ("seed", args.seed, 0, 2**32 - MOST_SEEDS),
    ):
        if value is not None and not low <= value <= high:
            raise TrainingError(f"--{name} {value}: give {low} to {high}")
    check_file("--html", args.html, ".html")
    if asked or args.train:
        checked_torch()
    return list(asked)


def _first(models: dict[str, Model], what: str) -> tuple[str, Any]:
    """Return the first model whose points are vertices of the finger.

    Raises:
        TrainingError: all are decoders.
    """
    found = next(((name, model) for name, model in models.items() if not is_decoder(model)), None)
    if found is None:
        raise TrainingError(
            f"{what} needs the finger's own vertices, and {', '.join(models)} has points of its "
            "own (a decoder); give a bundle of the finger too"
        )
    return found


def _seeds(args: EvaluateOptions) -> list[int]:
    return list(range(args.seed, args.seed + args.seeds))


def _plan(args: EvaluateOptions) -> Plan:
    from softmap_training.contenders import Plan

    return Plan(tuple(_seeds(args)), args.epochs, None if args.work is None else Path(args.work))


def _on_set(
    args: EvaluateOptions,
    models: dict[str, Model],
    asked: list[str],
    bar: Callable[[str, float], None],
    warnings: list[str],
) -> list[Row]:
    from softmap_edge.fem.finger import Finger
    from softmap_training.simulated import SimulatedSet

    data = SimulatedSet.load(args.set)
    test = data.split(choices.SPLIT_SEED).test
    u, true = (
        np.ascontiguousarray(data.command[test]),
        data.shapes(test).reshape(len(test), -1).astype(np.float64),
    )
    rows = []
    for k, (name, model) in enumerate(models.items()):
        bar("simulated", k / len(models))
        if model.rest.size != true.shape[1] or model.channels != u.shape[1]:
            raise TrainingError(
                f"{name}: {model.channels} commands and {len(model.rest)} points, the set has "
                f"{u.shape[1]} and {true.shape[1] // 3}; recording it on a sweep of its own finger"
            )
        trained = dict(model.made_from.get("prior") or {})
        details = {
            "what": trained.get("kind", model.kind),
            "parameters": size_of(model.with_residual(None)),
        }
        details |= {key: trained[key] for key in ("seconds", "seed") if key in trained}
        at, shapes = u, true
        if holds_shapes_of(model, u):
            at, shapes = halfway(model, u, Finger.from_toml(data.finger))
            details["judged"] = BETWEEN
        t = np.arange(float(len(at)))
        name, base = name + ("" if model.residual is None else WITHOUT), model.with_residual(None)
        asked_for = Run(t=t, command=at, t_seen=t, command_unit=model.command_unit)
        warnings += [f"{name}: {note}" for note in command_extrapolation(base, asked_for)]
        rows.append(on_shapes(name, model.prior.evaluate, at, shapes, details, model.triangles))
    if not asked:
        return rows
    from softmap_training.contenders import fitted_to_set
    from softmap_training.prior import Surface

    surface = Surface.of(_first(models, "--model")[1])
    return rows + [fitted_to_set(name, data, surface, _plan(args), bar) for name in asked]


def _on_run(
    args: EvaluateOptions,
    models: dict[str, Model],
    run: Run,
    taught: list[Run],
    bar: Callable[[str, float], None],
    warnings: list[str],
) -> tuple[list[Row], list[Row]]:
    """Return the rows of the recording, and those of residuals from growing training parts."""
    from softmap_training.contenders import decoder, residuals, took
    from softmap_training.recordings import Lesson

    truth = None if args.truth is None else read_npz(Path(args.truth), SoftmapError).get("vertices")
    if args.truth is not None and truth is None:
        raise TrainingError(
            f"{args.truth}: no `vertices` in it; give what `softmap record --virtual --truth` wrote"
        )
    bar("registering", 0.0)
    first, model = _first(models, "--run")
    recording = Recording.of(run, model, truth)
    warnings += [f"--run: {note}" for note in recording.remarks]
    warnings += [
        f"{first}: {note}" for note in shape_mismatch(model, match(model, recording.laid).mae_mm)
    ]
    rows: list[Row] = []
    curve: list[Row] = []
    for k, (name, one) in enumerate(models.items()):
        bar("recording", k / len(models))
        warnings += [f"{name}: {note}" for note in command_extrapolation(one, run)]
        base, trained = one.with_residual(None), one.made_from.get("prior") or {}
        what = "deepsoro" if is_decoder(one) else "without residual"
        details = took(base) | {"what": what, "base": name}
        details |= {key: trained[key] for key in ("seconds", "seed") if key in trained}
        rows.append(recording.evaluate(name if is_decoder(one) else name + WITHOUT, base, details))
        if one.residual is not None:
            details = took(one) | {"what": "with residual", "base": name}
            learned = one.made_from.get("residual") or {}
            details |= {
                key: learned[key] for key in ("seconds", "seed", "frames") if key in learned
            }
            rows.append(recording.evaluate(name, one, details))
    if not taught:
        return rows, curve
    lesson = Lesson.of(model, taught)
    if not lesson.of_clouds:
        raise TrainingError(
            "--train: a run without clouds (`points`, `start`); give recordings of clouds"
        )
    warnings += [f"--train: {note}" for note in lesson.remarks]
    if args.epochs is not None:
        warnings.append(
            f"--epochs {args.epochs}: what is trained here has other epochs than its recipe asks "
            "for"
        )
    if not args.no_decoder:
        rows.insert(0, decoder(lesson, recording, _plan(args), bar))
    for kind in dict.fromkeys(args.residual):
        parts = residuals(lesson, recording, kind, _plan(args), bar)
        for row in parts:
            row.details["base"] = first
            warnings += [
                f"{samples(row.details | {'name': row.name})}: {note}"
                for note in row.details["outside"]
            ]
        curve += parts
        rows.append(parts[-1])
    return rows, curve


def _falls(rows: list[Row]) -> list[dict[str, Any]]:
    """Return the relative fall of each error with a residual, and the paper's.

    The fall is relative to no residual and to the decoder.
    """
    found = []
    for row in rows:
        if row.details["what"] != "with residual":
            continue
        for other in rows:
            what = other.details["what"]
            if (
                what == "deepsoro"
                or what == "without residual"
                and other.details["base"] == row.details["base"]
            ):
                shares = {f"{error}_share": share for error, share in fall(other, row).items()}
                details = {"name": row.name, "against": other.name, "what": what}
                found.append(details | shares | {"paper_chamfer_share": FALLS[what]})
    return found
