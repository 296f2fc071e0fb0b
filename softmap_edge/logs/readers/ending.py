"""Check a text log's end: lines below the table, and a truncated last cell.

Many programs write no line end after the last row, so a missing one is no evidence. The last cell
is doubtful if it is shorter than every other cell of its column. Pinned by
tests/logs/test_ending.py.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from softmap_edge.logs.readers.cells import is_number, is_value, split, trimmed
from softmap_edge.logs.readers.encoding import encoding_of, is_wide

_TAIL = 2**16  # bytes at the end that are examined
_MOST = 50  # lines below a table at most
_LEAST = 20  # rows that show the format of a column
RECENT = 200  # rows compared with the last one
_MARK = re.compile(r"[.,]")


def last_lines(path: Path) -> list[str]:
    """Return the complete lines among the last bytes of a text file, or all lines of a small one.

    Raises:
        OSError: the file cannot be read.
    """
    encoding, size = encoding_of(path)[0], path.stat().st_size
    with path.open("rb") as file:
        file.seek(max(size - _TAIL, 0) // 4 * 4)
        text = file.read(_TAIL + 4).decode(
            encoding if size <= _TAIL or is_wide(encoding) else "utf-8", "replace"
        )
    lines = text.splitlines()
    return lines[1:] if size > _TAIL else lines


def lines_below(path: Path, delimiter: str, width: int, fewest: int | None = None) -> list[str]:
    """Return the lines below a table, such as `End of data` or `Total rows,600`; [] if none.

    Args:
        path: the log.
        delimiter: the separator of cells.
        width: cells of a row.
        fewest: cells of the shortest row; a last row with fewer is truncated and does not count.
            None keeps it.
    """
    lines = last_lines(path)
    while lines and not lines[-1].strip():
        lines.pop()
    cells = [trimmed(split(line, delimiter)) for line in lines]
    firsts = [row[0] for row in cells if len(row) == width]
    named = 2 * sum(map(is_value, firsts)) > len(firsts)  # the first column holds values
    end = len(lines)
    if fewest is not None and end > 1 and 0 < len(split(lines[-1], delimiter)) < fewest:
        end -= 1
    while (
        end
        and len(lines) - end < _MOST
        and (not cells[end - 1] or _is_remark(cells[end - 1], width, named))
    ):
        end -= 1
    # the reader leaves out remarks
    while end < len(lines) and lines[end].strip()[:1] in ("", "#", "%"):
        end += 1
    return lines[end:] if end > 0 and len(firsts) > 1 else []


def _is_remark(row: list[str], width: int, named: bool) -> bool:
    """Return whether cells are a remark, not a row; a truncated row has values."""
    first = next(cell for cell in row if cell)
    word = (
        not is_value(first) and any(c.isalpha() for c in first) and first[0] not in "+-.0123456789"
    )
    if len(row) == width and width > 1:
        return named and word
    return word and (named or len(row) <= 2)


def cut_within(path: Path, rows: Sequence[str], delimiter: str) -> str | None:
    """Return a log's last cell if the file seems to end within it, else None.

    Args:
        path: the log.
        rows: its last lines, ending with the last row.
        delimiter: the separator of cells.
    """
    if len(rows) <= _LEAST or _ends_with_line(path):
        return None
    cells = [row[-1] for line in rows if (row := split(line, delimiter))]
    last, others = cells[-1], cells[:-1]
    if is_number(last) and all(map(is_number, others)):
        lengths = {_decimals(cell) for cell in others}
        return last if len(lengths) == 1 and _decimals(last) < lengths.pop() else None
    if last in others or not last:
        return None
    same = {len(cell) for cell in others if not is_number(cell)}
    begun = any(cell.startswith(last) for cell in others)
    return (
        last
        if begun or (len(same) == 1 and len(last) < same.pop() and len(others) > _LEAST)
        else None
    )


def _decimals(cell: str) -> int:
    """Return the number of characters after the decimal mark, including an exponent."""
    parts = _MARK.split(cell)
    return len(parts[-1]) if len(parts) > 1 else 0


def _ends_with_line(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(0, 2)
        file.seek(max(file.tell() - 4, 0))
        return file.read().rstrip(b"\0")[-1:] in (b"\n", b"\r")
