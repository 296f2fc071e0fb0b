"""Read several files of one log one after another: the parts of a split bag, or logs with equal mappings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from softmap_edge.errors import RunError
from softmap_edge.logs.readers.columns import Array, Cells, Columns
from softmap_edge.logs.time_text import TimeText


@dataclass(frozen=True)
class JoinedColumns:
    """The columns of several files as one; a column that a file lacks is empty in its rows.

    Attributes:
        path: the path that messages name.
        parts: each file opened, with its name.
        clock: the column that puts them in order.
    """

    path: Path
    parts: tuple[tuple[str, Columns], ...]
    clock: str

    @property
    def names(self) -> list[str]:
        """The columns of all files, those of the first ones first."""
        return list(dict.fromkeys(name for _, columns in self.parts for name in columns.names))

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
        names = self.names
        asked = [names[k] for k in places]
        read = [_read(columns, asked, None if label is None else names[label], rows) for _, columns in self.parts]
        times = [self._times(columns, rows) for _, columns in self.parts]
        order = sorted(range(len(times)), key=lambda k: float(times[k].min()))
        self._apart(order, times)
        cells = [read[k] for k in order]
        labels = None if label is None else np.concatenate([np.asarray(one.labels) for one in cells])
        notes = [_noted(self.parts[k][0], note) for k in order for note in read[k].notes]
        listed = ", ".join(self.parts[k][0] for k in order)
        notes.insert(0, f"{len(order)} parts read one after another: {listed[:400]}{self._pause(order, times)}")
        return Cells(
            np.concatenate([one.numbers for one in cells])[:rows],
            None if labels is None else labels[:rows],
            np.concatenate([one.lines for one in cells])[:rows],
            tuple(notes),
        )

    def _times(self, columns: Columns, rows: int | None) -> Array:
        """The times (s or whatever they count) of the rows of one file that have one."""
        times = columns.read([columns.names.index(self.clock)], None, rows).numbers[:, 0]
        known = times[np.isfinite(times)]
        return known if len(known) else np.zeros(1)

    def _apart(self, order: Sequence[int], times: list[Array]) -> None:
        for k, later in zip(order, order[1:]):
            if times[k].max() > times[later].min():
                raise RunError(
                    f"{self.path}: {self.parts[k][0]} and {self.parts[later][0]} overlap in time ({self.clock} ends at "
                    f"{times[k].max():.10g} and begins at {times[later].min():.10g}), so they are no parts of one "
                    "recording; give one of them, or assign each log by `file` in the mapping"
                )

    def _pause(self, order: Sequence[int], times: list[Array]) -> str:
        """Return a text on the longest pause between two files."""
        pauses = [float(times[later].min() - times[k].max()) for k, later in zip(order, order[1:])]
        unit = "s" if self.clock == "log_time" else f"in {self.clock[:40]}"
        return f"; the longest pause between two is {max(pauses):.3g} {unit}" if pauses else ""


def _noted(name: str, note: str) -> str:
    """Return a note with the name of its part; a note of a subclass of str keeps its type."""
    return f"{name}: {note}" if type(note) is str else note


def _read(columns: Columns, names: list[str], label: str | None, rows: int | None) -> Cells:
    """Return the cells of named columns of one file, NaN where it has no such column."""
    here = [name for name in names if name in columns.names]
    place = columns.names.index(label) if label is not None and label in columns.names else None
    cells = columns.read([columns.names.index(name) for name in here] or [0], place, rows)
    numbers = np.full((len(cells.lines), len(names)), np.nan)
    for k, name in enumerate(here):
        numbers[:, names.index(name)] = cells.numbers[:, k]
    labels = None if label is None else (np.full(len(numbers), "") if place is None else cells.labels)
    return Cells(numbers, labels, cells.lines, cells.notes)
