"""The result of a calibration: the map of ticks, the held commands it was fitted to, and doubts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.calibration.departures import FITTED_ALONGSIDE, Departure
from softmap_edge.calibration.held_out import HeldOut
from softmap_edge.files.atomic import Document
from softmap_edge.model.servo_calibration import Calibration

if TYPE_CHECKING:
    from softmap_edge.model.model import Model

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A calibration found: `model` has it, `held` are the rows it was fitted to.

    `departures` are why it is not affine.

    `weight` (n,) of each row is 0 where it does not belong; `mae_mm` is what the matches leave of
    the shapes, median. Prints itself; `to_dict()` is softmap.calibration/1, with more than a bundle
    keeps.
    """

    model: Model
    calibration: Calibration
    held: HeldOut
    weight: Floats
    mae_mm: float
    departures: list[Departure]
    warnings: list[str]

    @property
    def affine(self) -> bool:
        """Whether no evidence contradicts an affine map; a memory or a turn is fitted with it."""
        return all(one.kind in FITTED_ALONGSIDE for one in self.departures)

    @property
    def left(self) -> Floats:
        """Return the map's error of matched commands (n, C); NaN if one was not observed."""
        return np.where(
            self.held.observed, self.held.u - self.calibration.commands(self.held.ticks), np.nan
        )

    def to_dict(self) -> Document:
        """Return the document softmap.calibration/1 with matched pairs and doubts."""
        found, pairs = self.calibration, zip(self.held.u.tolist(), self.held.observed.tolist())
        return found.to_dict() | {
            "affine": self.affine,
            "departures": [one.to_dict() for one in self.departures],
            "matched": {
                "ticks": self.held.ticks.tolist(),
                "command": [[v if k else None for v, k in zip(*row)] for row in pairs],
                "frames": [len(part) for part in self.held.frames],
                "weight": self.weight.tolist(),
                "mae_mm": self.mae_mm,
            },
            "usable_commands": found.usable(self.model.command_range).tolist(),
            "warnings": list(self.warnings),
        }

    def __str__(self) -> str:
        c, n = self.calibration, len(self.held)
        rows = []
        for i, unit in enumerate(c.b):
            a = "".join(f"{v:13.6f} ± {s:<8.6f}" for v, s in zip(c.A[i], c.sigma_A[i]))
            rows.append(
                f"  u{i} {a}   b {unit:8.3f} ± {c.sigma_b[i]:.3f} {c.unit}   home {c.home[i]:.7g} "
                "ticks"
            )
        wrong = int((self.weight == 0).sum())
        aside = f", {wrong} of them set aside" if wrong else ""
        error = c.held_out
        lines = [
            f"Calibrated: u = A (ticks − home) + b, from {c.frames} frames at {n} "
            f"{'held commands' if self.held.still else 'places, in motion'}{aside}",
            f"  A, {c.unit}/tick",
            *rows,
            f"  condition of A {c.condition:.2f}; held out: {error['command']:.3g} {c.unit} of "
            f"command, {error['shape_mm']:.3g} mm of shape, of which the matches leave "
            f"{error['matched_shape_mm']:.3g} mm",
        ]
        if c.window is not None:
            span = ", ".join(
                f"{low:.2f} to {high:.2f}" for low, high in c.usable(self.model.command_range)
            )
            lines.append(
                f"  usable with {c.window[0]:g} to {c.window[1]:g} ticks about home: {span} "
                f"{c.unit}"
            )
        return "\n".join([*lines, *(f"  look at: {text}" for text in self.warnings)])
