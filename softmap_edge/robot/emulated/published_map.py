"""Servo ticks and millimetres of tendon: u = A (ticks − home) + b.

The numbers are those published for the MOE finger.

Ma et al., SOFTMAP, fit A and b between real and simulated shapes; the numbers of `PUBLISHED` are
those that the authors released with their browser demonstration, the window of ±7000 ticks around
home too (neither stands in the paper). Two servos, one for each pair of tendons; b is not zero, so
that home is not command 0. The truth's own law, written apart from `model/servo_calibration.py`,
which has to find it. Pinned by tests/synthetic/test_virtual.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softmap_edge.errors import SoftmapError

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ServoMap:
    """The map of C servos: `slope` A (C, C) mm a tick, `shift` b (C,) mm, `home` (C,) ticks.

    `window` is ± ticks.
    """

    slope: tuple[tuple[float, ...], ...]
    shift: tuple[float, ...]
    home: tuple[float, ...]
    window: float

    def to_mm(self, ticks: ArrayLike) -> Floats:
        """Return the commands (..., C) mm of ticks (..., C)."""
        return np.asarray(
            (np.asarray(ticks, np.float64) - self.home) @ np.array(self.slope).T + self.shift
        )

    def to_ticks(self, command: ArrayLike) -> NDArray[np.int64]:
        """Return the whole ticks (..., C) nearest to commands (..., C) mm.

        Raises SoftmapError outside the window.
        """
        away = np.linalg.solve(
            np.array(self.slope), (np.asarray(command, np.float64) - self.shift)[..., None]
        )[..., 0]
        farthest = float(np.max(np.abs(away), initial=0.0))
        if farthest > self.window:
            raise SoftmapError(
                f"commands that need {farthest:.0f} ticks from home; the servos take "
                f"±{self.window:.0f}, move less"
            )
        return np.asarray(np.rint(away + self.home), np.int64)


PUBLISHED = ServoMap(
    slope=((0.003106, -0.001274), (-0.001511, -0.002801)),
    shift=(-1.363, 0.758),
    home=(1039.05, 1832.25),
    window=7000.0,
)
