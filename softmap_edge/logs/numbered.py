"""Recognise names that differ only in numbers: `u1` and `u2`, `log_0.csv` and `log_1.csv`."""

from __future__ import annotations

import re

_DIGITS = re.compile(r"\d+")


def without_numbers(name: str, mark: str = "#") -> str:
    """Return a name with its numbers replaced, so that names differing only in numbers are equal.

    Args:
        name: a name of a column or of a file.
        mark: the replacement; `*` turns a file name into a pattern.
    """
    return _DIGITS.sub(mark, name)


def numbers_in(name: str) -> list[int]:
    """Return the numbers in a name, from left to right."""
    return [int(digits) for digits in _DIGITS.findall(name)]
