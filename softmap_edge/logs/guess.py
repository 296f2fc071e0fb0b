"""Proposes a mapping for logs that nobody has described yet, and says in plain words what it assumed and cannot know.

From the header and the ranges: which column is time, which are commands, encoders, markers and labels, in which unit;
from the markers at rest, which axis of the log is the robot's and where its clamp may be. What no log tells (the rate
of a counter, the spool, gravity, the place of the clamp) is written as an assumption to be replaced. The proposal is
tried: what the import says of it belongs to the answer. Pinned by tests/test_guess.py.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.logs.guess_columns import (
    Role,
    Sheet,
    drive_unit,
    label_of,
    length_unit,
    points_of,
    read_sheets,
    roles_of,
    time_of,
    unit_in_name,
)
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import ANGLE, LENGTH, SCHEMA, TIME, parse_mapping
from softmap_edge.logs.plausible import at_rest, axes_for, is_base, rest_axis

Array = NDArray[np.float64]
RATE_HZ = 100  # of a counter, where nothing says better
MANY = 5000  # frames: a diagnosis needs no more, and takes longer
SEEN_HZ = 20


@dataclass(frozen=True)
class Guess:
    """A proposed mapping.

    Attributes:
        text: the mapping, commented.
        assumed, unknown: sentences on what was assumed, and on what no log can tell.
        said: what the import says of the proposal: notes, doubts, or why it fails.
    """

    text: str
    assumed: tuple[str, ...]
    unknown: tuple[str, ...]
    said: tuple[str, ...]

    def __str__(self) -> str:
        return self.text

    def to_dict(self) -> dict[str, Any]:
        """Return the document softmap.guess/1."""
        found = {"assumed": list(self.assumed), "unknown": list(self.unknown), "said": list(self.said)}
        return {"schema": "softmap.guess/1", "mapping": self.text, **found}


@dataclass
class _Found:
    """What is known so far."""

    assumed: list[str] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)
    command: tuple[Sheet, Role] | None = None
    present: tuple[Sheet, Role] | None = None
    others: list[tuple[Sheet, Role]] = field(default_factory=list)
    points: tuple[Sheet, list[list[str]], str] | None = None
    base: list[list[str]] = field(default_factory=list)  # markers on the clamp
    label: str | None = None
    times: dict[int, tuple[str | None, str]] = field(default_factory=dict)


def guess_mapping(paths: Sequence[str | os.PathLike[str]]) -> Guess:
    """Propose a mapping for logs.

    Args:
        paths: the logs of one recording, of any format that `softmap import` reads.

    Raises:
        RunError: a file cannot be read, or nothing in it looks like commands or markers.
    """
    files = [Path(path) for path in paths]
    sheets, found = read_sheets(files), _Found()
    for k, sheet in enumerate(sheets):
        name, unit, why = time_of(sheet)
        found.times[k] = (name, unit)
        found.assumed.append(f"time of {_called(sheet)}: {why}")
        if unit == "rows":
            what = "how fast rows were logged" if name is None else f"how fast '{name}' counts"
            found.unknown.append(f"{what} in {_called(sheet)}: {RATE_HZ} Hz is written; put the rate of the log there")
    _find_points(sheets, found)
    _find_drives(sheets, found)
    if found.points is None and found.command is None:
        seen = "; ".join(f"{_called(sheet)}: {', '.join(map(_range_of(sheet), sheet.names))}" for sheet in sheets)
        raise RunError(
            f"no column looks like a command or a marker by its name ({seen[:600]}); write the mapping by hand: "
            "docs/mapping.md lists its keys, examples/trunk.toml shows the form"
        )
    found.unknown += [
        line for sheet, time in zip(sheets, found.times.values()) for line in _left_out(sheet, time[0], found)
    ]
    text = _write(sheets, files, found)
    head = [f"# Proposed from the header and the ranges of {', '.join(path.name for path in files)}; read every line."]
    head += [f"# ASSUMED  {line}" for line in found.assumed] + [f"# UNKNOWN  {line}" for line in found.unknown]
    text = "\n".join([*map(_one_line, head), text])
    return Guess(text, tuple(found.assumed), tuple(found.unknown), _tried(files, text))


def _one_line(comment: str) -> str:
    """Names of files and columns may hold anything; a comment must not end within one and go on as keys."""
    return "".join(c if c.isprintable() else " " for c in comment)


def _tried(files: list[Path], text: str) -> tuple[str, ...]:
    try:
        done = import_logs(files, parse_mapping(text, Path("proposal")))
    except RunError as fault:
        return (f"as it stands it cannot be imported: {fault}",)
    return (*done.notes, *(f"look at: {doubt}" for doubt in done.doubts))


def _called(sheet: Sheet) -> str:
    return sheet.path.name if sheet.topic is None else f"{sheet.path.name} {sheet.topic}"


def _left_out(sheet: Sheet, time: str | None, found: _Found) -> list[str]:
    """Name the columns that vary and are not taken, so that nobody believes that they are in the run."""
    used = {time, found.label} | {c for pair in found.others if pair[0] is sheet for c in pair[1].columns}
    used |= {c for pair in (found.command, found.present) if pair and pair[0] is sheet for c in pair[1].columns}
    if found.points is not None and found.points[0] is sheet:
        used |= {name for triple in [*found.points[1], *found.base] for name in triple}
    varies = [name for name in sheet.names if np.unique(sheet.column(name)[np.isfinite(sheet.column(name))]).size > 1]
    left = [name for name in varies if name not in used]
    if not left:
        return []
    named = ", ".join(map(_range_of(sheet), left[:6])) + (f" and {len(left) - 6} more" if len(left) > 6 else "")
    return [f"what these columns of {_called(sheet)} are: {named}; they are left out, add them if the run needs them"]


def _range_of(sheet: Sheet) -> Any:
    def told(name: str) -> str:
        values = sheet.column(name)
        values = values[np.isfinite(values)]
        return f"{name} ({values.min():.4g} to {values.max():.4g})" if len(values) else f"{name} (text)"

    return told


# --- what is what --------------------------------------------------------------------------
def _find_points(sheets: list[Sheet], found: _Found) -> None:
    best = max(((points_of(sheet), sheet) for sheet in sheets), key=lambda pair: len(pair[0]))
    triples, sheet = best
    if not triples:
        found.unknown.append("where the markers are: no columns named x, y, z of a place; nothing is seen in this run")
        return
    found.base = [triple for triple in triples if is_base(triple[0])]
    triples = [triple for triple in triples if triple not in found.base]
    if not triples:
        triples, found.base = found.base, []
    flat = [name for triple in triples for name in triple]
    points = sheet.rows_of(flat).reshape(len(sheet.numbers), -1, 3)
    named = unit_in_name(flat[0], LENGTH)
    unit, why = (named, f"their names say {named}") if named else length_unit(points, sheet.units.get(flat[0]))
    found.points = (sheet, triples, unit)
    found.assumed.append(f"markers: {len(triples)} of {_called(sheet)}, in the order of the columns, base first; {why}")
    if found.base:
        places = " ".join(f"b{k}:X,Y,Z" for k in range(len(found.base)))
        found.assumed.append(
            f"base: {len(found.base)} markers are on the clamp by their names; `softmap align RUN --base {places}` "
            "brings the run to the base by them"
        )
    found.label = label_of(sheet)
    if found.label is not None:
        found.assumed.append(f"blocks: '{found.label}' names the part of the protocol; folds are cut by it")


def _find_drives(sheets: list[Sheet], found: _Found) -> None:
    spent = {id(sheet): {found.times[k][0] or ""} for k, sheet in enumerate(sheets)}
    if found.points is not None:
        sheet, triples, _ = found.points
        spent[id(sheet)] |= {name for triple in [*triples, *found.base] for name in triple} | {found.label or ""}
    roles = [(sheet, role) for sheet in sheets for role in roles_of(sheet, spent[id(sheet)])]
    commands = [pair for pair in roles if pair[1].kind == "command"]
    presents = [pair for pair in roles if pair[1].kind == "present"]
    commands.sort(key=lambda pair: (not pair[1].sure, -len(pair[1].columns)))
    presents.sort(key=lambda pair: -len(pair[1].columns))
    if commands:
        found.command = commands[0]
    elif presents:
        found.command = presents.pop(0)
        found.assumed.append("commands: none is named so; what the encoders read stands for them")
    if found.command is None:
        found.unknown.append("what was commanded: nothing is named so; effects of the drive cannot be told")
        return
    width = len(found.command[1].columns)
    fits = [pair for pair in presents if len(pair[1].columns) == width]
    found.present = fits[0] if fits else None
    sheet, role = found.command
    found.assumed.append(f"commands: {width} columns of {_called(sheet)}, {role.why}, in the order of the file")
    if not role.sure and found.present is None:
        found.assumed.append("commands: goals, or what the servos read, is not said; either drives the model")
    if found.present is not None:
        found.assumed.append(f"encoders: {width} columns of {_called(found.present[0])}, {found.present[1].why}")
    for pair in roles:
        one = pair[1].kind in ("temperature", "load") and len(pair[1].columns) == 1
        if one or (pair[1].kind == "current" and len(pair[1].columns) == width):
            found.others.append(pair)
            found.assumed.append(f"{pair[1].kind}: {', '.join(pair[1].columns)} of {_called(pair[0])} by name")
    _drive_units(found)


def _drive_units(found: _Found) -> None:
    """The units of commands and encoders; where only one is sure and both move alike, it is that of both."""
    assert found.command is not None
    drives = [("commands", found.command)] + ([] if found.present is None else [("encoders", found.present)])
    answers = [drive_unit(sheet.rows_of(role.columns), role.unit) for _, (sheet, role) in drives]
    if len(answers) == 2 and answers[0][2] != answers[1][2]:
        moved = [float(np.median(_spread(sheet.rows_of(role.columns)))) for _, (sheet, role) in drives]
        firm = 0 if answers[0][2] else 1
        if moved[0] > 0 and 0.5 < moved[1] / moved[0] < 1.5:
            why = f"encoders move {moved[1] / moved[0]:.2f} times as far as commands, so the unit is the same"
            answers[1 - firm] = (answers[firm][0], why, True)
    if len(answers) == 2 and not _alike(answers[0][0], answers[1][0]):
        if answers[0][2] and answers[1][2]:
            found.present = None
            found.unknown.append(
                f"the radius of the spools: encoders are in {answers[1][0]}, commands in {answers[0][0]}; the encoders "
                "are left out, give them with spool_radius_mm"
            )
        else:
            loose = 0 if answers[1][2] else 1
            answers[loose] = (answers[1 - loose][0], f"as the {drives[1 - loose][0]}", False)
    for (kind, (_, role)), (unit, why, sure) in zip(drives, answers[: 2 if found.present else 1]):
        role.unit = unit
        found.assumed.append(f"{kind}: in {unit}; {why}")
        if not sure:
            found.unknown.append(f"the unit of the {kind}: {unit} is only likely")
    unit = answers[0][0]
    if unit in ANGLE:
        found.unknown.append(
            f"the radius of the spools: commands stay {unit}; with spool_radius_mm, and without command_unit, they are "
            "mm of tendon, which a simulated finger needs"
        )


def _alike(one: str, other: str) -> bool:
    """Whether two units are of one kind."""
    kinds: tuple[Any, ...] = (LENGTH, ANGLE, ("ticks",))
    return any(one in kind and other in kind for kind in kinds)


def _spread(rows: Array) -> Array:
    return np.asarray(np.nanmax(rows, axis=0) - np.nanmin(rows, axis=0))


# --- the frame -----------------------------------------------------------------------------
def _frame(sheets: list[Sheet], found: _Found) -> list[str]:
    """The lines of [frame]: the robot's axis at rest is z; where the clamp may be."""
    assert found.points is not None
    sheet, triples, unit = found.points
    names = [name for triple in [*triples, *found.base] for name in triple]
    stated = sheet.units.get(names[0]) or "mm"
    points = sheet.rows_of(names).reshape(len(sheet.numbers), -1, 3) * LENGTH[stated if unit == "file" else unit]
    rest = _rest(sheets, found, sheet, points)
    base = rest[len(triples) :].mean(axis=0) if found.base else None
    body = rest[: len(triples)]
    body = body[np.isfinite(body).all(axis=1)]
    along = rest_axis(body, base)
    if along is None or np.abs(along).max() < 0.8:
        found.unknown.append(
            "the frame: the markers at rest lie along no axis of the log; set frame.origin_mm and axes"
        )
        return []
    k = int(np.argmax(np.abs(along)))
    sign = 1 if along[k] > 0 else -1
    towards = f"{'-' if sign < 0 else '+'}{'xyz'[k]}"
    found.assumed.append(f"frame: at rest the robot runs along {towards} of the log, so that is z of its base frame")
    if base is not None:
        origin, why = base, "the middle of the markers on the clamp"
    elif len(body) > 1:
        origin, why = _clamp(body, k, sign)
    elif abs(along[k]) > 0.95:
        origin, why = np.zeros(3), "the origin of the log, for the marker at rest lies on its axis"
    else:
        origin, why = np.zeros(3), "the origin of the log, for want of anything better"
    found.unknown.append(
        f"where the clamp is: {why} is taken; measure it, or let `softmap align` find it; and how the robot is "
        "mounted: gravity is not declared"
    )
    axes = ", ".join(f'"{axis}"' for axis in axes_for(k, sign))
    place = ", ".join(f"{x:.1f}" for x in origin + 0.0)
    return [
        "",
        "[frame]",
        f"origin_mm = [{place}]   # ASSUMED: {why}",
        f"axes = [{axes}]   # the robot runs along {towards} of the log",
    ]


def _clamp(body: Array, k: int, sign: int) -> tuple[Array, str]:
    """Where the clamp may be, of markers (M, 3) along axis k, and why there."""
    chord = body[-1] - body[0]
    step = float(np.linalg.norm(chord)) / (len(body) - 1)
    beside = np.linalg.norm(np.cross(body - body[0], chord / np.linalg.norm(chord)), axis=1)
    if beside.max() < 0.5 * step:  # a chain
        origin = body[0].copy()
        origin[k] -= sign * step
        return origin, "one marker spacing before the first marker"
    origin = body.mean(axis=0)
    origin[k] = sign * float((sign * body[:, k]).min())
    return origin, "the middle of the markers, level with the first of them along the robot"


def _rest(sheets: list[Sheet], found: _Found, sheet: Sheet, points: Array) -> Array:
    """The (M, 3) places nearest to home."""
    if found.command is None:
        return at_rest(np.zeros(1), np.zeros(1), None, points)
    other, role = found.command
    t, seen = (_seconds(sheets, found, which) for which in (other, sheet))
    rows = other.rows_of(role.columns)
    good = np.isfinite(rows).all(axis=1) & np.isfinite(t)
    shown = np.isfinite(seen)
    return at_rest(t[good], seen[shown], rows[good], points[shown])


def _seconds(sheets: list[Sheet], found: _Found, sheet: Sheet) -> Array:
    name, unit = found.times[next(k for k, other in enumerate(sheets) if other is sheet)]
    values = np.arange(len(sheet.numbers), dtype=float) if name is None else sheet.column(name)
    return values * (1.0 / RATE_HZ if unit == "rows" else TIME[unit])


# --- the text ------------------------------------------------------------------------------
def _write(sheets: list[Sheet], files: list[Path], found: _Found) -> str:
    lines = [f'schema = "{SCHEMA}"', '# robot = "…"   # a name']
    unit = found.command[1].unit if found.command is not None else None
    if unit in ANGLE:
        lines.append(f'command_unit = "{unit}"')
    if any(_since_1970(sheet, *found.times[k]) for k, sheet in enumerate(sheets)):
        lines.append("zero_time = true   # the log counts since 1970")
    for k, sheet in enumerate(sheets):
        inside = _inside(sheet, found)
        if inside:
            lines += ["", "[[log]]", *_head(sheet, len(files)), _time(sheet, *found.times[k]), *inside]
    if found.points is not None:
        lines += _frame(sheets, found)
        sheet = found.points[0]
        t = _seconds(sheets, found, sheet)
        rate = (len(t) - 1) / max(float(t[-1] - t[0]), 1e-9)
        if len(t) > MANY and rate > 1.2 * SEEN_HZ:
            lines += ["", "[seen]", f"rate_hz = {SEEN_HZ}   # enough for a diagnosis; leave it out to keep every frame"]
        if found.label is None:
            lines += ["", "[blocks]", "count = 5   # folds of equal time; a column of labels (block = …) is better"]
        lines += ["", "[constant]", "# gravity = [0.0, 0.0, 1.0]   # UNKNOWN: hanging (0, 0, 1), standing (0, 0, -1)"]
        lines += [
            "# sigma_mm = 0.1   # noise of a marker coordinate, if you know it",
            "# load_g = 0.0   # known mass at the tip",
        ]
    return "\n".join(lines) + "\n"


def _since_1970(sheet: Sheet, name: str | None, unit: str) -> bool:
    return name is not None and unit in TIME and float(np.nanmax(np.abs(sheet.column(name)))) * TIME[unit] > 1e8


def _head(sheet: Sheet, files: int) -> list[str]:
    lines = [f"file = {json.dumps(sheet.path.name)}"] if files > 1 else []
    lines += [] if sheet.topic is None else [f"topic = {json.dumps(sheet.topic, ensure_ascii=False)}"]
    return lines + ([] if sheet.header else ["header = false   # columns are numbers from 0"])


def _time(sheet: Sheet, name: str | None, unit: str) -> str:
    if name is None:
        return f"time = {{ rate_hz = {RATE_HZ} }}   # UNKNOWN: the rate of the log"
    cell = _cell(sheet, name)
    if unit == "rows":
        return f"time = {{ column = {cell}, rate_hz = {RATE_HZ} }}   # it counts rows; UNKNOWN: their rate"
    values = sheet.column(name)
    same = (np.diff(values[np.isfinite(values)]) == 0).mean() if len(values) > 1 else 0.0
    again = ', repeated = "spread"' if same > 0.05 else ', repeated = "drop"' if same > 0 else ""
    return f'time = {{ column = {cell}, unit = "{unit}"{again} }}'


def _cell(sheet: Sheet, name: str) -> str:
    """A column as the mapping names it: by number where there is no header, or where the name is there twice."""
    if not sheet.header or sheet.names.count(name) > 1:
        return str(sheet.names.index(name))
    return json.dumps(name, ensure_ascii=False)


def _inside(sheet: Sheet, found: _Found) -> list[str]:
    lines = []
    for kind, pair in (
        ("command", found.command),
        ("present", found.present),
        *((r.kind, (s, r)) for s, r in found.others),
    ):
        if pair is not None and pair[0] is sheet:
            unit = pair[1].unit
            key = f"present_{unit}".removeprefix("present_" * (kind == "command")) if unit == "ticks" else kind
            told = f', unit = "{unit}"' if unit and unit != "ticks" else ""
            lines.append(f"{key} = {{ columns = [{', '.join(_cell(sheet, c) for c in pair[1].columns)}]{told} }}")
    if found.points is not None and found.points[0] is sheet:
        _, triples, unit = found.points
        for kind, places in (("markers", triples), ("base", found.base)):
            rows = [f"    [{', '.join(_cell(sheet, name) for name in triple)}]," for triple in places]
            lines += [f'{kind} = {{ unit = "{unit}", columns = [', *rows, "] }"] if rows else []
        lines += [] if found.label is None else [f"block = {_cell(sheet, found.label)}"]
    return lines
