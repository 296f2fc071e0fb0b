"""The one-euro filter: a low pass that opens with speed.

It is still when the hand is still, and without lag when it moves.

    cutoff = min_cutoff + beta |dx/dt|  x̂ ← x̂ + a (x − x̂)  a = 1 / (1 + 1 / (2π cutoff dt))

G. Casiez, N. Roussel, D. Vogel, "1€ Filter", CHI 2012, component by component. The speed is
low-passed at SPEED_CUTOFF itself. After a gap it starts again from what is seen, and so it does
where the clock went back by more than one; a sample that is late by less changes nothing. Pinned by
tests/robot/test_one_euro.py.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softmap_edge.errors import TeleopError

Floats = NDArray[np.float64]
SPEED_CUTOFF = 1.0  # Hz, as published


@dataclass(frozen=True, eq=False)
class OneEuroState:
    """What the filter remembers: time s, estimate (n,), its speed (n,) a second."""

    t: float
    x: Floats
    speed: Floats


@dataclass(frozen=True)
class OneEuro:
    """`min_cutoff` Hz at rest, `beta` Hz per unit a second, `gap` s after which it starts again.

    Raises:
        TeleopError: a number that is not finite, a cutoff or gap not above 0, beta below 0.
    """

    min_cutoff: float = 1.5
    beta: float = 5.0
    gap: float = 0.5

    def __post_init__(self) -> None:
        if not (
            0 < self.min_cutoff < math.inf and 0 <= self.beta < math.inf and 0 < self.gap < math.inf
        ):
            raise TeleopError(
                f"one-euro filter: {self}; expected min_cutoff > 0 Hz, beta ≥ 0 and gap > 0 s, "
                "all finite"
            )

    def step(self, state: OneEuroState | None, t: float, x: ArrayLike) -> OneEuroState:
        """Return the state after `x` (n,) was seen at `t` s; its `x` is the estimate. None starts.

        Raises:
            TeleopError: a number that is not finite, or x of another size than before.
        """
        seen = np.atleast_1d(np.asarray(x, dtype=np.float64))
        if not (math.isfinite(t) and np.isfinite(seen).all()):
            raise TeleopError(
                f"one-euro filter: t = {t}, x = {seen.tolist()!s:.60}; give finite numbers, or "
                "start again"
            )
        if state is not None and seen.shape != state.x.shape:
            raise TeleopError(
                f"one-euro filter: x of shape {seen.shape} after {state.x.shape}; start again "
                "with None"
            )
        dt = math.inf if state is None else t - state.t
        if state is None or abs(dt) > self.gap:
            return OneEuroState(t, seen, np.zeros_like(seen))
        if dt <= 0:
            return state
        speed = state.speed + _share(SPEED_CUTOFF, dt) * ((seen - state.x) / dt - state.speed)
        cutoff = self.min_cutoff + self.beta * np.abs(speed)
        return OneEuroState(t, state.x + _share(cutoff, dt) * (seen - state.x), speed)


def _share(cutoff: float | Floats, dt: float) -> Floats:
    """How much of what is new a low pass takes in `dt` s."""
    return np.asarray(1.0 / (1.0 + 1.0 / (2.0 * math.pi * np.asarray(cutoff) * dt)))
