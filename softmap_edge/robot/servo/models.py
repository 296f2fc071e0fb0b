"""What is known of a servo's model: its entry in the compiled table, by name or by the number that it tells.

An entry has `name`, `number`, `baud_rates`, `operating_mode`, what the servo can do and what it draws; a model without
a current sensor has None for its currents. Pinned by tests/robot/test_rig_file.py.
"""

from __future__ import annotations

from typing import Any

from softmap_edge import _core
from softmap_edge.errors import ServoError

Entry = dict[str, Any]


def servo_model(name: str) -> Entry:
    """Return what is known of the model of this name.

    Raises:
        ServoError: no such model.
    """
    known = {model["name"]: model for model in _core.servo_models()}
    if name not in known:
        raise ServoError(f"no servo '{name:.40}' is known; there are {', '.join(known)}")
    return known[name]


def numbered(number: int) -> Entry | None:
    """Return what is known of the model that tells this number, None of a stranger."""
    return next((model for model in _core.servo_models() if model["number"] == number), None)
