"""The robot that a command drives: the rig of `--rig` with its limits, or an emulated one."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator
from dataclasses import replace
from typing import Literal, Protocol

import numpy as np

from softmap_edge.commands.output import check_file, check_idle, to_stderr
from softmap_edge.commands.own import effects_argument
from softmap_edge.errors import SoftmapError
from softmap_edge.model.model import Model
from softmap_edge.model.servo_calibration import TICKS, TICKS_PER_MM, Calibration
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.control.emergency_key import EmergencyKey
from softmap_edge.robot.drive.observations import seen_file
from softmap_edge.robot.emulated.finger import emulated_robot, hidden_laws
from softmap_edge.robot.open import DrivenRobot, read_driven_robot
from softmap_edge.robot.servo.loop_limits import RATE

HOME = 2048.0  # ticks: home of an emulated servo


class DrivenOptions(Protocol):
    """Options that `driven_arguments` declares."""

    @property
    def sim(self) -> bool: ...
    @property
    def hide(self) -> str: ...
    @property
    def seed(self) -> int | None: ...
    @property
    def record(self) -> str | None: ...
    @property
    def no_effects(self) -> bool: ...


def announce_edited_limits(model: Model) -> None:
    """Report that the limits of a finger differ from those written with its bundle."""
    if model.safety is not None and model.safety.edited:
        to_stderr(
            "safety.toml of the bundle was edited since that was written; `softmap servo limits` "
            "prints it"
        )


def driven_arguments(parser: argparse.ArgumentParser, seed: str = "") -> None:
    """Declare the arguments shared by commands that drive a robot; `seed` is for its help."""
    parser.add_argument(
        "--bundle",
        metavar="DIR",
        help="the model and its effects (default: the built-in finger)",
    )
    effects_argument(parser)
    parser.add_argument(
        "--no-effects", action="store_true", help="omit the effects of the bundle, for comparison"
    )
    parser.add_argument(
        "--hide",
        "--hidden",
        default="",
        metavar="NAME,NAME",
        help="--sim: hidden effects of the finger: backlash,creep",
    )
    parser.add_argument(
        "--seed", type=int, help=f"--sim: random seed of hidden effects and noise (0){seed}"
    )
    parser.add_argument("--record", metavar="FILE.mcap", help="save the recording of the loop")


def check_driven(args: DrivenOptions) -> None:
    """Raise SoftmapError for invalid values of these arguments."""
    check_file("--record", args.record, ".mcap", new=True)
    if args.record and (seen := seen_file(args.record)).exists():
        raise SoftmapError(
            f"--record {args.record}: {seen} exists, and would be taken for what it saw; give "
            "another name"
        )
    if args.hide and not args.sim:
        raise SoftmapError("--hide: only an emulated finger can hide something; give --sim with it")


def driven_model(args: DrivenOptions, model: Model) -> Model:
    """Return the model, without its effects if that is requested."""
    return model.bare() if args.no_effects else model


@contextlib.contextmanager
def emulated(
    model: Model, hidden: str = "", seed: int = 0, *, person: bool = False
) -> Iterator[DrivenRobot]:
    """Yield an emulated robot with the finger of `model` and injected effects.

    Args:
        model: model of the finger
        hidden: names of the injected effects
        seed: of noise and clock
        person: whether a person drives; then time follows real time, else it is stepped and
            independent of load
    """
    calibration = model.calibration or plain_map(model)
    laws = hidden_laws([name for name in hidden.split(",") if name], model.channels, seed)
    pace: Literal["paced", "stepped"] = "paced" if person else "stepped"
    with emulated_robot(model, calibration, laws, rate=RATE, seed=seed, time=pace) as (
        _,
        rig,
        limits,
        finger,
    ):
        yield DrivenRobot(rig, limits, calibration, model, finger)


@contextlib.contextmanager
def driven_robot(
    rig: str | None,
    model: Model,
    hidden: str = "",
    seed: int | None = None,
    *,
    person: bool = False,
) -> Iterator[DrivenRobot]:
    """Yield the robot of `--rig`, or one emulated by `--hide` and `--seed`.

    Args:
        rig: file of the rig; None for an emulated robot
        model: model of the finger
        hidden: names of the injected effects of an emulated robot
        seed: of its noise and clock; None for 0
        person: whether a person drives the robot
    """
    if rig:
        check_idle({"--seed": seed}, "only an emulated finger uses it; leave it out, or give --sim")
        announce_edited_limits(model)
        yield read_driven_robot(rig, model)
        return
    with emulated(model, hidden, seed or 0, person=person) as driven:
        yield driven


def own_map(model: Model) -> Calibration:
    """Return the true map of an emulated robot, with a window: its bundle's, or a plain one."""
    known = model.calibration or plain_map(model)
    return replace(known, window=known.window or known.holding(model.command_range))


def plain_map(model: Model) -> Calibration:
    """Return the map of an emulated robot whose bundle has none; the ticks are its servos' own.

    This concerns commands in ticks.
    """
    if model.command_unit == TICKS:
        middle = np.rint(np.asarray(model.command_range, float).mean(axis=1))
        return Calibration.stated(
            np.eye(model.channels), middle, middle, "the servos' own ticks", unit=TICKS
        )
    zero = np.zeros(model.channels)
    scale = np.eye(model.channels) / TICKS_PER_MM
    return Calibration.stated(scale, zero, zero + HOME, "an emulated robot's own map")


@contextlib.contextmanager
def driving(robot: Controller, record: str | None = None) -> Iterator[None]:
    """Enter `robot`, with a key of the terminal as its emergency stop.

    After Ctrl-C, report the results.
    """
    try:
        robot.tell, robot.at_terminal = to_stderr, True
        with EmergencyKey(robot, to_stderr), robot:
            yield
    except KeyboardInterrupt:
        kept = f"{record} keeps what was driven" if record else ""
        to_stderr("; ".join(filter(None, ["torque is off", robot.unrecorded or kept])))
        raise
