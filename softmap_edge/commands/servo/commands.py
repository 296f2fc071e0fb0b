"""The command `softmap servo`: the table of its actions, and those that find and set up servos.

These are scan, read, setup, off and reboot; the others are in the modules next to it.
"""

from __future__ import annotations

import argparse
import json
import shlex
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from softmap_edge.commands.output import check_file, next_command, to_stderr, with_files
from softmap_edge.commands.parser import Action, add_actions, run_action
from softmap_edge.commands.servo.check import LimitsOptions, limits, limits_arguments
from softmap_edge.commands.servo.commission import (
    CalibrateOptions,
    HomeOptions,
    PullOptions,
    calibrate,
    calibrate_arguments,
    home,
    home_arguments,
    pull_arguments,
    pull_test,
)
from softmap_edge.commands.servo.emulate import EmulateOptions, emulate, emulate_arguments
from softmap_edge.commands.servo.heartbeat import HeartbeatOptions, heartbeat, heartbeat_arguments
from softmap_edge.errors import NoAnswer, ServoError
from softmap_edge.files.atomic import Document
from softmap_edge.robot.commissioning import setup
from softmap_edge.robot.commissioning.reboot import restart
from softmap_edge.robot.commissioning.rig_entry import changes, entered, entry_of
from softmap_edge.robot.servo.bus import opened, ports, release
from softmap_edge.robot.servo.conditions import unfit
from softmap_edge.robot.servo.examined import members
from softmap_edge.robot.servo.home_mark import marked
from softmap_edge.robot.servo.known_state import (
    differs,
    passing,
    remarks_on_gains,
    rewritten,
)
from softmap_edge.robot.servo.presence import listened, why_silent
from softmap_edge.robot.servo.rig import Rig, read_rig
from softmap_edge.robot.servo.status_words import kept_words

SLOWEST, FASTEST = 9_600, 4_500_000  # baud
FAULT = 1  # exit code
OnBus = TypeVar("OnBus", "ScanOptions", "ReadOptions")


def _ports(port: str | None, baud: int | None) -> list[str]:
    """Return the selected ports.

    Raises:
        ServoError: there is no port, or `baud` is out of range.
    """
    if baud is not None and not SLOWEST <= baud <= FASTEST:
        raise ServoError(f"--baud {baud}; {SLOWEST} to {FASTEST} is allowed")
    found = [port] if port else ports()
    if not found:
        raise ServoError("no serial port on this machine; connect the adapter, or give --port")
    return found


def _of_rig(args: OnBus) -> tuple[Rig | None, OnBus]:
    """Return the rig of `--rig`, and the options with its port and baud rate where not given."""
    if args.rig is None:
        return None, args
    rig = read_rig(args.rig)
    return rig, replace(args, port=args.port or rig.port, baud=args.baud or rig.baud)


def _missing(rig: Rig | None, found: list[setup.ServoState], args: OnBus) -> list[str]:
    """Return a sentence for each servo of the rig that did not answer, with the cause."""
    if rig is None:
        return []
    listed = [servo.id for servo in rig.servos]
    left = [id for id in listed if id not in [servo.id for servo in found]]
    port = args.port or rig.port
    return [
        f"servo {id}: {_other_rate(rig, args, id) or why_silent(port, rig.baud, id, listed)}"
        for id in left
    ]


def _other_rate(rig: Rig | None, args: OnBus, id: int) -> str | None:
    """Return that `--baud` is wrong, if servo `id` answers at the rate of the rig; else None."""
    if rig is None or args.baud is None or args.baud == rig.baud:
        return None
    port = args.port or rig.port
    if all(servo.id != id for servo in listened(port, rig.baud).found):
        return None
    return (
        f"it answers at {rig.baud} baud, as the rig says, not at --baud {args.baud}; run the same "
        "command without --baud"
    )


def _scan(args: ScanOptions) -> int:
    rig, args = _of_rig(args)
    found: list[setup.ServoState] = []
    remarks: list[str] = []
    for port in _ports(args.port, args.baud):
        for heard in setup.scanned(port, args.baud):
            found += heard.found
            remarks += (faults := [*heard.remarks, *heard.errors])
            if not args.json:
                lines = [f"  ! {with_files(one, args)}" for one in faults]
                print("".join(f"{line}\n" for line in [*heard.found, *lines]), end="")
    remarks += (missing := _missing(rig, found, args))
    remarks, missing = ([with_files(one, args) for one in some] for some in (remarks, missing))
    if args.json:
        servos = [_servo_document(servo) for servo in found]
        print(json.dumps({"schema": "softmap.servos/1", "servos": servos, "remarks": remarks}))
    elif missing:
        print("\n".join(f"  ! {one}" for one in missing))
    elif not found and not remarks:
        more = "" if args.baud is None else ", and without --baud every rate is tried"
        print(f"no servo answers; check its power and wiring{more}")
    elif not remarks and args.rig:
        print(next_command("servo", "doctor", "--rig", args.rig))
    elif not remarks:
        first = found[0]
        where = ("--port", first.port, "--baud", str(first.baud), "--id", str(first.id))
        print(next_command("servo", "setup", *where, "--rig", "rig.toml"))
    return 0 if found and not remarks else FAULT


def _servo_document(servo: setup.ServoState) -> Document:
    name = servo.model["name"] if servo.model else None
    return dict(
        port=servo.port,
        baud=servo.baud,
        id=servo.id,
        model=name,
        model_number=servo.number,
        firmware=servo.firmware,
    )


def _find(
    args: ReadOptions | SetupOptions, rig: Rig | None = None
) -> tuple[list[setup.ServoState], list[str], set[int]]:
    """Return the selected servos, remarks on wrong answers, and the ids that answer pings only."""
    heard = [one for port in _ports(args.port, args.baud) for one in setup.scanned(port, args.baud)]
    every = [servo for one in heard for servo in one.found]
    remarks = [remark for one in heard for remark in one.remarks]
    found = [servo for servo in every if args.id is None or servo.id == args.id]
    if found:
        return found, remarks, {id for one in heard for id in one.mute}
    if remarks and not every:
        raise ServoError(remarks[0])
    which = "no servo" if args.id is None else f"no servo of id {args.id}"
    if args.id is not None and args.port and args.baud:
        other = None if isinstance(args, SetupOptions) else _other_rate(rig, args, args.id)
        why = other or why_silent(args.port, args.baud, args.id)
        raise ServoError(f"{which} answers: {why}")
    scan = (
        f"softmap servo scan --port {shlex.quote(args.port)}" if args.port else "softmap servo scan"
    )
    raise ServoError(f"{which} answers; check power and wiring, `{scan}` lists what does")


def _read(args: ReadOptions) -> int:
    documents = []
    rig, args = _of_rig(args)
    found, remarks, mute = _find(args, rig)
    remarks += [] if args.id is not None else _missing(rig, found, args)
    remarks = [with_files(one, args) for one in remarks]
    asked = {} if rig is None else {one.id: one.asked for one in members(rig)}
    well = not remarks
    shared = {servo.id for servo in found if [one.id for one in found].count(servo.id) > 1}
    for servo in {(one.port, one.baud, one.id): one for one in found}.values():
        unread = servo.id in shared or servo.id in mute
        values, complaints = ({}, []) if unread else _registers(servo, asked.get(servo.id))
        notes = remarks_on_gains(servo, values, asked.get(servo.id)) if values else []
        complaints, notes = (
            [with_files(one, args) for one in some] for some in (complaints, notes)
        )
        well &= not complaints
        documents.append(
            _servo_document(servo) | {"registers": values, "complaints": complaints, "notes": notes}
        )
        if not args.json:
            print(servo)
            print(
                "".join(
                    f"  {name.replace('_', ' '):<24} {value}\n" for name, value in values.items()
                ),
                end="",
            )
            print(
                "\n".join(
                    [*(f"  ! {line}" for line in complaints), *(f"  note: {n}" for n in notes)]
                )
                or ("  set up" if values else "  its registers cannot be read: see below")
            )
    if args.json:
        print(json.dumps({"schema": "softmap.servos/1", "servos": documents, "remarks": remarks}))
    else:
        print("".join(f"! {line}\n" for line in remarks), end="")
    return 0 if well else FAULT


def _registers(
    servo: setup.ServoState, asked: setup.Asked | None
) -> tuple[dict[str, int], list[str]]:
    """Return a servo's register values, and a line with the remedy for each bad or rewritten one.

    A bad value blocks a start; the others are rewritten by a start, and by a set-up.
    """
    try:
        with opened(servo.port, servo.baud) as bus:
            values = setup.registers(bus, servo.id)
            window = None if asked is None else asked.window
            proved = asked is not None and window is not None and marked(bus, servo.id, asked.home)
    except NoAnswer as fault:
        return {}, [str(fault)]
    left = [differs(servo, need, values[need.register]) for need in passing(servo, values, asked)]
    complaints = setup.complaints(servo, values, asked) + unfit(servo, values, asked, proved)
    return values, complaints + [f"{one}; {rewritten(servo)}" for one in left]


def _setup(args: SetupOptions) -> int:
    check_file("--rig", args.rig, ".toml")
    found, remarks, _ = _find(args)
    ids = [servo.id for servo in found]
    if len(found) > 1:
        if shared := [line for line in remarks if len(set(ids)) < len(ids) and "share" in line]:
            raise ServoError(
                f"{len(found)} servos answer (ids {', '.join(map(str, ids))}): {shared[0]}"
            )
        shown = ", ".join(map(str, ids))
        raise ServoError(
            f"{len(found)} servos answer (ids {shown}); connect one at a time, or say which with "
            "--id"
        )
    old = read_rig(args.rig) if args.rig and Path(args.rig).exists() else None
    entry = entry_of(old, found[0], args.new_id, args.new_baud)  # raises before anything is changed
    mended: list[str] = []
    try:
        ready = setup.set_up(found[0], args.new_id, args.new_baud, mended.append, entry.asked)
    except ServoError:
        for line in mended:  # what was written before it failed
            to_stderr(f"  {line}")
        raise
    done = ready.servo
    if args.rig:
        mended += [with_files(one, args) for one in changes(entry, found[0], ready, args.rig)]
        rig = entered(entry, ready, setup.gains(done))
        (rig.write if old is None else rig.note)(args.rig)
    if args.json:
        print(
            json.dumps(
                {
                    "schema": "softmap.servos/1",
                    "servos": [_servo_document(done)],
                    "rig": args.rig,
                    "mended": mended,
                }
            )
        )
    else:
        print("".join(f"  {line}\n" for line in mended), end="")
        print(f"{done}: set up" + (f", noted in {args.rig}" if args.rig else ""))
        print(_next(args, done))
    return 0


def _next(args: SetupOptions, done: setup.ServoState) -> str:
    """Return the step after set-up: homing, which needs a rig that lists the servo."""
    if args.rig:
        return "once all servos are set up,\n" + next_command("servo", "home", "--rig", args.rig)
    where = ("--port", done.port, "--baud", str(done.baud), "--id", str(done.id))
    return next_command("servo", "setup", *where, "--rig", "rig.toml")


def _off(args: OffOptions) -> int:
    port, baud, ids = args.port, args.baud, []
    if args.rig:
        rig = read_rig(args.rig)
        port, baud, ids = port or rig.port, baud or rig.baud, [servo.id for servo in rig.servos]
    ports, released, kept = _ports(port, args.baud), [], []
    for name in ports:
        there, left = release(name, baud, ids)
        released += there
        kept += left
        if not args.json:
            confirmed = (
                f"off: servo {', '.join(map(str, there))}" if there else "no servo confirmed it"
            )
            print(f"{name}: torque off was sent; {confirmed}")
            if left:
                print(f"{name}: {with_files(kept_words(left), args)}")
    if args.json:
        document = {
            "schema": "softmap.servos/1",
            "released": ports,
            "confirmed": released,
            "not_confirmed": kept,
        }
        print(json.dumps(document))
    return 0 if released and not kept else FAULT


def _reboot(args: RebootOptions) -> int:
    """Switch the torque of one servo off and restart it; return 0."""
    if not 0 <= args.id <= 252:
        raise ServoError(f"--id {args.id}; allowed are 0 to 252")
    port, baud = _where(args)
    done = restart(port, baud, args.id)
    if args.json:
        print(json.dumps(done.to_dict()))
    else:
        print(f"{done}\n{next_command('servo', 'home', '--rig', args.rig or 'FILE')}")
    return 0


def _where(args: RebootOptions) -> tuple[str, int]:
    """Return port and baud rate of the selected servo."""
    port, baud = args.port, args.baud
    if args.rig:
        rig = read_rig(args.rig)
        ids = [servo.id for servo in rig.servos]
        if args.id not in ids:
            raise ServoError(f"the rig has no servo {args.id}; it has {', '.join(map(str, ids))}")
        port, baud = port or rig.port, baud or rig.baud
    if port and baud:
        return port, baud
    found = [
        one
        for name in ([port] if port else ports())
        for one in setup.scan(name, baud)
        if one.id == args.id
    ]
    if len(found) != 1:
        raise ServoError(
            f"{len(found) or 'no'} servos of id {args.id} answer; say where it is with --rig, or "
            "--port and --baud"
        )
    return found[0].port, found[0].baud


def _bus_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--port", metavar="PORT", help="a serial port (default: all of this machine)"
    )
    parser.add_argument(
        "--baud", type=int, metavar="BAUD", help="one rate (default: all known rates)"
    )


@dataclass(frozen=True)
class ScanOptions:
    """Options of `softmap servo scan`, as its parser declares them."""

    port: str | None
    baud: int | None
    rig: str | None
    json: bool


def _scan_arguments(parser: argparse.ArgumentParser) -> None:
    _bus_arguments(parser)
    parser.add_argument("--rig", metavar="FILE.toml", help="search for the servos of this rig")


@dataclass(frozen=True)
class ReadOptions:
    """Options of `softmap servo read`, as its parser declares them."""

    port: str | None
    baud: int | None
    rig: str | None
    id: int | None
    json: bool


def _read_arguments(parser: argparse.ArgumentParser) -> None:
    _scan_arguments(parser)
    parser.add_argument("--id", type=int, metavar="ID", help="one servo (default: all that answer)")


@dataclass(frozen=True)
class SetupOptions:
    """Options of `softmap servo setup`, as its parser declares them."""

    port: str | None
    baud: int | None
    id: int | None
    new_id: int | None
    new_baud: int | None
    rig: str | None
    json: bool


def _setup_arguments(parser: argparse.ArgumentParser) -> None:
    _bus_arguments(parser)
    parser.add_argument(
        "--id", type=int, metavar="ID", help="its current id, if several servos are connected"
    )
    parser.add_argument("--new-id", type=int, metavar="ID", help="its new id")
    parser.add_argument("--new-baud", type=int, metavar="BAUD", help="its new baud rate")
    parser.add_argument("--rig", metavar="FILE.toml", help="add it to this rig")


@dataclass(frozen=True)
class OffOptions:
    """Options of `softmap servo off`, as its parser declares them."""

    port: str | None
    baud: int | None
    rig: str | None
    json: bool


def _off_arguments(parser: argparse.ArgumentParser) -> None:
    _bus_arguments(parser)
    parser.add_argument("--rig", metavar="FILE.toml", help="the rig whose port it is")


@dataclass(frozen=True)
class RebootOptions:
    """Options of `softmap servo reboot`, as its parser declares them."""

    id: int
    rig: str | None
    port: str | None
    baud: int | None
    json: bool


def _reboot_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `servo reboot`."""
    parser.add_argument("--id", type=int, required=True, metavar="ID", help="the servo")
    parser.add_argument("--rig", metavar="FILE.toml", help="the rig whose port it is")
    _bus_arguments(parser)


ACTIONS: dict[str, Action] = {
    "scan": Action("find ports, baud rates and servos", _scan_arguments, _scan, ScanOptions),
    "read": Action(
        "show the servos, and faults that block driving", _read_arguments, _read, ReadOptions
    ),
    "setup": Action(
        "set up one servo, and enter it into a rig.toml", _setup_arguments, _setup, SetupOptions
    ),
    "home": Action(
        "home the robot with the finger straight, after each power-up",
        home_arguments,
        home,
        HomeOptions,
    ),
    "calibrate": Action(
        "a first calibration without a camera: pulley, jogged signs, a ruler",
        calibrate_arguments,
        calibrate,
        CalibrateOptions,
    ),
    "pull": Action(
        "measure the current at the stroke; it becomes the ceiling",
        pull_arguments,
        pull_test,
        PullOptions,
    ),
    "limits": Action(
        "list every effective limit of a rig, and who set it",
        limits_arguments,
        limits,
        LimitsOptions,
    ),
    "off": Action("switch the torque of every servo off", _off_arguments, _off, OffOptions),
    "reboot": Action(
        "restart a servo that has shut down", _reboot_arguments, _reboot, RebootOptions
    ),
    "heartbeat": Action(
        "act as the emergency stop of a robot on another computer",
        heartbeat_arguments,
        heartbeat,
        HeartbeatOptions,
    ),
    "emulate": Action(
        "emulate a robot: servos, a finger, a camera, and injected faults",
        emulate_arguments,
        emulate,
        EmulateOptions,
    ),
}


def servo_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `servo` and of its actions."""
    add_actions(parser, ACTIONS)


def servo(args: argparse.Namespace) -> int:
    """Run an action and return its exit code."""
    return run_action(ACTIONS, args)
