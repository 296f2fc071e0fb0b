"""Read the files of one log in sequence: parts of a split bag, or logs with equal mappings.

The day-month order of dates is decided by all parts together. Parts whose times of day restart
after midnight follow those before it. Parts of any other clock that rolls over are ordered by name,
if the mapping mends roll-overs. Pinned by tests/logs/test_csv_parts.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from softmap_edge.errors import RunError, differing_times
from softmap_edge.logs.numbered import numbers_in, without_numbers
from softmap_edge.logs.readers.columns import Array, Cells, Columns, Declared
from softmap_edge.logs.readers.text import TextColumns
from softmap_edge.logs.table import place, raw_times
from softmap_edge.logs.time_keys import Clock
from softmap_edge.logs.time_text import (
    DAY,
    ORDER_WORDS,
    TimeText,
    TimeTextError,
    around_the_clock,
    common_order,
)


@dataclass(frozen=True)
class JoinedColumns:
    """The columns of several files joined; a column missing in a file is empty in its rows.

    Attributes:
        path: the path shown in messages.
        parts: each open file, with its name.
        clock: the time that determines their order, of one column or several.
        notes: sentences on all parts.
    """

    path: Path
    parts: tuple[tuple[str, Columns], ...]
    clock: Clock
    notes: tuple[str, ...] = ()
    declared: Declared = field(default_factory=Declared)

    @property
    def names(self) -> list[str]:
        """The columns of all files, in order of first occurrence."""
        if self._alike():  # a name may occur twice
            return self.parts[0][1].names
        return list(dict.fromkeys(name for _, columns in self.parts for name in columns.names))

    def _alike(self) -> bool:
        return all(columns.names == self.parts[0][1].names for _, columns in self.parts)

    @property
    def units(self) -> dict[str, str]:
        """The units stated by the files."""
        return {
            name: unit
            for _, columns in reversed(self.parts)
            for name, unit in columns.units.items()
        }

    @property
    def clocks(self) -> dict[int, TimeText]:
        """The columns of dates or times."""
        names, found = self.names, dict[int, TimeText]()
        for _, columns in reversed(self.parts):
            found |= {names.index(columns.names[k]): clock for k, clock in columns.clocks.items()}
        return found

    @property
    def head_line(self) -> None:
        """Line number of the column names: none, because each file has its own."""

    @property
    def where(self) -> str:
        """The word for a row."""
        return self.parts[0][1].where

    def read(self, places: list[int], label: int | None = None, rows: int | None = None) -> Cells:
        """Return the cells of some columns of all files, in order of time.

        Raises:
            RunError: two files overlap in time.
        """
        read = [self._read(columns, places, label, rows) for _, columns in self.parts]
        cells, times = [one for one, _ in read], [_known(t) for _, t in read]
        order, turns = self._order(times)
        times = [t + turn for t, turn in zip(times, turns)]
        rolls = self._rolls(times)
        notes, doubts = [*self.notes], [] if rolls else self._doubts(order)
        if any(turns):
            at = places.index(place(self.path, self.names, self.clock.columns[0]))
            for one, turn in zip(cells, turns):
                one.numbers[:, at] += turn
            after = ", ".join(self.parts[k][0] for k in order if turns[k] > min(turns))
            what = "midnight" if self._period == DAY else "the full hour"
            notes.append(f"the time passes {what} and counts on in later parts: {after[:400]}")
        listed = ", ".join(self.parts[k][0] for k in order)
        notes.insert(
            0,
            f"{len(order)} parts read one after another: "
            f"{listed[:400]}{'' if rolls else _pause(order, times)}",
        )
        cells = [cells[k] for k in order]
        labels = (
            None if label is None else np.concatenate([np.asarray(one.labels) for one in cells])
        )
        notes += [
            _noted(self.parts[k][0], note) for k, one in zip(order, cells) for note in one.notes
        ]
        doubts += [
            _noted(self.parts[k][0], doubt) for k, one in zip(order, cells) for doubt in one.doubts
        ]
        return Cells(
            np.concatenate([one.numbers for one in cells])[:rows],
            None if labels is None else labels[:rows],
            np.concatenate([one.lines for one in cells])[:rows],
            tuple(notes),
            doubts=tuple(doubts),
        )

    @property
    def _period(self) -> float:
        """Return the period (s) of a time of day without a date; 0 for any other time."""
        names, columns = self.names, self.clock.columns
        clocks = [self.clocks.get(place(self.path, names, column)) for column in columns]
        return clocks[0].period if len(clocks) == 1 and clocks[0] is not None else 0.0

    def _order(self, times: Sequence[Array]) -> tuple[list[int], list[float]]:
        """Return the order of the files, and the offset (s) of the times of each.

        Raises:
            RunError: two files overlap in time.
        """
        spans = [(float(t.min()), float(t.max())) for t in times]
        still = [0.0] * len(times)
        period = self._period
        if period:
            order, turns = around_the_clock(spans, period)
            still = [period * turn for turn in turns]
        elif self._rolls(times):
            return self._by_name(), still
        else:
            order = sorted(range(len(times)), key=lambda k: spans[k])
        self._apart(order, [t + turn for t, turn in zip(times, still)])
        return order, still

    def _rolls(self, times: Sequence[Array]) -> bool:
        """Return whether a clock declared to roll over continues from file to file."""
        if (
            self.clock.jumps != "mend"
            or self._period
            or len({without_numbers(name) for name, _ in self.parts}) > 1
        ):
            return False
        order = self._by_name()
        falls = any((np.diff(t) < 0).any() for t in times)
        return falls or any(
            times[k].max() > times[later].min() for k, later in zip(order, order[1:])
        )

    def _by_name(self) -> list[int]:
        """Return the order of the files by the numbers in their names."""
        names = [name for name, _ in self.parts]
        return sorted(range(len(names)), key=lambda k: numbers_in(names[k]))

    def _doubts(self, order: Sequence[int]) -> list[str]:
        """Return a doubt if the numbers in the names indicate another order.

        A restarting clock must be explained by that order.
        """
        named = self._by_name()
        dated = any(
            place(self.path, self.names, column) in self.clocks for column in self.clock.columns
        )
        turned = any([*named[k:], *named[:k]] == [*order] for k in range(1, len(named)))
        if len({without_numbers(name) for name, _ in self.parts}) > 1 or [*order] == named:
            return []
        if self._period:
            return [
                "t: the parts follow one another by their times of day, not by their names: give "
                "dates if it is wrong"
            ]
        if dated or not turned:
            return []
        return [
            "t: the parts follow one another by their times, not by the numbers in their names: "
            "if the clock rolled "
            'over between two of them, set time.jumps = "mend"'
        ]

    def _read(
        self, columns: Columns, places: list[int], label: int | None, rows: int | None
    ) -> tuple[Cells, Array]:
        """Return the cells of some columns of one file, and their times (rows,) s.

        Missing columns are NaN.
        """
        own = self._places(columns)
        clocks = [place(self.path, columns.names, column) for column in self.clock.columns]
        here = sorted({*(own[k] for k in places if k in own), *clocks})
        cells = columns.read(here, own.get(label) if label is not None else None, rows)
        numbers = np.full((len(cells.lines), len(places)), np.nan)
        for j, k in enumerate(places):
            if k in own:
                numbers[:, j] = cells.numbers[:, here.index(own[k])]
        labels = (
            np.full(len(numbers), "") if label is not None and label not in own else cells.labels
        )
        times = raw_times(self.path, columns, cells, here, self.clock)
        return Cells(numbers, labels, cells.lines, cells.notes, doubts=cells.doubts), times

    def _places(self, columns: Columns) -> dict[int, int]:
        """Return the positions of a file's columns by their positions among those of all files."""
        if self._alike():
            return {k: k for k in range(len(columns.names))}
        return {
            k: columns.names.index(name)
            for k, name in enumerate(self.names)
            if name in columns.names
        }

    def _apart(self, order: Sequence[int], times: list[Array]) -> None:
        """Raise RunError if two files overlap in time."""
        for k, later in zip(order, order[1:]):
            if times[k].max() > times[later].min():
                end, begin = differing_times(float(times[k].max()), float(times[later].min()))
                name = " and ".join(str(column) for column in self.clock.columns)
                raise RunError(
                    f"{self.path}: {self.parts[k][0]} and {self.parts[later][0]} overlap in time "
                    f"({name} ends at {end} s and begins at {begin} s), so they are not parts of "
                    "one recording; import each by itself, then join the runs with `softmap run "
                    "join`"
                )


def joined(path: Path, parts: Sequence[tuple[str, Columns]], clock: Clock) -> JoinedColumns:
    """Return several files as one log, with one day-month order for all dates.

    Raises:
        RunError: the dates of all parts together do not decide the order.
    """
    opened, notes = list(parts), list[str]()
    for column in clock.columns:
        dates = {
            k: columns.both_orders(at)
            for k, (_, columns) in enumerate(opened)
            if isinstance(columns, TextColumns)
            and (form := columns.clocks.get(at := place(path, columns.names, column))) is not None
            and (form.form, form.order) == ("local", None)
        }
        try:
            order = common_order([*dates.values()]) if dates else None
        except TimeTextError as fault:
            remedy = 'set time.date_order = "dmy" or "mdy" in the mapping'
            raise RunError(f"{path}: column {column}: {fault.args[0]}; {remedy}") from None
        if order is not None:
            notes.append(
                f"{column}: the dates are {ORDER_WORDS[order]}, as all parts together show"
            )
            opened = [
                (
                    name,
                    columns.dated(order)
                    if k in dates and isinstance(columns, TextColumns)
                    else columns,
                )
                for k, (name, columns) in enumerate(opened)
            ]
    return JoinedColumns(path, tuple(opened), clock, tuple(notes))


def _known(times: Array) -> Array:
    """Return the times of the rows that have one; 0 without any."""
    known = times[np.isfinite(times)]
    return known if len(known) else np.zeros(1)


def _pause(order: Sequence[int], times: list[Array]) -> str:
    """Return a text on the longest pause between two files."""
    pauses = [float(times[later].min() - times[k].max()) for k, later in zip(order, order[1:])]
    return f"; the longest pause between two is {max(pauses):.3g} s" if pauses else ""


def _noted(name: str, note: str) -> str:
    """Return a note prefixed with the name of its part; a subclass of str keeps its type."""
    return f"{name}: {note}" if type(note) is str else note
