"""Add a `time` column to a log with a stated rate, from frame or row numbers."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from softmap_edge.errors import RunError
from softmap_edge.logs.readers.columns import Cells, Declared
from softmap_edge.logs.readers.text import TextColumns
from softmap_edge.logs.time_text import TimeText

TIME = "time"


@dataclass(frozen=True)
class PacedColumns:
    """A text log with an additional last column `time` (s), from frame or row numbers.

    The file states the rate.

    Attributes:
        inner: the columns of the file.
        rate_hz: rows or frames per second.
        frame: position of the frame number column; None to count rows.
        first_frame: frame number at `start_s`.
        start_s: time of the first frame.
    """

    inner: TextColumns
    rate_hz: float
    frame: int | None = None
    first_frame: float = 1.0
    start_s: float = 0.0
    declared: Declared = field(default_factory=Declared)

    @property
    def path(self) -> Path:
        """The file."""
        return self.inner.path

    @property
    def names(self) -> list[str]:
        """The columns of the file, and `time`."""
        return [*self.inner.names, TIME]

    @property
    def units(self) -> dict[str, str]:
        """The units that the file states, and s."""
        return self.inner.units | {TIME: "s"}

    @property
    def where(self) -> str:
        """The word for a row."""
        return self.inner.where

    @property
    def clocks(self) -> dict[int, TimeText]:
        """The columns of dates or times."""
        return self.inner.clocks

    @property
    def header(self) -> bool:
        """Whether the columns have names."""
        return self.inner.header

    @property
    def head_line(self) -> int | None:
        """The line number of the column names."""
        return self.inner.head_line

    def texts(self, rows: int) -> dict[str, list[str]]:
        """Return the columns with text in the first rows, and that text."""
        return self.inner.texts(rows)

    def read(self, places: list[int], label: int | None = None, rows: int | None = None) -> Cells:
        """Return the cells of some columns.

        Raises:
            RunError: as `TextColumns.read`.
        """
        at = len(self.inner.names)
        if at not in places:
            return self.inner.read(places, label, rows)
        asked = [place for place in places if place != at]
        counted = [] if self.frame is None or self.frame in asked else [self.frame]
        cells = self.inner.read([*asked, *counted], label, rows)
        if self.frame is None:
            count = np.arange(len(cells.numbers), dtype=float)
        else:
            count = cells.numbers[:, [*asked, *counted].index(self.frame)] - self.first_frame
        table = np.empty((len(cells.numbers), len(places)))
        for j, place in enumerate(places):
            time = self.start_s + count / self.rate_hz
            table[:, j] = time if place == at else cells.numbers[:, asked.index(place)]
        note = (
            f"time counts {'rows' if self.frame is None else 'frames'} at {self.rate_hz:g} Hz, as "
            "the file states"
        )
        return replace(cells, numbers=table, notes=(*cells.notes, note))


def paced(
    columns: TextColumns, rate: str, frame: str | None = None, first_frame: float = 1.0
) -> TextColumns | PacedColumns:
    """Return a log with a column `time`, if it lacks one and states a rate.

    Args:
        columns: the log.
        rate: in Hz, as written in the file.
        frame: name of the frame number column; None to count rows.
        first_frame: number of the frame at 0 s.

    Raises:
        RunError: the rate is not a positive number.
    """
    if TIME in columns.names:
        return columns
    try:
        hertz = float(rate.replace(",", "."))
    except ValueError:
        hertz = 0.0
    if not 1e-3 <= hertz <= 1e7:
        raise RunError(
            f"{columns.path}: states the rate '{rate[:20]}', expected frames a second; correct "
            "it, or export again"
        )
    place = columns.names.index(frame) if frame is not None and frame in columns.names else None
    return PacedColumns(columns, hertz, place, first_frame)
