"""Level 1 of the search for a memory: the families whose signals lower the held-out loss.

The signals of each family (`signals.py`) are added to the static map as columns. If there are few
channels, their powers up to three are added as well. A family counts if it lowers the loss by enough
(`evidence.py`). If the best family does not, none counts: the next best would only replace it. The
B-splines of the command are the control. If they fit as well as the best family, they join the map.
Pinned by tests/rod/test_learned_memory.py.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softmap_edge.rod.memory.evidence import SURE
from softmap_edge.rod.memory.free_chain import FittedChain
from softmap_edge.rod.memory.progress import Progress, SearchData
from softmap_edge.rod.memory.step import FittedFamily, Step
from softmap_edge.rod.reference_run import ReferenceFrames
from softmap_edge.rod.signals import Family, families

Floats = NDArray[np.float64]

FEW_CHANNELS = 3  # most channels for powers of signals; with more there are too few frames
POWERS = 3


def shown_families(progress: Progress) -> list[FittedFamily]:
    """Return the families that this log can show, lowest held-out loss first."""
    seen, static = progress.data.seen, progress.data.static
    possible = [
        family
        for family in families()
        if not (family.fast and seen.slow or family.timed and seen.timeless)
        and not (family.static and (static.splined or static.basis.intervals))
    ]
    fitted = [
        FittedFamily(
            family,
            static.losses(progress.acting, family_signals(seen, family, progress.last)),
        )
        for family in possible
    ]
    return sorted(fitted, key=lambda one: one.loss)


def static_suffices(progress: Progress, shown: Sequence[FittedFamily]) -> bool:
    """Whether a map of another form fits as well as any memory."""
    best = shown[0].losses
    return progress.falls(best) and any(
        one.family.static and progress.near(one.losses, best) for one in shown
    )


def falling_families(progress: Progress, shown: Sequence[FittedFamily]) -> list[FittedFamily]:
    """Return the families that lower the loss; none if the best of all does not."""
    if not progress.falls(shown[0].losses):
        return []
    return [one for one in shown if progress.falls(one.losses) and not one.family.static]


def explains_more(data: SearchData, step: Step) -> bool:
    """Whether the signals of a step's family, on top of it, lower the remaining loss clearly."""
    signals = family_signals(data.seen, step.family, step.fitted)
    with_signals = data.static.losses(step.fitted.acting, signals)
    return data.evidence.falls(step.fitted.losses, with_signals, SURE)


def family_signals(seen: ReferenceFrames, family: Family, fitted: FittedChain | None) -> Floats:
    """Return a family's columns (n, J): signals of the effective commands, and their powers."""
    parts = []
    drive = seen.drive
    powers = POWERS if drive.channels <= FEW_CHANNELS and not family.static else 1
    for record in drive.records:
        u = record.u if fitted is None else fitted.effective(record)
        z = family.signals(record, u, drive.middle, drive.half)
        parts.append(np.concatenate([z**power for power in range(1, powers + 1)], axis=1))
    return np.concatenate(parts)
