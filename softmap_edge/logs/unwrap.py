"""Unwrap commands and encoders of a log over roll-overs that the mapping declares.

Other roll-overs are reported.
"""

from __future__ import annotations

import numpy as np

from softmap_edge.errors import RunError
from softmap_edge.logs.mapping import Quantity
from softmap_edge.logs.table import LogTable
from softmap_edge.run.rollover import DRIVES, Floats, roll_over, roll_over_line, unwrapped

_GAP = 1.5  # usual steps between rows: a longer one is a gap
_NEAR = 5  # rows on either side of a gap that show the speed


def counted_on(
    name: str, table: LogTable, quantity: Quantity, notes: list[str], doubts: list[str]
) -> Floats:
    """Return raw values (rows, columns) of a quantity, unwrapped over declared roll-overs.

    Args:
        name: of the quantity.
        table: the log.
        quantity: its columns, and the size of their turns.
        notes: receives what was unwrapped.
        doubts: receives undeclared roll-overs.

    Raises:
        RunError: a column spans more than one turn.
    """
    values = table.numbers(quantity.columns)
    if name not in DRIVES:
        return values
    named = [
        f"'{column}'" if isinstance(column, str) else f"column {column}"
        for column in quantity.columns
    ]
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
                f"{table.path}: {named[c]} spans {float(np.ptp(known)):.7g}, more than "
                f"{name}.unwrap = {turn:.7g}; give the size of a full turn in the unit of the "
                "log, or leave unwrap out"
            )
        values[:, c], jumps = unwrapped(values[:, c], float(turn))
        count += jumps
        doubts += _over_gaps(name, named[c], table.t, values[:, c], float(turn))
    notes.append(f"{name}: counts on over {count} roll-overs (unwrap)")
    return values


def _over_gaps(name: str, column: str, t: Floats, values: Floats, turn: float) -> list[str]:
    """Return a doubt on gaps in which a channel (T,) may have turned by more than half a turn.

    Unwrapping then counts too few turns.
    """
    known = np.flatnonzero(np.isfinite(values))
    step, moved = np.diff(t[known]), np.abs(np.diff(values[known]))
    if len(step) < 2 or (step <= 0).any():
        return []
    usual = float(np.median(step))
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(moved / step, _NEAR), 2 * _NEAR + 1)
    far = np.flatnonzero((step > _GAP * usual) & (windows.max(axis=1) * step > 0.5 * turn))
    if not len(far):
        return []
    first = int(far[0])
    return [
        f"{name}: {column} has {len(far)} gaps in which it may turn by more than half a turn at "
        f"its speed (the first lasts {step[first]:.3g} s after {t[known[first]]:.6g} s): the "
        "fewest turns are counted, and later rows may be off by whole turns; cut the log there "
        "with to_row and from_row"
    ]
