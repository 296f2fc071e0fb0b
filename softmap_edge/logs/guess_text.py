"""Writes a mapping that is proposed: what was found of a log as commented TOML."""

from __future__ import annotations

import json
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from softmap_edge.logs.guess_columns import Role, Sheet
from softmap_edge.logs.mapping import ANGLE, SCHEMA, TIME
from softmap_edge.logs.triples import LeftOut

Array = NDArray[np.float64]
RATE_HZ = 100  # of a counter, where nothing says better
MANY = 5000  # frames: a diagnosis needs no more, and takes longer
SEEN_HZ = 20


@dataclass
class Found:
    """What is known so far."""

    assumed: list[str] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)
    command: tuple[Sheet, Role] | None = None
    present: tuple[Sheet, Role] | None = None
    others: list[tuple[Sheet, Role]] = field(default_factory=list)
    points: tuple[Sheet, list[list[str]], str] | None = None
    base: list[list[str]] = field(default_factory=list)  # markers on the clamp
    left: list[tuple[Sheet, LeftOut]] = field(default_factory=list)  # columns in threes that are no place
    label: str | None = None
    times: dict[int, tuple[str | None, str]] = field(default_factory=dict)


def mapping_text(sheets: list[Sheet], found: Found, frame: list[str]) -> str:
    """Return the mapping of what was found, with the lines of the frame of its markers."""
    files = len({sheet.file for sheet in sheets})
    lines = [f'schema = "{SCHEMA}"', '# robot = "…"   # a name']
    unit = found.command[1].unit if found.command is not None else None
    if unit in ANGLE:
        lines.append(f'command_unit = "{unit}"')
    if unit == "ticks":
        lines.append('command_unit = "ticks"   # of a model that is learned; `softmap calibrate` takes them as well')
    if any(_since_1970(sheet, *found.times[k]) for k, sheet in enumerate(sheets)):
        lines.append("zero_time = true   # the log counts since 1970")
    for k, sheet in enumerate(sheets):
        inside = _inside(sheet, found)
        if inside:
            lines += ["", "[[log]]", *_head(sheet, files), _time(sheet, *found.times[k]), *inside]
    if found.points is not None:
        lines += frame
        sheet = found.points[0]
        t = seconds(sheets, found, sheet)
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
    lines = [f"file = {json.dumps(sheet.file)}"] if files > 1 else []
    lines += [] if sheet.topic is None else [f"topic = {json.dumps(sheet.topic, ensure_ascii=False)}"]
    if sheet.episode is not None:
        lines.append(f"episode = {sheet.episode}   # ASSUMED: the first of the file; each episode is a run of its own")
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
    k = sheet.names.index(name)
    if not sheet.header or (sheet.bare and sheet.bare.count(sheet.bare[k]) > 1):
        return str(k)
    return json.dumps(name, ensure_ascii=False)


def _inside(sheet: Sheet, found: Found) -> list[str]:
    lines = []
    for kind, pair in (
        ("command", found.command),
        ("present", found.present),
        *((r.kind, (s, r)) for s, r in found.others),
    ):
        if pair is not None and pair[0] is sheet:
            told = f', unit = "{pair[1].unit}"' if pair[1].unit else ""
            lines.append(f"{kind} = {{ columns = [{', '.join(_cell(sheet, c) for c in pair[1].columns)}]{told} }}")
    if found.points is not None and found.points[0] is sheet:
        _, triples, unit = found.points
        for kind, places in (("markers", triples), ("base", found.base)):
            rows = [f"    [{', '.join(_cell(sheet, name) for name in triple)}]," for triple in places]
            lines += [f'{kind} = {{ unit = "{unit}", columns = [', *rows, "] }"] if rows else []
        lines += [] if found.label is None else [f"block = {_cell(sheet, found.label)}"]
    return lines


def seconds(sheets: list[Sheet], found: Found, sheet: Sheet) -> Array:
    """Return the times (T,) s of the rows of a sheet."""
    name, unit = found.times[next(k for k, other in enumerate(sheets) if other is sheet)]
    values = np.arange(len(sheet.numbers), dtype=float) if name is None else sheet.column(name)
    return values * (1.0 / RATE_HZ if unit == "rows" else TIME[unit])
