"""Count commands and encoders of a log on over their roll-overs, as the mapping asks; report those it does not name."""

from __future__ import annotations

import numpy as np

from softmap_edge.errors import RunError
from softmap_edge.logs.mapping import Quantity
from softmap_edge.logs.table import LogTable
from softmap_edge.run.rollover import DRIVES, Floats, roll_over, roll_over_line, unwrapped


def counted_on(name: str, table: LogTable, quantity: Quantity, notes: list[str], doubts: list[str]) -> Floats:
    """Return the raw values (rows, columns) of a quantity, counted on over the roll-overs that the mapping declares.

    Args:
        name: of the quantity.
        table: the log. quantity: its columns, and the size of their turns.
        notes: receives what was counted on. doubts: receives roll-overs that the mapping does not declare.

    Raises:
        RunError: a column spans more than one turn.
    """
    values = table.numbers(quantity.columns)
    if name not in DRIVES:
        return values
    named = [f"'{column}'" if isinstance(column, str) else f"column {column}" for column in quantity.columns]
    if quantity.unwrap is None:
        found = [roll_over(column[np.isfinite(column)]) for column in values.T]
        line = roll_over_line(name, named, found)
        doubts += [] if line is None else [line]
        return values
    count = 0
    for c, turn in enumerate(quantity.unwrap):
        known = values[np.isfinite(values[:, c]), c]
        if len(known) and float(np.ptp(known)) > turn * (1 + 1e-9):
            raise RunError(
                f"{table.path}: {named[c]} spans {float(np.ptp(known)):.7g}, more than {name}.unwrap = {turn:.7g}; "
                "give the size of a full turn in the unit of the log, or leave unwrap out"
            )
        values[:, c], jumps = unwrapped(values[:, c], float(turn))
        count += jumps
    notes.append(f"{name}: counts on over {count} roll-overs (unwrap)")
    return values
