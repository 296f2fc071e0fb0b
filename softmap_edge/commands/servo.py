"""The verbs servo and replay: servos found, read, set up and released; the emulated ones; a recording decided again."""

from __future__ import annotations

import argparse
import json
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from softmap_edge.commands.output import check_file, check_no_run
from softmap_edge.commands.servo_calibrate import calibrate_bench, calibrate_bench_arguments
from softmap_edge.commands.servo_emulate import emulate, emulate_arguments
from softmap_edge.commands.servo_heartbeat import heartbeat, heartbeat_arguments
from softmap_edge.commands.servo_home import home, home_arguments
from softmap_edge.commands.servo_limits import limits, limits_arguments
from softmap_edge.commands.servo_pull import pull_arguments, pull_test
from softmap_edge.commissioning import setup
from softmap_edge.errors import RecordingWarning, ServoError
from softmap_edge.experiment.recorded import run_of
from softmap_edge.servo.bus import opened, ports, release
from softmap_edge.servo.ending import kept_words
from softmap_edge.servo.recording import read_recording
from softmap_edge.servo.rig import Rig, RigServo, read_rig

Declare = Callable[[argparse.ArgumentParser], None]
Do = Callable[[argparse.Namespace], int]
SLOWEST, FASTEST = 9_600, 4_500_000  # baud
OTHERWISE = 1  # exit code: a fault, or a recording that is decided otherwise


def _ports(args: argparse.Namespace) -> list[str]:
    """Return the ports that are meant.

    Raises:
        ServoError: none, or a rate that no port has.
    """
    if args.baud is not None and not SLOWEST <= args.baud <= FASTEST:
        raise ServoError(f"--baud {args.baud}; {SLOWEST} to {FASTEST} is allowed")
    found = [args.port] if args.port else ports()
    if not found:
        raise ServoError("no serial port on this machine; connect the adapter, or give --port")
    return found


def _scan(args: argparse.Namespace) -> int:
    found = []
    for port in _ports(args):
        for servo in setup.scan(port, args.baud):
            found.append(servo)
            if not args.json:
                print(servo)
    if args.json:
        print(json.dumps({"schema": "softmap.servos/1", "servos": [_told(servo) for servo in found]}))
    elif not found:
        print("no servo answers; check its power and wiring")
    return 0 if found else OTHERWISE


def _told(servo: setup.Found) -> dict[str, Any]:
    name = servo.model["name"] if servo.model else None
    return dict(
        port=servo.port, baud=servo.baud, id=servo.id, model=name, model_number=servo.number, firmware=servo.firmware
    )


def _find(args: argparse.Namespace) -> list[setup.Found]:
    """Return the servos that are meant."""
    found = [servo for port in _ports(args) for servo in setup.scan(port, args.baud)]
    if args.id is not None:
        found = [servo for servo in found if servo.id == args.id]
    if not found:
        which = "no servo" if args.id is None else f"no servo of id {args.id}"
        raise ServoError(f"{which} answers; check power and wiring, `softmap servo scan` lists what does")
    return found


def _read(args: argparse.Namespace) -> int:
    documents, well = [], True
    for servo in _find(args):
        with opened(servo.port, servo.baud) as bus:
            values = setup.registers(bus, servo.id)
        said = setup.complaints(servo, values)
        well &= not said
        documents.append(_told(servo) | {"registers": values, "complaints": said})
        if not args.json:
            print(servo)
            print("\n".join(f"  {name.replace('_', ' '):<24} {value}" for name, value in values.items()))
            print("\n".join(f"  ! {line}" for line in said) or "  set up")
    if args.json:
        print(json.dumps({"schema": "softmap.servos/1", "servos": documents}))
    return 0 if well else OTHERWISE


def _setup(args: argparse.Namespace) -> int:
    check_file("--rig", args.rig, ".toml")
    found = _find(args)
    if len(found) > 1:
        ids = ", ".join(str(servo.id) for servo in found)
        raise ServoError(f"{len(found)} servos answer (ids {ids}); connect one at a time, or say which with --id")
    old = read_rig(args.rig) if args.rig and Path(args.rig).exists() else None
    if old is not None:
        _check_rate(old, found[0].id, args.new_baud or found[0].baud)  # before anything is changed
    mended: list[str] = []
    done = setup.set_up(found[0], args.new_id, args.new_baud, mended.append)
    if args.rig:
        for one in old.servos if old is not None else ():
            held = {"home": one.home, "measured current": one.current_mA} if one.id == done.id else {}
            if names := [name for name, value in held.items() if value is not None]:
                mended.append(f"{args.rig} held its {' and '.join(names)}: taken out, to be found anew")
        bench = _noted(done, old)
        (bench.write if old is None else bench.note)(args.rig)
    if args.json:
        print(json.dumps({"schema": "softmap.servos/1", "servos": [_told(done)], "rig": args.rig, "mended": mended}))
    else:
        print("".join(f"  {line}\n" for line in mended), end="")
        print(f"{done}: set up" + (f", noted in {args.rig}" if args.rig else ""))
        print(f"  next, once all are: softmap servo home --rig {args.rig or 'FILE'}")
    return 0


def _check_rate(bench: Rig, id: int, baud: int) -> None:
    if bench.baud != baud:
        raise ServoError(f"the bench runs at {bench.baud} baud, servo {id} at {baud}; give --new-baud {bench.baud}")


def _noted(done: setup.Found, old: Rig | None) -> Rig:
    """Return the bench with the servo that was set up; it keeps its place if it is there."""
    assert done.model is not None
    new = RigServo(done.id, done.model["name"])  # another mode may count turns anew: no home, no ceiling
    if old is None:
        return Rig(done.port, done.baud, (new,))
    _check_rate(old, done.id, done.baud)
    servos = [new if servo.id == done.id else servo for servo in old.servos]
    if new not in servos:
        servos.append(new)
    return replace(old, port=done.port, servos=tuple(servos))


def _off(args: argparse.Namespace) -> int:
    port, baud, ids = args.port, args.baud, []
    if args.rig:
        rig = read_rig(args.rig)
        port, baud, ids = port or rig.port, baud or rig.baud, [servo.id for servo in rig.servos]
    args.port = port
    ports, released, kept = _ports(args), [], []
    for name in ports:
        there, left = release(name, baud, ids)
        released += there
        kept += left
        if not args.json:
            told = f"off: servo {', '.join(map(str, there))}" if there else "no servo confirmed it"
            print(f"{name}: torque off was sent; {told}")
            if left:
                print(f"{name}: {kept_words(left)}")
    if args.json:
        document = {"schema": "softmap.servos/1", "released": ports, "confirmed": released, "not_confirmed": kept}
        print(json.dumps(document))
    return 0 if released and not kept else OTHERWISE


def _bus_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--port", metavar="PORT", help="a serial port; every one of this machine without it")
    parser.add_argument("--baud", type=int, metavar="BAUD", help="one rate; every known one without it")


def _read_arguments(parser: argparse.ArgumentParser) -> None:
    _bus_arguments(parser)
    parser.add_argument("--id", type=int, metavar="ID", help="one servo; all that answer without it")


def _setup_arguments(parser: argparse.ArgumentParser) -> None:
    _bus_arguments(parser)
    parser.add_argument("--id", type=int, metavar="ID", help="its id now, where several servos are connected")
    parser.add_argument("--new-id", type=int, metavar="ID", help="the id it gets")
    parser.add_argument("--new-baud", type=int, metavar="BAUD", help="the baud rate it gets")
    parser.add_argument("--rig", metavar="rig.toml", help="add it to this bench")


def _off_arguments(parser: argparse.ArgumentParser) -> None:
    _bus_arguments(parser)
    parser.add_argument("--rig", metavar="rig.toml", help="the bench whose port it is")


ACTIONS: dict[str, tuple[str, Declare, Do]] = {
    "scan": ("find ports, baud rates and servos", _bus_arguments, _scan),
    "read": ("what a servo is, and what keeps it from being driven", _read_arguments, _read),
    "setup": ("make one servo ready, and note it in a rig.toml", _setup_arguments, _setup),
    "home": ("prove where the finger is straight, after each power-up", home_arguments, home),
    "calibrate": (
        "a first calibration without a camera: pulley, jogged signs, a ruler",
        calibrate_bench_arguments,
        calibrate_bench,
    ),
    "pull": ("measure the current at the stroke; it becomes the ceiling", pull_arguments, pull_test),
    "limits": ("every limit in force on a bench, and who set it", limits_arguments, limits),
    "off": ("switch the torque of every servo off", _off_arguments, _off),
    "heartbeat": ("be the emergency stop of a robot elsewhere", heartbeat_arguments, heartbeat),
    "emulate": ("an emulated robot: servos, a finger, a camera, faults on command", emulate_arguments, emulate),
}


def servo_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `servo` and of what it does."""
    what = parser.add_subparsers(dest="what", required=True, metavar="|".join(ACTIONS))
    for name, (text, declare, _) in ACTIONS.items():
        one = what.add_parser(name, help=text)
        declare(one)
        # The verb has it too; what stands before the sub-verb is not to be overruled by a default behind it.
        one.add_argument("--json", action="store_true", default=argparse.SUPPRESS, help="print one JSON document")


def servo(args: argparse.Namespace) -> int:
    """Do what was asked for with servos; 0 when all is well."""
    return ACTIONS[args.what][2](args)


def replay_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `replay`."""
    parser.add_argument("recording", help="what the control loop recorded (.mcap)")
    parser.add_argument("--run", metavar="FILE.npz", help="write it as a run as well, with what was seen")
    parser.add_argument("--force", action="store_true", help="replace the run that stands there")


def replay(args: argparse.Namespace) -> int:
    """Let the guard decide a recording again; 1 if it decides otherwise anywhere, or the recording is not whole."""
    check_file("--run", args.run, ".npz")
    check_no_run("--run", args.run, args.force)
    recording = read_recording(args.recording)
    differ = recording.replay()
    if args.run:
        run_of(recording).save(args.run)
    first, last = recording.periods[0], recording.periods[-1]
    seconds = (last["now"] - first["now"]) * 1e-9
    if args.json:
        document = {"schema": "softmap.replay/1", "periods": len(recording.periods), "seconds": seconds}
        print(json.dumps(document | {"otherwise": differ, "short": recording.short, "run": args.run}))
    else:
        said = "every one decided alike" if not differ else f"{len(differ)} decided otherwise, the first is {differ[0]}"
        print(f"{args.recording}: {len(recording.periods)} periods in {seconds:.1f} s, {said}")
        if args.run:
            print(f"{args.run}: written")
    if recording.incomplete:
        warnings.warn(RecordingWarning(recording.incomplete), stacklevel=2)
    return OTHERWISE if differ or recording.short else 0
