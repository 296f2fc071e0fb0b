"""The command `track`: move the tip along a figure, or print Table II or the workspace."""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from softmap_edge.commands.output import check_picture, next_command
from softmap_edge.commands.own import load_own, open_model
from softmap_edge.commands.progress import Bar
from softmap_edge.commands.robot import (
    check_driven,
    driven_arguments,
    driven_model,
    driven_robot,
    driving,
    plain_map,
)
from softmap_edge.commands.seeing import camera_arguments, late, receiver
from softmap_edge.errors import RecordingBroken, SoftmapError
from softmap_edge.files.atomic import Document, write_atomically
from softmap_edge.model.model import Model
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.drive.observations import Keeper, keeping, seen_file
from softmap_edge.robot.drive.track import Course, Tracked, course, spread
from softmap_edge.robot.drive.track import track as follow
from softmap_edge.robot.emulated.finger import LATE, SERVO
from softmap_edge.robot.link.frames import Seen
from softmap_edge.robot.motion.figures import FIGURES, WIDEST
from softmap_edge.robot.motion.kinematics import AXES, METHODS, Kinematics
from softmap_edge.robot.open import DrivenRobot
from softmap_edge.robot.servo.loop_limits import servo_limits
from softmap_edge.run.folds import LEAST_WITHHOLDING
from softmap_edge.synthetic.table_two import table_two, text_of


@dataclass(frozen=True)
class TrackOptions:
    """Options of `softmap track`, as its parser declares them."""

    figure: str | None
    sim: bool
    rig: str | None
    plan: bool
    table: bool
    workspace: bool
    alternative: str | None
    reach: list[float] | None
    amplitude: float
    duration: float
    rate: float | None
    axes: str | None
    method: str | None
    observe: bool
    camera: str | None
    key: str | None
    like: str | None
    late: float | None
    bundle: str | None
    effects: list[str]
    trust_onnx: bool
    no_effects: bool
    hide: str
    seed: int | None
    record: str | None
    picture: str | None
    json: bool


def track_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `track`."""
    parser.add_argument(
        "figure", nargs="?", help=f"{', '.join(FIGURES)}, or a polyline: FILE.csv (x,y)"
    )
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument(
        "--sim", action="store_true", help="on an emulated robot: real packets, simulated finger"
    )
    where.add_argument("--rig", metavar="FILE.toml", help="on the servos of this rig")
    where.add_argument("--plan", action="store_true", help="plan only, nothing moves")
    where.add_argument(
        "--table",
        action="store_true",
        help="the paper's Table II: letters on simulator and stand-in",
    )
    where.add_argument("--workspace", action="store_true", help="what the tip can reach")
    parser.add_argument(
        "--alternative", metavar="DIR", help="--table: another bundle to compare with (train prior)"
    )
    # its name before 0.2
    parser.add_argument(
        "--rival", dest="alternative", default=argparse.SUPPRESS, help=argparse.SUPPRESS
    )
    parser.add_argument(
        "--reach",
        nargs=3,
        type=float,
        metavar=("X", "Y", "Z"),
        help="--workspace: check whether this point (mm) is reachable",
    )
    parser.add_argument(
        "--amplitude", type=float, default=8.0, metavar="MM", help="half of the larger side (8)"
    )
    parser.add_argument(
        "--duration",
        type=float,
        default=20.0,
        metavar="S",
        help="least duration of the figure (20)",
    )
    parser.add_argument(
        "--rate", type=float, metavar="HZ", help="waypoints a second (30; --table: 3)"
    )
    parser.add_argument(
        "--axes", help="the plane of the figure, and what of the tip counts (xy; --workspace: xyz)"
    )
    parser.add_argument(
        "--method", choices=METHODS, help="how inverse kinematics is solved (exact; --table: paper)"
    )
    parser.add_argument(
        "--observe", action="store_true", help="feed back the tip position seen by the camera"
    )
    camera_arguments(parser)
    driven_arguments(parser, "; --table: of the stand-in (1)")
    parser.add_argument("--picture", metavar="FILE.svg", help="draw it")


def track(args: TrackOptions) -> int:
    """Move the tip along a figure, measure its error, draw it."""
    check_driven(args)
    check_picture("--picture", args.picture)
    if args.camera and not args.rig:
        raise SoftmapError(
            "--camera watches a robot; give --rig with it (an emulated finger has a camera of its "
            "own)"
        )
    if args.observe and not (args.sim or args.camera):
        raise SoftmapError(
            "--observe needs eyes: give --camera udp://:PORT (docs/do/camera.md), or --sim"
        )
    if (args.figure is None) == (not (args.table or args.workspace)):
        raise SoftmapError("name a figure, or give --table or --workspace without one")
    if (args.alternative and not args.table) or (args.reach and not args.workspace):
        raise SoftmapError(
            "--alternative goes with --table, --reach with --workspace; give that too"
        )
    only_driving = {
        "--record": args.record,
        "--seed": args.seed,
        "--key": args.key,
        "--like": args.like,
        "--late": args.late,
    }
    idle = [option for option, value in only_driving.items() if value is not None]
    if args.plan and idle:
        raise SoftmapError(f"{idle[0]} needs a robot, and --plan moves none; leave one of them out")
    behind = late(args, LATE[0] if args.sim else 0.0)
    load_own(args)
    model = open_model(args.bundle)
    if args.table:
        return _table(args, model)
    if args.workspace:
        return _workspace(args, Kinematics(driven_model(args, model), axes=args.axes or "xyz"))
    tracked = kept = None
    with contextlib.ExitStack() as stack:
        driven = (
            None
            if args.plan
            else stack.enter_context(driven_robot(args.rig, model, args.hide, args.seed))
        )
        seen = None if driven is None else stack.enter_context(_eyes(args, driven))
        calibration = driven.calibration if driven else model.calibration or plain_map(model)
        kinematics = Kinematics(
            driven_model(args, driven.model if driven else model), axes=args.axes or "xy"
        )
        limits = (
            driven.limits["servos"]
            if driven
            else [servo_limits(SERVO, 0, (-1000.0, 1000.0))] * model.channels
        )
        planned = course(
            kinematics,
            str(args.figure),
            amplitude=args.amplitude,
            duration=args.duration,
            rate=30.0 if args.rate is None else args.rate,
            slew=[one["slew"] for one in limits],
            acceleration=[one["acceleration"] for one in limits],
            calibration=calibration,
            method=args.method or "exact",
        )
        if driven is not None:
            record = Path(
                args.record
                or Path(stack.enter_context(tempfile.TemporaryDirectory())) / "track.mcap"
            )
            robot = Controller(
                driven.rig, calibration, driven.limits, kinematics=kinematics, record=record
            )
            with (
                _shown_first(lambda: tracked),
                driving(robot, args.record),
                _kept(args, seen, behind, driven) as kept,
                Bar(args.json) as bar,
            ):
                tracked = follow(
                    robot,
                    kinematics,
                    planned,
                    seen,
                    observe=args.observe,
                    late=behind,
                    progress=bar,
                )
    if args.picture:
        _draw(args.picture, kinematics, planned, tracked)
    sound = driven is not None and robot.unrecorded is None
    document = _document(args, kinematics, planned, tracked) | {
        "record": args.record if sound else None
    }
    seen_in = None if args.record is None else seen_file(args.record)
    document["seen"] = str(seen_in) if sound and kept is not None and kept.fault is None else None
    print(json.dumps(document) if args.json else _text(document))
    if driven is not None:
        robot.check_recorded()
    if kept is not None and kept.fault is not None:
        raise SoftmapError(f"{seen_in}: the camera frames are no longer recorded ({kept.fault})")
    return 0


@contextlib.contextmanager
def _shown_first(done: Callable[[], Tracked | None]) -> Iterator[None]:
    """Report an interrupted recording after the result, if there is a result."""
    try:
        yield
    except RecordingBroken:
        if done() is None:
            raise


@contextlib.contextmanager
def _eyes(args: TrackOptions, driven: DrivenRobot) -> Iterator[Seen | None]:
    """Yield the camera of the robot, if there is one."""
    if driven.finger is not None or args.camera is None:
        yield None if driven.finger is None else driven.finger.seen
        return
    with receiver(args, len(driven.model.rest)) as camera:
        yield camera.seen
        if not camera.taken:
            print(f"no frame came at {args.camera}; {camera.summary()}", file=sys.stderr)


@contextlib.contextmanager
def _kept(
    args: TrackOptions, seen: Seen | None, behind: float, driven: DrivenRobot
) -> Iterator[Keeper | None]:
    """Store the frames next to the recording, if there is one."""
    if seen is None or args.record is None:
        yield None
        return
    with keeping(args.record, seen, driven.model, behind) as keeper:
        yield keeper


def _draw(path: str, kinematics: Kinematics, planned: Course, tracked: Tracked | None) -> None:
    from softmap_edge.report.track_figure import track_figure

    write_atomically(path, track_figure(kinematics, planned, tracked))


def _document(
    args: TrackOptions, kinematics: Kinematics, planned: Course, tracked: Tracked | None
) -> Document:
    plan, counts = planned.plan, planned.counts
    seen = tracked is not None and len(tracked.error) > 0
    return {
        "schema": "softmap.track/1",
        "figure": args.figure,
        "amplitude_mm": args.amplitude,
        "axes": kinematics.axes,
        "method": args.method or "exact",
        "effects": kinematics.compensated,
        "left": [
            name for name in kinematics.model.chain_names if name not in kinematics.compensated
        ],
        "hidden": [name for name in args.hide.split(",") if name] if args.sim else None,
        "waypoints": int(counts.sum()),
        "asked_s": args.duration,
        "seconds": float(plan.t[-1] - plan.t[counts][0]),
        "quickest_s": planned.quickest,
        "unreachable_mm": float(plan.unreachable[counts].max()),
        "expected_mm": spread(plan.distance[counts]),
        "seen_mm": spread(tracked.error) if seen and tracked is not None else None,
        "driven": tracked is not None,
        "servos_s": None
        if not (tracked and tracked.response)
        else dict(zip(("delay", "lag"), tracked.response)),
        "observed": args.observe,
        "unseen_s": None if tracked is None else tracked.unseen,
        "picture": args.picture,
        "bundle": args.bundle,
    }


def _text(summary: Document) -> str:
    def numbers(name: str, things: str) -> str:
        return "{mean:.2f} ± {sd:.2f} mm (max {max:.2f}, {n} {0})".format(things, **summary[name])

    lines = [
        f"{summary['figure']}: {summary['waypoints']} waypoints in {summary['seconds']:.1f} s, "
        f"{summary['quickest_s']:.1f} s at least; effects compensated: "
        f"{', '.join(summary['effects']) or 'none'}"
        + (f"; not compensated: {', '.join(summary['left'])}" if summary["left"] else "")
    ]
    if summary["quickest_s"] > summary["asked_s"]:
        lines.append(
            f"{summary['asked_s']:g} s were asked for: slew and acceleration of the servos take "
            "longer"
        )
    if summary["unreachable_mm"] > 0.01:
        lines.append(
            f"part of it is out of reach, by up to {summary['unreachable_mm']:.2f} mm: the "
            "nearest points are taken"
        )
    lines.append(f"expected tip error {numbers('expected_mm', 'waypoints')}")
    if summary["servos_s"]:
        lines.append(
            "servos answer {delay:.3f} s late, with a lag of {lag:.3f} s: previewed".format(
                **summary["servos_s"]
            )
        )
    elif summary["driven"]:
        lines.append(
            "how late the servos answer could not be measured: nothing of it was previewed"
        )
    if summary["seen_mm"]:
        lines.append(f"measured tip error {numbers('seen_mm', 'frames')}")
        if summary["hidden"] == [] and summary["effects"]:
            lines.append(
                "the emulated finger has no hidden effect, so compensating "
                f"{', '.join(summary['effects'])} makes tracking worse; --hide NAMES injects "
                "effects, --no-effects compensates none"
            )
        if summary["unseen_s"]:
            fed = ", and nothing was fed back then" if summary["observed"] else ""
            lines.append(f"the tip was not seen for {summary['unseen_s']:.1f} s of it{fed}")
    elif summary["driven"]:
        lines.append("no camera: the true tip error is not known")
    lines += [
        f"{summary[name]}: written" for name in ("record", "seen", "picture") if summary[name]
    ]
    if summary["seen"]:
        bundle = summary["bundle"] or None
        frames = summary["seen_mm"]["n"] if summary["seen_mm"] else 0
        if frames < LEAST_WITHHOLDING:  # a diagnosis would have no data to validate on
            lines.append(
                f"{frames} frames are too few for a diagnosis, which needs {LEAST_WITHHOLDING} or "
                "more"
            )
            lines.append(next_command("next", "--standard", "--out", "next.csv", bundle=bundle))
        else:
            lines.append(next_command("diagnose", summary["record"], bundle=bundle))
    return "\n".join(lines)


# --- what is printed without a robot --------------------------------------------------------------
def _table(args: TrackOptions, model: Model) -> int:
    """Print Table II of the paper; return 0."""
    alternative = None if args.alternative is None else open_model(args.alternative)
    seed = 1 if args.seed is None else args.seed
    with Bar(args.json) as bar:
        rows = table_two(
            model,
            alternative,
            seed=seed,
            amplitude=args.amplitude,
            duration=args.duration,
            rate=3.0 if args.rate is None else args.rate,
            method=args.method or "paper",
            progress=bar,
        )
    document = {
        "schema": "softmap.table2/1",
        "bundle": args.bundle,
        "rival": None if args.alternative is None else Path(args.alternative).name,
        "kind": model.kind,
        "calibrated": model.calibration is not None,
        "effects": list(model.chain_names),
        "seed": seed,
        "amplitude_mm": args.amplitude,
        "method": args.method or "paper",
        "waypoints": len(rows[0].expected),
        "rows": [row.to_dict() for row in rows],
    }
    print(json.dumps(document) if args.json else text_of(document))
    return 0


def _workspace(args: TrackOptions, kinematics: Kinematics) -> int:
    """Print the reach of the tip and whether a point is within it, and draw it; return 0."""
    target = None if args.reach is None else np.asarray(args.reach, float)
    rest = np.asarray(kinematics.tip.evaluate(kinematics.home[None]))[0]
    if target is not None and not (np.abs(target) <= WIDEST).all():
        raise SoftmapError(f"--reach {target.tolist()}; numbers of up to {WIDEST:g} mm are allowed")
    places = kinematics.reach.samples[0]
    solved = None if target is None else kinematics.solve(target[None])
    unit = kinematics.model.command_unit
    document: Document = {
        "schema": "softmap.workspace/1",
        "axes": kinematics.axes,
        "command_unit": unit,
        f"commands_{unit}": kinematics.acting_bounds.tolist(),
        "rest_mm": rest.tolist(),
        "range_mm": {axis: [float(v.min()), float(v.max())] for axis, v in zip(AXES, places.T)},
        "target": None,
        "picture": args.picture,
    }
    if target is not None and solved is not None:
        document["target"] = {
            "target_mm": target.tolist(),
            "reached": bool(kinematics.reaches(target[None])[0]),
            "distance_mm": float(solved.distance[0]),
            "nearest_mm": solved.tip[0].tolist(),
            f"acting_{unit}": solved.acting[0].tolist(),
        }
    if args.picture:
        from softmap_edge.report.track_figure import workspace_figure

        write_atomically(
            args.picture,
            workspace_figure(kinematics, rest, target, None if solved is None else solved.tip[0]),
        )
    print(json.dumps(document) if args.json else _workspace_text(document))
    return 0


def _workspace_text(summary: Document) -> str:
    def point(numbers: list[float]) -> str:
        return "(" + ", ".join(f"{v:.2f}" for v in numbers) + ")"

    reach = ", ".join(
        f"{axis} {low:.1f} to {high:.1f}" for axis, (low, high) in summary["range_mm"].items()
    )
    lines = [f"the tip rests at {point(summary['rest_mm'])} mm and reaches {reach} mm"]
    if target := summary["target"]:
        where = f"{point(target['target_mm'])} mm, along {summary['axes']}"
        if target["reached"]:
            unit = summary["command_unit"]
            lines.append(
                f"{where}: within reach, where {point(target[f'acting_{unit}'])} {unit} acts"
            )
        else:
            lines.append(
                f"{where}: out of reach by {target['distance_mm']:.2f} mm; nearest is "
                f"{point(target['nearest_mm'])} mm"
            )
    lines += [f"{summary['picture']}: written"] if summary["picture"] else []
    return "\n".join(lines)
