"""Check the numbers and keys of a `finger.toml`.

Each error states the field, its value and the allowed values.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from softmap_edge.errors import FingerError
from softmap_edge.files.atomic import finite

Pairs = tuple[tuple[float, float], ...]
Vector = tuple[float, float, float]
COMPARE = "compare with the built-in finger's file"


def check_keys(
    table: str, document: Mapping[str, object], needed: Iterable[str], optional: Iterable[str] = ()
) -> None:
    """Reject unknown and missing keys of a table; "" is the top level. Raises FingerError."""
    where = f"[{table}]" if table else "the file"
    allowed = set(needed) | set(optional)
    if unknown := set(document) - allowed:
        raise FingerError(f"{where}: unknown key {names(unknown)}; allowed are {names(allowed)}")
    if missing := set(needed) - set(document):
        raise FingerError(f"{where}: {names(missing)} is missing; {COMPARE}")


def sequence(field: str, value: object) -> tuple[Any, ...]:
    """Return a list as a tuple. Raises FingerError."""
    if not isinstance(value, list | tuple):
        raise FingerError(f"{field}: {shown(value)}; expected a list")
    return tuple(value)


def rows(field: str, value: object) -> tuple[tuple[Any, ...], ...]:
    """Return a list of lists as tuples. Raises FingerError."""
    return tuple(sequence(field, row) for row in sequence(field, value))


def check_pairs(field: str, pairs: Sequence[Sequence[float]]) -> None:
    """Check (z, radius) pairs in mm, z ascending. Raises FingerError."""
    good = 2 <= len(pairs) <= 1000 and all(
        len(pair) == 2 and all(map(finite, pair)) for pair in pairs
    )
    if not good or any(b[0] <= a[0] for a, b in zip(pairs, pairs[1:])) or pairs[-1][0] > 2000:
        raise FingerError(
            f"{field}: expected 2 to 1000 [z, radius] pairs in mm with z ascending, up to 2000 mm"
        )


def check_points(field: str, points: Sequence[Sequence[float]]) -> None:
    """Check [x, y, z] guides in mm. Raises FingerError."""
    good = 2 <= len(points) <= 1000 and all(
        len(p) == 3 and all(finite(v) and abs(v) <= 2000 for v in p) for p in points
    )
    if not good or any(a == b for a, b in zip(points, points[1:])):
        raise FingerError(
            f"{field}: expected 2 to 1000 different [x, y, z] points in mm, each number within "
            "±2000"
        )


def check_count(field: str, value: object, low: int, high: int, usual: str) -> None:
    """Check a whole number. Raises FingerError."""
    if type(value) is not int or not low <= value <= high:
        raise FingerError(
            f"{field}: {shown(value)}; allowed are whole numbers {low} to {high}; {usual}"
        )


def check_number(field: str, value: object, low: float, high: float, remedy: str) -> None:
    """Check a number. Raises FingerError."""
    if not finite(value) or not low <= value <= high:
        raise FingerError(f"{field}: {shown(value)}; allowed is {low:g} to {high:g}; {remedy}")


def check_vector(field: str, value: object, low: float, high: float, remedy: str) -> None:
    """Check three numbers. Raises FingerError."""
    if (
        not isinstance(value, tuple)
        or len(value) != 3
        or not all(finite(v) and low <= v <= high for v in value)
    ):
        raise FingerError(
            f"{field}: {shown(value)}; expected three numbers from {low:g} to {high:g}; {remedy}"
        )


def at(pairs: Pairs, z: float) -> float:
    """Interpolate (z, radius) pairs, held constant beyond their ends."""
    for (z0, r0), (z1, r1) in zip(pairs, pairs[1:]):
        if z0 <= z <= z1:
            return r0 + (r1 - r0) * (z - z0) / (z1 - z0)
    return pairs[0][1] if z < pairs[0][0] else pairs[-1][1]


def shown(value: object) -> str:
    """Return a value as at most 60 characters."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # integers beyond 4300 digits have no decimal form
        return "a number of thousands of digits"
    return text if len(text) <= 60 else text[:57] + "..."


def names(items: Iterable[str]) -> str:
    """Return names in order, quoted."""
    return ", ".join(map(shown, sorted(items)))


def listed(values: Iterable[float | tuple[float, ...] | list[float]]) -> str:
    """Return numbers, or rows of numbers, as TOML writes them."""
    return (
        "["
        + ", ".join(listed(v) if isinstance(v, tuple | list) else repr(float(v)) for v in values)
        + "]"
    )
