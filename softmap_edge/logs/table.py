"""Reads the columns of one log that a mapping asks for, and its time; what is odd about either is told.

Whatever the format, a log is named columns (`softmap_edge/logs/`, one reader each). Rows that are the row before once
more, time and all, are left out; a time that stands still or goes backwards is refused unless the mapping says what
to do; missing rows are counted where the log has a regular clock.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.logs.clock import kept, times_of
from softmap_edge.logs.mapping import Clock, Log
from softmap_edge.logs.measured import Column
from softmap_edge.logs.readers.cells import find_delimiter
from softmap_edge.logs.readers.columns import Array, Cells, Columns
from softmap_edge.logs.readers.mcap_file import MAGIC
from softmap_edge.logs.readers.mocap import is_motive, is_trc, open_motive, open_trc
from softmap_edge.logs.readers.text import open_text
from softmap_edge.logs.readers.typed_rows import is_typed, open_typed
from softmap_edge.logs.readers.vendor_text import is_lvm, is_nexus, is_qtm, open_lvm, open_nexus, open_qtm
from softmap_edge.logs.time_text import DAY

_VENDORS: dict[str, Callable[[Path], Columns]] = {
    "trc": open_trc,
    "motive": open_motive,
    "qtm": open_qtm,
    "nexus": open_nexus,
    "typed": open_typed,
}
_STARTS = {"trc": is_trc, "motive": is_motive, "qtm": is_qtm, "nexus": is_nexus, "lvm": is_lvm, "typed": is_typed}
_START = 4096  # bytes that decide the format
LARGEST = 1e20  # of any cell, whatever its unit: times in nanoseconds since 1970 are 2e18


@dataclass(frozen=True)
class LogTable:
    """The cells of one log that a mapping asks for."""

    path: Path
    t: Array  # (rows,) s
    names: list[str]
    units: dict[str, str]
    values: dict[int, Array]
    labels: NDArray[Any] | None
    notes: tuple[str, ...]
    doubts: tuple[str, ...] = ()

    def numbers(self, columns: tuple[Column, ...]) -> Array:
        """Return (rows, len(columns)); absent cells are NaN."""
        return np.stack([self.values[place(self.path, self.names, column)] for column in columns], axis=1)

    def texts(self) -> NDArray[Any]:
        """Return the (rows,) labels."""
        assert self.labels is not None
        return self.labels

    def unit(self, column: Column) -> str | None:
        """Return the unit of a column, where the file states one."""
        return self.units.get(self.names[place(self.path, self.names, column)])

    def rows(self, keep: NDArray[np.bool_]) -> LogTable:
        """Return the same with some of its rows."""
        values = {k: column[keep] for k, column in self.values.items()}
        return replace(self, t=self.t[keep], values=values, labels=None if self.labels is None else self.labels[keep])


def open_log(path: Path, log: Log | None = None) -> Columns:
    """Open a log of whatever format; without `log` everything about it is found.

    Raises:
        RunError: it is absent, damaged, or in no format that is read here.
    """
    kind = _format(path)
    if kind == "c3d":
        from softmap_edge.logs.readers.c3d_file import open_c3d

        return open_c3d(path)
    if kind == "mcap":
        from softmap_edge.logs.readers.mcap_file import open_mcap

        return open_mcap(path, None if log is None else log.topic)
    if log is not None and log.topic is not None:
        raise RunError(f"{path}: topic = '{log.topic[:60]}' is for MCAP files, and this is none; leave it out")
    if kind in _VENDORS and not (log is not None and (log.skip_rows or not log.header)):
        return _VENDORS[kind](path)
    skip_rows, skip_last, header = (0, 0, None) if log is None else (log.skip_rows, log.skip_last_rows, log.header)
    delimiter, decimal = (None, None) if log is None else (log.delimiter, log.decimal)
    order = None if log is None else log.clock.date_order
    if kind == "lvm" and not skip_rows:
        return open_lvm(path, header, order)
    return open_text(path, delimiter, decimal, header, skip_rows, skip_last, order)


def _format(path: Path) -> str:
    """The format of a log by its ending, else by how it begins."""
    ending = path.suffix.lower()[1:]
    if ending in ("c3d", "mcap", "trc"):
        return ending
    if path.exists() and not path.is_file():  # a pipe would be waited for
        raise RunError(f"{path}: {'a folder' if path.is_dir() else 'no file'}; give the path of a log")
    try:
        with path.open("rb") as file:
            start = file.read(_START)
    except OSError as cause:
        raise RunError(f"{path}: cannot be read ({cause.strerror or cause}); give the path of a log") from cause
    if start.startswith(MAGIC):
        return "mcap"
    text = start.removeprefix(b"\xef\xbb\xbf").decode("latin-1")
    return next((kind for kind, fits in _STARTS.items() if fits(text)), "csv")


def read_log(path: Path, log: Log) -> LogTable:
    """Read the columns of one log that the mapping names.

    Raises:
        RunError: the file is absent or too large, a column is missing, or a line cannot be read.
    """
    columns = open_log(path, log)
    names = columns.names
    wanted: list[Column] = [column for quantity in log.rows.values() for column in quantity.columns]
    wanted += [column for points in (log.markers, log.base) if points is not None for column in points.columns]
    wanted += [] if log.output is None else log.output.columns
    wanted += log.clock.columns
    _all_there(path, names, [*wanted, *([] if log.block is None else [log.block])], log.delimiter)
    places = sorted({place(path, names, column) for column in wanted})
    cells = columns.read(places, None if log.block is None else place(path, names, log.block))
    cells = _cut(path, cells, log)
    _within_reason(path, columns.where, cells, places, names)
    times = times_of(path, columns.where, cells, _raw_times(path, columns, cells, places, log.clock), log.clock)
    values = dict(zip(places, times.cells.numbers.T))
    doubts = (*times.doubts, *_assumed(log.clock, len(times.t)))
    notes = (*cells.notes, *times.notes)
    return LogTable(path, times.t, names, columns.units, values, times.cells.labels, notes, doubts)


def _cut(path: Path, cells: Cells, log: Log) -> Cells:
    """The rows from `from_row` to `to_row`."""
    if log.from_row == 0 and log.to_row is None:
        return cells
    row, last = np.arange(len(cells.numbers)), len(cells.numbers) - 1
    chosen = (row >= log.from_row) & (row <= (last if log.to_row is None else log.to_row))
    if not chosen.any():
        raise RunError(
            f"{path}: from_row = {log.from_row}, to_row = {log.to_row}: no row is left; the log has rows 0 to {last}"
        )
    note = f"{int(chosen.sum())} of {len(chosen)} rows, {log.from_row} to {int(row[chosen][-1])}, as the mapping asks"
    return replace(kept(cells, chosen), notes=(*cells.notes, note))


def _assumed(clock: Clock, rows: int) -> tuple[str, ...]:
    """Say that times come from a rate that is not confirmed."""
    if not clock.assumed:
        return ()
    what = "the number of the row" if clock.column is None else f"'{clock.column}'"
    return (
        f"t: the times of {rows} rows are {what} at {1.0 / clock.seconds:g} Hz, a rate that is assumed: put the rate "
        'of the log into the mapping and remove `assumed`, or declare time = "none"',
    )


def place(path: Path, names: list[str], column: Column) -> int:
    """Return the position of a column given by name or by number.

    Raises:
        RunError: there is no such column, or several have this name.
    """
    if isinstance(column, int):
        if 0 <= column < len(names):
            return column
        raise RunError(f"{path}: no column number {column}; there are {len(names)}, counted from 0")
    if column in names:
        if names.count(column) > 1:
            numbers = " and ".join(str(k) for k, name in enumerate(names) if name == column)
            raise RunError(f"{path}: columns {numbers} are all called '{column[:60]}'; give the number instead")
        return names.index(column)
    raise RunError(f"{path}: no column '{column[:60]}'; there are {', '.join(names)[:200]}")


def _all_there(path: Path, names: list[str], wanted: list[Column], delimiter: str | None) -> None:
    missing = [c for c in wanted if (c not in names if isinstance(c, str) else not 0 <= c < len(names))]
    if not missing:
        return
    listed = ", ".join(str(column)[:40] for column in dict.fromkeys(missing[:8]))
    hint = ""
    if len(names) == 1 and delimiter is not None and (other := find_delimiter(names[0])) in names[0]:
        hint = f"; the file seems to be cut by '{other}', not by '{delimiter}'"
    raise RunError(f"{path}: no column {listed}; there are {', '.join(names)[:200]}{hint}; change the mapping")


def _within_reason(path: Path, where: str, cells: Cells, places: list[int], names: list[str]) -> None:
    for j, column in enumerate(places):
        wild = np.abs(cells.numbers[:, j]) > LARGEST  # infinity as well; NaN is an absent cell
        if wild.any():
            row = int(np.argmax(wild))
            raise RunError(
                f"{path}: {where} {cells.lines[row]}, column {names[column]}: {cells.numbers[row, j]:g} is no "
                "measurement; correct or remove the line"
            )


def _raw_times(path: Path, columns: Columns, cells: Cells, places: list[int], clock: Clock) -> Array:
    """The times (rows,) s as the log has them; NaN where it has none."""
    if clock.column is None:
        return np.arange(len(cells.numbers), dtype=float) * clock.seconds + clock.offset_s
    texts: dict[int, Any] = getattr(columns, "clocks", {})
    t = np.full(len(cells.numbers), clock.offset_s)
    dated = False
    for column, seconds in [(clock.column, clock.seconds), *clock.more]:
        at = place(path, columns.names, column)
        part = cells.numbers[:, places.index(at)]
        if at in texts:
            if column == clock.column and seconds != 1.0:
                raise RunError(
                    f"{path}: {columns.names[at]} holds dates or times; leave unit and rate_hz out of `time`"
                )
            part = np.mod(part, DAY) if dated and texts[at].form == "day" else part
            dated, seconds = True, 1.0
        t = t + part * seconds
    return t
