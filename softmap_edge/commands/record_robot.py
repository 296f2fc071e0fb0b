"""`softmap record` on a robot: a command file played on its servos, or on emulated ones, watched by a camera."""

from __future__ import annotations

import argparse
import contextlib
import json
import shlex
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from softmap_edge.bundle import save_bundle
from softmap_edge.camera.frames import Seen
from softmap_edge.commands.output import check_bundle, check_file, check_no_run, to_stderr
from softmap_edge.commands.own import open_model
from softmap_edge.commands.progress import Bar
from softmap_edge.commands.robot import Bench, emulated, plain_map, read_bench
from softmap_edge.commands.seeing import late, receiver
from softmap_edge.errors import SoftmapError
from softmap_edge.experiment.command_file import read_commands
from softmap_edge.experiment.pace import Pace, pace
from softmap_edge.experiment.play import Player, merged
from softmap_edge.model import Model
from softmap_edge.servo.controller import Controller
from softmap_edge.servo.emergency_key import EmergencyKey
from softmap_edge.servo.finger import LATE

INTERRUPTED = 130
SIMULATED = ("virtual", "truth", "finger", "truth_from")


def record_on_robot(args: argparse.Namespace) -> int:
    """Play a command file on a robot and write the run; what there is of it also when it is cut short."""
    _checked(args)
    model = open_model(args.bundle)
    if args.emulated:
        known = model.calibration or plain_map(model)
        model = replace(model, calibration=replace(known, window=known.window or known.holding(model.command_range)))
    made, robot_name = read_commands(args.commands)
    if robot_name != model.robot:
        raise SoftmapError(f"{args.commands}: made for '{robot_name}', the model is of '{model.robot}'")
    behind = late(args, LATE[0] if args.emulated else 0.0)
    ended: BaseException | None = None
    with tempfile.TemporaryDirectory(dir=Path(args.out).parent) as folder, _robot(args, model) as (bench, seen):
        model = bench.model
        paced = pace(made, bench.calibration, bench.limits["servos"])
        if not args.json:
            print(_ahead(args, paced), file=sys.stderr)
        if args.calibrated:
            save_bundle(model, args.calibrated)
        file = Path(args.record) if args.record else Path(folder) / "loop.mcap"
        with Bar(args.json) as bar:
            robot = Controller(bench.rig, bench.calibration, bench.limits, record=file)
            key = EmergencyKey(robot, to_stderr)
            player = Player(
                robot,
                paced,
                seen,
                ask=lambda what: _ask(args, what, key),
                tell=lambda share: bar("recording", share),
                late=behind,
            )
            try:
                with key, robot:
                    player.play()
            except (SoftmapError, KeyboardInterrupt) as cause:
                ended = cause
        if ended is not None and not player.played.taken:
            raise ended
        run = merged(file, model, paced, player.played)
        run.save(args.out)
    document = {
        "schema": "softmap.record/1", "out": args.out, "rows": len(run.t), "channels": run.channels,
        "frames": run.frames, "wanted": made.frames, "minutes": round(float(run.t[-1] - run.t[0]) / 60.0, 2),
        "simulated": False, "emulated": args.emulated, "whole": player.played.whole, "hash": run.hash(),
        "unsettled": player.played.unsettled, "settling_s": round(player.played.waited, 1), "record": args.record,
        "bundle": args.calibrated,
    }  # fmt: skip
    print(json.dumps(document, ensure_ascii=False) if args.json else _said(args, run, document))
    if isinstance(ended, SoftmapError):
        raise SoftmapError(f"{ended}; what was recorded before is in {args.out}")
    return INTERRUPTED if ended is not None else 0


def _checked(args: argparse.Namespace) -> None:
    """Raise SoftmapError for arguments that do not go together, or files that cannot be written."""
    given = [f"--{name.replace('_', '-')}" for name in SIMULATED if getattr(args, name)]
    if given:
        raise SoftmapError(f"{given[0]} goes with --sim")
    if args.hide and not args.emulated:
        raise SoftmapError("--hide: only a simulated or emulated finger can hide something")
    if args.rig and args.camera is None:
        raise SoftmapError("--rig needs eyes: give --camera udp://:PORT (docs/camera.md)")
    if args.emulated and args.camera is not None:
        raise SoftmapError("--emulated has a camera of its own; leave --camera out")
    if args.calibrated and not args.emulated:
        raise SoftmapError("--calibrated: only an emulated robot knows its true map; `softmap calibrate` finds one")
    check_file("--out", args.out, ".npz")
    check_no_run("--out", args.out)
    check_file("--record", args.record, ".mcap", new=True)
    if args.calibrated:
        check_bundle(args.calibrated)


@contextlib.contextmanager
def _robot(args: argparse.Namespace, model: Model) -> Iterator[tuple[Bench, Seen]]:
    """Give the bench and what sees it."""
    if args.emulated:
        hidden = ",".join(args.hide)
        with emulated(model, hidden, 1 if args.seed is None else args.seed) as bench:
            assert bench.finger is not None
            yield bench, bench.finger.seen
        return
    bench = read_bench(args.rig, model)
    with receiver(args, len(model.rest)) as camera:
        try:
            yield bench, camera.seen
        finally:
            if not args.json:
                print(camera.said(), file=sys.stderr)


def _ask(args: argparse.Namespace, what: str, key: EmergencyKey) -> None:
    """Say what is to be done by hand, and wait until it is."""
    if args.yes or args.emulated:
        if not args.json:
            print(f"  {what}", file=sys.stderr)
        return
    if not sys.stdin.isatty():
        raise SoftmapError(f"{what}: nobody is there to say that it is done; give --yes if it is")
    print(f"\n{what}; torque is off. Press Enter when it is so, Ctrl-C to end.", file=sys.stderr)
    with key.aside():
        sys.stdin.readline()


def _ahead(args: argparse.Namespace, paced: Pace) -> str:
    """Say how long it will take."""
    minutes = paced.t[-1] / 60.0
    slowed = minutes / max(paced.made.minutes, 1e-9)
    slower = f", {slowed:.1f} times as slow as written, by the limits of the servos" if slowed > 1.05 else ""
    rests = int(paced.rests.sum())
    return (
        f"a recording of {minutes:.1f} minutes{slower}; beside that up to {rests * 3} s for {rests} rests to settle; "
        "Ctrl-C ends it and keeps what there is"
    )


def _said(args: argparse.Namespace, run: Any, told: dict[str, Any]) -> str:
    lines = [
        f"{run}",
        f"{told['frames']} of {told['wanted']} frames in {told['minutes']:.1f} minutes, {told['settling_s']:g} s to "
        f"settle; written to {args.out}" + ("" if told["whole"] else "; it was cut short"),
    ]
    if told["unsettled"]:
        lines.append(f"{told['unsettled']} rests went on before all was still: the body creeps, or the servos hum")
    lines += [f"{told[name]}: written" for name in ("record", "bundle") if told[name]]
    bundle = args.calibrated or args.bundle
    if bundle:
        lines.append(f"next: softmap diagnose {shlex.quote(args.out)} --bundle {shlex.quote(bundle)}")
    return "\n".join(lines)
