"""What the columns of a log look like, by their names and numbers: commands, encoders, markers, labels, units.

Only the rules that a laboratory's habits give: `x1, y1, z1` are a point; `u3`, `cmd_2` or `servo_4_mm` are commands;
`phi2` or `present_1` are encoders. Every answer carries the reason that is shown to the user. `guess_time.py` finds
the time.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.logs.mapping import LENGTH, UNITS
from softmap_edge.logs.plausible import ROBOT
from softmap_edge.logs.readers.mcap_file import open_mcap, topics
from softmap_edge.logs.readers.paced import PacedColumns
from softmap_edge.logs.readers.text import TextColumns
from softmap_edge.logs.table import LARGEST, open_log

Array = NDArray[np.float64]
ROWS = 20_000  # of each log that are looked at
MOST_COLUMNS = 4096  # of each log: names are compared by pairs
_TIMES = re.compile(r"^t$|time|stamp|clock|^sec|^t_|_t$", re.IGNORECASE)
_LABELS = re.compile(r"block|label|segment|trial|phase|pattern|part|condition|experiment", re.IGNORECASE)
_NO_POINT = re.compile(r"rot|orient|quat|vel|acc|gyr|force|torque|imu|mag|twist|unlabel", re.IGNORECASE)
# Roles of groups of columns, the surest words first; each is tried on the name, and on the topic of a recording.
ROLES: tuple[tuple[str, str], ...] = (
    ("current", r"current|(^|_)cur(_|#|$)|amp|_ma$"),
    ("temperature", r"temp|celsius"),
    ("load", r"(^|_)(load|mass|weight|payload)(_|$)"),
    ("present", r"present|actual|meas|enc|feedback|(^|_)fb|phi#|joint_?state|theta#|^q#|read"),
    ("command", r"^u_?#|cmd|command|goal|target|set_?point|desired|_des|_ref|action|input|control"),
    ("command", r"servo|tendon|motor|cable|actuat|pull"),
    ("present", r"^pos|position|angle|joint|state"),
)
_UNIT = {"mm": "mm", "cm": "cm", "m": "m", "um": "um", "deg": "deg", "degrees": "deg", "°": "deg", "rad": "rad"}
_UNIT |= {"radians": "rad", "ticks": "ticks", "ma": "mA", "a": "A", "g": "g", "kg": "kg", "n": "N", "k": "K"}
_UNIT |= {"degc": "degC", "°c": "degC", "c": "degC"}
TICK_DEG, TICK_RAD = 360.0 / 4096, 2 * np.pi / 4096  # the step of a 12-bit servo


@dataclass(frozen=True)
class Sheet:
    """One log, or one topic of a recording: its first rows."""

    path: Path
    topic: str | None
    names: list[str]
    units: dict[str, str]
    numbers: Array  # (rows, names); NaN in a column of text
    texts: dict[str, list[str]]
    header: bool = True
    clocks: dict[str, str] = field(default_factory=dict)  # columns of dates or times, in s, and their form

    def column(self, name: str) -> Array:
        """Return the numbers of a column."""
        return np.asarray(self.numbers[:, self.names.index(name)])

    def rows_of(self, names: list[str]) -> Array:
        """Return (rows, len(names))."""
        return np.stack([self.column(name) for name in names], axis=1)


@dataclass
class Role:
    """Columns of one kind, their unit, and why they are taken for it."""

    kind: str
    columns: list[str]
    unit: str | None
    why: str
    sure: bool = True


def read_sheets(paths: list[Path]) -> list[Sheet]:
    """Read the first rows of logs, and every topic of a recording that can be decoded.

    Raises:
        RunError: a file cannot be read.
    """
    sheets: list[Sheet] = []
    for path in paths:
        columns = None if path.suffix.lower() == ".mcap" else open_log(path)
        if columns is None:
            recorded = topics(path)
            if not any(topic.readable for topic in recorded):
                named = ", ".join(f"{topic.name} ({topic.type})" for topic in recorded)[:200] or "none"
                raise RunError(
                    f"{path}: no topic holds messages in cdr of ros2msg, as rosbag2 writes; there are {named}"
                )
            for topic in recorded:
                if topic.readable:
                    held = open_mcap(path, topic.name, ROWS)
                    numbers = np.where(np.abs(held.numbers) < LARGEST, held.numbers, np.nan)
                    sheets.append(Sheet(path, topic.name, held.names, {}, numbers, {}))
            continue
        if len(columns.names) > MOST_COLUMNS:
            raise RunError(
                f"{path}: {len(columns.names)} columns, at most {MOST_COLUMNS} are looked at; name those of the robot "
                "in a mapping by hand: docs/mapping.md lists its keys"
            )
        texts: dict[str, list[str]] = {}
        clocks: dict[str, str] = {}
        if isinstance(columns, TextColumns | PacedColumns):
            texts = columns.texts(200)
            clocks = {columns.names[k]: clock.form for k, clock in columns.clocks.items()}
        places = [k for k, name in enumerate(columns.names) if name not in texts]
        cells = columns.read(places, None, ROWS).numbers[:ROWS]
        numbers = np.full((len(cells), len(columns.names)), np.nan)
        numbers[:, places] = np.where(np.abs(cells) < LARGEST, cells, np.nan)
        header = not isinstance(columns, TextColumns) or columns.header
        sheets.append(Sheet(path, None, columns.names, dict(columns.units), numbers, texts, header, clocks))
    return sheets


# --- names ---------------------------------------------------------------------------------
def unit_in_name(name: str, known: dict[str, float] | dict[str, str]) -> str | None:
    """Return the unit at the end of a name: `servo_4_mm`, `Time [ms]`, `u1 (deg)`."""
    bracketed = re.search(r"[\[(]([^\[\]()]*)[\])]$", name.lower())
    words: list[str] = re.findall(r"[a-z°]+", bracketed[1]) if bracketed else []
    words = words or re.findall(r"_([a-z°]+)$", name.lower())
    return words[-1] if words and words[-1] in known else None


# --- points --------------------------------------------------------------------------------
def points_of(sheet: Sheet) -> list[list[str]]:
    """Return the triples of columns that are x, y, z of a place, in the file's order."""
    found: list[list[str]] = []
    used: set[str] = set()
    for name in sheet.names:
        if name in used or name in sheet.texts or _NO_POINT.search(name):
            continue
        for at in [k for k in range(len(name) - 1, -1, -1) if name[k] in "xX"]:
            upper = name[at] == "X"
            triple = [name[:at] + (axis.upper() if upper else axis) + name[at + 1 :] for axis in "xyz"]
            fourth = name[:at] + ("W" if upper else "w") + name[at + 1 :]
            if all(n in sheet.names and n not in sheet.texts for n in triple) and fourth not in sheet.names:
                if np.isfinite(sheet.rows_of(triple)).all(axis=1).any():
                    found.append(triple)
                    used |= set(triple)
                break
    stems = {triple[0].lower() for triple in found}
    if stems & {"x", "px"}:  # beside a place there are rates and forces: fx, vx, wx
        found = [triple for triple in found if not re.fullmatch(r"[afgmqtvw]x", triple[0].lower())]
    bodies = [triple for triple in found if triple[0].replace(".x", ".rotation.x") in sheet.names]
    others = [triple for triple in found if triple not in bodies]
    return bodies if len(bodies) > 1 else others or bodies


def length_unit(points: Array, stated: str | None) -> tuple[str, str]:
    """Return the unit of points (K, M, 3), and why."""
    if stated in LENGTH:
        return "file", f"the file states {stated}"
    flat = points.reshape(-1, 3)
    flat = flat[np.isfinite(flat).all(axis=1)]
    span = float(np.ptp(flat, axis=0).max())
    if points.shape[1] == 1:
        span = max(span, float(np.abs(flat).max()))
    for unit in ("mm", "m", "um", "cm"):
        if 20.0 <= span * LENGTH[unit] <= 2000.0 or (unit == "cm" and ROBOT[0] <= span * 10 <= ROBOT[1]):
            return unit, f"they span {span:.3g}, {span * LENGTH[unit]:.0f} mm if they are {unit}"
    return "mm", f"they span {span:.3g}, which is no robot's size in any unit"


# --- drives --------------------------------------------------------------------------------
def roles_of(sheet: Sheet, spent: set[str]) -> list[Role]:
    """Return the groups of the other columns that have a meaning, the surest first."""
    groups: dict[str, list[str]] = {}
    for name in sheet.names:
        if name not in spent and name not in sheet.texts and np.isfinite(sheet.column(name)).any():
            stem = re.sub(r"\[[^\]]*\]$", "[#]", name) if sheet.topic else name
            stem = re.sub(r"(^|_)([a-dx-z]|left|right|up|down)(?=_|$)", "_#", re.sub(r"\d+", "#", stem.lower()))
            groups.setdefault(stem, []).append(name)
    roles: list[tuple[int, Role]] = []
    for stem, names in groups.items():
        bare = stem.replace("[#]", "#")
        if re.search(r"veloc|effort|accel", bare):
            continue
        where = [(bare, f"called '{names[0]}'" + ("" if len(names) == 1 else f" to '{names[-1]}'"))]
        if sheet.topic:
            where.insert(0, (sheet.topic.lower(), f"of topic {sheet.topic}"))
        for text, why in where:
            rank = next((k for k, (_, words) in enumerate(ROLES) if re.search(words, text)), None)
            if rank is not None:
                kind = ROLES[rank][0]
                unit = _UNIT.get((sheet.units.get(names[0]) or unit_in_name(names[0], _UNIT) or "").lower())
                roles.append((rank, Role(kind, names, unit if unit in UNITS[kind] else None, why, sure=rank < 5)))
                break
    roles.sort(key=lambda pair: pair[0])  # stable: neighbours in the file stay neighbours
    merged: list[tuple[int, Role]] = []
    for rank, role in roles:
        if merged and merged[-1][0] == rank and _siblings(sheet, merged[-1][1], role):
            merged[-1][1].columns.extend(role.columns)
        else:
            merged.append((rank, role))
    return [role for _, role in merged]


def _siblings(sheet: Sheet, one: Role, other: Role) -> bool:
    """Whether two columns side by side differ only in their last word: `motor_links`, `motor_rechts`."""
    place = sheet.names.index(other.columns[0]) - sheet.names.index(one.columns[-1])
    stems = [re.sub(r"[^_]*$", "", role.columns[0].lower()) for role in (one, other)]
    alone = len(other.columns) == 1 and not any(re.search(r"\d", name) for name in (one.columns[0], other.columns[0]))
    return alone and place == 1 and stems[0] == stems[1] != "" and one.unit == other.unit


def drive_unit(rows: Array, stated: str | None) -> tuple[str, str, bool]:
    """Return the unit of commands or encoders (T, C), why, and whether that is sure."""
    if stated is not None:
        return stated, f"their name says {stated}", True
    known = rows[np.isfinite(rows)]
    peak = float(np.abs(known).max())
    whole = rows[np.isfinite(rows).all(axis=1)]
    for tick, unit in ((TICK_DEG, "deg"), (TICK_RAD, "rad")):
        steps = (whole - whole[:1]) / tick  # whatever home is
        if len(steps) > 1 and np.abs(steps).max() > 10 and np.abs(steps - np.rint(steps)).max() < 0.02:
            return unit, f"they move in steps of {tick:.6g}, those of a 12-bit servo in {unit}", True
    if (known == np.rint(known)).all() and peak > 360:
        return "ticks", f"they are whole numbers up to {peak:.0f}", False
    for limit, unit in ((0.2, "m"), (3.3, "rad"), (25.0, "mm"), (3600.0, "deg")):
        if peak <= limit:
            return unit, f"they reach {peak:.3g}", False
    return "ticks", f"they reach {peak:.3g}", False


def label_of(sheet: Sheet) -> str | None:
    """Return the column that says which part of the protocol a row belongs to."""
    for name, texts in sheet.texts.items():
        if not sheet.header or "frame" in name.lower():  # the name of a coordinate frame
            continue
        if len(set(texts)) <= max(3, len(texts) // 2) and any(texts) and not _TIMES.search(name):
            return name
    for name in sheet.names:
        values = sheet.column(name) if name not in sheet.texts else np.zeros(0)
        if _LABELS.search(name) and len(values) and np.isfinite(values).all() and (values == np.rint(values)).all():
            return name
    return None
