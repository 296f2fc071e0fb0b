"""Find the columns x, y, z of a table by their names, or else by their values.

A column is not a coordinate if it counts rows, is constant, or holds integers while others hold
decimals. Three columns are no places if they are unit vectors (normals) or colours. The decision is
returned as a sentence.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RegistrationError

Floats = NDArray[np.float64]
Triple = tuple[int, int, int]

# A name: its quantity (points, normals, none), its axis, its unit.
_NAME = re.compile(
    r"(?P<stem>.*?)[ _.:/\-\[(]*(?P<axis>[xyz0-3])[\])]?"
    r"(?:[ _](?P<u>mm|m|cm|um)| ?[(\[](?P<v>mm|m|cm|um)[)\]])?"
)
_AXES = ("xyz", "012", "123")
_PLACES = (
    "p",
    "point",
    "points",
    "pos",
    "position",
    "positions",
    "xyz",
    "coord",
    "coords",
    "coordinates",
    "vertex",
    "vertices",
    "location",
    "world",
)
# what a column may be
COUNTS, NUMBERS, FEW = "counts rows", "numbers each row", "holds few numbers"
_LEAST_ROWS = 8  # from which a column that grows evenly counts rows
_FARTHEST = 1e5  # mm; beyond it lie time stamps
_UNIT = 0.01  # by which the length of a normal may differ from 1


def choose(names: Sequence[str], sample: Floats, label: str) -> tuple[Triple, str]:
    """Return the columns of x, y, z, and a sentence that reports a guess.

    Args:
        names: names of the columns, (C,); empty for a table without a header.
        sample: some rows of the table, (M, C); not finite where a cell holds no number.
        label: the file, for messages.

    Returns:
        tuple[Triple, str]: numbers of the three columns, from 0, and the sentence; "" if the names
            decide.

    Raises:
        RegistrationError: the names or values do not give exactly one triple, or the names give a
            unit other than mm.
    """
    if not names:
        return _by_values(sample, label, "its columns have no names")
    header = f"its header '{', '.join(name.strip() for name in names)[:60]}'"
    there = _named(names, header, label)
    triples = {stem: columns for stem, columns in there.items() if max(columns) < sample.shape[1]}
    if "" in triples:
        return triples[""], ""
    if triples:
        stem, found = _place_of(triples, sample, header, label)
        taken = ", ".join(_clean(names[k]) for k in found)
        return (
            found,
            f"{header} names no x, y, z; {taken} are taken for them"
            if stem not in _PLACES[3:]
            else "",
        )
    return _by_values(sample, label, f"{header} names no x, y, z")


def names_places(names: Sequence[str]) -> bool:
    """Return whether names of columns hold at least one triple of axes."""
    try:
        return bool(_named(names, "", ""))
    except RegistrationError:
        return True  # it names axes, but not three, or in another unit: that is reported


def _clean(name: str) -> str:
    return name.strip().strip("\"'#/% \t\ufeff")


def _named(names: Sequence[str], header: str, label: str) -> dict[str, Triple]:
    """Return the complete triples of axes by their quantity; "" stands for plain x, y, z."""
    found: dict[tuple[str, str], list[int]] = {}
    units: dict[str, set[str]] = {}
    for k, name in enumerate(names):
        if (match := _NAME.fullmatch(_clean(name).lower())) and (
            match["stem"] or match["axis"] in "xyz"
        ):
            found.setdefault((match["stem"], match["axis"]), []).append(k)
            units.setdefault(match["stem"], set()).update({match["u"] or match["v"]} - {None})
    plain = [found.get(("", axis), []) for axis in "xyz"]
    if any(plain) and any(len(columns) != 1 for columns in plain):
        raise RegistrationError(
            f"{label}: {header} names not each of x, y, z once; name three columns x, y, z, in mm"
        )
    triples: dict[str, Triple] = {}
    for stem in dict.fromkeys(stem for stem, _ in found):
        for axes in _AXES:
            columns = [found.get((stem, axis), []) for axis in axes]
            if stem not in triples and all(len(c) == 1 for c in columns):
                triples[stem] = (columns[0][0], columns[1][0], columns[2][0])
    chosen = [""] if "" in triples else list(triples)
    if other := sorted(set().union(*(units[stem] for stem in chosen)) - {"mm"}) if chosen else []:
        raise RegistrationError(
            f"{label}: {header} states {', '.join(other)}; clouds are read in mm, convert it"
        )
    return triples


def _place_of(
    triples: dict[str, Triple], sample: Floats, header: str, label: str
) -> tuple[str, Triple]:
    """Return the only triple that can be places: by its name, or else by its values."""
    by_name = [stem for stem in triples if stem in _PLACES]
    left = (
        by_name
        or [stem for stem, k in triples.items() if not _is_normal(sample[:, k])]
        or list(triples)
    )
    left = [stem for stem in left if not _is_colour(sample[:, triples[stem]])] or left
    if len(left) > 1:
        raise RegistrationError(
            f"{label}: {header} names {len(left)} triples that may be places "
            f"({', '.join(left)[:60]}); name three columns x, y, z, in mm"
        )
    return left[0], triples[left[0]]


def _by_values(sample: Floats, label: str, why: str) -> tuple[Triple, str]:
    count = sample.shape[1]
    refused = no_coordinates(sample)
    left = [k for k in range(count) if k not in refused]
    triples = [left[k : k + 3] for k in range(0, len(left) - 2, 3)]
    if not triples:
        reasons = "; ".join(f"column {k + 1} {reason}" for k, reason in refused.items())[:200]
        raise RegistrationError(
            f"{label}: {why}, and {len(left)} of {count} columns can be coordinates"
            f"{f' ({reasons})' if reasons else ''}; name three columns x, y, z, in mm"
        )
    good = [t for t in triples if not _is_normal(sample[:, t]) and not _is_colour(sample[:, t])]
    x, y, z = (good or triples)[0]
    if count == 3:
        return (x, y, z), ""
    because = "".join(f"; column {k + 1} {reason}" for k, reason in refused.items() if k < z)
    return (x, y, z), f"{why}; columns {x + 1}, {y + 1}, {z + 1} are taken for x, y, z{because}"


def no_coordinates(sample: Floats) -> dict[int, str]:
    """Return the columns of a sample (M, C) that cannot be coordinates, each with the reason.

    At least three columns are left, if possible.
    """
    rows, count = sample.shape
    known = np.isfinite(sample)
    sample = np.clip(sample, -1e12, 1e12)  # damaged values must not overflow
    refused = {k: FEW for k in range(count) if 2 * int(known[:, k].sum()) < rows}
    integers = {k for k in range(count) if not np.any(sample[known[:, k], k] % 1.0)}
    decimals = [k for k in range(count) if k not in refused and k not in integers]
    for k in (k for k in range(count) if k not in refused):
        values = sample[known[:, k], k]
        if len(values) >= _LEAST_ROWS and _counts_up(values):
            refused[k] = COUNTS
        elif len(decimals) >= 3 and k in integers:
            refused[k] = "holds whole numbers"
        elif np.abs(values).max(initial=0.0) > _FARTHEST and count - len(refused) > 3:
            refused[k] = f"reaches {np.abs(values).max():.3g}"
        elif not np.ptp(values) and count - len(refused) > 3:
            refused[k] = f"is always {values[0]:g}"
        elif (
            k in integers
            and len(values) >= 20
            and len(np.unique(values)) == len(values)
            and count - len(refused) > 3
        ):
            refused[k] = NUMBERS
    return refused


def _counts_up(values: Floats) -> bool:
    """Return whether values grow by one step from row to row."""
    steps = np.diff(values)
    return bool(steps[0]) and bool(np.all(np.abs(steps - steps[0]) <= 1e-6 * abs(steps[0])))


def _is_normal(values: Floats) -> bool:
    near = values[(np.abs(values) < 2.0).all(axis=1)]
    unit = np.abs(np.linalg.norm(near, axis=1) - 1.0) < _UNIT
    return (
        int(np.count_nonzero(unit))
        > 0.95 * int(np.count_nonzero(np.isfinite(values).all(axis=1)))
        > 0
    )


def _is_colour(values: Floats) -> bool:
    seen = values[np.isfinite(values).all(axis=1)]
    low, high = seen.min(initial=np.inf), seen.max(initial=-np.inf)
    return (
        len(seen) > 0 and low >= 0.0 and (high <= 1.0 or (high <= 255.0 and not np.any(seen % 1.0)))
    )
