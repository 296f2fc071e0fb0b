"""Set summary rows aside: lines of a table that hold the mean, the spread or the sum of its rows.

A line is one if its label (`Mean`, `SD`, `Max`) stands in a column that holds values in the other
lines. A block of lines at the start or the end without a label is one if it holds the mean of all
other rows, in every column, to the digits of the file; the lines next to it may then hold other
statistics. A row that occurs again is kept: it may be where the robot rests. Pinned by
tests/logs/test_summaries.py.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from softmap_edge.logs.readers.cells import is_value, split

Array = NDArray[np.float64]

LABEL = re.compile(
    r"(arithmetic |sample |pop(ulation)? )?"
    r"(mean|avg|average|median|std|sd|s\.d\.|std\.? ?(dev|deviation)?|stdev|stddev"
    r"|standard deviation|variance|var|sem|rms|min|minimum|max|maximum|range|sum|total|count|n"
    r"|mittel|mittelwert|mw|standardabweichung|summe|gesamt|anzahl|moyenne|[eé]cart[- ]type|somme)"
    r"( value)?[.:]?",
    re.IGNORECASE,
)
_WORD = re.compile(rf"(?<![^\W\d_])({LABEL.pattern})(?![^\W\d_])", re.IGNORECASE)
_PART = re.compile(r"\d{1,2}([.,]\d+)? ?%")  # a quantile, next to a line with a label
_MANY, _SAMPLE = 64, 20  # lines of a block with letters, and lines that show what a column holds
_BLOCK = 8  # rows at the start or the end that may be summaries
_LEAST = 10  # other rows
_DIGITS = 9  # decimals of a file at most
_CHANCE = 1e-4  # that a row equals the mean of the others by accident


def labelled(cells: Sequence[str], others: Sequence[Sequence[str]]) -> bool:
    """Return whether a line is a summary: its label stands in a column that holds values.

    Args:
        cells: of the line.
        others: cells of other lines of the table.
    """
    for place, cell in enumerate(cells):
        if LABEL.fullmatch(cell):
            column = [row[place] for row in others if place < len(row) and row[place]]
            values = sum(map(is_value, column))
            rest = [one for k, one in enumerate(cells) if one and k != place]
            numbers = sum(map(is_value, rest))
            return values > 0.5 * len(column) and bool(rest) and 2 * numbers > len(rest)
    return False


def labelled_lines(block: Sequence[str], mark: str) -> list[int]:
    """Return which lines of a block have the label of a summary.

    Where most lines have letters, only those at both ends of the block are looked at.

    Args:
        block: lines that are not blank.
        mark: the separator of cells.
    """
    some = [k for k, line in enumerate(block) if line.upper() != line.lower()]
    if len(some) > _MANY:
        some = [k for k in some if k < _BLOCK or k >= len(block) - _BLOCK]
    if not (some := [k for k in some if _WORD.search(block[k])]):
        return []
    ends = [*block[:_SAMPLE], *block[_SAMPLE:][-_SAMPLE:]]
    others = [split(line, mark) for line in ends]
    found = [k for k in some if labelled(split(block[k], mark), others)]
    return sorted({*found, *_quantiles(block, mark, found)})


def _quantiles(block: Sequence[str], mark: str, found: Sequence[int]) -> Iterator[int]:
    """Yield the lines labelled 25%, 50%, … below a line of `found`, as pandas describes a table."""
    for k in found:
        while (k := k + 1) < len(block) and _PART.fullmatch(split(block[k], mark)[0]):
            yield k


def summaries(numbers: Array) -> NDArray[np.intp]:
    """Return the rows at the start and the end that summarise the others, in order.

    Args:
        numbers: (rows, columns); NaN where missing.
    """
    found: list[int] = []
    if not _near_mean(numbers):
        return np.array(found, np.intp)
    for size in range(min(_BLOCK, len(numbers) - _LEAST), 0, -1):
        if not found and _summarise(numbers[:-size], numbers[-size:]):
            found = [*range(len(numbers) - size, len(numbers))]
        if not found and _summarise(numbers[size:], numbers[:size]):
            found = [*range(size)]
    return np.array(found, np.intp)


def _near_mean(numbers: Array) -> bool:
    """Return whether some row at the start or the end is near the mean of those between.

    It takes no more memory than a column, and ends at the first column of most logs: the time.
    """
    core = numbers[_BLOCK:-_BLOCK]
    if len(core) < _LEAST:
        return len(numbers) > _LEAST
    ends = np.concatenate([numbers[:_BLOCK], numbers[-_BLOCK:]])
    near = np.isfinite(ends).any(axis=1)
    for column, row in zip(core.T, ends.T):
        known = column[np.isfinite(column)]
        if not near.any():
            return False
        if len(known) < _LEAST:
            continue
        reach = float(np.ptp(known)) * len(ends) / len(core) + _digit(known)
        near &= ~np.isfinite(row) | (np.abs(row - known.mean()) <= reach)
    return bool(near.any())


def _summarise(body: Array, block: Array) -> bool:
    """Return whether all rows of a block are statistics of a body, and one is its mean."""
    known = np.isfinite(body).sum(axis=0) >= _LEAST
    body, block = body[:, known], block[:, known]
    spread = np.nanmax(body, axis=0) - np.nanmin(body, axis=0) if body.size else np.zeros(0)
    body, block, spread = body[:, spread > 0], block[:, spread > 0], spread[spread > 0]
    if not body.shape[1]:
        return False
    digit = np.array([_digit(column[np.isfinite(column)]) for column in body.T])
    mean = [
        _equal(row, np.nanmean(body, axis=0), digit)
        and _rarely(row, digit, spread)
        and not (np.isnan(row) | (body == row)).all(axis=1).any()
        for row in block
    ]
    return any(mean) and all(
        one or any(_equal(row, other, tolerance) for other, tolerance in _statistics(body, digit))
        for one, row in zip(mean, block)
    )


def _statistics(body: Array, digit: Array) -> list[tuple[Array, Array]]:
    """Return the statistics (columns,) that stand next to a mean, and their rounding."""
    count = np.isfinite(body).sum(axis=0).astype(float)
    low, high = np.nanmin(body, axis=0), np.nanmax(body, axis=0)
    both = [(np.nanstd(body, axis=0, ddof=k), np.nanvar(body, axis=0, ddof=k)) for k in (0, 1)]
    plain = [np.nanmedian(body, axis=0), low, high, high - low, both[1][0] / np.sqrt(count), count]
    plain += [statistic for pair in both for statistic in pair]
    total = (np.nansum(body, axis=0), digit * count)
    return [total, *((statistic, digit) for statistic in plain)]


def _equal(row: Array, statistic: Array, tolerance: Array) -> bool:
    """Return whether a row (columns,) with some number equals a statistic."""
    given = np.isfinite(row)
    near = np.abs(row - statistic) <= tolerance + 1e-9 * np.abs(statistic)
    return bool(given.any() and (near | ~given).all())


def _rarely(row: Array, digit: Array, spread: Array) -> bool:
    """Return whether a row (columns,) would hardly equal a statistic by accident."""
    chance = np.minimum(2.0 * digit / spread, 1.0)[np.isfinite(row)]
    return float(chance.prod()) < _CHANCE


def _digit(column: Array) -> float:
    """Return the last digit of the numbers (rows,): 0.001 if they have three decimals."""
    some = column[:200]
    for decimals in range(_DIGITS):
        scaled = some * 10.0**decimals
        if np.abs(scaled - np.rint(scaled)).max() < 1e-6 * max(1.0, float(np.abs(scaled).max())):
            return float(10.0**-decimals)
    return float(10.0**-_DIGITS)
