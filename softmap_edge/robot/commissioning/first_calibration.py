"""A first calibration without a camera: from pulley radius, bending directions, and a ruler.

Servo k's command is the tendon that its pulley winds, u_k = ±r (ticks − home), straight at home (b
= 0). Coupling is not measured, so every other entry is 0 with a standard deviation of COUPLING of
the servo's own. The home was set by eye, so its standard deviation is what homing tolerates.
`held_out` is the error expected from these deviations over the model's range, because no block was
left out. A calibration with a camera (`softmap model calibrate`) replaces this one. Pinned by
tests/robot/test_calibrate_rig.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import CalibrationError, ServoError
from softmap_edge.files.atomic import Document
from softmap_edge.model.model import Model
from softmap_edge.model.servo_calibration import TURN, Calibration
from softmap_edge.robot.commissioning.home import NEAR
from softmap_edge.robot.servo.home_mark import no_home
from softmap_edge.robot.servo.rig import Rig

Floats = NDArray[np.float64]

RADIUS = (0.5, 100.0)  # mm
CALIPER = 0.1  # of the radius: the tendon lies on top of the pulley and winds in layers
RULER_MM = 0.5  # mm: standard deviation of a ruler reading
SHORTEST_MM = 2.0  # mm of tendon: shortest useful ruler reading
AGREE = 3.0  # standard deviations by which radius and ruler may differ
# unobserved motion of another command by a servo, as a share of its own
COUPLING = 0.1
AXES = "xyz"


@dataclass(frozen=True)
class Radius:
    """A pulley's radius, its standard deviation (mm), and their origin as text."""

    mm: float
    sigma: float
    said: str


def radius(pulley_mm: float, ruler: tuple[float, float] | None = None) -> Radius:
    """Return the radius at which tendon is wound: the pulley's, combined with a ruler (ticks, mm).

    Raises:
        CalibrationError: the radius is out of range, or the two do not agree.
    """
    if not RADIUS[0] <= pulley_mm <= RADIUS[1]:
        raise CalibrationError(
            f"a pulley of {pulley_mm:g} mm; allowed are {RADIUS[0]:g} to {RADIUS[1]:g} mm of radius"
        )
    sigma = CALIPER * pulley_mm
    if ruler is None:
        return Radius(pulley_mm, sigma, f"pulley {pulley_mm:g} mm, no ruler")
    ticks, mm = abs(ruler[0]), abs(ruler[1])
    if not (np.isfinite([ticks, mm]).all() and ticks >= 1.0 and mm >= SHORTEST_MM):
        raise CalibrationError(
            f"a ruler reading of {ruler[1]:g} mm for {ruler[0]:g} ticks; at least {SHORTEST_MM:g} "
            "mm of tendon are needed: turn the servo farther"
        )
    turn = TURN / (2.0 * np.pi * ticks)
    read, doubt = mm * turn, RULER_MM * turn
    apart = abs(read - pulley_mm) / np.hypot(sigma, doubt)
    if apart > AGREE:
        raise CalibrationError(
            f"the ruler gives a radius of {read:.3g} ± {doubt:.2g} mm, the pulley has "
            f"{pulley_mm:g} ± {sigma:.2g}: {apart:.1f} standard deviations apart, allowed are "
            f"{AGREE:g}; measure both again (radius, not diameter)"
        )
    weights = np.array([sigma, doubt]) ** -2.0
    both = float(weights @ [pulley_mm, read] / weights.sum())
    source = f"pulley {pulley_mm:g} mm, ruler {mm:g} mm for {ticks:g} ticks"
    return Radius(both, float(weights.sum() ** -0.5), source)


def bends(model: Model, k: int) -> str:
    """Return where the tip goes for more of command `k`: its largest base-frame axis, as `+x`."""
    low, high = np.zeros((2, model.channels))
    reach = np.asarray(model.command_range, float)[k]
    low[k], high[k] = 0.25 * reach
    change = np.asarray(model.tip(np.array([low, high])), float).reshape(2, 3)
    moved = change[1] - change[0]
    axis = int(np.argmax(np.abs(moved)))
    return f"{'+' if moved[axis] > 0 else '-'}{AXES[axis]}"


def pulley_calibration(rig: Rig, model: Model, pulley: Radius, signs: Sequence[int]) -> Calibration:
    """Return the calibration of a rig whose servo k pulls command k by `signs[k]`, ±1.

    All pulleys have the same radius.

    Raises:
        ServoError: a home is not known, or servos, signs and commands do not agree.
        CalibrationError: the model's commands are not in mm.
    """
    count = model.channels
    if len(rig.servos) != count or len(signs) != count:
        raise ServoError(
            f"the rig has {len(rig.servos)} servos, the model {count} commands, {len(signs)} "
            "signs are given; servo k of the rig pulls command k, so they must agree"
        )
    if model.command_unit != "mm":
        raise CalibrationError(
            f"the model's commands are {model.command_unit}; a radius gives only mm of tendon"
        )
    homes = [servo.home for servo in rig.servos]
    if missing := [servo.id for servo in rig.servos if servo.home is None]:
        raise ServoError(no_home(missing))
    slope = 2.0 * np.pi / TURN * pulley.mm
    share = pulley.sigma / pulley.mm
    doubt = np.where(np.eye(count) > 0, share, COUPLING) * slope
    found = Calibration(
        np.diag(np.array(signs, float)) * slope,
        np.zeros(count),
        np.array(homes, float),
        doubt,
        np.full(count, NEAR * slope),
        _expected(model, share, NEAR * slope),
        f"no run: {pulley.said}, jogged signs {','.join('+' if s > 0 else '-' for s in signs)}",
        0,
        0,
    )
    return replace(found, window=found.holding(model.command_range))


def _expected(model: Model, share: float, at_home: float) -> dict[str, float]:
    """Return the error expected from these deviations, RMS over the model's range.

    The shape error is that at the ends of the range.
    """
    box = np.asarray(model.command_range, float)
    # mean of u² over each range
    square = (box[:, 0] ** 2 + box[:, 0] * box[:, 1] + box[:, 1] ** 2) / 3.0
    command = float(
        np.sqrt(np.mean((share**2 + COUPLING**2 * (len(box) - 1)) * square + at_home**2))
    )
    inside = 0.5 * box[:, 1]
    shapes = np.asarray(model.prior.evaluate(np.array([inside, inside + command]))).reshape(
        2, -1, 3
    )
    shape = float(np.sqrt(np.mean(np.sum((shapes[1] - shapes[0]) ** 2, axis=-1))))
    return {"command": command, "shape_mm": shape, "matched_shape_mm": 0.0}


def document(found: Calibration, model: Model, warnings: Sequence[str]) -> Document:
    """Return softmap.calibration/1 as `softmap model calibrate` does, without matched pairs."""
    matched: Document = {"ticks": [], "command": [], "frames": [], "weight": [], "mae_mm": None}
    return found.to_dict() | {
        "affine": True,
        "departures": [],
        "matched": matched,
        "usable_commands": found.usable(model.command_range).tolist(),
        "warnings": list(warnings),
    }
