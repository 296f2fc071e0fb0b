"""Label the blocks of a joined run: a new one at each gap or change of orientation or temperature.

A label such as `2:slow` is the number of the run and its own label, if any. `2:slow/3` is the
third part of it, after a gap, a turn or a change of temperature.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from softmap_edge.run.conditions import NEAR, WARMING
from softmap_edge.run.folds import GAP
from softmap_edge.run.run import Run

Floats = NDArray[np.float64]
MANY_STEPS = 10.0  # usual steps between frames: a longer one is a gap


def joined_blocks(runs: Sequence[Run], follows: Sequence[bool]) -> NDArray[np.generic] | None:
    """Return the labels (K,) of joined runs; None if they are one unlabelled recording.

    Args:
        runs: in order.
        follows: whether each run continues the previous one without a gap.
    """
    group = np.cumsum([not one for one in follows])
    if group[-1] == group[0]:
        return _own(runs)
    labels: list[str] = []
    for g in np.unique(group):
        together = [run for run, number in zip(runs, group) if number == g]
        own = _own(together)
        parts = np.concatenate([borders(run) for run in together])
        labels += _named(int(g - group[0] + 1), own, parts)
    return np.array(labels) if labels else None


def borders(run: Run) -> NDArray[np.bool_]:
    """Return the frames (K,) at which a new block begins.

    It begins after a gap, or with another orientation or temperature.
    """
    found = np.zeros(run.frames, bool)
    if run.frames < 2:
        return found
    step = np.diff(run.t_seen)
    found[1:] = step > max(GAP, MANY_STEPS * float(np.median(step)))
    row = np.clip(np.searchsorted(run.t, run.t_seen, side="right") - 1, 0, None)
    if run.gravity is not None and run.gravity.ndim == 2:
        found |= _changes(run.gravity[row], lambda first, rows: rows @ first < NEAR)
    if run.temperature is not None:
        found |= _changes(run.temperature[row], lambda first, rows: np.abs(rows - first) > WARMING)
    return found


def _changes(
    values: Floats, apart: Callable[[Floats, Floats], NDArray[np.bool_]]
) -> NDArray[np.bool_]:
    """Return where values (K, …) differ from those at the last change."""
    found, begin = np.zeros(len(values), bool), 0
    while begin < len(values):
        far = np.flatnonzero(apart(values[begin], values[begin:]))
        if not len(far):
            break
        begin += int(far[0])
        found[begin] = True
    return found


def _own(runs: Sequence[Run]) -> NDArray[np.generic] | None:
    """Return the labels of runs that are one recording; None if no run has labels."""
    if all(run.block is None for run in runs):
        return None
    blocks = [np.full(run.frames, "") if run.block is None else run.block for run in runs]
    same = len({block.dtype.kind for block in blocks}) == 1
    return np.concatenate(blocks if same else [block.astype(str) for block in blocks])


def _named(number: int, own: NDArray[np.generic] | None, parts: NDArray[np.bool_]) -> list[str]:
    """Return the labels of one recording in a joined run."""
    head = (
        [str(number)] * len(parts)
        if own is None
        else [f"{number}:{label}" for label in own.tolist()]
    )
    counts: dict[str, int] = {}
    seen: dict[tuple[str, int], int] = {}
    found = []
    for label, part in zip(head, np.cumsum(parts).tolist()):
        if (label, part) not in seen:
            counts[label] = seen[label, part] = counts.get(label, 0) + 1
        k = seen[label, part]
        found.append(label if k == 1 else f"{label}/{k}")
    return found
