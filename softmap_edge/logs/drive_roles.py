"""Sort column groups that may be commands or encoders, and exclude those that cannot be.

Values count more than names: moving columns come before constant ones and before those that are
only 0 and 1, and unit quaternions are not encoders. Goals in x, y, z come last, because a position
controller logs them next to the commands of its motors. Pinned by tests/logs/test_drive_roles.py
and tests/logs/test_switches.py.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from softmap_edge.logs.flags import is_switch
from softmap_edge.logs.goals import is_goal
from softmap_edge.logs.guess_columns import Role
from softmap_edge.logs.guess_sheets import Sheet
from softmap_edge.logs.triples import LeftOut

Array = NDArray[np.float64]
Pair = tuple[Sheet, Role]
_UNIT = 1e-2  # allowed deviation of a quaternion's length from 1
_AXIS = re.compile(r"[xyz]")


def drives_of(roles: list[Pair]) -> tuple[list[Pair], list[Pair], list[tuple[Sheet, LeftOut]]]:
    """Return the possible command or encoder groups, most likely first, and the excluded ones.

    Args:
        roles: the column groups of all logs, with their logs.
    """
    drives = [pair for pair in roles if pair[1].kind in ("command", "present")]
    left = [
        (sheet, LeftOut(tuple(role.columns), why))
        for sheet, role in drives
        if (why := _no_drive(sheet, role))
    ]
    gone = {(id(sheet), one.columns) for sheet, one in left}
    drives = [pair for pair in drives if (id(pair[0]), tuple(pair[1].columns)) not in gone]
    commands = sorted((pair for pair in drives if pair[1].kind == "command"), key=_command_order)
    presents = sorted((pair for pair in drives if pair[1].kind == "present"), key=_present_order)
    return commands, presents, left


def moves(pair: Pair) -> bool:
    """Return whether any column of a group changes."""
    columns = map(pair[0].column, pair[1].columns)
    return any(len(np.unique(values[np.isfinite(values)])) > 1 for values in columns)


def switches_of(pair: Pair) -> list[str]:
    """Return the columns of a group that hold only 0 and 1, and no unit is stated of them."""
    if pair[1].unit is not None:
        return []  # 0 and 1 kg were measured
    return [name for name in pair[1].columns if is_switch(pair[0].column(name))]


def _switched(pair: Pair) -> bool:
    return len(switches_of(pair)) == len(pair[1].columns)


def _command_order(pair: Pair) -> tuple[bool, bool, bool, bool, int]:
    unsure, width = not pair[1].sure, len(pair[1].columns)
    return not moves(pair), _switched(pair), _in_space(pair[1].columns), unsure, -width


def _present_order(pair: Pair) -> tuple[bool, bool, bool, int]:
    return not moves(pair), _switched(pair), not pair[1].sure, -len(pair[1].columns)


def _in_space(columns: list[str]) -> bool:
    """Return whether the columns are named x, y, z of a goal."""
    stems = {_AXIS.sub("#", name.lower()) for name in columns}
    return (
        len(columns) == 3
        and len(stems) == 1
        and len(set(columns)) == 3
        and is_goal(next(iter(stems)))
    )


def _no_drive(sheet: Sheet, role: Role) -> str | None:
    """Return why columns are not commands or encoders although their name suggests it; else None."""
    rows = sheet.rows_of(role.columns)
    if not role.sure and role.kind == "present" and not moves((sheet, role)):
        return "constants, because they never change"
    fours = [rows[:, k : k + 4] for k in range(0, rows.shape[1], 4)]
    return (
        "a quaternion, for their length is 1 in all rows" if all(map(_quaternion, fours)) else None
    )


def _quaternion(rows: Array) -> bool:
    """Return whether columns (rows, 4) are changing unit quaternions."""
    return is_unit_quaternion(rows) and bool(
        np.ptp(rows[np.isfinite(rows).all(axis=1)], axis=0).any()
    )


def is_unit_quaternion(rows: NDArray[np.float64]) -> bool:
    """Return whether columns are unit quaternions in all rows with known values.

    Args:
        rows: (T, C) numbers; NaN where a cell is missing. Only C = 4 can be quaternions.
    """
    known = rows[np.isfinite(rows).all(axis=1)]
    if rows.shape[1] != 4 or len(known) < 2:
        return False
    return bool((np.abs(np.linalg.norm(known, axis=1) - 1.0) < _UNIT).all())
