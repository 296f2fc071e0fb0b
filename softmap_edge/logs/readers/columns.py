"""What every reader of a log gives: named columns whose cells are read when they are asked for."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from softmap_edge.logs.time_text import TimeText

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Cells:
    """The columns that were asked for; an absent cell is NaN.

    Attributes:
        numbers: (rows, columns).
        labels: (rows,) text of the column of labels, if one was asked for.
        lines: (rows,) the line (or frame, or message) of the file that holds each row, for
            messages.
        notes: what the reader did, a sentence each.
        rows: (rows,) the number of each row in its log, from 0; None before any row was left out.
        doubts: what looks wrong, a sentence each.
    """

    numbers: Array
    labels: NDArray[np.generic] | None
    lines: NDArray[np.int64]
    notes: tuple[str, ...] = ()
    rows: NDArray[np.int64] | None = None
    doubts: tuple[str, ...] = ()


class Columns(Protocol):
    """One log, opened: its columns are known, its cells not yet read."""

    @property
    def names(self) -> list[str]:
        """The columns, in the file's order."""

    @property
    def units(self) -> dict[str, str]:
        """The unit of a column, where the file states it: `mm`, `m`, …"""

    @property
    def where(self) -> str:
        """What a row is called in this file: line, frame or message."""

    @property
    def clocks(self) -> dict[int, TimeText]:
        """The columns of dates or times as text, by position."""

    @property
    def head_line(self) -> int | None:
        """The number of the line that names the columns; None where no line does."""

    def read(self, places: list[int], label: int | None = None, rows: int | None = None) -> Cells:
        """Return the cells of some columns by their positions; `rows` ends the reading early."""


def quiet(numbers: Array) -> Array:
    """Replace signalling NaNs by ordinary ones, in place; return the numbers.

    Damaged bytes may hold signalling ones.
    """
    numbers[np.isnan(numbers)] = np.nan
    return numbers


def as_floats(values: object) -> Array:
    """Return numbers as float64; signalling NaNs, as of damaged bytes, are NaN, unwarned."""
    with np.errstate(invalid="ignore"):
        return np.asarray(values, np.float64)


@dataclass(frozen=True)
class HeldColumns:
    """Columns that a reader of a binary format has in memory already."""

    path: Path
    names: list[str]
    numbers: Array  # (rows, names)
    units: dict[str, str] = field(default_factory=dict)
    texts: dict[int, list[str]] = field(default_factory=dict)
    where: str = "frame"
    notes: tuple[str, ...] = ()

    @property
    def clocks(self) -> dict[int, TimeText]:
        """Its columns of dates or times as text: none."""
        return {}

    @property
    def head_line(self) -> None:
        """The number of the line that names the columns: there is none."""

    def read(self, places: list[int], label: int | None = None, rows: int | None = None) -> Cells:
        """Return the cells of some columns."""
        numbers = quiet(self.numbers[:rows, places])
        lines = np.arange(1, len(numbers) + 1)
        if label is None:
            return Cells(numbers, None, lines, self.notes)
        texts = self.texts.get(label)
        labels = [f"{x:g}" for x in self.numbers[:rows, label]] if texts is None else texts[:rows]
        return Cells(numbers, np.array(labels), lines, self.notes)
