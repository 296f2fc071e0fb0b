"""`softmap record` on a robot: play a command file on servos, watched by a camera.

The servos may be emulated."""

from __future__ import annotations

import contextlib
import json
import shlex
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from softmap_edge.commands.output import (
    check_bundle,
    check_file,
    check_idle,
    check_no_run,
    next_command,
    to_stderr,
)
from softmap_edge.commands.own import open_model
from softmap_edge.commands.progress import Bar
from softmap_edge.commands.robot import announce_edited_limits, emulated, own_map
from softmap_edge.commands.seeing import late, receiver
from softmap_edge.errors import RecordingWarning, SoftmapError
from softmap_edge.files.atomic import Document
from softmap_edge.files.refusals import refusal
from softmap_edge.model.bundle import save_bundle
from softmap_edge.model.model import Model
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.control.emergency_key import EmergencyKey
from softmap_edge.robot.control.recording import read_recording
from softmap_edge.robot.control.recording_damage import CUT
from softmap_edge.robot.drive.command_file import read_commands
from softmap_edge.robot.drive.observations import SEEN, Keeper, read_kept
from softmap_edge.robot.drive.pace import Pace, pace
from softmap_edge.robot.drive.player import Player, merged
from softmap_edge.robot.emulated.finger import LATE
from softmap_edge.robot.link.frames import Seen
from softmap_edge.robot.open import DrivenRobot, read_driven_robot
from softmap_edge.run.protocol import Protocol
from softmap_edge.run.run import Run

if TYPE_CHECKING:
    from softmap_edge.commands.options import RecordOptions

INTERRUPTED = 130
LOOP = ".loop.mcap"  # suffix of the loop's recording next to the run, until the run is written


def record_on_robot(args: RecordOptions) -> int:
    """Play a command file on a robot and write the run, or the part before an interruption.

    Until then, the loop and the camera frames are recorded continuously in files next to it.
    """
    _checked(args)
    model = open_model(args.bundle)
    if args.emulated:
        model = replace(model, calibration=own_map(model))
    made = _commands(args, model)
    behind = late(args, LATE[0] if args.emulated else 0.0)
    file, seen_file = _left(args)
    ended: BaseException | None = None
    try:
        with _cut_in_order(), _robot(args, model) as (driven, seen):
            model = driven.model
            paced = pace(made, driven.calibration, driven.limits["servos"])
            if not args.json:
                print(_ahead(args, paced), file=sys.stderr)
            if args.calibrated:
                save_bundle(model, args.calibrated)
            with Bar(args.json) as bar, Keeper(seen_file, behind, model) as keeper:
                robot = Controller(
                    driven.rig, driven.calibration, driven.limits, record=file, tell=to_stderr
                )
                robot.at_terminal = True
                key = EmergencyKey(robot, to_stderr)
                player = Player(
                    robot,
                    paced,
                    seen,
                    ask=lambda what: _ask(args, what, key),
                    tell=lambda share: _watch(bar, share, robot, keeper),
                    late=behind,
                    keep=keeper.add,
                )
                try:
                    with key, robot:
                        player.play()
                except (SoftmapError, KeyboardInterrupt) as cause:
                    ended = cause
            if ended is not None and not player.played.taken:
                seen_file.unlink()  # nothing to store
                if not args.record:
                    file.unlink(missing_ok=True)
                raise ended
            ended = ended or _broken(robot, keeper)
            run = merged(file, model, paced, player.played)
            run.save(args.out)
    except BaseException as fault:
        if seen_file.exists() and file.exists():
            to_stderr(f"kept: {file} and {seen_file}; they become the run by: {_again(args)}")
        if isinstance(fault, OSError):
            raise SoftmapError(refusal(fault, args.out)) from None
        raise
    seen_file.unlink()
    if not args.record:
        file.unlink()
    document = _document(args, run, made) | {
        "emulated": args.emulated,
        "whole": player.played.whole,
        "unsettled": player.played.unsettled,
        "settling_s": round(player.played.waited, 1),
        "record": args.record,
        "bundle": args.calibrated,
    }
    print(json.dumps(document, ensure_ascii=False) if args.json else _said(args, run, document))
    if isinstance(ended, SoftmapError):
        raise SoftmapError(f"{ended}; what was recorded before is in {args.out}")
    return INTERRUPTED if ended is not None else 0


def recover(args: RecordOptions, seen_file: Path) -> int:
    """Make the run of an interrupted recording from the loop's file and the stored frames."""
    check_file("--out", args.out, ".npz")
    check_no_run("--out", args.out)
    model = open_model(args.bundle)
    made = _commands(args, model)
    file = Path(args.record) if args.record else seen_file.with_suffix(LOOP)
    played, recorded = read_kept(seen_file), read_recording(file)
    if recorded.doubtful:
        raise SoftmapError(f"{recorded.incomplete}; copy it again")
    if recorded.incomplete is not None and recorded.short != CUT:
        warnings.warn(RecordingWarning(recorded.incomplete), stacklevel=2)
    if not played.taken:
        raise SoftmapError(f"{seen_file}: no frame was taken before it was cut; record again")
    run = merged(file, model, pace(made, recorded.calibration, recorded.limits["servos"]), played)
    run.save(args.out)
    document = _document(args, run, made) | {
        "emulated": None,
        "whole": False,
        "recovered": args.recover,
    }
    document |= {"lacks": played.lacks}
    text = f"{run}\n{run.frames} of {made.frames} frames; written to {args.out}"
    text = "\n".join(
        [
            text,
            *filter(None, [recorded.incomplete if recorded.short == CUT else None, played.lacks]),
        ]
    )
    print(json.dumps(document, ensure_ascii=False) if args.json else text)
    return 0


def _commands(args: RecordOptions, model: Model) -> Protocol:
    made, robot = read_commands(args.commands)
    if robot != model.robot:
        raise SoftmapError(f"{args.commands}: made for '{robot}', the model is of '{model.robot}'")
    return made


def _document(args: RecordOptions, run: Run, made: Protocol) -> Document:
    return {
        "schema": "softmap.record/1",
        "out": args.out,
        "rows": len(run.t),
        "channels": run.channels,
        "frames": run.frames,
        "wanted": made.frames,
        "minutes": round(float(run.t[-1] - run.t[0]) / 60.0, 2),
        "simulated": False,
        "hash": run.hash(),
    }


def _left(args: RecordOptions) -> tuple[Path, Path]:
    """Return the files for the loop's recording and the frames until the run is written.

    Raises:
        SoftmapError: they exist, from an earlier interrupted recording.
    """
    out = Path(args.out)
    file, seen = Path(args.record) if args.record else out.with_suffix(LOOP), out.with_suffix(SEEN)
    for there in (file, seen):
        if there.exists():
            raise SoftmapError(
                f"{there} is what a recording left that was cut; make its run by: {_again(args)}, "
                "or give another --out"
            )
    return file, seen


def _again(args: RecordOptions) -> str:
    """Return the command that makes the run from the remaining files."""
    words = ["softmap", "record", args.commands, "--recover", str(Path(args.out).with_suffix(SEEN))]
    words += ["--record", args.record] if args.record else []
    bundle = args.calibrated or args.bundle
    words += ["--bundle", bundle] if bundle else []
    return shlex.join([*words, "--out", args.out])


def _watch(
    bar: Callable[[str, float], None], share: float, robot: Controller, keeper: Keeper
) -> None:
    """Show the progress; end playing if recording has ended."""
    bar("recording", share)
    if fault := _broken(robot, keeper):
        raise fault


def _broken(robot: Controller, keeper: Keeper) -> SoftmapError | None:
    """Return why the writing of either file ended, for example a full disk."""
    if robot.unrecorded is not None:
        return SoftmapError(robot.unrecorded)
    return (
        None
        if keeper.fault is None
        else SoftmapError(f"the camera frames are no longer recorded: {keeper.fault}")
    )


@contextlib.contextmanager
def _cut_in_order() -> Iterator[None]:
    """Treat SIGTERM and SIGHUP as Ctrl-C: release tension, and write the data so far.

    A closed terminal or a lost ssh connection sends SIGHUP.
    """

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {one: signal.signal(one, interrupt) for one in (signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)


def _checked(args: RecordOptions) -> None:
    """Raise SoftmapError for conflicting arguments, or files that cannot be written."""
    simulated = {
        "--virtual": args.virtual,
        "--truth": args.truth,
        "--finger": args.finger,
        "--truth-from": args.truth_from,
    }
    if given := [option for option, value in simulated.items() if value]:
        raise SoftmapError(f"{given[0]} goes with --sim")
    if not args.emulated:
        check_idle({"--seed": args.seed}, "only a simulated or emulated finger uses it")
    if args.hide and not args.emulated:
        raise SoftmapError("--hide: only a simulated or emulated finger can hide something")
    if args.rig and args.camera is None:
        raise SoftmapError("--rig needs eyes: give --camera udp://:PORT (docs/do/camera.md)")
    if args.emulated and args.camera is not None:
        raise SoftmapError("--emulated has a camera of its own; leave --camera out")
    if args.calibrated and not args.emulated:
        raise SoftmapError(
            "--calibrated: only an emulated robot knows its true map; `softmap model calibrate` "
            "finds one"
        )
    check_file("--out", args.out, ".npz")
    check_no_run("--out", args.out)
    check_file("--record", args.record, ".mcap", new=True)
    if args.calibrated:
        check_bundle(args.calibrated, None, "--calibrated")


@contextlib.contextmanager
def _robot(args: RecordOptions, model: Model) -> Iterator[tuple[DrivenRobot, Seen]]:
    """Yield the robot and its camera."""
    if args.emulated:
        hidden = ",".join(args.hide)
        with emulated(model, hidden, 1 if args.seed is None else args.seed) as driven:
            assert driven.finger is not None
            yield driven, driven.finger.seen
        return
    if args.rig is None:
        raise SoftmapError("no robot is given; give --rig FILE.toml")
    announce_edited_limits(model)
    driven = read_driven_robot(args.rig, model)
    with receiver(args, len(model.rest)) as camera:
        try:
            yield driven, camera.seen
        finally:
            if not args.json:
                print(camera.summary(), file=sys.stderr)


def _ask(args: RecordOptions, what: str, key: EmergencyKey) -> None:
    """Print what must be done by hand, and wait until it is done."""
    if args.yes or args.emulated:
        if not args.json:
            print(f"  {what}", file=sys.stderr)
        return
    if not sys.stdin.isatty():
        raise SoftmapError(f"{what}: no terminal to confirm that it is done; give --yes if it is")
    print(f"\n{what}; torque is off. Press Enter when it is so, Ctrl-C to end.", file=sys.stderr)
    with key.aside():
        sys.stdin.readline()


def _ahead(args: RecordOptions, paced: Pace) -> str:
    """Print the expected duration."""
    minutes = paced.t[-1] / 60.0
    slowed = minutes / max(paced.made.minutes, 1e-9)
    slower = (
        f", {slowed:.1f} times as slow as written, by the limits of the servos"
        if slowed > 1.05
        else ""
    )
    rests = int(paced.rests.sum())
    return (
        f"a recording of {minutes:.1f} minutes{slower}; in addition up to {rests * 3} s for "
        f"{rests} rests to settle; Ctrl-C ends it and keeps what there is; should the computer "
        f"fail, this makes the run of what is there: {_again(args)}"
    )


def _said(args: RecordOptions, run: object, summary: Document) -> str:
    lines = [
        f"{run}",
        f"{summary['frames']} of {summary['wanted']} frames in {summary['minutes']:.1f} minutes, "
        f"{summary['settling_s']:g} s to settle; written to {args.out}"
        + ("" if summary["whole"] else "; it was cut short"),
    ]
    if summary["unsettled"]:
        lines.append(
            f"{summary['unsettled']} rests went on before all was still: the body creeps, or the "
            "servos hum"
        )
    lines += [f"{summary[name]}: written" for name in ("record", "bundle") if summary[name]]
    bundle = args.calibrated or args.bundle
    if bundle:
        lines.append(next_command("diagnose", args.out, bundle=bundle))
    return "\n".join(lines)
