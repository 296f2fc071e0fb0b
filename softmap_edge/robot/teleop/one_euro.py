"""The one-euro filter: a low-pass whose cutoff rises with speed.

It suppresses jitter at rest and has little lag in motion.

    cutoff = min_cutoff + beta |dx/dt|  x̂ ← x̂ + a (x − x̂)  a = 1 / (1 + 1 / (2π cutoff dt))

G. Casiez, N. Roussel, D. Vogel, "1€ Filter", CHI 2012, per component. The speed is itself
low-passed at SPEED_CUTOFF. The filter restarts after a gap, and when the clock goes back by more
than a gap. A sample that is late by less is ignored. Pinned by tests/robot/test_one_euro.py.
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
    """State of the filter: time s, estimate (n,), its speed (n,) per s."""

    t: float
    x: Floats
    speed: Floats


@dataclass(frozen=True)
class OneEuro:
    """Filter with `min_cutoff` Hz at rest, `beta` Hz per unit/s; it restarts after `gap` s.

    Raises:
        TeleopError: a number is not finite, a cutoff or gap is not above 0, or beta is below 0.
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
        """Return the state after sample `x` (n,) at `t` s; its `x` is the estimate. None starts.

        Raises:
            TeleopError: a number is not finite, or x has another size than before.
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
    """Return the weight of a new sample in a low-pass after `dt` s."""
    return np.asarray(1.0 / (1.0 + 1.0 / (2.0 * math.pi * np.asarray(cutoff) * dt)))
