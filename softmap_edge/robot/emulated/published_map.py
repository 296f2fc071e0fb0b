"""The published map of the MOE finger from servo ticks to tendon length: u = A (ticks − home) + b.

Ma et al., SOFTMAP, fit A and b between real and simulated shapes. The numbers in `PUBLISHED` are
those of the authors' browser demonstration, including the window of ±7000 ticks around home;
neither is in the paper. Each of the two servos drives a pair of tendons. b is not zero, so home is
not command 0. This is a hidden law, written independently of `model/servo_calibration.py`, which
must recover it. Pinned by tests/synthetic/test_virtual.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softmap_edge.errors import SoftmapError

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ServoMap:
    """The map of C servos: `slope` A (C, C) mm per tick, `shift` b (C,) mm, `home` (C,) ticks.

    `window` is the largest distance from home, ticks.
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
        """Return the integer ticks (..., C) nearest to commands (..., C) mm.

        Raises:
            SoftmapError: ticks are outside the window.
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
