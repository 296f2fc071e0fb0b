"""Reject a text log whose cells have a unit after each number, such as `25.0 mm`.

Pinned by tests/logs/test_unit_cells.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from softmap_edge.errors import RunError
from softmap_edge.files.printable import listed
from softmap_edge.logs.readers.cells import is_number, is_unit
from softmap_edge.logs.readers.spellings import UNIT_CELL

_MOST = 0.9  # of the filled cells must have the unit
_LEAST = 3  # filled cells needed
_MOSTLY = 0.5  # of the filled cells: with more plain numbers, only a known unit counts
_DISTINCT = 0.2  # of the cells must differ: labels of a protocol (`10mm`, `20mm`) are few
_NAMED = 4  # columns that are listed


def refuse_unit_cells(path: Path, texts: Mapping[str, Sequence[str]]) -> None:
    """Raise RunError if text columns hold measured numbers with one unit.

    Args:
        path: the log.
        texts: the first cells of each text column, by name.

    Raises:
        RunError: lists the columns, a cell and the remedy.
    """
    found = {
        name: unit for name, cells in texts.items() if (unit := unit_behind(cells)) is not None
    }
    if not found:
        return
    name, unit = next(iter(found.items()))
    cell = next(cell for cell in texts[name] if UNIT_CELL.fullmatch(cell) and not is_number(cell))
    raise RunError(
        f"{path}: columns {listed(found, _NAMED)} hold numbers with a unit, such as "
        f"'{cell[:30]}'; export the log with numbers only (or remove '{unit}' from the cells), "
        "and give the unit in the mapping"
    )


def unit_behind(cells: Sequence[str]) -> str | None:
    """Return the unit after the numbers of a column; None for labels or numbers without unit."""
    filled = [cell for cell in cells if cell]
    units = [
        match[1] for cell in filled if not is_number(cell) and (match := UNIT_CELL.fullmatch(cell))
    ]
    if len(filled) < _LEAST or len(set(units)) != 1:
        return None
    if sum(map(is_number, filled)) > _MOSTLY * len(filled):  # a unit only in some cells
        return (
            units[0]
            if is_unit(units[0]) and (len(units[0]) > 1 or not units[0].isalpha())
            else None
        )
    if len(units) < _MOST * len(filled):
        return None
    return units[0] if len(set(filled)) > _DISTINCT * len(filled) else None
