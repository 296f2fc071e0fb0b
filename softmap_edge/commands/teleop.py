"""The command `teleop` and its helpers: fetch the hand model, make a key, send landmarks."""

from __future__ import annotations

import argparse
import contextlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

from softmap_edge.commands.output import to_stderr
from softmap_edge.commands.own import load_own, open_model
from softmap_edge.commands.robot import check_driven, driven_arguments, driven_model, driven_robot
from softmap_edge.errors import RecordingBroken, TeleopError
from softmap_edge.files.atomic import Document
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.link.session import dropped_words, new_key, read_key
from softmap_edge.robot.motion.kinematics import Kinematics
from softmap_edge.robot.servo.clock import BUSY
from softmap_edge.robot.servo.terminal import terminal
from softmap_edge.robot.teleop.busy import LONG
from softmap_edge.robot.teleop.drive import Drive, DriveState
from softmap_edge.robot.teleop.frames import UdpAddress, source
from softmap_edge.robot.teleop.gesture import Rule
from softmap_edge.robot.teleop.hand import HandMap, View
from softmap_edge.robot.teleop.hand_source import (
    CameraHandSource,
    HandSource,
    NullHandSource,
    RemoteHandSource,
    camera_hand_source,
)
from softmap_edge.robot.teleop.keys import Input
from softmap_edge.robot.teleop.landmarks import Receiver, Sender
from softmap_edge.robot.teleop.mapping import DirectMapping, HandMapping, TipMapping
from softmap_edge.robot.teleop.model_file import fetch_model
from softmap_edge.robot.teleop.page import PORT, Page
from softmap_edge.robot.teleop.page_state import PageState
from softmap_edge.robot.teleop.remote_sender import send
from softmap_edge.robot.teleop.sketch import ShapePreview
from softmap_edge.robot.teleop.terminal import HELP, Terminal

DONE, FAULT = 0, 1
RULES = {rule.replace(" ", "-"): rule for rule in get_args(Rule)}


@dataclass(frozen=True)
class TeleopOptions:
    """Options of `softmap teleop`, as its parser declares them."""

    sim: bool
    rig: str | None
    send: str | None
    fetch_model: str | None
    new_key: str | None
    camera: str
    model: str | None
    key: str | None
    page: str
    page_host: str
    tip: bool
    hand: Literal["any", "left", "right"]
    mirrored: bool
    flip: str
    reach: tuple[float, float]
    gesture: str
    seconds: float | None
    bundle: str | None
    effects: list[str]
    trust_onnx: bool
    no_effects: bool
    hide: str
    seed: int | None
    record: str | None
    force: bool
    json: bool


def teleop_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `teleop`."""
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument(
        "--sim", action="store_true", help="an emulated robot: real packets, simulated finger"
    )
    what.add_argument("--rig", metavar="FILE.toml", help="the servos of this rig")
    what.add_argument(
        "--send",
        metavar="udp://HOST:PORT",
        help="do not drive: send landmarks and key to this address",
    )
    what.add_argument(
        "--fetch-model",
        metavar="FROM",
        help="make the model of hands of mediapipe's wheel, or a copy",
    )
    what.add_argument(
        "--new-key", metavar="FILE", help="create the key to share between both computers"
    )
    cameras = "a camera, a video, landmarks of another computer, or none: keys and mouse (none)"
    parser.add_argument(
        "--camera", default="none", metavar="N|/dev/…|FILE|udp://:PORT|none", help=cameras
    )
    parser.add_argument(
        "--model", metavar="FILE.task", help="the model of hands (where --fetch-model puts it)"
    )
    parser.add_argument("--key", metavar="FILE", help="the key of --send or --camera udp://")
    parser.add_argument(
        "--page", default=str(PORT), metavar="PORT|none", help=f"of the page; 0: any free ({PORT})"
    )
    parser.add_argument(
        "--page-host",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="address of the page (127.0.0.1)",
    )
    parser.add_argument(
        "--tip", action="store_true", help="lead the tip in x and y, by inverse kinematics"
    )
    parser.add_argument(
        "--hand", default="any", choices=("any", "left", "right"), help="which hand drives (any)"
    )
    parser.add_argument("--mirrored", action="store_true", help="the camera image is mirrored")
    parser.add_argument(
        "--flip",
        default="",
        metavar="x,y",
        help="reverse the hand's lateral (x) or forward (y) direction",
    )
    reach = "motion to the end of the range, in hand scales ({:g},{:g})".format(*HandMap.reach)
    parser.add_argument(
        "--reach", default=HandMap.reach, type=_two, metavar="SIDE,FORWARD", help=reach
    )
    parser.add_argument(
        "--gesture",
        default="fist-releases",
        choices=RULES,
        help="in addition to the key (fist-releases)",
    )
    parser.add_argument("--seconds", type=float, metavar="S", help="end after this time, s")
    driven_arguments(parser)
    parser.add_argument(
        "--force", action="store_true", help="--fetch-model: replace the file that is there"
    )


def teleop(args: TeleopOptions) -> int:
    """Drive by hand until the file, Ctrl-C, q or the loop ends it."""
    if args.fetch_model:
        made = fetch_model(args.fetch_model, args.model, force=args.force)
        _print(
            args,
            {"model": str(made.path), "sha256": made.sha256, "known_as": made.known_as or None},
            str(made),
        )
        return DONE
    if args.new_key:
        new_key(args.new_key)
        text = (
            f"{args.new_key}: a new key; copy it to the other computer, where only you can read it"
        )
        _print(args, {"key": args.new_key}, text)
        return DONE
    if args.seconds is not None and not 0 < args.seconds <= 1e6:
        raise TeleopError(f"--seconds {args.seconds:g}; allowed is above 0, up to 1000000")
    return _send(args, args.send) if args.send else _drive(args)


def _drive(args: TeleopOptions) -> int:
    check_driven(args)
    load_own(args)
    loaded = open_model(args.bundle)
    flips = _flips(args.flip)
    with contextlib.ExitStack() as stack:
        eyes = stack.enter_context(_eyes(args, stack))
        by_hand = not isinstance(eyes, NullHandSource)
        inputs: list[Input] = []
        page = None
        if args.page != "none":
            page = stack.enter_context(
                Page(_port(args.page), args.page_host, "hand" if by_hand else "knob")
            )
            inputs.append(page)
        if isinstance(eyes, RemoteHandSource):
            inputs.append(eyes)
        if (typed := terminal()) is not None:
            inputs.append(stack.enter_context(Terminal("hand" if by_hand else "knob", typed)))
            to_stderr(HELP)
        if not inputs and args.seconds is None and not by_hand:
            raise TeleopError(
                "nothing can drive: no page, no terminal, no camera; leave --page none away"
            )
        driven = stack.enter_context(
            driven_robot(args.rig, loaded, args.hide, args.seed, person=True)
        )
        model = driven_model(args, driven.model)
        kinematics = Kinematics(model, axes="xy" if args.tip else "xyz")
        aim: HandMapping = TipMapping(kinematics) if args.tip else DirectMapping(kinematics)
        # reported below, after the summary
        stack.enter_context(contextlib.suppress(RecordingBroken))
        robot = stack.enter_context(
            Controller(
                driven.rig,
                driven.calibration,
                driven.limits,
                kinematics=kinematics,
                record=args.record,
                tell=to_stderr,
            )
        )
        robot.at_terminal = True
        show: Callable[[DriveState], None] | None = None
        if page is not None:
            about = {"source": "hand" if by_hand else "knob"}
            shown = PageState(model, aim, eyes, ShapePreview(model, driven.calibration), about)
            page.shows(shown.hello, shown.view)
            show = shown.take
            to_stderr(f"open {page.url}")
        drive = Drive(
            robot,
            kinematics,
            aim,
            eyes,
            inputs,
            reach=args.reach,
            flip=flips,
            rule=RULES[args.gesture],
            stays=page is not None,
            show=show,
            say=to_stderr,
        )
        account = drive.run(args.seconds)
    summary = {
        "robot": model.robot,
        "camera": eyes.name,
        "aim": "tip" if args.tip else "direct",
        "effects": list(model.chain_names),
        "pictures": eyes.taken,
        "hands": eyes.hands,
        "refused": eyes.refused if isinstance(eyes, RemoteHandSource) else {},
        **account.to_dict(),
        "command_age_us": robot.ended.get("command_age_us"),
        "record": args.record if robot.unrecorded is None else None,
    }
    _print(args, summary, _text(summary))
    robot.check_recorded()
    return FAULT if account.failed else DONE


def _eyes(args: TeleopOptions, stack: contextlib.ExitStack) -> HandSource:
    view = View(args.hand, args.mirrored)
    if args.camera == "none":
        return NullHandSource()
    what = source(args.camera)
    if isinstance(what, UdpAddress):
        receiver = stack.enter_context(
            Receiver(what.host, what.port, _key(args, "--camera udp://"))
        )
        return RemoteHandSource(receiver, view)
    return camera_hand_source(what, args.model, view)


def _send(args: TeleopOptions, target: str) -> int:
    there = source(target)
    if not isinstance(there, UdpAddress) or not there.host:
        raise TeleopError(f"--send {target}: give udp://HOST:PORT")
    what = source(args.camera) if args.camera != "none" else None
    if what is None or isinstance(what, UdpAddress):
        raise TeleopError(
            f"--send: --camera {args.camera} gives no pictures; give a camera, or a video"
        )
    key = _key(args, "--send")
    with contextlib.ExitStack() as stack:
        eyes: CameraHandSource = stack.enter_context(
            camera_hand_source(what, args.model, View(args.hand, args.mirrored))
        )
        sender = stack.enter_context(Sender(there.host, there.port, key))
        typed = terminal()
        keys = None if typed is None else stack.enter_context(Terminal("hand", typed))
        if keys is not None:
            to_stderr("hold Space to drive, q ends")
        sent = send(eyes, sender, keys, args.seconds, to_stderr)
    summary = {"camera": eyes.name, "pictures": eyes.taken, "hands": eyes.hands, **sent.to_dict()}
    _print(
        args,
        summary,
        f"{eyes.taken} pictures, {eyes.hands} with a hand, {sent.sent} sent; {sent.ended}",
    )
    return FAULT if sent.failed else DONE


def _key(args: TeleopOptions, what: str) -> bytes:
    if args.key is None:
        raise TeleopError(
            f"{what} needs --key FILE, the same on both computers; --new-key FILE makes one"
        )
    return read_key(args.key)


def _port(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= 5):
        raise TeleopError(f"--page {text!r:.40}: give a port, 0 for any free one, or none")
    return int(text)


def _two(text: str) -> tuple[float, float]:
    try:
        side, forward = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r:.30}: give two numbers, SIDE,FORWARD, as 0.35,0.8"
        ) from None
    return side, forward


def _flips(text: str) -> tuple[bool, bool]:
    """Return the axes whose sign is changed."""
    named = [part for part in text.split(",") if part]
    if wrong := [part for part in named if part not in ("x", "y")]:
        raise TeleopError(f"--flip {wrong[0]!r:.20}: there are x and y")
    return "x" in named, "y" in named


def _print(args: TeleopOptions, summary: Document, text: str) -> None:
    print(json.dumps({"schema": "softmap.teleop/1", **summary}) if args.json else text)


def _text(summary: Document) -> str:
    lines = [
        f"driven for {summary['driving_s']:.1f} s in {summary['presses']} presses; ended: "
        f"{summary['ended']}"
    ]
    if summary["pictures"]:
        late = summary["latency_ms"]
        lines.append(
            f"{summary['pictures']} pictures, {summary['hands']} with a hand"
            + (
                ", {median:.0f} ms from picture to command (median; 95 %: {p95:.0f})".format(**late)
                if late
                else ""
            )
        )
    if summary["refused"]:
        lines.append(dropped_words(summary["refused"]))
    if summary["busy_s"] > LONG:
        lines.append(
            f"{BUSY}: the simulated robot stood still for {summary['busy_s']:.1f} s in all"
        )
    lines += [f"driving ended {count} times: {why}" for why, count in summary["lost"].items()]
    lines.append(
        "states: "
        + ", ".join(f"{state} {seconds:.1f} s" for state, seconds in summary["states_s"].items())
    )
    if summary["record"]:
        lines.append(f"{summary['record']}: written")
    return "\n".join(lines)
