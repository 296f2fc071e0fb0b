"""Commands that find and change the effects of a model: compare, diagnose, add, remove, refit."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from softmap_edge.commands.options import CompareOptions
from softmap_edge.commands.output import (
    bundle_arguments,
    check_bundle,
    check_file,
    check_kept,
    next_command,
)
from softmap_edge.commands.own import BUILTIN, effects_argument, load_own, open_model
from softmap_edge.commands.progress import Bar, Elapsed
from softmap_edge.commands.seeing import camera_arguments
from softmap_edge.errors import SoftmapError, no_name
from softmap_edge.files.atomic import Document, write_atomically
from softmap_edge.files.numbers import fall, percent
from softmap_edge.model.user_effect import check_hashes
from softmap_edge.robot.drive.recorded import open_run

if TYPE_CHECKING:
    from softmap_edge.comparison.comparison import Comparison
    from softmap_edge.diagnosis.document import Diagnosis
    from softmap_edge.model.model import Model
    from softmap_edge.run.run import Run

RESIDUAL = "residual"
NUMBERS = {
    "restored": "the parameters of the rod are again those before the effect was added",
    "kept": (
        "the rod's own numbers stay as they were fitted with the effect, since this bundle does "
        "not hold those of before; `softmap learn` fits them again"
    ),
}


def compare_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `softmap compare`."""
    parser.add_argument(
        "run", help="the measured run, .npz, or a recording, .mcap; with --live while it grows"
    )
    parser.add_argument("--live", action="store_true", help="while a robot runs, seen by --camera")
    camera_arguments(parser)
    parser.add_argument(
        "--seconds",
        type=float,
        metavar="S",
        help="--live: end after this time, s (default: at Ctrl-C)",
    )
    parser.add_argument(
        "--bundle",
        action="append",
        metavar="DIR",
        help=(
            f"the model, or `{BUILTIN}` (default: the built-in finger); give two to see them side "
            "by side, before and after"
        ),
    )
    effects_argument(parser)
    parser.add_argument(
        "--html", metavar="FILE.html", help="write one self-contained page with pictures"
    )


def compare(args: CompareOptions) -> int:
    """Show the error of a model on a run, and where it is.

    Return 1 if the last of several bundles is worse than the first.
    """
    if args.live:
        from softmap_edge.commands.live import compare_live

        return compare_live(args)
    if args.camera is not None or args.seconds is not None:
        raise SoftmapError("--camera and --seconds go with --live; a run has its own frames")
    from softmap_edge.comparison.comparison import compare as measure
    from softmap_edge.comparison.text import pair_text

    check_file("--html", args.html, ".html")
    load_own(args)
    models = [open_model(path) for path in args.bundle] if args.bundle else [open_model(None)]
    run = open_run(args.run, models[0])
    warn_outside("compare", models[0], run)
    found = [measure(model, run) for model in models]
    _doubt("compare", models[0], run)
    if args.json:
        documents = [c.to_dict() for c in found]
        print(json.dumps(documents[0] if len(documents) == 1 else documents, indent=1))
    else:
        for path, one in zip(args.bundle or [], found if len(found) > 2 else []):
            print(f"{path}\n{one}\n")
        print(pair_text(found[0], found[-1]) if len(found) > 1 else found[0])
        better = found[-1].error["rms_mm"] <= found[0].error["rms_mm"]
        bundle = None if not args.bundle else args.bundle[-1 if better else 0]
        if done := _nothing_left(found[0], found[-1] if better else found[0]):
            print(done)
        else:
            print(next_command("diagnose", args.run, "--out", "diagnosis.json", bundle=bundle))
    if args.html:
        write_page(args.html, run, models[0], models[-1], None, "measured")
    return int(len(found) > 1 and found[-1].error["rms_mm"] > found[0].error["rms_mm"])


NEAR_FLOOR = 1.5  # times the noise floor: a diagnosis finds little below it
REMOVED = 0.9  # share of the error above the floor; a diagnosis calls the rest unexplained below it


def _nothing_left(before: Comparison, after: Comparison) -> str | None:
    """Return why a run need not be diagnosed with the model of `after`; None if it is worth it."""
    old, new, floor = before.error["rms_mm"], after.error["rms_mm"], after.noise_floor_mm
    if floor is None or after.floor_is_bound:
        return None
    if new <= NEAR_FLOOR * floor:
        return (
            f"The error is within {NEAR_FLOOR:g} times the noise floor: the model is as good as "
            "this run can show."
        )
    gone = fall(old, new, floor)
    if gone is not None and gone >= REMOVED:
        return (
            f"{percent(gone)} of the removable error is gone: this run validates the second model."
        )
    return None


@dataclass(frozen=True)
class DiagnoseOptions:
    """Options of `softmap diagnose`, as its parser declares them."""

    runs: list[str]
    bundle: str | None
    held_out: str | None
    reference: list[str] | None
    effects: list[str]
    trust_onnx: bool
    html: str | None
    out: str | None
    since: str | None
    json: bool


def diagnose_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `softmap diagnose`."""
    parser.add_argument(
        "runs",
        nargs="+",
        metavar="run",
        help="the measured run, .npz or .mcap; several runs are fitted together",
    )
    parser.add_argument("--bundle", metavar="DIR", help="the model (default: the built-in finger)")
    parser.add_argument(
        "--held-out",
        metavar="RUN",
        help="an independent run, never fitted; effects that do not lower its error are dropped",
    )
    parser.add_argument(
        "--reference",
        action="append",
        metavar="RUN",
        help=(
            "a run of the same commands before the change; errors are relative to it; repeat for "
            "each run"
        ),
    )
    effects_argument(parser, "; NAME,NAME: test only these effects and those of the files")
    parser.add_argument(
        "--html", metavar="FILE.html", help="write one self-contained page with pictures"
    )
    parser.add_argument(
        "--out", metavar="FILE", help="write the diagnosis as JSON, for `softmap add --from`"
    )
    parser.add_argument(
        "--since", metavar="FILE", help="an earlier diagnosis: report what was settled since then"
    )


def diagnose(args: DiagnoseOptions) -> int:
    """Identify the family of effects that a model lacks, and its law; always return 0."""
    from softmap_edge.diagnosis.diagnose import diagnose as find
    from softmap_edge.diagnosis.document import Diagnosis
    from softmap_edge.report.progress import progress_lines

    check_file("--html", args.html, ".html")
    check_file("--out", args.out, ".json")
    if args.since and args.out and Path(args.since).resolve() == Path(args.out).resolve():
        raise SoftmapError(
            f"--out {args.out} would replace the diagnosis of --since; give another name"
        )
    before = None if args.since is None else Diagnosis.load(args.since).to_dict()
    names = [name for text in args.effects if not text.endswith(".py") for name in _names(text)]
    files = [path for path in args.effects if path.endswith(".py")]
    own = load_own(replace(args, effects=files))
    searched = [*dict.fromkeys([*names, *own])] if names else None
    model = open_model(args.bundle)
    runs, references = (
        [open_run(path, model) for path in paths] for paths in (args.runs, args.reference or [])
    )
    held_out = None if args.held_out is None else open_run(args.held_out, model)
    for run in [*runs, *references]:
        warn_outside("diagnose", model, run)
    with Elapsed("searching for missing effects", silent=args.json) as progress:
        found = find(model, runs, held_out, searched, progress, reference=references or None)
    text = json.dumps(found.to_dict(), indent=1) if args.json else str(found)
    try:  # files before the text: a reader may close the pipe
        if args.out:
            _write_json(args.out, found.to_dict())
        if args.html:
            kind = "fitted" if held_out is None else "held out"
            write_page(args.html, held_out or runs[0], model, found.model, found, kind)
    except OSError:
        print(text)  # a full disk does not cost the result
        raise
    print(text)
    if before is not None and not args.json:
        print("\n".join(["", *progress_lines(before, found.to_dict())]))
    if not args.json and (after := _after_diagnosis(args, found)):
        print(f"\n{after}")
    return 0


def _after_diagnosis(args: DiagnoseOptions, found: Diagnosis) -> str | None:
    """Return the command that adds the named effects or plans the next recording, or None.

    Both read the diagnosis from a file, so without one the command is to write it.
    """
    named = bool(found.effects) and found.verdict == "identified"
    if not named and not found.next:
        return None
    if args.out is None:
        return next_command("diagnose", *args.runs, "--out", "diagnosis.json", bundle=args.bundle)
    if named:
        return next_command("add", "--from", args.out, "--out", "better", bundle=args.bundle)
    return next_command("next", args.out, "--out", "next.csv", bundle=args.bundle)


@dataclass(frozen=True)
class AddOptions:
    """Options of `softmap add`, as its parser declares them."""

    name: str | None
    source: str
    bundle: str | None
    effects: list[str]
    trust_onnx: bool
    out: str
    force: bool
    json: bool


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `softmap add`."""
    parser.add_argument(
        "name",
        nargs="?",
        metavar="NAME[,NAME]",
        help="the effects to add; without it all effects that the diagnosis names",
    )
    parser.add_argument(
        "--from", dest="source", required=True, metavar="FILE", help="a diagnosis, JSON"
    )
    parser.add_argument("--bundle", metavar="DIR", help="the model (default: the built-in finger)")
    effects_argument(parser)
    bundle_arguments(parser)


def add(args: AddOptions) -> int:
    """Write a bundle with the effects of a diagnosis added, with their fitted values."""
    from softmap_edge.diagnosis.document import Diagnosis

    check_bundle(args.out, args.force)
    load_own(args)
    model, diagnosis = open_model(args.bundle), Diagnosis.load(args.source)
    names = (
        [effect.name for effect in diagnosis.effects] if args.name is None else _names(args.name)
    )
    if not names:
        raise SoftmapError(
            f"the diagnosis names no effect (verdict {diagnosis.verdict}), so there is none to add"
        )
    check_hashes(names, diagnosis.made_from.get("python_effects"))
    twice = [n for n in names if n in model.chain_names]
    if twice:
        raise SoftmapError(
            f"the model has '{twice[0]}' already; `softmap model refit` fits it again"
        )
    replay = diagnosis.made_from.get("reference")
    relative = (
        {}
        if replay is None
        else {"relative_to": replay.get("run") if isinstance(replay, dict) else replay}
    )
    return _write(
        args, diagnosis.added(model, names), {"added": names} | relative | _dropped(model)
    )


@dataclass(frozen=True)
class RemoveOptions:
    """Options of `softmap model remove`, as its parser declares them."""

    name: str
    bundle: str
    effects: list[str]
    trust_onnx: bool
    out: str
    force: bool
    json: bool


def remove_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `softmap model remove`."""
    parser.add_argument("name", metavar="NAME[,NAME]", help="the effects to remove, or `residual`")
    parser.add_argument("--bundle", required=True, metavar="DIR", help="the model")
    effects_argument(parser)
    bundle_arguments(parser)


def remove(args: RemoveOptions) -> int:
    """Write a bundle without some of its effects, or without its residual."""
    check_bundle(args.out, args.force)
    load_own(args)
    model, names = open_model(args.bundle), _names(args.name)
    known = [*model.chain_names, *([] if model.residual is None else [RESIDUAL])]
    for name in names:
        if name not in known:
            raise SoftmapError(f"the model has {no_name('effect', name, known)}")
    gone = [name for name in names if name != RESIDUAL]
    if not gone:
        return _write(args, model.with_residual(None), {"removed": names})
    rest = tuple(n for n in model.chain_names if n not in gone)
    params = {label: v for label, v in model.params.items() if label.split(".")[0] in rest}
    law = model.changes(gone) and not model.changes(rest)
    numbers = {"numbers": "restored" if model.has_earlier_numbers else "kept"} if law else {}
    dropped = {} if RESIDUAL in names else _dropped(model)
    return _write(args, model.with_effects(rest, params), {"removed": names} | numbers | dropped)


@dataclass(frozen=True)
class RefitOptions:
    """Options of `softmap model refit`, as its parser declares them."""

    runs: list[str]
    bundle: str | None
    finger: str | None
    effects: list[str]
    trust_onnx: bool
    out: str
    force: bool
    json: bool


def refit_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `softmap model refit`."""
    parser.add_argument(
        "runs",
        nargs="+",
        metavar="run",
        help="the measured run, .npz or .mcap; several share their effects",
    )
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--bundle", metavar="DIR", help="a model with effects: fit the effects again")
    what.add_argument(
        "--finger",
        metavar="FILE.toml",
        help="a finger.toml: fit the finger's own numbers ([fit] says which)",
    )
    effects_argument(parser)
    bundle_arguments(parser)


def refit(args: RefitOptions) -> int:
    """Refit the effects of a bundle, or the parameters of a finger.

    Return 0 if the held-out error falls, else 1.
    """
    if args.finger is not None:
        return _refit_finger(args, args.finger)
    from softmap_edge.diagnosis.refit import refit as fit_again

    check_bundle(args.out, args.force)
    load_own(args)
    before = open_model(args.bundle)
    model, report = fit_again(before, [open_run(path, before) for path in args.runs])
    _write(args, model, report.to_dict() | _dropped(before))
    return int(report.after_held_out_rms_mm > report.before_rms_mm)


def _refit_finger(args: RefitOptions, finger: str) -> int:
    from softmap_edge.fem.finger import Finger
    from softmap_edge.fem.fit import fit_finger

    check_file("--out", args.out, ".toml")
    check_kept(args.out, "a finger", args.force)
    if len(args.runs) > 1:
        raise SoftmapError(f"{len(args.runs)} runs; a finger's own numbers are fitted to one")
    with Bar(args.json) as bar:
        found = fit_finger(Finger.load(finger), open_run(args.runs[0]), bar)
    write_atomically(args.out, found.finger.to_toml())
    if args.json:
        print(json.dumps({**found.to_dict(), "out": str(args.out)}, indent=1))
    else:
        print(
            f"{found}\n{args.out}: build its model with `softmap build {args.out}`, then diagnose "
            "the rest of the error"
        )
    before, after = found.frame_fitted_mm, found.finger_fitted_mm
    return int(before is not None and after is not None and after > before)


# --- what the commands share --------------------------------------------------------------------


def warn_outside(verb: str, model: Model, run: Run) -> None:
    """Warn on stderr if a run leaves the commands or the frame of the model.

    The warning is printed in addition to any document.
    """
    from softmap_edge.model.training_range import command_extrapolation, out_of_reach
    from softmap_edge.run.plane import plane_of

    plane = plane_of(run)
    flat = [] if plane is None else [f"{plane}; no effect across it is tested"]
    for note in [*command_extrapolation(model, run), *out_of_reach(model, run), *flat]:
        print(f"softmap {verb}: {note}", file=sys.stderr)


def _doubt(verb: str, model: Model, run: Run) -> None:
    """Warn on stderr of a robot that hardly moves, and of data that a diagnosis would exclude.

    A comparison uses the run unchanged.
    """
    from softmap_edge.comparison.comparison import still
    from softmap_edge.diagnosis.clean import clean_run

    if text := still(model, run):
        print(f"softmap {verb}: {text}", file=sys.stderr)
    commands = model.commands(run)
    if (commands == commands[:1]).all():
        print(
            f"softmap {verb}: the commands never change in this run, so it does not show their "
            "effect",
            file=sys.stderr,
        )
    try:
        remarks: tuple[str, ...] = tuple(clean_run(model, run).remarks)
    except SoftmapError as fault:
        remarks = (str(fault),)
    for remark in remarks:
        print(f"softmap {verb}: a diagnosis would say: {remark}", file=sys.stderr)


def _names(text: str) -> list[str]:
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise SoftmapError("no effect is named; `softmap model effects` lists them")
    return list(dict.fromkeys(names))


def write_page(
    path: str,
    run: Run,
    before: Model,
    after: Model | None,
    diagnosis: Diagnosis | None,
    kind: str,
    ways: tuple[Mapping[str, float | None], str] | None = None,
) -> None:
    """Write the page on a run with one model, or with two models if they differ."""
    from softmap_edge.comparison.comparison import compare as measure
    from softmap_edge.comparison.series import series
    from softmap_edge.report.html import write_html

    other = None if after is before else after
    found = [measure(model, run) for model in (before, other) if model is not None]
    write_html(path, found, diagnosis, series(run, before, other, kind), ways=ways)


def _dropped(model: Model) -> Document:
    """Return a line that a model's residual is removed with its effects, for the report."""
    return {} if model.residual is None else {"residual": "dropped"}


def _write(args: AddOptions | RemoveOptions | RefitOptions, model: Model, report: Document) -> int:
    from softmap_edge.model.bundle import save_bundle

    folder = save_bundle(model, args.out)
    params = model.params
    if args.json:
        print(
            json.dumps(
                {
                    "schema": "softmap.bundle-change/1",
                    "bundle": str(folder),
                    **report,
                    "effects": params,
                },
                indent=1,
            )
        )
        return 0
    print(f"{folder}: {', '.join(model.chain_names) or 'no effects'}")
    for label, value in params.items():
        print(f"  {label:<24} {value:.6g}")
    if "numbers" in report:
        print(NUMBERS[report["numbers"]])
    if "relative_to" in report:
        print(
            "the added effects are relative to a reference run: the errors of the model on that "
            "run remain"
        )
    if "residual" in report:
        print(
            "the residual was learned with other effects and is dropped; `softmap model adapt` "
            "learns it again"
        )
    if "before_rms_mm" in report:
        before, after = report["before_rms_mm"], report["after_held_out_rms_mm"]
        print(f"error {before:.3f} mm RMS (as the bundle stood) -> {after:.3f} mm RMS (held out)")
    print(
        next_command(
            "compare", "ANOTHER_RUN", "--bundle", args.bundle or BUILTIN, bundle=str(args.out)
        )
    )
    return 0


def _write_json(path: str, document: Document) -> None:
    write_atomically(path, json.dumps(document, indent=1) + "\n")
