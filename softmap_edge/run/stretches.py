"""Find stretches of consecutive frames or rows that share a property."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def stretches_of(chosen: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return each stretch of true values (K,): its first index, and the one after it."""
    edges = np.flatnonzero(np.diff(np.r_[False, chosen, False].astype(int)))
    return [(int(first), int(end)) for first, end in edges.reshape(-1, 2)]
