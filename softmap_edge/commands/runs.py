"""Commands about files: import (logs → run, or a proposed mapping), check and show."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.checks.advice_text import effect_lines
from softmap_edge.checks.summary import SCHEMA, summary
from softmap_edge.checks.summary_text import sentences
from softmap_edge.commands.output import check_file, check_kept, check_no_run, next_command
from softmap_edge.commands.own import effects_argument, load_own, open_model
from softmap_edge.errors import RunError, SoftmapError, SweepError
from softmap_edge.files.atomic import Document, write_atomically
from softmap_edge.files.npz import read_npz
from softmap_edge.files.printable import one_line, plain_line, shortened
from softmap_edge.logs.importer import import_logs, read_mapping
from softmap_edge.model.bundle import load_chain
from softmap_edge.model.manifest import load_manifest
from softmap_edge.model.onnx import compare_with_onnxruntime
from softmap_edge.model.user_effect import loaded
from softmap_edge.robot.drive.recorded import open_incomplete, open_run
from softmap_edge.run.run import Run
from softmap_edge.sweep.summary import read_summary
from softmap_edge.sweep.summary import sentences as sweep_sentences
from softmap_edge.sweep.sweep_file import LIMIT, is_shape_sweep

Floats = NDArray[np.float64]

DONE, FAULT = 0, 1
_BARS = "▁▂▃▄▅▆▇█"
_WIDTH = 48  # characters of a trace


@dataclass(frozen=True)
class ImportOptions:
    """Options of `softmap import`, as its parser declares them."""

    logs: list[str]
    map: str | None
    guess: bool
    out: str | None
    force: bool
    json: bool


def import_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `import`."""
    parser.add_argument(
        "logs",
        nargs="+",
        metavar="LOG",
        help=(
            "the logs of one recording (CSV, TRC, C3D, MCAP, .db3, .mat, .npz, Parquet), or its "
            "folder"
        ),
    )
    how = parser.add_mutually_exclusive_group(required=True)
    how.add_argument(
        "--map", help="mapping file (docs/reference/mapping.md; examples/trunk.toml is one)"
    )
    how.add_argument(
        "--guess", action="store_true", help="propose a mapping from the header and the ranges"
    )
    parser.add_argument(
        "--out",
        help="the run to write (.npz); with --guess the mapping (.toml), else it is printed",
    )
    parser.add_argument(
        "--force",
        action="store_true",
        help="overwrite an existing run, or with --guess an existing mapping",
    )


def import_(args: ImportOptions) -> int:
    """Read logs by a mapping and write a run, or propose the mapping."""
    if args.guess or args.map is None:  # the parser requires one of them
        return _guess(args)
    if args.out is None:
        raise RunError("--out is missing; name the run to write (.npz)")
    check_file("--out", args.out, ".npz")
    check_no_run("--out", args.out, args.force)
    imported = import_logs(args.logs, read_mapping(args.map))
    run = imported.run
    run.save(args.out)
    document = {
        "schema": "softmap.import/1",
        "out": args.out,
        "rows": len(run.t),
        "channels": run.channels,
        "frames": run.frames,
        "notes": list(imported.notes),
        "doubts": list(imported.doubts),
        "damage": list(imported.damage),
        "hash": run.hash(),
    }
    if args.json:
        print(json.dumps(document, ensure_ascii=False))
    else:
        lines = [
            *(f"  {note}" for note in imported.notes),
            *(f"  look at: {doubt}" for doubt in imported.doubts),
        ]
        after = next_command("check", str(args.out))
        print("\n".join([str(run), *lines, f"written to {args.out}", after]))
    return DONE


def _guess(args: ImportOptions) -> int:
    from softmap_edge.logs.guess import guess_mapping

    check_file("--out", args.out, ".toml")
    if args.out is not None:
        check_kept(args.out, "a mapping", args.force)
    found = guess_mapping(args.logs)
    if args.out is not None:
        write_atomically(args.out, found.text)
    if args.json:
        print(json.dumps(found.to_dict() | {"out": args.out}, ensure_ascii=False))
        return DONE
    if args.out is None:
        print("\n".join([found.text, *(f"# the import says: {line}" for line in found.said)]))
        return DONE
    lines = [
        *(f"assumed   {line}" for line in found.assumed),
        *(f"unknown   {line}" for line in found.unknown),
    ]
    lines += [f"tried     {line}" for line in found.said]
    print(
        "\n".join(
            [
                *lines,
                f"written to {args.out}: read it and put right what is wrong",
                next_command("import", *args.logs, "--map", args.out, "--out", "run.npz"),
            ]
        )
    )
    return DONE


@dataclass(frozen=True)
class CheckOptions:
    """Options of `softmap check`, as its parser declares them."""

    path: str
    bundle: str | None
    effects: list[str]
    trust_onnx: bool
    json: bool


def check_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `check`."""
    parser.add_argument("path", help="a run (.npz or .mcap), a sweep (.npz) or a bundle folder")
    parser.add_argument(
        "--bundle",
        metavar="DIR",
        help="of a run: report which effects are detectable with this model",
    )
    effects_argument(parser)


def check(args: CheckOptions) -> int:
    """Check whether a run or bundle is valid, and print its content; return 0 if valid, else 1."""
    path = _existing(args.path)
    load_own(args)
    kind = _kind_of(path)
    document: Document = {"schema": SCHEMA, "path": str(path), "kind": kind}
    found: Document = {}
    lines: list[str] = []
    try:
        if kind == "run":
            found, lines = _run(path, args.bundle)
        elif kind == "bundle":
            found = _bundle(path) | _compared_networks(path)
            lines = _bundle_lines(document | found)
        else:
            found = read_summary(path)
            lines = sweep_sentences(found)
        faults = [
            *found.get("not_seen", []),
            *found.get("unseen_parts", []),
            *(found[key] for key in ("unanswered", "fault") if found.get(key)),
        ]
        document |= found | {"sound": not faults, "fault": "; ".join(faults) or None}
    except SoftmapError as fault:
        document |= {"sound": False, "fault": str(fault)}
    if args.json:
        print(json.dumps(document, ensure_ascii=False))
        return DONE if document["sound"] else FAULT
    if document["fault"]:
        print(f"not sound: {document['fault']}", file=sys.stderr)
    if found:  # the readable part, also of a damaged or truncated recording
        state = _state_of(document, found)
        lines += [_after_check(path, kind, args.bundle)] if document["sound"] else []
        print("\n".join([f"{state:<10}{path}", *lines]))
    return DONE if document["sound"] else FAULT


def _kind_of(path: Path) -> str:
    """Return whether a file is a bundle, a sweep or a run."""
    if path.is_dir():
        return "bundle"
    return "sweep" if is_shape_sweep(path) else "run"


def _state_of(document: Document, found: Document) -> str:
    if document["sound"]:
        return "sound"
    return "damaged" if found.get("fault") else "not sound"


def _after_check(path: Path, kind: str, bundle: str | None) -> str:
    """Return the next command for a valid file: compare, build from a sweep, or learn."""
    from softmap_edge.fem.finger import Finger

    if kind == "sweep":
        return next_command("build", str(path), "--out", "model")
    if kind == "bundle":
        return next_command("compare", "RUN", bundle=str(path))
    run = open_run(path)
    if not run.channels or len(run.t) < 2:
        return next_command("show", str(path))  # nothing is learned or compared without commands
    if bundle is None and run.robot != Finger.builtin().name:
        if run.markers is None:
            return next_command("show", str(path))
        return next_command("learn", str(path), "--out", "model")
    return next_command("compare", str(path), bundle=bundle)


@dataclass(frozen=True)
class ShowOptions:
    """Options of `softmap show`, as its parser declares them."""

    path: str
    effects: list[str]
    trust_onnx: bool
    json: bool


def show_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `show`."""
    parser.add_argument("path", help="a run (.npz or .mcap), a sweep (.npz) or a bundle folder")
    effects_argument(parser)


def show(args: ShowOptions) -> int:
    """Print the content of a run (fields, traces) or a bundle (manifest).

    Code in a bundle is not run.
    """
    path = _existing(args.path)
    load_own(args)
    if path.is_dir():
        document = {
            "schema": "softmap.show/1",
            "path": str(path),
            "kind": "bundle",
            **_bundle(path, asking=False),
        }
        print(
            json.dumps(document, ensure_ascii=False)
            if args.json
            else "\n".join([*_bundle_lines(document), next_command("check", str(path))])
        )
        return DONE
    sweep = is_shape_sweep(path)
    run = None if sweep else open_run(path)
    arrays = read_npz(path, SweepError, LIMIT) if run is None else run.arrays()
    if run is not None and run.output is not None:  # as measured, not as markers
        arrays = {"output" if name == "markers" else name: array for name, array in arrays.items()}
        arrays["output"] = run.outputs
    fields = [_field(name, array) for name, array in arrays.items()]
    if args.json:
        kind = "sweep" if sweep else "run"
        print(
            json.dumps(
                {"schema": "softmap.show/1", "path": str(path), "kind": kind, "fields": fields}
            )
        )
        return DONE
    print("\n".join(sweep_sentences(read_summary(path))) if run is None else run)
    for field in fields:
        span = "" if field["low"] is None else f"{field['low']:g} to {field['high']:g}"
        name = shortened(one_line(field["name"]), 60)
        print(
            f"  {name:<14} {field['shape']!s:<16} {field['type']:<8} "
            f"{span or one_line(field['text'] or '')}"
        )
    for label, values in [] if run is None else _traces(run):
        print(f"  {label:<14} {_trace(values)}")
    print(next_command("check", str(path)))
    return DONE


def _existing(path: str) -> Path:
    if not Path(path).exists():
        raise RunError(f"{path}: no such file or folder; give a run (.npz) or a bundle folder")
    return Path(path)


def _run(path: Path, bundle: str | None) -> tuple[Document, list[str]]:
    """Return the summary of a run as a document, and as text."""
    model = None if bundle is None else open_model(bundle)
    run, fault = open_incomplete(path, model)
    contents = summary(run, model)
    document, lines = contents.to_dict() | {"fault": fault}, sentences(contents)
    if model is not None:
        from softmap_edge.diagnosis.diagnose import showing

        effects = showing(model, run)
        document["effects"] = effects
        lines += effect_lines(effects)
    return document, lines


def _bundle(path: Path, asking: bool = True) -> Document:
    """Return manifest and chain; code is not loaded unless `asking`."""
    manifest = load_manifest(path)
    if not asking and set(manifest.get("own_effects", {})) - set(loaded()):
        names, params = load_chain(path)
        return {"manifest": manifest, "effects": names, "params": params}
    model = open_model(str(path))
    chain = {"effects": list(model.chain_names), "params": model.params}
    calibration = {} if model.calibration is None else {"calibration": model.calibration.to_dict()}
    tables = {
        key: model.made_from[key] for key in ("through_onnxruntime",) if key in model.made_from
    }
    return {"manifest": manifest, **chain, **calibration, **tables}


def _compared_networks(path: Path) -> Document:
    """Compare a bundle's networks in the core with onnxruntime; return nothing if it has none."""
    manifest = load_manifest(path)
    between = np.array(manifest["command_range"], float).reshape(-1, 2)
    apart = {}
    for name in ("prior.onnx", "residual.onnx"):
        if name in manifest["sha256"]:
            content = (path / name).read_bytes()
            try:
                _core.Network(content)
            except SoftmapError:  # the network is a table computed with onnxruntime
                continue
            apart[name.removesuffix(".onnx")] = compare_with_onnxruntime(name, content, between)
    return {"differs_from_onnxruntime_mm": apart} if apart else {}


def _bundle_lines(document: Document) -> list[str]:
    manifest = document["manifest"]
    shown = {k: v for k, v in manifest.items() if k != "sha256"} | {
        "effects": document["effects"] or "none"
    }
    if found := document.get("calibration"):
        shown["calibration"] = {key: found[key] for key in ("A", "b", "home", "condition")}
    lines = [f"{key:<18} {_plain(value)}" for key, value in shown.items()]
    for name, found in document.get("through_onnxruntime", {}).items():
        lines.append(
            f"{'onnxruntime':<18} the {name} is a table of what onnxruntime makes of its graph, "
            f"{found['table_off_mm']:.2g} mm off between the nodes (RMS): {found['why']}"
        )
    for name, apart in document.get("differs_from_onnxruntime_mm", {}).items():
        compared = (
            "not compared, onnxruntime is not installed"
            if apart is None
            else f"differs by {apart:.1g} mm"
        )
        lines.append(f"{'onnxruntime':<18} the {name} network: {compared}")
    for name in manifest.get("own_effects", {}):
        file = Path(document["path"]) / f"{name}.py"
        lines.append(
            f"{'code':<18} the effect {name} is Python code, {file}: read it, then allow it with "
            f"--effects {file}"
        )
    return [plain_line(line) for line in lines]


def _plain(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _field(name: str, array: NDArray[np.generic]) -> Document:
    finite = array[np.isfinite(array)] if array.dtype.kind == "f" else array
    numbers = array.dtype.kind in "biuf" and finite.size > 0
    return {
        "name": name,
        "shape": list(array.shape),
        "type": str(array.dtype),
        "low": float(finite.min()) if numbers else None,
        "high": float(finite.max()) if numbers else None,
        "text": str(array.reshape(-1)[0])[:80] if array.dtype.kind in "US" and array.size else None,
    }


def _traces(run: Run) -> list[tuple[str, Floats]]:
    rows = run.command if run.command is not None else run.ticks
    traces = (
        []
        if rows is None
        else [(f"command {c}", np.asarray(rows[:, c], float)) for c in range(run.channels)]
    )
    if run.output is not None:
        return [*traces, *zip(run.output.names, run.outputs.T)]
    if (
        run.frames
        and (run.vertices is not None or run.markers is not None)
        and run.seen_points.shape[1]
    ):
        last = run.seen_points[:, -1]
        name = "last vertex" if run.vertices is not None else "last marker"
        traces += [(f"{name} {axis}", last[:, k]) for k, axis in enumerate("xyz")]
    return traces


def _trace(values: Floats) -> str:
    """Return a line of bars: the mean of each part of the record, scaled to its range.

    Parts without data are blank.
    """
    parts = np.array_split(values, min(_WIDTH, len(values)))
    means = np.array(
        [part[np.isfinite(part)].mean() if np.isfinite(part).any() else np.nan for part in parts]
    )
    if not np.isfinite(means).any():
        return ""
    low, span = np.nanmin(means), max(float(np.nanmax(means) - np.nanmin(means)), 1e-12)
    level = np.where(np.isfinite(means), (means - low) / span * (len(_BARS) - 1), -1)
    return "".join(" " if step < 0 else _BARS[int(round(step))] for step in level)
