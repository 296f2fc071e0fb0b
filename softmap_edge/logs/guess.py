"""Propose a mapping for logs without one; report its assumptions and what the logs do not show.

Header and ranges identify time, commands, encoders, markers and labels, and their units. The
markers at rest show which axis of the log is the robot's, and where its clamp may be. A log does
not show the rate of a counter, the spool, gravity and the position of the clamp: the proposal
contains assumptions to be replaced. The proposal is then imported, and the answer includes the
result. Pinned by tests/logs/test_guess.py.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.files.atomic import Document
from softmap_edge.files.printable import listed, plain_line
from softmap_edge.logs.drive_roles import drives_of, switches_of
from softmap_edge.logs.fills import unread_ticks
from softmap_edge.logs.guess_columns import TRACKED, Role, drive_unit, roles_of
from softmap_edge.logs.guess_parts import joined_parts
from softmap_edge.logs.guess_points import find_points, places_of
from softmap_edge.logs.guess_sheets import Sheet, read_sheets
from softmap_edge.logs.guess_text import Found, mapping_text, seconds
from softmap_edge.logs.guess_time import RATE_HZ, time_of
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.left_out import no_role
from softmap_edge.logs.lerobot import EITHER_UNIT
from softmap_edge.logs.mapping import (
    ANGLE,
    CONDITIONS,
    LENGTH,
    UNITS,
    parse_mapping,
)
from softmap_edge.logs.plausible import at_rest, axes_for, rest_axis
from softmap_edge.logs.sensor_errors import never_read
from softmap_edge.logs.table import header_hint
from softmap_edge.logs.text_columns import text_columns
from softmap_edge.logs.triples import LeftOut

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Guess:
    """A proposed mapping.

    Attributes:
        text: the mapping, with comments.
        assumed: sentences on the assumptions.
        unknown: sentences on what a log does not show.
        said: the result of importing with the proposal: notes, doubts, or the error.
    """

    text: str
    assumed: tuple[str, ...]
    unknown: tuple[str, ...]
    said: tuple[str, ...]

    def __post_init__(self) -> None:
        for name in ("assumed", "unknown", "said"):  # they quote names of files and columns
            object.__setattr__(self, name, tuple(map(plain_line, getattr(self, name))))

    def __str__(self) -> str:
        return self.text

    def to_dict(self) -> Document:
        """Return it as a document softmap.guess/1."""
        found = {
            "assumed": list(self.assumed),
            "unknown": list(self.unknown),
            "said": list(self.said),
        }
        return {"schema": "softmap.guess/1", "mapping": self.text, **found}


def guess_mapping(paths: Sequence[str | os.PathLike[str]]) -> Guess:
    """Propose a mapping for logs.

    Args:
        paths: the logs of one recording, of any format that `softmap import` reads.

    Raises:
        RunError: a file cannot be read, or no column resembles commands or markers.
    """
    files = [Path(path) for path in paths]
    found = Found()
    sheets, found.assumed, apart = joined_parts(read_sheets(files))
    rows = max((len(sheet.numbers) for sheet in sheets), default=0)
    if rows < 2:
        names = ", ".join(path.name for path in files)
        raise RunError(
            f"{names}: {rows} row{'s' * (rows != 1)} of numbers; give the log of a complete "
            "recording"
        )
    for k, sheet in enumerate(sheets):
        if not sheet.header:
            found.assumed.append(
                f"columns of {sheet.called}: no line names them, so they are numbers from 0"
            )
        if sheet.why:
            lines = found.unknown if sheet.pivot is None else found.assumed
            lines.append(f"rows of {sheet.called}: {sheet.why}")
        found.unknown += _several_bodies(sheet)
        time = found.times[k] = time_of(sheet, alone=len(sheets) == 1)
        found.assumed.append(f"time of {sheet.called}: {time.why}")
        found.unknown += [time.doubt] if time.doubt else []
        if time.unit == "rows":
            what = (
                f"how fast '{time.columns[0]}' counts"
                if time.columns
                else "how fast rows were logged"
            )
            found.unknown.append(
                f"{what} in {sheet.called}: {RATE_HZ} Hz is written; put the rate of the log there"
            )
        elif time.unit == "none":
            found.unknown.append(
                f'how fast rows were logged in {sheet.called}: time = "none" is written, and '
                "nothing about rates or "
                "delays can be learned; write time = { rate_hz = … } if you know the rate"
            )
    find_points(sheets, found)
    _find_drives(sheets, found)
    if found.points is None and found.command is None:
        raise _nothing_found(sheets)
    found.unknown += [
        line
        for sheet, time in zip(sheets, found.times.values())
        for line in _left_out(sheet, time.columns, found)
    ]
    if any(sheet.episode is not None for sheet in sheets):
        found.unknown.append(EITHER_UNIT)
    frame = [] if found.points is None else _frame(sheets, found)
    text = mapping_text(sheets, found, frame)
    head = [
        f"# Proposed from the header and the ranges of {', '.join(path.name for path in files)}; "
        "read every line."
    ]
    head += [f"# ASSUMED  {line}" for line in found.assumed] + [
        f"# UNKNOWN  {line}" for line in found.unknown
    ]
    text = "\n".join([*map(plain_line, head), text])
    return Guess(text, tuple(found.assumed), tuple(found.unknown), (*apart, *_tried(files, text)))


def _nothing_found(sheets: list[Sheet]) -> RunError:
    """Return the error that no column is named like a command or a marker."""
    seen = "; ".join(
        f"{sheet.called}: {', '.join(map(_range_of(sheet), sheet.names))}" for sheet in sheets
    )
    seen = seen if len(seen) <= 600 else f"{seen[:600].rpartition(', ')[0] or seen[:600]} …"
    hint = next((hint for sheet in sheets if (hint := header_hint(sheet.head_line))), "")
    return RunError(
        f"no column looks like a command or a marker by its name ({seen}){hint}; write the "
        "mapping by hand: docs/reference/mapping.md lists its keys, examples/trunk.toml shows "
        "the form"
    )


def _tried(files: list[Path], text: str) -> tuple[str, ...]:
    try:
        done = import_logs(files, parse_mapping(text, Path("proposal")))
    except RunError as fault:
        return (f"as it stands it cannot be imported: {fault}",)
    return (*done.notes, *(f"look at: {doubt}" for doubt in done.doubts))


def _several_bodies(sheet: Sheet) -> list[str]:
    """Return the question which body is the robot, if rows of several follow each other."""
    return [
        f"which body is the robot: '{name}' of {sheet.called} holds {listed(bodies, 3)}, each in "
        "rows of its own; keep the rows of one, or export one column for each coordinate of each"
        for name, texts in sheet.texts.items()
        if TRACKED.fullmatch(name) and len(bodies := list(dict.fromkeys(filter(None, texts)))) > 1
    ]


def _left_out(sheet: Sheet, time: tuple[str, ...], found: Found) -> list[str]:
    """List the columns that vary but are not part of the run."""
    used = {*time, found.label} | {
        c for pair in found.others if pair[0] is sheet for c in pair[1].columns
    }
    used |= {
        c
        for pair in (found.command, found.present)
        if pair and pair[0] is sheet
        for c in pair[1].columns
    }
    used |= {name for other, one in found.left if other is sheet for name in one.columns}
    if found.points is not None and found.points[0] is sheet:
        used |= {name for triple in [*found.points[1], *found.base] for name in triple}
        used |= {*found.likelihood.values()}
    varies = [
        name
        for name in sheet.names
        if np.unique(sheet.column(name)[np.isfinite(sheet.column(name))]).size > 1
    ]
    left = [name for name in varies if name not in used]
    own = text_columns(sheet.called, sheet.texts, used, [name for name in varies if name in used])
    if not left:
        return own
    named = listed(map(_range_of(sheet), left), 6)
    return [
        f"what these columns of {sheet.called} are: {named}; they are left out, add them if the "
        "run needs them",
        *own,
    ]


def _range_of(sheet: Sheet) -> Callable[[str], str]:
    def described(name: str) -> str:
        values = sheet.column(name)
        values = values[np.isfinite(values)]
        return (
            f"{name} ({values.min():.4g} to {values.max():.4g})"
            if len(values)
            else f"{name} (text)"
        )

    return described


# --- the drives ----------------------------------------------------------------------------
def _find_drives(sheets: list[Sheet], found: Found) -> None:
    spent = {id(sheet): set(found.times[k].columns) for k, sheet in enumerate(sheets)}
    for other, left in found.left:
        spent[id(other)] |= set(left.columns)
    if found.points is not None:
        sheet, triples, _ = found.points
        spent[id(sheet)] |= {name for triple in [*triples, *found.base] for name in triple}
        spent[id(sheet)] |= {*found.likelihood.values(), found.label or ""}
    roles = [(sheet, role) for sheet in sheets for role in roles_of(sheet, spent[id(sheet)])]
    for sheet, role in roles:
        if role.kind != "load":
            sheet.drop_fills(role.columns)
    commands, presents, no_drives = drives_of(roles)
    found.left += no_drives
    found.unknown += [no_role(sheet.called, one) for sheet, one in no_drives]
    if commands:
        found.command = commands[0]
    elif presents:
        found.command = presents.pop(0)
        found.assumed.append(
            "commands: no column is named so; the encoder positions are taken for them"
        )
    if found.command is None:
        found.unknown.append(
            "what was commanded: nothing is named so; effects of the drive cannot be identified"
        )
        return
    width = len(found.command[1].columns)
    fits = [pair for pair in presents if len(pair[1].columns) == width]
    found.present = fits[0] if fits else None
    sheet, role = found.command
    found.assumed.append(
        f"commands: {width} columns of {sheet.called}, {role.why}, in the order of the file"
    )
    if not role.sure and found.present is None:
        found.assumed.append(
            "commands: the log does not state whether they are goals or positions that the servos "
            "read; either works"
        )
    if found.present is not None:
        found.assumed.append(
            f"encoders: {width} columns of {found.present[0].called}, {found.present[1].why}"
        )
    for key, pair in (("command", found.command), ("present", found.present)):
        if pair is not None and (names := switches_of(pair)):
            found.unknown.append(
                f"whether `{key}` holds flags: only 0 and 1 in {listed(names, 4)} of "
                f"{pair[0].called}, as a flag or a switch has; take out what is one"
            )
    _find_others(roles, width, found)
    _drive_units(found)


def _find_others(roles: list[tuple[Sheet, Role]], width: int, found: Found) -> None:
    """Add currents, one for each of `width` channels, and conditions; report what is left out."""
    for sheet, role in roles:
        if role.kind in {other.kind for _, other in found.others}:
            continue  # a run holds one of each; it is listed among the columns that are left out
        one = role.kind in CONDITIONS and len(role.columns) == 1
        if not one and not (role.kind == "current" and len(role.columns) == width):
            continue
        named = f"{', '.join(role.columns)} of {sheet.called}"
        why = never_read(role.kind, role.unit, sheet.rows_of(role.columns)) if one else None
        if switches_of((sheet, role)):
            why = "only 0 and 1, as a flag or a switch is"
        if why is not None:
            found.left.append((sheet, LeftOut(tuple(role.columns), why)))
            found.unknown.append(f"the {role.kind}: {named} is {why}, and is left out")
            continue
        found.others.append((sheet, role))
        found.assumed.append(f"{role.kind}: {named} by name")
        if role.stated is not None:
            found.unknown.append(
                f"the unit of the {role.kind}: the log states '{role.stated}', which is not a unit "
                f"of it in this program: {UNITS[role.kind][0]} is taken; give scale and offset"
            )


def _drive_units(found: Found) -> None:
    """Set the units of commands and encoders; a certain unit also applies to similar motion."""
    assert found.command is not None
    drives = [("commands", found.command)] + (
        [] if found.present is None else [("encoders", found.present)]
    )
    answers = [
        (role.stated, "the log states it", True)
        if role.stated is not None
        else drive_unit(sheet.rows_of(role.columns), role.unit, role.joint)
        for _, (sheet, role) in drives
    ]
    moved = [float(np.median(_spread(sheet.rows_of(role.columns)))) for _, (sheet, role) in drives]
    together = len(drives) == 2 and moved[0] > 0 and 0.5 < moved[1] / moved[0] < 1.5
    if len(answers) == 2 and answers[0][2] != answers[1][2]:
        firm = 0 if answers[0][2] else 1
        if together:
            why = (
                f"encoders move {moved[1] / moved[0]:.2f} times as far as commands, so the unit "
                "is the same"
            )
            answers[1 - firm] = (answers[firm][0], why, True)
    if len(answers) == 2 and not _alike(answers[0][0], answers[1][0]):
        apart = any(role.joint for _, (_, role) in drives) and not together
        if (answers[0][2] and answers[1][2]) or apart:
            found.present = None
            found.unknown.append(
                f"the radius of the spools: encoders are in {answers[1][0]}, commands in "
                f"{answers[0][0]}; the encoders are left out, give them with spool_radius_mm"
            )
        else:
            loose = 0 if answers[1][2] or drives[1][1][1].joint or not moved[0] else 1
            answers[loose] = (answers[1 - loose][0], f"as the {drives[1 - loose][0]}", False)
    for (kind, (_, role)), (unit, why, sure) in zip(drives, answers[: 2 if found.present else 1]):
        role.unit = unit
        found.assumed.append(f"{kind}: in {unit}; {why}")
        if not sure:
            found.unknown.append(f"the unit of the {kind}: {unit} is only likely")
    unit = answers[0][0]
    if unit not in UNITS["command"]:
        found.unknown.append(
            f"the unit of the commands: the log states '{unit}', which is not a unit of commands "
            "in this program: commands stay as they are, and every figure about the drive carries "
            "this unit. With unit and scale, and without command_unit, they are mm of tendon"
        )
    if unit == "ticks":
        found.unknown.append(_home_in_ticks(found.command[0].rows_of(found.command[1].columns)))
    if unit in ANGLE:
        found.unknown.append(
            f"the radius of the spools: commands stay {unit}; with spool_radius_mm, and without "
            "command_unit, they are mm of tendon, which a simulated finger needs"
        )


def _home_in_ticks(rows: Array) -> str:
    """Return the remark that no log contains home, and how to declare it."""
    rows = np.where(unread_ticks(rows), np.nan, rows)
    low, high = np.nanmin(rows, axis=0), np.nanmax(rows, axis=0)
    middle = ", ".join(f"{-m:.0f}" for m in 0.5 * (low + high))
    return (
        "home: the ticks at which the robot rests. Effects such as gain, play and slack count "
        f"from there. The middle of each range is taken, as with offset = [{middle}]; if the "
        "robot rests at other commands, give offset of command"
    )


def _alike(one: str, other: str) -> bool:
    """Return whether two units measure the same quantity."""
    kinds: tuple[Container[str], ...] = (LENGTH, ANGLE, ("ticks",))
    return one == other or any(one in kind and other in kind for kind in kinds)


def _spread(rows: Array) -> Array:
    return np.asarray(np.nanmax(rows, axis=0) - np.nanmin(rows, axis=0))


# --- the frame -----------------------------------------------------------------------------
def _frame(sheets: list[Sheet], found: Found) -> list[str]:
    """Return the lines of [frame]: the robot's axis at rest is z; where the clamp may be."""
    assert found.points is not None
    sheet, triples, unit = found.points
    names = [name for triple in [*triples, *found.base] for name in triple]
    stated = sheet.units.get(names[0]) or "mm"
    points = places_of(sheet, [*triples, *found.base]) * LENGTH.get(
        stated if unit == "file" else unit, 1.0
    )
    points *= np.array([[found.scales.get(one[0], 1.0)] for one in [*triples, *found.base]])
    rest = _rest(sheets, found, sheet, points)
    base = rest[len(triples) :].mean(axis=0) if found.base else None
    body = rest[: len(triples)]
    body = body[np.isfinite(body).all(axis=1)]
    along = rest_axis(body, base)
    if along is None or np.abs(along).max() < 0.8:
        found.unknown.append(
            "the frame: the markers at rest lie along no axis of the log; set frame.origin_mm and "
            "axes"
        )
        return []
    k = int(np.argmax(np.abs(along)))
    sign = 1 if along[k] > 0 else -1
    towards = f"{'-' if sign < 0 else '+'}{'xyz'[k]}"
    found.assumed.append(
        f"frame: at rest the robot runs along {towards} of the log, so that is z of its base frame"
    )
    if base is not None:
        origin, why = base, "the middle of the markers on the clamp"
    elif len(body) > 1:
        origin, why = _clamp(body, k, sign)
    elif abs(along[k]) > 0.95:
        origin, why = np.zeros(3), "the origin of the log, for the marker at rest lies on its axis"
    else:
        origin, why = np.zeros(3), "the origin of the log, since the markers do not show the clamp"
    or_find = (
        ", or let `softmap run align` find it"
        if len(names) == 3 * (len(triples) + len(found.base))
        else ""
    )
    found.unknown.append(
        f"where the clamp is: {why} is taken; measure it{or_find}; and how the robot is mounted: "
        "gravity is not declared"
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
    """Return the possible clamp position for markers (M, 3) along axis k, and the reason."""
    chord = body[-1] - body[0]
    step = float(np.linalg.norm(chord)) / (len(body) - 1)
    aside = np.linalg.norm(np.cross(body - body[0], chord / np.linalg.norm(chord)), axis=1)
    if aside.max() < 0.5 * step:  # a chain
        origin = body[0].copy()
        origin[k] -= sign * step
        return origin, "one marker spacing before the first marker"
    origin = body.mean(axis=0)
    origin[k] = sign * float((sign * body[:, k]).min())
    return origin, "the middle of the markers, level with the first of them along the robot"


def _rest(sheets: list[Sheet], found: Found, sheet: Sheet, points: Array) -> Array:
    """Return the positions (M, 3) nearest to home."""
    if found.command is None:
        return at_rest(np.zeros(1), np.zeros(1), None, points)
    other, role = found.command
    t, seen = (seconds(sheets, found, which) for which in (other, sheet))
    rows = other.rows_of(role.columns)
    good = np.isfinite(rows).all(axis=1) & np.isfinite(t)
    shown = np.isfinite(seen)
    return at_rest(t[good], seen[shown], rows[good], points[shown])
