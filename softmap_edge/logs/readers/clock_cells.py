"""Find the columns of dates and times in the first rows of a text log, and how they are written.

Columns of numbers may hold the digits of a date without separators (`240305125950.5`). Fractions
of a second may be counts without leading zeros (`12:59:50.50` is 50 ms, and `12.50` may be 12 s and
50 us). The rows decide all of it.
Pinned by tests/logs/test_time_text.py.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from softmap_edge.logs.readers.cells import is_number
from softmap_edge.logs.readers.words import EMPTY
from softmap_edge.logs.time_text import (
    DAY,
    HOUR,
    TimeText,
    TimeTextError,
    counted_on,
    seconds_of,
    time_text_of,
)

_FIRST = 200  # rows whose text decides whether a column holds times
_MORE = 5000  # rows that decide how digits and fractions of times are read
_ROWS = 3  # that show how digits without separators are read
_MINUTE_LEAP = 40.0  # from 59 to 100, less the second that passes
_FEWER = 10  # times fewer falls: the right reading of fractions
_HOURS = re.compile(r"[012]?\d[0-5]\d[0-5]\d([.,]\d+)?")  # `125950.5`
_COUNTED = re.compile(r"([0-9]{1,12})(?:[.,]([0-9]{1,9}))?")  # `12.5`
_COUNT = TimeText("count", packed=True)
Rows = Callable[[int], list[list[str]]]  # the cells of so many first rows


def clocks_of(first_rows: Rows, order: str | None) -> dict[int, TimeText]:
    """Return the columns of dates and times of a text log, by position.

    Args:
        first_rows: returns the cells of the first rows.
        order: `dmy` or `mdy` of local dates, where a mapping gives it.
    """
    clocks: dict[int, TimeText] = {}
    filled = _filled(first_rows(_FIRST))
    for place, cells in filled.items():
        clock = packed_of(cells) if all(map(is_number, cells)) else time_text_of(cells, order)
        if clock is not None:
            clocks[place] = clock
    counted = [place for place, cells in filled.items() if _like_counts(cells)]
    if clocks or counted or any(map(_like_hours, filled.values())):
        filled = _filled(first_rows(_MORE))
    for place, cells in filled.items():
        if place in clocks and not clocks[place].packed:
            digits = unpadded_of(clocks[place], cells)
            clocks[place] = replace(clocks[place], unpadded=digits)
        elif place in clocks or _like_hours(cells):
            clock = packed_of(cells)
            clocks |= {place: clock} if clock is not None else {}
        if place in counted and place not in clocks:
            digits = unpadded_of(_COUNT, cells) if _like_counts(cells) else 0
            clocks |= {place: replace(_COUNT, unpadded=digits)} if digits else {}
    return clocks


def _filled(rows: list[list[str]]) -> dict[int, list[str]]:
    """Return the cells of rows that are not empty, by column."""
    return {
        place: [cell for cell in column if cell.lower() not in EMPTY]
        for place, column in enumerate(zip(*rows))
    }


def _like_hours(cells: list[str]) -> bool:
    """Return whether the first and last numbers of a column may be times of day as digits."""
    return len(cells) > _ROWS and all(_HOURS.fullmatch(cells[k]) for k in (0, 1, -1))


def _like_counts(cells: list[str]) -> bool:
    """Return whether numbers may be seconds with a count of fractions: `12.5` is 12 s and 5 us.

    Then full seconds rise, and the digits of the fractions vary in number without leading zeros.
    """
    found = [_COUNTED.fullmatch(cell) for cell in cells]
    parts = [one.groups() for one in found if one is not None]
    if len(parts) <= _ROWS or len(parts) < len(cells):
        return False
    tails = [tail for _, tail in parts if tail is not None]
    return (
        len(set(map(len, tails))) > 1
        and not any(tail[0] == "0" and tail != "0" for tail in tails)
        and bool((np.diff([float(whole) for whole, _ in parts]) >= 0).all())
    )


def packed_of(cells: Sequence[str]) -> TimeText | None:
    """Return how a column of numbers holds dates or times of day as digits; None if it does not.

    Every cell is a date of the calendar then, and times rise. Times of day (`125950.5`) are known
    by a minute that passes, where the digits leap by 40 s and the time does not.

    Args:
        cells: the first cells that are not empty.
    """
    for clock in (TimeText("ymd", packed=True), TimeText("day", None, DAY, packed=True)):
        if len(cells) < _ROWS or any(clock.match(cell) is None for cell in cells):
            continue
        clock = replace(clock, unpadded=unpadded_of(clock, cells))
        try:
            t = clock.parse(cells)[:, 0]
        except TimeTextError:
            continue
        step = np.diff(counted_on(t, DAY)[0] if clock.form == "day" else t)
        if not (step >= 0).all() or not step.any():
            continue
        if clock.form == "ymd":
            return clock
        whole = np.diff([float(re.split("[.,]", cell)[0]) for cell in cells])
        leap = np.rint((whole - np.diff(np.floor(t))) / _MINUTE_LEAP)
        if step.max() < _MINUTE_LEAP and (np.abs(leap) > 0).any():
            return clock
    return None


def unpadded_of(clock: TimeText, cells: Sequence[str]) -> int:
    """Return the digits of the unit of fractions without leading zeros; 0 of decimal fractions.

    Fractions are counted so if their digits vary in number, none begins with a zero, and the times
    rise so, but fall as decimals.

    Args:
        clock: how the times are written. cells: the first cells that are not empty.
    """
    found = [match for cell in cells if (match := clock.match(cell.strip())) is not None]
    parts = [match.groupdict().get("f") or "" for match in found]
    digits = max(map(len, parts), default=0)
    short = {part for part in parts if 0 < len(part) < digits}
    if digits not in (3, 6, 9) or not short or any(p[0] == "0" and p != "0" for p in parts if p):
        return 0
    falls = []
    for unpadded in (0, digits):
        t = np.array([seconds_of(match, {}, unpadded)[0] for match in found])
        falls.append(int((np.diff(t) < 0).sum() - (np.diff(t) < -0.5 * HOUR).sum()))
    return digits if falls[0] > _FEWER * falls[1] else 0
