"""Read a log's columns that a mapping lists, and its time; report anything suspicious.

Every format gives named columns (`softmap_edge/logs/`, one reader each). A row that repeats the
previous one, including its time, is left out. Time that does not increase is rejected unless the
mapping states a treatment. Missing rows are counted if the log has a regular clock.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.files.printable import listed
from softmap_edge.logs.clock import kept, times_of
from softmap_edge.logs.fills import LARGEST, without_fills
from softmap_edge.logs.mapping import CONDITIONS, Clock, Log
from softmap_edge.logs.measured import Column
from softmap_edge.logs.other_units import doubts_of_clock
from softmap_edge.logs.readers.cells import find_delimiter
from softmap_edge.logs.readers.columns import Array, Cells, Columns
from softmap_edge.logs.readers.json_lines import open_json_lines
from softmap_edge.logs.readers.kinds import ARRAYS, kind_of
from softmap_edge.logs.readers.matlab_file import open_hdf5, open_matlab
from softmap_edge.logs.readers.mocap import open_motive, open_trc
from softmap_edge.logs.readers.npz_log import open_npz
from softmap_edge.logs.readers.parquet_log import open_parquet
from softmap_edge.logs.readers.pivoted import pivoted
from softmap_edge.logs.readers.rosbag_sqlite import open_db3
from softmap_edge.logs.readers.summaries import summaries
from softmap_edge.logs.readers.text import TextColumns, open_text
from softmap_edge.logs.readers.typed_rows import open_typed
from softmap_edge.logs.readers.vendor_text import open_lvm, open_nexus, open_qtm
from softmap_edge.logs.time_keys import fractions
from softmap_edge.logs.time_text import DAY

_VENDORS: dict[str, Callable[[Path], Columns]] = {
    "trc": open_trc,
    "motive": open_motive,
    "qtm": open_qtm,
    "nexus": open_nexus,
    "typed": open_typed,
}
_LISTED = 6  # columns that are listed
_NAMED = 8  # missing columns that are listed
_WIDTH = 200  # characters of a list of columns
_FEWEST_STEPS = 10  # between rows: fewer show no rate
_REGULAR, _USUALLY = 0.5, 0.8  # deviation from the usual step, and share of such steps
_SAME_RATE = 0.01  # relative difference of rates that rounding of the head explains


@dataclass(frozen=True)
class LogTable:
    """The cells of one log that a mapping requests."""

    path: Path
    t: Array  # (rows,) s
    names: list[str]
    units: dict[str, str]
    values: dict[int, Array]
    labels: NDArray[np.generic] | None
    notes: tuple[str, ...]
    doubts: tuple[str, ...] = ()
    # cells of a line of units that are not known, by column; None if the log is not a text
    odd_units: dict[str, str] | None = None

    def numbers(self, columns: tuple[Column, ...]) -> Array:
        """Return (rows, len(columns)); missing cells are NaN."""
        return np.stack(
            [self.values[place(self.path, self.names, column)] for column in columns], axis=1
        )

    def texts(self) -> NDArray[np.generic]:
        """Return the labels (rows,)."""
        assert self.labels is not None
        return self.labels

    def name(self, column: Column) -> str:
        """Return the name of a column that a mapping gives by name or number."""
        return self.names[place(self.path, self.names, column)]

    def unit(self, column: Column) -> str | None:
        """Return the unit of a column if the file states one."""
        return self.units.get(self.name(column))

    def rows(self, keep: NDArray[np.bool_]) -> LogTable:
        """Return a copy with the rows where `keep` (rows,) is true."""
        values = {k: column[keep] for k, column in self.values.items()}
        return replace(
            self,
            t=self.t[keep],
            values=values,
            labels=None if self.labels is None else self.labels[keep],
        )


def open_log(path: Path, log: Log | None = None) -> Columns:
    """Open a log of any format; without `log` its layout is detected.

    Raises:
        RunError: it is absent or damaged, or has an unsupported format.
    """
    columns = _opened(path, log)
    if log is None or log.pivot is None:
        return columns
    frame, marker = log.pivot.frame, log.pivot.marker
    _all_there(path, columns, [*frame, *marker], log.delimiter)
    return pivoted(
        columns,
        path,
        [place(path, columns.names, column) for column in frame],
        [place(path, columns.names, column) for column in marker],
    )


def _opened(path: Path, log: Log | None) -> Columns:
    """Open a log as its file holds it."""
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
        raise RunError(
            f"{path}: topic = '{log.topic[:60]}' is for MCAP files, which this is not; leave it out"
        )
    if kind == "parquet":
        return open_parquet(path) if log is None else open_parquet(path, log.episode)
    if kind in ARRAYS:
        return {"mat": open_matlab, "hdf5": open_hdf5}.get(kind, open_npz)(path)
    if kind in _VENDORS and not (log is not None and (log.skip_rows or not log.header)):
        return _VENDORS[kind](path)
    skip_rows, skip_last, header = (
        (0, 0, None) if log is None else (log.skip_rows, log.skip_last_rows, log.header)
    )
    delimiter, decimal = (None, None) if log is None else (log.delimiter, log.decimal)
    order = None if log is None else log.clock.date_order
    if kind == "jsonl":
        if log is not None and (delimiter is not None or decimal is not None or not log.header):
            raise RunError(
                f"{path}: delimiter, decimal and header are for tables, and this log is JSON "
                "Lines, whose keys are the names; leave them out"
            )
        return open_json_lines(path, skip_rows, skip_last, order)
    if kind == "lvm" and not skip_rows:
        return open_lvm(path, header, order)
    return open_text(path, delimiter, decimal, header, skip_rows, skip_last, order)


def read_log(path: Path, log: Log, columns: Columns | None = None) -> LogTable:
    """Read the columns of one log that its mapping lists.

    Args:
        path: the log.
        log: its entry in the mapping.
        columns: the log, if already open.

    Raises:
        RunError: the file is absent or too large, a column is missing, or a line cannot be read.
    """
    columns = open_log(path, log) if columns is None else columns
    names = columns.names
    needed = columns_named(log)
    _all_there(path, columns, [*needed, *([] if log.block is None else [log.block])], log.delimiter)
    places = sorted({place(path, names, column) for column in needed})
    cells = columns.read(places, None if log.block is None else place(path, names, log.block))
    cells = replace(cells, rows=np.arange(len(cells.numbers)))
    lacks = _other_count(columns, len(cells.numbers))
    clocks = [place(path, names, column) for column in log.clock.columns]
    if isinstance(columns, TextColumns):
        for clock in clocks:
            columns.refuse_words(clock)
    drives = {
        places.index(place(path, names, column))
        for name, quantity in log.rows.items()
        if name not in CONDITIONS
        for column in quantity.columns
    }
    cells = without_fills(
        _finite(_cut(path, cells, log), places, names), [names[k] for k in places], drives
    )
    _within_reason(path, columns.where, cells, places, names)
    cells = _without_summaries(columns, cells)
    cells, aside = _set_aside(columns.where, cells, [places.index(clock) for clock in clocks])
    t = raw_times(path, columns, cells, places, log.clock)
    at = [places.index(clock) for clock in clocks]
    times = times_of(path, columns.where, cells, t, log.clock, at, log.pivot is not None)
    values = dict(zip(places, times.cells.numbers.T))
    found = _other_rate(columns, times.t, log.clock)
    doubts = (*lacks, *cells.doubts, *times.doubts, *found, *_assumed(log.clock, len(times.t)))
    notes = (*cells.notes, *aside, *times.notes)
    odd = columns.declared.odd_units
    table = LogTable(
        path, times.t, names, columns.units, values, times.cells.labels, notes, doubts, odd
    )
    read = [name for name in log.clock.columns if place(path, names, name) not in columns.clocks]
    return replace(table, doubts=(*doubts, *doubts_of_clock(table, log.clock, read)))


def _without_summaries(columns: Columns, cells: Cells) -> Cells:
    """Return the rows of a text log without those that summarise the others, and a note."""
    gone = summaries(cells.numbers) if isinstance(columns, TextColumns) else np.zeros(0, np.intp)
    if not len(gone):
        return cells
    lines = listed([str(line) for line in cells.lines[gone]], _LISTED)
    note = (
        f"{len(gone)} of {len(cells.numbers)} rows hold the mean (or another statistic) of the "
        f"others in every column, and were left out as summaries: line {lines}"
    )
    keep = np.ones(len(cells.numbers), np.bool_)
    keep[gone] = False
    return replace(kept(cells, keep), notes=(*cells.notes, note))


def _other_count(columns: Columns, rows: int) -> list[str]:
    """Return the doubt that a log has another number of rows than its head states."""
    if not isinstance(columns, TextColumns) or columns.stated_rows is None:
        return []
    stated, rows = columns.stated_rows, rows + columns.skip_last
    if stated == rows:
        return []
    missing = f": {stated - rows} are missing, export it again" if rows < stated else ""
    return [f"the head states {stated} frames, the file holds {rows}{missing}"]


def _other_rate(columns: Columns, t: Array, clock: Clock) -> list[str]:
    """Return the doubt that rows at times t (T,) s have another rate than the head states."""
    step = np.diff(t)
    if columns.declared.rate is None or clock.timeless or len(step) < _FEWEST_STEPS:
        return []
    regular = np.abs(step / np.median(step) - 1.0) < _REGULAR  # no gap; rounded stamps differ
    key, stated = columns.declared.rate
    rate = 1.0 / float(step[regular].mean())
    if regular.mean() < _USUALLY or abs(rate / stated - 1.0) <= _SAME_RATE:
        return []
    taken = "the rate of the mapping" if clock.column is None or clock.counter else "the time"
    frame = next((name for name in columns.names if name.lower() == "frame"), None)
    counted = "" if frame is None else f'column = "{frame}", '
    remedy = f"time = {{ {counted}rate_hz = {stated:g} }}"
    return [
        f"t: the head states {key} {stated:g} Hz, and by {taken} there are {rate:.4g} rows a "
        f"second, {100 * (rate / stated - 1.0):+.0f} %: {taken} is followed; set {remedy} if the "
        "head is right"
    ]


def columns_named(log: Log) -> list[Column]:
    """Return the number columns listed for a log in a mapping, time first."""
    found: list[Column] = [*log.clock.columns]
    found += [column for quantity in log.rows.values() for column in quantity.columns]
    found += [
        column
        for points in (log.markers, log.base)
        if points is not None
        for column in (*points.columns, *points.likelihood)
    ]
    return [*found, *([] if log.output is None else log.output.columns)]


def _cut(path: Path, cells: Cells, log: Log) -> Cells:
    """Return the rows from `from_row` to `to_row`."""
    if log.from_row == 0 and log.to_row is None:
        return cells
    row, last = np.arange(len(cells.numbers)), len(cells.numbers) - 1
    chosen = (row >= log.from_row) & (row <= (last if log.to_row is None else log.to_row))
    if not chosen.any():
        raise RunError(
            f"{path}: from_row = {log.from_row}, to_row = {log.to_row}: no row is left; the log "
            f"has rows 0 to {last}"
        )
    note = (
        f"{int(chosen.sum())} of {len(chosen)} rows, {log.from_row} to {int(row[chosen][-1])}, as "
        "the mapping asks"
    )
    return replace(kept(cells, chosen), notes=(*cells.notes, note))


def _assumed(clock: Clock, rows: int) -> tuple[str, ...]:
    """Return a sentence if the times are based on an unconfirmed rate."""
    if not clock.assumed:
        return ()
    what = "the number of the row" if clock.column is None else f"'{clock.column}'"
    return (
        f"t: the times of {rows} rows are {what} at {1.0 / clock.seconds:g} Hz, a rate that is "
        "assumed: put the rate "
        'of the log into the mapping and remove `assumed`, or declare time = "none"',
    )


def place(path: Path, names: list[str], column: Column) -> int:
    """Return the position of a column given by name or number.

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
            raise RunError(
                f"{path}: columns {numbers} are all called '{column[:60]}'; give the number instead"
            )
        return names.index(column)
    raise RunError(f"{path}: no column '{column[:60]}'; there are {_listed(names)}")


def _listed(names: list[str]) -> str:
    """Return column names for a message, and the number of those omitted."""
    shown = names[:1]
    for name in names[1:]:
        if len(", ".join([*shown, name])) > _WIDTH:
            return f"{', '.join(shown)[:_WIDTH]} … and {len(names) - len(shown)} more"
        shown = [*shown, name]
    return ", ".join(shown)[:_WIDTH]


def _all_there(path: Path, columns: Columns, needed: list[Column], delimiter: str | None) -> None:
    names = columns.names
    missing = [
        c
        for c in dict.fromkeys(needed)
        if (c not in names if isinstance(c, str) else not 0 <= c < len(names))
    ]
    if not missing:
        return
    absent = listed((str(column)[:40] for column in missing), _NAMED)
    hint = ""
    if (
        len(names) == 1
        and delimiter is not None
        and (other := find_delimiter(names[0])) in names[0]
    ):
        hint = f"; the file seems to be cut by '{other}', not by '{delimiter}'"
    hint += header_hint(columns.head_line)
    raise RunError(
        f"{path}: no column {absent}; there are {_listed(names)}{hint}; change the mapping"
    )


def header_hint(line: int | None) -> str:
    """Return the line of the names with remedies if it is wrong; "" for other formats.

    Args:
        line: the line number of the column names, if any.
    """
    if line is None:
        return ""
    return (
        f"; line {line} was taken for the names: if another line holds them, set skip_rows to the "
        "number of lines above it, or header = false and give column numbers"
    )


def _finite(cells: Cells, places: list[int], names: list[str]) -> Cells:
    """Return the cells with infinite numbers as missing, and a note on them."""
    count = np.isinf(cells.numbers).sum(axis=0)
    if not count.any():
        return cells
    counted = listed((f"{names[places[j]]} {count[j]}" for j in np.flatnonzero(count)), _LISTED)
    note = f"infinite values of {len(cells.numbers)} rows are taken as missing: {counted}"
    numbers = np.where(np.isinf(cells.numbers), np.nan, cells.numbers)
    return replace(cells, numbers=numbers, notes=(*cells.notes, note))


def _within_reason(
    path: Path, where: str, cells: Cells, places: list[int], names: list[str]
) -> None:
    for j, column in enumerate(places):
        wild = np.abs(cells.numbers[:, j]) > LARGEST  # NaN is a missing cell
        if wild.any():
            row = int(np.argmax(wild))
            raise RunError(
                f"{path}: {where} {cells.lines[row]}, column {names[column]}: "
                f"{cells.numbers[row, j]:g} is not a measurement; correct or remove the line"
            )


def _set_aside(where: str, cells: Cells, clocks: list[int]) -> tuple[Cells, list[str]]:
    """Leave out rows with a time but no other column of the mapping.

    They come from another publisher or device. For messages this always applies; for other logs
    only to rows where time does not rise.
    """
    rest = np.delete(cells.numbers, clocks, axis=1)
    bare = np.asarray(np.isnan(rest).all(axis=1))
    if not clocks or not bare.any() or bare.all():
        return cells, []
    t = cells.numbers[:, clocks[0]]
    bare &= np.isfinite(t)
    if where != "message" and (np.diff(t[np.isfinite(t)]) > 0).all():
        return cells, []
    what = "messages" if where == "message" else "rows"
    note = (
        f"{int(bare.sum())} of {len(bare)} {what} hold none of the columns that the mapping names "
        "and were left out"
    )
    return kept(cells, ~bare), [note]


def raw_times(path: Path, columns: Columns, cells: Cells, places: list[int], clock: Clock) -> Array:
    """Return the times (rows,) s as in the log; NaN where missing.

    Args:
        path: the log, for messages.
        columns: the open log.
        cells: those of its columns `places`, including the time columns.
        places: positions of columns.
        clock: the time declared by the mapping.

    Raises:
        RunError: a column is absent, or holds dates instead of the declared numbers, or fractions
            instead of counts.
    """
    if clock.column is None:
        return np.arange(len(cells.numbers), dtype=float) * clock.seconds + clock.offset_s
    texts = columns.clocks
    t = np.full(len(cells.numbers), clock.offset_s)
    dated = False
    for column, seconds in [(clock.column, clock.seconds), *clock.more]:
        at = place(path, columns.names, column)
        part = cells.numbers[:, places.index(at)]
        if at in texts:
            if column == clock.column and seconds != 1.0:
                raise RunError(
                    f"{path}: {columns.names[at]} holds dates or times; leave unit and rate_hz "
                    "out of `time`"
                )
            part = np.mod(part, DAY) if dated and texts[at].form == "day" else part
            dated, seconds = True, 1.0
        elif clock.counter:
            _refuse_fractions(path, columns.where, columns.names[at], part, cells)
        t = t + part * seconds
    return t


def _refuse_fractions(path: Path, where: str, name: str, counts: Array, cells: Cells) -> None:
    """Reject a counter of frames or rows that holds fractions."""
    broken = fractions(counts)
    if not broken.any():
        return
    first = int(np.argmax(broken))
    raise RunError(
        f"{path}: {where} {cells.lines[first]}: '{name[:60]}' is {counts[first]:.9g}, and so are "
        f"{int(broken.sum()) - 1} more of {len(counts)} no whole numbers; a counter (`column` with "
        "`rate_hz`) holds whole numbers only. Mend the lines, or, if the column holds time, give "
        "`unit` in place of `rate_hz`"
    )
