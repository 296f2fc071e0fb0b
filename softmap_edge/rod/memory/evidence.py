"""Compare held-out losses of one log: whether an explanation counts, and which ones are equal.

Pinned by tests/rod/test_learned_memory.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.rod.reference_run import ReferenceFrames
from softmap_edge.rod.regression import standard_error
from softmap_edge.rod.static_map import StaticMap

Floats = NDArray[np.float64]

LEAST = 0.03  # least share of the loss that a family explains; less depends on the choice of folds
# the same of the loss above the noise; later families share the remainder
FIRST, LATER = 0.05, 0.3
# Shares of the loss above the noise. SURE: least that an identified or unknown law explains. LEFT:
# most that remains of the first loss, as in a diagnosis (decision.py).
SURE, LEFT = 0.2, 0.1
MOST_FOLDS = 0.6  # share of the folds in which it must fall
FALL = 0.01  # of a fold's loss: least fall
# of the robot's length, RMS: camera limit (0.12 mm for a finger of 120)
VISIBLE = 1e-3
FORM = 0.025  # of the explained loss: closer laws differ only by model-form error
# share and least number of folds that decide if the mean difference does not
AGREE, FOLDS_THAT_AGREE = 0.85, 5


@dataclass(frozen=True)
class Evidence:
    """The sizes of a log that decide whether a loss (folds,) mm² falls.

    Attributes:
        held_out: frames that are held out, over all folds.
        markers: count of markers.
        floor: loss of the noise alone over these frames, mm².
        noise_mm: noise of a target, mm.
        length_mm: length of the robot, mm.
    """

    held_out: int
    markers: int
    floor: float
    noise_mm: float
    length_mm: float

    @classmethod
    def of(cls, seen: ReferenceFrames, static: StaticMap) -> Evidence:
        """Return the evidence of a reference run with a static map."""
        held_out = sum(len(test) for _, test in static.parts)
        variance = _noise(static.residual(seen.drive.commanded))
        return cls(
            held_out,
            seen.markers.shape[1],
            variance * held_out * static.targets.shape[1],
            float(np.sqrt(variance)),
            float(np.linalg.norm(seen.markers, axis=2).mean(axis=0).max()),
        )

    def above(self, losses: Floats) -> float:
        """Return a loss above that of the noise, mm²; negative if it is below."""
        return float(losses.sum()) - self.floor

    def rms(self, losses: Floats) -> float:
        """Return a held-out error, mm RMS."""
        return float(np.sqrt(max(float(losses.sum()), 0.0) / (self.held_out * self.markers)))

    def falls(self, before: Floats, after: Floats, share: float) -> bool:
        """Whether a loss falls clearly, in most folds, by enough of it, and visibly."""
        fall = before - after
        enough = max(
            LEAST * float(before.sum()), share * max(self.above(before), 0.0), standard_error(fall)
        )
        most = float((fall > FALL * before).mean()) >= MOST_FOLDS
        visible = self.rms(fall) > VISIBLE * self.length_mm
        return float(fall.sum()) > enough and most and visible

    @staticmethod
    def near(one: Floats, best: Floats, before: Floats) -> bool:
        """Whether a held-out loss equals the best, within its error and form tolerance."""
        behind = one - best
        if behind.sum() <= FORM * float((before - best).sum()):
            return True
        decided = len(behind) >= FOLDS_THAT_AGREE and float((behind > 0).mean()) >= AGREE
        return float(behind.sum()) <= standard_error(behind) and not decided


def _noise(residual: Floats) -> float:
    """Return the variance of a target, mm², from its third differences between frames.

    It is the part that no map can explain.
    """
    if len(residual) < 8:
        return 0.0
    square = (np.diff(residual, n=3, axis=0) ** 2).mean(axis=1)
    # 1 + 9 + 9 + 1; corners at reversals are few, so the median
    return float(np.median(square)) / 20.0
