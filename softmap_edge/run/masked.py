"""Keep the numbers behind the mask of a numpy masked array out of every result.

`np.asarray` drops the mask, so that a filler such as 99999 would count as a value. Pinned by
tests/run/test_masked.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def unmasked(values: ArrayLike) -> NDArray[np.float64]:
    """Return real numbers, NaN where a numpy masked array masks one."""
    if isinstance(values, np.ma.MaskedArray):
        return np.where(np.ma.getmaskarray(values), np.nan, np.ma.getdata(values)).astype(float)
    return np.asarray(values, np.float64)


def mask_of(values: object) -> NDArray[np.bool_] | None:
    """Return which values a numpy masked array masks; None if there is none."""
    if not isinstance(values, np.ma.MaskedArray):
        return None
    mask = np.asarray(np.ma.getmaskarray(values), np.bool_)
    return mask if mask.any() else None
