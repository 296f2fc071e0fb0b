"""Reads the columns of one log that a mapping asks for, and its time; what is odd about either is told.

Whatever the format, a log is named columns (`softmap_edge/logs/`, one reader each). Rows that are the row before once
more, time and all, are left out; a time that stands still or goes backwards is refused unless the mapping says what
to do; missing rows are counted where the log has a regular clock.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.logs.mapping import Clock, Log
from softmap_edge.logs.measured import Column
from softmap_edge.logs.readers.columns import Array, Cells, Columns
from softmap_edge.logs.readers.kinds import ARRAYS, kind_of
from softmap_edge.logs.readers.matlab_file import open_hdf5, open_matlab
from softmap_edge.logs.readers.mocap import open_motive, open_trc
from softmap_edge.logs.readers.npz_log import open_npz
from softmap_edge.logs.readers.parquet_log import open_parquet
from softmap_edge.logs.readers.rosbag_sqlite import open_db3
from softmap_edge.logs.readers.text import TextColumns, find_delimiter, open_text
from softmap_edge.time_text import differing

LARGEST = 1e20  # of any cell, whatever its unit: times in nanoseconds since 1970 are 2e18
_TOLD = 6  # columns that are named
_REGULAR = 0.2  # of the usual step: what a clock with jitter stays within


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
    kind = kind_of(path)
    if kind == "c3d":
        from softmap_edge.logs.readers.c3d_file import open_c3d

        return open_c3d(path)
    if kind == "mcap":
        from softmap_edge.logs.readers.mcap_file import open_mcap

        return open_mcap(path, None if log is None else log.topic)
    if kind == "db3":
        return open_db3(path, None if log is None else log.topic)
    if log is not None and log.topic is not None:
        raise RunError(f"{path}: topic = '{log.topic[:60]}' is for MCAP files, and this is none; leave it out")
    if kind == "parquet":
        return open_parquet(path) if log is None else open_parquet(path, log.episode)
    if kind in ARRAYS:
        return {"mat": open_matlab, "hdf5": open_hdf5}.get(kind, open_npz)(path)
    if kind in ("trc", "motive"):
        return open_trc(path) if kind == "trc" else open_motive(path)
    skip_rows, skip_last, header = (0, 0, None) if log is None else (log.skip_rows, log.skip_last_rows, log.header)
    delimiter, decimal = (None, None) if log is None else (log.delimiter, log.decimal)
    return open_text(path, delimiter, decimal, header, skip_rows, skip_last)


def read_log(path: Path, log: Log, columns: Columns | None = None) -> LogTable:
    """Read the columns of one log that the mapping names.

    Args:
        path: the log.
        log: what the mapping says of it.
        columns: the log, if it is open already.

    Raises:
        RunError: the file is absent or too large, a column is missing, or a line cannot be read.
    """
    columns = open_log(path, log) if columns is None else columns
    names = columns.names
    wanted: list[Column] = [column for quantity in log.rows.values() for column in quantity.columns]
    wanted += [column for points in (log.markers, log.base) if points is not None for column in points.columns]
    wanted += [] if log.output is None else log.output.columns
    wanted += [] if log.clock.column is None else [log.clock.column]
    _all_there(path, names, [*wanted, *([] if log.block is None else [log.block])], log.delimiter)
    places = sorted({place(path, names, column) for column in wanted})
    cells = columns.read(places, None if log.block is None else place(path, names, log.block))
    if log.clock.column is not None and isinstance(columns, TextColumns):
        columns.refuse_words(place(path, names, log.clock.column))
    cells = _finite(cells, places, names)
    _within_reason(path, columns.where, cells, places, names)
    clock = None if log.clock.column is None else places.index(place(path, names, log.clock.column))
    cells, aside = _set_aside(columns.where, cells, clock)
    t, cells, notes = _clock(path, columns.where, cells, clock, log.clock)
    values = dict(zip(places, cells.numbers.T))
    return LogTable(path, t, names, columns.units, values, cells.labels, (*cells.notes, *aside, *notes))


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


def _finite(cells: Cells, places: list[int], names: list[str]) -> Cells:
    """Return the cells with infinite numbers as absent ones, and a note on them."""
    count = np.isinf(cells.numbers).sum(axis=0)
    if not count.any():
        return cells
    told = [f"{names[places[j]]} {count[j]}" for j in np.flatnonzero(count)[:_TOLD]]
    more = f" and {int((count > 0).sum()) - _TOLD} more" if (count > 0).sum() > _TOLD else ""
    note = f"infinite values of {len(cells.numbers)} rows are taken as missing: {', '.join(told)}{more}"
    numbers = np.where(np.isinf(cells.numbers), np.nan, cells.numbers)
    return replace(cells, numbers=numbers, notes=(*cells.notes, note))


def _within_reason(path: Path, where: str, cells: Cells, places: list[int], names: list[str]) -> None:
    for j, column in enumerate(places):
        wild = np.abs(cells.numbers[:, j]) > LARGEST  # NaN is an absent cell
        if wild.any():
            row = int(np.argmax(wild))
            raise RunError(
                f"{path}: {where} {cells.lines[row]}, column {names[column]}: {cells.numbers[row, j]:g} is no "
                "measurement; correct or remove the line"
            )


# --- time ----------------------------------------------------------------------------------
def _set_aside(where: str, cells: Cells, clock: int | None) -> tuple[Cells, list[str]]:
    """Leave out rows that hold a time and nothing else that the mapping names: those of another publisher or device.

    Messages always; rows of other logs where time does not rise with them.
    """
    rest = np.delete(cells.numbers, [] if clock is None else [clock], axis=1)
    bare = np.asarray(np.isnan(rest).all(axis=1))
    if clock is None or not bare.any() or bare.all():
        return cells, []
    t = cells.numbers[:, clock]
    bare &= np.isfinite(t)
    if where != "message" and (np.diff(t[np.isfinite(t)]) > 0).all():
        return cells, []
    what = "messages" if where == "message" else "rows"
    note = f"{int(bare.sum())} of {len(bare)} {what} hold none of the columns that the mapping names and were left out"
    return _kept(cells, ~bare), [note]


def _clock(path: Path, where: str, cells: Cells, column: int | None, clock: Clock) -> tuple[Array, Cells, list[str]]:
    """The time of the rows in s, the rows that have one, and what was odd."""
    notes: list[str] = []
    count = np.arange(len(cells.numbers), dtype=float) if column is None else cells.numbers[:, column]
    t = count * clock.seconds + clock.offset_s
    empty = ~np.isfinite(t)
    if empty.any():
        if not np.isnan(cells.numbers[empty]).all():
            row = int(np.argmax(empty & np.isfinite(cells.numbers).any(axis=1)))
            raise RunError(f"{path}: {where} {cells.lines[row]}: the time is empty or not a number; remove the line")
        notes.append(f"{int(empty.sum())} empty rows were left out")
        t, cells = t[~empty], _kept(cells, ~empty)
    if len(t) == 0:
        raise RunError(f"{path}: holds no rows; give a log that holds data")
    same = np.r_[False, np.diff(t) == 0]
    if same.any():
        at = np.flatnonzero(same)
        again = np.zeros(len(t), bool)
        before, after = cells.numbers[at - 1], cells.numbers[at]
        again[at] = ((before == after) | (np.isnan(before) & np.isnan(after))).all(axis=1)
        if cells.labels is not None:
            again[at] &= cells.labels[at - 1] == cells.labels[at]
        if again.any():
            notes.append(f"{int(again.sum())} rows that repeat the row before, time and all, were left out")
            t, cells = t[~again], _kept(cells, ~again)
    if clock.repeated == "drop" and len(t) > 1:
        fresh = np.r_[True, t[1:] > np.maximum.accumulate(t)[:-1]]
        if not fresh.all():
            notes.append(f"{int((~fresh).sum())} rows whose time does not increase were dropped")
            t, cells = t[fresh], _kept(cells, fresh)
    _increasing(path, where, t, cells, spread=clock.repeated == "spread")
    if clock.repeated == "spread" and (np.diff(t) == 0).any():
        notes.append(f"{int((np.diff(t) == 0).sum())} rows share a time with the row before and were spread evenly")
        t = _spread(t)
    return t, cells, [*notes, *_gaps(where, t, cells)]


def _kept(cells: Cells, keep: NDArray[np.bool_]) -> Cells:
    labels = None if cells.labels is None else cells.labels[keep]
    return replace(cells, numbers=cells.numbers[keep], labels=labels, lines=cells.lines[keep])


def _increasing(path: Path, where: str, t: Array, cells: Cells, spread: bool) -> None:
    step = np.diff(t)
    late = step < 0 if spread else step <= 0
    if not late.any():
        return
    row = int(np.argmax(late)) + 1
    back = step[row - 1] < 0
    now, before = differing(t[row], t[row - 1])
    remedy = 'set time.repeated = "drop" to leave such rows out'
    if not back:
        remedy += ', or "spread" to place rows of one time evenly up to the next'
    raise RunError(
        f"{path}: time {'goes backwards' if back else 'stands still'} at row {row} ({where} {cells.lines[row]}: "
        f"{now} s after {before} s), {int(late.sum())} such rows; {remedy}"
    )


def _spread(t: Array) -> Array:
    """Rows of one time, evenly from it to the next time; the last ones at the usual step."""
    first = np.flatnonzero(np.r_[True, np.diff(t) > 0])
    count = np.diff(np.r_[first, len(t)])
    width = np.diff(t[first])
    usual = float(np.median(width / count[:-1])) if len(width) else 1.0
    step = np.r_[width / count[:-1], usual]
    within = np.arange(len(t)) - np.repeat(first, count)
    return np.asarray(np.repeat(t[first], count) + within * np.repeat(step, count))


def _gaps(where: str, t: Array, cells: Cells) -> list[str]:
    """Rows that a regular clock should have had."""
    step = np.diff(t)
    if len(step) < 10:
        return []
    usual = float(np.median(step))
    if (np.abs(step - usual) <= _REGULAR * usual).mean() < 0.9:
        return []
    gaps = step > 1.5 * usual
    if not gaps.any():
        return []
    missing, row = int(np.rint(step[gaps] / usual - 1).sum()), int(np.argmax(step))
    return [
        f"{missing} rows are missing in {int(gaps.sum())} gaps, the longest {step[row]:.3g} s after {where} "
        f"{cells.lines[row]} (usual step {usual:.3g} s); nothing is made up for them"
    ]
