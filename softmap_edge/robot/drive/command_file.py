"""The command file: a protocol as a CSV table, readable by people and playable on a robot.

    # softmap commands 1; robot moe-finger; unit mm
    t,u0,u1,gravity_x,gravity_y,gravity_z,load_g,temperature_c,look,block,note
    0.0000,0.0000,0.0000,0.00000,0.00000,1.00000,0,,1,home,

`t` is in s, and `u0` … in the unit of the first line. Gravity is in g in the base frame. `load_g`
is the declared load at the tip, g. `temperature_c` is the temperature to reach, °C; it is empty if
the protocol has none. `look` is 1 where a frame is required; a camera may take more. `block` is the
part of the protocol, and `note` what must be done by hand from this row on. Limit: frames are taken
at rows, which are 0.02 s apart in files of this tool. Files are checked when written and read.
Pinned by tests/experiment/test_experiment.py and tests/model/test_mutated_files.py.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError, brief
from softmap_edge.files.atomic import own_text, replacement_of
from softmap_edge.run.protocol import Protocol

Floats = NDArray[np.float64]

HEAD = re.compile(r"# softmap commands (\d+); robot (.{0,80}); unit (\S{1,16})")
VERSION = 1
# limits: bytes of a file, its rows, its channels, characters of a label
BYTES = 1 << 27
ROWS = 1_000_000
CHANNELS = 64
TEXT = 200
REMEDY = "write it with `softmap next --out`"
BEFORE = ("t",)
AFTER = ("gravity_x", "gravity_y", "gravity_z", "load_g", "temperature_c", "look", "block", "note")


def write_commands(path: str | Path, plan: Protocol, robot: str) -> None:
    """Write a protocol as a command file, complete or not at all."""
    look, label = np.zeros(plan.t.size, int), np.full(plan.t.size, "", object)
    rows = np.clip(np.searchsorted(plan.t, plan.t_seen - 1e-9), 0, plan.t.size - 1)
    look[rows] = 1
    if plan.frames:
        label[:] = plan.block[
            np.clip(np.searchsorted(rows, np.arange(plan.t.size)), 0, plan.frames - 1)
        ]
    note = {int(np.searchsorted(plan.t, time - 1e-9)): text for time, text in plan.notes}
    with (
        replacement_of(Path(path)) as partial,
        open(partial, "w", encoding="utf-8", newline="") as file,
    ):
        file.write(f"# softmap commands {VERSION}; robot {_line(robot)[:80]}; unit {plan.unit}\n")
        table = csv.writer(file, lineterminator="\n")
        table.writerow([*BEFORE, *(f"u{c}" for c in range(plan.command.shape[1])), *AFTER])
        for k, (time, command, gravity) in enumerate(zip(plan.t, plan.command, plan.gravity)):
            load = "0" if plan.load is None else f"{plan.load[k]:g}"
            warm = "" if plan.temperature is None else f"{plan.temperature[k]:.3f}"
            numbers = [
                f"{time:.4f}",
                *(f"{u:.4f}" for u in command),
                *(f"{g:.7f}" for g in gravity),
                load,
                warm,
            ]
            table.writerow([*numbers, look[k], label[k], note.get(k, "")])


def read_commands(path: str | Path) -> tuple[Protocol, str]:
    """Read a command file; return the protocol and the name of the robot that it was made for.

    Raises:
        RunError: it is not a command file, it is of a newer version, or a line is not usable; the
            message names the line.
    """
    file = Path(path)
    if file.exists() and file.is_file() and file.stat().st_size > BYTES:
        raise RunError(
            f"{path}: {file.stat().st_size >> 20} MB, command files of up to {BYTES >> 20} MB are "
            "read"
        )
    try:
        lines = own_text(file, BYTES).split("\n")
    except FileNotFoundError:
        raise
    except OSError as fault:
        raise RunError(f"{path}: {fault.strerror}; {REMEDY}") from None
    except UnicodeDecodeError as fault:
        raise RunError(f"{path}: no text in UTF-8 ({brief(fault)}); {REMEDY}") from None
    head = HEAD.fullmatch(lines[0].rstrip("\r"))
    if head is None:
        raise RunError(
            f"{path}: no command file, the first line is '{_line(lines[0])[:60]}'; {REMEDY}"
        )
    if int(head[1][:9]) != VERSION:
        raise RunError(
            f"{path}: command file of version {head[1][:9]}, version {VERSION} is read; {REMEDY}"
        )
    try:
        rows = [row for row in csv.reader(lines[1:], strict=True) if row]
    except csv.Error as fault:
        raise RunError(f"{path}: not readable as CSV ({brief(fault)}); {REMEDY}") from None
    return _protocol(path, rows, head[3]), _line(head[2])


def _protocol(path: str | Path, rows: list[list[str]], unit: str) -> Protocol:
    names = rows[0] if rows else []
    channels = len(names) - len(BEFORE) - len(AFTER)
    required = [*BEFORE, *(f"u{c}" for c in range(max(channels, 0))), *AFTER]
    if names != required or channels > CHANNELS:
        raise RunError(
            f"{path}: columns {_line(','.join(names))[:100]}; expected t, u0 to u63 at most, "
            f"{', '.join(AFTER)}"
        )
    if not 2 <= len(rows) - 1 <= ROWS:
        raise RunError(f"{path}: {len(rows) - 1} rows of commands; 2 to {ROWS} are read")
    width = len(names) - 2  # the last two columns are texts
    numbers = np.empty((len(rows) - 1, width))
    for k, row in enumerate(rows[1:]):
        if len(row) != len(names):
            raise RunError(
                f"{path}: row {k + 1} has {len(row)} cells, the header {len(names)}; {REMEDY}"
            )
        numbers[k] = [_number(path, k, name, cell) for name, cell in zip(names, row[:width])]
        if any(len(text) > TEXT for text in row[width:]):
            raise RunError(
                f"{path}: row {k + 1}: a text of more than {TEXT} characters; shorten it"
            )
    column = dict(zip(names, numbers.T))
    t, look = column["t"], column["look"]
    if not np.all(np.diff(t) > 0):
        k = int(np.argmin(np.diff(t) > 0))
        raise RunError(
            f"{path}: row {k + 2}: time {t[k + 1]:g} s after {t[k]:g} s; it must grow from row to "
            "row"
        )
    if not np.isin(look, (0.0, 1.0)).all():
        raise RunError(
            f"{path}: look is 0 or 1, got {look[~np.isin(look, (0.0, 1.0))][0]:g}; {REMEDY}"
        )
    gravity = np.stack([column[name] for name in AFTER[:3]], axis=1)
    length = np.linalg.norm(gravity, axis=1)
    if np.any(np.abs(length - 1.0) > 0.01):
        k = int(np.argmax(np.abs(length - 1.0)))
        raise RunError(
            f"{path}: row {k + 1}: gravity of {length[k]:g} g; it is a direction of length 1"
        )
    load, warm = column["load_g"], column["temperature_c"]
    if not np.all((load >= 0) & np.isfinite(load)):
        k = int(np.argmin((load >= 0) & np.isfinite(load)))
        raise RunError(f"{path}: row {k + 1}: load_g is {load[k]:g}; a weight is 0 g or more")
    if np.isnan(warm).any() and not np.isnan(warm).all():
        raise RunError(
            f"{path}: temperature_c is given in some rows only; give it in all, or in none"
        )
    seen = look == 1.0
    return Protocol(
        name="commands",
        t=t,
        command=numbers[:, 1 : 1 + channels],
        gravity=gravity / length[:, None],
        t_seen=t[seen],
        block=np.array(
            [_line(row[width]) for row, required in zip(rows[1:], seen) if required], str
        ),
        load=load if np.any(load != 0) else None,
        temperature=None if np.isnan(warm).all() else warm,
        notes=tuple(
            (float(time), _line(row[width + 1])) for time, row in zip(t, rows[1:]) if row[width + 1]
        ),
        unit=unit,
    )


def _number(path: str | Path, k: int, name: str, cell: str) -> float:
    if name == "temperature_c" and not cell:
        return float("nan")
    try:
        value = float(cell)
    except ValueError:
        value = float("nan")
    if not abs(value) < 1e6:
        raise RunError(
            f"{path}: row {k + 1}: {name} is '{_line(cell)[:40]}', expected a number below a "
            "million"
        )
    return value


def _line(text: str) -> str:
    """Return a text as one line of printable characters."""
    return "".join(c for c in text if c.isprintable())


def steps(notes: Iterable[tuple[float, str]]) -> list[str]:
    """Return the steps to do by hand as lines, each with minutes and seconds."""
    return [f"{int(time // 60)}:{int(time % 60):02d}  {text}" for time, text in notes]
