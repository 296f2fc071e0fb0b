"""Open a rig with the finger on it as a robot, for a user's own program.

docs/do/own_program.md shows an example. Pinned by tests/robot/test_own_program.py, and by the tests
of the commands that drive.
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
class DrivenRobot:
    """A robot that is ready to be driven.

    Attributes:
        rig: the hardware, as in its file.
        limits: of the control loop.
        calibration: map of servo ticks to commands.
        model: of the finger; that of a real rig uses this calibration.
        finger: the emulated finger; None on a real rig.
    """

    rig: Rig
    limits: LoopLimits
    calibration: Calibration
    model: Model
    finger: EmulatedFinger | None = None


def read_driven_robot(path: str | Path, model: Model) -> DrivenRobot:
    """Return the robot of a rig file, ready to be driven with the finger of `model`.

    Raises:
        ServoError: something that driving needs is missing; the message names it.
    """
    known = calibration_of(model)  # first, because a user corrects the bundle before the rig
    rig = read_rig(path)
    found = effective_limits(rig, model, known, RATE)
    return DrivenRobot(
        rig, found.table(), found.calibration, replace(model, calibration=found.calibration)
    )


def open_robot(
    rig: str | Path,
    model: Model | str | Path,
    *,
    axes: str = "xyz",
    record: str | Path | None = None,
) -> Controller:
    """Return the robot of a rig; it can be driven inside a `with` block.

    Args:
        rig: rig file, as `softmap servo setup` writes it
        model: model of its finger, or the folder of a bundle; it must be calibrated, and its
            effects are compensated
        axes: axes that count for `robot.kinematics`
        record: file for all inputs, decisions and outputs of the loop

    Raises:
        BundleError: there is no such bundle, or it is damaged.
        ServoError: something that driving needs is missing; the message names it. On entering: as
            `Controller`.
    """
    driven = read_driven_robot(rig, model if isinstance(model, Model) else load_bundle(model))
    kinematics = Kinematics(driven.model, axes=axes)
    return Controller(
        driven.rig, driven.calibration, driven.limits, kinematics=kinematics, record=record
    )
