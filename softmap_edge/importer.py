"""Turns the CSV logs of any robot into a run, as told by a small TOML mapping (columns, units, axes, rates).

`read_mapping(path)` checks the mapping, `import_logs(paths, mapping)` gives the run and what was done to it
in plain words.
Several logs are joined by time: the rows of the log that holds the commands become the rows of the run,
everything else recorded beside them is interpolated to those times, and what was seen keeps its own times.
A held encoder (read more slowly than it is logged, so that rows repeat) lags by half its period; it is
un-held by a straight line between the rows where a new value arrives. Longer stillness stays stillness: only
gaps up to three typical holds are bridged, and nothing is done when the typical hold is over 0.25 s, for
that is a robot at rest. tests/test_import.py pins all of it; docs/mapping.md lists the keys.
"""

from __future__ import annotations

import fnmatch
import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.log_table import LogTable, read_log
from softmap_edge.mapping import LENGTH, Mapping, Quantity, read_mapping
from softmap_edge.run import Run

__all__ = ["Imported", "Mapping", "import_logs", "read_mapping", "unhold"]

Array = NDArray[np.float64]
LONGEST_HOLD = 0.25  # s: an encoder polled more slowly than 4 Hz is not worth un-holding
_TO_SI = {"g": 1.0, "kg": 1000.0, "N": 1000.0 / 9.80665, "mA": 1.0, "A": 1000.0}


@dataclass(frozen=True)
class Imported:
    """A run and what was done to make it, one sentence each."""

    run: Run
    notes: tuple[str, ...]


def import_logs(paths: Sequence[str | os.PathLike[str]], mapping: Mapping) -> Imported:
    """Read logs by a mapping.

    Args:
        paths: the CSV files; which is which the mapping tells by their names.
        mapping: from `read_mapping`.

    Raises:
        RunError: a file, a column or a value does not fit the mapping; the message says what to change.
    """
    notes: list[str] = []
    files = _assign([Path(path) for path in paths], mapping)
    tables = [read_log(path, log) for path, log in zip(files, mapping.logs)]
    fields: dict[str, Any] = {}
    t = _command_rows(tables, mapping, fields, notes)
    t_seen = _seen(tables, mapping, fields)
    if t is None and t_seen is None:
        raise RunError(f"{mapping.path}: names neither commands nor markers; give at least one of them")
    t = t_seen if t is None else t
    assert t is not None
    t, fields = _resample_commands(t, fields, mapping, notes)
    if t_seen is not None:
        t_seen = _choose_frames(t, t_seen, fields, mapping, notes)
        fields["t_seen"] = t_seen
        _blocks(t_seen, fields, mapping)
    if mapping.zero_time:
        zero = t[0]
        t = t - zero
        if t_seen is not None:
            fields["t_seen"] = t_seen - zero
        notes.append(f"time counts from {zero:.6g} s of the log")
    _constants(files, mapping, fields, notes)
    made_from = [f"{path.name} sha256 {hashlib.sha256(path.read_bytes()).hexdigest()}" for path in files]
    run = Run(t=t, **fields, extra={"made_from": np.array(made_from)})
    return Imported(run, tuple(notes))


def unhold(t: Array, rows: Array) -> tuple[Array, float]:
    """Replace held samples by the line between the rows where new values arrive.

    Args:
        t: (T,) s. rows: (T, C), all channels read together.

    Returns:
        The rows un-held, and the typical hold in s (0 when nothing was held).
    """
    if len(rows) < 3 or rows.shape[1] == 0:
        return rows, 0.0
    fresh = np.flatnonzero(np.r_[True, (np.diff(rows, axis=0) != 0).any(axis=1)])
    if len(fresh) < 3 or len(fresh) > 0.7 * len(rows):
        return rows, 0.0
    gaps = np.diff(fresh)
    typical = int(np.median(gaps))
    hold = float(np.median(np.diff(t[fresh])))
    if typical < 2 or hold > LONGEST_HOLD:
        return rows, 0.0
    still = np.flatnonzero(gaps > 3 * typical)  # the value really stayed: keep it until one hold before the next
    knots = np.union1d(fresh, fresh[still + 1] - typical)
    return np.stack([np.interp(t, t[knots], rows[knots, c]) for c in range(rows.shape[1])], axis=1), hold


# --- the rows of the run -------------------------------------------------------------------
def _assign(paths: list[Path], mapping: Mapping) -> list[Path]:
    """The file of each log of the mapping, in the mapping's order."""
    if len(mapping.logs) == 1 and len(paths) == 1:
        return paths
    chosen: list[Path] = []
    for log in mapping.logs:
        fits = [path for path in paths if fnmatch.fnmatch(path.name, log.file or "*")]
        if len(fits) != 1:
            found = (
                f"{len(fits)} of the given files fit ({', '.join(path.name for path in fits)})"
                if fits
                else "no given file fits"
            )
            raise RunError(
                f"{mapping.path}: log '{log.file or '*'}': {found}; give exactly one, or change `file` in the mapping"
            )
        chosen += fits
    spare = [path.name for path in paths if path not in chosen]
    if spare or len(set(chosen)) < len(chosen):
        named = ", ".join(log.file or "*" for log in mapping.logs)
        raise RunError(
            f"{mapping.path}: {', '.join(spare) or 'one file'} fits no log of its own; the mapping has {named}"
        )
    return chosen


def _command_rows(tables: list[LogTable], mapping: Mapping, fields: dict[str, Any], notes: list[str]) -> Array | None:
    """The times of the commands; `fields` gets everything that is sampled at them."""
    owners = [k for k, log in enumerate(mapping.logs) if {"command", "ticks"} & set(log.rows)]
    if len(owners) > 1:
        raise RunError(f"{mapping.path}: {len(owners)} logs hold commands; name the columns of one of them only")
    t = tables[owners[0]].t if owners else None
    for k, log in enumerate(mapping.logs):
        for name, quantity in log.rows.items():
            values = _convert(name, tables[k].numbers(quantity.columns), quantity, mapping)
            if quantity.held != "keep":
                values, hold = unhold(tables[k].t, values)
                if hold:
                    notes.append(f"{name}: held samples ({hold * 1000:.0f} ms typical) were un-held")
                elif quantity.held == "unhold":
                    notes.append(f"{name}: no held samples found")
            column = values if t is None or k in owners else _interpolate(t, tables[k].t, values)
            if name in ("temperature", "load"):
                fields[name] = column[:, 0]
            else:
                fields[name] = np.rint(column) if "ticks" in name else column
    if t is None and fields:
        raise RunError(
            f"{mapping.path}: {', '.join(fields)} without commands; name the columns of `command` or `ticks` as well"
        )
    return t


def _convert(name: str, values: Array, quantity: Quantity, mapping: Mapping) -> Array:
    unit = quantity.unit
    if name in ("command", "present"):
        if mapping.command_unit != "mm":
            if unit == "rad" and mapping.command_unit == "deg":
                values = np.rad2deg(values)
            elif unit == "deg" and mapping.command_unit == "rad":
                values = np.deg2rad(values)
        elif unit in LENGTH:
            values = values * LENGTH[unit]
        else:
            values = (np.deg2rad(values) if unit == "deg" else values) * quantity.spool_radius_mm
    elif unit == "K":
        values = values - 273.15
    else:
        values = values * _TO_SI.get(unit, 1.0)
    return values * quantity.scale + quantity.offset


def _interpolate(t: Array, own: Array, values: Array) -> Array:
    """Rows at times t, linear; outside its own record the first and last values hold."""
    if len(own) < 1:
        raise RunError("a log without rows cannot be joined; give a log that holds data")
    if (np.diff(own) <= 0).any():
        row = int(np.flatnonzero(np.diff(own) <= 0)[0]) + 1
        raise RunError(
            f'time does not increase at row {row} of a joined log; set time.repeated = "drop" or repair the log'
        )
    return np.stack([np.interp(t, own, values[:, c]) for c in range(values.shape[1])], axis=1)


def _resample_commands(
    t: Array, fields: dict[str, Any], mapping: Mapping, notes: list[str]
) -> tuple[Array, dict[str, Any]]:
    if mapping.command_rate_hz is None or len(t) < 2:
        return t, fields
    regular = np.arange(t[0], t[-1] + 1e-9, 1.0 / mapping.command_rate_hz)
    if len(regular) > 50_000_000:
        raise RunError(
            f"{mapping.path}: commands.rate_hz = {mapping.command_rate_hz:g} gives {len(regular)} rows; "
            "give a lower rate"
        )
    for name in ("command", "ticks", "present", "present_ticks", "current", "temperature", "load"):
        if name in fields:
            column = fields[name]
            rows = _interpolate(regular, t, column.reshape(len(t), -1))
            rows = np.rint(rows) if "ticks" in name else rows
            fields[name] = rows if column.ndim == 2 else rows[:, 0]
    notes.append(f"commands resampled from {len(t)} rows to {len(regular)} at {mapping.command_rate_hz:g} Hz")
    return regular, fields


# --- what was seen -------------------------------------------------------------------------
def _seen(tables: list[LogTable], mapping: Mapping, fields: dict[str, Any]) -> Array | None:
    """The times of the frames; `fields` gets markers in the base frame, who was visible, and labels."""
    owners = [k for k, log in enumerate(mapping.logs) if log.markers is not None]
    if not owners:
        return None
    if len(owners) > 1:
        raise RunError(f"{mapping.path}: {len(owners)} logs hold markers; name the columns of one of them only")
    table, log = tables[owners[0]], mapping.logs[owners[0]]
    assert log.markers is not None
    flat = table.numbers(log.markers.columns) * LENGTH[log.markers.unit]
    points = (flat * log.markers.scale + log.markers.offset).reshape(len(flat), -1, 3)  # (K, M, 3) mm, the log's frame
    fields["markers"] = to_base(points, mapping)
    visible = np.isfinite(points).all(axis=2)
    if not visible.all():
        fields["visible"] = visible
    if log.block is not None:
        fields["block"] = table.texts(log.block)
    return table.t


def to_base(points: Array, mapping: Mapping) -> Array:
    """Return points (..., 3) mm of the log's frame in the base frame: shifted, then axes turned."""
    shifted = points - mapping.origin_mm
    return np.stack([sign * shifted[..., axis] for axis, sign in mapping.axes], axis=-1)


def _choose_frames(t: Array, t_seen: Array, fields: dict[str, Any], mapping: Mapping, notes: list[str]) -> Array:
    """Drop frames outside the commands and the wished interval, then thin to the wished rate."""
    low = max(float(t[0]), mapping.from_s if mapping.from_s is not None else -np.inf)
    high = min(float(t[-1]), mapping.to_s if mapping.to_s is not None else np.inf)
    slack = 1e-9 * max(1.0, abs(low), abs(high))
    keep = np.flatnonzero((t_seen >= low - slack) & (t_seen <= high + slack))
    if len(t_seen) and not len(keep):
        raise RunError(
            f"{mapping.path}: the frames last from {t_seen[0]:.6g} to {t_seen[-1]:.6g} s, but only "
            f"{low:.6g} to {high:.6g} s is "
            "commanded and asked for; give time.offset_s of one log"
        )
    if len(keep) < len(t_seen):
        notes.append(
            f"{len(t_seen) - len(keep)} of {len(t_seen)} frames lie outside {low:.6g} to {high:.6g} s and were dropped"
        )
    if mapping.seen_rate_hz is not None and len(keep) > 1:
        # the first frame at or after each tick of the wished clock: even where the log's own clock jitters
        tick = np.floor((t_seen[keep] - t_seen[keep[0]]) * mapping.seen_rate_hz + 1e-6)
        thinned = keep[np.r_[True, np.diff(tick) > 0]]
        notes.append(f"{len(thinned)} of {len(keep)} frames kept for {mapping.seen_rate_hz:g} Hz")
        keep = thinned
    for name in ("markers", "visible", "block"):
        if name in fields:
            fields[name] = fields[name][keep]
    return t_seen[keep]


def _blocks(t_seen: Array, fields: dict[str, Any], mapping: Mapping) -> None:
    if "block" in fields or not len(t_seen):
        return
    since = t_seen - t_seen[0]
    if mapping.block_seconds is not None:
        fields["block"] = np.floor(since / mapping.block_seconds).astype(np.int64)
    elif mapping.block_count is not None:
        share = since / max(float(since[-1]), 1e-12)
        fields["block"] = np.minimum(np.floor(share * mapping.block_count), mapping.block_count - 1).astype(np.int64)


def _constants(files: list[Path], mapping: Mapping, fields: dict[str, Any], notes: list[str]) -> None:
    fields |= {"robot": mapping.robot, "command_unit": mapping.command_unit}
    fields |= {name: np.asarray(value) for name, value in mapping.constants.items()}
    if mapping.marker_rest_mm is not None:
        fields["marker_rest"] = to_base(mapping.marker_rest_mm, mapping)
    grams = next(
        (g for pattern, g in mapping.load_g if any(fnmatch.fnmatch(path.name, pattern) for path in files)),
        None,
    )
    if grams is not None and mapping.declare_load:
        if "load" in fields:
            raise RunError(f"{mapping.path}: load is both a column and a constant; keep one")
        fields["load"] = np.asarray(grams)
    elif grams:
        notes.append(
            f"a load of {grams:g} g is known to the mapping but not declared in the run (declare_load = false)"
        )
