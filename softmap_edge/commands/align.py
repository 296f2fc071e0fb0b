"""The commands `run align` and `run register`: runs in the base frame, vertices of clouds."""

from __future__ import annotations

import argparse
import dataclasses
import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from softmap_edge.alignment.align import align_base, align_home, clamped_places
from softmap_edge.alignment.base_in_clouds import align_clouds
from softmap_edge.alignment.clouds import read_clouds
from softmap_edge.alignment.register import PRINTED
from softmap_edge.alignment.register import register as lay
from softmap_edge.alignment.result import Alignment, base_markers, in_frame
from softmap_edge.commands.output import check_file, check_no_run, next_command
from softmap_edge.commands.own import effects_argument, load_own, open_model
from softmap_edge.errors import AlignError, RegistrationError
from softmap_edge.geometry.rigid import RigidPose
from softmap_edge.robot.drive.recorded import open_run
from softmap_edge.run.run import Run

if TYPE_CHECKING:
    from softmap_edge.model.model import Model

Floats = NDArray[np.float64]

POOR = 1  # exit code if a frame has warnings

_HOW = (
    "give --base clamped, --base 0 1 2 (numbers whose places are in `marker_rest`), --base "
    "0:X,Y,Z 1:X,Y,Z … or, of the run's `base_markers`, --base b0:X,Y,Z b1:X,Y,Z … (b0 alone: "
    "where it is seen on average)"
)


@dataclass(frozen=True)
class AlignOptions:
    """Options of `softmap run align`, as its parser declares them."""

    run: str
    bundle: str | None
    effects: list[str]
    trust_onnx: bool
    out: str
    base: list[str] | None
    follow_base: bool
    drop_base: bool
    force: bool
    like: str | None
    json: bool


def align_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `run align`."""
    parser.add_argument("run", help="a run (.npz or .mcap) in the frame of the camera or mocap")
    parser.add_argument(
        "--bundle", metavar="DIR", help="the model of this robot (default: the built-in finger)"
    )
    effects_argument(parser)
    parser.add_argument(
        "--out", required=True, metavar="RUN", help="the run in the base frame (.npz)"
    )
    parser.add_argument(
        "--base",
        nargs="+",
        metavar="POINT",
        help=(
            "align by points fixed to the base, not by home frames: clamped, or marker numbers, "
            "each with its place in the base frame in mm unless `marker_rest` has it: 0:30,0,0 "
            "1:0,30,0 2:-30,0,0; b0 is the first of the run's `base_markers`"
        ),
    )
    parser.add_argument(
        "--follow-base", action="store_true", help="remove the motion of the base, frame by frame"
    )
    parser.add_argument(
        "--drop-base", action="store_true", help="leave the base markers out of the run afterwards"
    )
    parser.add_argument("--force", action="store_true", help="overwrite an existing run")
    parser.add_argument(
        "--like", metavar="RUN", help="use the transform of a run that is already aligned"
    )


def align(args: AlignOptions) -> int:
    """Find the transform from the measurement frame to the base; write the transformed run."""
    check_file("--out", args.out, ".npz")
    check_no_run("--out", args.out, args.force)
    run = open_run(args.run)
    if args.like:
        return _like(args, args.like, run)
    if (args.follow_base or args.drop_base) and not args.base:
        raise AlignError(f"--follow-base and --drop-base need base points; {_HOW}")
    places = _places(args, args.base, run) if args.base and run.points is None else {}
    if run.points is not None:
        found = _of_clouds(args, run)
    else:
        found = (
            align_base(run, places, args.follow_base)
            if args.base
            else align_home(run, _bundle(args))
        )
    aligned = found.apply(run)
    if args.drop_base:
        aligned = without(aligned, list(places))
    aligned.save(args.out)
    if args.json:
        print(
            json.dumps(found.to_dict() | {"run": args.run, "out": args.out, "hash": aligned.hash()})
        )
    else:
        print(f"{found}\nwritten to {args.out}\n{next_command('check', args.out)}")
    return 0


def _bundle(args: AlignOptions) -> Model:
    load_own(args)
    return open_model(args.bundle)


def _of_clouds(args: AlignOptions, run: Run) -> Alignment:
    """Find the frame of point clouds from the body near the clamp."""
    if args.base != ["clamped"] or args.follow_base or args.drop_base:
        raise AlignError(
            f"{args.run}: holds clouds, whose base is found from the body near the clamp: give "
            "--base clamped"
        )
    return align_clouds(run, _bundle(args))


def _like(args: AlignOptions, like: str, run: Run) -> int:
    """Apply the transform of another run, in which cameras and base were at the same places."""
    if args.base or args.follow_base or args.drop_base:
        raise AlignError("--like takes a transform that is known; it goes with no --base")
    other = open_run(like)
    if other.frame is None or other.frame_sigma is None:
        raise AlignError(
            f"{like}: was not aligned; `softmap run align` it first and give its output"
        )
    if run.frame is not None:
        raise AlignError(f"{args.run}: is aligned already; give the run as it was recorded")
    aligned = in_frame(run, RigidPose(other.frame[:, :3], other.frame[:, 3]), other.frame_sigma)
    aligned.save(args.out)
    document = {
        "schema": "softmap.align/1",
        "method": "like",
        "like": args.like,
        "run": args.run,
        "out": args.out,
    }
    text = (
        f"{args.out}: in the base frame by the transform of {args.like}; cameras and base must "
        f"stand as they did then\n{next_command('check', args.out)}"
    )
    print(json.dumps(document) if args.json else text)
    return 0


def _places(args: AlignOptions, base: list[str], run: Run) -> dict[int, Floats]:
    """Return the base-frame position of each point that --base names."""
    if base == ["clamped"]:
        return clamped_places(run, _bundle(args))
    places: dict[int, Floats] = {}
    for word in " ".join(base).replace(", ", ",").split():
        for part in [word] if ":" in word else word.split(","):
            number, _, place = part.partition(":")
            names = run.marker_names
            number = str(names.index(number)) if number in names else number
            try:
                of_base = number.startswith("b")
                index = int(number[of_base:])
                own = _mean if of_base else _rest
                at = np.array([float(x) for x in place.split(",")]) if place else own(run, index)
                index += _markers(run) if of_base else 0
            except ValueError:
                raise AlignError(f"--base {part}: no number of a marker; {_HOW}") from None
            if at.shape != (3,) or index in places:
                raise AlignError(
                    f"--base {part}: expected one place of three numbers in mm for each marker; "
                    f"{_HOW}"
                )
            places[index] = at
    return places


def _rest(run: Run, index: int) -> Floats:
    if run.marker_rest is None:
        raise AlignError(
            f"--base {index}: the run has no `marker_rest`, so its place is not known; give "
            f"{index}:X,Y,Z"
        )
    if not 0 <= index < len(run.marker_rest):
        raise AlignError(f"--base {index}: the run has markers 0 to {len(run.marker_rest) - 1}")
    return np.asarray(run.marker_rest[index])


def _markers(run: Run) -> int:
    return int(run.seen_points.shape[1])


def _mean(run: Run, index: int) -> Floats:
    """Return the mean position of a base marker, so that only its motion is removed."""
    base = base_markers(run)
    if not 0 <= index < base.shape[1]:
        held = f"b0 to b{base.shape[1] - 1}" if base.shape[1] else "none"
        raise AlignError(f"--base b{index}: the run's base markers are {held}")
    return np.nanmedian(base[:, index], axis=0)


def without(run: Run, names: list[int]) -> Run:
    """Return the run without some of its markers."""
    # the run has separate base markers
    names = [n for n in names if n < _markers(run)]
    if run.markers is None:
        raise AlignError("--drop-base leaves markers out; vertices belong to the template and stay")
    keep = np.setdiff1d(np.arange(run.markers.shape[1]), names)
    if not len(keep):
        raise AlignError("--drop-base: no marker is left; the run needs markers on the robot too")
    visible = run.visible
    sigma = run.sigma
    rest = run.marker_rest
    extra = run.extra
    labels = extra.get("marker_labels")
    if labels is not None and labels.shape == (run.markers.shape[1],):
        extra = extra | {"marker_labels": labels[keep]}
    return dataclasses.replace(
        run,
        markers=run.markers[:, keep],
        visible=visible if visible is None or not visible.ndim else visible[:, keep],
        sigma=sigma if sigma is None or not sigma.ndim else sigma[:, keep],
        extra=extra,
        marker_rest=None if rest is None else rest[keep],
    )


@dataclass(frozen=True)
class RegisterOptions:
    """Options of `softmap run register`, as its parser declares them."""

    clouds: list[str]
    bundle: str | None
    effects: list[str]
    trust_onnx: bool
    out: str
    mode: Literal["robust", "paper"]
    force: bool
    json: bool


def register_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `run register`."""
    parser.add_argument(
        "clouds",
        nargs="+",
        help=(
            "a run with clouds (.npz), or a cloud per frame (PLY, PCD, CSV, XYZ, OBJ, NPY, NPZ), mm"
        ),
    )
    parser.add_argument(
        "--bundle", metavar="DIR", help="the model of this finger (default: the built-in finger)"
    )
    effects_argument(parser)
    parser.add_argument("--out", required=True, metavar="RUN", help="the run of vertices (.npz)")
    parser.add_argument(
        "--mode",
        choices=("robust", "paper"),
        default="robust",
        help="robust, or the published objective",
    )
    parser.add_argument("--force", action="store_true", help="overwrite an existing run")


def register(args: RegisterOptions) -> int:
    """Fit the template to each point cloud, and write the run of its vertices."""
    check_file("--out", args.out, ".npz")
    check_no_run("--out", args.out, args.force)
    load_own(args)
    notes: list[str] = []
    model, run = open_model(args.bundle), read_clouds(args.clouds, notes)
    try:
        found = lay(model, run, args.mode)
    except RegistrationError as fault:  # the columns may have been guessed wrongly
        raise RegistrationError("; ".join([str(fault), *notes[:PRINTED]])) from None
    vertices = found.run(run)
    vertices.save(args.out)
    if args.json:
        print(
            json.dumps(found.to_dict() | {"notes": notes, "out": args.out, "hash": vertices.hash()})
        )
    else:
        lines = [f"  look at: {note}" for note in notes[:PRINTED]]
        lines += (
            [f"  and {len(notes) - PRINTED} more such files (--json)"]
            if len(notes) > PRINTED
            else []
        )
        after = next_command("compare", args.out, bundle=args.bundle)
        print("\n".join([str(found), *lines, f"written to {args.out}", after]))
    return POOR if any(row["warnings"] for row in found.frames) else 0
