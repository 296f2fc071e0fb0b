"""Reads a delimited text log (CSV and its cousins) block by block; what cannot be read is named with its line.

Found by itself: the delimiter, comments above the header, a header that is a comment (as numpy writes it), a line of
units below it, decimal commas, blank lines. Each block of lines goes through numpy's compiled reader, with empty cells
as NaN; only where that stumbles are its lines read one by one, to say where. So a million rows of 16 columns need
seconds and little more memory than their numbers (tests/test_import_csv.py, `python -m benches.import_rows`).
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.logs.mapping import ANGLE, LENGTH, TIME
from softmap_edge.logs.readers.columns import Array, Cells
from softmap_edge.logs.readers.words import EMPTY, Words, is_text, is_word

LIMIT = 2**30  # bytes of one log: about 5 million rows of 16 columns
LONGEST = 2**20  # characters of one line: 50 000 columns
_BLOCK = 2**22  # characters read at a time
_HEAD = 1000  # lines in which a header must be
_COMMA_NUMBER = re.compile(r"[+-]?\d+(,\d+)?([eE][+-]?\d+)?")
_DELIMITERS = (",", ";", "\t", "|")
_OTHERS = ("", "-", "°", "°c", "degrees", "radians", "n", "ma", "a", "g", "kg")
_UNITS = {*LENGTH, *TIME, *ANGLE, *_OTHERS}  # what a line of units holds


@dataclass(frozen=True)
class TextColumns:
    """The columns of a text log whose head is known."""

    path: Path
    names: list[str]
    first: int  # the line number of the first row
    delimiter: str
    decimal: str
    skip_last: int = 0
    units: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    where: str = "line"
    header: bool = True
    words: Words = field(default_factory=Words)  # of the last reading

    def texts(self, rows: int) -> dict[str, list[str]]:
        """Return the columns that hold text in the first rows, with that text."""
        lines = [line for line in first_lines(self.path, rows, self.first) if line.strip()]
        cells = [row for line in lines if len(row := split(line, self.delimiter)) == len(self.names)]
        found: dict[str, list[str]] = {}
        for name, column in zip(self.names, zip(*cells)):
            if is_text(column, is_number):
                found[name] = list(column)
        return found

    def read(self, places: list[int], label: int | None = None, rows: int | None = None) -> Cells:
        """Return the cells of some columns.

        Raises:
            RunError: a line has another number of cells than the header, or a cell is not a number.
        """
        parts: list[Array] = []
        lines: list[NDArray[np.int64]] = []
        labels: list[str] = []
        known: dict[str, str] = {}  # one object for each distinct label
        count = 0
        self.words.found.clear()
        for first, block in _held_back(_blocks(self.path, self.first), self.skip_last):
            numbers = np.arange(first, first + len(block))
            if not all(map(str.strip, block)):
                kept = [k for k, line in enumerate(block) if line.strip()]
                numbers, block = numbers[kept], [block[k] for k in kept]
            if not block:
                continue
            cells, texts = self._block(block, numbers, places, label)
            parts.append(cells)
            lines.append(numbers)
            labels += [known.setdefault(text, text) for text in texts]
            count += len(block)
            if rows is not None and count >= rows:
                break
        if not parts:
            raise RunError(f"{self.path}: holds no rows; give a log that holds data, or fewer skip_rows")
        found = np.array(labels) if label is not None else None
        at = np.concatenate(lines)
        blank = int(at[-1]) - self.first + 1 - count
        said = (*self.notes, *((f"{blank} blank lines were left out",) if blank else ()))
        said += self._worded(count)
        return Cells(np.concatenate(parts), found, at, said)

    def refuse_words(self, column: int) -> None:
        """Raise RunError if a column that was read, such as the time, holds a word."""
        for (other, word), (_, line) in self.words.found.items():
            if other == column:
                raise RunError(
                    f"{self.path}: line {line}, column {self.names[column]}: '{word}' is not a number; correct or "
                    "remove the line"
                )

    def _worded(self, rows: int) -> tuple[str, ...]:
        """Return the sentence on words in columns of numbers; raise RunError where a column holds text."""
        if (text := self.words.mostly(rows)) is not None:
            raise RunError(
                f"{self.path}: line {text[2]}, column {self.names[text[0]]}: '{text[1]}' is not a number; this column "
                "holds text: leave it out of the mapping, or name it as `block`"
            )
        return tuple(self.words.line(self.names, rows))

    def _block(
        self, block: list[str], numbers: NDArray[np.int64], places: list[int], label: int | None
    ) -> tuple[Array, list[str]]:
        if self.delimiter == " ":
            block = [" ".join(line.split()) for line in block]
        cells = self._fast(block, places) if places else np.empty((len(block), 0))
        if cells is None or (label is not None and any('"' in line for line in block)):
            return self._slow(block, numbers, places, label)
        if label is None:
            return cells, []
        return cells, [line.split(self.delimiter)[label].strip() for line in block]

    def _fast(self, block: list[str], places: list[int]) -> Array | None:
        """A block by numpy's compiled reader; None where it stumbles or lines differ in cells."""
        cut, mark = len(self.names) - 1, self.delimiter
        if any(line.count(mark) != cut for line in block):
            return None
        for attempt in range(2):
            if attempt:  # once more with empty cells as NaN
                text = "\n" + "\n".join(block) + "\n"
                for old, new in ((mark * 2, f"{mark}nan{mark}"),) * 2 + ((f"\n{mark}", f"\nnan{mark}"),):
                    text = text.replace(old, new)
                block = text.replace(f"{mark}\n", f"{mark}nan\n")[1:-1].split("\n")
            elif self.decimal == ",":
                block = "\n".join(block).replace(",", ".").split("\n")
            try:
                cells = np.loadtxt(block, delimiter=mark, usecols=places, comments=None, ndmin=2, dtype=float)
            except (ValueError, OverflowError):
                continue
            return cells if len(cells) == len(block) else None
        return None

    def _slow(
        self, block: list[str], numbers: NDArray[np.int64], places: list[int], label: int | None
    ) -> tuple[Array, list[str]]:
        try:
            rows = list(csv.reader(block, delimiter=self.delimiter, skipinitialspace=True))
        except csv.Error as cause:
            raise RunError(f"{self.path}: is not a CSV log ({cause}); export it again") from cause
        if len(rows) != len(block):
            raise RunError(f"{self.path}: a quoted cell runs over several lines; export the log without quotes")
        cells, labels = np.empty((len(rows), len(places))), list[str]()
        for k, row in enumerate(rows):
            if len(row) != len(self.names):
                raise RunError(
                    f"{self.path}: line {numbers[k]} has {len(row)} cells, expected {len(self.names)}; the file may "
                    "be cut short: remove the line, or set skip_last_rows"
                )
            for j, column in enumerate(places):
                cells[k, j] = self._number(row[column].strip(), int(numbers[k]), column)
            if label is not None:
                labels.append(row[label].strip())
        return cells, labels

    def _number(self, cell: str, line: int, column: int) -> float:
        if cell.lower() in EMPTY:
            return np.nan
        try:
            return float(cell.replace(",", ".") if self.decimal == "," else cell)
        except ValueError:
            if is_word(cell):
                self.words.take(cell, column, line)
                return np.nan
            hint = '; set decimal = "," in the mapping' if "," in cell else ""
            raise RunError(
                f"{self.path}: line {line}, column {self.names[column]}: '{cell[:40]}' is not a number{hint}"
            ) from None


# --- the head ------------------------------------------------------------------------------
def open_text(
    path: Path, delimiter: str | None, decimal: str | None, header: bool | None, skip_rows: int, skip_last: int
) -> TextColumns:
    """Find the header of a text log; what is None is found.

    Raises:
        RunError: the file is absent, too large, not text, empty, or has no header where one is expected.
    """
    start = first_lines(path, _HEAD, skip_rows + 1)
    at = comment = 0
    while at < len(start) and (not start[at].strip() or start[at].lstrip()[0] in "#%"):
        comment = at + 1 if start[at].strip() else comment
        at += 1
    if at == len(start):
        raise RunError(f"{path}: holds no lines after {skip_rows} skipped ones; give a log that holds data")
    cut = delimiter or find_delimiter(start[at])
    above = split(start[comment - 1].lstrip("#% \t"), cut) if comment else []
    bare = all(is_number(cell) for cell in split(start[at], cut) if cell)  # the first line is numbers
    named = bare and len(above) == len(split(start[at], cut)) and not all(map(is_number, above))
    if header and bare and not named:
        raise RunError(
            f"{path}: has no header line (the first line is numbers); set header = false and give column numbers"
        )
    head = above if named else split(start[at], cut)
    body = at if named or header is False or (header is None and bare) else at + 1
    names = head if named or body > at else [str(k) for k in range(len(head))]
    columns = TextColumns(path, names, skip_rows + 1 + body, cut, decimal or ".", skip_last, header=body > at or named)
    return _below(columns, start[body : body + 20], found_decimal=decimal is None)


def _below(columns: TextColumns, rows: list[str], found_decimal: bool) -> TextColumns:
    """What the first rows tell: a line of units, a delimiter at the end of each line, decimal commas."""
    cut, names = columns.delimiter, columns.names
    first = split(rows[0], cut) if rows else []
    texts = [cell.strip("[]()").lower() for cell in first]
    if len(first) == len(names) and any(texts) and all(text in _UNITS for text in texts):
        units = {name: text for name, text in zip(names, texts) if text}
        columns = replace(columns, units=units, first=columns.first + 1, notes=("the line below the header is units",))
        rows = rows[1:]
        first = split(rows[0], cut) if rows else []
    if len(first) == len(names) + 1 and not first[-1]:
        columns = replace(columns, names=[*names, ""])
    cells = [cell for row in rows for cell in split(row, cut)]
    commas = [cell for cell in cells if re.fullmatch(r"[+-]?\d*,\d+([eE][+-]?\d+)?", cell)]
    if found_decimal and cut != "," and commas and not any(re.fullmatch(r"[+-]?\d*\.\d+", cell) for cell in cells):
        columns = replace(columns, decimal=",", notes=(*columns.notes, "numbers have decimal commas"))
    return columns


def split(line: str, delimiter: str) -> list[str]:
    """Return the cells of one line, stripped; [] where it is no CSV."""
    try:
        if delimiter == " ":
            line = " ".join(line.split())
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])]
    except csv.Error:
        return []


def find_delimiter(line: str) -> str:
    """Return what cuts a line into most cells; a space only where nothing else does.

    Between numbers with decimal commas there are more commas than delimiters: what leaves such numbers whole, cuts.
    """
    for mark in (";", "\t", "|", " "):
        cells = [cell for cell in split(line, mark) if cell] if "," in line else []
        if len(cells) > 1 and all(_COMMA_NUMBER.fullmatch(cell) for cell in cells):
            return mark
    best = max(_DELIMITERS, key=line.count)
    return best if best in line else (" " if " " in line.strip() else ",")


def is_number(cell: str) -> bool:
    """Whether a cell is a number, with a decimal point or comma."""
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


# --- the lines -----------------------------------------------------------------------------
def first_lines(path: Path, count: int, first: int = 1) -> list[str]:
    """Return at most `count` lines of a text log from line `first` on."""
    found: list[str] = []
    for _, lines in _blocks(path, first):
        found += lines[: count - len(found)]
        if len(found) == count:
            break
    return found


def _blocks(path: Path, first: int) -> Iterator[tuple[int, list[str]]]:
    """The lines from number `first` on, some thousand at a time, with the number of the first of them."""
    number, rest = 1, ""
    try:
        if not path.is_file():
            raise RunError(f"{path}: {'a folder' if path.is_dir() else 'cannot be read'}; give the path of a log")
        if path.stat().st_size > LIMIT:
            raise RunError(f"{path}: {path.stat().st_size} bytes, at most {LIMIT} are read; split the log")
        with path.open(encoding="utf-8-sig") as file:
            while text := file.read(_BLOCK):
                if "\0" in text:
                    raise RunError(f"{path}: holds zero bytes; the file is damaged or not a CSV log")
                lines = (rest + text).split("\n")
                rest = lines.pop()
                if len(rest) > LONGEST:
                    raise RunError(
                        f"{path}: line {number + len(lines)} is longer than {LONGEST} characters; export again"
                    )
                if number + len(lines) > first:
                    yield max(number, first), lines[max(first - number, 0) :]
                number += len(lines)
    except OSError as cause:
        raise RunError(f"{path}: cannot be read ({cause.strerror or cause}); give the path of a log") from cause
    except UnicodeDecodeError as cause:
        if b"\0" in cause.object:
            raise RunError(f"{path}: is not text; give the log of a recording, as CSV") from cause
        raise RunError(f"{path}: is not text in UTF-8 (byte {cause.start} of a part); save the log as UTF-8") from cause
    if rest.strip() and number >= first:
        yield number, [rest]


def _held_back(blocks: Iterator[tuple[int, list[str]]], count: int) -> Iterator[tuple[int, list[str]]]:
    """The same lines without the last `count` that are not blank."""
    held: list[str] = []
    start = 1
    for first, lines in blocks:
        start = start if held else first
        held += lines
        if count == 0:
            yield start, held
            held = []
        elif len(held) > 2 * count:  # blank lines at the end are not counted among them
            yield start, held[:-count]
            start, held = start + len(held) - count, held[-count:]
    while count and held and not held[-1].strip():
        held.pop()
    if count and len(held) > count:
        yield start, held[:-count]
