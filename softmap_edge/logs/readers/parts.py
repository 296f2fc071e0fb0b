"""Read several files of one log one after another: the parts of a split bag, or logs with equal mappings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from softmap_edge.errors import RunError
from softmap_edge.files.time_digits import differing
from softmap_edge.logs.readers.columns import Array, Cells, Columns
from softmap_edge.logs.table import place, raw_times
from softmap_edge.logs.time_keys import Clock
from softmap_edge.logs.time_text import TimeText


@dataclass(frozen=True)
class JoinedColumns:
    """The columns of several files as one; a column that a file lacks is empty in its rows.

    Attributes:
        path: the path that messages name.
        parts: each file opened, with its name.
        clock: the time that puts them in order, of one column or several.
    """

    path: Path
    parts: tuple[tuple[str, Columns], ...]
    clock: Clock

    @property
    def names(self) -> list[str]:
        """The columns of all files, those of the first ones first."""
        if self._alike():  # a name may stand twice
            return self.parts[0][1].names
        return list(dict.fromkeys(name for _, columns in self.parts for name in columns.names))

    def _alike(self) -> bool:
        return all(columns.names == self.parts[0][1].names for _, columns in self.parts)

    @property
    def units(self) -> dict[str, str]:
        """The units that the files state."""
        return {name: unit for _, columns in reversed(self.parts) for name, unit in columns.units.items()}

    @property
    def clocks(self) -> dict[int, TimeText]:
        """The columns of dates or times."""
        names, found = self.names, dict[int, TimeText]()
        for _, columns in reversed(self.parts):
            own: dict[int, TimeText] = getattr(columns, "clocks", {})
            found |= {names.index(columns.names[k]): clock for k, clock in own.items()}
        return found

    @property
    def where(self) -> str:
        """The name of a row."""
        return self.parts[0][1].where

    def read(self, places: list[int], label: int | None = None, rows: int | None = None) -> Cells:
        """Return the cells of some columns of all files, the earliest file first.

        Raises:
            RunError: two files overlap in time.
        """
        read = [self._read(columns, places, label, rows) for _, columns in self.parts]
        cells, times = [one for one, _ in read], [_known(t) for _, t in read]
        order = sorted(range(len(times)), key=lambda k: float(times[k].min()))
        self._apart(order, times)
        cells = [cells[k] for k in order]
        labels = None if label is None else np.concatenate([np.asarray(one.labels) for one in cells])
        notes = [_noted(self.parts[k][0], note) for k, one in zip(order, cells) for note in one.notes]
        listed = ", ".join(self.parts[k][0] for k in order)
        notes.insert(0, f"{len(order)} parts read one after another: {listed[:400]}{_pause(order, times)}")
        return Cells(
            np.concatenate([one.numbers for one in cells])[:rows],
            None if labels is None else labels[:rows],
            np.concatenate([one.lines for one in cells])[:rows],
            tuple(notes),
            doubts=tuple(_noted(self.parts[k][0], doubt) for k, one in zip(order, cells) for doubt in one.doubts),
        )

    def _read(self, columns: Columns, places: list[int], label: int | None, rows: int | None) -> tuple[Cells, Array]:
        """Return the cells of some columns of one file, NaN where it has no such column, and their times (rows,) s."""
        own = self._places(columns)
        clocks = [place(self.path, columns.names, column) for column in self.clock.columns]
        here = sorted({*(own[k] for k in places if k in own), *clocks})
        cells = columns.read(here, own.get(label) if label is not None else None, rows)
        numbers = np.full((len(cells.lines), len(places)), np.nan)
        for j, k in enumerate(places):
            if k in own:
                numbers[:, j] = cells.numbers[:, here.index(own[k])]
        labels = np.full(len(numbers), "") if label is not None and label not in own else cells.labels
        times = raw_times(self.path, columns, cells, here, self.clock)
        return Cells(numbers, labels, cells.lines, cells.notes, doubts=cells.doubts), times

    def _places(self, columns: Columns) -> dict[int, int]:
        """Return the places of a file's columns by their places among those of all files."""
        if self._alike():
            return {k: k for k in range(len(columns.names))}
        return {k: columns.names.index(name) for k, name in enumerate(self.names) if name in columns.names}

    def _apart(self, order: Sequence[int], times: list[Array]) -> None:
        """Raise RunError if two files overlap in time."""
        for k, later in zip(order, order[1:]):
            if times[k].max() > times[later].min():
                end, begin = differing(float(times[k].max()), float(times[later].min()))
                name = " and ".join(str(column) for column in self.clock.columns)
                raise RunError(
                    f"{self.path}: {self.parts[k][0]} and {self.parts[later][0]} overlap in time ({name} ends at "
                    f"{end} s and begins at {begin} s), so they are no parts of one recording; import each by itself, "
                    "then join the runs with `softmap run join`"
                )


def _known(times: Array) -> Array:
    """Return the times of the rows that have one; 0 without any."""
    known = times[np.isfinite(times)]
    return known if len(known) else np.zeros(1)


def _pause(order: Sequence[int], times: list[Array]) -> str:
    """Return a text on the longest pause between two files."""
    pauses = [float(times[later].min() - times[k].max()) for k, later in zip(order, order[1:])]
    return f"; the longest pause between two is {max(pauses):.3g} s" if pauses else ""


def _noted(name: str, note: str) -> str:
    """Return a note with the name of its part; a note of a subclass of str keeps its type."""
    return f"{name}: {note}" if type(note) is str else note
