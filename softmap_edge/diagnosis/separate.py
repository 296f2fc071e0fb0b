"""The experiment that separates two families of effects: it varies what only one of them depends on.

Each family declares its own (`rust/families/`). Of two families, that of the more special input is taken: a declared
condition, then time, then the history of the commands; of one kind the family that is declared later. So delay and
play are separated by two speeds, creep and time by a repeat after a rest, a load and the shape at rest by two
orientations. Pinned by tests/test_separate.py.
"""

from __future__ import annotations

from collections.abc import Collection

from softmap_edge.diagnosis.families import families, home

SPECIAL = ("static", "memory", "time", "condition")  # kinds of input; a later one is varied by itself more easily


def separating(one: str, other: str) -> tuple[str, float] | None:
    """Return what to record so that two families are separated, and the minutes it takes; None where none declares it.

    Args:
        one: name of a family.
        other: name of another one.
    """
    every = families()
    rows = [(SPECIAL.index(f.kind), i, f) for i, f in enumerate(every) if f.name in (one, other) and f.experiment[0]]
    return max(rows, key=lambda row: row[:2])[2].experiment if rows and one != other else None


def families_of(effects: Collection[str]) -> tuple[str, ...]:
    """Return the families that effects belong to, the first of each."""
    return tuple(dict.fromkeys(family.name for e in effects if (family := home(e)) is not None))
