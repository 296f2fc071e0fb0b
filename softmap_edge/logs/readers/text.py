"""Read a delimited text log (CSV and similar) block by block.

A cell that cannot be read is reported with its line. The reader finds the start of the table
(`header.py`), its delimiter, and a header in a comment (as numpy writes it). It also finds a line
of units, decimal commas, blank lines, empty cells at the end of rows, and dates and times
(`time_text.py`). Each block of lines is parsed by numpy's compiled reader, with empty cells as NaN.
If that fails, the lines are read one by one to find the fault. A million rows of 16 columns take
seconds, and little more memory than their numbers (tests/logs/test_import_csv.py,
`python -m benches.import_rows`).
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.files.printable import listed
from softmap_edge.logs.readers.between import Between
from softmap_edge.logs.readers.cells import find_delimiter, is_number, is_plain, split
from softmap_edge.logs.readers.clock_cells import clocks_of
from softmap_edge.logs.readers.columns import Array, Cells, Declared, text_array
from softmap_edge.logs.readers.encoding import encoding_of, is_cut
from softmap_edge.logs.readers.ending import RECENT, cut_within, lines_below
from softmap_edge.logs.readers.header import Table, is_remark, widths_of
from softmap_edge.logs.readers.heads import names_again, refuse_rows_above, refuse_second_head
from softmap_edge.logs.readers.late_table import search
from softmap_edge.logs.readers.lines import blocks, first_lines, held_back
from softmap_edge.logs.readers.spellings import (
    hex_columns,
    spelling_remedy,
    with_exponents,
    with_minus,
    without_hex,
)
from softmap_edge.logs.readers.stated_rate import stated_rate
from softmap_edge.logs.readers.summaries import labelled
from softmap_edge.logs.readers.thousands import Marks, is_alike, marks_of, other_mark, unclear
from softmap_edge.logs.readers.thousands import plain as ungrouped
from softmap_edge.logs.readers.words import EMPTY, Words, is_text, is_word
from softmap_edge.logs.time_text import (
    TimeText,
    TimeTextError,
)

_HEADS = 60  # lines above the rows that are compared with the lines between them
NO_NUMBER = "; use one decimal mark and no marks between groups of digits, or export the log again"
_LISTED = 4  # columns that are named in a note
_FIRST = 200  # rows whose text decides the content of a column


@dataclass(frozen=True)
class TextColumns:
    """The columns of a text log with a known header."""

    path: Path
    names: list[str]
    first: int  # line number of the first row
    delimiter: str
    decimal: str
    skip_last: int = 0
    units: dict[str, str] = field(default_factory=dict)
    stated_rows: int | None = None  # number of rows that the head states
    declared: Declared = field(default_factory=lambda: Declared(odd_units={}))
    notes: tuple[str, ...] = ()
    where: str = "line"
    header: bool = True
    # number of cells of a full row without its empty last cells; None: the number of names
    fewest: int | None = None
    stop: int | None = None  # line number after the last row; None: the end of the file
    # columns of dates or times, read in s
    clocks: dict[int, TimeText] = field(default_factory=dict)
    words: Words = field(default_factory=Words)  # from the last reading
    head_line: int | None = None  # line number of the column names
    # lines above the rows without numbers; loggers repeat them
    head: tuple[str, ...] = ()
    grouped: str | None = None  # the separator of groups of three digits
    hexed: frozenset[int] = frozenset()  # columns of hexadecimal integers
    marks: Marks = field(default_factory=Marks)  # the findings in the first rows
    stated: bool = False  # whether the mapping states the decimal mark

    def texts(self, rows: int) -> dict[str, list[str]]:
        """Return the text columns of the first rows, with their text; times are not text."""
        found: dict[str, list[str]] = {}
        for place, (name, column) in enumerate(zip(self.names, zip(*self._first_rows(rows)))):
            if place in self.clocks:
                continue
            if is_text(column, is_number):
                found[name] = list(column)
        return found

    def _first_rows(self, rows: int) -> list[list[str]]:
        """Return the cells of the first rows that are full, without heads among them."""
        lines = [line for line in first_lines(self.path, rows, self.first) if line.strip()]
        cells = [split(self._fitted(with_minus(line)), self.delimiter) for line in lines]
        full = [row for row in cells if len(row) == len(self.names)]
        full = [row for row in full if not names_again(row, self.names)]
        return [row for row in full if not labelled(row, full)]

    def with_clocks(self, order: str | None) -> TextColumns:
        """Return a copy with its columns of dates and times identified.

        `order` (dmy, mdy) applies to dates like 5/7/2031.
        """
        clocks, hexed = clocks_of(self._first_rows, order), hex_columns(self._first_rows(_FIRST))
        if hexed:
            named = listed([self.names[place] for place in sorted(hexed)], _LISTED)
            note = f"hexadecimal numbers are read in {named}"
            return replace(self, hexed=hexed, notes=(*self.notes, note))._timed(clocks)
        return self._timed(clocks)

    def _timed(self, clocks: dict[int, TimeText]) -> TextColumns:
        """Return the same with known columns of dates and times."""
        units = {self.names[place]: "s" for place in clocks}
        return replace(self, clocks=clocks, units=self.units | units) if clocks else self

    def read(self, places: list[int], label: int | None = None, rows: int | None = None) -> Cells:
        """Return the cells of some columns; a column of times in s.

        Raises:
            RunError: a line and the header differ in number of cells, or a cell is not a number.
        """
        timed = [place for place in places if place in self.clocks]
        plain = [place for place in places if place not in self.clocks]
        asked = [*timed, *([] if label is None else [label])]
        parts: list[Array] = []
        lines: list[NDArray[np.int64]] = []
        times: dict[int, list[Array]] = {place: [] for place in timed}
        labels: list[str] = []
        known: dict[str, str] = {}  # one object for each distinct label
        count = 0
        self.words.found.clear()
        between, recent = Between(), list[str]()
        for first, block in held_back(blocks(self.path, self.first, self.stop), self.skip_last):
            numbers = np.arange(first, first + len(block))
            if not all(map(str.strip, block)):
                kept = [k for k, line in enumerate(block) if line.strip()]
                numbers, block = numbers[kept], [block[k] for k in kept]
            if block:
                block, numbers = between.rows(
                    block, numbers, self.head, self.delimiter, len(self.names)
                )
            if not block:
                continue
            recent = [*recent, *block[-RECENT:]][-RECENT:]
            cells, texts = self._block(block, numbers, plain, asked)
            parts.append(cells)
            lines.append(numbers)
            for place, column in zip(timed, texts):
                times[place].append(self._times(place, column, numbers))
            labels += (
                [known.setdefault(text, text) for text in texts[-1]] if label is not None else []
            )
            count += len(block)
            if rows is not None and count >= rows:
                break
        if not parts:
            raise RunError(
                f"{self.path}: holds no rows; give a log that holds data, or fewer skip_rows"
            )
        found = None if label is None else text_array(self.path, self.names[label], labels)
        at = np.concatenate(lines)
        blank = int(at[-1]) - self.first + 1 - count - sum(line < at[-1] for line in between.found)
        notes = (
            *self.notes,
            *((f"{blank} blank lines were left out",) if blank else ()),
            *between.lines(),
            *self._worded(count),
        )
        doubts = self._cut(recent, int(at[-1])) if rows is None and self.skip_last == 0 else ()
        doubts += self._contradicted()
        read = np.concatenate(parts)
        self._unclear(read, plain, int(at[-1]) - self.first + 1)
        table, more = self._joined(read, places, {k: np.concatenate(v) for k, v in times.items()})
        return Cells(table, found, at, (*notes, *more), doubts=doubts)

    def _cut(self, recent: list[str], line: int) -> tuple[str, ...]:
        """Return a doubt if the file ends, or seems to end, within its last cell."""
        if is_cut(self.path):
            return (
                f"the file was cut: it ends within a character of line {line}, and that row may "
                "be wrong: set skip_last_rows = 1 to leave it out",
            )
        last = cut_within(self.path, recent, self.delimiter)
        if last is None:
            return ()
        return (
            f"the file may be cut within its last cell: line {line} ends in '{last[:40]}' without "
            f"a line end, and is shorter there than the {len(recent) - 1} rows above: set "
            "skip_last_rows = 1 to leave the row out",
        )

    def both_orders(self, place: int) -> Array:
        """Return the seconds (rows, 2) of a date column in both day-month orders.

        Raises:
            RunError: a cell is not a date.
        """
        cells = self.read([], place)
        assert cells.labels is not None
        return self._times(place, cells.labels.tolist(), cells.lines)

    def dated(self, order: str) -> TextColumns:
        """Return a copy with a day-month order for dates that have none yet."""
        clocks = {
            place: replace(clock, order=clock.order or order) if clock.form == "local" else clock
            for place, clock in self.clocks.items()
        }
        return replace(self, clocks=clocks)

    def refuse_words(self, column: int) -> None:
        """Raise RunError if a column such as the time contains a word."""
        for (other, word), (_, line) in self.words.found.items():
            if other == column:
                raise RunError(
                    f"{self.path}: line {line}, column {self.names[column]}: '{word}' is not a "
                    f"number; {self._below(word) or 'correct or remove the line'}"
                )

    def _worded(self, rows: int) -> tuple[str, ...]:
        """Return the sentence on words in number columns; RunError if a column is text."""
        if (text := self.words.mostly(rows)) is not None:
            raise RunError(
                f"{self.path}: line {text[2]}, column {self.names[text[0]]}: '{text[1]}' is not a "
                "number; this column holds text: leave it out of the mapping, or name it as "
                "`block`"
            )
        return tuple(self.words.line(self.names, rows))

    def _times(self, place: int, cells: Sequence[str], lines: NDArray[np.int64]) -> Array:
        """Return the seconds (rows, 2) of a column of times, in both day-month orders."""
        try:
            return self.clocks[place].parse(
                ["" if cell.lower() in EMPTY else cell for cell in cells]
            )
        except TimeTextError as fault:
            line = int(lines[fault.args[1]])
            raise RunError(
                f"{self.path}: line {line}, column {self.names[place]}: {fault.args[0]}; correct "
                "or remove the line"
            ) from None

    def _joined(
        self, numbers: Array, places: list[int], times: dict[int, Array]
    ) -> tuple[Array, list[str]]:
        """Return numbers and times in the requested order, and notes on the times."""
        if not times:
            return numbers, []
        table, notes = np.empty((len(numbers), len(places))), list[str]()
        table[:, [j for j, place in enumerate(places) if place not in times]] = numbers
        for j, place in enumerate(places):
            if place not in times:
                continue
            try:
                table[:, j], note = self.clocks[place].settle(times[place])
            except TimeTextError as fault:
                remedy = 'set time.date_order = "dmy" or "mdy" in the mapping'
                raise RunError(
                    f"{self.path}: column {self.names[place]}: {fault.args[0]}; {remedy}"
                ) from None
            notes += [] if note is None else [f"{self.names[place]}: {note}"]
        return table, notes

    def _block(
        self, block: list[str], numbers: NDArray[np.int64], places: list[int], asked: list[int]
    ) -> tuple[Array, list[list[str]]]:
        if not all(map(str.isascii, block)):
            block = list(map(with_minus, block))
        if self.delimiter == " ":
            block = [" ".join(line.split()) for line in block]
        cut, mark = len(self.names) - 1, self.delimiter
        if any(line.count(mark) != cut for line in block):
            block = [self._fitted(line) for line in block]
        if hexed := [place for place in places if place in self.hexed]:
            block = without_hex(self.path, block, self.delimiter, hexed, numbers.tolist())
        cells = self._fast(block, places) if places else np.empty((len(block), 0))
        if cells is None or (
            asked and any('"' in line or line.count(mark) != cut for line in block)
        ):
            return self._slow(block, numbers, places, asked)
        if not asked:
            return cells, []
        rows = [line.split(mark) for line in block]
        return cells, [[row[place].strip() for row in rows] for place in asked]

    def _fitted(self, line: str) -> str:
        """Return a line with one cell per name; empty last cells may be added or missing."""
        cut, mark = len(self.names) - 1, self.delimiter
        if line.count(mark) == cut:
            return line
        bare = line.rstrip(mark + " \t\r")
        fewest = len(self.names) if self.fewest is None else self.fewest
        if '"' not in line and bare.count(mark) <= cut and line.count(mark) >= fewest - 1:
            return bare + mark * (cut - bare.count(mark))
        return line

    def _fast(self, block: list[str], places: list[int]) -> Array | None:
        """Parse a block with numpy's compiled reader; None if it fails or lines differ in cells."""
        cut, mark = len(self.names) - 1, self.delimiter
        if self.grouped == "." or "" in block or any(line.count(mark) != cut for line in block):
            return None
        if self.decimal == "," and any(
            "." in line and self._has_points(line, places) for line in block
        ):
            return None
        for attempt in range(2):
            if attempt:  # again, with empty cells as NaN, and with plain exponents
                text = with_exponents("\n" + "\n".join(block) + "\n")
                for old, new in ((mark * 2, f"{mark}nan{mark}"),) * 2 + (
                    (f"\n{mark}", f"\nnan{mark}"),
                ):
                    text = text.replace(old, new)
                block = text.replace(f"{mark}\n", f"{mark}nan\n")[1:-1].split("\n")
            elif self.decimal == ",":
                block = "\n".join(block).replace(",", ".").split("\n")
            try:
                cells = np.loadtxt(
                    block, delimiter=mark, usecols=places, comments=None, ndmin=2, dtype=float
                )
            except (ValueError, OverflowError):
                continue
            return cells if len(cells) == len(block) else None
        return None

    def _has_points(self, line: str, places: list[int]) -> bool:
        """Return whether a line has a decimal point in these columns of a decimal-comma log."""
        cells = line.split(self.delimiter)
        return any("." in cells[place] for place in places)

    def _slow(
        self, block: list[str], numbers: NDArray[np.int64], places: list[int], asked: list[int]
    ) -> tuple[Array, list[list[str]]]:
        try:
            rows = list(csv.reader(block, delimiter=self.delimiter, skipinitialspace=True))
        except csv.Error as cause:
            raise RunError(f"{self.path}: is not a CSV log ({cause}); export it again") from cause
        if len(rows) != len(block):
            raise RunError(
                f"{self.path}: a quoted cell runs over several lines; export the log without quotes"
            )
        cells = np.empty((len(rows), len(places)))
        for k, row in enumerate(rows):
            refuse_second_head(self.path, row, self.names, int(numbers[k]), self.header)
            self._complete(row, int(numbers[k]))
            for j, column in enumerate(places):
                cells[k, j] = self._number(row[column].strip(), int(numbers[k]), column)
        return cells, [[row[place].strip() for row in rows] for place in asked]

    def _complete(self, row: list[str], line: int) -> None:
        """Extend or cut a row to one cell per name; only empty last cells may differ."""
        full, count = len(self.names), len(row)
        while len(row) > full and not row[-1].strip():
            row.pop()
        if len(row) < full and count >= (full if self.fewest is None else self.fewest):
            row.extend([""] * (full - len(row)))
        if len(row) != full:
            raise RunError(
                f"{self.path}: line {line} has {count} cells, expected {full}; "
                f"{self._misfit(count, line)}"
            )

    def _misfit(self, count: int, line: int) -> str:
        """Return the remedy for a line whose number of cells differs from the number of names."""
        if line == self.first:
            return (
                "if the table begins in another line, set skip_rows to the number of lines above "
                "its names"
            )
        if count > len(self.names):
            return "cells of the line are not named: correct the line, or the delimiter"
        if below := self._below(None):
            return below
        return "the file may be cut short: remove the line, or set skip_last_rows"

    def _below(self, word: str | None) -> str:
        """Return the remedy for lines below the table; with `word`, only if one starts with it."""
        below = (
            lines_below(self.path, self.delimiter, len(self.names)) if self.skip_last == 0 else []
        )
        if not below or (
            word is not None and not any(line.lstrip('" ').startswith(word) for line in below)
        ):
            return ""
        lines = (
            "line at the end is not a row" if len(below) == 1 else "lines at the end are not rows"
        )
        return f"{len(below)} {lines} ('{below[0][:40]}'): set skip_last_rows = {len(below)}"

    def _number(self, cell: str, line: int, column: int) -> float:
        if cell.lower() in EMPTY:
            return np.nan
        other = other_mark(self.decimal)
        odd = is_alike(cell, other) and other not in self.marks.decimals
        mark = other if odd and self.stated else self.grouped
        if (
            mark is not None
            and mark != self.decimal
            and (whole := ungrouped(cell, mark)) is not None
        ):
            return float(whole)
        plain = with_exponents(cell.replace(",", ".") if self.decimal == "," else cell)
        if not odd and is_plain(plain):
            return float(plain)
        if is_word(cell):
            self.words.take(cell, column, line)
            return np.nan
        if not odd and (whole := ungrouped(cell, self.grouped)) is not None and is_plain(whole):
            return float(whole)
        raise RunError(
            f"{self.path}: line {line}, column {self.names[column]}: '{cell[:40]}' is not a number"
            f"{self._remedy(cell, odd)}"
        )

    def _remedy(self, cell: str, odd: bool) -> str:
        """Return the remedy for a cell that is not a number because of commas or points; else ""."""
        if odd and self.decimal in self.marks.decimals:
            return (
                "; if its digits are in groups of three, "
                f'set decimal = "{self.decimal}" in the mapping'
            )
        if "," not in cell:
            return NO_NUMBER if odd else spelling_remedy(cell)
        comma = self.decimal == "." and "." not in self.marks.decimals and is_number(cell)
        if comma:
            return '; set decimal = "," in the mapping'
        return spelling_remedy(cell) or NO_NUMBER

    def _contradicted(self) -> tuple[str, ...]:
        """Return a doubt if the mapping's decimal mark only separates digit groups in the log."""
        other, cell = other_mark(self.decimal), self.marks.alike.get(self.decimal)
        if (
            not self.stated
            or cell is None
            or self.decimal in self.marks.decimals
            or other not in self.marks.decimals
        ):
            return ()
        return (
            f"numbers such as '{cell}' are read as {cell.replace(',', '.')}, for the mapping "
            f"states decimal = \"{self.decimal}\", but other cells have '{other}' as their "
            f"decimal mark: leave decimal out to read {cell.replace(self.decimal, '')}",
        )

    def _unclear(self, numbers: Array, places: Sequence[int], count: int) -> None:
        """Raise RunError if a column of (rows, columns) may hold decimals or grouped integers.

        Groups have three digits.
        """
        if self.stated or self.decimal in self.marks.decimals or self.grouped is not None:
            return
        for j, place in enumerate(places):
            known = numbers[np.isfinite(numbers[:, j]), j]
            part = known[known != np.rint(known)]
            if not len(part) or np.abs(known).max() >= 1000.0 or np.abs(part).min() < 1.0:
                continue
            if np.abs(1e3 * part - np.rint(1e3 * part)).max() > 1e-6:
                continue
            cells = [row[place] for row in self._first_rows(count) if len(row) > place]
            if (cell := unclear(cells, self.decimal)) is None:
                continue
            small, large = cell.replace(",", "."), cell.replace(self.decimal, "")
            raise RunError(
                f"{self.path}: column {self.names[place]}: '{cell}' may be {small} or {large}, "
                "and no cell of the log "
                f'shows its decimal mark: set decimal = "{self.decimal}" in the mapping to read '
                f'{small}, or decimal = "{other_mark(self.decimal)}" to read {large}'
            )


# --- the head ------------------------------------------------------------------------------
def open_text(
    path: Path,
    delimiter: str | None,
    decimal: str | None,
    header: bool | None,
    skip_rows: int,
    skip_last: int,
    order: str | None = None,
) -> TextColumns:
    """Find the table of a text log; None for an argument means automatic.

    Args:
        path: the log.
        delimiter: the separator of cells.
        decimal: `.` or `,`.
        header: whether a line names the columns.
        skip_rows: lines to skip above the table.
        skip_last: rows to leave out at the end.
        order: `dmy` or `mdy` for dates such as 5/7/2031; None: the rows decide.

    Raises:
        RunError: the file is absent, too large, not text, empty, or lacks an expected header.
    """
    found = search(path, delimiter, skip_rows)
    start, table, skip_rows = found.lines, found.table, found.skipped
    at = next(k for k, line in enumerate(start) if not is_remark(line))
    if table is None:  # no line of numbers: assume that the first line holds the names
        cut = delimiter or find_delimiter(start[at])
        names = split(start[at], cut)
        table = Table(cut, names, at + 1, at, len(names), len(names))
    refuse_rows_above(path, start, table, skip_rows)
    if header is not False and table.names is None and (header or table.clash is not None):
        raise RunError(f"{path}: {_no_names(start, table, skip_rows)}")
    first, names = table.first, table.names or []
    if header is False or table.names is None:
        first = (
            table.header
            if table.header is not None and _is_row(start[table.header], table)
            else table.first
        )
        names = [str(k) for k in range(table.width)]
    head = start[: first if table.header is None else table.header]
    skipped = found.hidden + sum(not is_remark(line) for line in head)
    notes = [f"lines above the table were skipped: {skipped}"] if skipped else []
    notes += ["the line below the header is units"] if table.units and header is not False else []
    if table.fewest < table.width:
        notes.append(
            f"rows of {table.fewest} to {table.width - 1} cells, as there are many, end in empty "
            "cells"
        )
    notes += [note] if (note := encoding_of(path)[1]) is not None else []
    named = header is not False and table.names is not None
    columns = TextColumns(
        path,
        names,
        skip_rows + 1 + first,
        table.delimiter,
        decimal or ".",
        skip_last,
        notes=tuple(notes),
        header=named,
    )
    columns = replace(
        columns,
        units=table.units if named else {},
        declared=Declared(odd_units=table.stated if named else {}),
        fewest=min(table.fewest, len(names)),
    )
    if named and table.header is not None:
        columns = replace(columns, head_line=skip_rows + 1 + table.header)
    above = [
        line for line in start[:first] if any(map(str.isalpha, line)) and not _is_row(line, table)
    ]
    columns = replace(columns, head=tuple(above[-_HEADS:]) if named else ())
    rate = stated_rate(columns.head)
    named_rate = None if rate is None else ("a rate of", rate)
    columns = replace(columns, declared=replace(columns.declared, rate=named_rate))
    return _marked(columns, start[first : first + _FIRST], decimal).with_clocks(order)


def _marked(columns: TextColumns, rows: list[str], decimal: str | None) -> TextColumns:
    """Return the columns with the decimal and group marks found in the first rows."""
    marks = marks_of(cell for row in rows for cell in split(with_minus(row), columns.delimiter))
    notes, found = list(columns.notes), decimal or "."
    if decimal is None and "." not in marks.decimals and "," not in marks.groups:
        found = (
            "," if "." in marks.groups or "," in marks.decimals or [*marks.alike] == [","] else "."
        )
        notes += ["numbers have decimal commas"] if found == "," else []
    known = found in marks.decimals or decimal is not None or bool(marks.groups)
    mark, example = marks.grouped(found) or (None, "") if known else (None, "")
    notes += [] if mark is None else [f"digits are in groups of three, such as '{example}'"]
    return replace(
        columns,
        decimal=found,
        grouped=mark,
        marks=marks,
        stated=decimal is not None,
        notes=tuple(notes),
    )


def _no_names(start: list[str], table: Table, skipped: int) -> str:
    """Return why no line names the columns, and the remedy."""
    row, cut = skipped + 1 + table.first, table.delimiter
    if table.clash is None and not any(line.strip() for line in start[: table.first]):
        cells = [cell for cell in split(start[table.first], cut) if cell]
        numbers = sum(map(is_number, cells))
        return (
            f"has no header line: line {row} looks like a row, not like names ({numbers} of "
            f"{len(cells)} cells are numbers); set header = false and give column numbers"
        )
    widths = widths_of(start[: table.first + 1], cut)
    return (
        f"no line above the table names its {table.width} columns: the first lines differ in "
        f"width ({widths}), and the table seems to begin in line {row}: set skip_rows = {row - 1} "
        "and header = false, and give column numbers"
    )


def _is_row(line: str, table: Table) -> bool:
    """Return whether a line of names holds mostly numbers."""
    cells = [cell for cell in split(line, table.delimiter) if cell]
    return 2 * sum(map(is_number, cells)) > len(cells)
