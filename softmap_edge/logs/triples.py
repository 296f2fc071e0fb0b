"""Find the column triples that are x, y, z of a position, and list the others with the reason.

A triple is found by its names: `tip_x, tip_y, tip_z`, `x1, y1, z1`, `p_tip(1), p_tip(2), p_tip(3)`.
Forces, angles and rates are triples too. Three criteria decide, in this order:

    name    `force`, `rpy`, `omega`: no position. `tip`, `marker`, `position`, or a column with a
            length unit: a position
    values  a triple that never changes is an offset; one of constant length 1 or 9.81 is a
            direction or gravity; one that is called desired or computed and follows a position was
            not measured (`goals.py`)
    size    any other name counts only if it fits the known positions: near them, within a factor
            `FITS` of their distance from the origin, and not within ±π, the range of angles and
            unit vectors

Triples whose names differ only in digits (`m1`, `m2`, `m3`) are classified together. Doubtful
triples are left out. Pinned by tests/logs/test_triples.py.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from softmap_edge.logs.flags import is_switch
from softmap_edge.logs.goals import follows, is_computed, is_drive, is_goal
from softmap_edge.logs.numbered import without_numbers
from softmap_edge.logs.plausible import is_base

Array = NDArray[np.float64]
Rows = Callable[[list[str]], Array]

FITS = 100.0  # ratio of sizes within one robot's markers at most
# times the extent of the positions, and 0.9 of their distance from the origin: range of markers
NEAR = 10.0
LONGEST = 200  # characters of a name
STEADY = 1e-3  # of its length: variation of a triple of constant length
_OFFSET = "an offset, because they never change"
DIRECTIONS = (1.0, 9.81)  # length of a direction, and of gravity in m/s²

_OTHER: tuple[tuple[str, str], ...] = (
    (
        "a force or torque",
        r"force|torque|moment|wrench|load|press|strain|stress|tension|tof|tau|curr|volt|effort",
    ),
    (
        "angles",
        r"rot|orient|quat|rpy|ypr|roll|pitch|yaw|eul|ang|theta|phi|psi|heading|attitude|tilt|dir"
        r"|ori|alpha|beta|gamma|curv|kappa|bend",
    ),
    ("rates", r"vel|speed|acc|gyr|omega|twist|jerk|rate|spin"),
    ("a field or a constant", r"grav|mag|imu|field|norm|bias|offset|scale|gain|color|colour|rgb"),
    ("an error or a spread", r"err|std|var|cov|sigma|resid|unc"),
)
_NAMELESS = re.compile("unlabel", re.IGNORECASE)
_PLACE = re.compile(
    r"tip|end|eef|tcp|mark|mk|led|tag|point|pnt|pos|place|loc|trans|coord|body|bodies|rigid|base"
    r"|clamp|frame|mount|node|vert|bead|dot|seg|sec|disk|disc|tool|hand|wrist|elbow|head|finger"
    r"|joint|link|object|mocap|vicon|opti|aruco|april|cent|cam|robot|sensor|probe|ring|knot|xyz"
    r"|track|feature|blob|ball|pose",
    re.IGNORECASE,
)
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+|[^\W\d_]+")
# F1, q2: these letters are not positions, with a number or without
_NUMBERED_OTHER = {"f", "g", "q", "w", "v"}
# without a number; m1 is a marker, M a torque
_SHORT_OTHER = {*_NUMBERED_OTHER, "a", "b", "e", "i", "m", "n", "r"}
_SHORT_PLACE = {"p", "m", "mk", "pt", "ee"}
_INDEX = re.compile(r"^(.*[^\d,\s(\[{])?\s*([(\[{])\s*((?:\d+\s*,\s*)*)(\d+)\s*([)\]}])$")


@dataclass(frozen=True)
class LeftOut:
    """Columns in a triple or a pair that are not taken as a position."""

    columns: tuple[str, ...]
    why: str


@dataclass(frozen=True)
class Triples:
    """The triples of a log: the positions, in the file's order, and the columns left out."""

    places: list[list[str]] = field(default_factory=list)
    left: list[LeftOut] = field(default_factory=list)
    # positions with uninformative names
    by_size: list[list[str]] = field(default_factory=list)
    # the column with the likelihood of each position, by its first column; {} unless all have one
    likelihood: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class _Candidate:
    """A triple of columns, its name without axis and digits, and whether that names a position."""

    columns: list[str]
    stem: str
    named: bool
    other: str | None  # another quantity indicated by its name
    flag: str | None  # that a coordinate is only 0 and 1
    size: float  # median distance from the origin
    largest: float
    steady: str | None  # another quantity indicated by its values
    middle: Array  # (3,) median position
    extent: float  # of its positions


def find_triples(
    names: Sequence[str], bare: Sequence[str], rows: Rows, is_length: Callable[[str], bool]
) -> Triples:
    """Find the positions among the columns of a log.

    Args:
        names: number columns, each name once.
        bare: their names in the file, which may repeat.
        rows: returns the numbers (rows, n) of n columns.
        is_length: whether the file states a length unit for a column.
    """
    found = list(_triples(list(names), list(bare), rows))
    fours = [columns for columns, _ in found if len(columns) == 4]
    turned = [LeftOut(tuple(four), "a quaternion") for four in fours]
    candidates = [_candidate(one, stem, rows, is_length) for one, stem in found if len(one) == 3]
    accepted, left = _classified(_families(candidates))
    accepted, unseen = _seen_only(accepted, list(_goals(list(names), list(bare))), rows)
    order = {one.columns[0]: k for k, one in enumerate(candidates)}
    places = sorted(
        (one.columns for family in accepted for one in family),
        key=lambda columns: order[columns[0]],
    )
    loose = [one.columns for family in accepted for one in family if not one.named]
    return Triples(
        places, [*sorted(left, key=lambda one: order[one.columns[0]]), *unseen, *turned], loose
    )


def _seen_only(
    accepted: list[list[_Candidate]], goals: list[list[str]], rows: Rows
) -> tuple[list[list[_Candidate]], list[LeftOut]]:
    """Return the families of measured positions, and the triples that repeat one's motion."""
    stems = [one.stem for family in accepted for one in family]
    doubtful = [family for family in accepted if is_computed(family[0].stem, stems)]
    seen = [family for family in accepted if family not in doubtful]
    places = [one.columns for family in seen for one in family]
    left = []
    for columns in [*(one.columns for family in doubtful for one in family), *goals]:
        leader = next((place for place in places if follows(rows(columns), rows(place))), None)
        if leader is not None:
            left.append(
                LeftOut(
                    tuple(columns),
                    f"a desired or computed place by the name, and follow {leader[0]}",
                )
            )
    gone = {one.columns for one in left}
    kept = [[one for one in family if tuple(one.columns) not in gone] for family in accepted]
    return [family for family in kept if family], left


def _goals(names: list[str], bare: list[str]) -> Iterator[list[str]]:
    """Yield the triples with names of goals."""
    return (
        columns for columns, stem in _by_letter(names, bare) if len(columns) == 3 and is_goal(stem)
    )


def _families(candidates: list[_Candidate]) -> list[list[_Candidate]]:
    """Return the candidates in sets whose names differ only in digits."""
    families: dict[str, list[_Candidate]] = {}
    for one in candidates:
        families.setdefault(without_numbers(one.stem), []).append(one)
    return list(families.values())


def _classified(families: list[list[_Candidate]]) -> tuple[list[list[_Candidate]], list[LeftOut]]:
    """Return the families of triples that are positions, and the others with the reason."""
    left: list[LeftOut] = []
    standing: list[list[_Candidate]] = []
    moves = any(
        (one.other or one.flag) is None and one.extent > 0 and (one.named or one.largest > np.pi)
        for family in families
        for one in family
    )
    for family in families:
        # a coarse coordinate of one marker among others may be 0 and 1
        why = family[0].other or (family[0].flag if all(one.flag for one in family) else None)
        steady = {one.steady for one in family}
        if (
            why is None
            and None not in steady
            and (not family[0].named or (moves and _never_changes(family)))
        ):
            why = family[0].steady
        if why is None:
            standing.append(family)
        else:
            left += [LeftOut(tuple(one.columns), why) for one in family]
    named = [family for family in standing if family[0].named]
    unnamed = [family for family in standing if not family[0].named]
    if not named and unnamed:
        named, unnamed = _by_size(unnamed)
    known = _together([one for family in named for one in family]) if named else None
    for family in unnamed:
        assert known is not None  # without an informative name, the largest set counts as positions
        why = _misfit(_together(family), known)
        if why is None:
            named.append(family)
        else:
            left += [LeftOut(tuple(one.columns), why) for one in family]
    return named, left


def _never_changes(family: list[_Candidate]) -> bool:
    """Return whether triples never change, like a camera's position; clamp markers may rest."""
    return all(one.steady == _OFFSET and not is_base(one.stem) for one in family)


def _by_size(
    families: list[list[_Candidate]],
) -> tuple[list[list[_Candidate]], list[list[_Candidate]]]:
    """Return the families taken as positions if no name marks one, and the others.

    Families beyond ±π nearest in size to the largest set are positions. If all are within ±π, all
    of them are positions in m.
    """
    sizes = [float(np.median([one.size for one in family])) for family in families]
    beyond = [k for k, family in enumerate(families) if max(one.largest for one in family) > np.pi]
    if not beyond:
        return families, []
    top = sizes[max(beyond, key=lambda k: len(families[k]))]
    alike = [k for k in beyond if top / FITS < sizes[k] < top * FITS]
    return [families[k] for k in alike], [
        family for k, family in enumerate(families) if k not in alike
    ]


@dataclass(frozen=True)
class _Set:
    """Several triples together: their size, largest number, middle (3,) and extent."""

    size: float
    largest: float
    middle: Array
    extent: float


def _together(family: list[_Candidate]) -> _Set:
    return _Set(
        float(np.median([one.size for one in family])),
        max(one.largest for one in family),
        np.mean([one.middle for one in family], axis=0),
        max(one.extent for one in family),
    )


def _misfit(family: _Set, known: _Set) -> str | None:
    """Return why triples without an informative name are not positions; None if they are.

    They are compared with the `known` positions.
    """
    if family.largest <= np.pi:
        return (
            "angles, within ±π"
            if known.largest > np.pi
            else "angles or places in m, because they are within ±π"
        )
    if not known.size / FITS < family.size < known.size * FITS:
        return f"no place: they are of size {family.size:.3g}, the places of size {known.size:.3g}"
    apart = float(np.linalg.norm(family.middle - known.middle))
    if apart > max(NEAR * known.extent, 0.9 * known.size):
        return f"no place of this robot: they are {apart:.3g} away from the others"
    return None


def _candidate(
    columns: list[str], stem: str, rows: Rows, is_length: Callable[[str], bool]
) -> _Candidate:
    points = rows(columns)
    points = points[np.isfinite(points).all(axis=1)]
    length = np.linalg.norm(points, axis=1)
    other, named = _by_name(stem)
    if is_length(columns[0]) and not _NAMELESS.search(stem):
        other, named = None, True
    size = float(np.median(length))
    largest = float(np.quantile(np.abs(points), 0.99))
    extent = float(
        np.linalg.norm(np.quantile(points, 0.95, axis=0) - np.quantile(points, 0.05, axis=0))
    )
    middle = np.median(points, axis=0)
    return _Candidate(
        columns,
        stem,
        named,
        other,
        _flag(columns, points),
        size,
        largest,
        _steady(points, length),
        middle,
        extent,
    )


def _flag(columns: list[str], points: Array) -> str | None:
    """Return that points (n, 3) are not positions, because a coordinate is only 0 and 1.

    Positions in whole numbers may have such a coordinate, if they have another one too.
    """
    switches = [is_switch(column) for column in points.T]
    whole = bool((points == np.rint(points)).all())
    wide = [bool(np.ptp(column) > 1.0) for column in points.T] if len(points) else []
    if not any(switches) or (whole and any(wide)):
        return None
    name = columns[switches.index(True)]
    return f"a flag or a switch, for {name} holds only 0 and 1"


def _steady(points: Array, length: Array) -> str | None:
    """Return what points (n, 3) are if they, or their distances from the origin, are constant."""
    if len(points) < 3:
        return None
    if not np.ptp(points, axis=0).any():
        return _OFFSET
    middle = float(np.median(length))
    usual = any(abs(middle - size) < 0.02 * size for size in DIRECTIONS)
    if usual and float(np.quantile(np.abs(length - middle), 0.9)) < STEADY * middle:
        return f"a direction or gravity, for their length is {middle:.4g} in all rows"
    return None


def _by_name(stem: str) -> tuple[str | None, bool]:
    """Return the other quantity that a name indicates, if any, and whether it marks a position."""
    words = [word.lower() for word in _WORD.findall(stem)]
    text = "_".join(words)
    place = any(_PLACE.search(word) or word in _SHORT_PLACE for word in words) or not words
    if _NAMELESS.search(stem):
        return "a marker without a name", False
    for what, pattern in _OTHER:
        if any(re.match(pattern, word) for word in words) or (
            not place and re.search(pattern, text)
        ):
            return f"{what}, by the name", False
    short = _NUMBERED_OTHER if re.search(r"\d", stem) else _SHORT_OTHER
    if re.fullmatch(r"[\W_]*T[\W_]*", stem) or (words and all(word in short for word in words)):
        return "a force, a rate or an angle, by the name of one letter", False
    return None, place


def find_pairs(
    names: Sequence[str],
    bare: Sequence[str],
    rows: Rows,
    is_place: Callable[[Sequence[str]], bool] = lambda _: False,
) -> Triples:
    """Find x, y of markers in a plane, for a log without positions in space.

    At least one must be named like a position, or be one by `is_place`.

    Args:
        names, bare, rows: as in `find_triples`.
        is_place: whether other columns show that a pair is a position.
    """

    def padded(columns: list[str]) -> Array:
        points = rows(columns)
        return np.column_stack([points, np.zeros(len(points))])

    pairs = list(_pairs(list(names), list(bare), rows))
    places_known = {pair[0] for pair, _ in pairs if is_place(pair)}
    families = _families(
        [_candidate(one, stem, padded, places_known.__contains__) for one, stem in pairs]
    )
    accepted, left = (
        _classified(families) if any(family[0].named for family in families) else ([], [])
    )
    order = {pair[0]: k for k, (pair, _) in enumerate(pairs)}
    places = sorted(
        (one.columns for family in accepted for one in family),
        key=lambda columns: order[columns[0]],
    )
    return Triples(
        places, left, [one.columns for family in accepted for one in family if not one.named]
    )


def _pairs(names: list[str], bare: list[str], rows: Rows) -> Iterator[tuple[list[str], str]]:
    """Yield x, y without z that move, and the shared part of their names."""
    where = {name: k for k, name in enumerate(bare)}
    for name in bare:
        for at in _letters(name):
            upper = name[at] == "X"
            second, third = (
                name[:at] + (axis.upper() if upper else axis) + name[at + 1 :] for axis in "yz"
            )
            if second in where and third not in where and not is_drive(name):
                columns = [names[where[one]] for one in (name, second)]
                points = rows(columns)
                points = points[np.isfinite(points).all(axis=1)]
                if len(points) > 1 and np.ptp(points, axis=0).any():
                    yield columns, name[:at] + " " + name[at + 1 :]
                break


# --- by name ---------------------------------------------------------------------------------
def _triples(names: list[str], bare: list[str], rows: Rows) -> Iterator[tuple[list[str], str]]:
    """Yield each triple of number columns, with the shared part of their names."""
    used: set[str] = set()
    for triple, stem in [*_by_letter(names, bare), *_by_number(names, bare)]:
        if used & set(triple) or is_drive(stem) or not np.isfinite(rows(triple)).all(axis=1).any():
            continue
        used |= set(triple)
        yield triple, stem


def _letters(name: str) -> list[int]:
    """Return the positions of x in a name, last first; empty for an overlong name."""
    return (
        [i for i in range(len(name) - 1, -1, -1) if name[i] in "xX"] if len(name) <= LONGEST else []
    )


def _by_letter(names: list[str], bare: list[str]) -> Iterator[tuple[list[str], str]]:
    """Yield triples whose names differ in x, y, z.

    For repeated names, the first occurrences form one triple, the second ones another.
    """
    where: dict[str, list[int]] = {}
    for k, name in enumerate(bare):
        where.setdefault(name, []).append(k)
    for k, name in enumerate(bare):
        for at in _letters(name):
            upper = name[at] == "X"
            triple = [
                name[:at] + (axis.upper() if upper else axis) + name[at + 1 :] for axis in "xyz"
            ]
            fourth = name[:at] + ("W" if upper else "w") + name[at + 1 :]
            nth = where[name].index(k)
            four = [*triple, fourth] if fourth in where else triple
            if all(len(where.get(one, [])) > nth for one in four):
                yield [names[where[one][nth]] for one in four], name[:at] + " " + name[at + 1 :]
                break


def _by_number(names: list[str], bare: list[str]) -> Iterator[tuple[list[str], str]]:
    """Yield triples counted 1, 2, 3 or 0, 1, 2 in brackets, if their name marks a position."""
    groups: dict[str, list[tuple[int, int]]] = {}
    for k, name in enumerate(bare):
        if len(name) <= LONGEST and (parts := _INDEX.match(name)) is not None and parts[1]:
            groups.setdefault(f"{parts[1]}{parts[2]}{parts[3]}", []).append((int(parts[4]), k))
    for stem, members in groups.items():
        numbers, columns = [n for n, _ in members], [k for _, k in members]
        even = numbers == list(range(numbers[0], numbers[0] + len(numbers))) and numbers[0] in (
            0,
            1,
        )
        other, place = _by_name(stem)
        if even and len(members) % 3 == 0 and place and other is None:
            for i in range(0, len(members), 3):
                yield (
                    [names[k] for k in columns[i : i + 3]],
                    f"{stem}{i // 3 if len(members) > 3 else ''}",
                )
