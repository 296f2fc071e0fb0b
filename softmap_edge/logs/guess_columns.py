"""Classify columns by names and numbers: commands, encoders, markers, labels, units.

The rules cover common laboratory habits: `x1, y1, z1` are a point; `u3`, `cmd_2` or `servo_4_mm`
are commands; `phi2` or `present_1` are encoders. Every answer includes the reason shown to the
user. `guess_time.py` finds the time.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.logs.flags import REASON, are_flags, named_so, words_of
from softmap_edge.logs.guess_sheets import Sheet
from softmap_edge.logs.likelihood import is_likelihood, likelihood_of
from softmap_edge.logs.mapping import LENGTH, UNITS
from softmap_edge.logs.numbered import without_numbers
from softmap_edge.logs.plausible import ROBOT
from softmap_edge.logs.text_columns import mostly_numbers
from softmap_edge.logs.time_names import TIME_NAME, is_time_name
from softmap_edge.logs.triples import LeftOut, Triples, find_pairs, find_triples
from softmap_edge.logs.unit_words import UNIT_WORDS, unit_in_name, unknown_unit

Array = NDArray[np.float64]
_JOINTS = re.compile(r"joint_?states?", re.IGNORECASE)  # a topic, a column or a message type
# a word of a name
_LABELS = re.compile(
    r"(block|label|segment|trial|phase|pattern|part|condition|experiment)s?"
    r"(id|nr|no|num|number|index|idx|name|label)?"
)
TRACKED = re.compile(r"track|instance|individual|scorer|skeleton", re.IGNORECASE)
_PLACES = re.compile(
    r"marker|point|(^|[._])tip($|_)|xyz|mocap|optitrack|vicon|place|end_?effector", re.IGNORECASE
)
_NO_POINT = re.compile(
    r"rot|orient|quat|vel|acc|gyr|force|torque|imu|mag|twist|unlabel", re.IGNORECASE
)
# roles of column groups, the most certain words first; tried on the name, and on the topic of a
# recording
ROLES: tuple[tuple[str, str], ...] = (
    ("current", r"current|(^|_)cur(_|#|$)|(?<![a-z])amp(s|eres?)?(?![a-z])|_ma$"),
    ("temperature", r"(?<!at)temp(?!l|or)|celsius"),
    ("load", r"(^|_)(load|mass|weight|payload)(?![^\W\d_])"),
    (
        "present",
        r"present|actual|meas|encoder|enc(?![a-z])|feedback|(^|_)fb|phi#|joint_?state|theta#|^q#"
        r"|(?<![a-z])read(?!y)",
    ),
    ("present", r"gemessen|(^|[_ .])ist([_ .#-]|wert|winkel|pos|lage|$)"),
    (
        "command",
        r"^u(_[a-z]{1,2})?[_.]?#|cmd|command|goal|target|set_?point|desired|_des|(^|_)ref"
        r"|(?<![a-z])action|input|control",
    ),
    ("command", r"soll|vorgabe|stell_?(gr|wert|signal)|befehl|f(ü|ue)hrungsgr|consigne"),
    ("command", r"servo|tendon|motor|cable|actuat|pull"),
    ("present", r"^pos(?!e)|position|angle|joint|state|winkel|gelenk|stellung|articulation"),
)
_SURE = 7  # of the roles: the names of the others are those of goals and of positions that are read
TICK_DEG, TICK_RAD = 360.0 / 4096, 2 * np.pi / 4096  # step of a 12-bit servo


@dataclass
class Role:
    """Columns of one kind, their unit, and the reason for this classification."""

    kind: str
    columns: list[str]
    unit: str | None
    why: str
    sure: bool = True
    joint: bool = False  # joint states of ROS: rad, or m for a joint that slides
    stated: str | None = None  # the unit that the log states, if it is not read for this kind


def last_of(sheet: Sheet, name: str) -> str:
    """Return the last word of an array's path: `u[0]` of `log.signal.u[0]`; others unchanged."""
    found = re.fullmatch(r".*?([^.\[\]]+(\[[^\]]*\])*(\.[xyz])?)", name)
    return found[1] if found and sheet.indexed and sheet.topic is None else name


def stated_of(sheet: Sheet, name: str, known: Collection[str]) -> str | None:
    """Return the unit that a log states for a column, if it is none of the `known` words."""
    if sheet.indexed or not sheet.header:
        return None
    line = sheet.units.get(name) or sheet.stated.get(name)
    return unknown_unit(name, line, known)


# --- points --------------------------------------------------------------------------------
def points_of(sheet: Sheet) -> Triples:
    """Return the triples of columns that are x, y, z of a position, and those that are not.

    They are in the file's order.
    """
    flags = sheet.flags()
    found = _points_of(sheet, {*sheet.texts, *flags})
    likely = {place[0]: name for place in found.places if (name := _likelihood(sheet, place))}
    if len(likely) == len(found.places):
        found = replace(found, likelihood=likely)
        flags = [name for name in flags if name not in likely.values()]
    return replace(found, left=[*found.left, LeftOut(tuple(flags), REASON)]) if flags else found


def _likelihood(sheet: Sheet, place: Sequence[str]) -> str | None:
    """Return the column with the likelihood of a position; None without one."""
    name = likelihood_of(place, sheet.names) if sheet.header else None
    if name is None or name in sheet.texts:
        return None
    letter = len(name) == len(place[0])
    # pixels have no z and are never negative; `tip_p` of a place in mm may be a pressure
    if letter and (len(place) > 2 or (sheet.rows_of(list(place)) < 0).any()):
        return None
    return name if is_likelihood(sheet.column(name), letter) else None


def _points_of(sheet: Sheet, gone: set[str]) -> Triples:
    keep = [k for k, name in enumerate(sheet.names) if name not in gone]
    names, bare = [sheet.names[k] for k in keep], [(sheet.bare or sheet.names)[k] for k in keep]
    found = find_triples(names, bare, sheet.rows_of, lambda name: sheet.units.get(name) in LENGTH)
    used = {name for one in [*found.places, *(left.columns for left in found.left)] for name in one}
    used |= gone
    found = replace(found, places=[*found.places, *_elements(sheet, used)])
    bodies = [one for one in found.places if _turns(sheet, one[0])]
    if len(bodies) > 1:  # markers of a rigid body repeat its pose
        return Triples(bodies, found.left)
    others = [one for one in found.places if one not in bodies]
    if found.places:
        return Triples(others or bodies, found.left, found.by_size)
    plane = find_pairs(
        names, bare, sheet.rows_of, lambda pair: _likelihood(sheet, pair) is not None
    )
    return Triples(plane.places, [*found.left, *plane.left], plane.by_size)


def _turns(sheet: Sheet, name: str) -> bool:
    """Return whether a position has a rotation, so belongs to a rigid body of motion capture."""
    return ".x" in name and name.replace(".x", ".rotation.x") in sheet.names


def _elements(sheet: Sheet, used: set[str]) -> list[list[str]]:
    """Return the positions among arrays.

    These have three columns without another meaning, or 3 M columns and a name such as markers.
    """
    if not sheet.indexed or sheet.topic is not None:
        return []
    arrays: dict[str, list[str]] = {}
    for name in sheet.names:
        if (
            (found := re.fullmatch(r"(.*)\[\d+\]", name))
            and name not in used
            and not _NO_POINT.search(name)
        ):
            arrays.setdefault(found[1], []).append(name)
    triples: list[list[str]] = []
    for stem, names in arrays.items():
        last = last_of(sheet, stem)
        free = len(names) == 3 and not any(
            re.search(words, f"{last.lower()}#") for _, words in ROLES
        )
        if len(names) % 3 == 0 and (free or _PLACES.search(last)):
            triples += [names[k : k + 3] for k in range(0, len(names), 3)]
    return triples


def length_unit(points: Array, stated: str | None) -> tuple[str, str]:
    """Return the unit of points (K, M, 3), and the reason."""
    if stated in LENGTH:
        return "file", f"the file states {stated}"
    flat = points.reshape(-1, 3)
    flat = flat[np.isfinite(flat).all(axis=1)]
    if not len(flat):
        return "mm", "no row has all coordinates of one place"
    span = float(np.ptp(flat, axis=0).max())
    if points.shape[1] == 1:
        span = max(span, float(np.abs(flat).max()))
    for unit in ("mm", "m", "um", "cm"):
        if 20.0 <= span * LENGTH[unit] <= 2000.0 or (
            unit == "cm" and ROBOT[0] <= span * 10 <= ROBOT[1]
        ):
            return unit, f"they span {span:.3g}, {span * LENGTH[unit]:.0f} mm if they are {unit}"
    return "mm", f"they span {span:.3g}, which is not the size of a robot in any unit"


# --- drives --------------------------------------------------------------------------------
def roles_of(sheet: Sheet, spent: set[str]) -> list[Role]:
    """Return the groups of other columns that have a meaning, the most certain first."""
    groups: dict[str, list[str]] = {}
    for name in sheet.names:
        if name not in spent and name not in sheet.texts and _may_drive(sheet, name):
            plain = re.sub(r"[(\[{](\d+)[)\]}]$", r"\1", name)
            stem = re.sub(r"\[[^\]]*\]$", "[#]", name) if sheet.indexed else plain
            stem = re.sub(
                r"(?:^|_|(\.))([a-dx-z]|left|right|up|down)(?=[_.]|$)",
                lambda part: f"{part[1] or '_'}#",
                without_numbers(stem.lower()),
            )
            groups.setdefault(stem, []).append(name)
    roles: list[tuple[int, Role]] = []
    for stem, names in _by_publisher(sheet, groups):
        bare = stem.replace("[#]", "#")
        if re.search(r"veloc|effort|accel|covar", bare):
            continue
        last = last_of(sheet, bare)
        where = [(last, f"called '{names[0]}'" + ("" if len(names) == 1 else f" to '{names[-1]}'"))]
        if last != bare:
            where.append((bare, where[0][1]))
        if sheet.topic:
            where.insert(0, (sheet.topic.lower(), f"of topic {sheet.topic}"))
        joint = _JOINTS.search(f"{sheet.topic or ''} {bare} {sheet.kind}") is not None
        for text, why in where:
            rank = next((k for k, (_, words) in enumerate(ROLES) if re.search(words, text)), None)
            if rank is not None:
                kind = ROLES[rank][0]
                unit = UNIT_WORDS.get(
                    (sheet.units.get(names[0]) or unit_in_name(names[0], UNIT_WORDS) or "").lower()
                )
                words = {word for word, one in UNIT_WORDS.items() if one in UNITS[kind]}
                odd = None if unit in UNITS[kind] else stated_of(sheet, names[0], words)
                roles.append(
                    (
                        rank,
                        Role(
                            kind,
                            names,
                            unit if unit in UNITS[kind] else None,
                            why,
                            rank < _SURE,
                            joint,
                            odd,
                        ),
                    )
                )
                break
    roles.sort(key=lambda pair: pair[0])  # stable: the file's order is kept
    merged: list[tuple[int, Role]] = []
    for rank, role in roles:
        if merged and merged[-1][0] == rank and _siblings(sheet, merged[-1][1], role):
            merged[-1][1].columns.extend(role.columns)
        else:
            merged.append((rank, role))
    return [role for _, role in merged]


def _may_drive(sheet: Sheet, name: str) -> bool:
    """Return whether a column has numbers, and is not a clock: named like one, and never falling."""
    known = sheet.column(name)[np.isfinite(sheet.column(name))]
    last = name.rsplit(".", 1)[-1] if sheet.topic is not None else name
    rises = len(known) > 1 and known[-1] > known[0] and bool((np.diff(known) >= 0).all())
    return len(known) > 0 and not (rises and is_time_name(last))


def _by_publisher(sheet: Sheet, groups: dict[str, list[str]]) -> list[tuple[str, list[str]]]:
    """Return the groups, split by publisher.

    Columns of different publishers never hold a number in the same row.
    """
    found: list[tuple[str, list[str]]] = []
    for stem, names in groups.items():
        parts: list[tuple[NDArray[np.bool_], list[str]]] = []
        for name in names:
            present = np.isfinite(sheet.column(name))
            part = next((part for part in parts if (part[0] & present).any()), None)
            if part is None:
                parts.append((present, [name]))
            else:
                part[1].append(name)
                part[0][:] |= present
        found += [(stem, part) for _, part in parts]
    return found


def _siblings(sheet: Sheet, one: Role, other: Role) -> bool:
    """Return whether columns differ only in the last word: `motor_links`, `motor_rechts`."""
    place = sheet.names.index(other.columns[0]) - sheet.names.index(one.columns[-1])
    stems = [re.sub(r"[^_]*$", "", role.columns[0].lower()) for role in (one, other)]
    alone = len(other.columns) == 1 and not any(
        re.search(r"\d", name) for name in (one.columns[0], other.columns[0])
    )
    return alone and place == 1 and stems[0] == stems[1] != "" and one.unit == other.unit


def drive_unit(rows: Array, stated: str | None, joint: bool = False) -> tuple[str, str, bool]:
    """Return the unit of commands or encoders (T, C), the reason, and whether it is certain.

    `joint` states whether they are joint states.
    """
    if stated is not None:
        return stated, f"their name states {stated}", True
    known = rows[np.isfinite(rows)]
    peak = float(np.abs(known).max())
    if not joint and all(len(np.unique(column[np.isfinite(column)])) < 2 for column in rows.T):
        return "mm", f"they never change (at most {peak:.3g}), and a constant shows no unit", False
    complete = rows[np.isfinite(rows).all(axis=1)]
    for tick, unit in ((TICK_DEG, "deg"), (TICK_RAD, "rad")):
        steps = (complete - complete[:1]) / tick  # independent of home
        if (
            len(steps) > 1
            and np.abs(steps).max() > 10
            and np.abs(steps - np.rint(steps)).max() < 0.02
        ):
            return (
                unit,
                f"they move in steps of {tick:.6g}, those of a 12-bit servo in {unit}",
                True,
            )
    if joint:
        return (
            "rad",
            "joint states are in rad by REP 103, or in m for joints that slide; they reach "
            f"{peak:.3g}",
            False,
        )
    if (known == np.rint(known)).all() and peak > 360:
        return "ticks", f"they are whole numbers up to {peak:.0f}", False
    for limit, unit in ((0.2, "m"), (3.3, "rad"), (25.0, "mm"), (3600.0, "deg")):
        if peak <= limit:
            return unit, f"they reach {peak:.3g}", False
    return "ticks", f"they reach {peak:.3g}", False


def label_of(sheet: Sheet) -> str | None:
    """Return the column that labels each row's part of the protocol."""
    for name, texts in sheet.texts.items():
        # the name of a coordinate frame, and of what a tracker of pictures follows
        if not sheet.header or "frame" in name.lower() or TRACKED.fullmatch(name):
            continue
        labelled = any(map(_LABELS.fullmatch, words_of(name)))
        if are_flags(name, texts) or (mostly_numbers(texts) and not labelled):
            continue
        if len(set(texts)) <= max(3, len(texts) // 2) and any(texts) and not TIME_NAME.search(name):
            return name
    for name in sheet.names:
        values = sheet.column(name) if name not in sheet.texts else np.zeros(0)
        if (
            any(map(_LABELS.fullmatch, words_of(name)))
            and not named_so(name)
            and len(values)
            and 2 * len(np.unique(values)) <= max(len(values), 6)
            and np.isfinite(values).all()
            and (values == np.rint(values)).all()
        ):
            return name
    return None
