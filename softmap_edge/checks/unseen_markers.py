"""Report the markers of a run that no frame shows, or that stand at 0, 0, 0 in every frame.

Pinned by tests/logs/test_never_seen.py.
"""

from __future__ import annotations

import numpy as np

from softmap_edge.files.printable import listed
from softmap_edge.logs.never_seen import at_one_number, never_seen
from softmap_edge.run.run import NOT_SEEN, Run, known, text_in

_NAMED = 5  # markers that are named one by one


def unseen_markers(run: Run) -> list[str]:
    """Return the names of the markers that no frame of a run shows, if others are seen."""
    if run.markers is None or run.output is not None or not run.frames:
        return []
    shown = np.atleast_1d(known(run, run.markers).any(axis=0))
    if not shown.any():
        return []
    return [name for name, seen in zip(run.marker_names, shown) if not seen]


def doubts_of_unseen(run: Run) -> list[str]:
    """Return sentences on markers that no frame shows, or at one number in every frame."""
    if run.markers is None or run.output is not None or not run.frames:
        return []
    doubts = []
    if names := unseen_markers(run):
        doubts.append(
            f"{listed(names, _NAMED)}: seen in none of {run.frames} frames; leave "
            f"{'it' if len(names) == 1 else 'them'} out of `markers` in the mapping to learn a "
            "model"
        )
    if text_in(run.extra, NOT_SEEN) != "keep":
        points = np.where(known(run, run.markers)[..., None], run.markers, np.nan)
        doubts += [
            f"{each}: never seen, or the origin of the base frame; leave the marker out, or keep "
            'it with not_seen = "keep"'
            for each in at_one_number(points, never_seen(points).tolist(), run.marker_names)
        ]
    return doubts
