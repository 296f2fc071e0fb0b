"""Read the part of a mapping for outputs other than positions (force, angle, level).

Pinned by tests/run/test_output.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.files.toml import TomlTable, shown

Array = NDArray[np.float64]
Column = str | int


@dataclass(frozen=True)
class Measured:
    """Columns of outputs other than positions (force, angle, level).

    An output is value · scale + offset, in `unit`.
    """

    columns: tuple[Column, ...]
    names: tuple[str, ...]
    unit: str
    scale: Array
    offset: Array
    not_seen: tuple[float, ...] | None = ()  # numbers that stand for "not seen"; None keeps all


def measured_of(log: TomlTable) -> Measured | None:
    """Return the outputs that a log declares, if any.

    Raises:
        RunError: a key of `output` is wrong, or its unit is missing.
    """
    if "output" not in log.values:
        return None
    table = log.table("output")
    table.only(("columns", "names", "unit", "scale", "offset", "not_seen"))
    columns = columns_of(table)
    names = table.get("names", (list,), [str(column) for column in columns])
    if len(names) != len(columns) or not all(isinstance(name, str) for name in names):
        raise RunError(
            f"{table.where}: names = {shown(names)}, expected {len(columns)} texts, one for each "
            "column"
        )
    unit = table.get("unit", (str,), "")
    if not unit:
        raise RunError(f'{table.where}: unit is missing; say what the numbers are: unit = "N"')
    return Measured(
        columns=tuple(columns),
        names=tuple(names),
        unit=unit,
        scale=scale_of(table, len(columns)),
        offset=per_column(table, "offset", len(columns), 0.0),
        not_seen=not_seen_of(table),
    )


def not_seen_of(table: TomlTable) -> tuple[float, ...] | None:
    """Return the numbers that a mapping declares as not seen; None if it keeps every number.

    Raises:
        RunError: `not_seen` is neither auto, keep nor a list of numbers.
    """
    given = table.get("not_seen", (str, list), "auto")
    if isinstance(given, str):
        if given not in ("auto", "keep"):
            raise RunError(
                f"{table.where}: not_seen = '{given[:60]}', expected auto, keep or a list of "
                "numbers"
            )
        return () if given == "auto" else None
    numbers = table.numbers("not_seen", (None,))
    assert numbers is not None
    return tuple(float(x) for x in numbers)


def columns_of(table: TomlTable) -> list[str | int]:
    """Return the columns that a table names, with nested lists flattened.

    Raises:
        RunError: there are none, or an entry is neither name nor number.
    """
    listed = table.get("columns", (list,), [])
    cells = [cell for entry in listed for cell in (entry if isinstance(entry, list) else [entry])]
    flat = [cell for cell in cells if isinstance(cell, str | int) and not isinstance(cell, bool)]
    if not flat or len(flat) < len(cells):
        raise RunError(
            f"{table.where}: columns = {str(listed)[:60]}, expected a list of column names or "
            "numbers"
        )
    return flat


def per_column(table: TomlTable, key: str, count: int, default: float) -> Array:
    """Return one number per column: the same for all, or a list."""
    if isinstance(table.values.get(key), list):
        values = table.numbers(key, (count,))
        assert values is not None
        return values
    return np.full(count, table.number(key, default))


def scale_of(table: TomlTable, count: int) -> Array:
    """Return the scale of each column, 1 unless given.

    Raises:
        RunError: one is 0, or is not a plain number.
    """
    scale = per_column(table, "scale", count, 1.0)
    if (scale == 0.0).any():
        raise RunError(
            f"{table.where}: scale = {shown(table.values['scale'])}: 0 makes every value the same; "
            "give the factor from the log to the unit, or leave the column out"
        )
    return scale
