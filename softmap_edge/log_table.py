"""Reads one CSV log as columns of numbers or text; what is missing or cut short is named with its line.

The whole table goes through numpy's compiled reader; only when that stumbles are the lines read one by one,
to say where, or to take empty cells as "not seen".
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.mapping import Column, Log

Array = NDArray[np.float64]
LIMIT = 2**30  # bytes of one log: about 5 million rows of 16 columns
LARGEST = 1e20  # of any cell, whatever its unit: times in nanoseconds since 1970 are 2e18
_ABSENT = {"", "nan", "na", "n/a", "null", "none", "-nan"}


@dataclass(frozen=True)
class LogTable:
    """The cells of one log that a mapping asks for."""

    path: Path
    t: Array  # (rows,) s
    names: list[str]
    values: dict[int, Array]
    labels: NDArray[Any] | None

    def numbers(self, columns: tuple[Column, ...]) -> Array:
        """Return (rows, len(columns)); absent cells are NaN."""
        return np.stack([self.values[place(self.path, self.names, column)] for column in columns], axis=1)

    def texts(self, column: Column) -> NDArray[Any]:
        """Return the (rows,) labels."""
        assert self.labels is not None
        return self.labels


def read_log(path: Path, log: Log) -> LogTable:
    """Read the columns of one log that the mapping names.

    Raises:
        RunError: the file is absent or too large, a column is missing, or a line cannot be read.
    """
    lines = _lines(path, log)
    delimiter = log.delimiter or _delimiter(lines[0])
    head = next(csv.reader([lines[0]], delimiter=delimiter), [])
    names = [name.strip() for name in head] if log.header else [str(k) for k in range(len(head))]
    if log.header and head and all(_is_number(name) for name in names):
        raise RunError(
            f"{path}: has no header line (the first line is numbers); set header = false and give column numbers"
        )
    body = lines[1:] if log.header else lines
    first = log.skip_rows + 1 + int(log.header)  # the line number of body[0]
    if log.skip_last_rows:
        body = body[: -log.skip_last_rows]
    if not body:
        raise RunError(f"{path}: holds no rows; give a log that holds data, or fewer skip_rows")
    wanted: list[Column] = [column for quantity in log.rows.values() for column in quantity.columns]
    wanted += list(log.markers.columns) if log.markers else []
    wanted += [] if log.clock.column is None else [log.clock.column]
    _all_there(path, names, [*wanted, *([] if log.block is None else [log.block])], lines[0], delimiter)
    places = sorted({place(path, names, column) for column in wanted})
    block = None if log.block is None else place(path, names, log.block)
    numbers = _fast(body, delimiter, places, log.decimal, len(names)) if block is None and places else None
    labels = None
    if numbers is None:
        numbers, labels = _slow(path, body, first, delimiter, places, block, names, log.decimal)
    _within_reason(path, numbers, places, names, first)
    values = dict(zip(places, numbers.T))
    count = (
        np.arange(len(body), dtype=float) if log.clock.column is None else values[place(path, names, log.clock.column)]
    )
    t = count * log.clock.seconds + log.clock.offset_s
    if not np.isfinite(t).all():
        row = int(np.flatnonzero(~np.isfinite(t))[0])
        raise RunError(f"{path}: line {first + row}: the time is empty or not a number; remove the line")
    if log.clock.repeated == "drop" and len(t) > 1:
        fresh = np.r_[True, t[1:] > np.maximum.accumulate(t)[:-1]]
        t, values = t[fresh], {k: column[fresh] for k, column in values.items()}
        labels = None if labels is None else labels[fresh]
    return LogTable(path, t, names, values, labels)


def _within_reason(path: Path, numbers: Array, places: list[int], names: list[str], first: int) -> None:
    wild = np.abs(numbers) > LARGEST  # infinity as well; NaN is an absent cell
    if wild.any():
        row, j = (int(i) for i in np.argwhere(wild)[0])
        raise RunError(
            f"{path}: line {first + row}, column {names[places[j]]}: {numbers[row, j]:g} is no measurement; "
            "correct or remove the line"
        )


def place(path: Path, names: list[str], column: Column) -> int:
    """Return the position of a column given by name or by number.

    Raises:
        RunError: there is no such column.
    """
    if isinstance(column, int):
        if 0 <= column < len(names):
            return column
        raise RunError(f"{path}: no column number {column}; there are {len(names)}, counted from 0")
    if column in names:
        return names.index(column)
    raise RunError(f"{path}: no column '{column[:60]}'; there are {', '.join(names)[:200]}")


def _lines(path: Path, log: Log) -> list[str]:
    try:
        if path.stat().st_size > LIMIT:
            raise RunError(f"{path}: {path.stat().st_size} bytes, at most {LIMIT} are read; split the log")
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as cause:
        raise RunError(f"{path}: cannot be read ({cause.strerror or cause}); give the path of a CSV log") from cause
    except UnicodeDecodeError as cause:
        raise RunError(f"{path}: byte {cause.start} is not text; give a CSV log in UTF-8") from cause
    if "\0" in text:
        raise RunError(f"{path}: holds zero bytes; the file is damaged or not a CSV log")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")[log.skip_rows :]
    while lines and not lines[-1].strip():
        lines.pop()
    if not lines:
        raise RunError(f"{path}: holds no lines after {log.skip_rows} skipped ones; give a log that holds data")
    return lines


def _delimiter(line: str) -> str:
    """The delimiter that cuts the first line into most cells."""
    return max((",", ";", "\t", "|", " "), key=line.count)


def _all_there(path: Path, names: list[str], wanted: list[Column], line: str, delimiter: str) -> None:
    missing = [c for c in wanted if (c not in names if isinstance(c, str) else not 0 <= c < len(names))]
    if not missing:
        return
    listed = ", ".join(str(column)[:40] for column in dict.fromkeys(missing[:8]))
    hint = ""
    other = _delimiter(line)
    if len(names) == 1 and other != delimiter and line.count(other):
        hint = f"; the file seems to be cut by '{other}', not by '{delimiter}'"
    if line.lstrip().startswith("#"):
        hint = "; the line read as header is a comment: set skip_rows to the number of lines above the header"
    raise RunError(f"{path}: no column {listed}; there are {', '.join(names)[:200]}{hint}; change the mapping")


def _fast(body: list[str], delimiter: str, places: list[int], decimal: str, width: int) -> Array | None:
    """The whole table by numpy's compiled reader; None where it stumbles or lines differ in cells."""
    cut = width - 1
    if any(line.count(delimiter) != cut for line in body):
        return None
    text = "\n".join(body)
    if '"' in text:
        return None
    if decimal == ",":
        text = text.replace(",", ".")
    try:
        return np.loadtxt(io.StringIO(text), delimiter=delimiter, usecols=places, comments=None, ndmin=2, dtype=float)
    except (ValueError, OverflowError):
        return None


def _slow(
    path: Path,
    body: list[str],
    first: int,
    delimiter: str,
    places: list[int],
    block: int | None,
    names: list[str],
    decimal: str,
) -> tuple[Array, NDArray[Any] | None]:
    numbers = np.empty((len(body), len(places)))
    labels: list[str] = []
    try:
        rows = list(csv.reader(body, delimiter=delimiter, skipinitialspace=True))
    except csv.Error as cause:
        raise RunError(f"{path}: is not a CSV log ({cause}); export it again") from cause
    if len(rows) != len(body):
        raise RunError(f"{path}: a quoted cell runs over several lines; export the log without quotes")
    for k, cells in enumerate(rows):
        if len(cells) != len(names):
            raise RunError(
                f"{path}: line {first + k} has {len(cells)} cells, expected {len(names)}; the file may "
                "be cut short: "
                "remove the line, or set skip_last_rows"
            )
        for j, column in enumerate(places):
            cell = cells[column].strip()
            if cell.lower() in _ABSENT:
                numbers[k, j] = np.nan
                continue
            try:
                numbers[k, j] = float(cell.replace(",", ".") if decimal == "," else cell)
            except ValueError:
                hint = '; set decimal = "," in the mapping' if "," in cell else ""
                raise RunError(
                    f"{path}: line {first + k}, column {names[column]}: '{cell[:40]}' is not a number{hint}"
                ) from None
        if block is not None:
            labels.append(cells[block].strip())
    return numbers, np.array(labels) if block is not None else None


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True
