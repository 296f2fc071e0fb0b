"""Read the tables of logs as sheets: columns with names, numbers and units.

Pinned by tests/logs/test_guess.py.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.logs.fills import LARGEST, marked_missing
from softmap_edge.logs.flags import flags_of
from softmap_edge.logs.guess_pivot import find_long
from softmap_edge.logs.pivot import Pivot
from softmap_edge.logs.readers.arrays import ArrayColumns
from softmap_edge.logs.readers.columns import Columns, HeldColumns
from softmap_edge.logs.readers.ending import lines_below
from softmap_edge.logs.readers.kinds import RECORDINGS
from softmap_edge.logs.readers.mcap_file import Topic
from softmap_edge.logs.readers.paced import PacedColumns
from softmap_edge.logs.readers.parquet_log import EPISODE, open_parquet
from softmap_edge.logs.readers.pivoted import PivotedColumns, pivoted
from softmap_edge.logs.readers.summaries import summaries
from softmap_edge.logs.readers.text import TextColumns
from softmap_edge.logs.readers.unit_cells import refuse_unit_cells
from softmap_edge.logs.sources import (
    Part,
    called,
    groups_of,
    open_recording,
    parts_of,
    pattern_of,
    topics_of,
)
from softmap_edge.logs.table import open_log

Array = NDArray[np.float64]
ROWS = 20_000  # rows examined in each log
MOST_COLUMNS = 4096  # of each log: names are compared pairwise
_MOST_LENGTHS = 16  # tables of different lengths in one file of arrays


@dataclass(frozen=True)
class Sheet:
    """The first rows of a log, or of one topic of a recording."""

    path: Path
    topic: str | None
    names: list[str]
    units: dict[str, str]
    numbers: Array  # (rows, names); NaN in a column of text
    texts: dict[str, list[str]]
    header: bool = True
    # the names in the file, where some may be equal
    bare: list[str] = field(default_factory=list)
    kind: str = ""  # message type of a topic
    file: str = ""  # the log's `file` in a mapping
    indexed: bool = False  # brackets at the end of a name hold an element's number or name
    episode: int | None = None  # of a dataset
    below: list[str] = field(default_factory=list)  # lines below the table
    # columns of dates or times: name → format; values in s
    clocks: dict[str, str] = field(default_factory=dict)
    head_line: int | None = None  # the number of the line of a text log that names the columns
    rate_hz: float | None = None  # of its rows, as the lines above the table state it
    stated: dict[str, str] = field(default_factory=dict)  # units of a line that are not known
    parts: int = 1  # files of the log
    more: tuple[str, ...] = ()  # the `file` of further parts that no common pattern names
    booleans: frozenset[str] = frozenset()  # columns that the file holds as booleans
    pivot: Pivot | None = None  # of a long table, whose rows are frames here
    why: str = ""  # what shows that it is one, or may be one

    @property
    def called(self) -> str:
        """The name of the file, and of the topic if there is one."""
        return self.path.name if self.topic is None else f"{self.path.name} {self.topic}"

    def column(self, name: str) -> Array:
        """Return the numbers of a column."""
        return np.asarray(self.numbers[:, self.names.index(name)])

    def rows_of(self, names: list[str]) -> Array:
        """Return (rows, len(names))."""
        return np.stack([self.column(name) for name in names], axis=1)

    def flags(self) -> list[str]:
        """Return the columns of numbers that are labels of what was seen."""
        return flags_of(self.names, self.numbers, self.booleans) if self.header else []

    def drop_fills(self, names: list[str]) -> None:
        """Replace fill values in drive columns by NaN, in place."""
        for name in names:
            j = self.names.index(name)
            self.numbers[marked_missing(self.numbers[:, j]), j] = np.nan


def read_sheets(paths: list[Path]) -> list[Sheet]:
    """Read the first rows of logs, and every decodable topic of a recording.

    Raises:
        RunError: a file cannot be read.
    """
    return [sheet for group in groups_of(parts_of(paths)) for sheet in _sheets_of(group)]


def _sheets_of(group: list[Part]) -> list[Sheet]:
    """Return the sheets of a log: one, or one for each topic of a recording or array length."""
    first = group[0]
    if first.kind in RECORDINGS:
        return _sheets_of_recording(group)
    with called(first.file, first.path):
        columns = (
            open_parquet(first.file, first=True)
            if first.kind == "parquet"
            else open_log(first.file)
        )
        if isinstance(columns, ArrayColumns):
            return [_sheet(first, columns, places) for places in columns.groups()[:_MOST_LENGTHS]]
        sheet = _sheet(first, columns, list(range(len(columns.names))))
        return [_turned(first, columns, sheet)]


def _turned(part: Part, columns: Columns, sheet: Sheet) -> Sheet:
    """Return the sheet of a log; a long table as one row for each frame."""
    if isinstance(columns, TextColumns):
        columns = replace(columns, skip_last=len(sheet.below), names=sheet.names)
    long = find_long(sheet, columns)
    if long is None:
        return sheet
    if not long.sure:
        remedy = f"if so, write {long.pivot.line()} below [[log]] and name the columns of each"
        return replace(sheet, why=f"whether they are {long.why}; {remedy}")
    places = [sheet.names.index(str(name)) for name in (*long.pivot.frame, *long.pivot.marker)]
    count = len(long.pivot.frame)
    wide = pivoted(columns, part.file, places[:count], places[count:])
    own = [sheet.names.index(name) for name in long.own]
    which = [*map(sheet.names.index, long.shared), *wide.places_of(own)]
    turned = _sheet(part, wide, sorted(which))
    names = [_name(sheet, str(name)) for name in long.pivot.frame]
    pivot = Pivot(tuple(names), tuple(_name(sheet, str(name)) for name in long.pivot.marker))
    return replace(
        sheet,
        names=turned.names,
        bare=turned.bare,
        units=turned.units,
        numbers=turned.numbers,
        texts={name: texts for name, texts in sheet.texts.items() if name in long.shared},
        stated=wide.declared.odd_units or {},
        pivot=pivot,
        why=long.why,
    )


def _name(sheet: Sheet, name: str) -> str | int:
    """Return a column as in a mapping: by number if its name repeats."""
    k = sheet.names.index(name)
    return k if sheet.bare.count(sheet.bare[k]) > 1 else name


def _sheets_of_recording(group: list[Part]) -> list[Sheet]:
    """Return a sheet for each decodable topic."""
    path = (
        group[0].given
        if group[0].of_folder or len(group) == 1
        else group[0].path.with_name(pattern_of(group))
    )
    recorded = {topic.name: topic for part in group for topic in topics_of(part) if topic.readable}
    if not recorded:
        raise _nothing_readable(path, [topic for part in group for topic in topics_of(part)])
    sheets = []
    for name in recorded:
        held = open_recording(group, name, ROWS)
        cells = held.read(list(range(len(held.names))), None, ROWS)
        numbers = np.where(np.abs(cells.numbers) < LARGEST, cells.numbers, np.nan)
        kind, file = recorded[name].type, pattern_of(group)
        sheets.append(
            Sheet(path, name, held.names, {}, numbers, {}, kind=kind, file=file, indexed=True)
        )
    return sheets


def _nothing_readable(path: Path, recorded: list[Topic]) -> RunError:
    """Return the error that no topic of a recording is readable, with the reason."""
    named = ", ".join(f"{topic.name} ({topic.type})" for topic in recorded)[:200] or "none"
    if not any(topic.count for topic in recorded):
        return RunError(f"{path}: holds no message (topics: {named}); give the recording of a run")
    return RunError(
        f"{path}: no topic holds messages in cdr of ros2msg, as rosbag2 writes; there are "
        f"{named}; convert the recording where ROS knows its types: `ros2 bag convert` to MCAP"
    )


def _sheet(part: Part, columns: Columns, which: list[int]) -> Sheet:
    """Return the first rows of some columns of a log."""
    if len(which) > MOST_COLUMNS:
        raise RunError(
            f"{part.path}: {len(which)} columns, at most {MOST_COLUMNS} are looked at; name those "
            "of the robot in a mapping by hand: docs/reference/mapping.md lists its keys"
        )
    bare = [columns.names[k] for k in which]
    if isinstance(columns, TextColumns | HeldColumns):
        columns = replace(columns, names=_unique(columns.names))
    names = [columns.names[k] for k in which]
    texts: dict[str, list[str]] = {}
    clocks: dict[str, str] = {}
    below: list[str] = []
    if isinstance(columns, TextColumns):
        below = lines_below(
            columns.path,
            columns.delimiter,
            len(columns.names),
            columns.fewest or len(columns.names),
        )
        columns = replace(columns, skip_last=len(below))
    if isinstance(columns, TextColumns | PacedColumns | PivotedColumns):
        texts = columns.texts(200)
        refuse_unit_cells(part.path, texts)
        clocks = {columns.names[k]: clock.form for k, clock in columns.clocks.items()}
    if isinstance(columns, ArrayColumns):
        texts = {columns.names[k]: columns.texts[k][:200] for k in which if k in columns.texts}
    places = [k for k in which if columns.names[k] not in texts]
    cells = columns.read(places, None, ROWS).numbers[:ROWS]
    numbers = np.full((len(cells), len(names)), np.nan)
    at = [which.index(k) for k in places]
    numbers[:, at] = np.where(np.abs(cells) < LARGEST, cells, np.nan)
    if isinstance(columns, TextColumns) and len(gone := summaries(numbers)):
        numbers = np.delete(numbers, gone, axis=0)
        texts = {name: _without(cells, gone.tolist()) for name, cells in texts.items()}
    header = not isinstance(columns, TextColumns) or columns.header
    arrays = isinstance(columns, ArrayColumns)
    episode = (
        int(numbers[0, names.index(EPISODE)])
        if part.kind == "parquet" and EPISODE in names
        else None
    )
    file = pattern_of([part])
    return Sheet(
        part.given,
        None,
        names,
        dict(columns.units),
        numbers,
        texts,
        header,
        bare,
        file=file,
        indexed=arrays,
        episode=episode,
        clocks=clocks,
        below=below,
        head_line=columns.head_line,
        rate_hz=None if columns.declared.rate is None else columns.declared.rate[1],
        stated=columns.declared.odd_units or {},
        booleans=frozenset(columns.names[k] for k in which if k in columns.declared.booleans),
    )


def _without(texts: list[str], gone: list[int]) -> list[str]:
    """Return the texts of the first rows without those of some rows."""
    return [text for k, text in enumerate(texts) if k not in gone]


def _unique(names: list[str]) -> list[str]:
    """Return unique names: the number of the column is appended to repeated names."""
    count = Counter(names)
    return [f"{name} (column {k})" if count[name] > 1 else name for k, name in enumerate(names)]


# --- names ---------------------------------------------------------------------------------
