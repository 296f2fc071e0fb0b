"""Find markers that swap labels between two consecutive frames.

Between frames a marker moves little compared with its distance to the others. If each of some
markers is nearest to the last position of another of them, the labels were swapped. Dropouts of up
to half a second are bridged. The labels of most frames are taken as right, because a tracker may
have started with swapped ones. Known limits: swaps while one of the markers is not seen, and
motion between frames of more than 0.3 of the distance between two markers, are not examined. Pinned
by tests/logs/test_import_markers.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
BRIDGED = 0.5  # s, longest dropout of a marker after which its last position is used
_CLEAR = (
    # of the distance between two markers: largest motion at which they can be distinguished
    0.3
)
_CHUNK = 2**19  # distances in memory at a time


@dataclass(frozen=True)
class Swap:
    """A swap: from `frame` on, the markers `after` show what the markers `before` showed."""

    frame: int
    t: float | None  # s; None in a log without time
    after: tuple[int, ...]
    before: tuple[int, ...]
    labels: tuple[str, ...]

    def __str__(self) -> str:
        names = [self.labels[m] for m in self.after]
        when = "" if self.t is None else f" ({self.t:.6g} s)"
        return f"{', '.join(names[:-1])} and {names[-1]} change places at frame {self.frame}{when}"


def find_swaps(points: Array, t: Array, labels: tuple[str, ...]) -> list[Swap]:
    """Find where markers swap labels.

    Args:
        points: (K, M, 3), NaN where a marker was not seen.
        t: (K,) s.
        labels: the M names.
    """
    frames, count = points.shape[:2]
    if count < 2 or frames < 2:
        return []
    last = _last_seen(points, t)  # (K, M, 3): last position of each marker before this frame
    step = max(1, _CHUNK // count**2)
    found: list[Swap] = []
    for start in range(0, frames, step):
        here, old = points[start : start + step], last[start : start + step]
        distance = np.linalg.norm(here[:, :, None] - old[:, None], axis=-1)  # (k, M now, M before)
        distance[np.isnan(distance)] = np.inf
        nearest = distance.argmin(axis=2)
        other = (nearest != np.arange(count)) & np.isfinite(distance.min(axis=2))
        for k in np.flatnonzero(other.sum(axis=1) >= 2):
            after = tuple(int(m) for m in np.flatnonzero(other[k]))
            before = tuple(int(m) for m in nearest[k, list(after)])
            apart = np.linalg.norm(old[k, list(before)] - old[k, list(after)], axis=-1)
            moved = distance[k, list(after), list(before)]
            if set(before) == set(after) and (moved <= _CLEAR * apart).all():
                found.append(Swap(start + int(k), float(t[start + k]), after, before, labels))
    return found


def mend_swaps(points: Array, swaps: list[Swap]) -> tuple[Array, bool]:
    """Reverse every swap, so that each label shows its marker of most frames.

    Args:
        points: (K, M, 3).
        swaps: in frame order.

    Returns:
        The points (K, M, 3), and whether the labels of the first frame are those of most frames.
    """
    shown = np.arange(points.shape[1])  # marker of the first frame that each label shows
    stretches = [(0, shown)]
    for swap in swaps:
        turned = shown.copy()
        turned[list(swap.after)] = shown[list(swap.before)]
        shown = turned
        stretches.append((swap.frame, shown))
    ends = [*(start for start, _ in stretches[1:]), len(points)]
    frames: dict[tuple[int, ...], int] = {}
    for (start, shown), end in zip(stretches, ends):
        frames[tuple(shown.tolist())] = frames.get(tuple(shown.tolist()), 0) + end - start
    usual = np.array(max(frames, key=lambda names: frames[names]))  # the first of equals
    label = np.argsort(usual)  # label of each marker
    mended = points.copy()
    for (start, shown), end in zip(stretches, ends):
        mended[start:end, label[shown]] = points[start:end]
    return mended, bool((usual == np.arange(len(usual))).all())


def _last_seen(points: Array, t: Array) -> Array:
    """Return the last position of each marker before each frame; NaN if too long ago."""
    seen = np.isfinite(points).all(axis=2)
    row = np.where(seen, np.arange(len(points))[:, None], -1)
    row = np.vstack([np.full((1, points.shape[1]), -1), np.maximum.accumulate(row, axis=0)[:-1]])
    last = np.take_along_axis(points, np.maximum(row, 0)[..., None], axis=0)
    usual = float(np.median(np.diff(t)))
    old = t[:, None] - t[np.maximum(row, 0)] > max(BRIDGED, 1.5 * usual)
    last[(row < 0) | old] = np.nan
    return last
