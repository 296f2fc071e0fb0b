"""Data of a servo's model: its entry in the compiled table, by name or by reported number.

An entry has `name`, `number`, `baud_rates`, `operating_mode`, the servo's capabilities and its
currents; a model without a current sensor has None for its currents. Pinned by
tests/robot/test_rig_file.py.
"""

from __future__ import annotations

from typing import TypedDict

from softmap_edge import _core
from softmap_edge.errors import ServoError

# position gains P, I, D and feedforward 1, 2 of the manual (register units); None if they depend on
# the firmware
FACTORY_GAINS: dict[str, tuple[int | None, ...]] = {"XL330": (400, 0, 0, 0, 0)}
OTHER_GAINS = (None, 0, None, 0, 0)


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
    pwm_limit: int
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


def factory_gains(model: ServoModel) -> tuple[int | None, ...]:
    """Return the factory setting of each gain in the order of `known_state.GAINS`.

    None stands for a gain that depends on the firmware.
    """
    return FACTORY_GAINS.get(model["name"].partition("-")[0], OTHER_GAINS)
