"""A preview of the finger, predicted by the model from the servo positions.

Pinned by tests/robot/test_aim.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from softmap_edge.model.model import Model
from softmap_edge.model.servo_calibration import Calibration

Floats = NDArray[np.float64]

LONGEST = 0.5  # s between two calls; after a longer gap the effects restart at rest


class ShapePreview:
    """The points of a model's finger, with its effects, as servos turn.

    Args:
        model: with its effects, in its usual orientation, without load
        calibration: from ticks to commands
    """

    def __init__(self, model: Model, calibration: Calibration) -> None:
        self._model, self._map = model, calibration
        self._low, self._high = np.asarray(model.command_range, float).T
        self._shape = model.points.still(model.chain, model.chain_params, model.gravity_reference)
        self._state: Floats | None = None
        self._last = 0.0

    def points(self, position: Floats, now: float) -> Floats:
        """Return the points (N, 3) mm for servos at `position` (C,) ticks at `now` s (steady)."""
        u = self._map.commands(position[None])[0]
        model, dt = self._model, now - self._last
        self._last = now
        if not model.chain_names:
            return self.at(u)
        if self._state is None or not 0 < dt <= LONGEST:
            self._state, dt = model.chain.init(model.chain_params, u), 1e-3
        acting, self._state = model.chain.step(
            model.chain_params, self._state, u, dt, now, gravity=model.gravity_reference, load=0.0
        )
        return self.at(acting)

    def at(self, acting: Floats) -> Floats:
        """Return the points (N, 3) mm for the command `acting` (C,) mm, limited to the range."""
        inside = np.clip(acting, self._low, self._high)
        return np.asarray(self._shape.evaluate(inside[None])).reshape(-1, 3)
