"""Compare lines of names of one text log: the same head again, or the head of another table.

Names are the same if only a byte order mark, upper case or blanks differ. Rows above another head
are data: the log is refused, for a reader of one table would drop them. Pinned by
tests/logs/test_between.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from softmap_edge.errors import RunError
from softmap_edge.files.printable import listed
from softmap_edge.logs.readers.cells import is_unit, is_value, split, trimmed
from softmap_edge.logs.readers.header import Table

_MANY = 10  # rows without names: fewer may be settings of a logger
_FEW = 3  # names that are listed
_NEAR = 0.75  # of the larger width: rows of tables that differ by a few columns
_SAME = 0.5  # of the names: two heads of one table


def plain_name(cell: str) -> str:
    """Return a name without a byte order mark, quotes, upper case and extra blanks."""
    return " ".join(cell.replace("\ufeff", "").strip(' "\r').split()).casefold()


def plain_names(cells: Sequence[str]) -> tuple[str, ...]:
    """Return the names of a line as they are compared."""
    return tuple(map(plain_name, cells))


def names_again(cells: Sequence[str], names: Sequence[str]) -> bool:
    """Return whether a line between the rows holds names, those of the table or others.

    Args:
        cells: of the line.
        names: of the table.
    """
    filled = [cell for cell in plain_names(cells) if cell]
    if len(filled) < 2 or any(map(is_value, filled)):
        return False
    known = len({*filled} & {*plain_names(names)})
    wide = len(filled) == len(set(filled)) >= max(3.0, _NEAR * len(names))
    return known >= max(2.0, _SAME * min(len(filled), len(names))) or wide


def units_again(cells: Sequence[str], width: int) -> bool:
    """Return whether a line between the rows is a line of units: no numbers, two units or more.

    Args:
        cells: of the line.
        width: columns of the table.
    """
    filled = [cell for cell in cells if cell.strip()]
    units = sum(is_unit(cell.strip()) and cell.strip() != "-" for cell in filled)
    wide = len(trimmed(list(cells))) > max(1.0, _NEAR * width) and not any(map(is_value, filled))
    return wide and units >= 2 and units > _SAME * len(filled)


def refuse_second_head(
    path: Path, cells: Sequence[str], names: Sequence[str], line: int, header: bool
) -> None:
    """Raise RunError if a line between the rows holds names or units: a second log begins.

    Args:
        path: the log.
        cells: of the line.
        names: of the table.
        line: number of the line.
        header: whether the table has names of its own.
    """
    if names_again(cells, names):
        again = f"again, {again_words(cells, names)}" if header else "below rows"
        raise RunError(
            f"{path}: line {line} names the columns {again}; cut the log there, and import each "
            "part"
        )
    if units_again(cells, len(names)):
        raise _second_units(path, line)


def _second_units(path: Path, line: int) -> RunError:
    return RunError(
        f"{path}: line {line} gives units below rows: a second log begins; cut the log there, "
        "above its names, and import each part"
    )


def again_words(cells: Sequence[str], names: Sequence[str]) -> str:
    """Return how the names of a second head differ, as a part of a sentence."""
    new, old = plain_names(trimmed(list(cells))), plain_names(names)
    if sorted(new) == sorted(old):
        return "in another order"
    more = [cell for cell, name in zip(cells, new) if name not in old]
    gone = [name for name, known in zip(names, old) if known not in new]
    parts = [f"with {listed(more, _FEW)}"] if more else []
    return " and ".join([*parts, *([f"without {listed(gone, _FEW)}"] if gone else [])])


def refuse_rows_above(path: Path, lines: list[str], table: Table, skipped: int) -> None:
    """Raise RunError if rows of numbers stand above the table: they would be dropped.

    Args:
        path: the log.
        lines: its first lines, after those that are skipped.
        table: what was found in them.
        skipped: lines above them.
    """
    top = table.first if table.header is None else table.header
    rows = [k for k in range(top) if _is_row(lines[k], table)]
    if not rows:
        return
    cells = [] if table.header is None else split(lines[table.header], table.delimiter)
    heads = [split(lines[k].lstrip("#% \t"), table.delimiter) for k in range(rows[0])]
    head = next((head for head in heads if _alike(head, cells)), None)
    if len(rows) < (_MANY if head is None else 2):
        return
    if units_again(cells, table.width):
        raise _second_units(path, skipped + 1 + top)
    line, count = skipped + 1 + top, f"{len(rows)} row{'s' * (len(rows) != 1)} of numbers"
    what = (
        f"line {line} names the columns again, {again_words(cells, head)}, below {count}"
        if head is not None
        else f"{count} stand above the table that begins in line {line}"
    )
    raise RunError(
        f"{path}: {what}; cut the log there, and import each part (skip_rows = {line - 1} reads "
        "the rows from there on)"
    )


def _is_row(line: str, table: Table) -> bool:
    """Return whether a line holds mostly numbers, in about as many cells as the table's rows."""
    if not line.strip() or line.lstrip()[0] in "#%":
        return False
    cells = trimmed(split(line, table.delimiter))
    small, large = sorted((len(cells), table.width))
    if small < 2 or small < min(_NEAR * large, large - 1):
        return False
    filled = [cell for cell in cells if cell]
    return 2 * sum(map(is_value, filled)) > len(filled)


def _alike(head: Sequence[str], cells: Sequence[str]) -> bool:
    """Return whether two heads share many names."""
    one, other = {*plain_names(head)} - {""}, {*plain_names(cells)} - {""}
    return len(one & other) >= max(2.0, _SAME * min(len(one), len(other)))
