"""Convert the logs of any robot to a run with a small TOML mapping (columns, units, axes, rates).

`read_mapping(path)` checks the mapping. `import_logs(paths, mapping)` returns the run, with a
sentence for each change and each suspicious finding. Several logs are joined by time. The rows of
the log with the commands become the rows of the run. Other recorded signals are interpolated to
their times; frames keep their own times. A row without a command is left out, because commands are
linear between rows. A missing cell in another column is interpolated. Pinned by
tests/test_import*.py; docs/reference/mapping.md lists the keys.
"""

from __future__ import annotations

import fnmatch
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import RunError, differing_times
from softmap_edge.files.atomic import Document, sha256_of
from softmap_edge.files.mcap_records import Damage
from softmap_edge.files.printable import listed, plain_line
from softmap_edge.logs.clock import corrected
from softmap_edge.logs.column_roles import doubts_of_roles
from softmap_edge.logs.coverage import doubts_of_pauses
from softmap_edge.logs.frames import choose_frames, seen
from softmap_edge.logs.held import unhold
from softmap_edge.logs.mapping import ANGLE, CONDITIONS, LENGTH, Mapping, Quantity, read_mapping
from softmap_edge.logs.mixed_units import drives_question
from softmap_edge.logs.other_units import doubts_of_units
from softmap_edge.logs.plausible import (
    doubts_of_base,
    doubts_of_both,
    doubts_of_frozen,
    doubts_of_rows,
    doubts_of_time,
    doubts_of_unread,
)
from softmap_edge.logs.recorded import check_frames, doubts_of_lists, on_one_clock
from softmap_edge.logs.sensor_errors import without_errors
from softmap_edge.logs.sources import assign, named, open_parts, parts_of
from softmap_edge.logs.table import LogTable, read_log
from softmap_edge.logs.time_names import is_time_name
from softmap_edge.logs.unwrap import counted_on
from softmap_edge.run.fields import ROW_S
from softmap_edge.run.plane import AXES, PLANE
from softmap_edge.run.rollover import DRIVES
from softmap_edge.run.run import DAMAGE, NO_COMMANDS, NOT_SEEN, SPOOL_RADIUS, Run

__all__ = ["Imported", "Mapping", "import_logs", "read_mapping", "unhold"]

Array = NDArray[np.float64]
_TO_SI = {"g": 1.0, "kg": 1000.0, "N": 1000.0 / _core.STANDARD_GRAVITY, "mA": 1.0, "A": 1000.0}


@dataclass(frozen=True)
class Imported:
    """A run, with sentences on each change, suspicious finding and damage of its logs."""

    run: Run
    notes: tuple[str, ...]
    doubts: tuple[str, ...] = ()
    damage: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("notes", "doubts", "damage"):  # they quote names of files and columns
            object.__setattr__(self, name, tuple(map(plain_line, getattr(self, name))))


def import_logs(paths: Sequence[str | os.PathLike[str]], mapping: Mapping) -> Imported:
    """Read logs with a mapping; issue a `RecordingWarning` for each damaged or truncated log.

    Args:
        paths: the logs, or folders of a recording; the mapping identifies them by name.
        mapping: from `read_mapping`.

    Raises:
        RunError: a file, a column or a value does not match the mapping; the message states the
            remedy.
    """
    notes: list[str] = []
    doubts: list[str] = []
    parts = parts_of([Path(path) for path in paths])
    notes += [note for part in parts for note in part.notes]
    mapping, logs = assign(parts, mapping)
    with named(parts):
        opened = [open_parts(one.parts, log) for one, log in zip(logs, mapping.logs)]
        for one, log, columns in zip(logs, mapping.logs, opened):
            found = [*check_frames(log, columns), *doubts_of_lists(log, columns)]
            doubts += [f"{one.label}: {doubt}" for doubt in found]
        clocks = on_one_clock(mapping.logs, opened)
        mapping = replace(mapping, logs=clocks.logs)
        notes += clocks.notes
        doubts += clocks.doubts
        tables = [read_log(one.path, log, opened.pop(0)) for one, log in zip(logs, mapping.logs)]
    damage = tuple(
        dict.fromkeys(note for table in tables for note in table.notes if isinstance(note, Damage))
    )
    for one, table, log in zip(logs, tables, mapping.logs):
        notes += [f"{one.label}: {note}" for note in table.notes if not isinstance(note, Damage)]
        found = [*table.doubts, *doubts_of_roles(table.names, log)]
        doubts += [f"{one.label}: {doubt}" for doubt in found]
    fields: Document = _timeless(mapping, notes)
    if fields:
        doubts += [
            f"{one.label}: {doubt}"
            for one, table in zip(logs, tables)
            for doubt in _unused_time(table.names)
        ]
    else:
        doubts += [
            f"{one.label}: {doubt}"
            for one, table in zip(logs, tables)
            for doubt in doubts_of_time(table.t)
        ]
    t = _command_rows(tables, mapping, fields, notes, doubts)
    doubts += doubts_of_both(fields)
    doubts += [] if t is None or "timeless" in fields else doubts_of_frozen(t, fields)
    t_seen = seen(tables, mapping, t, fields, notes, doubts)
    if t is None and t_seen is None:
        raise RunError(
            f"{mapping.path}: names neither commands nor markers nor outputs; give at least one "
            "of them"
        )
    doubts += [f"command: no column; {NO_COMMANDS}"] if t is None else []
    t = t_seen if t is None else t
    assert t is not None
    del tables  # frees half of the memory of a long log
    t, fields = _resample_commands(t, fields, mapping, notes)
    if t_seen is not None:
        t_seen = _frames_clock(t, t_seen, mapping, notes)
        _rest(t_seen, fields, mapping, notes)
        t_seen = choose_frames(t, t_seen, fields, mapping, notes)
        fields["t_seen"] = t_seen
        doubts += [] if "output" in fields else doubts_of_base(t, t_seen, fields, mapping)
    if mapping.zero_time:
        zero = t[0]
        t = t - zero
        if t_seen is not None:
            fields["t_seen"] = t_seen - zero
        notes.append(
            f"time counts from {differing_times(zero, float(t[-1]) + zero)[0]} s of the log"
        )
    files = list(dict.fromkeys(part.path for one in logs for part in one.parts))
    _constants(files, mapping, fields, notes)
    made_from = [f"{path.name} sha256 {sha256_of(path)}" for path in files]
    extra = {
        name: fields.pop(name)
        for name in ("base_markers", "marker_labels", PLANE)
        if name in fields
    }
    extra |= _looked_for(mapping, fields) | _spool(mapping)
    extra |= {DAMAGE: np.array("; ".join(damage))} if damage else {}
    try:
        run = Run(t=t, **fields, extra={"made_from": np.array(made_from)} | extra)
    except RunError as fault:
        name = str(fault).split(":")[0]
        # the likely fault of the mapping
        suspicion = next((doubt for doubt in doubts if f"{name}: " in doubt), None)
        raise RunError(f"{fault}; {suspicion}" if suspicion else str(fault)) from None
    return Imported(run, tuple(dict.fromkeys(notes)), tuple(doubts), damage)


def _spool(mapping: Mapping) -> dict[str, Array]:
    """Return the radius (mm) of the spools that convert angles to commands, for the run to keep.

    {} without a spool.
    """
    commands = [log.rows["command"] for log in mapping.logs if "command" in log.rows]
    radii = {
        one.spool_radius_mm
        for one in commands
        if one.unit in ANGLE and np.all(np.abs(one.scale) == 1.0)
    }
    known = mapping.command_unit == "mm" and len(radii) == len({one.unit for one in commands}) == 1
    return {SPOOL_RADIUS: np.array(radii.pop())} if known else {}


def _looked_for(mapping: Mapping, fields: Document) -> dict[str, NDArray[np.generic]]:
    """Return the field on the search for places that stand for "not seen": done, or off."""
    if "markers" not in fields:
        return {}
    kept = any(
        seen is not None and seen.not_seen is None
        for log in mapping.logs
        for seen in (log.markers, log.output)
    )
    return {NOT_SEEN: np.array("keep" if kept else "checked")}


def _timeless(mapping: Mapping, notes: list[str]) -> Document:
    """Return the field of a run whose log has no time.

    Raise RunError if times would be needed to join logs.
    """
    if not any(log.clock.timeless for log in mapping.logs):
        return {}
    if len(mapping.logs) > 1:
        raise RunError(
            f'{mapping.path}: time = "none" and {len(mapping.logs)} logs: only time could join them'
        )
    asked = {
        "commands.rate_hz": mapping.command_rate_hz,
        "seen.rate_hz": mapping.seen_rate_hz,
        "seen.from_s": mapping.from_s,
        "seen.to_s": mapping.to_s,
        "seen.fast_ppm": mapping.fast_ppm or None,
        "seen.clock_step": mapping.clock_step,
        "blocks.seconds": mapping.block_seconds,
        "constant.marker_rest_s": mapping.marker_rest_s,
    }
    named = [key for key, value in asked.items() if value is not None]
    if named:
        raise RunError(
            f'{mapping.path}: {", ".join(named)} in a mapping with time = "none": a log without '
            "time has rows only; "
            "leave one of them out (from_row and to_row cut it, blocks.count divides it)"
        )
    notes.append(
        "the log has no time: rows count, and nothing about rates or delays can be learned from it"
    )
    return {"timeless": True}


def _unused_time(names: Sequence[str]) -> list[str]:
    """Return the doubt that a log declared to have no time has columns named like time."""
    times = [name for name in names if is_time_name(name)]
    if not times:
        return []
    return [
        f't: time = "none" is declared, but columns are called {listed(times, 4)}: they are not '
        "used, and nothing "
        "about rates or delays is identified; name one in `time` if it holds the time"
    ]


# --- the rows of the run -------------------------------------------------------------------
def _command_rows(
    tables: list[LogTable],
    mapping: Mapping,
    fields: Document,
    notes: list[str],
    doubts: list[str],
) -> Array | None:
    """Return the times of the commands; add everything sampled at them to `fields`."""
    owners = [k for k, log in enumerate(mapping.logs) if {"command", "ticks"} & set(log.rows)]
    if len(owners) > 1:
        raise RunError(
            f"{mapping.path}: {len(owners)} logs hold commands; name the columns of one of them "
            "only"
        )
    named = [name for log in mapping.logs for name in log.rows]
    if twice := next((name for name in named if named.count(name) > 1), None):
        raise RunError(
            f"{mapping.path}: {named.count(twice)} logs hold {twice}; name the columns of one of "
            "them only"
        )
    t: Array | None = None
    for k in owners:
        goals = [
            quantity
            for name, quantity in mapping.logs[k].rows.items()
            if name in ("command", "ticks")
        ]
        rows = np.hstack([tables[k].numbers(quantity.columns) for quantity in goals])
        given = np.asarray(np.isfinite(rows).all(axis=1))
        if not given.any():
            raise RunError(
                f"{tables[k].path}: no row has all commands; name in `command` the columns of one "
                "publisher, which stand in one row"
            )
        if not given.all():
            notes.append(
                f"{int((~given).sum())} of {len(given)} rows have no command and were left out"
            )
        t = tables[k].t[given]
    for k, log in enumerate(mapping.logs):
        for name, quantity in log.rows.items():
            raw = (
                without_errors(name, tables[k], quantity, notes, doubts)
                if name in CONDITIONS
                else counted_on(name, tables[k], quantity, notes, doubts)
            )
            own, values = _filled(name, tables[k], raw)
            other = doubts_of_units(name, tables[k], quantity)
            question = None if other else _mixed(name, tables[k], quantity, values)
            if question is not None:
                raise RunError(f"{tables[k].path}: {question}")
            doubts += other or doubts_of_rows(name, values, quantity)
            doubts += doubts_of_unread(name, values, quantity)
            values = _convert(name, values, quantity, mapping)
            if quantity.held != "keep":
                values, held = unhold(own, values)
                if held.hold_s:
                    beat = f"every {held.hold_s / ROW_S:.0f} rows" if "timeless" in fields else None
                    notes.append(
                        f"{name}: {held.text(beat)}: un-held by straight lines between new values"
                    )
                elif quantity.held == "unhold":
                    notes.append(f"{name}: no held samples found")
            if t is not None and "timeless" not in fields and name not in ("command", "ticks"):
                doubts += doubts_of_pauses(name, t, own)
            column = values if t is None or np.array_equal(t, own) else _interpolate(t, own, values)
            if name in CONDITIONS:
                fields[name] = column[:, 0]
            else:
                fields[name] = np.rint(column) if "ticks" in name else column
    if t is None and set(fields) - {"timeless"}:
        raise RunError(
            f"{mapping.path}: {', '.join(fields)} without commands; name the columns of `command` "
            "or `ticks` as well"
        )
    return t


def _mixed(name: str, table: LogTable, quantity: Quantity, values: Array) -> str | None:
    """Return what to ask about drives (T, C) in different units; None if there is no question."""
    if name not in DRIVES or quantity.scaled:
        return None
    return drives_question(name, values, [table.name(column) for column in quantity.columns])


def _filled(name: str, table: LogTable, values: Array) -> tuple[Array, Array]:
    """Return the rows with a value in some column, with missing cells interpolated linearly."""
    some = np.asarray(np.isfinite(values).any(axis=1))
    empty = np.asarray(~np.isfinite(values).any(axis=0))
    if empty.any():
        column = int(np.argmax(empty)) + 1
        raise RunError(
            f"{table.path}: {name}: its column {column} holds no value at all; leave it out"
        )
    t = table.t
    if not some.all():
        t, values = t[some], values[some]
    for c in np.flatnonzero(np.isnan(values).any(axis=0)):
        known = np.isfinite(values[:, c])
        values[:, c] = np.interp(t, t[known], values[known, c])
    return t, values


@np.errstate(invalid="ignore")  # a signalling NaN of a damaged file counts as NaN
def _convert(name: str, values: Array, quantity: Quantity, mapping: Mapping) -> Array:
    """Return values in our units, changed in place: they are most of the memory of a long log."""
    unit = quantity.unit
    if name in ("command", "present"):
        if mapping.command_unit != "mm":
            if unit == "rad" and mapping.command_unit == "deg":
                values *= 180.0 / np.pi
            elif unit == "deg" and mapping.command_unit == "rad":
                values *= np.pi / 180.0
        elif unit in LENGTH:
            values *= LENGTH[unit]
        else:
            values *= (np.pi / 180.0 if unit == "deg" else 1.0) * quantity.spool_radius_mm
    elif unit == "K":
        values -= 273.15
    else:
        values *= _TO_SI.get(unit, 1.0)
    values *= quantity.scale
    values += quantity.offset
    return values


def _interpolate(t: Array, own: Array, values: Array) -> Array:
    """Interpolate rows linearly to times t; hold the first and last values outside the record."""
    return np.stack([np.interp(t, own, values[:, c]) for c in range(values.shape[1])], axis=1)


def _resample_commands(
    t: Array, fields: Document, mapping: Mapping, notes: list[str]
) -> tuple[Array, Document]:
    if mapping.command_rate_hz is None or len(t) < 2:
        return t, fields
    count = (t[-1] - t[0]) * mapping.command_rate_hz
    if count > 50_000_000:
        raise RunError(
            f"{mapping.path}: commands.rate_hz = {mapping.command_rate_hz:g} gives {count:.0f} "
            "rows; give a lower rate"
        )
    regular = np.arange(t[0], t[-1] + 1e-9, 1.0 / mapping.command_rate_hz)
    for name in ("command", "ticks", "present", "present_ticks", "current", "temperature", "load"):
        if name in fields:
            column = fields[name]
            rows = _interpolate(regular, t, column.reshape(len(t), -1))
            rows = np.rint(rows) if "ticks" in name else rows
            fields[name] = rows if column.ndim == 2 else rows[:, 0]
    notes.append(
        f"commands resampled from {len(t)} rows to {len(regular)} at {mapping.command_rate_hz:g} Hz"
    )
    return regular, fields


def _frames_clock(t: Array, t_seen: Array, mapping: Mapping, notes: list[str]) -> Array:
    """Return frame times on the clock of the commands, corrected as the mapping states."""
    if mapping.fast_ppm == 0.0 and mapping.clock_step is None:
        return t_seen
    start, step = float(t[0]), mapping.clock_step
    if step is not None and mapping.zero_time:  # `check` counts from the first command
        step = (step[0] + start, step[1])
    moved = corrected(t_seen, start, mapping.fast_ppm, step)
    notes.append(
        f"the clock of the frames is corrected by up to {float(np.abs(moved - t_seen).max()):.4g} s"
    )
    return moved


def _rest(t_seen: Array, fields: Document, mapping: Mapping, notes: list[str]) -> None:
    """Take the markers' rest places from a stretch of the log when the robot is straight."""
    if mapping.marker_rest_s is None:
        return
    low, high = mapping.marker_rest_s
    if mapping.marker_rest_mm is not None or fields.get("markers") is None:
        raise RunError(
            f"{mapping.path}: marker_rest_s needs markers, and marker_rest_mm gives the same; "
            "leave marker_rest_s out"
        )
    straight = np.asarray(fields["markers"])[(t_seen >= low) & (t_seen <= high)]
    known = np.isfinite(straight).all(axis=2)
    if not len(straight) or not known.any(axis=0).all():
        raise RunError(
            f"{mapping.path}: marker_rest_s = [{low:g}, {high:g}]: {len(straight)} frames, and "
            f"some marker is not seen in them; the log is seen from {t_seen[0]:g} to "
            f"{t_seen[-1]:g} s"
        )
    fields["marker_rest"] = (
        np.where(known[..., None], straight, 0.0).sum(axis=0) / known.sum(axis=0)[:, None]
    )
    notes.append(
        f"markers at rest: where they were from {low:g} to {high:g} s ({len(straight)} frames)"
    )


def _constants(files: list[Path], mapping: Mapping, fields: Document, notes: list[str]) -> None:
    fields |= {"robot": mapping.robot, "command_unit": mapping.command_unit}
    fields |= {name: np.asarray(value) for name, value in mapping.constants.items()}
    if mapping.marker_rest_mm is not None:
        fields["marker_rest"] = mapping.to_base(mapping.marker_rest_mm)
        if PLANE in fields:
            fields["marker_rest"][:, AXES.index(str(fields[PLANE]))] = 0.0
    grams = next(
        (
            g
            for pattern, g in mapping.load_g
            if any(fnmatch.fnmatch(path.name, pattern) for path in files)
        ),
        None,
    )
    if grams is not None and mapping.declare_load:
        if "load" in fields:
            raise RunError(f"{mapping.path}: load is both a column and a constant; keep one")
        fields["load"] = np.asarray(grams)
    elif grams:
        notes.append(
            f"a load of {grams:g} g is known to the mapping but not declared in the run "
            "(declare_load = false)"
        )
