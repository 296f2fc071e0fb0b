"""Find a table that begins below the lines that are searched for one (`header.py`).

A logger may write thousands of lines of settings or messages first. Lines in the middle and at the
end of the file show how its rows look. If the first lines hold no such rows, the table begins at
the first stretch of them. Rows of numbers above it would be dropped, so they are refused. Pinned by
tests/logs/test_late_table.py.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from softmap_edge.errors import RunError
from softmap_edge.logs.readers.between import without_heads
from softmap_edge.logs.readers.cells import is_value, split, trimmed
from softmap_edge.logs.readers.encoding import encoding_of, is_wide
from softmap_edge.logs.readers.header import Table, find_table, is_remark, table_lines
from softmap_edge.logs.readers.lines import blocks, first_lines
from softmap_edge.logs.readers.words import EMPTY

MOST = 1_000_000  # lines above a table
_BYTES, _LINES = 2**16, 40  # of a sample
_SOLID = 10  # consecutive rows that are a table
_PART = 0.9  # of the lines of a sample that are its rows
_ABOVE = 60  # lines above the first row that may hold names and units
_NUMBERS = re.compile(r"[-+\d.eE]+(?:[\s,;|]+[-+\d.eE]+)+")  # a row of numbers in any table


@dataclass(frozen=True)
class Found:
    """What is known of the table of a log.

    Attributes:
        lines: those that were searched.
        table: the table among them; None without rows of numbers.
        skipped: lines above them.
        hidden: how many of these are not remarks and are not skipped by the mapping.
    """

    lines: list[str]
    table: Table | None
    skipped: int
    hidden: int = 0


def search(path: Path, delimiter: str | None, skipped: int) -> Found:
    """Find the table of a text log.

    Args:
        path: the log.
        delimiter: the separator of cells; None to find it.
        skipped: lines to skip.

    Raises:
        RunError: a long file has no table, or rows of numbers stand above a table far below.
    """
    first = _found(path, delimiter, skipped)
    late = _late_start(path, first, delimiter)
    if late is None:
        return first
    begin, hidden = late
    return replace(_found(path, delimiter, begin), hidden=hidden)


def _found(path: Path, delimiter: str | None, skipped: int) -> Found:
    lines = table_lines(path, skipped)
    return Found(lines, find_table(without_heads(lines), delimiter, EMPTY), skipped)


def _late_start(path: Path, first: Found, delimiter: str | None) -> tuple[int, int] | None:
    """Return the lines above those to search for a table far below, and how many are not remarks.

    None if the table of the first lines is the log's.
    """
    lines, table, skipped = first.lines, first.table, first.skipped
    settings = table is not None and table.names is None and not _is_row(lines[table.first], table)
    if not settings and not first_lines(path, 1, skipped + 1 + len(lines)):
        return None
    rows: Table | None = None
    for share in (0.5, 1.0):
        sample = _sample(path, share)
        one = find_table(sample, delimiter, EMPTY) if sample else None
        if one is None or not _solid(sample, one):
            continue
        if table is not None and _alike(one, table):
            return None
        rows = one
    if rows is not None:
        return _begin(path, rows, skipped)
    if table is not None:
        return None
    raise RunError(
        f"{path}: the first {len(lines)} lines hold no table, nor do lines in the middle and at the "
        "end of the file; if it has one, set skip_rows to the number of lines above the names of "
        "its columns"
    )


def _sample(path: Path, share: float) -> list[str]:
    """Return some complete lines in the middle or at the end of a file; [] if it is not simple."""
    encoding = encoding_of(path)[0]
    if is_wide(encoding):
        return []
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(int(max(size - _BYTES, 0) * share))
        text = file.read(_BYTES).decode(encoding, "ignore")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")[1:-1]
    return lines[-_LINES:]


def _solid(lines: Sequence[str], table: Table) -> bool:
    """Return whether nearly all lines are rows of numbers of a table."""
    filled = [line for line in lines if not is_remark(line)]
    count = sum(_is_row(line, table) for line in filled)
    return count >= max(_SOLID, _PART * len(filled))


def _alike(one: Table, other: Table) -> bool:
    """Return whether rows of one table may be rows of the other."""
    return one.delimiter == other.delimiter and (
        one.fewest <= other.width and other.fewest <= one.width
    )


def _is_row(line: str, table: Table) -> bool:
    """Return whether a line begins with a number and holds mostly numbers; settings have a name."""
    cells = trimmed(split(line, table.delimiter))
    filled = [cell for cell in cells if cell]
    values = sum(map(is_value, filled))
    fits = table.fewest <= len(cells) <= table.width and 2 * values > len(filled) > 1
    return fits and is_value(filled[0])


def _begin(path: Path, rows: Table, skipped: int) -> tuple[int, int]:
    """Return where to search for the first stretch of rows, as `_late_start`."""
    stretch = counted = others = 0
    above: list[bool] = []  # which of the last lines count
    for first, lines in blocks(path, skipped + 1, skipped + 1 + MOST):
        for number, line in enumerate(lines, first):
            remark = is_remark(line)
            row = not remark and _is_row(line, rows)
            stretch = stretch + 1 if row else stretch if remark and stretch else 0
            if stretch == 1 and row:
                begin = number
            if stretch == _SOLID:
                _refuse_others(path, begin, others)
                return begin - 1 - len(above), counted - sum(above)
            if not stretch:
                others += _NUMBERS.fullmatch(line.strip()) is not None
                counted += not remark
                above = [*above[1 - _ABOVE :], not remark]
    raise RunError(
        f"{path}: no table begins within {MOST} lines, although lines further down look like rows "
        f"of {rows.width} cells; set skip_rows to the number of lines above the names of its "
        "columns"
    )


def _refuse_others(path: Path, begin: int, others: int) -> None:
    """Raise RunError if rows of numbers stand above a table: they would be dropped."""
    if others >= _SOLID:
        raise RunError(
            f"{path}: {others} rows of numbers stand above the table that begins in line {begin}; "
            f"cut the log there, and import each part (skip_rows = {begin - 2} reads the rows from "
            "there on)"
        )
