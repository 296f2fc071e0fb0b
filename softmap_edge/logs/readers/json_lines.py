"""Read JSON Lines: one object a line, whose keys are the columns.

Objects and lists within it become columns of their own: `tip.x`, `u[0]`. A key that is missing in a
line is an empty cell. The lines are written as rows of cells to a temporary file, each row in the
line of its object, and read from there as any text log (`text.py`): dates, words and missing values
count as they do there. Numbers keep their digits, and text that is a number is one. Pinned by
tests/logs/test_json_lines.py.
"""

from __future__ import annotations

import json
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from softmap_edge.errors import RunError
from softmap_edge.logs.readers.cells import is_number
from softmap_edge.logs.readers.columns import Cells
from softmap_edge.logs.readers.lines import LIMIT, lines_of
from softmap_edge.logs.readers.packed import Unpacked
from softmap_edge.logs.readers.text import TextColumns

MOST_COLUMNS = 4096
DEEPEST = 8  # levels of objects and lists in a line
_PLAIN = re.compile(r"[\w.:+/-][\w .:+/-]*")  # texts that need no quotes
_OBJECT = re.compile(r'\s*\{\s*"(?:[^"\\]|\\.)*"\s*:')
WAY_OUT = (
    "write one object a line, with the columns of one row "
    "(`jq -c '.[]' FILE > NEW.jsonl` does so for a list of objects), or CSV"
)


class _Number(str):
    """The digits of a number, as the file has them."""

    __slots__ = ()


@dataclass(frozen=True)
class JsonColumns(TextColumns):
    """The columns of JSON Lines; `path` is the temporary file, `log` the one that errors name."""

    log: Path = Path()
    keep: Unpacked | None = None

    def read(self, places: list[int], label: int | None = None, rows: int | None = None) -> Cells:
        """Return the cells of some columns; a column of times in s.

        Raises:
            RunError: as `TextColumns.read`.
        """
        with _called(self.path, self.log):
            return super().read(places, label, rows)


@contextmanager
def _called(file: Path, path: Path) -> Iterator[None]:
    """Make errors show the log, not the temporary file."""
    try:
        yield
    except RunError as fault:
        raise RunError(str(fault).replace(str(file), str(path))) from None


def is_json_lines(start: str) -> bool:
    """Return whether a file with this start has a JSON object in its first line."""
    line, end = _first_line(start)
    if not end or not line.startswith("{"):
        return _OBJECT.match(line) is not None
    return _holds(line, dict)


def is_json(start: str) -> bool:
    """Return whether a file with this start is a JSON document of several lines, or lists."""
    line, end = _first_line(start)
    begins = _OBJECT.match(start) is not None or re.match(r"\s*\[\s*[\[{]", start) is not None
    return begins or (end and line.startswith("[") and _holds(line, list))


def _first_line(start: str) -> tuple[str, bool]:
    """Return the first line of a file that is not blank, and whether its end is known."""
    line, end, _ = start.lstrip("\ufeff \t\r\n").partition("\n")
    return line, bool(end)


def _holds(line: str, kind: type) -> bool:
    """Return whether a line is a JSON value of a kind."""
    try:
        return isinstance(json.loads(line, parse_int=_Number), kind)
    except RecursionError:
        return True
    except ValueError:
        return False


def open_json_lines(path: Path, skip_rows: int, skip_last: int, order: str | None) -> TextColumns:
    """Open a log of JSON Lines.

    Args:
        path: the log.
        skip_rows: lines to leave out at the beginning.
        skip_last: rows to leave out at the end.
        order: `dmy` or `mdy` for dates such as 5/7/2031; None: the rows decide.

    Raises:
        RunError: a line is not an object, nests too deep, or has a key twice; or there is no room.
    """
    keep = Unpacked(Path(tempfile.mkdtemp(prefix="softmap-")) / f"{path.stem}.csv")
    names: dict[str, int] = {}
    try:
        with keep.file.open("w", encoding="utf-8", newline="\n") as file:
            fewest, notes = _write(path, file, names)
    except OSError as cause:
        raise RunError(
            f"{path}: cannot be written as a table ({cause.strerror or cause}); free some disk "
            "space"
        ) from cause
    if not names:
        raise RunError(f"{path}: its objects hold no values; give a log that holds data")
    columns = JsonColumns(
        keep.file,
        list(names),
        skip_rows + 1,
        ",",
        ".",
        skip_last,
        fewest=fewest,
        notes=notes,
        stated=True,
        log=path,
        keep=keep,
    )
    with _called(keep.file, path):
        return columns.with_clocks(order)


def _write(path: Path, file: TextIO, names: dict[str, int]) -> tuple[int, tuple[str, ...]]:
    """Write the rows of a log; collect its names.

    Returns:
        The cells of the shortest row, and notes.
    """
    fewest, written, count = MOST_COLUMNS, 0, 0
    room = min(LIMIT, shutil.disk_usage(Path(file.name).parent).free // 2)
    fault: RunError | None = None  # of the last line: it may have been cut
    for number, line in lines_of(path):
        if not (bare := line.strip("\ufeff \t\r")):
            file.write("\n")
            continue
        if fault is not None:
            raise fault
        try:
            row = _row(path, number, bare, names)
        except json.JSONDecodeError as cause:
            fault = RunError(
                f"{path}: line {number}, character {cause.pos + 1}: is not a JSON object "
                f"({cause.msg}); remove the line, or {WAY_OUT}"
            )
            continue
        text = ",".join(row) or "nan"
        count, fewest, written = count + 1, min(fewest, max(len(row), 1)), written + len(text) + 1
        if written > room:
            raise RunError(
                f"{path}: needs more than {room} bytes as a table (at most {LIMIT}, and half of the "
                "free disk); split it"
            )
        file.write(f"{text}\n")
    if fault is not None and not count:
        raise fault
    if count == 1:
        raise RunError(f"{path}: holds one JSON object, so no rows of a table; {WAY_OUT}")
    notes = [f"JSON Lines: the keys of {count} objects are {len(names)} columns"]
    notes += [] if fault is None else ["the last line is not a complete object and was left out"]
    return fewest, tuple(notes)


def _row(path: Path, number: int, line: str, names: dict[str, int]) -> list[str]:
    """Return the cells of one line; new names are added."""

    def paired(pairs: list[tuple[str, object]]) -> dict[str, object]:
        found = dict(pairs)
        if len(found) < len(pairs):
            keys = [key for key, _ in pairs]
            twice = next(key for key in keys if keys.count(key) > 1)
            raise _twice(path, number, twice)
        return found

    try:
        value: object = json.loads(
            line,
            object_pairs_hook=paired,
            parse_float=_Number,
            parse_int=_Number,
            parse_constant=lambda word: _Number(word.replace("Infinity", "inf")),
        )
    except RecursionError:
        raise _deep(path, number) from None
    if not isinstance(value, dict):
        raise RunError(f"{path}: line {number} is JSON, but no object with keys; {WAY_OUT}")
    row: list[str] = []
    given: set[str] = set()
    for name, cell in _flat(path, number, "", value, 0):
        if name in given:
            raise _twice(path, number, name)
        given.add(name)
        at = names.setdefault(name, len(names))
        if at >= MOST_COLUMNS:
            raise RunError(
                f"{path}: line {number}: more than {MOST_COLUMNS} values in one object or in all "
                f"keys together, so it is not a row of a table; {WAY_OUT}"
            )
        row += [""] * (at + 1 - len(row))
        row[at] = cell
    return row


def _flat(
    path: Path, number: int, name: str, value: object, depth: int
) -> Iterator[tuple[str, str]]:
    """Yield the columns of a value, and their cells."""
    if depth > DEEPEST:
        raise _deep(path, number)
    if isinstance(value, dict):
        for key, one in value.items():
            yield from _flat(path, number, f"{name}.{key}" if name else key, one, depth + 1)
    elif isinstance(value, list):
        for k, one in enumerate(value):
            yield from _flat(path, number, f"{name}[{k}]", one, depth + 1)
    else:
        yield name, _cell(value)


def _cell(value: object) -> str:
    """Return a value as a cell of the table."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    text = " ".join(str(value).split())
    if (
        isinstance(value, _Number)
        or (is_number(text) and "," not in text)
        or _PLAIN.fullmatch(text)
    ):
        return text
    return '"' + text.replace('"', '""') + '"' if text else ""


def _twice(path: Path, number: int, key: str) -> RunError:
    return RunError(
        f"{path}: line {number} holds the key '{key[:60]}' twice; which one counts is not known: "
        "rename or remove one"
    )


def _deep(path: Path, number: int) -> RunError:
    return RunError(
        f"{path}: line {number} nests objects and lists deeper than {DEEPEST} levels; {WAY_OUT}"
    )
