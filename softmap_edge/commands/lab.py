"""The command `lab`: a page to see where a model fails, and to add what is missing."""

from __future__ import annotations

import argparse
import json
import time
import webbrowser
from dataclasses import dataclass
from pathlib import Path

from softmap_edge.commands.output import to_stderr
from softmap_edge.commands.own import effects_argument, load_own, open_model
from softmap_edge.errors import SoftmapError
from softmap_edge.lab.journal import read_inputs
from softmap_edge.lab.server import PORT, LabServer
from softmap_edge.lab.session import NamedRun, Session
from softmap_edge.robot.drive.recorded import open_run

DEMO = (".", "demo", "out/demo")  # folders in which `softmap demo` may have left its runs
DEMO_RUNS = ("run.npz", "other_run.npz")
MADE = "demo_run.npz"
HIDDEN, SEED = "backlash", 1  # of the run that is made here


@dataclass(frozen=True)
class LabOptions:
    """Options of `softmap lab`, as its parser declares them."""

    runs: list[str]
    bundle: str | None
    folder: str
    port: int
    no_browser: bool
    effects: list[str]
    trust_onnx: bool
    json: bool


def lab_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `lab`."""
    parser.add_argument(
        "runs",
        nargs="*",
        metavar="run",
        help=(
            "measured runs, .npz or .mcap: the first is fitted, the others validate (default: "
            "those of the session in --folder, else run.npz and other_run.npz here or where `softmap demo` left them)"
        ),
    )
    parser.add_argument("--bundle", metavar="DIR", help="the model (default: the built-in finger)")
    parser.add_argument(
        "--folder",
        default="lab",
        metavar="DIR",
        help="session folder: every accepted step is written into it; opened again if there (lab)",
    )
    parser.add_argument(
        "--port", type=int, default=PORT, help=f"port of the page; 0: any that is free ({PORT})"
    )
    parser.add_argument("--no-browser", action="store_true", help="print the link only")
    effects_argument(parser)


def lab(args: LabOptions) -> int:
    """Serve the page until Ctrl-C."""
    load_own(args)
    paths, bundle = _inputs(args)
    model = open_model(bundle)
    runs = [NamedRun(path, open_run(path, model)) for path in paths]
    session = Session(args.folder, runs, model, bundle)
    try:
        with LabServer(session, args.port) as server:
            to_stderr(f"open {server.url}")
            if not args.no_browser:
                webbrowser.open(server.url)
            _wait()
    finally:
        session.close()
    steps = len(session.journal.state.accepted)
    if args.json:
        print(json.dumps({"schema": "softmap.lab/1", "folder": args.folder, "accepted": steps}))
    else:
        print(f"{args.folder}: {steps} accepted step{'s' * (steps != 1)}")
    return 0


def _wait() -> None:
    """Return at Ctrl-C."""
    try:
        while True:
            time.sleep(3600.0)
    except KeyboardInterrupt:
        return


def _inputs(args: LabOptions) -> tuple[list[str], str | None]:
    """Return the runs and the bundle: those given, of the session, or of the demo."""
    if args.runs:
        return args.runs, args.bundle
    kept = read_inputs(args.folder)
    if kept is not None:
        if missing := [run.path for run in kept.runs if not Path(str(run.path)).exists()]:
            raise SoftmapError(
                f"{args.folder}: its run {missing[0]} is gone; bring it back, or give another "
                "--folder"
            )
        return [str(run.path) for run in kept.runs], args.bundle or kept.bundle.path
    for folder in DEMO:
        found = [str(path) for name in DEMO_RUNS if (path := Path(folder) / name).is_file()]
        if found:
            return found, args.bundle
    return [_made(Path(args.folder))], args.bundle


def _made(folder: Path) -> str:
    """Simulate a run of a finger with a hidden effect, in the session folder."""
    file = folder / MADE
    if not file.is_file():
        from softmap_edge.run.protocol import other_protocol
        from softmap_edge.synthetic.finger import hide

        to_stderr("No run is given: simulating one of a finger with a hidden effect …")
        folder.mkdir(parents=True, exist_ok=True)
        hide([HIDDEN], SEED).measure(other_protocol(2)).save(file)
    return str(file)
