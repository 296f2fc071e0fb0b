"""The spool radius, if known: an eccentric pulley then has no free period.

    R = |A_kk| · 4096 / 2π       A (C, C) commands a tick (the model's calibration), 4096 ticks a
                                 turn of the horn

An eccentric pulley repeats after one turn, 2πR of the command. A run can also declare R
(`spool_radius_mm`, which an import keeps from its mapping). The calibration takes precedence: it
was measured in the model's own commands. Limits: one radius for all spools, mounted on the horn
without gears, one servo per channel. Pinned by tests/diagnosis/test_spools.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.model.parameter_layout import Layout
from softmap_edge.model.servo_calibration import TURN, Calibration
from softmap_edge.run.run import Run, spool_radius

if TYPE_CHECKING:
    from softmap_edge.model.model import Model

Floats = NDArray[np.float64]

RADIUS = "eccentric_pulley.radius"
ALIKE = 0.05  # of their mean: radii that differ by less are equal
# of its own slope: a channel moved more by other servos is not on one spool
CROSSED = 0.1


@dataclass(frozen=True)
class Spool:
    """The radius of the spools in the commands' unit, its standard deviation and origin."""

    radius: float
    sigma: float | None
    source: str


def spool_of(model: Model, runs: Sequence[Run]) -> Spool | None:
    """Return a robot's spool radius; None if neither calibration nor every run gives it."""
    calibration = model.calibration
    if calibration is not None and calibration.unit == model.command_unit:
        return _calibrated(calibration)
    declared = [spool_radius(run.extra) for run in runs]
    radii = np.array([radius for radius in declared if radius is not None])
    if not len(runs) or len(radii) < len(runs) or model.command_unit != "mm":
        return None
    if np.ptp(radii) > ALIKE * radii.mean():
        return None
    return Spool(float(radii.mean()), None, "the run's mapping")


def _calibrated(calibration: Calibration) -> Spool | None:
    """Return the radius that a calibration gives.

    None if channels have several servos or different spools.
    """
    slopes, own = np.abs(calibration.A), np.abs(np.diag(calibration.A))
    radii, sigma = own * TURN / (2.0 * np.pi), np.diag(calibration.sigma_A) * TURN / (2.0 * np.pi)
    if np.any(slopes.sum(axis=1) - own > CROSSED * own) or np.ptp(radii) > ALIKE * radii.mean():
        return None
    return Spool(float(radii.mean()), float(np.sqrt(np.mean(sigma**2))), "the servos' calibration")


def with_radius(layout: Layout, spool: Spool) -> Layout:
    """Return a layout with the known radius of an eccentric pulley."""
    known = np.array([label == RADIUS for label in layout.labels], bool)

    def fixed(values: Floats) -> Floats:
        return np.where(known, spool.radius, values)

    return replace(
        layout,
        null=fixed(layout.null),
        start=fixed(layout.start),
        low=fixed(layout.low),
        high=fixed(layout.high),
        limit=fixed(layout.limit),
    )
