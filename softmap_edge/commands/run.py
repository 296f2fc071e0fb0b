"""The command `run`: cut a run into pieces, join runs into one, show the contents of a run."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from softmap_edge.commands.output import check_file, check_no_run, next_command
from softmap_edge.commands.parser import Action, add_actions, run_action
from softmap_edge.errors import RunError
from softmap_edge.files.printable import plain_line
from softmap_edge.robot.drive.recorded import open_run
from softmap_edge.run.contents import contents, lines
from softmap_edge.run.cut import cut
from softmap_edge.run.join import GAP_S, join_runs
from softmap_edge.run.join_doubts import join_doubts
from softmap_edge.run.run import Run

Piece = tuple[str, Run]


@dataclass(frozen=True)
class CutOptions:
    """Options of `softmap run cut`, as its parser declares them."""

    run: str
    start: list[float] | None
    end: list[float] | None
    block: list[str] | None
    lead: float
    out: str
    force: bool
    json: bool


def _cut_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", help="the run (.npz or .mcap)")
    parser.add_argument(
        "--from",
        dest="start",
        action="append",
        type=float,
        metavar="S",
        help="start of a piece, s; repeat --from and --to for several pieces",
    )
    parser.add_argument(
        "--to", dest="end", action="append", type=float, metavar="S", help="end of a piece, s"
    )
    parser.add_argument(
        "--block",
        action="append",
        metavar="LABEL",
        help="a piece is this block; repeat for several",
    )
    parser.add_argument(
        "--lead",
        type=float,
        default=0.0,
        metavar="S",
        help=(
            "keep the commands of this many seconds before each piece, so that effects with "
            "memory start right (0)"
        ),
    )
    _out_arguments(
        parser, "the piece to write (.npz); several pieces are NAME_1.npz, NAME_2.npz, …"
    )


@dataclass(frozen=True)
class JoinOptions:
    """Options of `softmap run join`, as its parser declares them."""

    runs: list[str]
    gap: float
    drop: list[str]
    out: str
    force: bool
    json: bool


def _join_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "runs", nargs="+", metavar="run", help="the runs of one robot (.npz or .mcap), in order"
    )
    parser.add_argument(
        "--gap",
        type=float,
        default=GAP_S,
        metavar="S",
        help=f"time between runs that are not pieces of one recording, s ({GAP_S:g})",
    )
    parser.add_argument(
        "--drop",
        action="append",
        default=[],
        metavar="FIELD",
        help="leave out a field that not all runs share",
    )
    _out_arguments(parser, "the run to write (.npz)")


def _out_arguments(parser: argparse.ArgumentParser, text: str) -> None:
    parser.add_argument("--out", required=True, metavar="NAME.npz", help=text)
    parser.add_argument("--force", action="store_true", help="overwrite an existing run")


@dataclass(frozen=True)
class ShowOptions:
    """Options of `softmap run show`, as its parser declares them."""

    run: str
    json: bool


def _show_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", help="the run (.npz or .mcap)")


def _cut(args: CutOptions) -> int:
    check_file("--out", args.out, ".npz")
    run = open_run(args.run)
    found = _pieces(run, args)
    names = (
        [args.out]
        if len(found) == 1
        else [_numbered(args.out, k) for k in range(1, len(found) + 1)]
    )
    for name in names:
        check_no_run("--out", name, args.force)
    for name, (_, piece) in zip(names, found):
        piece.save(name)
    documents = [contents(piece) | {"out": name} for name, (_, piece) in zip(names, found)]
    if args.json:
        print(
            json.dumps(
                {"schema": "softmap.cut/1", "run": run.hash(), "pieces": documents},
                ensure_ascii=False,
            )
        )
        return 0
    for name, (what, piece) in zip(names, found):
        print(f"{name}: {plain_line(what)}, {len(piece.t)} rows, {piece.frames} frames")
    if any(piece.t[0] > run.t[0] for _, piece in found) and not args.lead:
        print(
            "  prediction begins in equilibrium at the first row; --lead S keeps the commands "
            "before a piece"
        )
    print(next_command("check", names[0]))
    return 0


def _pieces(run: Run, args: CutOptions) -> list[Piece]:
    """Return each requested piece with its description.

    Raises:
        RunError: no piece is requested, or the numbers of --from and --to differ.
    """
    if args.block:
        if args.start or args.end:
            raise RunError(
                "--block and --from/--to: give one of the two; a piece of a block takes two cuts"
            )
        return [(f"block {label}", cut(run, block=label, lead_s=args.lead)) for label in args.block]
    pairs = _pairs(args.start or [], args.end or [])
    found = [cut(run, low, high, lead_s=args.lead) for low, high in pairs]
    return [(_span(piece), piece) for piece in found]


def _pairs(
    starts: Sequence[float], ends: Sequence[float]
) -> list[tuple[float | None, float | None]]:
    """Return start and end (s) of each piece; None stands for the start or end of the run."""
    if not starts and not ends:
        raise RunError("no piece is named; give --from and --to in seconds, or --block LABEL")
    if len(starts) <= 1 and len(ends) <= 1:
        return [(starts[0] if starts else None, ends[0] if ends else None)]
    if len(starts) != len(ends):
        raise RunError(
            f"{len(starts)} --from and {len(ends)} --to: for several pieces give both of each, as "
            "--from 0 --to 30 --from 60 --to 90"
        )
    return list(zip(starts, ends))


def _span(run: Run) -> str:
    """Return a piece's time span of frames as text, or of commands if it has none."""
    times = run.t_seen if run.frames else run.t
    return f"{times[0]:g} to {times[-1]:g} s"


def _numbered(name: str, number: int) -> str:
    path = Path(name)
    return str(path.with_name(f"{path.stem}_{number}{path.suffix}"))


def _join(args: JoinOptions) -> int:
    check_file("--out", args.out, ".npz")
    check_no_run("--out", args.out, args.force)
    runs = [open_run(path) for path in args.runs]
    joined = join_runs(runs, args.gap, args.drop)
    joined.save(args.out)
    document = contents(joined) | {"doubts": join_doubts(runs, args.gap)}
    if args.json:
        print(
            json.dumps({"schema": "softmap.join/1", "out": args.out} | document, ensure_ascii=False)
        )
    else:
        print("\n".join([f"{args.out}: {len(args.runs)} runs joined", *lines(document)]))
        print("".join(f"look at   {plain_line(doubt)}\n" for doubt in document["doubts"]), end="")
        print(next_command("check", args.out))
    return 0


def _show(args: ShowOptions) -> int:
    document = contents(open_run(args.run))
    if args.json:
        print(
            json.dumps(
                {"schema": "softmap.contents/1", "path": args.run} | document, ensure_ascii=False
            )
        )
    else:
        print("\n".join([*lines(document), next_command("check", args.run)]))
    return 0


ACTIONS: dict[str, Action] = {
    "cut": Action("cut pieces out of a run, by time or by block", _cut_arguments, _cut, CutOptions),
    "join": Action("join runs of one robot into one", _join_arguments, _join, JoinOptions),
    "show": Action("list what a run holds", _show_arguments, _show, ShowOptions),
}


def run_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `run` and of its actions."""
    add_actions(parser, ACTIONS)


def run(args: argparse.Namespace) -> int:
    """Cut, join or show runs."""
    return run_action(ACTIONS, args)
