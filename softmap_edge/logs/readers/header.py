"""Find the start of a text log's table: delimiter, line of names, units, first row.

Loggers and vendors write lines of all kinds above the names. The table is the longest stretch of
rows of one width that are mostly numbers or times. Its names are the last line of text above it
that is as wide as the rows (not counting a line of units). Names that span several columns (`tip`
above `X, Y, Z`) become prefixes of the names below. A first line that resembles the rows below is a
row: it has text only where the rows have text.

Only the first lines are searched (`LINES`, `CHARACTERS`), however long the file is. Comments and
blank lines do not count among `LINES`. Pinned by tests/logs/test_header.py.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

from softmap_edge.errors import RunError
from softmap_edge.logs.readers.cells import DELIMITERS, is_unit, is_value, split, trimmed, unit_of
from softmap_edge.logs.readers.lines import blocks

LINES = 1000  # lines in which the table must begin
CHARACTERS = 2**20  # of these lines, but always at least `LEAST` lines
LEAST = 8
# columns of a text log: a robot has a few hundred, and each cell of the first lines costs 10 us
MOST_COLUMNS = 50_000
_LOOKED = 20  # rows below a line that decide whether it is a row as well
_COMMON = 0.05  # of the rows: a width that so many have is no accident
_NEAR = 3  # lines of text above a line of units or types that may hold the names
_SPARE = 3  # surplus of names over cells: columns that are always empty, such as comments


@dataclass(frozen=True)
class Table:
    """The header of a table.

    Attributes:
        delimiter: the separator of cells.
        names: of the columns; None where no line holds them.
        first: the index of the first row among the lines.
        header: the index of the line of names; None without one.
        width: cells of a row.
        fewest: cells of a row whose last cells, all empty, are left out.
        units: by name, where a line of units stands between names and rows.
        stated: by name, the cells of that line that are not a known unit.
        clash: indices of a line above the rows that could be names but has another number of cells.
    """

    delimiter: str
    names: list[str] | None
    first: int
    header: int | None
    width: int
    fewest: int
    units: dict[str, str] = field(default_factory=dict)
    stated: dict[str, str] = field(default_factory=dict)
    clash: int | None = None


@dataclass(frozen=True)
class _Line:
    """One line: its cells, and whether it is a row, text, a comment, or blank."""

    cells: list[str]
    kind: str  # row, text, comment, blank


def is_remark(line: str) -> bool:
    """Return whether a line is blank or a comment."""
    bare = line.lstrip()
    return not bare or bare[0] in "#%"


def enough(lines: Iterable[str]) -> list[str]:
    """Return the first lines, as many as are searched; remarks count by their characters only."""
    found: list[str] = []
    held = counted = 0
    for line in lines:
        held += len(line)
        counted += not is_remark(line)
        if counted > LINES or (held > CHARACTERS and len(found) >= LEAST):
            break
        found.append(line)
    return found


def table_lines(path: Path, skipped: int) -> list[str]:
    """Return the first lines of a log after those that are skipped, as many as are searched.

    Raises:
        RunError: they are all remarks, or a line has too many columns.
    """
    found = enough(line for _, block in blocks(path, skipped + 1) for line in block)
    if all(map(is_remark, found)):
        for first, block in blocks(path, skipped + 1 + len(found)):
            at = next((first + k for k, line in enumerate(block) if not is_remark(line)), None)
            if at is not None:
                raise RunError(
                    f"{path}: the {at - 1 - skipped} lines above line {at} are comments or blank, "
                    f"more than are searched for the table: set skip_rows = {max(at - 2, 0)} in "
                    "the mapping"
                )
        raise RunError(
            f"{path}: holds no lines after {skipped} skipped ones; give a log that holds data"
        )
    for k, line in enumerate(found):
        counts = {mark: line.count(mark) for mark in (*DELIMITERS, " ")}
        if max(counts.values()) < MOST_COLUMNS or is_remark(line):
            continue
        most = max(max(counts[mark] for mark in DELIMITERS) + 1, len(line.split()))
        if most > MOST_COLUMNS:
            raise RunError(
                f"{path}: line {skipped + 1 + k} has {most} columns, at most {MOST_COLUMNS} are "
                "read; export only the columns of the robot"
            )
    return found


def find_table(lines: list[str], delimiter: str | None, absent: Collection[str]) -> Table | None:
    """Return the table that begins in these lines; None if no line resembles a row.

    Args:
        lines: the first lines of a log.
        delimiter: the separator of cells; None to find it.
        absent: words (lower case) for a missing value.
    """
    best: tuple[tuple[float, ...], Table] | None = None
    for mark in [delimiter] if delimiter else _marks(lines):
        found = [_line(line, mark, absent) for line in lines]
        table = _table(found, mark)
        if table is not None:
            rows = [
                line.cells
                for line in found[table.first :]
                if line.kind == "row" and _full(line, table.width)
            ]
            numbers = sum(is_value(cell) for row in rows[:100] for cell in row)
            filled = sum(1 for row in rows[:100] for cell in row if cell)
            score = (len(rows), table.names is not None, numbers, numbers / max(filled, 1))
            if best is None or score > best[0]:
                best = (score, table)
    return None if best is None else best[1]


def _marks(lines: list[str]) -> list[str]:
    """Return the possible delimiters of these lines, most likely first."""
    marks = [mark for mark in DELIMITERS if any(mark in line for line in lines)]
    return marks + [" "] * any(" " in line.strip() for line in lines) or [","]


def _line(line: str, mark: str, absent: Collection[str]) -> _Line:
    if not line.strip():
        return _Line([], "blank")
    if line.lstrip()[0] in "#%":
        return _Line(split(line.lstrip("#% \t"), mark), "comment")
    cells = split(line, mark)
    filled = [
        cell for cell in cells if cell.lower() not in absent and any(c.isalnum() for c in cell)
    ]
    values = sum(map(is_value, filled))
    if not filled:
        return _Line(cells, "row" if any(cells) and len(cells) > 1 else "blank")
    return _Line(cells, "row" if values and 2 * values >= len(filled) else "text")


def _width(lines: list[_Line]) -> int:
    """Return the number of cells of a row.

    It is the largest frequent width, without columns that are empty in all of these rows.
    """
    counts = Counter(len(line.cells) for line in lines if line.kind == "row")
    most, enough_rows = max(counts.values()), max(2.0, _COMMON * counts.total())
    many = {width for width, count in counts.items() if count == most or count >= enough_rows}
    rows = [line.cells for line in lines if line.kind == "row" and len(line.cells) in many]
    return max(1, *(len(trimmed(cells)) for cells in rows))


def _shorter(lines: list[_Line], width: int) -> set[int]:
    """Return the frequent widths of rows without their empty last cells."""
    counts = Counter(len(line.cells) for line in lines if line.kind == "row")
    least = max(2.0, _COMMON * counts.total())
    return {w for w, count in counts.items() if 1 < w < width and count >= least}


def _full(line: _Line, width: int) -> bool:
    """Return whether a row is not truncated and has no values beyond the table's columns."""
    return len(line.cells) >= width >= len(trimmed(line.cells))


def _table(lines: list[_Line], mark: str) -> Table | None:
    if not any(line.kind == "row" for line in lines):
        return None
    width = _width(lines)
    rows = [k for k, line in enumerate(lines) if line.kind == "row" and _full(line, width)]
    if not rows:
        return None
    begin = [_first_of(lines, k, width) for k in rows if k == rows[0] or _opens(lines, k)]
    starts = {k: _names_above(lines, k, width) for k in begin}
    counts = {k: sum(1 for row in rows if k <= row < _end(starts, k)) for k in starts}
    first = max(counts, key=lambda k: (counts[k], starts[k] is not None))
    fewest = min(_shorter(lines[first : _end(starts, first)], width), default=width)
    return _head(lines, first, width, fewest, mark, [k for k in rows if k >= first])


def _first_of(lines: list[_Line], k: int, width: int) -> int:
    """Return the first row of the block that contains row `k`; its last cells may be missing."""
    short = _shorter(lines[k:], width) if k and lines[k - 1].kind == "row" else set()
    while k and lines[k - 1].kind == "row" and len(lines[k - 1].cells) in short:
        k -= 1
    return k


def _opens(lines: list[_Line], k: int) -> bool:
    """Return whether a row follows a line of text, ignoring blank lines and comments."""
    above = k - 1
    while above >= 0 and lines[above].kind in ("blank", "comment"):
        above -= 1
    return above < 0 or lines[above].kind == "text"


def _end(starts: dict[int, int | None], k: int) -> int:
    """Return the next row that starts a table with its own names."""
    return min(
        (other for other, names in starts.items() if other > k and names is not None), default=10**9
    )


def _names_above(lines: list[_Line], first: int, width: int) -> int | None:
    """Return the line of names above a row: the last text line as wide as rows, not of units."""
    k = first - 1
    seen = None
    while k >= 0 and lines[k].kind != "row":
        if lines[k].kind == "text" and _wide(lines[k].cells, width):
            seen = k if seen is None else seen
            if not _units_below(lines, k):
                return k
        k -= 1
    return seen


def _wide(cells: list[str], width: int) -> bool:
    """Return whether a line has names for rows of this width (`_head` checks further cells)."""
    count = len(trimmed(cells))
    spare = _SPARE if width > _SPARE else 1
    return len(cells) == width or max(min(width, 2), width // 2) <= count <= width + spare


def _units_below(lines: list[_Line], k: int) -> bool:
    """Return whether a line holds units (or types) for the names above it."""
    cells = trimmed(lines[k].cells)
    filled = [cell for cell in cells if cell]
    if not filled:
        return False
    if all(is_unit(cell) for cell in filled):
        return True
    known = 2 * sum(map(is_unit, filled)) >= len(filled)
    above = range(k - 1, max(k - 1 - _NEAR, -1), -1)
    names = [trimmed(lines[j].cells) for j in above if lines[j].kind == "text"]
    return any(
        _names_these(own, cells) and (known or len(set(filled)) < len(set(own))) for own in names
    )


def _names_these(own: list[str], cells: list[str]) -> bool:
    """Return whether a line has distinct names for the cells below; the first may be missing."""
    filled = [name for name in own if name]
    if (
        len(own) < len(cells)
        or 3 * len(set(filled)) <= 2 * len(filled)
        or all(map(is_unit, filled))
    ):
        return False
    return all(name or not cell for name, cell in list(zip(own, cells))[1:])


def _head(
    lines: list[_Line], first: int, width: int, fewest: int, mark: str, rows: list[int]
) -> Table:
    """Return the table with a known first row; `rows` are those of full width."""
    bare = Table(mark, None, first, None, width, fewest)
    header = _names_above(lines, first, width)
    if header is None:
        return _bare_head(lines, bare, rows)
    own = trimmed(lines[header].cells)
    comment = _comment_above(lines, header, width) if all(map(is_unit, own)) else None
    if comment is not None:  # as numpy writes it, perhaps with a line of units below
        own, header = trimmed(lines[comment].cells), comment
    if len(own) < width:  # the last column has no name, or names are missing
        own = lines[header].cells[:width]
        if len(own) != width:
            return replace(bare, clash=header)
    names = _grouped(own, lines[header - 1] if header else None)
    if header > 1 and names != own and len(set(names)) < len(names):  # a group of groups
        names = _grouped(names, lines[header - 2])
    units = _units_above(names, lines[header - 1]) if header and names == own else {}
    stated: dict[str, str] = {}
    for line in lines[header + 1 : first]:
        if line.kind == "text":
            units |= _units_of(names, line.cells)
            if any(map(is_unit, filter(None, line.cells))):
                cells = dict(zip(names, line.cells))
                stated |= {name: cell for name, cell in cells.items() if cell and not is_unit(cell)}
    return Table(mark, names, first, header, width, fewest, units, stated)


def _units_of(names: list[str], cells: list[str]) -> dict[str, str]:
    """Return the known units of a line, by column name."""
    return {name: unit_of(cell) for name, cell in zip(names, cells) if cell and is_unit(cell)}


def _units_above(names: list[str], above: _Line) -> dict[str, str]:
    """Return the units in a line above the names; {} if it holds something else."""
    filled = [cell for cell in above.cells if cell]
    full = (
        above.kind == "text"
        and len(trimmed(above.cells)) <= len(names)
        and 2 * len(filled) >= len(names)
    )
    return (
        _units_of(names, above.cells)
        if full and 2 * sum(map(is_unit, filled)) >= len(filled)
        else {}
    )


def _bare_head(lines: list[_Line], bare: Table, rows: list[int]) -> Table:
    """Return the table without a text line above: a comment or the first row may hold the names."""
    first, width = bare.first, bare.width
    comment = _comment_above(lines, first, width)
    if comment is not None:
        return replace(bare, names=trimmed(lines[comment].cells), header=comment)
    below = [lines[k].cells[:width] for k in rows]
    if (
        len(below) > 1
        and rows[0] == first
        and (_is_names(below[0], below[1 : 1 + _LOOKED]) or _counts(below))
    ):
        return replace(bare, names=trimmed(below[0]), first=rows[1], header=first)
    above = lines[first - 1] if first else None
    clash = first - 1 if above and above.kind == "text" and len(trimmed(above.cells)) > 1 else None
    return replace(bare, clash=clash)


def _counts(rows: list[list[str]]) -> bool:
    """Return whether the first row only numbers the columns, as pandas writes it."""
    count = [str(k) for k in range(len(rows[0]))]
    return len(count) > 2 and rows[0] == count and any("." in cell for cell in rows[1])


def _comment_above(lines: list[_Line], first: int, width: int) -> int | None:
    """Return the last comment above a row, if it names the columns."""
    comments = [k for k in range(first - 1, -1, -1) if lines[k].kind == "comment"]
    comment = next((k for k in comments if not all(map(is_unit, trimmed(lines[k].cells)))), None)
    if (
        comment is None
        or len(trimmed(lines[comment].cells)) != width
        or all(map(is_value, lines[comment].cells))
    ):
        return None
    return comment


def _is_names(line: list[str], below: list[list[str]]) -> bool:
    """Return whether a line with some numbers holds names: text above numbers in the rows."""
    for column, cell in enumerate(line):
        if cell and any(c.isalpha() for c in cell) and not is_value(cell):
            under = [row[column] for row in below if column < len(row) and row[column]]
            if under and sum(map(is_value, under)) > 0.5 * len(under):
                return True
    return False


def _grouped(names: list[str], above: _Line | None) -> list[str]:
    """Return names prefixed by the group above: `tip` over `X, Y, Z` gives `tip.X`, `tip.Y`, ….

    A group stands above its first column. Either the line begins with an empty cell, or the names
    alone are not distinct.
    """
    top = [] if above is None or above.kind != "text" else trimmed(above.cells)
    if above is None or not top or len(top) > len(names):
        return names
    filled = [name for name in names if name]
    if above.cells[0] and (len(set(filled)) == len(filled) or 2 * len(top) <= len(names)):
        return names
    groups, group = [], ""
    for k in range(len(names)):
        group = (above.cells[k] if k < len(above.cells) else "") or group
        groups.append(group)
    joined = [
        f"{group}.{name}" if group and name else name or group for group, name in zip(groups, names)
    ]
    return joined if len(set(joined)) >= len(set(names)) else names


def widths_of(lines: list[str], mark: str) -> str:
    """Return the widths of the first lines for a message: `1, 5, 6 …`."""
    counts = [len(split(line, mark)) for line in lines if line.strip()]
    shown = list(dict.fromkeys(counts))
    return ", ".join(map(str, shown[:5])) + (" …" if len(shown) > 5 else "")
