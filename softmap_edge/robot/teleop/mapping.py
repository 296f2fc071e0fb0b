"""Map a hand or knob to a point of a plane: the two commands, or the tip's lateral position.

The direct map of the paper uses the commands (u_lat, u_vert) as the plane. `TipMapping` uses the
tip's (x, y) relative to u = 0 and finds the commands by inverse kinematics, for any number of
tendons. Pinned by tests/robot/test_aim.py.
"""

from __future__ import annotations

from itertools import product
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softmap_edge.errors import TeleopError
from softmap_edge.robot.motion.kinematics import Kinematics

Floats = NDArray[np.float64]

# tendons up to which the tip's range is searched over all corners of the command range
MOST_GRID = 5


class HandMapping(Protocol):
    """A plane to drive in: `box` (2, 2) mm is its range, LOW < 0 < HIGH; `names` its axes."""

    box: Floats
    names: tuple[str, str]

    def command(self, point: ArrayLike) -> Floats:
        """Return the command (C,) mm that should act for a point (2,) of the plane."""
        ...

    def point(self, acting: ArrayLike) -> Floats:
        """Return the point (2,) of the plane for the effective command `acting` (C,) mm."""
        ...


class DirectMapping:
    """The two commands of a model, as in the paper.

    Raises:
        TeleopError: the model has another number of commands.
    """

    names = ("u0", "u1")

    def __init__(self, kinematics: Kinematics) -> None:
        if (count := kinematics.model.channels) != 2:
            raise TeleopError(
                f"the model takes {count} commands, a hand drives two; give --tip to lead its tip"
            )
        self.box = kinematics.acting_bounds

    def command(self, point: ArrayLike) -> Floats:
        """Return the point (2,) itself, within the range of the commands."""
        return np.asarray(np.clip(np.asarray(point, float), *self.box.T))

    def point(self, acting: ArrayLike) -> Floats:
        """Return the effective command (2,) itself."""
        return np.asarray(acting, float)


class TipMapping:
    """The tip's x and y relative to u = 0; an unreachable point is replaced by the nearest one."""

    names = ("x", "y")

    def __init__(self, kinematics: Kinematics) -> None:
        if kinematics.axes != "xy":
            raise TeleopError(
                f"the tip is led in x and y, and the kinematics count {kinematics.axes}"
            )
        self._kinematics = kinematics
        low, high = kinematics.acting_bounds.T
        count = len(low)
        rest = np.clip(np.zeros(count), low, high)
        some = (
            product(*zip(low, rest, high)) if count <= MOST_GRID else _one_by_one(low, rest, high)
        )
        self._rest = np.asarray(kinematics.tip.evaluate(rest[None]))[0]
        places = np.asarray(kinematics.tip.evaluate(np.array(list(some))))[:, :2] - self._rest[:2]
        self.box = np.stack([places.min(axis=0), places.max(axis=0)], axis=1)
        self._last = rest

    def command(self, point: ArrayLike) -> Floats:
        """Return the effective command (C,) for a point (2,) mm, from the previous solution."""
        place = self._rest + (*np.asarray(point, float), 0.0)
        self._last = self._kinematics.solve(place[None], self._last).acting[0]
        return self._last

    def point(self, acting: ArrayLike) -> Floats:
        """Return the position (2,) mm of the tip relative to u = 0, for a command (C,)."""
        tip = np.asarray(self._kinematics.tip.evaluate(np.asarray(acting, float)[None]))[0]
        return np.asarray((tip - self._rest)[:2])


def _one_by_one(low: Floats, rest: Floats, high: Floats) -> list[Floats]:
    found = []
    for c, end in product(range(len(low)), (low, high)):
        one = rest.copy()
        one[c] = end[c]
        found.append(one)
    return found
