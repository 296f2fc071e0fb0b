"""Turn a long table, with one row for each marker of each frame, to one row for each frame.

Column `x` of the rows of marker `tip` becomes column `tip.x`. The columns of the file stay, for
numbers that are equal in all rows of a frame, such as commands. A marker without a row in a frame
was not seen in it. Two rows for one marker of a frame are refused.

The table is read once for frames and markers, and once for the requested cells; only requested
columns are kept. Pinned by tests/logs/test_long_tables.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.files.printable import listed
from softmap_edge.logs.readers.cells import is_number
from softmap_edge.logs.readers.columns import Array, Cells, Columns, Declared
from softmap_edge.logs.readers.paced import PacedColumns
from softmap_edge.logs.readers.text import TextColumns
from softmap_edge.logs.time_text import TimeText

MOST_MARKERS = 1000
MOST_CELLS = 2**25  # of the turned table in memory: 256 MiB
_FEW = 0.05  # of the rows: more with a time and marker of others are a clock that was set back
_LISTED = 4  # names in a note
Rows = NDArray[np.int64]


@dataclass(frozen=True)
class Layout:
    """Where the rows of a long table belong.

    Attributes:
        markers: their names: numbers in their order, texts as they first occur.
        frame: (rows,) the frame of each row.
        marker: (rows,) the marker of each row; -1 of a row that names none.
        lines: (frames,) the line of the first row of each frame.
        note: a sentence on the turned table.
    """

    markers: list[str]
    frame: Rows
    marker: Rows
    lines: Rows
    note: str


@dataclass(frozen=True)
class PivotedColumns:
    """The columns of a long table, followed by those of each marker."""

    path: Path
    inner: Columns
    layout: Layout
    of_markers: list[int]  # positions of the columns that each marker has
    names: list[str] = field(default_factory=list)

    @property
    def units(self) -> dict[str, str]:
        """The units that the file states, also for the columns of markers."""
        return self._for_markers(self.inner.units)

    @property
    def declared(self) -> Declared:
        """What else the file states; its rate only where frames show several markers."""
        inner = self.inner.declared
        odd = None if inner.odd_units is None else self._for_markers(inner.odd_units)
        several = len(self.layout.frame) > len(self.layout.lines)
        return Declared(odd, inner.rate if several else None)

    def _for_markers(self, units: dict[str, str]) -> dict[str, str]:
        own = [self.inner.names[place] for place in self.of_markers] * len(self.layout.markers)
        added = self.names[len(self.inner.names) :]
        return units | {name: units[old] for name, old in zip(added, own) if old in units}

    @property
    def where(self) -> str:
        """The word for a row in this file."""
        return self.inner.where

    @property
    def clocks(self) -> dict[int, TimeText]:
        """The columns of dates or times as text."""
        return self.inner.clocks

    @property
    def head_line(self) -> int | None:
        """The line number of the column names."""
        return self.inner.head_line

    def texts(self, rows: int) -> dict[str, list[str]]:
        """Return the text columns of the first rows of the file, with their text."""
        inner = self.inner
        return inner.texts(rows) if isinstance(inner, TextColumns | PacedColumns) else {}

    def places_of(self, own: list[int]) -> list[int]:
        """Return the positions of each marker's columns, from their positions in the file."""
        old, width = len(self.inner.names), len(self.of_markers)
        at = [self.of_markers.index(place) for place in own]
        return [old + m * width + k for m in range(len(self.layout.markers)) for k in at]

    def read(self, places: list[int], label: int | None = None, rows: int | None = None) -> Cells:
        """Return the cells of columns, a row for each frame; `rows` limits the frames returned.

        Raises:
            RunError: a column of the file differs within a frame, or the table is too large.
        """
        count = len(self.layout.lines) if rows is None else min(rows, len(self.layout.lines))
        if count * len(places) > MOST_CELLS:
            raise RunError(
                f"{self.path}: {count} frames of {len(places)} columns, at most {MOST_CELLS} cells "
                "are read; split the log"
            )
        old = len(self.inner.names)
        source = [
            p if p < old else self.of_markers[(p - old) % len(self.of_markers)] for p in places
        ]
        asked = sorted(set(source))
        cells = self.inner.read(asked, label)
        used = self.layout.frame < count
        table = np.full((count, len(places)), np.nan)
        for j, place in enumerate(places):
            column = cells.numbers[:, asked.index(source[j])]
            if place < old:
                table[:, j] = self._shared(place, column, cells.lines)[:count]
            else:
                own = used & (self.layout.marker == (place - old) // len(self.of_markers))
                table[self.layout.frame[own], j] = column[own]
        labels = None
        if cells.labels is not None and label is not None:
            known, codes = np.unique(cells.labels, return_inverse=True)
            shared = self._shared(label, codes.astype(float), cells.lines)[:count]
            labels = known[shared.astype(int)]
        notes = (*cells.notes, self.layout.note)
        return Cells(table, labels, self.layout.lines[:count], notes, doubts=cells.doubts)

    def _shared(self, place: int, column: Array, lines: Rows) -> Array:
        """Return the number of each frame (frames,) in a column that does not differ within one.

        Raises:
            RunError: it differs.
        """
        order = np.argsort(self.layout.frame, kind="stable")
        starts = np.searchsorted(self.layout.frame[order], np.arange(len(self.layout.lines)))
        low = np.fmin.reduceat(column[order], starts)
        high = np.fmax.reduceat(column[order], starts)
        if not (other := low < high).any():
            return low
        frame = int(np.argmax(other))
        own = np.flatnonzero((self.layout.frame == frame) & ~np.isnan(column))
        k = next(k for k in own if column[k] != column[own[0]])
        name, marker = self.inner.names[place][:60], self.layout.markers[0][:40]
        raise RunError(
            f"{self.path}: '{name}' differs within {int(other.sum())} of {len(low)} frames, such "
            f"as in {self.where}s {lines[own[0]]} and {lines[k]}: give the column of one marker, "
            f"such as '{marker}.{name}', or another column for pivot.frame"
        )


def pivoted(columns: Columns, path: Path, frame: list[int], marker: list[int]) -> PivotedColumns:
    """Return a long table as one row for each frame.

    Args:
        columns: the long table.
        path: the log.
        frame: positions of the columns that are equal within a frame.
        marker: positions of the columns that name the marker of a row.

    Raises:
        RunError: a row has no frame, or a marker has two rows in a frame.
    """
    keys = columns.read(frame, marker[0])
    called = [columns.names[place] for place in frame]
    missing = ~np.isfinite(keys.numbers).all(axis=1)
    if missing.any():
        at = int(np.argmax(missing))
        raise RunError(
            f"{path}: {columns.where} {keys.lines[at]}: '{' '.join(called)[:60]}' is empty or no "
            f"number in {int(missing.sum())} rows, so their frame is not known; remove the lines"
        )
    named = " and ".join(columns.names[place] for place in marker)
    markers, code = _markers(path, columns, marker, keys, named)
    instant = np.unique(keys.numbers, axis=0, return_inverse=True)[1].reshape(-1)
    frames = frames_of(instant.astype(np.int64), code, len(markers))
    _refuse_twice(path, columns.where, keys, frames, markers, code, called)
    count = int(frames.max()) + 1
    first = np.full(count, len(frames))
    np.minimum.at(first, frames, np.arange(len(frames)))
    unseen = count * len(markers) - int((code >= 0).sum())
    note = (
        f"a long table: {len(frames)} rows became {count} frames by '{' '.join(called)[:60]}', "
        f"with columns for each of {len(markers)} names in '{named[:60]}' "
        f"({listed(markers, _LISTED)})"
        + (f"; {unseen} rows are missing and count as not seen" if unseen else "")
    )
    layout = Layout(markers, frames, code, keys.lines[first], note)
    own = [k for k in range(len(columns.names)) if k not in (*frame, *marker)]
    # `q.x` of a marker `q` looks like a rate, so it becomes `body q.x`
    called = [f"{named} {name}" if len(name) == 1 and name.isalpha() else name for name in markers]
    added = [
        name if len(own) == 1 else f"{name}.{columns.names[place]}"
        for name in called
        for place in own
    ]
    names = [*columns.names, *added]
    if len({*names}) < len(added) + len({*columns.names}):
        twice = next(name for name in added if names.count(name) > 1)
        raise RunError(
            f"{path}: two columns would be called '{twice[:60]}' as one row for each frame; rename "
            "a column or a marker in the log"
        )
    return PivotedColumns(path, columns, layout, own, names)


def frames_of(instant: Rows, code: Rows, count: int) -> Rows:
    """Return the frame of each row, from the number of its time and of its marker.

    Rows of one time are a frame, wherever they stand. A clock that is set back, or rolls over,
    repeats or disorders its times: then only consecutive rows of one time are a frame.
    """
    order = np.argsort(code, kind="stable")
    rises = (np.diff(instant[order]) >= 0) | (np.diff(code[order]) != 0)
    named = code >= 0
    twice = named.sum() - len(np.unique(instant[named] * count + code[named]))
    if rises.all() or 0 < twice <= _FEW * len(code):
        return instant
    return np.cumsum(np.r_[False, np.diff(instant) != 0])


def _markers(
    path: Path, columns: Columns, places: Sequence[int], keys: Cells, named: str
) -> tuple[list[str], Rows]:
    """Return the names of the markers, and the marker of each row; -1 where no cell names it.

    `keys` holds the texts of the first column already.
    """
    found: list[str] = [""]
    code = np.zeros(0, np.int64)
    for place in places:
        labels = keys.labels if place == places[0] else columns.read([], place).labels
        assert labels is not None
        known, own = np.unique(labels, return_inverse=True)
        pair = own if not len(code) else code * len(known) + own
        some, code = np.unique(pair, return_inverse=True)
        found = [
            ".".join(filter(None, (found[k // len(known)], str(known[k % len(known)]).strip())))
            for k in some.tolist()
        ]
        if len(found) > MOST_MARKERS + 1:
            raise RunError(
                f"{path}: '{named[:60]}' holds {len(found)} different names, at most "
                f"{MOST_MARKERS} markers are read; name another column in pivot.marker"
            )
    first = np.full(len(found), len(code))
    np.minimum.at(first, code, np.arange(len(code)))
    names = [name for name in found if name]
    if not names:
        raise RunError(f"{path}: '{named[:60]}' is empty in all rows; change pivot.marker")
    numbers = all(map(is_number, names))
    order = sorted(
        (k for k, name in enumerate(found) if name),
        key=lambda k: float(found[k]) if numbers else first[k],
    )
    place_of = np.full(len(found), -1)
    place_of[order] = np.arange(len(order))
    return [found[k] for k in order], place_of[code].astype(np.int64)


def _refuse_twice(
    path: Path,
    where: str,
    keys: Cells,
    frames: Rows,
    markers: Sequence[str],
    code: Rows,
    called: Sequence[str],
) -> None:
    """Raise RunError if a marker has two rows in a frame."""
    rows = np.flatnonzero(code >= 0)
    pair = frames[rows] * len(markers) + code[rows]
    order = np.argsort(pair, kind="stable")
    again = np.flatnonzero(np.diff(pair[order]) == 0)
    if not len(again):
        return
    one, other = rows[order[again[0]]], rows[order[again[0] + 1]]
    at = ", ".join(f"{name[:40]} = {x:.10g}" for name, x in zip(called, keys.numbers[one]))
    raise RunError(
        f"{path}: {where}s {keys.lines[one]} and {keys.lines[other]} both hold marker "
        f"'{markers[code[one]][:40]}' at {at}, and {len(again)} of {len(rows)} rows are such "
        "duplicates; remove them, or add to pivot.marker the column that distinguishes them"
    )
