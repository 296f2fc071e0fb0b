"""Cut a piece out of a run: a time span or a block, with its recording's hash and times.

A piece keeps the frames of its span. It also keeps the rows from the last one before them (whose
command still holds) to the first one after them (commands are linear between rows). Prediction
starts in equilibrium at the first row, so the memory of earlier commands is lost. `lead_s` keeps
the rows of that many seconds before the first frame. Pinned by tests/run/test_run_parts.py.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError, no_name
from softmap_edge.run import pieces as run_pieces
from softmap_edge.run.fields import cut_rows
from softmap_edge.run.join import join_runs
from softmap_edge.run.run import OURS, Run
from softmap_edge.run.stretches import stretches_of

MOST_NAMED = 20  # blocks that an error lists


def cut(
    run: Run,
    start: float | None = None,
    end: float | None = None,
    *,
    block: str | int | None = None,
    lead_s: float = 0.0,
) -> Run:
    """Return a piece of a run.

    Args:
        run: with T rows and K frames.
        start, end: s; frames with start <= time < end. None: the beginning or end of the run.
        block: a label, in place of times. If its frames are in several places of the run, these are
            joined.
        lead_s: s of commands kept before the first frame, to preserve memory.

    Raises:
        RunError: the piece is empty, there is no such block, or `start` is not before `end`.
    """
    if not lead_s >= 0.0:
        raise RunError(f"lead_s: {lead_s:g} s, expected 0 or more")
    if block is None:
        return _span(
            run, -np.inf if start is None else start, np.inf if end is None else end, lead_s
        )
    if start is not None or end is not None:
        raise RunError("cut: give a block or a time, not both; a piece of a piece takes two cuts")
    found = [_part(run, frames, lead_s) for frames in _places(run, str(block))]
    return found[0] if len(found) == 1 else join_runs(found)


def _span(run: Run, start: float, end: float, lead_s: float) -> Run:
    """Return the piece of a time span."""
    if start > run.t[-1] and end > start:
        raise RunError(
            f"cut: the run ends at {run.t[-1]:g} s, before --from {start:g}; give a begin within "
            "the run"
        )
    span = (
        f"from {run.t[0] if start == -np.inf else start:g} to "
        f"{run.t[-1] if end == np.inf else end:g} s"
    )
    lasts = f"the run lasts from {run.t[0]:g} to {run.t[-1]:g} s"
    if not start < end:
        raise RunError(f"cut: {span} ends before it begins; {lasts}")
    frames = slice(int(np.searchsorted(run.t_seen, start)), int(np.searchsorted(run.t_seen, end)))
    if frames.start < frames.stop:
        return _part(run, frames, lead_s, start, end)
    if run.frames or not np.any((run.t >= start) & (run.t < end)):
        what = "frame is seen" if run.frames else "row lies"
        raise RunError(f"cut: no {what} {span}; {lasts}")
    return _part(run, frames, lead_s, start, end)


def _places(run: Run, label: str) -> list[slice]:
    """Return the stretches of frames that have this label."""
    if run.block is None:
        raise RunError(
            "cut: the run has no blocks; cut it by time (--from, --to), or declare `block` where "
            "it is imported"
        )
    labels = np.array([str(one) for one in run.block.tolist()])
    found = stretches_of(labels == label)
    if not found:
        raise RunError(no_name("block", label, list(dict.fromkeys(labels.tolist())), MOST_NAMED))
    return [slice(first, end) for first, end in found]


def _part(
    run: Run, frames: slice, lead_s: float, start: float = np.inf, end: float = -np.inf
) -> Run:
    """Return some frames of a run, with their rows and those from `start` to `end`."""
    t, seen = run.t, run.t_seen[frames]
    begins = min(start, float(seen[0]) if len(seen) else np.inf)
    ends = float(seen[-1]) if len(seen) else -np.inf
    first = max(int(np.searchsorted(t, begins - lead_s, side="right")) - 1, 0)
    last = max(int(np.searchsorted(t, end)), int(np.searchsorted(t, ends)) + 1)
    rows = slice(first, min(last, len(t)))
    chosen = np.zeros(run.frames, bool)
    chosen[frames] = True
    part = run.at(chosen)
    extra = dict(part.extra)
    extra |= {name: array[kept] for name, array, kept in _along(run, rows, frames)}
    extra |= run_pieces.fields(run_pieces.within(run_pieces.pieces(run), rows, frames))
    return dataclasses.replace(part, **cut_rows(run, rows), extra=extra)


def _along(run: Run, rows: slice, frames: slice) -> list[tuple[str, NDArray[np.generic], slice]]:
    """Return unknown fields with an entry per row or per frame, and the part of each to keep."""
    unknown = [
        (name, array) for name, array in run.extra.items() if name not in OURS and array.ndim
    ]
    by_row = [(name, array, rows) for name, array in unknown if len(array) == len(run.t)]
    return by_row + [
        (name, array, frames)
        for name, array in unknown
        if len(array) == run.frames and len(array) != len(run.t)
    ]
