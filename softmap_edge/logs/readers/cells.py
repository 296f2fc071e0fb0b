"""Split a line of a text log into cells; classify a cell as number, time, unit or name."""

from __future__ import annotations

import csv
import re

from softmap_edge.logs.mapping import ANGLE, LENGTH, TIME
from softmap_edge.logs.readers.spellings import is_hex, with_exponents, with_minus
from softmap_edge.logs.readers.thousands import grouping_of
from softmap_edge.logs.time_text import is_time
from softmap_edge.logs.unit_words import LENGTH_WORDS

DELIMITERS = (",", ";", "\t", "|")
_COMMA_NUMBER = re.compile(r"[+-]?\d+(,\d+)?([eEdDqQ][+-]?\d+)?")
_OTHERS = ("", "-", "°", "°c", "degrees", "radians", "n", "ma", "a", "g", "kg")
_UNITS = {*LENGTH, *TIME, *ANGLE, *_OTHERS}  # possible cells of a line of units
_BRACKETS = "[](){}"


def split(line: str, delimiter: str) -> list[str]:
    """Return the stripped cells of one line; [] if it is not CSV."""
    if '"' not in line:
        return [
            cell.strip()
            for cell in (line.split() if delimiter == " " else line.rstrip("\r\n").split(delimiter))
        ]
    try:
        if delimiter == " ":
            line = " ".join(line.split())
        return [
            cell.strip()
            for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
        ]
    except csv.Error:
        return []


def trimmed(cells: list[str]) -> list[str]:
    """Return the cells without empty ones at the end."""
    end = len(cells)
    while end and not cells[end - 1]:
        end -= 1
    return cells[:end]


def find_delimiter(line: str) -> str:
    """Return the delimiter that gives the most cells; a space only if there is no other.

    Numbers with decimal commas contain more commas than delimiters, so the delimiter must not split
    them.
    """
    for mark in (";", "\t", "|", " "):
        cells = [cell for cell in split(line, mark) if cell] if "," in line else []
        if len(cells) > 1 and all(_COMMA_NUMBER.fullmatch(cell) for cell in cells):
            return mark
    best = max(DELIMITERS, key=line.count)
    if best in line:
        return best
    return " " if " " in line.strip() else ","


def is_number(cell: str) -> bool:
    """Return whether a cell is a number.

    It may have a decimal point or comma, or clear groups of digits, or an exponent of Fortran
    (`1.0D+02`), or be hexadecimal (`0x1F`).
    """
    cell = with_minus(cell)
    plain = cell.replace(",", ".")
    return (
        is_plain(plain)
        or is_plain(with_exponents(plain))
        or grouping_of(cell) is not None
        or is_hex(cell)
    )


def is_plain(cell: str) -> bool:
    """Return whether a cell is a number with a decimal point.

    Python's `1_000` counts as a name or a fault of the file.
    """
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell


def is_value(cell: str) -> bool:
    """Return whether a cell is a number or a time."""
    return is_number(cell) or is_time(cell)


def unit_of(cell: str) -> str:
    """Return a cell of a line of units without its brackets, as this program spells it."""
    word = cell.strip(_BRACKETS).strip().lower()
    return LENGTH_WORDS.get(word, word)


def is_unit(cell: str) -> bool:
    """Return whether a cell is a known unit, or is in brackets."""
    return unit_of(cell) in _UNITS or (
        len(cell) > 2 and cell[0] in _BRACKETS and cell[-1] in _BRACKETS
    )
