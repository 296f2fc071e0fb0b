"""Make commands constant that hardly change. Pinned by tests/run/test_nothing_there.py."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# smallest change of a command, in any unit: a nanometre in metres, far below any servo's step
_NO_CHANGE = 1e-9


def without_jitter(command: Array) -> Array:
    """Return commands (T, C) in which every channel that hardly changes is constant.

    A change below `_NO_CHANGE` is no motion in any unit; dividing by it overflows.
    """
    if command.ndim != 2 or not command.size:
        return command
    with np.errstate(over="ignore", invalid="ignore"):
        still = np.flatnonzero(np.ptp(command, axis=0) < _NO_CHANGE)
    level = np.where(np.abs(command[0]) < _NO_CHANGE, 0.0, command[0])
    if (command[:, still] == level[still]).all():
        return command
    constant = command.copy()
    constant[:, still] = level[still]
    constant.setflags(write=False)
    return constant
