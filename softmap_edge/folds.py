"""Folds of cross-validation: which frames are held out together, and which are then fitted.

Frames near each other are alike, so folds are blocks of time, with a gap beside each that trains nothing. But moves of
one kind are often recorded one after the other, and a block of time then holds all of them: what was never seen cannot
be learned (on a real nine-tendon robot a polynomial looked ten times worse than it is). So where a run labels its
frames (`block`) and has labels enough, whole labels are dealt out to the folds in turn, in the order they appear in.
Units: s. Pinned by tests/test_fit.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import SoftmapError

Floats = NDArray[np.float64]
Index = NDArray[np.int64]

FOLDS, GAP = 8, 1.0  # parts of a run, and the seconds left out beside what is held out
LEAST_FRAMES = 8
LABELS_A_FOLD = 2  # fewer, and a fold would hold out one kind of motion and nothing else


def run_folds(t_seen: Floats, labels: NDArray[Any] | None = None) -> list[tuple[Index, Index]]:
    """Return (train, test) frame indices: by label where there are 16 or more, else by blocks of time.

    Args:
        t_seen: (K,) s. labels: (K,), one for each frame.

    Raises:
        SoftmapError: fewer than 8 frames.
    """
    frames = len(t_seen)
    if frames < LEAST_FRAMES:
        raise SoftmapError(f"{frames} seen frames cannot be held out in blocks; record at least 8, better 60")
    if labelled(labels):
        fold = dealt(labels, FOLDS)
    else:
        count = FOLDS if frames >= 2 * FOLDS else max(2, frames // 4)
        fold = np.repeat(np.arange(count), [len(part) for part in np.array_split(t_seen, count)])
    found = []
    for test, train in apart(t_seen, fold, GAP):
        if len(train) < frames // 4:  # labels that change with every frame leave nothing a second away
            train = np.setdiff1d(np.arange(frames), test)
        found.append((train, test))
    return found


def labelled(labels: NDArray[Any] | None) -> bool:
    """Whether frames have labels enough to be held out by them."""
    return labels is not None and len(np.unique(labels)) >= LABELS_A_FOLD * FOLDS


def dealt(labels: NDArray[Any] | None, most: int) -> Index:
    """Return the fold (n,) of each frame: whole labels, dealt out in turn to at most `most` folds."""
    _, first, label = np.unique(np.asarray(labels), return_index=True, return_inverse=True)
    order = np.argsort(np.argsort(first))  # labels in the order in which they appear
    return np.asarray(order[label.reshape(-1)] % max(1, min(most, len(first))), np.int64)


def apart(t: Floats, fold: Index, gap_s: float) -> list[tuple[Index, Index]]:
    """Return (test, train) for each fold: frames of it, and frames over `gap_s` s away from all of them.

    Args:
        t: (n,) s, increasing. fold: (n,) number of the fold of each frame.
    """
    parts = []
    for k in range(int(fold.max(initial=-1)) + 1):
        test = np.flatnonzero(fold == k)
        after = np.searchsorted(t[test], t)
        last, next_ = np.maximum(after - 1, 0), np.minimum(after, len(test) - 1)
        away = np.minimum(np.abs(t - t[test[last]]), np.abs(t - t[test[next_]]))
        parts.append((test, np.flatnonzero((fold != k) & (away > gap_s))))
    return parts
