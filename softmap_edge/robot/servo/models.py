"""Data of a servo's model: its entry in the compiled table, by name or by reported number.

An entry has `name`, `number`, `baud_rates`, `operating_mode`, the servo's capabilities and its
currents; a model without a current sensor has None for its currents. Pinned by
tests/robot/test_rig_file.py.
"""

from __future__ import annotations

from typing import TypedDict

from softmap_edge import _core
from softmap_edge.errors import ServoError


class ServoModel(TypedDict):
    """Data of a servo model; currents are None for a model without a sensor."""

    name: str
    number: int
    baud_rates: list[int]
    operating_mode: int
    capped_by: str  # register that caps the torque
    current_limit: int | None  # register units
    current_limit_mA: float | None
    current_unit_mA: float | None
    stall_current_mA: float
    stall_torque_Nm: float
    position_gains: tuple[int, int, int]  # P, I, D of the manual, register units
    pwm_limit: int
    shutdown: int  # bits of the errors that shut it down, as delivered
    velocity_limit: int
    fastest_ticks_per_s: float
    temperature_limit_C: float
    voltage_V: tuple[float, float]


def servo_model(name: str) -> ServoModel:
    """Return the data of the model with this name.

    Raises:
        ServoError: no such model.
    """
    known = {model["name"]: model for model in _core.servo_models()}
    if name not in known:
        raise ServoError(f"no servo '{name:.40}' is known; there are {', '.join(known)}")
    return known[name]


def numbered(number: int) -> ServoModel | None:
    """Return the entry of the model with this number; None if it is unknown."""
    return next((model for model in _core.servo_models() if model["number"] == number), None)


def manual_gains(model: ServoModel) -> tuple[int, ...]:
    """Return the initial gains in the manual of this model, in the order of `known_state.GAINS`.

    They only serve for comparison: the firmware may set others when a mode is chosen.
    """
    return (*model["position_gains"], 0, 0)
