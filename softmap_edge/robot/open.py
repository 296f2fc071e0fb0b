"""A rig with the finger on it, and its robot, for a user's own program.

docs/do/own_program.md shows one.

Pinned by tests/robot/test_own_program.py, and by the tests of the commands that drive.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from softmap_edge.model.bundle import load_bundle
from softmap_edge.model.model import Model
from softmap_edge.model.servo_calibration import Calibration
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.motion.kinematics import Kinematics
from softmap_edge.robot.servo.limits import calibration_of, effective_limits
from softmap_edge.robot.servo.loop_limits import RATE
from softmap_edge.robot.servo.loop_types import LoopLimits
from softmap_edge.robot.servo.rig import Rig, read_rig

if TYPE_CHECKING:
    from softmap_edge.robot.emulated.finger import EmulatedFinger


@dataclass(frozen=True)
class Bench:
    """A robot that can be driven.

    It has its `rig`, the `limits` of its loop, its `calibration`, and the `model`, which on a real
    rig has that calibration as its own; of an emulated one the `finger`.
    """

    rig: Rig
    limits: LoopLimits
    calibration: Calibration
    model: Model
    finger: EmulatedFinger | None = None


def read_bench(path: str | Path, model: Model) -> Bench:
    """Return the robot of a rig file, ready to be driven with the finger of `model`.

    Raises:
        ServoError: something that driving needs is unknown; the line names it.
    """
    known = calibration_of(model)  # asked first: the bundle is what a user mends first
    rig = read_rig(path)
    found = effective_limits(rig, model, known, RATE)
    return Bench(
        rig, found.table(), found.calibration, replace(model, calibration=found.calibration)
    )


def open_robot(
    rig: str | Path,
    model: Model | str | Path,
    *,
    axes: str = "xyz",
    record: str | Path | None = None,
) -> Controller:
    """Return the robot of a rig, which is driven from entering to leaving it (`with`).

    Args:
        rig: the file of the rig, as `softmap servo setup` writes it.
        model: of its finger, or the folder of a bundle; it must be calibrated, and its effects are
            compensated.
        axes: that count for `robot.kinematics`.
        record: a file for all inputs, decisions and outputs of the loop.

    Raises:
        BundleError: no such bundle, or a damaged one.
        ServoError: something that driving needs is unknown; the line names it. On entering: as
            `Controller`.
    """
    bench = read_bench(rig, model if isinstance(model, Model) else load_bundle(model))
    kinematics = Kinematics(bench.model, axes=axes)
    return Controller(
        bench.rig, bench.calibration, bench.limits, kinematics=kinematics, record=record
    )
