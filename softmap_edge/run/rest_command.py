"""The command at which a robot rests: 0, or a place within a range far from 0.

Such a range occurs with servo ticks that are not counted from home.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

_STAYS = 10  # rows
_NEAR = 0.02  # of the range: two commands that differ by less are one place
FAR = 0.5  # of its range: a command that stays farther from 0 is not counted from home


def home_command(reach: ArrayLike) -> NDArray[np.float64]:
    """Return the command (C,) at rest.

    Args:
        reach: least and largest command of each channel, shape (C, 2).

    Returns:
        The command: 0 if the range holds it, the nearest end of a range that begins slightly
        beyond 0, or the middle of a range far from 0.
    """
    low, high = np.asarray(reach, float).reshape(-1, 2).T
    near = np.clip(0.0, np.minimum(low, high), np.maximum(low, high))
    return np.asarray(np.where(far_from_home(reach), 0.5 * (low + high), near))


def far_from_home(reach: ArrayLike) -> NDArray[np.bool_]:
    """Return which channels (C,) have a range (C, 2) far from 0, so are not counted from home."""
    low, high = np.asarray(reach, float).reshape(-1, 2).T
    return np.asarray((np.maximum(low, -high) > FAR * (high - low)) & (high > low))


def rest_command(rows: ArrayLike) -> NDArray[np.float64]:
    """Return the command (C,) at which a robot probably rests, from finite commands (T, C).

    It is that of `home_command`. For channels with a range far from 0 it is the first command, if
    the run stays or ends there.
    """
    rows = np.asarray(rows, float)
    reach = np.stack([rows.min(axis=0), rows.max(axis=0)], axis=1)
    home, near = home_command(reach), _NEAR * np.ptp(reach, axis=1)
    stays = (np.abs(rows[:_STAYS] - rows[0]) <= near).all() or (
        np.abs(rows[-1] - rows[0]) <= near
    ).all()
    return np.asarray(np.where(far_from_home(reach), rows[0], home)) if stays else home
