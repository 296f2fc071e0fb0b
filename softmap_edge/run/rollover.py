"""Find commands and encoders that roll over: jumps of about one turn in otherwise slow motion.

A turn is 2^k counts, 360 degrees (also in tenths or hundredths) or 2π. A commanded step may have
the same size, but the motion does not continue across it. Pinned by tests/run/test_rollover.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.files.printable import listed
from softmap_edge.run.fields import FieldName
from softmap_edge.run.run import Run, spool_radius

Floats = NDArray[np.float64]
TURNS = (2 * np.pi, 360.0, 3600.0, 36000.0, *(2.0**bits for bits in range(8, 25)))
DRIVES: tuple[FieldName, ...] = ("command", "ticks", "present", "present_ticks")
_SLOW = 0.25  # of a turn: all other steps are shorter
_NEAR = 5  # rows on either side that measure the speed
_FASTER = 2.0  # times the largest step there: the largest step across a roll-over
_MOST = 0.8  # of the jumps must be roll-overs
_SHOWN = 6  # channels that are listed


@dataclass(frozen=True)
class RollOver:
    """Where a channel rolls over.

    Attributes:
        turn: the size of a turn, in the unit of the channel.
        count: the number of jumps.
        row: the first row after the first jump.
    """

    turn: float
    count: int
    row: int


def roll_over(values: Floats, turns: tuple[float, ...] = TURNS) -> RollOver | None:
    """Return where a channel (T,) rolls over; None if it does not.

    Args:
        values: (T,) finite numbers.
        turns: the possible sizes of a turn.
    """
    if len(values) < 3:
        return None
    step, span = np.diff(values), float(np.ptp(values))
    size = np.abs(step)
    for turn in turns:
        if not 0.5 * turn < span <= turn * (1 + 1e-9) or (
            turn == TURNS[0] and (values == np.rint(values)).all()
        ):
            continue  # whole numbers are not radians
        jumps = size > 0.5 * turn
        if not jumps.any() or size[~jumps].max(initial=0.0) > _SLOW * turn:
            continue
        left = turn - size[jumps]
        if float((left <= _reach(size, jumps)).mean()) >= _MOST:
            return RollOver(turn, int(jumps.sum()), int(np.argmax(jumps)) + 1)
    return None


def _reach(size: Floats, jumps: NDArray[np.bool_]) -> Floats:
    """Return the largest step that the motion around each jump allows; -1 at rest.

    It is computed from the steps `size` (T - 1,).
    """
    steps = np.where(jumps, 0.0, size)
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(steps, _NEAR), 2 * _NEAR + 1)
    fastest = windows[np.flatnonzero(jumps)].max(axis=1)
    return np.asarray(np.where(fastest > 0, _FASTER * fastest, -1.0))


def unwrapped(values: Floats, turn: float) -> tuple[Floats, int]:
    """Return a channel (T,) unwrapped over its roll-overs, and their number; NaN stays NaN."""
    known = np.isfinite(values)
    jumps = int((np.abs(np.diff(values[known])) > 0.5 * turn).sum())
    found = values.copy()
    found[known] = np.unwrap(values[known], period=turn)
    return found, jumps


def roll_overs_of(run: Run) -> list[str]:
    """Return a sentence for each kind of drive data in a run that rolls over."""
    radius = spool_radius(run.extra)
    found: list[str] = []
    for name in DRIVES:
        rows = run.array(name)
        in_mm = "ticks" not in name and run.command_unit == "mm"
        if rows is None or (in_mm and radius is None):
            continue
        turns = (2 * np.pi * float(radius or 0.0),) if in_mm else TURNS
        each = [roll_over(np.asarray(column, float), turns) for column in rows.T]
        names = [f"channel {c}" for c in range(len(each))]
        line = roll_over_line(name, names, each)
        found += [f"{line} in the mapping, and import the log again"] if line else []
    return found


def roll_over_line(name: str, names: list[str], found: list[RollOver | None]) -> str | None:
    """Return the sentence on channels that roll over, with the key of the mapping that fixes it.

    Return None if no channel does.
    Args:
        name: of the quantity in a mapping.
        names: of its channels.
        found: the roll-over of each channel.
    """
    some = [(label, one) for label, one in zip(names, found) if one is not None]
    if not some:
        return None
    channels = listed(
        (f"{label} in {one.count} rows (the first is row {one.row})" for label, one in some), _SHOWN
    )
    turn = f"{some[0][1].turn:.7g}"
    return (
        f"{name}: jumps by about {turn} within one row and moves slowly otherwise, as an encoder "
        f"that rolls over: {channels}; if so, set {name}.unwrap = {turn}"
    )
