"""Shared by commands that use a camera: its arguments, and the receiver of its points."""

from __future__ import annotations

import argparse
from typing import Protocol

from softmap_edge.errors import SoftmapError
from softmap_edge.robot.drive.observations import LATEST
from softmap_edge.robot.drive.recorded import open_run
from softmap_edge.robot.link.points import PointReceiver
from softmap_edge.robot.link.session import read_key, udp_address


class CameraOptions(Protocol):
    """Options that `camera_arguments` declares."""

    @property
    def camera(self) -> str | None: ...
    @property
    def key(self) -> str | None: ...
    @property
    def like(self) -> str | None: ...
    @property
    def late(self) -> float | None: ...


def camera_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the source of the points."""
    parser.add_argument(
        "--camera",
        metavar="udp://:PORT",
        help="address to which the camera program sends points (docs/do/camera.md)",
    )
    parser.add_argument(
        "--key",
        metavar="FILE",
        help="key shared with that program; required between computers",
    )
    parser.add_argument(
        "--like",
        metavar="RUN",
        help="points are in the camera frame: transform them to the base as in this aligned run",
    )
    parser.add_argument(
        "--late",
        type=float,
        metavar="S",
        help="delay of the fastest frame from exposure to arrival, s (0)",
    )


def receiver(args: CameraOptions, count: int | None = None) -> PointReceiver:
    """Return the receiver of `--camera`, for frames of `count` points.

    Raises:
        SoftmapError: an argument is not valid, or the address is not available.
    """
    frame = None if args.like is None else open_run(args.like).frame
    if args.like is not None and frame is None:
        raise SoftmapError(
            f"--like {args.like}: it was not aligned; `softmap run align` brings it to the base"
        )
    key = None if args.key is None else read_key(args.key)
    if args.camera is None:
        raise SoftmapError("no camera is given; give --camera udp://:PORT (docs/do/camera.md)")
    return PointReceiver(*udp_address(args.camera), key, count=count, frame=frame)


def late(args: CameraOptions, otherwise: float = 0.0) -> float:
    """Return `--late` after a check.

    Raises:
        SoftmapError: it is not a valid time.
    """
    seconds = otherwise if args.late is None else float(args.late)
    if not 0.0 <= seconds <= LATEST:
        raise SoftmapError(f"--late {seconds:g}: 0 to {LATEST:g} s is allowed")
    return seconds
