"""Folds of a rod's cross-validation: time blocks whose commands also occur in other parts.

A recording of one or two sweeps visits each command once or twice. A long block then holds all
frames of its commands. Its error measures how a polynomial extrapolates, not how accurate it is. So
blocks and the gaps next to them are halved until the rest covers them. Coverage is the leverage of
the terms of the fitted map (`model/coverage.py`). The few uncovered frames are not tested: one of
them can outweigh all others. A diagnosis excludes such frames as well. If squares replace too many
terms, all frames are tested. Long recordings keep the given blocks. Pinned by
tests/rod/test_learned_memory.py, tests/rod/test_pulled_rod.py and tests/rod/test_splined_rod.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from softmap_edge.model.basis import SQUARES, Basis
from softmap_edge.model.coverage import Coverage
from softmap_edge.rod.reference_run import ReferenceFrames
from softmap_edge.run.folds import FOLDS, GAP, Folds, Index, folds, labelled, run_folds

UNCOVERED = 0.1  # share of the held-out frames that the others may leave uncovered
LEAST_COVERED = 0.5  # share of covered frames below which all frames are tested
MOST_GAP = 0.5  # of a block: larger gaps leave too little of a short run
MOST_BLOCKS, LEAST_FRAMES = 40, 4  # most blocks of a run, and least frames of a block


def covered_folds(
    seen: ReferenceFrames, basis: Basis, blocks: int, gap_s: float
) -> tuple[Folds, float]:
    """Return folds of at least `blocks` time blocks, and the gap (s, at most `gap_s`) next to each.

    Args:
        seen: the frames.
        basis: the richest map that may be fitted to them.
        blocks, gap_s: as requested.

    Raises:
        RunError: too few frames.
    """
    while True:
        gap = min(gap_s, MOST_GAP * seen.seconds / max(blocks, 1))
        parts = folds(seen.t, blocks, gap)
        covered = [(train, test[~_outside(seen, basis, train, test)]) for train, test in parts]
        share = sum(len(test) for _, test in covered) / len(seen.t)
        finer = 2 * blocks
        if share >= 1.0 - UNCOVERED or finer > MOST_BLOCKS or len(seen.t) < LEAST_FRAMES * finer:
            tested = [(train, test) for train, test in covered if len(test)]
            own = basis != SQUARES and share >= LEAST_COVERED and len(tested) > 1
            return (tested if own else parts), gap
        blocks = finer


def search_folds(seen: ReferenceFrames, basis: Basis) -> Folds:
    """Return the folds of a search: labels, or time blocks, and runs covered by others.

    A run is covered if its commands occur in other runs.
    """
    parts = (
        run_folds(seen.t, seen.labels)
        if labelled(seen.labels)
        else covered_folds(seen, basis, FOLDS, GAP)[0]
    )
    for k in range(len(seen.runs)) if len(seen.runs) > 1 else ():
        inside = seen.number == k
        commands = seen.drive.commanded
        if Coverage.of(commands[~inside]).outside(commands[inside]).mean() <= UNCOVERED:
            parts.append((np.flatnonzero(~inside), np.flatnonzero(inside)))
    return parts


def _outside(seen: ReferenceFrames, basis: Basis, train: Index, test: Index) -> NDArray[np.bool_]:
    """Return which of the held-out frames the training frames leave uncovered."""
    commands = seen.drive.commanded
    return (
        Coverage.of(commands[train], basis).outside(commands[test])
        if len(train)
        else np.zeros(len(test), bool)
    )
