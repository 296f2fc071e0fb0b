"""Inverse kinematics of the tip: effective commands, and the commands that produce them.

    kinematics = Kinematics(model)
    kinematics.solve([[5.0, 0.0, 95.0]]).distance     # 0 within reach, else mm to the nearest
                                                      # reachable point
    plan = kinematics.plan(targets, t)  # a timed path through the effects of the model

Targets are in the base frame, without sensing effects. Effective commands stay within the range of
the model; commands also stay within the tick window of its calibration. Delay and lag are previewed
along the path; all other effects of the chain are inverted sample by sample (`rust/inverse/`).
Pinned by tests/model/test_kinematics.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softmap_edge import _core
from softmap_edge.errors import SoftmapError
from softmap_edge.files.atomic import Document
from softmap_edge.model.chain_labels import valued
from softmap_edge.model.model import Model
from softmap_edge.model.predictors import tip
from softmap_edge.run.fields import unmasked
from softmap_edge.run.rest_command import home_command

Floats = NDArray[np.float64]

AXES = "xyz"
METHODS = ("exact", "paper")
HEAVIEST = 1e4  # g at the tip
# mm: below this a target counts as reached; folds of an interpolated sweep hide some µm
REACHED = 0.01
# effects that act on the path rather than on a sample, and their delay parameter
PREVIEWED = {"latency": "delay", "lag": "tau"}


@dataclass(frozen=True)
class Solved:
    """The solution for targets (T, 3).

    `acting` (T, C) mm are the effective commands and `tip` (T, 3) mm the tip there. `distance` (T,)
    mm counts along the axes in use. `asked` (T,) counts evaluations of the model.
    """

    acting: Floats
    tip: Floats
    distance: Floats
    asked: NDArray[np.int64]


@dataclass(frozen=True)
class Plan:
    """A timed path: at `t` (T,) s the tip should be at `targets` (T, 3) mm.

    The effective commands `acting` (T, C) mm bring it there. The commands `commands` (T, C) mm,
    sent at `t`, produce them through the effects. `tip` (T, 3) is the position that the model then
    expects, and `distance` (T,) mm its distance from the target along the axes that count.
    `unreachable` (T,) mm are the distances of the targets from the reachable set.
    """

    t: Floats
    targets: Floats
    acting: Floats
    commands: Floats
    tip: Floats
    distance: Floats
    unreachable: Floats


class Kinematics:
    """Inverse kinematics of a model's tip in constant conditions.

    `counted` (3,) are the axes that count.

    Args:
        model: with its effects
        gravity: (3,) unit vector, by default the model's orientation
        load: g at the tip
        temperature: °C
        axes: coordinates of a target that count, such as "xy"

    Raises:
        SoftmapError: invalid axes, gravity or load, a model without commands, an effect that cannot
            be inverted (a user's own), or a missing field that an effect needs.
    """

    def __init__(
        self,
        model: Model,
        *,
        gravity: ArrayLike | None = None,
        load: float = 0.0,
        temperature: float = float("nan"),
        axes: str = AXES,
    ) -> None:
        if not axes or set(axes) - set(AXES) or len(set(axes)) < len(axes):
            raise SoftmapError(f"axes '{axes}'; name some of x, y and z, each once")
        if model.channels == 0:
            raise SoftmapError(
                f"the model of '{model.robot}' takes no commands: nothing moves its tip"
            )
        hangs = unmasked(model.gravity_reference if gravity is None else gravity)
        unit = gravity is None or (hangs.shape == (3,) and abs(np.linalg.norm(hangs) - 1.0) < 1e-3)
        if not unit or not 0.0 <= load <= HEAVIEST:
            raise SoftmapError(
                f"gravity {hangs.tolist()}, load {load:g} g; a unit vector (3,) and 0 to "
                f"{HEAVIEST:g} g are expected"
            )
        self.model, self.axes = model, axes
        self.counted: NDArray[np.bool_] = np.array([axis in axes for axis in AXES])
        self._world = hangs, load, temperature
        if gravity is None and not load:
            self.tip = model.tip_shape
        else:
            self.tip = tip(model.structure, model.chain, model.chain_params, *self._world)
        reach = np.asarray(model.command_range, float)
        self.bounds = reach if model.calibration is None else model.calibration.usable(reach)
        self._chain = self.inverse()

    def inverse(self) -> _core.Inverse:
        """Return the chain of the model's effects, at rest, to be inverted step by step."""
        low, high = self.bounds.T
        return _core.Inverse(
            self.model.chain, self.model.chain_params, low.tolist(), high.tolist(), *self._world
        )

    def document(self) -> Document | None:
        """Return the data for the control loop to compensate the effects; None without effects."""
        if not self.model.chain_names:
            return None
        gravity, load, temperature = self._world
        return {
            "names": list(self.model.chain_names),
            "params": np.asarray(self.model.chain_params).tolist(),
            "low": self.bounds[:, 0].tolist(),
            "high": self.bounds[:, 1].tolist(),
            "gravity": np.asarray(gravity, float).tolist(),
            "load": load,
            "temperature": None if np.isnan(temperature) else temperature,
        }

    @property
    def home(self) -> Floats:
        """The command (C,) at rest, limited to the usable range."""
        return home_command(self.bounds)

    @cached_property
    def acting_bounds(self) -> Floats:
        """The range (C, 2) mm of effective commands.

        It is that of the model, limited to what single commands reach when held for long.
        """
        home = self.home
        ends = []
        for c, side in np.ndindex(self.model.channels, 2):
            command = home.copy()
            command[c] = self.bounds[c, side]
            ends.append(self._chain.settle(command))
        found = np.array(ends + [self._chain.settle(home)])
        low, high = np.asarray(self.model.command_range, float).T
        return np.stack(
            [np.maximum(found.min(axis=0), low), np.minimum(found.max(axis=0), high)], axis=1
        )

    @cached_property
    def reach(self) -> _core.Reach:
        """The reachable set of the tip."""
        low, high = self.acting_bounds.T
        return _core.Reach(self.tip, low.tolist(), high.tolist(), self.counted.tolist())

    def solve(
        self, targets: ArrayLike, start: ArrayLike | None = None, method: str = "exact"
    ) -> Solved:
        """Return the effective commands for each of `targets` (T, 3) mm, one after the other.

        Args:
            start: (C,) mm, start of the first search; by default the complete range is searched
            method: `exact`, or `paper`: the paper's grid, Nelder-Mead and Adam, for comparison

        Raises:
            SoftmapError: targets of another shape or not finite, or no such method.
        """
        points = _points(targets)
        if method not in METHODS:
            raise SoftmapError(f"no method '{method}'; there are {', '.join(METHODS)}")
        first = None if start is None else unmasked(start).tolist()
        return Solved(*self.reach.path(points, first, method == "paper"))

    def plan(
        self,
        targets: ArrayLike,
        t: ArrayLike,
        start: ArrayLike | None = None,
        method: str = "exact",
        acting: Floats | None = None,
    ) -> Plan:
        """Return commands that lead the tip through `targets` (T, 3) mm at `t` (T,) s.

        The effects are compensated. Before the first target, the finger has been at rest for long,
        at home or at the command `start` (C,) mm. The effective commands are solved for, unless
        `acting` (T, C) mm gives them.

        Raises:
            SoftmapError: as `solve`, or times that do not increase.
        """
        points, t = _points(targets), unmasked(t)
        if t.shape != (len(points),) or not np.isfinite(t).all() or (np.diff(t) <= 0).any():
            raise SoftmapError(
                f"times of shape {t.shape} for {len(points)} targets; give each one, and let them "
                "rise"
            )
        if acting is None:
            solved = self.solve(points, None, method)
            acting, unreachable = solved.acting, solved.distance
        else:
            unreachable = self._apart(np.asarray(self.tip.evaluate(acting)), points)
        rested = self.home if start is None else unmasked(start)
        self._chain.settle(rested)
        commands, _ = self._chain.path(early(acting, t, *self.delays), t)
        expected = np.asarray(self.tip.evaluate(self.effective_commands(commands, t, rested)))
        return Plan(
            t, points, acting, commands, expected, self._apart(expected, points), unreachable
        )

    @property
    def compensated(self) -> list[str]:
        """The model's effects that commands compensate.

        Delays without a preview are not compensated; a plan includes their error. A shape with
        memory is solved as if at rest.
        """
        from softmap_edge.model.effect_info import registry

        left = {
            info.name for info in registry().values() if info.family == "delay" or info.remembers
        }
        return [name for name in self.model.chain_names if name in PREVIEWED or name not in left]

    def _apart(self, places: Floats, targets: Floats) -> Floats:
        """Return the distances (T,) mm along the axes that count."""
        return np.asarray(np.linalg.norm((places - targets)[:, self.counted], axis=1))

    @property
    def delays(self) -> tuple[Floats, Floats]:
        """The delay of the model's effects (C,) s: pure delay plus time constant of the lag."""
        there = _core.Chain(list(PREVIEWED), self.model.channels)
        values = valued(there, self.model.params, there.null)
        labels = (f"{name}.{number}" for name, number in PREVIEWED.items())
        delay, lag = (values[[label == group for group in there.group_labels]] for label in labels)
        return delay, lag

    def effective_commands(self, commands: Floats, t: Floats, rested: Floats) -> Floats:
        """Return effective commands (T, C) mm for `commands` sent at `t`, from `rested` (C,).

        The commands were at `rested` for long. This runs the complete chain of the model forwards,
        including the part that cannot be inverted.
        """
        if not self.model.chain_names:
            return commands
        count = len(t) + 1
        times = np.concatenate([[t[0] - (t[1] - t[0] if len(t) > 1 else 1.0)], t])
        gravity, load, temperature = self._world
        acts = self.model.chain.rollout(
            np.asarray(self.model.chain_params)[None],
            np.concatenate([rested[None], commands]),
            times,
            np.tile(gravity, (count, 1)),
            np.full(count, load),
            None if np.isnan(temperature) else np.full(count, temperature),
        )
        return np.asarray(acts)[0, 1:]

    def reaches(self, targets: ArrayLike) -> NDArray[np.bool_]:
        """Return which of `targets` (T, 3) mm the tip reaches within `REACHED` mm.

        Distances count along the axes in use."""
        points = _points(targets)
        return np.array([self.solve(point[None]).distance[0] <= REACHED for point in points], bool)


def early(acting: Floats, t: Floats, delay: Floats, lag: Floats) -> Floats:
    """Return commands at `t` (T,) s that make `acting` (T, C) effective in time.

    The delays and lags are (C,) s. u(t) = x(t + delay) + lag x'(t + delay), linear between samples,
    held after the last.
    """
    if (not delay.any() and not lag.any()) or len(t) < 2:
        return acting
    asked = acting + lag * np.gradient(acting, t, axis=0)
    return np.stack(
        [np.interp(t + late, t, column) for late, column in zip(delay, asked.T)], axis=1
    )


def _points(targets: ArrayLike) -> Floats:
    points = unmasked(targets)
    if points.ndim != 2 or points.shape[1:] != (3,):
        raise SoftmapError(
            f"targets of shape {points.shape}, expected (T, 3): x, y, z in mm, base frame"
        )
    if not np.isfinite(points).all():
        wrong = int(np.argmin(np.isfinite(points).all(axis=1)))
        raise SoftmapError(
            f"target {wrong} is {points[wrong].tolist()}; finite numbers in mm are expected"
        )
    return points
