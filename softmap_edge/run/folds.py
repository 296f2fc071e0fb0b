"""Cross-validation folds: frames that are held out together, and frames that are then fitted.

Adjacent frames are similar, so folds are blocks of time. Frames in a gap on each side are not used
for training. But moves of one kind are often recorded in sequence, so a block of time may hold all
of them, and a fit cannot learn moves that it never sees. (On a real nine-tendon robot the error of
a polynomial appeared ten times too large.) If a run has enough labels (`block`), complete labels
are distributed over the folds in turn, in order of appearance. In the same way every fifth block
is withheld from a search, to confirm its claims. Units: s. Pinned by tests/diagnosis/test_fit.py,
tests/diagnosis/test_certificates.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError, SoftmapError

Floats = NDArray[np.float64]
Index = NDArray[np.intp]
Folds = list[tuple[Index, Index]]  # (frames trained on, frames tested)

FOLDS, GAP = 8, 1.0  # folds of a diagnosis; s left out on each side of a fold
MOST_FOLDS = 10
LEAST_FRAMES = 8
LEAST_LABELLED = 3  # frames per label, on average; with fewer, labels are numbers of frames
LABELS_A_FOLD = 2  # labels; with fewer, a fold holds out only one kind of motion
# every fifth block is withheld, starting with the third: the first frames of a run are used
EVERY, FIRST = 5, 2
# a block is at least this many gaps long, so gaps cost few frames
MOST_BLOCKS, GAPS_A_BLOCK = 25, 5
LEAST_WITHHOLDING = 60  # frames; shorter runs withhold no blocks


def folds(
    t: Floats,
    blocks: int,
    gap_s: float,
    labels: NDArray[np.generic] | None = None,
    most: int = MOST_FOLDS,
) -> Folds:
    """Split frames at `t` (n,) s into folds; each is predicted from frames `gap_s` or more away.

    Without `labels` (n,) a fold is a block of time. With labels, complete labels are distributed in
    turn over at most `most` folds.

    Raises:
        RunError: too few frames or labels.
    """
    if labels is None:
        fold = np.repeat(
            np.arange(max(blocks, 1)), [len(part) for part in np.array_split(t, max(blocks, 1))]
        )
    else:
        _, first, label = np.unique(labels, return_index=True, return_inverse=True)
        order = np.argsort(np.argsort(first))  # labels in order of appearance
        blocks = min(most, len(first))
        fold = order[label.reshape(-1)] % max(blocks, 1)
    if blocks < 2 or len(t) < 2 * blocks:
        raise RunError(
            f"{len(t)} usable frames and {blocks} blocks; cross-validation needs 2 blocks of 2 "
            "frames or more"
        )
    parts: Folds = []
    for k in range(blocks):
        test = np.flatnonzero(fold == k)
        parts.append((np.flatnonzero((fold != k) & (_away(t, t[test]) > gap_s)), test))
    return parts


def run_folds(t_seen: Floats, labels: NDArray[np.generic] | None = None) -> Folds:
    """Return (train, test) frame indices of a diagnosis.

    Folds are by label if there are 16 labels or more, else by blocks of time.

    Args:
        t_seen: times of the frames, (K,) s.
        labels: one per frame, (K,).

    Raises:
        SoftmapError: fewer than 8 frames.
    """
    frames = len(t_seen)
    if frames < LEAST_FRAMES:
        raise SoftmapError(
            f"{frames} seen frames cannot be held out in blocks; record {LEAST_FRAMES} or more, "
            "better 60"
        )
    count = FOLDS if frames >= 2 * FOLDS else max(2, frames // 4)
    found = []
    for train, test in folds(t_seen, count, GAP, labels if labelled(labels) else None, FOLDS):
        # labels that change at every frame leave no frame outside the gap
        if len(train) < frames // 4:
            train = np.setdiff1d(np.arange(frames), test)
        found.append((train, test))
    return found


def without_gap(t_seen: Floats, labels: NDArray[np.generic] | None = None) -> tuple[int, int]:
    """Count the folds of a diagnosis whose blocks are shorter than the gap and therefore have none.

    Args:
        t_seen: times of the frames, shape (K,), s.
        labels: a label for each frame, shape (K,).

    Returns:
        tuple[int, int]: the number of such folds, and of all folds.
    """
    frames = len(t_seen)
    if frames < LEAST_FRAMES:
        return 0, 0
    bare = [len(train) + len(test) == frames for train, test in run_folds(t_seen, labels)]
    return sum(bare), len(bare)


def labelled(labels: NDArray[np.generic] | None) -> bool:
    """Return whether frames have enough labels for a diagnosis to hold out complete labels."""
    if labels is None:
        return False
    count = len(np.unique(labels))
    return LABELS_A_FOLD * FOLDS <= count <= len(labels) / LEAST_LABELLED


@dataclass(frozen=True, eq=False)
class Withheld:
    """Frames that a search uses, and frames of complete blocks withheld from it.

    The remaining frames lie within a gap.
    """

    chosen: Index  # (n,) increasing; includes the first frame of each run
    rows: Index  # (w,) increasing; none within a gap of the chosen frames
    blocks: int  # number of blocks that `rows` come from
    reason: str = ""  # why nothing is withheld


def withheld(t_seen: Floats, labels: NDArray[np.generic] | None, begins: Index) -> Withheld:
    """Withhold every fifth block of a run: blocks of time or of labels, as in `run_folds`.

    Noise is correlated over short times, so the search does not use frames within a gap of a
    withheld block either.

    Args:
        t_seen: times of the frames, (K,) s.
        labels: one per frame, (K,).
        begins: index of the first frame of each run; these frames are kept, because time starts
            there.
    """
    frames = len(t_seen)
    every = np.arange(frames)
    if frames < LEAST_WITHHOLDING:
        return Withheld(
            every,
            every[:0],
            0,
            f"{frames} frames are too few to withhold any; {LEAST_WITHHOLDING} needed",
        )
    if labels is not None and labelled(labels):
        _, first, label = np.unique(labels, return_index=True, return_inverse=True)
        block = np.argsort(np.argsort(first))[label.reshape(-1)]
        # leave enough blocks
        out = np.arange(FIRST, len(first), EVERY)[: len(first) - LABELS_A_FOLD * FOLDS]
    else:
        count = int(float(t_seen[-1] - t_seen[0]) / (EVERY * GAPS_A_BLOCK * GAP))
        count = EVERY * min(max(count, 1), MOST_BLOCKS // EVERY)
        block = np.repeat(np.arange(count), [len(part) for part in np.array_split(every, count)])
        out = np.arange(FIRST, count, EVERY)
    rows = np.flatnonzero(np.isin(block, out) & (_away(t_seen, t_seen[begins]) > GAP))
    if not len(rows):
        return Withheld(every, every[:0], 0, "too few labelled blocks to withhold any")
    chosen = np.setdiff1d(np.flatnonzero(_away(t_seen, t_seen[rows]) > GAP), rows)
    if len(chosen) < frames // 2:
        return Withheld(
            every, every[:0], 0, f"blocks are shorter than the gaps of {GAP:g} s that separate them"
        )
    return Withheld(chosen, rows, len(np.unique(block[rows])))


def _away(t: Floats, others: Floats) -> Floats:
    """Return the distance (n,) s of times `t` (n,) to the nearest of `others`; both increase."""
    after = np.searchsorted(others, t)
    last, next_ = np.maximum(after - 1, 0), np.minimum(after, len(others) - 1)
    return np.asarray(np.minimum(np.abs(t - others[last]), np.abs(t - others[next_])))
