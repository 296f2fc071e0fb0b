"""A mapping's `time`: columns, units, and treatment of times that do not increase."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.files.toml import TomlTable, shown
from softmap_edge.logs.measured import Column
from softmap_edge.logs.time_text import ORDERS
from softmap_edge.run.fields import ROW_S

KEYS = (
    *("column", "unit", "rate_hz", "columns", "units", "offset_s"),
    *("repeated", "jumps", "date_order", "assumed"),
)
NO_TIME = "none"  # the `time` of a log without time: rows are counted
# → s; Windows counts in 100ns
TIME = {
    **{"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "100ns": 1e-7},
    **{"min": 60.0, "h": 3600.0, "d": 86400.0},
}

_WHOLE = 1e-6  # of a count: rounding error of text with few digits


def fractions(counts: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which counts (rows,) are not whole numbers; missing ones are not included."""
    return np.isfinite(counts) & (np.abs(counts - np.rint(counts)) > _WHOLE)


@dataclass(frozen=True)
class Clock:
    """The time of a log: columns with units, a counter or row number at a rate, or none.

    Attributes:
        column: the column of time, or of the seconds; None for the row number.
        seconds: s per unit, or per count.
        offset_s: added to every time.
        repeated: treatment of rows whose time does not increase.
        timeless: whether the log has no time.
        date_order: `dmy` or `mdy` for dates such as 5/7/2031; None: the rows decide.
        more: columns to add, with s per unit of each: nanoseconds to seconds, a time of day to a
            date.
        jumps: `mend` to unwrap a roll-over, and to remove one step of a set clock.
        assumed: whether the rate is an assumption.
        counter: whether the column counts rows or frames, at the rate in the mapping.
    """

    column: Column | None
    seconds: float
    offset_s: float = 0.0
    repeated: str = "refuse"
    timeless: bool = False
    date_order: str | None = None
    more: tuple[tuple[Column, float], ...] = ()
    jumps: str = "refuse"
    assumed: bool = False
    counter: bool = False

    @property
    def columns(self) -> list[Column]:
        """The columns that form the time."""
        return [
            *([] if self.column is None else [self.column]),
            *(column for column, _ in self.more),
        ]


def clock_of(log: TomlTable) -> Clock:
    """Return the time declared by a `[[log]]`.

    Raises:
        RunError: it declares none, or a key is invalid.
    """
    given = log.values.get("time")
    if given == NO_TIME:
        return Clock(None, ROW_S, timeless=True)
    if isinstance(given, str):
        raise RunError(
            f"{log.where}: time = '{shown(given)}', expected a table such as {{ column = \"t\" "
            f"}}, or time = "
            f'"{NO_TIME}" (in lower case) for a log without time'
        )
    time = log.table("time")
    time.only(KEYS)
    rate = time.number("rate_hz", None, 1e-6, 1e7)
    several = _columns(time)
    one = time.get("column", (str, int))
    if one is not None and several:
        raise RunError(f"{time.where}: column and columns; give one of them")
    if one is None and not several and rate is None:
        raise RunError(
            f"{time.where}: needs `column`, `rate_hz`, or both (a counter), or `columns`; say "
            "where the log has its "
            f'time, or time = "{NO_TIME}" if it has none'
        )
    if several and rate is not None:
        raise RunError(
            f"{time.where}: columns and rate_hz; leave rate_hz out, or give one column, a counter"
        )
    unit = time.choice("unit", tuple(TIME), "s")
    column, seconds = one, TIME[unit]
    if several:
        column, seconds = several[0]
    elif rate is not None:
        seconds = 1.0 / rate
    return Clock(
        column=column,
        seconds=seconds,
        offset_s=time.number("offset_s", 0.0) or 0.0,
        repeated=time.choice("repeated", ("refuse", "drop", "spread"), "refuse"),
        date_order=_date_order(time),
        more=tuple(several[1:]),
        jumps=time.choice("jumps", ("refuse", "mend"), "refuse"),
        assumed=bool(time.get("assumed", (bool,), False)),
        counter=one is not None and rate is not None,
    )


def _date_order(time: TomlTable) -> str | None:
    if time.get("date_order", (str,)) is None:
        return None
    return time.choice("date_order", ORDERS, ORDERS[0])


def _columns(time: TomlTable) -> list[tuple[Column, float]]:
    """Return the columns that are summed to a time, with s per unit of each."""
    listed = time.get("columns", (list,))
    units = time.get("units", (list,))
    if listed is None:
        if units is not None:
            raise RunError(
                f"{time.where}: units without columns; give both, or `column` and `unit`"
            )
        return []
    if len(listed) != 2 or not all(
        isinstance(c, str | int) and not isinstance(c, bool) for c in listed
    ):
        raise RunError(
            f'{time.where}: columns = {shown(listed)}, expected two: ["sec", "nanosec"], or a '
            "date and a time of day"
        )
    units = ["s", "ns"] if units is None else units
    if len(units) != 2 or not all(isinstance(unit, str) and unit in TIME for unit in units):
        raise RunError(f"{time.where}: units = {shown(units)}, expected two of {', '.join(TIME)}")
    if "unit" in time.values:
        raise RunError(f'{time.where}: unit with columns; give units = ["s", "ns"]')
    return [(column, TIME[unit]) for column, unit in zip(listed, units)]
