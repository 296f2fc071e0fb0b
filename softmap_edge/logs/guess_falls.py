"""Propose how to read a time column that falls in some rows; report what is doubtful.

A roll-over shows the unit: a counter of 2^32 is not a time since 1970. `jumps = "mend"` removes
steps of a clock that was set. `repeated = "drop"` leaves out other falls if enough rows remain.

Pinned by tests/logs/test_guess_falls.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.files.printable import listed
from softmap_edge.logs.clock import BITS, increasing
from softmap_edge.logs.set_clock import Jump, usual_step
from softmap_edge.logs.time_keys import TIME

Array = NDArray[np.float64]
_LOST = 0.3  # of the rows: if more are lost, leaving them out does not read the log
_SAME = 3.0  # usual steps: times closer together are the same start
_LISTED = 5  # steps that are listed
_NEAR = 9.0  # usual steps: distance from its period at which a counter rolls over


@dataclass(frozen=True)
class Treatment:
    """How to read a clock that falls.

    Attributes:
        keys: keys of the mapping.
        moves: the behaviour of the column, as a part of a sentence.
        doubt: what is unknown, as a sentence.
        seconds: (rows,) s as read; they rise nearly throughout.
    """

    keys: list[str]
    moves: str
    doubt: str
    seconds: Array


def treatment(t: Array, jump: Jump | None, name: str) -> Treatment:
    """Return how to read a clock that falls in some rows and does not roll over.

    Args:
        t: (rows,) s, finite.
        jump: the steps of a set clock that explain the falls; None if they do not.
        name: of the column.
    """
    rows = np.flatnonzero(np.diff(t) < 0) + 1
    first, largest = int(rows[0]), float(-np.diff(t).min())
    cut = f"or import the log in parts with to_row = {first - 1} and from_row = {first}"
    again = next((int(row) for row in rows if _starts_again(t, int(row))), None)
    if jump is not None and again is not None:
        cut = f"import the log in parts with to_row = {again - 1} and from_row = {again}"
        doubt = f"'{name}' starts again at row {again}, as in a second recording: {cut}"
        return Treatment(
            [], f"rises, but starts again at row {again}", doubt, _without_steps(t, rows)
        )
    if jump is not None:
        steps = listed((f"by {-np.diff(t)[row - 1]:.6g} s at row {row}" for row in rows), _LISTED)
        which = f"the step at row {first}" if len(rows) == 1 else f"{len(rows)} steps"
        doubt = (
            f"whether the clock '{name}' was set back {steps}: jumps = \"mend\" takes {which} out "
            f"as if no time had passed; {cut}"
        )
        moves = (
            f"rises, but for {'a step' if len(rows) == 1 else which} at row "
            f"{first}{' and later' * (len(rows) > 1)}"
        )
        return Treatment(['jumps = "mend"'], moves, doubt, _without_steps(t, rows))
    lost = int((~increasing(t)).sum())
    moves = (
        f"rises, but falls in {len(rows)} of {len(t)} rows (first at row {first}, by up to "
        f"{largest:.6g} s)"
    )
    drops = f'repeated = "drop" leaves out {lost} of {len(t)} rows'
    if lost > _LOST * len(t):
        doubt = (
            f"why '{name}' falls {len(rows)} times: {drops}, which is too much; "
            f"{cut.removeprefix('or ')}"
        )
        return Treatment([], moves, doubt, t)
    doubt = (
        f"why '{name}' falls {len(rows)} times (a single wrong stamp, rows out of order, a clock "
        "that was "
    )
    doubt += f"set): {drops}; {cut}"
    return Treatment(['repeated = "drop"'], moves, doubt, t)


def _starts_again(t: Array, row: int) -> bool:
    """Return whether a clock returns to its first time, or to 0."""
    near = _SAME * usual_step(t)
    return bool(abs(t[row] - t[0]) <= near or abs(t[row]) <= near)


def _without_steps(t: Array, rows: NDArray[np.int64]) -> Array:
    moved = np.zeros(len(t))
    moved[rows] = usual_step(t) - np.diff(t)[rows - 1]
    return np.asarray(t + np.cumsum(moved))


def counts_of_roll(values: Array, usual: float) -> tuple[str, str] | None:
    """Return the unit of a counter that rolls over, and the reason; else None.

    In this unit its usual step is that of a robot.

    Args:
        values: (rows,) counts, finite.
        usual: the usual step.
    """
    fall = -np.diff(values)
    fall = fall[fall > 0]
    if not len(fall):
        return None
    for bits in BITS:
        left = 2.0**bits - fall
        rolls = (
            bool(((left > 0) & (left <= _NEAR * usual)).all()) and float(values.max()) <= 2.0**bits
        )
        unit = next(
            (unit for unit in ("s", "ms", "us", "ns") if 2e-4 <= usual * TIME[unit] < 5.0), None
        )
        if rolls and unit is not None and usual != 1.0:
            return (
                unit,
                f"it rolls over at 2^{bits} counts, and steps of {usual:.4g} look like {unit}",
            )
    return None
