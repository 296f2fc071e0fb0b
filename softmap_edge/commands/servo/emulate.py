"""The action `servo emulate`: an emulated robot at a pseudo-terminal, faults on standard input."""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from softmap_edge import _core
from softmap_edge.commands.output import check_bundle, check_file, check_idle, to_stderr
from softmap_edge.commands.own import effects_argument, load_own, open_model
from softmap_edge.commands.robot import own_map
from softmap_edge.errors import ServoError, SoftmapError
from softmap_edge.files.atomic import Document
from softmap_edge.files.printable import shell_file
from softmap_edge.model.bundle import save_bundle
from softmap_edge.model.model import Model
from softmap_edge.robot.emulated.finger import (
    BAUD,
    FRAMES,
    LATE,
    SERVO,
    EmulatedFinger,
    emulated_robot,
    hidden_laws,
)
from softmap_edge.robot.link.points import PointSender
from softmap_edge.robot.link.session import read_key, udp_address
from softmap_edge.robot.servo.models import servo_model
from softmap_edge.robot.servo.rig import MOST_SERVOS, Rig, RigServo, read_rig

FAULTS = (
    "faults, one a line: mute|stuck|torn|reversed|jammed|uncapped|mend|reset|lose_turn SERVO · "
    "heat SERVO °C · supply SERVO V · burden SERVO TIMES · fail SERVO BITS · rename SERVO ID · "
    "swap SERVO SERVO · drop|damage|junk|slow SHARE · unpowered 0|1 · unplug (SERVO from 0)"
)
FINGER_FAULTS = "blind 0|1"
EMULATED = "emulated"  # key of [made] that marks a rig file as emulated
KEPT_OPEN = "sleep infinity | softmap servo emulate …"
BROKEN = ("mute", "stuck", "torn", "reversed", "jammed", "uncapped")


@dataclass(frozen=True)
class EmulateOptions:
    """Options of `softmap servo emulate`, as its parser declares them."""

    bundle: str | None
    effects: list[str]
    trust_onnx: bool
    hide: str
    strength: float | None
    seed: int
    model: str
    baud: int
    fresh: bool
    servos: int | None
    rig: str | None
    force: bool
    calibrated: str | None
    stream: list[str]
    key: str | None
    json: bool


def emulate_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `servo emulate`."""
    parser.add_argument("--bundle", metavar="DIR", help="the finger (default: the built-in one)")
    effects_argument(parser)
    parser.add_argument(
        "--hide",
        "--hidden",
        default="",
        metavar="NAME,NAME",
        help="hidden effects: backlash,creep",
    )
    parser.add_argument("--strength", type=float, metavar="X", help="factor on their strength (1)")
    parser.add_argument("--seed", type=int, default=0, help="random seed (0)")
    parser.add_argument(
        "--model", default=SERVO, metavar="NAME", help=f"model of the servos ({SERVO})"
    )
    parser.add_argument(
        "--baud", type=int, default=BAUD, metavar="BAUD", help=f"baud rate of the servos ({BAUD})"
    )
    parser.add_argument(
        "--fresh", action="store_true", help="servos with factory settings: not set up, never homed"
    )
    parser.add_argument(
        "--servos", type=int, metavar="N", help="N servos with factory settings, without a finger"
    )
    parser.add_argument("--rig", metavar="FILE.toml", help="write the rig of the emulated robot")
    parser.add_argument(
        "--force",
        action="store_true",
        help="overwrite an existing rig and bundle, also those of a real robot",
    )
    parser.add_argument(
        "--calibrated", metavar="DIR", help="write its bundle, with the true map of the servos"
    )
    parser.add_argument(
        "--stream",
        action="append",
        default=[],
        metavar="udp://HOST:PORT",
        help="send the points of its camera to this address (docs/do/camera.md); may be repeated",
    )
    parser.add_argument("--key", metavar="FILE", help="sign the points with this shared key")


def emulate(args: EmulateOptions) -> int:
    """Emulate a robot until standard input ends or Ctrl-C; return 0."""
    check_file("--rig", args.rig, ".toml")
    _check_no_rig(args.rig, args.force)
    if not 0 <= args.seed < 2**63:
        raise ServoError(f"--seed {args.seed}; 0 to {2**63 - 1} is allowed")
    if args.servos is not None:
        return _bare(args, args.servos)
    if args.calibrated is not None:
        check_bundle(args.calibrated, args.force, "--calibrated")
    strength = 1.0 if args.strength is None else args.strength
    if not 0.0 < strength <= 10.0:
        raise ServoError(f"--strength {strength:g}; more than 0 and up to 10 times is allowed")
    if not args.hide:
        check_idle({"--strength": args.strength}, "nothing is hidden; give --hide NAME with it")
    load_own(args)
    model = open_model(args.bundle)
    calibration = own_map(model)
    names = [name for name in args.hide.split(",") if name]
    laws = hidden_laws(names, model.channels, args.seed, strength)
    senders = _senders(args)
    robot = emulated_robot(
        model,
        calibration,
        laws,
        seed=args.seed,
        servo=args.model,
        baud=args.baud,
        ready=not args.fresh,
    )
    with contextlib.ExitStack() as stack:
        for sender in senders:
            stack.enter_context(sender)
        bus, rig, _, finger = stack.enter_context(robot)
        if args.rig:
            _written(rig, args.rig)
        if args.calibrated:
            save_bundle(replace(model, calibration=calibration), args.calibrated)
        stack.enter_context(streaming(finger, senders))
        document = {
            "schema": "softmap.emulated/1",
            "port": bus.path,
            "baud": args.baud,
            "servos": len(rig.servos),
            "ready": not args.fresh,
            "robot": model.robot,
            "points": len(model.rest),
            "frames_a_second": FRAMES,
            "hidden": names,
            "rig": args.rig,
            "bundle": args.calibrated,
            "stream": args.stream,
        }
        print(
            json.dumps(document) if args.json else _sentence(args, bus.path, model, names),
            flush=True,
        )
        _obey(bus, finger)
    return 0


def _check_no_rig(path: str | None, force: bool) -> None:
    """Raise SoftmapError if `--rig` names a file that no emulator wrote, unless `force`."""
    if path is None or force or not Path(path).exists():
        return
    try:
        emulated = EMULATED in read_rig(path).made
    except ServoError:
        emulated = False
    if not emulated:
        raise SoftmapError(
            f"--rig {path}: a file that no emulator wrote stands there, perhaps a real rig; "
            "give another name, or --force to replace it"
        )


def _written(rig: Rig, path: str) -> None:
    """Write the rig file, marked as emulated."""
    replace(rig, made={**rig.made, EMULATED: {"by": "softmap servo emulate"}}).write(path)


def _sentence(args: EmulateOptions, port: str, model: Model, names: list[str]) -> str:
    """Return a text on the emulated robot, and the commands to type next."""
    lines = [
        f"{port} at {args.baud} baud, ids 1 to {model.channels}: '{model.robot}' is emulated, "
        f"never called real; it hides {', '.join(names) or 'nothing'}"
    ]
    lines += [
        f"{len(model.rest)} points a frame, {FRAMES:g} frames a second, to {to}"
        for to in args.stream
    ]
    lines += [f"{path}: written" for path in (args.rig, args.calibrated) if path]
    if args.fresh:
        rig = shell_file(args.rig or "rig.toml")
        lines += [
            "next, in another terminal, for each servo:",
            f"  softmap servo setup --port {port} --baud {args.baud} --id 1 --rig {rig}",
        ]
    elif args.rig and args.calibrated:
        on = f"--bundle {shell_file(args.calibrated)} --rig {shell_file(args.rig)}"
        seen = f" --camera {args.stream[0].replace('//127.0.0.1:', '//:')}" if args.stream else ""
        seen += f" --key {shell_file(args.key)}" if seen and args.key else ""
        lines += ["next, in another terminal:", f"  softmap track S {on}{seen} --picture s.svg"]
        if seen:
            lines += [
                "  softmap next --standard --out commands.csv",
                f"  softmap record commands.csv {on}{seen} --late {LATE[0]:g} --out run.npz",
            ]
    else:
        lines += [
            "give --rig and --calibrated too, and it can be driven: softmap track S --bundle DIR "
            "--rig FILE.toml"
        ]
    return "\n".join([*lines, f"{FAULTS} · {FINGER_FAULTS}"])


def _senders(args: EmulateOptions) -> list[PointSender]:
    if args.key and not args.stream:
        raise SoftmapError("--key signs what is sent; give --stream udp://HOST:PORT with it")
    key = None if args.key is None else read_key(args.key)
    return [
        PointSender(host or "127.0.0.1", port, key) for host, port in map(udp_address, args.stream)
    ]


@contextlib.contextmanager
def streaming(finger: EmulatedFinger, senders: list[PointSender]) -> Iterator[None]:
    """Send each frame of a finger's camera as it arrives, from a thread."""
    done = threading.Event()

    def live() -> None:
        last = -float("inf")
        while not done.wait(0.004):
            for frame in finger.seen()[-10:]:
                if frame.stamp > last:
                    last = frame.stamp
                    for sender in senders:
                        sender.send(frame.points, frame.stamp)

    thread = threading.Thread(target=live, daemon=True)
    if senders:
        thread.start()
    try:
        yield
    finally:
        done.set()
        if senders:
            thread.join(2.0)


def _bare(args: EmulateOptions, count: int) -> int:
    """Emulate servos without a finger, with a nominal load on each."""
    number = servo_model(args.model)["number"]
    if not 1 <= count <= MOST_SERVOS:
        raise ServoError(f"{count} servos; allowed are 1 to {MOST_SERVOS}")
    of_finger = {
        "--bundle": args.bundle,
        "--effects": args.effects,
        "--trust-onnx": args.trust_onnx,
        "--hide": args.hide,
        "--strength": args.strength,
        "--stream": args.stream,
        "--calibrated": args.calibrated,
        "--key": args.key,
    }
    check_idle(of_finger, "it needs a finger; leave --servos out")
    pull = [(1000.0, -400.0), (2000.0, 0.0), (3000.0, 400.0)]
    servos = [(id, number, args.baud, 2000.0) for id in range(1, count + 1)]
    bus = _core.EmulatedBus(servos, [pull] * count, seed=args.seed)
    try:
        if args.rig:
            _written(
                Rig(bus.path, args.baud, tuple(RigServo(id, args.model) for id, *_ in servos)),
                args.rig,
            )
        document: Document = {
            "schema": "softmap.emulated/1",
            "port": bus.path,
            "baud": args.baud,
        }
        text = f"{bus.path} at {args.baud} baud, ids 1 to {count}, no finger; {FAULTS}"
        print(
            json.dumps(document | {"servos": count, "ready": False}) if args.json else text,
            flush=True,
        )
        _obey(bus, None)
    finally:
        bus.unplug()
    return 0


def _obey(bus: _core.EmulatedBus, finger: EmulatedFinger | None) -> None:
    """Apply the faults read from standard input until it ends."""
    known = FAULTS if finger is None else f"{FAULTS} · {FINGER_FAULTS}"
    with contextlib.suppress(KeyboardInterrupt):
        for line in sys.stdin:
            if fault := line.split():
                try:
                    _break(bus, finger, fault)
                except ServoError as refused:
                    print(f"{line.strip()}: {refused}; {known}", file=sys.stderr)
                except (ValueError, OverflowError):
                    print(
                        f"{line.strip()}: some of its values are not numbers of that kind; {known}",
                        file=sys.stderr,
                    )
        to_stderr(
            f"standard input has ended, and {bus.path} with it; in the background keep it open: "
            f"{KEPT_OPEN}"
        )


def _break(bus: _core.EmulatedBus, finger: EmulatedFinger | None, fault: list[str]) -> None:
    """Apply one line of faults."""
    name, *numbers = fault
    if name == "unplug" and not numbers:
        bus.unplug()
    elif name in (*BROKEN, "mend") and len(numbers) == 1:
        bus.damage(
            int(numbers[0]), **({name: True} if name in BROKEN else dict.fromkeys(BROKEN, False))
        )
    elif name in ("reset", "lose_turn") and len(numbers) == 1:
        getattr(bus, name)(int(numbers[0]))
    elif name in ("heat", "supply", "burden") and len(numbers) == 2:
        getattr(bus, name)(int(numbers[0]), float(numbers[1]))
    elif name in ("fail", "rename", "swap") and len(numbers) == 2:
        getattr(bus, name)(int(numbers[0]), int(numbers[1], 0))
    elif name in ("drop", "damage", "junk", "slow") and len(numbers) == 1:
        share = float(numbers[0])
        bus.faults(
            drop=share * (name == "drop"),
            damage=share * (name == "damage"),
            junk=share * (name == "junk"),
            slow=share * (name == "slow"),
        )
    elif name == "unpowered" and len(numbers) == 1:
        bus.faults(unpowered=int(numbers[0]) == 1)
    elif name == "blind" and numbers in (["0"], ["1"]) and finger is not None:
        finger.blind(numbers == ["1"])
    else:
        raise ServoError("no such fault")
