"""Check whether a strong memory explains an apparent fault of the measurement.

A play causes plateaus, a smaller stroke and late motion. So do a frozen camera, a command in
another unit and a wrong clock. Before such a fault is reported, plays of several widths are tried
in front of the model:

    share = 1 − Σ |(s − p) − mean|² / Σ |s − mean|²  s measured, p predicted points behind a play
    free  = (Σ s p)² / (Σ s² Σ p²)  the same with the best scale, about the means

Limit: one gap for all channels, in half of their median range. Pinned by
tests/checks/test_remembered.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from softmap_edge.model.model import Model
    from softmap_edge.run.run import Run

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# gaps in half ranges of the commands; with 2 nothing would move
GAPS = (0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0, 1.15, 1.3, 1.45, 1.6, 1.7, 1.8, 1.85, 1.9, 1.95)
PLAY = "backlash"
# of the squared jump, relative to the last step alone: the full motion leaves less
CAUGHT = 0.25


@dataclass(frozen=True)
class MemoryShare:
    """Best share of the motion that a play in front of the model explains.

    It is given at scale 1 and at the best scale (`free`).
    """

    share: float
    free: float


def memory_share(model: Model, run: Run, seen: Floats, visible: Mask) -> MemoryShare:
    """Return the share of the motion (K, N, 3) that the model explains behind the best play."""
    spans = np.ptp(model.commands(run), axis=0)
    if PLAY in model.chain_names or not np.any(spans > 0):
        return MemoryShare(-np.inf, 0.0)
    half = 0.5 * float(np.median(spans[spans > 0]))
    names, s = (PLAY, *model.chain_names), centred(seen, visible)
    power, best, free = max(float(np.sum(s**2)), 1e-300), -np.inf, 0.0
    for gap in GAPS:
        behind = model.with_effects(names, model.params | {f"{PLAY}.gap": gap * half})
        p = centred(np.asarray(behind.predict(run), float), visible)
        both, size = float(np.sum(s * p)), max(float(np.sum(p**2)), 1e-300)
        best = max(best, 1.0 - float(np.sum((s - p) ** 2)) / power)
        free = max(free, max(both, 0.0) ** 2 / (power * size))
    return MemoryShare(best, free)


def centred(points: Floats, visible: Mask) -> Floats:
    """Return points (K, N, 3) minus their mean over the frames that show them; 0 where unseen."""
    shown = np.where(visible[..., None], points, 0.0)
    mean = shown.sum(axis=0) / np.maximum(visible.sum(axis=0), 1)[:, None]
    return np.where(visible[..., None], shown - mean, 0.0)


def catches_up(
    begins: list[tuple[int, int, int]], seen: Floats, visible: Mask, predicted: Floats
) -> bool:
    """Return whether points jump by the complete predicted motion after repeated pictures.

    After the plateau of a play they continue from where they were, by the last step at most.

    Args:
        begins: for each stretch its first frame, its last repetition and the next frame.
        seen: measured points (K, N, 3) mm.
        predicted: predicted points (K, N, 3) mm.
        visible: which points were seen, (K, N).
    """
    total = last = 0.0
    for first, repeated, after in begins:
        both = visible[first] & visible[after]
        jump = (seen[after] - seen[first])[both]
        total += float(np.sum((jump - (predicted[after] - predicted[first])[both]) ** 2))
        last += float(np.sum((jump - (predicted[after] - predicted[repeated])[both]) ** 2))
    return total < CAUGHT * last
