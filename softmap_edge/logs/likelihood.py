"""Use the likelihood of each place, as trackers of pictures write it: x, y, likelihood.

DeepLabCut writes `tip.x, tip.y, tip.likelihood`, SLEAP `tip.score`, OpenPose `Tip_c`. The
likelihood is not a coordinate: a place whose likelihood is below `least_likelihood` was not seen.
These trackers measure in pixels. Pinned by tests/logs/test_likelihood.py.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.files.printable import listed
from softmap_edge.logs.mapping import Quantity
from softmap_edge.logs.table import LogTable

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_WORDS = re.compile(r"likelihood|score|confidence|conf|probability|prob|certainty|c|p", re.I)
_MOST = 1.5  # scores of SLEAP pass 1 a little
_SURE = 0.7  # median of likelihoods that one letter names
_LISTED = 5  # markers that are listed
PIXEL_WORDS = ("px", "pix", "pixel", "pixels")


def likelihood_of(place: Sequence[str], names: Sequence[str]) -> str | None:
    """Return the column with the likelihood of a place; None without one.

    Args:
        place: its columns, x and y first.
        names: all columns of the log.
    """
    x, y = place[:2]
    at = next((k for k, (one, other) in enumerate(zip(x, y)) if one != other), None)
    if at is None or len(x) != len(y) or x[at + 1 :] != y[at + 1 :]:
        return None
    before, after = x[:at], x[at + 1 :]
    for name in names:
        word = name[len(before) : len(name) - len(after)]
        fits = name.startswith(before) and name.endswith(after)
        if fits and (before or after) and _WORDS.fullmatch(word):
            return name
    return None


def is_likelihood(values: Array, letter: bool) -> bool:
    """Return whether numbers (rows,) may be likelihoods: from 0 to about 1, and not all 0.

    Args:
        values: of the column.
        letter: whether one letter names it, as in `Tip_c`: then they must vary, and most must be
            near 1, for `tip_p` may be a pressure as well.
    """
    known = values[np.isfinite(values)]
    if not len(known) or known.min() < 0.0 or known.max() > (1.0 if letter else _MOST):
        return False
    varies = np.ptp(known) > 0.0 and np.median(known) > _SURE
    return bool(known.max() > 0.0 and (varies or not letter))


def unlikely(table: LogTable, quantity: Quantity) -> Mask:
    """Return which places (K, M) have no likelihood, or one below that of the mapping."""
    return np.asarray(~(table.numbers(quantity.likelihood) >= quantity.least_likelihood), np.bool_)


def lines_of(
    name: str, table: LogTable, quantity: Quantity, labels: Sequence[str], gone: Mask
) -> list[str]:
    """Return the sentence that counts the places (K, M) that `unlikely` found; [] without any.

    Raises:
        RunError: no place is likely enough.
    """
    if not gone.any():
        return []
    least = f"{quantity.least_likelihood:g}"
    if gone.all():
        given = table.numbers(quantity.likelihood)
        largest = given[np.isfinite(given)].max(initial=0.0)
        raise RunError(
            f"{table.path}: {name}: no place has a likelihood of {least} or more (the largest is "
            f"{largest:.3g}): set {name}.least_likelihood lower, or check the columns of "
            "`likelihood`"
        )
    counts = sorted(zip(gone.sum(axis=0).tolist(), labels), key=lambda pair: -pair[0])
    each = listed((f"{label} {count}" for count, label in counts if count), _LISTED)
    return [
        f"{name}: {int(gone.sum())} of {gone.size} places with a likelihood below {least} are "
        f"taken as not seen: {each}; {name}.least_likelihood sets the limit"
    ]
