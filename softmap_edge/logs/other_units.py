"""Report units of a mapping that contradict those that the log states for the same columns.

A log states a unit at the end of a column's name or in a line of units. The mapping is followed. A
`scale` other than 1 converts on purpose, so nothing is reported then. Pinned by
tests/logs/test_other_units.py.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from softmap_edge.logs.mapping import LENGTH, POINTS, UNITS, Quantity
from softmap_edge.logs.measured import Column, Measured
from softmap_edge.logs.time_keys import TIME, Clock
from softmap_edge.logs.time_names import time_unit
from softmap_edge.logs.unit_words import UNIT_WORDS, unit_in_name, unknown_unit

if TYPE_CHECKING:
    from softmap_edge.logs.table import LogTable

# words of one meaning that are not units of this program; ticks are counts of any kind
_SAME = {
    **dict.fromkeys(("%", "pct", "percent", "perc"), "%"),
    **dict.fromkeys(("tick", "count", "counts", "pulses", "steps", "raw", "lsb", "cnt"), "ticks"),
}
_FACTORS = 30  # factors that are written out
_ALONE = 1  # letters of a unit that is only read in brackets, since `cmd_a` may be command a


def doubts_of_units(
    name: str, table: LogTable, quantity: Quantity | Measured, units: Sequence[str] | None = None
) -> list[str]:
    """Return a doubt if the log states another unit than the mapping for some of the columns.

    Args:
        name: key in the mapping, such as `command`.
        table: the cells of the log.
        quantity: the columns with their unit.
        units: of each column, if they differ.
    """
    if (np.asarray(quantity.scale) != 1.0).any():
        return []
    found: dict[tuple[str, str], list[str]] = {}
    for column, unit in zip(quantity.columns, units or [quantity.unit] * len(quantity.columns)):
        label, stated = _stated(table, column)
        if stated is not None and not _alike(stated, unit):
            found.setdefault((stated, unit), []).append(label)
    said = [_stated(table, column) for column in quantity.columns] if found else []
    several = {stated for _, stated in said if stated is not None}
    mixed = name in POINTS and len(several) > 1 and several <= set(LENGTH)
    return [
        f"{name}: {labels[0]}{f' and {len(labels) - 1} more' if len(labels) > 1 else ''}: the file "
        f"states {stated}, the mapping {unit} and is followed; "
        + (_conversion(said) if mixed else _remedy(name, stated))
        for (stated, unit), labels in found.items()
    ]


def _conversion(said: Sequence[tuple[str, str | None]]) -> str:
    """Return what to set if the columns of places state several units of length.

    Args:
        said: name of each column, and the unit that the log states for it.
    """
    unit = next(unit for _, unit in said if unit is not None)
    factors = [LENGTH[one or unit] / LENGTH[unit] for _, one in said]
    scale = ", ".join(f"{factor:g}" for factor in factors[:_FACTORS])
    more = f", … (one factor for each of {len(factors)} columns)" if len(factors) > _FACTORS else ""
    return f'the columns state several units: set unit = "{unit}" and scale = [{scale}{more}]'


def doubts_of_clock(table: LogTable, clock: Clock, columns: Sequence[Column]) -> list[str]:
    """Return a doubt if the log states another unit of time than the mapping.

    Args:
        table: the cells of the log.
        clock: its time in the mapping.
        columns: those of its columns that hold numbers.
    """
    if clock.counter or clock.column is None:
        return []
    doubts = []
    for column, seconds in ((clock.column, clock.seconds), *clock.more):
        label, line = _label(table, column)
        stated = time_unit(label) if line is None else time_unit(line)
        factor = seconds if stated is None else TIME[stated]
        if column in columns and not np.isclose(factor, seconds, rtol=1e-6):
            doubts.append(
                f"t: {label}: the file states {stated}, the mapping {seconds:g} s for each unit "
                f'and is followed; set time.unit = "{stated}" if it is wrong'
            )
    return doubts


def _label(table: LogTable, column: Column) -> tuple[str, str | None]:
    """Return the name of a column, and its cell in a line of units."""
    label = table.name(column)
    if table.names.count(label) > 1:
        return label, None
    return label, table.units.get(label) or (table.odd_units or {}).get(label)


def _stated(table: LogTable, column: Column) -> tuple[str, str | None]:
    """Return the name of a column and the unit that the log states for it."""
    label, line = _label(table, column)
    if line is not None:
        known = UNIT_WORDS.get(line.strip("[](){} ").lower())
        return label, known or unknown_unit(label, line, UNIT_WORDS)
    text = table.odd_units is not None  # else brackets hold the name of a joint, or an index
    word = unit_in_name(label, UNIT_WORDS)
    bracket = label.rstrip().endswith(("]", ")"))
    if word is not None and (text if bracket else len(word) > _ALONE or word == "m"):
        return label, UNIT_WORDS[word]
    return label, unknown_unit(label, None, UNIT_WORDS) if text else None


def _alike(stated: str, unit: str) -> bool:
    one, other = (re.sub(r"[\s.·*]", "", word.lower()) for word in (stated, unit))
    names = _SAME | {word: known.lower() for word, known in UNIT_WORDS.items()}
    return names.get(one, one) == names.get(other, other)


def _remedy(name: str, stated: str) -> str:
    """Return what to set if the log is right."""
    if stated not in UNITS.get(name, ()):
        return "if the log is right, give `scale` and `offset`, or name the unit it states"
    if name in ("command", "present") and stated not in LENGTH:
        return f'set unit = "{stated}", with spool_radius_mm or command_unit, if it is wrong'
    return f'set unit = "{stated}" if it is wrong'
