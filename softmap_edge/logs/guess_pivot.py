"""Recognise a long table: one row for each marker of each frame, not one row for each frame.

Names alone do not decide. In a long table times repeat in groups, a column of ids has each value at
most once in a group, and the other columns differ between ids: an id explains a good part of their
variance, or a number is nearer to the last one of its id than to its neighbour of the same frame.
A counter within a coarse second has such ids too, but its columns go on from row to row. Where
every row has its own time, ids must also cycle. Pinned by tests/logs/test_long_tables.py.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.logs.pivot import Pivot
from softmap_edge.logs.readers.columns import Columns
from softmap_edge.logs.readers.pivoted import MOST_MARKERS, frames_of
from softmap_edge.logs.time_names import TIME_NAME, is_time_name, time_unit

if TYPE_CHECKING:
    from softmap_edge.logs.guess_sheets import Sheet

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
_FRAMES = re.compile(r"frame|^(sample|count(er)?|idx|index|step|n)#?$", re.IGNORECASE)
_COUNTS = re.compile(r"sample|count|frame|row|step|seq|frac|block|trial|phase", re.IGNORECASE)
_NAMES = re.compile(
    r"marker|body|bodies|\bid\b|_id$|^id|name|label|tag|point|object|node|joint|bead|landmark"
    r"|signal|variable|channel|track|feature",
    re.IGNORECASE,
)
_LEAST = 3  # frames, and rows of a marker on average
_GROUPED = 1.5  # rows of a frame on average
_MOST = 64  # values of a column of ids that are numbers
_TWICE = 0.05  # of the rows: more that share frame and id are not duplicates
_EXPLAINED = 0.2  # of the variance: an id that explains so much names markers
_NEARER = 0.5  # of the step to the neighbour in the frame: the step of one marker
_NAMED = 0.3  # of the rows: others hold commands, or nothing
_CYCLES = 0.8  # of the rows: the next row has another id
_TRIED = 8  # columns of ids, and of frames


@dataclass(frozen=True)
class LongTable:
    """A long table.

    Attributes:
        pivot: its columns of frames and markers.
        shared: the columns that are equal in all rows of a frame.
        own: the columns of numbers that each marker has.
        why: a sentence on what shows it.
        sure: whether a text, or a column named so, names the markers. Other numbers may count the
            rows of a coarse second.
    """

    pivot: Pivot
    shared: list[str]
    own: list[str]
    why: str
    sure: bool


def find_long(sheet: Sheet, columns: Columns) -> LongTable | None:
    """Return the columns of frames and markers of a long table; None if a log is none.

    Args:
        sheet: the first rows of the log.
        columns: the same log, for the texts of its rows.
    """
    if not sheet.header or len(sheet.numbers) < 2 * _LEAST:
        return None
    ids = _ids(sheet, columns)
    sets = [*((one,) for one in ids), *combinations(ids, 2)]
    times = [_codes(sheet.rows_of(list(names))) for names in _frames(sheet)]
    for grouped in (True, False):
        for names, frame in zip(_frames(sheet), times):
            if grouped and not _repeats(frame):
                continue
            for chosen in sets:
                if set(names) & set(chosen):
                    continue
                if not grouped and not _cycles(chosen, ids):
                    continue
                found = _tested(sheet, names, frame, chosen, ids, grouped)
                if found is not None:
                    return found
    return None


def _codes(rows: Array) -> Rows:
    """Return a number for each distinct row of (rows, n), in their order; -1 if one is empty."""
    known = np.isfinite(rows).all(axis=1)
    code = np.full(len(rows), -1)
    code[known] = np.unique(rows[known], axis=0, return_inverse=True)[1].reshape(-1)
    return code


def _repeats(frame: Rows) -> bool:
    """Return whether times come again, in the same frame or after a clock was set back."""
    known = frame[frame >= 0]
    return len(known) >= _GROUPED * len(np.unique(known)) or bool((np.diff(known) < 0).any())


def _ids(sheet: Sheet, columns: Columns) -> dict[str, Rows]:
    """Return the columns that may name markers, with a number for each name; -1 without one."""
    found: dict[str, Rows] = {}
    rows = len(sheet.numbers)
    for k, name in enumerate(sheet.names):
        if len(found) == _TRIED or (is_time_name(name) and not _NAMES.search(name)):
            continue
        if name in sheet.texts:
            few = len(set(sheet.texts[name])) <= max(2, len(sheet.texts[name]) // 2)
            if few and not _COUNTS.search(name):
                found[name] = _spelt(columns, k, rows)
            continue
        values, named = sheet.column(name), _NAMES.search(name) is not None
        known = values[np.isfinite(values)]
        counted = _COUNTS.search(name) is not None or time_unit(name) is not None
        if bool((known == np.rint(known)).all()) and (named or not counted):
            code = _spelt(columns, k, rows) if named else _codes(values[:, None])
            if 0 < code.max() < (MOST_MARKERS if named else _MOST):
                found[name] = code
    return found


def _spelt(columns: Columns, place: int, rows: int) -> Rows:
    """Return a number for each spelling in a column, as `pivoted` reads it: 01 and 1 are two."""
    texts = columns.read([], place, rows).labels
    assert texts is not None
    distinct, code = np.unique(texts[:rows], return_inverse=True)
    return np.asarray(code - int(distinct[0] == ""), np.int64)


def _frames(sheet: Sheet) -> Iterator[tuple[str, ...]]:
    """Yield the columns that may name frames, the likeliest first."""
    numbers = [name for name in sheet.names if name not in sheet.texts]
    timed = [name for name in numbers if name in sheet.clocks or TIME_NAME.search(name)]
    named = [name for name in numbers if is_time_name(name) and name not in timed]
    counted = [name for name in numbers if _FRAMES.search(name)]
    parts = [one for one in zip(numbers, numbers[1:]) if all(map(is_time_name, one))]
    singles = dict.fromkeys([*timed, *named, *counted, *numbers[:1]])
    yield from [*parts, *((name,) for name in singles)][:_TRIED]


def _cycles(chosen: tuple[str, ...], ids: dict[str, Rows]) -> bool:
    """Return whether columns named like those of markers change from row to row."""
    code = ids[chosen[0]]
    return any(map(_NAMES.search, chosen)) and bool((np.diff(code) != 0).mean() > _CYCLES)


def _tested(
    sheet: Sheet,
    names: tuple[str, ...],
    frame: Rows,
    chosen: tuple[str, ...],
    ids: dict[str, Rows],
    grouped: bool,
) -> LongTable | None:
    """Return the long table of these columns; None if the values contradict."""
    marker = _codes(np.stack([ids[name] for name in chosen], axis=1).astype(float))
    named = (frame >= 0) & np.all([ids[name] >= 0 for name in chosen], axis=0)
    if named.mean() < _NAMED:
        return None
    table = sheet.numbers[frame >= 0]
    marker, named, frame = (one[frame >= 0] for one in (marker, named, frame))
    marker[named] = np.unique(marker[named], return_inverse=True)[1]
    marker[~named] = -1
    count = int(marker.max()) + 1
    frame = frames_of(frame, marker, count)
    rows, frames = int(named.sum()), len(np.unique(frame[named]))
    if frames < _LEAST or (rows < _GROUPED * frames) == grouped:
        return None
    once = len(np.unique((frame * count + marker)[named]))
    if count < 2 or count * _LEAST > rows or rows - once > _TWICE * rows:
        return None
    order, starts = _by_frame(frame)
    others = [
        name
        for name in sheet.names
        if name not in (*names, *chosen) and np.isfinite(sheet.column(name)).any()
    ]
    columns = {name: table[:, sheet.names.index(name)] for name in others}
    own = [name for name in others if _differs(columns[name], order, starts)]
    apart = [
        name for name in own if _apart(columns[name][named], frame[named], marker[named], grouped)
    ]
    if not apart or (grouped and 2 * len(apart) < len(own)):
        return None
    own = own if grouped else apart
    axes = {form for name in own for form in _without_axis(name)}
    own = [name for name in others if name in own or axes & _without_axis(name)]
    shared = [name for name in sheet.names if name not in (*own, *chosen)]
    called = "' and '".join(chosen)
    why = (
        f"a long table: {count} names in '{called}', each with a row of its own for "
        f"{', '.join(own[:4])}{' …' * (len(own) > 4)}"
        + ("" if grouped else "; every row has a time of its own, so each frame shows one of them")
    )
    sure = all(name in sheet.texts or _NAMES.search(name) for name in chosen)
    return LongTable(Pivot(names, chosen), shared, own, why, sure)


def _without_axis(name: str) -> set[str]:
    """Return a name with each of its letters x, y, z left out: a plane may have y = 0 for all."""
    return {f"{name[:k]}#{name[k + 1 :]}" for k, letter in enumerate(name) if letter in "xyzXYZ"}


def _by_frame(frame: Rows) -> tuple[Rows, Rows]:
    """Return the rows in the order of their frames, and where each frame starts among them."""
    order = np.argsort(frame, kind="stable")
    return order, np.flatnonzero(np.r_[True, np.diff(frame[order]) != 0])


def _differs(column: Array, order: Rows, starts: Rows) -> bool:
    """Return whether a column (rows,) of numbers differs within some frame."""
    low, high = (one.reduceat(column[order], starts) for one in (np.fmin, np.fmax))
    return bool((low < high).any()) or (len(starts) == len(order) and bool((low < np.inf).any()))


def _apart(column: Array, frame: Rows, marker: Rows, grouped: bool) -> bool:
    """Return whether the numbers (rows,) of markers differ as those of different things do."""
    known = np.isfinite(column)
    column, frame, marker = column[known], frame[known], marker[known]
    if len(column) < 2 * _LEAST or np.ptp(column) == 0.0:
        return False
    count = np.bincount(marker)
    mean = np.bincount(marker, column)[count > 0] / count[count > 0]
    between = float(np.sum(count[count > 0] * (mean - column.mean()) ** 2))
    share = between / float(np.sum((column - column.mean()) ** 2))
    if share > max(_EXPLAINED, 10.0 * (len(mean) - 1) / len(column)):
        return True
    steps = []
    for first, second in ((frame, marker), (marker, frame)):
        order = np.lexsort((second, first))
        same = (
            np.diff(first[order]) == 0
            if grouped or first is marker
            else np.ones(len(order) - 1, bool)
        )
        step = np.abs(np.diff(column[order]))[same]
        steps.append(float(np.median(step)) if len(step) else 0.0)
    return steps[1] < _NEARER * steps[0]
