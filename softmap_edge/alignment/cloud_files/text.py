"""Read a cloud in text form: CSV of any dialect, XYZ, PTS, COLMAP's points3D, OBJ vertices.

The dialect is the one in which most lines hold three or more numbers. The lines above the first
such line are the header. The names of the columns are in the nearest header line that names axes,
which may be a comment or have another separator.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.alignment.cloud_files.columns import (
    COUNTS,
    FEW,
    NUMBERS,
    Triple,
    choose,
    names_places,
    no_coordinates,
)
from softmap_edge.errors import RegistrationError, brief
from softmap_edge.logs.readers.cells import is_plain

Floats = NDArray[np.float64]

MOST_POINTS = 10_000_000
_SAMPLE_BYTES, _SAMPLE_LINES = 1 << 20, 2000  # from which dialect and columns are decided
_MOST_COLUMNS = 200  # that are tested
_MARKS = ("#", "//", "%")  # of comments
_SEPARATORS = (";", "\t", ",", None)
_UNSEEN = {
    "",
    "-",
    "--",
    "na",
    "n/a",
    "#n/a",
    "null",
    "none",
    "nan(ind)",
    "-nan(ind)",
    "1.#qnan",
    "-1.#ind",
}


@dataclass(frozen=True)
class _Dialect:
    """How a line is split into cells: the separator (None: blanks), and whether 1,5 is a number."""

    separator: str | None
    comma: bool

    def cells(self, line: str) -> list[str]:
        cells = line.split(self.separator, _MOST_COLUMNS)[:_MOST_COLUMNS]
        return [cell.replace(",", ".") for cell in cells] if self.comma else cells


_DIALECTS = [
    _Dialect(mark, comma)
    for mark in _SEPARATORS
    for comma in (False, True)
    if not (comma and mark == ",")
]


def read_text(path: Path, notes: list[str]) -> Floats:
    """Return the points (M, 3) mm of a text file; NaN for cells that stand for "not seen".

    Args:
        path: the file.
        notes: receives a sentence for each choice of columns.

    Raises:
        RegistrationError: no three columns of numbers, or more than MOST_POINTS rows.
    """
    encoding = _encoding(path)
    lines = _first_lines(path, encoding)
    if sum(line.startswith("v ") for line in lines) > len(lines) // 4:
        return _numbers(path, encoding, _Dialect(None, False), 0, (1, 2, 3), vertices=True)
    dialect, first = _found(lines, path)
    rows = [dialect.cells(line) for line in lines[first:] if not _is_comment(line)]
    sample = _sample(rows)
    names = _fitted(_header(lines[:first], dialect, max(map(len, rows))), sample)
    columns, sentence = choose(names, sample, str(path))
    if sentence:
        notes.append(f"{path.name}: {sentence}")
    return _numbers(path, encoding, dialect, first, columns)


def _encoding(path: Path) -> str:
    with path.open("rb") as file:
        head = file.read(_SAMPLE_BYTES)
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "utf-16"
    if b"\0" in head:
        raise RegistrationError(
            f"{path}: neither text nor a known kind of cloud; save it as PLY, PCD or CSV"
        )
    return "utf-8-sig"


def _lines(path: Path, encoding: str) -> Iterator[str]:
    with path.open(encoding=encoding, errors="replace") as file:
        while line := file.readline(_SAMPLE_BYTES):  # a line has an end, or is cut
            yield line


def _first_lines(path: Path, encoding: str) -> list[str]:
    lines: list[str] = []
    left = _SAMPLE_BYTES
    for line in islice(_lines(path, encoding), _SAMPLE_LINES):
        lines.append(line)
        if (left := left - len(line)) <= 0:
            break
    return lines


def _is_comment(line: str) -> bool:
    return not line.strip() or line.lstrip().startswith(_MARKS)


def _found(lines: Sequence[str], path: Path) -> tuple[_Dialect, int]:
    """Return the dialect, and the number of the first line that holds a row of it."""
    some = [k for k, line in enumerate(lines) if not _is_comment(line)]
    best, most = None, 0
    for dialect in _DIALECTS:
        numbers = {k: sum(map(is_plain, dialect.cells(lines[k]))) for k in some}
        rows = [k for k, count in numbers.items() if count >= 3]
        if len(rows) > most:
            best, most = (dialect, rows[0]), len(rows)
    if best is None:
        raise RegistrationError(
            f"{path}: no columns x, y, z of numbers (no line of the first {len(lines)} holds "
            "three); export it again"
        )
    if _is_scan_table(lines, some):
        raise RegistrationError(
            f"{path}: a PTX file, whose scans have frames of their own; save it as PLY, PCD or XYZ"
        )
    return best


def _is_scan_table(lines: Sequence[str], some: Sequence[int]) -> bool:
    """Return whether a file begins as PTX does.

    A PTX file begins with two counts, four rows of three numbers, and a 4 × 4 matrix.
    """
    return [len(lines[k].split()) for k in some[:10]] == [1, 1, 3, 3, 3, 3, 4, 4, 4, 4]


def _value(cell: str) -> float:
    """Return the number in a cell, NaN for "not seen".

    Raises:
        ValueError: anything else.
    """
    text = cell.strip().strip('"')
    if text.lower() in _UNSEEN:
        return float("nan")
    if "_" in text:
        raise ValueError(f"could not convert string to float: {text[:40]!r}")
    return float(text.replace(",", "."))


def _sample(rows: Sequence[Sequence[str]]) -> Floats:
    """Return the cells of some rows as numbers; NaN if a cell holds none.

    There are as many columns as in the median row.
    """
    width = int(np.median([len(row) for row in rows]))
    values = np.full((len(rows), width), np.nan)
    for row, cells in zip(values, rows):
        row[: min(width, len(cells))] = [
            float(cell) if is_plain(cell) else np.nan for cell in cells[:width]
        ]
    # a separator at the end of each line
    while values.shape[1] > 3 and not np.isfinite(values[:, -1]).any():
        values = values[:, :-1]
    return values


def _header(lines: Sequence[str], dialect: _Dialect, width: int) -> list[str]:
    """Return the names in the nearest line above the rows that names axes.

    If there is none, return those of the nearest line with one name for each column.
    """
    split = [
        [_split(text, mark) for text in _texts(line) for mark in _order(dialect)]
        for line in reversed(lines)
    ]
    for ways in split:
        for names in ways:
            if len(names) >= 3 and names_places(names):
                return names
    fits = (
        names
        for ways in split
        for names in ways[:1]
        if 3 <= len(names) <= width and not is_plain(names[0])
    )
    return next(fits, [])


def _fitted(names: list[str], sample: Floats) -> list[str]:
    """Return the names of the columns, with one added for a first column of unnamed row numbers."""
    if len(names) == sample.shape[1] - 1 and no_coordinates(sample).get(0) in (
        COUNTS,
        NUMBERS,
        FEW,
    ):
        return ["", *names]
    return names


def _split(text: str, mark: str | None) -> list[str]:
    return text.split(mark) if mark is None else re.split(re.escape(mark), text)


def _texts(line: str) -> list[str]:
    """Return the parts of a line that may be names: the text after a colon, and the full line."""
    bare = _bare(line)
    _, colon, after = bare.rpartition(": ")
    return [after, bare] if colon else [bare]


def _order(dialect: _Dialect) -> list[str | None]:
    return [dialect.separator, *(mark for mark in _SEPARATORS if mark != dialect.separator)]


def _bare(line: str) -> str:
    return re.sub(r"^[#/%\s]+", "", line.strip().lstrip("\ufeff"))[:2000]


def _numbers(
    path: Path,
    encoding: str,
    dialect: _Dialect,
    first: int,
    columns: Triple,
    vertices: bool = False,
) -> Floats:
    """Return the three columns of all rows: fast for plain numbers, else cell by cell."""
    for convert in (None, _value):
        if convert is None and dialect.comma:
            continue
        lines = islice(_lines(path, encoding), first, None)
        rows = (line for line in lines if line.startswith("v ")) if vertices else lines
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of a file without rows; that is reported
                values = np.loadtxt(
                    islice(rows, MOST_POINTS + 1),
                    delimiter=dialect.separator,
                    usecols=columns,
                    ndmin=2,
                    comments=list(_MARKS),
                    converters=convert,
                )
        except (ValueError, IndexError, OverflowError) as error:
            fault = error
            continue
        if len(values) > MOST_POINTS:
            raise RegistrationError(f"{path}: more than {MOST_POINTS} points; thin it out")
        return np.asarray(values, np.float64)
    raise RegistrationError(
        f"{path}: no columns x, y, z of numbers ({brief(fault)}, lines counted from the first "
        "row); export it again"
    )
