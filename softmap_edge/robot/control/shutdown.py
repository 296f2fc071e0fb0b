"""What a controller tells of a command and of servos that keep torque, and what a forked child lets go of.

Pinned by tests/robot/test_nobody_watches.py.
"""

from __future__ import annotations

import os
import weakref
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


class Running(Protocol):
    """What holds the pipe of a running loop."""

    def _let_go(self) -> None: ...


running: weakref.WeakSet[Running] = weakref.WeakSet()


def numbers(command: ArrayLike) -> Floats | None:
    """Return a command as an array of real numbers, None if it is none."""
    try:
        found = np.asarray(command)
        return None if np.iscomplexobj(found) else found.astype(float)
    except (TypeError, ValueError):
        return None


def kept_words(ids: Sequence[int]) -> str:
    """Return what is to be said of servos that have not confirmed that their torque is off."""
    which, several = ", ".join(map(str, ids)), len(ids) > 1
    who, its, it = ("servos", "their", "they answer") if several else ("servo", "its", "it answers")
    return f"{who} {which} did not confirm that {its} torque is off; cut {its} supply, or `softmap servo off` once {it}"


def _forked() -> None:
    for robot in running:
        robot._let_go()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forked)
