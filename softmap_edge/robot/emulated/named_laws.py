"""Hidden laws by name, in a fixed strength: faults that the effect library does not contain.

Like those of `robot/emulated/laws.py`, they differ in form from the effect library. Pinned by
tests/commands/test_own_effect_page.py and tests/synthetic/test_truth.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from typing import Self

import numpy as np

from softmap_edge.errors import SoftmapError, no_name
from softmap_edge.robot.emulated.laws import LAWS, Floats, Law, Numbers


@dataclass(frozen=True)
class OffCentreSpool(Law):
    """A spool that turns off its centre: exact winding geometry, not in the library.

    The rim (radius R) turns about a point at distance e from its centre c. The tendon leaves the
    rim along the tangent towards a guide at distance D. With L the free length, β the angle of the
    tangent point about c and θ the servo's angle, the tendon is shortened by L(θ) − L(0) + R (θ −
    β(θ) + β(0)). Its slope is the moment arm of the free tendon about the axis. The command is the
    rim's radius times the servo's angle, as if the spool turned about its centre.
    """

    NAME = "off_centre_spool"
    radius_mm: float = 5.0
    off_mm: Numbers = (0.9, 0.8)  # of each channel, repeated for more channels
    phase: Numbers = (0.6, -1.1)
    guide_mm: float = 40.0

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls()

    def scaled(self, s: float) -> Self:
        return replace(self, off_mm=tuple(s * x for x in self.off_mm))

    def command(self, t: Floats, u: Floats) -> Floats:
        spools = zip(u.T, cycle(self.off_mm), cycle(self.phase))
        return np.stack([self.wound(x / self.radius_mm, e, p) for x, e, p in spools], axis=1)

    def wound(self, angle: Floats, off: float, phase: float) -> Floats:
        """Return the shortening (T,) mm at servo angles (T,) rad."""

        def free_and_tangent(turned: Floats) -> tuple[Floats, Floats]:
            x, y = self.guide_mm - off * np.cos(turned + phase), -off * np.sin(turned + phase)
            far = np.hypot(x, y)
            return np.sqrt(far**2 - self.radius_mm**2), np.arctan2(y, x) + np.arccos(
                self.radius_mm / far
            )

        (free, tangent), (free0, tangent0) = free_and_tangent(angle), free_and_tangent(np.zeros(1))
        return np.asarray(free - free0 + self.radius_mm * (angle - tangent + tangent0))


@dataclass(frozen=True)
class SwappedServos(Law):
    """The first two servos are swapped; a single servo turns the wrong way."""

    NAME = "servo_swap"

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls()

    def scaled(self, s: float) -> Self:
        return self

    def command(self, t: Floats, u: Floats) -> Floats:
        return np.asarray(-u if u.shape[1] < 2 else u[:, [1, 0, *range(2, u.shape[1])]])


NAMED: dict[str, type[Law]] = {law.NAME: law for law in (SwappedServos, OffCentreSpool)}


def check_hidden(names: Sequence[str], seed: int) -> None:
    """Raise SoftmapError for an unknown or repeated name of a law, or a negative seed."""
    unknown = [name for name in names if name not in {**NAMED, **LAWS}]
    if unknown:
        raise SoftmapError(no_name("hidden law", unknown[0], [*LAWS, *NAMED]))
    if len(set(names)) != len(names):
        raise SoftmapError(f"each effect can be hidden once, got {', '.join(names)}")
    if seed < 0:
        raise SoftmapError(f"seed {seed} is negative; give 0 or more")
