"""Report topics and logs that begin late, stop early or pause, where others go on.

A reading is interpolated to the times of the commands, and held before its first and after its last
value. That is right between two readings; in a pause many times longer the values are made up.
Pinned by tests/logs/test_late_topics.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import differing_times

Array = NDArray[np.float64]
_LONGEST = 3.0  # times the 95th percentile of the steps: a longer one is a pause


def pauses(t: Array, begin: float, end: float) -> list[tuple[float, float]]:
    """Return the times (s) from `begin` to `end` in which a regular series has no value.

    Args:
        t: times of the values, (n,) s, rising.
        begin: s.
        end: s.
    """
    steps = np.diff(t)
    if len(steps) < 2:
        return []
    longest = _LONGEST * float(np.quantile(steps, 0.95))
    usual = _LONGEST * float(np.median(steps))
    edges = np.r_[min(begin, t[0]), t, max(end, t[-1])]
    # many pauses raise the percentile; then the series is irregular, and only longer ones count
    long = np.flatnonzero(np.diff(edges) > max(longest, usual))
    return [(float(edges[k]), float(edges[k + 1])) for k in long]


def doubts_of_pauses(name: str, t: Array, own: Array) -> list[str]:
    """Report rows whose values of a quantity are made up because it was not recorded there.

    Args:
        name: of the quantity.
        t: times of the rows, (T,) s.
        own: times of its values, (n,) s, rising.
    """
    if not len(t) or not len(own):
        return []
    found = pauses(own, float(t[0]), float(t[-1]))
    made_up = sum(
        int(
            (
                (t > (low if low >= own[0] else -np.inf))
                & (t < (high if high <= own[-1] else np.inf))
            ).sum()
        )
        for low, high in found
    )
    if not made_up:
        return []
    low, high = max(found, key=lambda span: span[1] - span[0])
    when = " to ".join(differing_times(low, high))
    if low < own[0]:
        how = "begins late, and its first value is held before"
    elif high > own[-1]:
        how = "stops early, and its last value is held after"
    else:
        how = "pauses, and is interpolated linearly there"
    return [
        f"{name}: {how}: {made_up} of {len(t)} rows have made-up values, most from {when} s: leave "
        f"{name} out, or cut the commands there with from_row and to_row"
    ]


def unseen_spans(t_seen: Array, begin: float, end: float) -> list[str]:
    """Return the note that what is seen begins after the commands, or stops before them.

    Args:
        t_seen: times of the frames, (K,) s, rising.
        begin: first time that is commanded and asked for, s.
        end: last such time, s.
    """
    found = [
        span for span in pauses(t_seen, begin, end) if span[0] < t_seen[0] or span[1] > t_seen[-1]
    ]
    if not found:
        return []
    spans = " and from ".join(" to ".join(differing_times(*span)) for span in found)
    return [f"commands without frames, from {spans} s: nothing is seen there"]
