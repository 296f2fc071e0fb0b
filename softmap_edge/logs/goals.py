"""Recognise column triples with a desired or computed position, which was not measured.

A name such as `target` or `des` marks a desired position. A name such as `sim` or `est` marks a
computed one, but logs also use it for measurements. Then values decide: a computed triple follows
a marker of the log, near it and with its motion. Pinned by tests/logs/test_goals.py.
"""

from __future__ import annotations

import re
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from softmap_edge.logs.flags import words_of

Array = NDArray[np.float64]

_DEVICE = re.compile(r"joint_?stat|servo|motor|enc(?!e)|present|tendon", re.IGNORECASE)
_GOAL = re.compile(r"cmd|command|goal|desired|target|refer|_ref|set_?p", re.IGNORECASE)
_GOAL_WORDS = {"des", "dsr", "setp"}
_COMPUTED = re.compile(
    r"(plan|nominal|ideal|traj|waypoint|predict|model|expect|theor|calc|comput|estim|simul|filter"
    r"|smooth|refer).*"
    r"|ref|sp|wp|nom|sim|pred|mod|est|hat|fk|filt"
)
_SUFFIX = "d"  # of control theory: x and xd
_LEAST = 10  # rows needed to decide
_APART = 0.7  # of a marker's motion: a triple that deviates more does not follow it


def is_drive(stem: str) -> bool:
    """Return whether the shared part of a triple's names marks a goal or a drive.

    Such a triple is not a measured position.
    """
    return _DEVICE.search(stem) is not None or is_goal(stem)


def is_goal(stem: str) -> bool:
    """Return whether the shared part of a triple's names marks a desired position, not a device."""
    marked = _GOAL.search(stem) is not None or bool(_GOAL_WORDS & set(words_of(stem)))
    return marked and _DEVICE.search(stem) is None


def is_computed(stem: str, others: Collection[str]) -> bool:
    """Return whether a shared name part may mark a computed position: `ref`, `tip_est`, `xd`.

    The position may also be a desired one.

    Args:
        stem: the shared part of the triple's names.
        others: the shared parts of the other triples' names.
    """
    words = words_of(stem)
    rest = [word for word in words if word != _SUFFIX]
    if len(rest) < len(words) and any(words_of(other) == rest for other in others):
        return True
    return any(_COMPUTED.fullmatch(word) for word in words)


def follows(points: Array, place: Array) -> bool:
    """Return whether points (rows, 3) stay near a position (rows, 3) and move with it.

    Their unit may be m where that of `place` is mm.

    Args:
        points: the desired or computed positions.
        place: a marker.
    """
    both = np.isfinite(points).all(axis=1) & np.isfinite(place).all(axis=1)
    points, place = points[both], place[both]
    if len(points) < _LEAST:
        return False
    extent = float(
        np.linalg.norm(np.quantile(place, 0.95, axis=0) - np.quantile(place, 0.05, axis=0))
    )
    moves = float(np.linalg.norm(place.std(axis=0)))
    gaps = [points * scale - place for scale in (1.0, 1e-3, 1e3)]
    return extent > 0 and any(
        np.median(np.linalg.norm(gap, axis=1)) < extent
        and np.linalg.norm(gap.std(axis=0)) < _APART * moves
        for gap in gaps
    )
