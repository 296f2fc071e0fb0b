"""Find points that stand for "not seen" in run files of older versions or other programs.

`softmap import` hides such points and writes the field `NOT_SEEN`, so the search is not repeated.
Any other run is searched in the same way (`logs/not_seen.py`, `logs/shifted.py`). Pinned by
tests/logs/test_not_seen.py.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.logs.not_seen import not_seen
from softmap_edge.logs.shifted import find_shifted
from softmap_edge.noise.floor import commanded
from softmap_edge.run.run import NOT_SEEN, Run, known, text_in

Mask = NDArray[np.bool_]

WORDS = ("checked", "keep")
REMEDY = "correct the log or `visible`, or import the log again"
KEEP = f'a field `{NOT_SEEN}` with the text "keep" keeps them'


def lost_points(run: Run, remedy: str = REMEDY) -> tuple[Mask, list[str]]:
    """Find the points of a run that stand for "not seen".

    Args:
        run: a run of vertices, markers or outputs; point clouds are not searched.
        remedy: the last part of each sentence.

    Returns:
        tuple: which points (K, N), and a sentence for each place that stands for "not seen".
    """
    points = run.places
    if points is None or not points.size or _looked_for(run):
        return np.zeros((len(run.t_seen), 0 if points is None else points.shape[1]), bool), []
    names = (
        run.marker_names
        if run.markers is not None
        else [f"vertex {n}" for n in range(points.shape[1])]
    )
    visible = known(run, points)
    raw = np.where(
        visible[..., None], points if run.output is None else run.outputs[..., None], np.nan
    )
    rows = commanded(run)
    u = (
        np.stack([np.interp(run.t_seen, run.t, c) for c in rows.T], axis=1)
        if rows.shape[1]
        else None
    )
    lost = not_seen(raw, u)
    mask, lines = lost.mask, lost.lines(names, remedy)
    raw[mask] = np.nan
    shifted = find_shifted(raw) if raw.shape[2] > 1 else None
    if shifted is not None:
        mask, lines = mask | shifted.wrong, [*lines, *shifted.lines(names, remedy)]
    return mask, lines


def _looked_for(run: Run) -> bool:
    """Return whether an import has searched for such points, or the user keeps them.

    An array under the name of this field does not count.
    """
    return text_in(run.extra, NOT_SEEN) in WORDS


def without_lost(run: Run, remedy: str = KEEP) -> tuple[Run, list[str]]:
    """Return a run with these points hidden, and the sentences; the same run if there are none."""
    mask, lines = lost_points(run, remedy)
    if not mask.any():
        return run, []
    points = run.places
    assert points is not None
    return replace(run, visible=known(run, points) & ~mask), lines
