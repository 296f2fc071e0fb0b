"""The command `servo move`: jog servos by keys, turn one by some ticks, or go to one command.

The enable key and the questions are shared with `commission.py`. Pinned by
tests/robot/test_move.py, tests/robot/test_home.py and tests/robot/test_calibrate_rig.py.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from softmap_edge.commands.output import JsonOption, check_idle, to_stderr, with_files
from softmap_edge.commands.own import effects_argument, load_own, open_model
from softmap_edge.commands.robot import driven_robot, driving, emulated
from softmap_edge.errors import ServoError, SoftmapError
from softmap_edge.files.printable import raw
from softmap_edge.robot.commissioning.jog import ARRIVED, EVERY, Deadman, Held, Jog, most_travel
from softmap_edge.robot.commissioning.keys import Keys
from softmap_edge.robot.commissioning.pull import LEAST_SHORT, SHORT
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.motion.figures import WIDEST
from softmap_edge.robot.servo import status_words as words
from softmap_edge.robot.servo.conditions import HELD, JOG_TRAVEL
from softmap_edge.robot.servo.home_mark import forget
from softmap_edge.robot.servo.rig import Rig, read_rig
from softmap_edge.robot.servo.terminal import EMERGENCY, terminal, wait_for_release

Floats = NDArray[np.float64]
Ticks = NDArray[np.float64] | NDArray[np.int64]

ARROWS = {"right": (0, 1), "left": (0, -1), "up": (1, 1), "down": (1, -1)}
SIGNS = {"+": 1, "=": 1, "-": -1}
ENDS = {
    "": "",
    "window": ": the end of its window",
    "travel": ": as far as one jog goes; let go, and on once torque is off",
}
NEAR = 25.0  # ticks: largest distance to the target of a servo that has arrived
LAGS = 1.0  # s from the goal's arrival until a servo is as close as it will come
CAME_SHORT = 1  # exit code
STAYS = 3.0  # s at a command
STEP = 10.0  # ticks of one tap; a held key continues from its first repetition
HELP = (
    "hold a key: left and right servo 1, down and up servo 2, 1-9 choose a servo for - and +; a "
    f"tap is one step of {STEP:.0f} ticks, a held key goes on from its first repetition; space, "
    f"escape and q stop, {EMERGENCY} is the emergency stop"
)


@dataclass(frozen=True)
class MoveOptions:
    """Options of `softmap servo move`, as its parser declares them."""

    command: str | None
    sim: bool
    rig: str | None
    bundle: str | None
    effects: list[str]
    trust_onnx: bool
    servo: int | None
    by: float | None
    seconds: float | None
    hold: bool
    json: bool


def move_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `servo move`."""
    parser.add_argument(
        "command",
        nargs="?",
        metavar="U1,U2",
        help="command to go to, mm, and back (default: jog by keys)",
    )
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument(
        "--sim", action="store_true", help="an emulated robot: real packets, simulated finger"
    )
    where.add_argument("--rig", metavar="FILE.toml", help="the servos of this rig")
    parser.add_argument(
        "--bundle",
        metavar="DIR",
        help="the model, with its calibration (default: the built-in finger)",
    )
    effects_argument(parser)
    parser.add_argument("--servo", type=int, metavar="ID", help="jog this servo, by --by")
    parser.add_argument(
        "--by", type=float, metavar="TICKS", help=f"how far, at most {JOG_TRAVEL:.0f} either way"
    )
    parser.add_argument(
        "--seconds",
        type=float,
        metavar="S",
        help=f"time at U1,U2, s ({STAYS:g})",
    )
    hold_argument(parser, "; with U1,U2 nothing is asked first")


def move(args: MoveOptions) -> int:
    """Jog, or go to one command; return 0 on arrival, 1 if a servo ends short of its goal."""
    if (args.servo is None) != (args.by is None) or (args.command and args.by is not None):
        raise SoftmapError(
            "give U1,U2, or --servo ID with --by TICKS, or none of them to jog by keys"
        )
    _check_by(args.by, JOG_TRAVEL)
    if args.command:
        return _go(args, args.command, STAYS if args.seconds is None else args.seconds)
    check_idle({"--seconds": args.seconds}, "a jog ends where it is; give U1,U2 to stay there")
    model = {"--bundle": args.bundle, "--effects": args.effects, "--trust-onnx": args.trust_onnx}
    check_idle(
        model if args.rig else {}, "a jog of a rig uses no model; leave it out, or give U1,U2"
    )
    check_idle(
        {"--hold": args.hold and args.by is None},
        "a jog by keys is driven by held keys; give --servo ID with --by TICKS, or U1,U2",
    )
    with _rig(args) as rig:
        servo = None if args.servo is None else _numbered(rig, args.servo)
        if args.by is not None:
            _check_by(args.by, most_travel(rig))
        with deadman(args.hold and args.by is not None) as hand, Jog(rig, tell=to_stderr) as jog:
            begin = jog.position
            if args.by is not None and servo is not None:
                announce(
                    args,
                    f"servo {args.servo} by {args.by:+.0f} ticks at {jog.slew:.0f} ticks/s",
                    hand,
                )
                jog.by(servo, args.by, hand)
            else:
                assert isinstance(hand, Keys)  # `Held` only with --by
                print(HELP, file=sys.stderr)
                _by_keys(jog, hand)
            end = jog.position
            asked = args.by is not None and not hand.stopped
            short = ""
            if asked and servo is not None and args.by is not None:
                short = _jog_short(jog, servo, begin, args.by)
            jog.stop()
        stood = _stood(rig, begin, end, begin + _turns(rig, args)) if asked else ""
    servos = [
        {"id": one.id, "from": float(a), "to": float(b)}
        for one, a, b in zip(rig.servos, begin, end, strict=True)
    ]
    document = {
        "schema": "softmap.move/1",
        "servos": servos,
        "stopped": bool(hand.stopped),
        "short": short or None,
    }
    lines = [f"servo {one['id']}: {one['from']:.0f} → {one['to']:.0f} ticks" for one in servos]
    print(json.dumps(document) if args.json else "\n".join([*lines, "torque is off"]))
    return _reported(args, short, stood)


def _turns(rig: Rig, args: MoveOptions) -> Floats:
    """Return the requested turn of each servo, ticks."""
    return np.array([args.by if servo.id == args.servo else 0.0 for servo in rig.servos], float)


def _check_by(by: float | None, most: float) -> None:
    if by is not None and not 1 <= abs(by) <= most:
        raise SoftmapError(f"--by {by:g}; allowed are 1 to {most:.0f} ticks either way")


@contextlib.contextmanager
def _rig(args: MoveOptions) -> Iterator[Rig]:
    """Yield the rig of `--rig`, or an emulated one."""
    if args.rig:
        yield read_rig(args.rig)
        return
    load_own(args)
    model = open_model(args.bundle)
    with emulated(model, person=True) as robot:
        yield robot.rig


def _numbered(rig: Rig, id: int) -> int:
    ids = [servo.id for servo in rig.servos]
    if id not in ids:
        raise ServoError(f"the rig has no servo {id}; it has {', '.join(map(str, ids))}")
    return ids.index(id)


def _by_keys(jog: Jog, hand: Keys) -> None:
    """Jog by keys until a stop key: one step at a press, continuously while the key repeats.

    The servo keeps its torque until the key is known to be released.
    """
    chosen = 0
    count = len(jog.rig.servos)
    presses = 0
    step = 0.0
    ended: Literal["", "window", "travel"] = ""
    while not hand.stopped:
        jog.robot.time.there()
        key = hand.key()
        if key.isdigit() and 0 < int(key) <= count:
            chosen = int(key) - 1
        servo, way = ARROWS.get(key, (chosen, SIGNS.get(key, 0)))
        if way and servo < count:
            if hand.held():
                ended = jog.push(servo, way)
            else:
                if hand.presses != presses:
                    presses, step = hand.presses, float(jog.goal[servo]) + way * STEP
                ended = jog.press(servo, step)
        at = "  ".join(f"{one.id}: {tick:.0f}" for one, tick in zip(jog.rig.servos, jog.position))
        end = ENDS[ended] if jog.robot.state == "commissioning" else ""
        print(
            f"\r{at}  ({words.state(jog.robot.report)}{end})\x1b[K",
            end="",
            file=raw(sys.stderr),
            flush=True,
        )
        time.sleep(EVERY)
    jog.robot.time.there(driving=False)
    print(file=sys.stderr)
    jog.obey(hand)


def _go(args: MoveOptions, command: str, seconds: float) -> int:
    """Go to a command through every check of the guard, stay there, and release tension."""
    try:
        u = np.array([float(word) for word in command.split(",")])
    except ValueError:
        raise SoftmapError(
            f"'{command:.40}' is no command; expected mm, one a servo: 2.5,-1"
        ) from None
    if not (np.abs(u) <= WIDEST).all() or not 0.0 <= seconds <= 600.0:
        raise SoftmapError(
            f"{args.command:.40} for {seconds:g} s; commands of up to {WIDEST:g} mm and 0 to "
            "600 s are allowed"
        )
    load_own(args)
    model = open_model(args.bundle)
    with driven_robot(args.rig, model) as there:
        if len(u) != len(there.rig.servos):
            raise SoftmapError(
                f"{len(u)} numbers for {len(there.rig.servos)} servos; give mm, one a servo"
            )
        if not args.hold and not confirm(
            f"The finger goes to {args.command} mm and comes back. Is it free?", "--hold"
        ):
            raise ServoError("nothing moved: it was not confirmed that the finger is free")
        robot = Controller(there.rig, there.calibration, there.limits)
        with driving(robot):
            begin = robot.position
            done, sent, arrived = robot.engage(u), None, None
            while arrived is None or robot.time.now() - arrived < seconds:
                done, now = robot.target(u), robot.time.now()
                off = _off(robot, done, "goal")
                sent = now if sent is None and off < ARRIVED else sent
                if (
                    arrived is None
                    and sent is not None
                    and (_off(robot, done, "position") < NEAR or now - sent > LAGS)
                ):
                    arrived = now
                robot.time.sleep(EVERY)
            at = there.calibration.commands(robot.position)
            short, end = _short(robot, done), robot.position
        stood = _stood(there.rig, begin, end, robot.calibration.ticks(done))
    short = "; ".join(filter(None, [_cut(u, done), short]))
    document = {
        "schema": "softmap.move/1",
        "command_mm": u.tolist(),
        "done_mm": done.tolist(),
        "at_mm": at.tolist(),
    }
    document |= {"short": short or None}
    cut = f" (nearest to {_mm(u)} within its window)" if _cut(u, done) else ""
    came = "came only to" if short and not cut else "came to"
    text = (
        f"sent to {_mm(done)} mm{cut}, {came} {_mm(at)} mm by the servos; slack again, torque is "
        "off"
    )
    print(json.dumps(document) if args.json else text)
    return _reported(args, short, stood)


def _reported(args: MoveOptions, short: str, stood: str) -> int:
    """Report a move that missed its goal and servos that did not turn; return the exit code."""
    for sentence in filter(None, (short, stood)):
        to_stderr(f"softmap servo move: {with_files(sentence, args)}")
    return CAME_SHORT if short or stood else 0


def _cut(u: Floats, done: Floats) -> str:
    """Return a line if the command `u` is outside the window, else "".

    `done` is the nearest command inside.
    """
    if np.allclose(done, u, atol=0.01):
        return ""
    return (
        f"{_mm(u)} mm is outside the window, the nearest is {_mm(done)} mm; give a smaller "
        "command, or see who sets the window: `softmap servo limits`"
    )


def _stood(rig: Rig, begin: Floats, end: Floats, target: Ticks) -> str:
    """Clear the home mark of servos that should have turned but did not.

    Returns:
        A line that names them, "" if there are none.
    """
    still = (np.abs(end - begin) < ARRIVED) & (np.abs(target - begin) > LEAST_SHORT)
    if not (ids := [servo.id for servo, stood in zip(rig.servos, still) if stood]):
        return ""
    forget(rig.port, rig.baud, ids)
    return (
        f"servo {', '.join(map(str, ids))} did not turn at all: it is blocked, or its encoder "
        "stands, so that its home is lost; free it, then home the robot again (`softmap servo "
        "home --rig FILE`)"
    )


def _short(robot: Controller, done: Floats) -> str:
    """Return a line on servos short of the command `done` by the limits of the pull test, or ""."""
    home, target = robot.calibration.home, robot.calibration.ticks(done)
    limits = robot.limits["servos"]
    return _far(
        robot.rig, target, robot.position, target - home, [one["current"] for one in limits]
    )


def _jog_short(jog: Jog, servo: int, begin: Floats, by: float) -> str:
    """Return a line if a jogged servo is short of its target, else ""."""
    target, asked = jog.goal.copy(), begin[servo] + by
    if abs(target[servo] - asked) > max(LEAST_SHORT, SHORT * abs(by)):
        limits = jog.robot.limits["servos"][servo]
        return (
            f"servo {jog.rig.servos[servo].id} was asked to go to {asked:.0f} ticks, outside its "
            f"window of {limits['low']:.0f} to {limits['high']:.0f}; give a smaller --by, or see "
            "who sets the window: `softmap servo limits`"
        )
    away = np.zeros(len(target))
    away[servo] = by
    most = min(
        jog.robot.limits["jog_current"], jog.robot.limits["servos"][servo]["current"] or np.inf
    )
    return _far(jog.rig, target, jog.position, away, [most] * len(target))


def _far(
    rig: Rig,
    target: Ticks,
    position: Floats,
    away: Floats,
    most: Sequence[float | None],
) -> str:
    """Return a line on servos too far from their targets after a move by `away` ticks, or ""."""
    sentences = []
    for servo, to, at, way, mA in zip(rig.servos, target, position, away, most):
        allowed = max(LEAST_SHORT, SHORT * abs(way))
        if not abs(at - to) <= allowed:
            sentences.append(
                f"servo {servo.id} stands {at - to:+.0f} ticks from its goal, allowed are "
                f"{allowed:.0f}"
            )
            sentences[-1] += "" if mA is None else f", under at most {mA:.0f} mA"
    return "; ".join([*sentences, HELD]) if sentences else ""


def _off(robot: Controller, command: Floats, what: str) -> float:
    """Return the distance (ticks) from a command to the newest report's `goal` or `position`.

    It is ∞ if the report has none.
    """
    report = robot.report
    ticks = (report.get("goal") if what == "goal" else report.get("position")) or [None]
    return (
        np.inf
        if None in ticks
        else float(np.abs(np.array(ticks) - robot.calibration.ticks(command)).max())
    )


def _mm(numbers: Floats) -> str:
    return ", ".join(f"{one:.2f}" for one in numbers)


# --- shared with commission.py: the enable key, and questions -----------------------------------
def hold_argument(parser: argparse.ArgumentParser, more: str = "") -> None:
    """Declare `--hold`, the same for every command with an enable key; `more` extends its help."""
    parser.add_argument(
        "--hold",
        action="store_true",
        help=f"no key needs to be held; Ctrl-C releases{more}",
    )


@contextlib.contextmanager
def deadman(held: bool) -> Iterator[Deadman]:
    """Yield the enable key: a key of the terminal, or with `held` the program itself.

    With `held`, keys still stop the program if there is a terminal.
    """
    if held and terminal() is None:
        yield Held()
    else:
        with Keys(always=held) as keys:
            yield keys


def announce(args: JsonOption, what: str, hand: Deadman) -> None:
    """Print what will move and how to stop it."""
    if not args.json:
        print(f"{what}; {hand.how}", file=sys.stderr)


def confirm(question: str, instead: str) -> bool:
    """Ask a question on the terminal until the answer is yes or no; an empty answer is no.

    A key that is still held is not an answer: its release is awaited.

    Args:
        question: the question.
        instead: option that answers it where there is no terminal.

    Raises:
        ServoError: there is no terminal.
    """
    if not sys.stdin.isatty():
        raise ServoError(f"no terminal to ask at; {instead} says it instead")
    if (file := terminal()) is not None:
        wait_for_release(file)
    while True:
        print(f"{question} [y/N] ", end="", file=sys.stderr, flush=True)
        answer = sys.stdin.readline().strip().lower()
        if answer in ("y", "yes", "n", "no", ""):
            return answer.startswith("y")
        print("y for yes, n or Enter for no", file=sys.stderr)
