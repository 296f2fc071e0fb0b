"""The verb evaluate: bundles and baselines on simulated shapes and on a recording, in one table each."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from softmap_edge import _core
from softmap_edge.commands.own import effects_argument, load_own, open_model
from softmap_edge.commands.progress import Bar
from softmap_edge.errors import SoftmapError
from softmap_edge.npz import read_npz
from softmap_training import choices
from softmap_training.baselines import NAMES, fit_baseline
from softmap_training.errors import TrainingError
from softmap_training.evaluate import PUBLISHED_REAL, SCHEMA, Row, fall, on_run, on_shapes

ALL = "all"
PAPER = (("deepsoro", "DeepSoRo"), ("without residual", "without residual"), ("with residual", "with residual"))


def evaluate_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `evaluate`."""
    parser.add_argument("bundles", nargs="*", metavar="BUNDLE", help="models to judge; the built-in finger without any")
    effects_argument(parser)
    parser.add_argument("--set", metavar="SET", help="simulated shapes (.zarr or .npz): judged on their test part")
    parser.add_argument("--run", metavar="RUN", help="a recording of clouds that taught nothing")
    parser.add_argument("--truth", metavar="FILE", help="its true vertices, of `softmap record --virtual --truth`")
    parser.add_argument(
        "--model", nargs="+", default=[], metavar="NAME", help=f"fit and judge beside them: {', '.join(NAMES)}, or all"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the baselines (0)")


def evaluate(args: argparse.Namespace) -> int:
    """Judge models and print their tables."""
    if args.set is None and args.run is None:
        raise TrainingError("nothing to judge on; give --set SET, --run RUN or both")
    if args.truth is not None and args.run is None:
        raise TrainingError("--truth goes with --run")
    asked = [*NAMES] if ALL in args.model else args.model
    if wrong := [name for name in asked if name not in NAMES]:
        raise TrainingError(f"--model {wrong[0]}: there are {', '.join(NAMES)}, and all")
    if asked and args.set is None:
        raise TrainingError("--model fits baselines to simulated shapes; give --set SET")
    load_own(args)
    models = {Path(path).name: open_model(path) for path in args.bundles} or {"built-in": open_model(None)}
    with Bar(args.json) as bar:
        shapes = [] if args.set is None else _on_set(args, models, asked, bar)
        seen = [] if args.run is None else _on_run(args, models, bar)
    document: dict[str, Any] = {
        "schema": SCHEMA,
        "simulated": [row.to_dict() for row in shapes],
        "recorded": [row.to_dict() for row in seen],
        "falls": _falls(seen),
        "paper": {"recorded": {n: {"chamfer_mm": {"mean": m, "sd": s}} for n, (m, s) in PUBLISHED_REAL.items()}},
    }
    print(json.dumps(document) if args.json else "\n".join(_lines(document)))
    return 0


def _on_set(args: argparse.Namespace, models: dict[str, Any], asked: list[Any], bar: Bar) -> list[Row]:
    from softmap_training.simulated import SimulatedSet

    data = SimulatedSet.load(args.set)
    parts = data.split(choices.SPLIT_SEED)
    every = data.shapes(np.arange(len(data.command))).reshape(len(data.command), -1).astype(np.float64)
    u, true = np.ascontiguousarray(data.command[parts.test]), every[parts.test]
    rows = []
    for name, model in models.items():
        if model.rest.size != true.shape[1] or model.channels != u.shape[1]:
            raise TrainingError(
                f"{name}: {model.channels} commands and {len(model.rest)} points, the set has {u.shape[1]} and "
                f"{true.shape[1] // 3}; judge it on a sweep of its own finger"
            )
        trained = dict(model.made_from.get("prior") or {})
        told = {"what": trained.get("kind", model.kind)}
        told |= {key: trained[key] for key in ("seconds", "parameters", "seed") if key in trained}
        rows.append(on_shapes(name + _nodes(model, u), model.prior.evaluate, u, true, told))
    for k, name in enumerate(asked):
        bar("baselines", k / len(asked))
        fitted = fit_baseline(name, np.ascontiguousarray(data.command[parts.train]), every[parts.train], args.seed)
        told = {"what": name, "seconds": fitted.seconds, "parameters": fitted.numbers, "seed": args.seed}
        rows.append(on_shapes(name, fitted.predict, u, true, told))
    return rows


def _nodes(model: Any, u: Any) -> str:
    """Return a remark for a table whose own nodes all these commands (n, C) are: it was told their shapes."""
    if not isinstance(model.prior, _core.Table):
        return ""
    near = [np.abs(u[:, c, None] - axis).min(axis=1).max() for c, axis in enumerate(model.prior.axes)]
    return " (told these shapes)" if max(near, default=1.0) < 1e-6 else ""


def _on_run(args: argparse.Namespace, models: dict[str, Any], bar: Bar) -> list[Row]:
    from softmap_edge.run import Run

    run = Run.load(args.run)
    truth = None if args.truth is None else read_npz(Path(args.truth), SoftmapError).get("vertices")
    if args.truth is not None and truth is None:
        raise TrainingError(f"{args.truth}: no `vertices` in it; give what `softmap record --virtual --truth` wrote")
    rows = []
    for k, (name, model) in enumerate(models.items()):
        bar("recording", k / len(models))
        if model.residual is not None:
            rows.append(on_run(f"{name}, without residual", model.with_residual(None), run, truth))
        rows.append(on_run(name, model, run, truth))
    return rows


def _falls(rows: list[Row]) -> list[dict[str, Any]]:
    """Return by what share each error falls with a residual, beside the paper's."""
    by_name = {row.name: row for row in rows}
    pairs = [(name, by_name.get(f"{name}, without residual"), row) for name, row in by_name.items()]
    return [
        {
            "name": name,
            **{f"{error}_share": fall(before, row, error) for error in row.errors},
            "paper_chamfer_share": 0.334,
        }
        for name, before, row in pairs
        if before is not None
    ]


def _lines(document: dict[str, Any]) -> list[str]:
    lines = []
    for title, key, errors in (
        ("Simulated shapes that taught nothing", "simulated", ("chamfer", "vertex")),
        ("Recording", "recorded", ("chamfer", "surface", "vertex")),
    ):
        rows = document[key]
        if not rows:
            continue
        there = [e for e in errors if f"{e}_mm" in rows[0]]
        lines += ["", f"{title} (mm, mean ± sd over frames)", f"  {'':<28}" + "".join(f"{e:>18}" for e in there)]
        for row in rows:
            cells = "".join(f"{row[f'{e}_mm']['mean']:>10.3f} ± {row[f'{e}_mm']['sd']:<5.3f}" for e in there)
            lines.append(f"  {row['name']:<28.28}{cells}" + _took(row))
            if row.get("paper"):
                cells = "".join(
                    f"{row['paper'][f'{e}_mm']['mean']:>10.3f} ± {row['paper'][f'{e}_mm']['sd']:<5.3f}" for e in there
                )
                lines.append(f"  {'   the paper, other data':<28}{cells}")
    if document["recorded"]:
        for name, said in PAPER:
            mean, sd = PUBLISHED_REAL[name]
            lines.append(f"  {'   the paper, other data: ' + said:<42}{mean:>7.3f} ± {sd:.3f} chamfer")
    for row in document["falls"]:
        shares = ", ".join(
            f"{key.removesuffix('_share')} {100 * v:.0f} %"
            for key, v in row.items()
            if key not in ("name", "paper_chamfer_share")
        )
        lines.append(f"  the residual of {row['name']} lowers {shares} (the paper: Chamfer 33 %)")
    return lines[1:]


def _took(row: dict[str, Any]) -> str:
    told = [f"{row['milliseconds']:.2f} ms"] if "milliseconds" in row else []
    told += [f"trained {row['seconds']:.0f} s"] if "seconds" in row else []
    told += [f"{row['parameters']} numbers"] if "parameters" in row else []
    return "   " + ", ".join(told) if told else ""
