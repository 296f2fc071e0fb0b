"""Report what a run did not see: markers, outputs, or all points over a large part of it.

Nothing about such a part can be checked, so `softmap check` does not call the run sound. Pinned by
tests/checks/test_unseen_parts.py and tests/logs/test_never_seen.py.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from softmap_edge.files.printable import listed
from softmap_edge.logs.chance import is_improbable
from softmap_edge.logs.never_seen import at_one_number, never_seen
from softmap_edge.noise.floor import commanded
from softmap_edge.run.run import NOT_SEEN, Run, known, text_in
from softmap_edge.run.stretches import stretches_of

Mask = NDArray[np.bool_]
Places = NDArray[np.float64]

_NAMED = 5  # markers that are named one by one
ENOUGH = 20  # frames of a run; with fewer, no share is computed
# a marker seen in fewer frames, or in a smaller share of them, is almost never seen
FEW, RARE = 5, 0.05
PART = 0.4  # of a recording: a stretch this long without a marker is a missing part
MOVED = 0.05  # of the range of a command: while it moves less, no frame is missed
FAR = 2.0  # of the extent of the points: if all are farther from the origin, this is no base frame


def unseen_markers(run: Run) -> list[str]:
    """Return the names of the markers that no frame of a run shows, if others are seen."""
    if run.markers is None or run.output is not None or not run.frames:
        return []
    shown = np.atleast_1d(known(run, run.markers).any(axis=0))
    if not shown.any():
        return []
    return [name for name, seen in zip(run.marker_names, shown) if not seen]


def unseen_parts(run: Run) -> list[str]:
    """Return a sentence for each part of a run about which nothing can be checked.

    These are markers and outputs never or almost never seen, or at one place to the last digit in
    every frame, and large parts of the recording without a marker or without any point.
    """
    seen = _seen(run)
    if seen is None or not run.frames:
        return []
    if not seen.any():
        what = "point" if run.output is None else "output"
        return [
            f"no {what} is seen in any of {run.frames} frames: nothing about this run can be "
            "checked"
        ]
    found = list(_unwatched(run, np.asarray(seen.any(axis=1))))
    if run.markers is None:
        return found
    names, labels = run.marker_names, "outputs" if run.output is not None else "markers"
    count = seen.sum(axis=0)
    none = count == 0
    if none.any():
        found.append(
            f"{listed(_those(names, none), _NAMED)}: seen in none of {run.frames} frames, so "
            f"nothing about {_it(none)} can be checked; leave {_it(none)} out of `{labels}` in the "
            "mapping to learn a model"
        )
    rare = ~none & (count < max(FEW, RARE * run.frames)) & (run.frames >= ENOUGH)
    for n in np.unique(count[rare]):
        one = rare & (count == n)
        found.append(
            f"{listed(_those(names, one), _NAMED)}: seen in {n} of {run.frames} frames only, too "
            f"few to check {_it(one)}; leave {_it(one)} out of `{labels}` in the mapping, or "
            "record again"
        )
    return [*found, *_stretches(run, seen & ~rare & ~none, names), *_frozen(run, seen & ~rare)]


def _seen(run: Run) -> Mask | None:
    """Return which points (K, N) of a run are seen; of clouds, whether there are any (K, 1)."""
    if run.places is not None:
        return known(run, run.places)
    if run.start is not None and run.points is not None:
        return np.asarray(np.diff(run.start) > 0, np.bool_)[:, None]
    return None


def _those(names: list[str], chosen: Mask) -> Iterable[str]:
    return (name for name, one in zip(names, chosen) if one)


def _it(chosen: Mask) -> str:
    return "it" if chosen.sum() == 1 else "them"


def _longest(unseen: Mask) -> tuple[int, int]:
    """Return the longest stretch of true values: its first index, and the one after it."""
    return max(stretches_of(unseen), key=lambda pair: pair[1] - pair[0], default=(0, 0))


def _stretches(run: Run, seen: Mask, names: list[str]) -> Iterator[str]:
    """Yield a sentence for each large part of the frames in which some markers are not seen."""
    if run.frames < ENOUGH:
        return
    watched = seen.any(axis=1)  # frames that show nothing are reported as such
    parts: dict[tuple[int, int], list[str]] = {}
    for m in np.flatnonzero(seen.any(axis=0)):
        first, end = _longest(~seen[watched, m])
        if end - first >= PART * watched.sum():
            parts.setdefault((first, end), []).append(names[m])
    frames = np.flatnonzero(watched)
    for (first, end), missing in parts.items():
        a, b = int(frames[first]), int(frames[end - 1])
        when = "" if run.timeless else f" ({run.t_seen[a]:.6g} to {run.t_seen[b]:.6g} s)"
        yield (
            f"{listed(missing, _NAMED)}: not seen in frames {a} to {b}{when}, "
            f"{100 * (end - first) / len(frames):.0f} % of the recording; nothing about "
            f"{'it' if len(missing) == 1 else 'them'} can be checked there: cut the run, or record "
            "again"
        )


def _unwatched(run: Run, watched: Mask) -> Iterator[str]:
    """Yield a sentence if no point is seen over a large part of the time of moving commands."""
    u, shown = commanded(run), run.t_seen[watched]
    start, end = min(run.t[0], run.t_seen[0]), max(run.t[-1], run.t_seen[-1])
    if run.frames < ENOUGH or not end > start:
        return
    edges = np.r_[start, shown, end]
    k = int(np.argmax(np.diff(edges)))
    a, b = float(edges[k]), float(edges[k + 1])
    rows = u[(run.t > a) & (run.t < b)]
    span = np.ptp(u, axis=0) if u.size else np.zeros(0)
    moves = rows.size > 0 and bool((np.ptp(rows, axis=0) > MOVED * np.maximum(span, 1e-12)).any())
    hidden = int((~watched & (run.t_seen >= a) & (run.t_seen <= b)).sum())
    if b - a < PART * (end - start) or not (moves or hidden):
        return
    what = f"{hidden} frames show no point" if hidden else "there is no frame"
    when = "" if run.timeless else f" from {a:.6g} to {b:.6g} s"
    yield (
        f"{what}{when}, {100 * (b - a) / (end - start):.0f} % of the recording, and "
        "nothing about what the robot did there can be checked: cut the run, or record again"
    )


def _frozen(run: Run, seen: Mask) -> Iterator[str]:
    """Yield sentences on markers and outputs that never change although they should."""
    assert run.markers is not None
    if text_in(run.extra, NOT_SEEN) == "keep":
        return
    points = np.where(seen[..., None], run.markers, np.nan)
    zero = never_seen(points).tolist() if run.output is None else []
    yield from (
        f"{each}: never seen, or the origin of the base frame, so nothing about it can be checked; "
        'leave the marker out, or keep it with not_seen = "keep"'
        for each in at_one_number(points, zero, run.marker_names)
    )
    still = _still(points)
    still[zero] = False
    stuck = np.array(
        [bool(still[m]) and _should_change(run, points, still, m) for m in range(len(still))], bool
    )
    if stuck.any():
        yield (
            f"{listed(_those(run.marker_names, stuck), _NAMED)}: the same to the last digit in all "
            f"{run.frames} frames while others change, so nothing about {_it(stuck)} can be "
            f"checked; leave {_it(stuck)} out, or keep {_it(stuck)} with "
            'not_seen = "keep" in the mapping'
        )


def _still(points: Places) -> Mask:
    """Return which markers have one place in all of their frames."""
    found = np.zeros(points.shape[1], bool)
    for m in range(points.shape[1]):
        places = points[np.isfinite(points[:, m]).all(axis=1), m]
        found[m] = len(places) >= ENOUGH and bool((places == places[0]).all())
    return found


def _should_change(run: Run, points: Places, still: Mask, m: int) -> bool:
    """Return whether marker `m`, which never changes, would change if it were measured.

    A marker of the clamp may stand still in a recording without noise. It changes if another one
    has noise, or if one that is nearer to the base moves. An output changes if others do.
    """
    moving = np.flatnonzero(~still & np.isfinite(points).any(axis=(0, 2)))
    if run.output is not None:
        return len(moving) > 0
    if any(is_improbable(points[:, n]) for n in moving):
        return True
    away = np.linalg.norm(np.nanmedian(points, axis=0), axis=1)
    extent = float(np.nanmax(np.ptp(np.nanmedian(points, axis=0), axis=0)))
    return bool(np.nanmin(away) <= FAR * extent and (away[moving] < away[m]).any())
