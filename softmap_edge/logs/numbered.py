"""Recognise names that differ in their numbers only: `u1` and `u2`, `log_0.csv` and `log_1.csv`."""

from __future__ import annotations

import re

_DIGITS = re.compile(r"\d+")


def without_numbers(name: str, mark: str = "#") -> str:
    """Return a name with marks for numbers: names that differ in numbers only are then equal.

    Args:
        name: a name of a column or of a file.
        mark: what stands for a number; `*` makes a pattern of a name of a file.
    """
    return _DIGITS.sub(mark, name)


def numbers_in(name: str) -> list[int]:
    """Return the numbers in a name, from left to right."""
    return [int(digits) for digits in _DIGITS.findall(name)]
