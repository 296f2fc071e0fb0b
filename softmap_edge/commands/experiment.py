"""Commands of the next experiment: `next` and `record`.

`next` finds which block to record, as a command file; `record` plays a command file.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from softmap_edge.commands.options import RecordOptions
from softmap_edge.commands.output import check_file, check_no_run, next_command
from softmap_edge.commands.own import effects_argument, load_own, open_model
from softmap_edge.commands.progress import Bar
from softmap_edge.commands.seeing import camera_arguments
from softmap_edge.errors import RunError, SoftmapError
from softmap_edge.files.atomic import read_document
from softmap_edge.files.npz import write_npz
from softmap_edge.model.user_effect import check_hashes
from softmap_edge.robot.drive.recorded import open_run

if TYPE_CHECKING:
    from softmap_edge.experiment.choose import Experiment
    from softmap_edge.fem.finger import Finger
    from softmap_edge.files.npz import Arrays
    from softmap_edge.model.model import Model
    from softmap_edge.run.protocol import Limits, Protocol
    from softmap_edge.run.run import Run

BOTH = (
    "  play it twice ({:.1f} minutes in all): as the run was, and as the reference run was; then\n"
    "  `softmap diagnose RUN NEW --reference REFERENCE --reference NEW_REFERENCE`"
)


@dataclass(frozen=True)
class NextOptions:
    """Options of `softmap next`, as its parser declares them."""

    diagnosis: str | None
    bundle: str | None
    effects: list[str]
    trust_onnx: bool
    run: list[str]
    reference: list[str]
    out: str | None
    standard: bool
    protocol: str | None
    block: list[str]
    minutes: float
    fastest: float | None
    since: str | None
    seed: int
    json: bool


def next_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `softmap next`."""
    parser.add_argument(
        "diagnosis",
        nargs="?",
        metavar="FILE",
        help="the diagnosis, JSON, of `softmap diagnose --out`",
    )
    parser.add_argument("--bundle", metavar="DIR", help="the model (default: the built-in finger)")
    effects_argument(parser)
    parser.add_argument(
        "--run",
        action="append",
        default=[],
        metavar="RUN",
        help=(
            "a run that the diagnosis was made from (repeat for each); without it, blocks are "
            "ranked less reliably"
        ),
    )
    parser.add_argument(
        "--reference",
        action="append",
        default=[],
        metavar="RUN",
        help="the reference run of a diagnosis that was made with one (repeat for each)",
    )
    parser.add_argument("--out", metavar="CSV", help="write the commands, for `softmap record`")
    parser.add_argument(
        "--standard",
        action="store_true",
        help="the standard protocol for this robot, without a diagnosis",
    )
    parser.add_argument(
        "--protocol",
        choices=["grid", "validation", "paths"],
        help=(
            "commands to learn a robot from, without a diagnosis: a grid of held commands, each "
            "reached from a neighbour; held commands for validation; paths with reversals for "
            "tests"
        ),
    )
    parser.add_argument(
        "--block",
        action="append",
        default=[],
        metavar="NAME",
        help="write this block instead of the best one",
    )
    parser.add_argument(
        "--minutes", type=float, default=6.0, help="total length of the blocks to write (6)"
    )
    parser.add_argument(
        "--fastest",
        type=float,
        metavar="SPEED",
        help="highest speed, in mm/s or the robot's unit/s",
    )
    parser.add_argument(
        "--since", metavar="FILE", help="an earlier diagnosis: report what was settled since then"
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=0,
        help="random seed of the irregular frame times and of --protocol (0)",
    )


def next(args: NextOptions) -> int:
    """Find the block of commands that answers the open questions, and write it."""
    from softmap_edge.experiment.choose import SCHEMA
    from softmap_edge.robot.drive.command_file import steps, write_commands

    check_file("--out", args.out, ".csv")
    if not args.minutes > 0:
        raise SoftmapError(f"--minutes {args.minutes:g}: give a time above 0")
    if args.seed < 0:
        raise SoftmapError(f"--seed {args.seed} is negative; give 0 or more")
    load_own(args)
    model = open_model(args.bundle)
    made, found, lines, times = (
        (*_standard(args, model), 1)
        if args.diagnosis is None
        else _answered(args, args.diagnosis, model)
    )
    names = [] if made is None else made.name.split(" + ")
    settles = list(dict.fromkeys(name for e in found if e.block in names for name in e.settles))
    if made is not None and args.out:
        write_commands(args.out, made, model.robot)
    document = {
        "schema": SCHEMA,
        "next": [e.to_dict() for e in found],
        "blocks": names,
        "settles": settles,
        "minutes": None if made is None else round(made.minutes, 2),
        "times": times,
        "frames": None if made is None else made.frames,
        "commands": args.out if made is not None else None,
        "by_hand": []
        if made is None
        else [{"t_s": round(t, 2), "do": text} for t, text in made.notes],
        "progress": lines,
    }
    if args.json:
        print(json.dumps(document, ensure_ascii=False, indent=1))
        return 0
    if found:
        lines += ["Experiments that would settle it, best first", *(f"  {e}" for e in found)]
    elif made is None:
        lines += ["Nothing is open, so there is nothing to record."]
    if made is not None:
        reason = f", to settle {', '.join(settles)}" if settles else ""
        lines += [f"{made.name}: {made.minutes:.1f} minutes, {made.frames} frames{reason}"]
        lines += [f"  at {step}" for step in steps(made.notes)]
        lines += [BOTH.format(times * made.minutes)] if times > 1 else []
    if made is not None and args.out:
        lines += [f"written to {args.out}", *_playing(args, args.out, model)]
    print("\n".join(lines))
    return 0


def _standard(args: NextOptions, model: Model) -> tuple[Protocol, list[Experiment], list[str]]:
    """Return commands without a diagnosis: the standard protocol, or blocks by name."""
    from softmap_edge.experiment.blocks import Setting, chosen, plan
    from softmap_edge.run.protocol import standard_protocol
    from softmap_edge.synthetic.virtual_protocol import virtual_protocol

    for path in (*args.run, *args.reference):
        open_run(path, model)  # the run is not used here, but damage is reported
    setting = Setting.after([], model.gravity_reference)
    ways = {"--standard": args.standard, "--block": args.block, "--protocol": args.protocol}
    given = [option for option, value in ways.items() if value]
    if len(given) > 1:
        raise SoftmapError(f"{' and '.join(given)} are two protocols; leave one of them out")
    if args.protocol:
        return (
            virtual_protocol(args.protocol, args.seed, _limits(args, model), setting.gravity),
            [],
            [],
        )
    if args.block:
        return plan(chosen(args.block), _limits(args, model), setting, args.seed), [], []
    if not args.standard:
        raise SoftmapError(
            "no diagnosis is given; name the file of `softmap diagnose --out`, or ask for "
            "--standard or a --protocol"
        )
    both = (setting.gravity, setting.leaning())
    return (
        standard_protocol(
            seed=args.seed, limits=_limits(args, model), back=True, orientations=both
        ),
        [],
        [],
    )


def _answered(
    args: NextOptions, file: str, model: Model
) -> tuple[Protocol | None, list[Experiment], list[str], int]:
    """Return the commands that answer the open questions of a diagnosis.

    Also the weighed blocks, the open questions, and the number of repetitions.
    """
    from softmap_edge.diagnosis.document import Diagnosis
    from softmap_edge.diagnosis.separate import REFIT
    from softmap_edge.experiment.blocks import Setting, chosen, plan
    from softmap_edge.experiment.choose import next_experiment, program
    from softmap_edge.report.progress import progress_lines

    if args.standard or args.protocol:
        name = "--standard" if args.standard else "--protocol"
        raise SoftmapError(f"{name} takes no diagnosis; leave one of the two out")
    diagnosis, before = Diagnosis.load(file), args.since and Diagnosis.load(args.since).to_dict()
    diagnosis.check_robot(model)
    asked = {e.name for e in diagnosis.effects} | {
        name for a in diagnosis.alternatives for name in a.effects
    }
    check_hashes([*asked], diagnosis.made_from.get("python_effects"))
    runs, limits = [open_run(path, model) for path in args.run], _limits(args, model)
    references = [open_run(path, model) for path in args.reference]
    with Bar(args.json) as bar:
        found = next_experiment(
            model, diagnosis, runs, limits, lambda share: bar("simulating", share), references
        )
    names = args.block or [e.block for e in program(found, args.minutes)]
    setting = Setting.after(runs, model.gravity_reference)
    made = plan(chosen(names), limits, setting, args.seed) if names else None
    times = 1 if diagnosis.made_from.get("reference") is None else 2
    lines = progress_lines(before or None, diagnosis.to_dict())
    lines += [
        f"First, without a recording: {REFIT}" for block in diagnosis.next if block.block == REFIT
    ]
    return made, found, lines, times


def _playing(args: NextOptions, commands: str, model: Model) -> list[str]:
    """Return the command that plays the file: on the simulated finger if it is meant for it."""
    from softmap_edge.fem.finger import Finger

    if model.robot != Finger.builtin().name:
        return [next_command("record", commands, "--rig", "rig.toml", "--out", "new.npz")]
    if args.protocol:
        virtual = ("--sim", "--virtual", "--out", "new.npz", "--truth", "truth.npz")
        return [
            "  --seed of `softmap record` draws the finger, not the commands: one for all its runs",
            next_command("record", commands, *virtual),
        ]
    return [
        "  give `softmap record` the --hide or --virtual and the --seed of the runs before",
        next_command("record", commands, "--sim", "--out", "new.npz", bundle=args.bundle),
    ]


def _limits(args: NextOptions, model: Model) -> Limits:
    from softmap_edge.run.protocol import Limits

    return Limits.of(model.command_range, model.command_unit, args.fastest)


def record_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `softmap record`."""
    parser.add_argument("commands", metavar="CSV", help="a command file of `softmap next --out`")
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--sim",
        action="store_true",
        help="on a simulated finger: frames are computed by the simulator",
    )
    where.add_argument(
        "--emulated",
        action="store_true",
        help=(
            "on emulated servos with a finger on them, in simulated time: as fast as the computer "
            "can"
        ),
    )
    where.add_argument(
        "--rig", metavar="FILE.toml", help="on the servos of this rig, seen by --camera"
    )
    where.add_argument(
        "--recover",
        metavar="FILE.seen",
        help="make the run from the files of an interrupted recording",
    )
    camera_arguments(parser)
    parser.add_argument(
        "--yes", action="store_true", help="--rig: do not ask before a condition changes"
    )
    parser.add_argument(
        "--record", metavar="FILE.mcap", help="--rig, --emulated: save the recording of the loop"
    )
    parser.add_argument(
        "--calibrated", metavar="DIR", help="--emulated: write its bundle, with the true map"
    )
    parser.add_argument(
        "--virtual",
        action="store_true",
        help=(
            "on the virtual finger, a simulated stand-in for hardware: other elements and "
            "material, turned tendons, friction, a lean; the run holds servo ticks and noisy "
            "clouds of two views, no command in mm and no vertices"
        ),
    )
    parser.add_argument(
        "--truth",
        metavar="FILE",
        help="with --virtual: write its true vertices and commands next to the run, .npz",
    )
    parser.add_argument(
        "--bundle",
        metavar="DIR",
        help="the model that the commands are for (default: the built-in finger)",
    )
    effects_argument(parser)
    parser.add_argument(
        "--finger", metavar="FILE.toml", help="the simulated finger (default: the built-in one)"
    )
    hidden = parser.add_mutually_exclusive_group()
    hidden.add_argument(
        "--hide",
        "--hidden",
        nargs="+",
        default=[],
        metavar="NAME,NAME",
        help="effects that the simulated finger has",
    )
    hidden.add_argument(
        "--truth-from",
        metavar="FILE",
        help="the same hidden effects as in a demo (its --json document)",
    )
    parser.add_argument(
        "--seed",
        type=int,
        help="random seed of the finger and the strengths of its hidden effects (1)",
    )
    parser.add_argument(
        "--noise-seed", type=int, default=0, help="random seed of the camera noise (0)"
    )
    parser.add_argument("--out", required=True, metavar="RUN", help="the run to write, .npz")


def record(args: RecordOptions) -> int:
    """Play a command file on a robot, or on the simulated finger, and write the run."""
    from softmap_edge.fem.finger import Finger
    from softmap_edge.robot.drive.command_file import read_commands
    from softmap_edge.robot.emulated.named_laws import check_hidden
    from softmap_edge.synthetic.finger import WATCH

    if args.recover:
        from softmap_edge.commands.record_robot import recover

        return recover(args, Path(args.recover))
    if not (args.sim or args.emulated or args.rig):
        raise SoftmapError(
            "where is it played? give --sim (simulated), --emulated (real packets) or --rig "
            "FILE.toml"
        )
    if not args.sim:
        from softmap_edge.commands.record_robot import record_on_robot

        return record_on_robot(args)
    check_file("--out", args.out, ".npz")
    check_no_run("--out", args.out)
    check_file("--truth", args.truth, ".npz")
    check_no_run("--truth", args.truth)
    if args.truth is not None and (not args.virtual or args.truth == args.out):
        raise SoftmapError("--truth goes with --virtual, and into a file of its own")
    made, robot = read_commands(args.commands)
    load_own(args)
    finger = Finger.builtin() if args.finger is None else Finger.load(args.finger)
    if not args.virtual or args.bundle is not None:
        model = open_model(args.bundle)
        if finger.name != model.robot:
            raise SoftmapError(
                f"the model is of '{model.robot}', the simulated finger is '{finger.name}'; give "
                "its own with --finger"
            )
    if (
        robot != finger.name
        or made.unit != finger.command_unit
        or made.command.shape[1] != len(finger.pairs)
    ):
        raise SoftmapError(
            f"{args.commands}: {made.command.shape[1]} commands in {made.unit} for '{robot}', "
            f"'{finger.name}' takes {len(finger.pairs)} in {finger.command_unit}; write them for "
            "this one with `softmap next --bundle`"
        )
    if args.noise_seed < 0:
        raise SoftmapError(f"--noise-seed {args.noise_seed} is negative; give 0 or more")
    asked = [name for text in args.hide for name in text.split(",") if name]
    names, seed = (asked, 1) if args.truth_from is None else _secrets(args.truth_from)
    seed = seed if args.seed is None else args.seed
    check_hidden(names, seed)
    if not args.json:
        print(_ahead(made, bool(names)), file=sys.stderr)
    with Bar(args.json) as bar:
        before = WATCH.set(lambda share: bar("solving", share))
        try:
            run, truth = _measured(args, made, finger, names, seed)
        finally:
            WATCH.reset(before)
    run.save(args.out)
    if args.truth is not None:
        write_npz(Path(args.truth), truth)
    document = {
        "schema": "softmap.record/1",
        "out": args.out,
        "rows": len(run.t),
        "channels": run.channels,
        "frames": run.frames,
        "minutes": round(made.minutes, 2),
        "simulated": True,
        "virtual": args.virtual,
        "truth": args.truth,
        "hash": run.hash(),
    }
    apart = "" if args.truth is None else f"; its truth in {args.truth}"
    after = next_command("compare", args.out, bundle=args.bundle)
    sentence = (
        f"{run}\n{'virtual, ' if args.virtual else ''}simulated; written to {args.out}{apart}\n"
        f"{after}"
    )
    print(json.dumps(document, ensure_ascii=False) if args.json else sentence)
    return 0


def _ahead(made: Protocol, hidden: bool) -> str:
    """Print the duration of the recording and what is simulated; the bar shows progress."""
    first = "finding how strong the hidden effects are, then " if hidden else ""
    return (
        f"a recording of {made.minutes:.1f} minutes; {first}solving its {made.frames} frames one "
        "by one"
    )


def _measured(
    args: RecordOptions, made: Protocol, finger: Finger, names: list[str], seed: int
) -> tuple[Run, Arrays]:
    """Return the run of a protocol and, for the virtual finger, the true values."""
    from softmap_edge.synthetic.finger import hide, stretch
    from softmap_edge.synthetic.virtual_finger import virtual_finger

    drawn = 0.5 if names else 0.0  # the strengths of hidden effects are drawn by solves
    if args.virtual:
        with stretch(0.0, drawn):
            virtual = virtual_finger(seed, finger, names)
        with stretch(drawn, 1.0):
            return virtual.measure(made, args.noise_seed)
    with stretch(0.0, drawn):
        truth = hide(names, seed, finger=finger)
    with stretch(drawn, 1.0):
        return truth.measure(made, args.noise_seed), {}


def _secrets(path: str) -> tuple[list[str], int]:
    """Return the hidden effects of a demo: names and seed."""
    try:
        document = json.loads(read_document(path, RunError))
        names, seed = [str(row["name"]) for row in document["hidden"]], document["seed"]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise RunError(
            f"{path}: not the document of a demo; make it with `softmap demo --json`"
        ) from None
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 2**63:
        raise RunError(f"{path}: seed {str(seed)[:40]}, expected a whole number from 0 on")
    return names, seed
