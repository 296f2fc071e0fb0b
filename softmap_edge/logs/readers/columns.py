"""The interface of all log readers: named columns, with cells that are read on request."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError

if TYPE_CHECKING:
    from softmap_edge.logs.time_text import TimeText

Array = NDArray[np.float64]
_MOST_LETTERS = 2**28  # of an array of texts: 1 GiB


@dataclass(frozen=True)
class Cells:
    """The requested columns; a missing cell is NaN.

    Attributes:
        numbers: (rows, columns).
        labels: (rows,) text of the label column, if requested.
        lines: (rows,) line (or frame, or message) of the file for each row, used in messages.
        notes: sentences on what the reader did.
        rows: (rows,) number of each row in its log, from 0; None until a row is left out.
        doubts: sentences on suspicious findings.
    """

    numbers: Array
    labels: NDArray[np.generic] | None
    lines: NDArray[np.int64]
    notes: tuple[str, ...] = ()
    rows: NDArray[np.int64] | None = None
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True)
class Declared:
    """What a file states about its columns besides their names and known units.

    Attributes:
        odd_units: cells of a line of units that are not known; None if the file is not a text.
        rate: name and value (Hz) of the rate of the rows.
        booleans: positions of the columns that the file holds as booleans.
    """

    odd_units: dict[str, str] | None = None
    rate: tuple[str, float] | None = None
    booleans: frozenset[int] = frozenset()


class Columns(Protocol):
    """An open log: its columns are known, its cells not yet read."""

    @property
    def names(self) -> list[str]:
        """The names of the columns, in the file's order."""

    @property
    def units(self) -> dict[str, str]:
        """The units of columns, where the file states them: `mm`, `m`, …"""

    @property
    def declared(self) -> Declared:
        """What else the file states about its columns."""

    @property
    def where(self) -> str:
        """The word for a row in this file: line, frame or message."""

    @property
    def clocks(self) -> dict[int, TimeText]:
        """The columns of dates or times as text, by position."""

    @property
    def head_line(self) -> int | None:
        """The line number of the column names; None if there are none."""

    def read(self, places: list[int], label: int | None = None, rows: int | None = None) -> Cells:
        """Return the cells of columns by position; `rows` limits the number of rows read."""


def text_array(path: Path, name: str, texts: list[str]) -> NDArray[np.generic]:
    """Return the texts of a column as an array, where each takes the room of the longest.

    Raises:
        RunError: that is too much.
    """
    longest = max(map(len, texts), default=0)
    if longest * len(texts) > _MOST_LETTERS:
        raise RunError(
            f"{path}: column {name}: its longest text has {longest} characters, too many for "
            f"labels of {len(texts)} rows; name another column"
        )
    return np.array(texts)


def quiet(numbers: Array) -> Array:
    """Replace signalling NaNs of damaged bytes by ordinary ones, in place; return the numbers."""
    numbers[np.isnan(numbers)] = np.nan
    return numbers


def as_floats(values: object) -> Array:
    """Return numbers as float64; signalling NaNs of damaged bytes become NaN without a warning."""
    with np.errstate(invalid="ignore"):
        return np.asarray(values, np.float64)


def as_floats_or_booleans(values: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return numbers as float64, and booleans unchanged."""
    return values if values.dtype.kind == "b" else as_floats(values)


@dataclass(frozen=True)
class HeldColumns:
    """Columns of a binary format that the reader already holds in memory."""

    path: Path
    names: list[str]
    numbers: Array  # (rows, names)
    units: dict[str, str] = field(default_factory=dict)
    texts: dict[int, list[str]] = field(default_factory=dict)
    where: str = "frame"
    notes: tuple[str, ...] = ()
    declared: Declared = field(default_factory=Declared)

    @property
    def clocks(self) -> dict[int, TimeText]:
        """Columns of dates or times as text: none."""
        return {}

    @property
    def head_line(self) -> None:
        """Line number of the column names: none."""

    def read(self, places: list[int], label: int | None = None, rows: int | None = None) -> Cells:
        """Return the cells of some columns."""
        numbers = quiet(self.numbers[:rows, places])
        lines = np.arange(1, len(numbers) + 1)
        if label is None:
            return Cells(numbers, None, lines, self.notes)
        texts = self.texts.get(label)
        labels = [f"{x:g}" for x in self.numbers[:rows, label]] if texts is None else texts[:rows]
        return Cells(numbers, np.array(labels), lines, self.notes)
