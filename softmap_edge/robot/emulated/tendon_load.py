"""The load of the tendons on a servo: current (mA) over ticks, from the tensions of a model.

    τ_s = Σ_c (4096 / 2π) A_cs Σ_i S_ic T_i(u),    mA = τ / k

T_i (N) are the tensions stored in a simulated bundle. S_ic is +1 for the tendon that command c
shortens and −1 for the one that it lengthens. A is in mm per tick, and k is the servo's torque per
current from its stall figures (without gear losses). The other commands stay at home. Bundles
without tensions get a nominal stiffness. Used for emulated servos; the ceiling of a real one is
measured. Pinned by tests/robot/test_emulated_finger.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from softmap_edge.model.model import Model
from softmap_edge.model.servo_calibration import TURN, Calibration, tendon_mm
from softmap_edge.robot.servo.models import ServoModel
from softmap_edge.run.rest_command import home_command

Floats = NDArray[np.float64]
Load = list[tuple[float, float]]

TICKS_PER_RAD = TURN / (2.0 * np.pi)
# N per mm of command, for a bundle without tensions: about that of the built-in finger
NOMINAL = 0.5
OWN = 0.6  # share of the largest change of tension from which a tendon belongs to the command
POINTS = 41  # points of a table


def tendon_loads(
    model: Model, calibration: Calibration, window: tuple[float, float], servo: ServoModel
) -> list[Load]:
    """Return the load of each servo, (ticks, mA) ascending over `window` about home.

    Args:
        servo: data of its model (`servo_model`)
    """
    stall = servo["stall_torque_Nm"], servo["stall_current_mA"]
    length = calibration.A * tendon_mm(model.command_unit)  # of tendon, per tick
    away = np.linspace(*window, POINTS)
    loads = []
    for s, home in enumerate(calibration.home):
        u = calibration.b + np.outer(away, calibration.A[:, s])  # (POINTS, C)
        torque = _forces(model, u) @ length[:, s] * TICKS_PER_RAD * 1e-3  # N·m
        loads.append(
            [(float(home + a), float(t * stall[1] / stall[0])) for a, t in zip(away, torque)]
        )
    return loads


def _forces(model: Model, u: Floats) -> Floats:
    """Return the force (N) that pulls back each command (n, C), (n, C)."""
    pull = None if model.arrays is None else model.arrays.prior.tensions()
    if model.structure.cables is None or pull is None:
        return NOMINAL * tendon_mm(model.command_unit) * (u - home_command(model.command_range))
    reach = 0.5 * np.diag(np.min(np.abs(np.asarray(model.command_range, float)), axis=1))  # (C, C)
    change = np.asarray(pull.evaluate(reach)) - np.asarray(pull.evaluate(-reach))  # (C, tendons)
    most = np.maximum(np.abs(change).max(axis=1, keepdims=True), 1e-12)
    own = np.where(np.abs(change) > OWN * most, np.sign(change), 0.0)
    inside = np.clip(u, *np.asarray(model.command_range, float).T)
    return np.asarray(np.maximum(np.asarray(pull.evaluate(inside)), 0.0) @ own.T)
