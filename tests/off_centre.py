"""A finger whose spools turn off their middle: exact geometry of winding, another form than any effect of the library.

The rim (radius R) turns about a point e off its middle c, e = |c|; the tendon leaves it along the tangent towards a
guide D away. With L the free length, β the angle of the tangent point about c and θ the servo's angle, the tendon is
shortened by L(θ) − L(0) + R (θ − β(θ) + β(0)); its slope is the moment arm of the free tendon about the axis.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from softmap_edge.bundle import builtin_model
from softmap_edge.diagnosis.comparison import compare
from softmap_edge.protocol import other_protocol, standard_protocol
from softmap_edge.truth import Secret, hide
from softmap_edge.truth_laws import Law


@dataclass(frozen=True)
class OffCentre(Law):
    """A command is the rim's radius times the servo's angle, as if the spool turned about its middle."""

    NAME = "off-centre spool"
    radius_mm: float = 5.0
    off_mm: tuple[float, ...] = (0.9, 0.8)
    phase: tuple[float, ...] = (0.6, -1.1)
    guide_mm: float = 40.0

    def command(self, t, u):
        return np.stack([self.wound(x / self.radius_mm, e, p) for x, e, p in zip(u.T, self.off_mm, self.phase)], axis=1)

    def wound(self, angle, off, phase):
        """Return the shortening (T,) mm at servo angles (T,) rad."""

        def free_and_tangent(turned):
            x, y = self.guide_mm - off * np.cos(turned + phase), -off * np.sin(turned + phase)
            far = np.hypot(x, y)
            return np.sqrt(far**2 - self.radius_mm**2), np.arctan2(y, x) + np.arccos(self.radius_mm / far)

        (free, tangent), (free0, tangent0) = free_and_tangent(angle), free_and_tangent(np.zeros(1))
        return free - free0 + self.radius_mm * (angle - tangent + tangent0)


@lru_cache(maxsize=1)
def story(seed=4):
    """Return a run of that finger, a run of another kind, and the error there of the model with nothing hidden."""
    hidden = replace(hide((), seed), secrets=(Secret(OffCentre(), 0.0),))
    judge = other_protocol(2)
    floor = compare(builtin_model(), hidden.twin().measure(judge, seed=1)).error["rms_mm"]
    return hidden.measure(standard_protocol(2)), hidden.measure(judge, seed=1), floor
