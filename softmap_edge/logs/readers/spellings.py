"""Read numbers in other spellings: a Unicode minus sign, hexadecimal integers, Fortran exponents.

Pinned by tests/logs/test_spellings.py.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from softmap_edge.errors import RunError
from softmap_edge.logs.readers.words import EMPTY

_MINUS = "\u2212\ufe63\uff0d\u2013"  # minus, small hyphen-minus, full-width one, en dash
_SIGN = re.compile(rf"(?:(?<![^\W_]|[.])|(?<=\d[eE]))[{_MINUS}](?=[\d.,])")
_HEX = re.compile(r"[+-]?0[xX][0-9a-fA-F]{1,16}")
# 1.0D+02, 2.5q3, 1D-3, and 1.0+100: three digits of an exponent leave no room for the letter
_EXPONENT = re.compile(
    r"(?<![\w.+-])([+-]?(?:\d+\.\d*|\.\d+|\d+(?=[dDqQ][+-])))"
    r"(?:[dDqQ](?=[+-]?\d{1,3}(?![\w.+-]))|(?=[+-]\d{3}(?![\w.+-])))"
)
UNIT_CELL = re.compile(r"[+-]?\d[\d.,]*(?:[eE][+-]?\d+)?\s*([^\d\s.,;:/_-]{1,8})")


def with_minus(text: str) -> str:
    """Return a text whose numbers have a plain minus sign."""
    if text.isascii() or not any(mark in text for mark in _MINUS):
        return text
    return _SIGN.sub("-", text)


def with_exponents(text: str) -> str:
    """Return a text in which numbers with exponents of Fortran (1.0D+02) have a plain one."""
    return _EXPONENT.sub(r"\1e", text)


def is_hex(cell: str) -> bool:
    """Return whether a cell is a hexadecimal integer such as `0x1F`."""
    return _HEX.fullmatch(cell) is not None


def hex_columns(rows: Sequence[Sequence[str]]) -> frozenset[int]:
    """Return the positions of columns whose filled cells in the first rows are all hexadecimal."""
    found = set()
    for place, column in enumerate(zip(*rows)):
        filled = [cell for cell in column if cell.lower() not in EMPTY]
        if filled and all(map(is_hex, filled)):
            found.add(place)
    return frozenset(found)


def without_hex(
    path: Path, block: Sequence[str], mark: str, places: Sequence[int], lines: Sequence[int]
) -> list[str]:
    """Return lines with decimal numbers in place of hexadecimal ones in some columns.

    Args:
        path: the log.
        block: its lines.
        mark: the separator of cells.
        places: positions of the columns that are hexadecimal.
        lines: the numbers of the lines.

    Raises:
        RunError: a cell of such a column is decimal: its base is unclear.
    """
    found = []
    for text, line in zip(block, lines):
        cells = text.split(mark)
        for place in places:
            cell = cells[place].strip(' "\r') if place < len(cells) else ""
            if is_hex(cell):
                cells[place] = str(int(cell, 16))
            elif cell[:1].isdigit():
                raise RunError(
                    f"{path}: line {line}: '{cell[:40]}' stands in a column of hexadecimal "
                    "numbers without 0x; write all its cells with 0x, or none"
                )
        found.append(mark.join(cells))
    return found


def spelling_remedy(cell: str) -> str:
    """Return the remedy for a cell that is a number in another spelling; else ""."""
    if is_hex(cell):
        return (
            "; hexadecimal numbers are read only if all cells of their column begin with 0x: "
            "write the column in one base"
        )
    if (unit := UNIT_CELL.fullmatch(cell)) is not None:
        return f"; remove '{unit[1]}' from the cell, and give the unit in the mapping"
    return ""
