"""Read and check the mapping file of an import: meaning, unit, frame and rate of each column.

Unknown keys are rejected, and the message lists the known ones. docs/reference/mapping.md lists
all keys; examples/trunk.toml shows the form.
"""

from __future__ import annotations

import os
import re
import tomllib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError, brief
from softmap_edge.files.atomic import Document, own_text
from softmap_edge.files.toml import TomlTable, parsed, shown
from softmap_edge.logs.measured import (
    Column,
    Measured,
    columns_of,
    measured_of,
    not_seen_of,
    per_column,
    scale_of,
)
from softmap_edge.logs.pivot import KEY as PIVOT
from softmap_edge.logs.pivot import Pivot, pivot_of
from softmap_edge.logs.readers.cdr import FRAME
from softmap_edge.logs.time_keys import NO_TIME as NO_TIME
from softmap_edge.logs.time_keys import TIME as TIME
from softmap_edge.logs.time_keys import Clock as Clock
from softmap_edge.logs.time_keys import clock_of
from softmap_edge.run.fields import plain
from softmap_edge.run.rollover import DRIVES

Array = NDArray[np.float64]

SCHEMA = "softmap.mapping/1"
POINTS = ("markers", "base")
CONDITIONS = ("temperature", "load")  # of the robot: one column each
FILE = "file"  # the unit that the file itself states; mm where it states none
PIXEL = "px"  # of a picture: no length, so `scale` gives the mm of one pixel
LIKELIHOOD = 0.6  # least likelihood of a place that counts as seen, as DeepLabCut plots it
LENGTH = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 1e-3, "in": 25.4, "ft": 304.8}  # → mm
ANGLE = ("deg", "rad")
UNITS: dict[str, tuple[str, ...]] = {
    "command": (*LENGTH, *ANGLE, "ticks"),
    "present": (*LENGTH, *ANGLE, "ticks"),
    "ticks": ("ticks",),
    "present_ticks": ("ticks",),
    "current": ("mA", "A"),
    "temperature": ("degC", "K"),
    "load": ("g", "kg", "N"),
    "markers": (*LENGTH, FILE, PIXEL),
    "base": (*LENGTH, FILE, PIXEL),
}
KEYS = (
    *("schema", "robot", "command_unit", "zero_time", "log"),
    *("frame", "commands", "seen", "blocks", "constant"),
)
LOG = (
    *("file", "topic", "frame_id", "episode", "delimiter", "decimal", "header"),
    *("skip_rows", "skip_last_rows", "from_row", "to_row", "time", "block", "output"),
    PIVOT,
)
QUANTITY = ("columns", "unit", "scale", "offset", "spool_radius_mm", "held")
CONSTANTS = (
    *("gravity", "temperature_c", "sigma_mm", "marker_rest_mm", "marker_rest_s"),
    *("load_g", "declare_load"),
)
_SIZE = 1_000_000  # bytes of a mapping
_HUGE = 1e12  # no component of a direction is larger
_UNIT_LENGTH = 1e-3  # deviation from length 1 that a run accepts


@dataclass(frozen=True)
class Quantity:
    """Columns of one kind: their names and conversion to our units (value · scale + offset)."""

    columns: tuple[Column, ...]
    unit: str
    scale: Array
    offset: Array
    held: str = "keep"
    spool_radius_mm: float = 1.0
    labels: tuple[str, ...] = ()  # names of the markers
    swaps: str = "report"
    not_seen: tuple[float, ...] | None = ()  # numbers that stand for "not seen"; None keeps all
    axes: int = 3  # coordinates of a marker: 2 in a plane
    likelihood: tuple[Column, ...] = ()  # one column for each marker
    least_likelihood: float = LIKELIHOOD  # of a place that was seen
    # (columns,) size of a turn after which each rolls over, in the log's unit
    unwrap: Array | None = None
    scaled: bool = False  # whether the mapping gives `scale`


@dataclass(frozen=True)
class Log:
    """One log file, or one topic of a file."""

    file: str | None
    topic: str | None
    delimiter: str | None
    decimal: str | None
    header: bool
    skip_rows: int
    skip_last_rows: int
    clock: Clock
    rows: dict[str, Quantity]
    markers: Quantity | None
    base: Quantity | None
    block: Column | None
    output: Measured | None = None
    episode: int | None = None
    from_row: int = 0  # first row that is read, counted from 0
    to_row: int | None = None
    pivot: Pivot | None = None  # of a table with one row for each marker
    frame_id: str | None = None  # of a recording: the frame whose places are read


@dataclass(frozen=True)
class Mapping:
    """A mapping; made by `read_mapping`."""

    path: Path
    robot: str | None
    command_unit: str
    zero_time: bool
    logs: tuple[Log, ...]
    axes: tuple[tuple[int, int], ...]
    origin_mm: Array
    command_rate_hz: float | None
    seen_rate_hz: float | None
    from_s: float | None
    to_s: float | None
    block_count: int | None
    block_seconds: float | None
    constants: Document = field(default_factory=dict)
    marker_rest_mm: Array | None = None
    marker_rest_s: tuple[float, float] | None = None
    load_g: tuple[tuple[str, float], ...] = ()
    declare_load: bool = True
    # rate error of the frames' clock against that of the commands; positive if it runs fast
    fast_ppm: float = 0.0
    # when the frames' clock is set, and by how much, s
    clock_step: tuple[float, float] | None = None

    def to_base(self, points: Array) -> Array:
        """Return points (..., 3) mm of the log's frame in the base frame: shifted, then rotated."""
        shifted = points - self.origin_mm
        return np.stack([sign * shifted[..., axis] for axis, sign in self.axes], axis=-1)


def read_mapping(path: str | os.PathLike[str]) -> Mapping:
    """Read a mapping file.

    Raises:
        RunError: it is absent, not TOML, or a key is unknown, missing or of the wrong kind.
    """
    path = Path(path)
    try:
        if path.stat().st_size > _SIZE:
            raise RunError(
                f"{path}: {path.stat().st_size} bytes, a mapping has at most {_SIZE}; give the "
                "mapping, not the log"
            )
        return parse_mapping(own_text(path, _SIZE), path)
    except OSError as cause:
        raise RunError(
            f"{path}: cannot be read ({cause.strerror or cause}); give the path of a mapping file"
        ) from cause
    except UnicodeDecodeError as cause:
        raise RunError(f"{path}: is not a TOML file ({brief(cause)}); save it as UTF-8") from cause


def parse_mapping(text: str, path: Path) -> Mapping:
    """Return the mapping described by a text; errors refer to `path`.

    Raises:
        RunError: as in `read_mapping`.
    """
    try:
        document = parsed(text)
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as cause:
        raise RunError(
            f"{path}: is not a TOML file ({brief(cause)}); examples/trunk.toml shows the form"
        ) from cause
    return _mapping(path, TomlTable(document, str(path)))


def _mapping(path: Path, top: TomlTable) -> Mapping:
    top.only(KEYS)
    schema = top.get("schema", (str,), "")
    if schema != SCHEMA:
        raise RunError(
            f"{path}: schema '{schema[:60]}', expected '{SCHEMA}'; put schema = \"{SCHEMA}\" in "
            "the first line"
        )
    unit = _name(top, "command_unit") or "mm"
    logs = top.get("log", (list,), [])
    if not logs:
        raise RunError(f"{path}: no [[log]]; each file of the logs needs one")
    frame, commands, seen, blocks, constant = (
        top.table(k) for k in ("frame", "commands", "seen", "blocks", "constant")
    )
    frame.only(("origin_mm", "axes"))
    commands.only(("rate_hz",))
    seen.only(("rate_hz", "from_s", "to_s", "fast_ppm", "clock_step"))
    blocks.only(("count", "seconds"))
    constant.only(CONSTANTS)
    origin = frame.numbers("origin_mm", (3,))
    if {"count", "seconds"} <= blocks.values.keys():
        raise RunError(
            f"{blocks.where}: count = {shown(blocks.values['count'])} and seconds = "
            f"{shown(blocks.values['seconds'])}: both cut the frames into blocks; keep one of them"
        )
    gravity = _gravity(constant)
    temperature = constant.number("temperature_c")
    sigma = constant.number("sigma_mm")
    pairs = {"gravity": gravity, "temperature": temperature, "sigma": sigma}
    return Mapping(
        path=path,
        robot=_name(top, "robot"),
        command_unit=unit,
        zero_time=bool(top.get("zero_time", (bool,), False)),
        logs=tuple(
            _log(TomlTable(log, f"{path}: log {k + 1}"), unit) for k, log in enumerate(logs)
        ),
        axes=_axes(frame),
        origin_mm=np.zeros(3) if origin is None else origin,
        command_rate_hz=commands.number("rate_hz", None, 1e-3, 1e5),
        seen_rate_hz=seen.number("rate_hz", None, 1e-3, 1e5),
        from_s=seen.number("from_s"),
        to_s=seen.number("to_s"),
        block_count=blocks.integer("count", None, 1, 10_000),
        block_seconds=blocks.number("seconds", None, 1e-3, 1e9),
        constants={name: value for name, value in pairs.items() if value is not None},
        marker_rest_mm=constant.numbers("marker_rest_mm", (None, 3)),
        marker_rest_s=_stretch(constant),
        load_g=_loads(constant),
        declare_load=bool(constant.get("declare_load", (bool,), True)),
        fast_ppm=seen.number("fast_ppm", 0.0, -1e5, 1e5) or 0.0,
        clock_step=_step(seen),
    )


def _name(top: TomlTable, key: str) -> str | None:
    """Return a text that the run stores, checked as the run's."""
    text = top.get(key, (str,))
    return None if text is None else plain(f"{top.where}: {key}", text)


def _step(seen: TomlTable) -> tuple[float, float] | None:
    step = seen.numbers("clock_step", (2,))
    return None if step is None else (float(step[0]), float(step[1]))


def _stretch(constant: TomlTable) -> tuple[float, float] | None:
    limits = constant.numbers("marker_rest_s", (2,))
    if limits is None:
        return None
    low, high = map(float, limits)
    if not low <= high:
        raise RunError(
            f"{constant.where}: marker_rest_s = [{low:g}, {high:g}]: it ends before it begins"
        )
    return low, high


def _gravity(constant: TomlTable) -> Array | None:
    """Return the declared direction of gravity (3,), a unit vector; None without one."""
    if "gravity" not in constant.values:
        return None
    allowed = (
        "expected a direction of length 1 in the base frame, such as [0.0, 0.0, 1.0] (hanging) or "
        "[0.0, 0.0, -1.0] (standing)"
    )
    given = constant.values["gravity"]
    numbers = given if isinstance(given, list) else []
    plain_numbers = all(
        isinstance(x, int | float) and not isinstance(x, bool) and abs(x) <= _HUGE for x in numbers
    )
    if len(numbers) != 3 or not plain_numbers:  # NaN is not below the limit either
        raise RunError(f"{constant.where}: gravity = {shown(given)}: {allowed}")
    gravity = np.array(numbers, float)
    length = float(np.linalg.norm(gravity))
    if length == 0.0:
        raise RunError(
            f"{constant.where}: gravity = {shown(given)} has no direction: {allowed}; leave it out "
            "if you do not know it"
        )
    if abs(length - 1.0) > _UNIT_LENGTH:
        unit = ", ".join(f"{x:.4g}" for x in gravity / length + 0.0)
        raise RunError(
            f"{constant.where}: gravity = {shown(given)} has length {length:.4g}: {allowed}; "
            f"gravity = [{unit}] has this direction"
        )
    return gravity


def _loads(constant: TomlTable) -> tuple[tuple[str, float], ...]:
    value = constant.get("load_g", (int, float, dict))
    if isinstance(value, dict):
        table = constant.table("load_g")
        return tuple((pattern, table.number(pattern, None, 0.0, 1e5) or 0.0) for pattern in value)
    grams = constant.number("load_g", None, 0.0, 1e5)
    return () if grams is None else (("*", grams),)


def _axes(frame: TomlTable) -> tuple[tuple[int, int], ...]:
    names = frame.get("axes", (list,), ["x", "y", "z"])
    signs = [(-1 if str(name).startswith("-") else 1, str(name).lstrip("+-")) for name in names]
    if sorted(letter for _, letter in signs) != ["x", "y", "z"]:
        raise RunError(
            f"{frame.where}: axes = {str(names)[:60]}, expected each of x, y, z once, with - "
            "where it is turned round"
        )
    axes = tuple(("xyz".index(letter), sign) for sign, letter in signs)
    matrix = np.zeros((3, 3))
    for row, (axis, sign) in enumerate(axes):
        matrix[row, axis] = sign
    if np.linalg.det(matrix) < 0:
        raise RunError(
            f"{frame.where}: axes = {str(names)[:60]} mirror the robot; turn one sign round or "
            "swap two axes"
        )
    return axes


def _log(table: TomlTable, command_unit: str) -> Log:
    table.only((*LOG, *UNITS))
    clock = clock_of(table)
    rows = {name: _quantity(table, name, command_unit) for name in UNITS if name in table.values}
    markers, base = (rows.pop(name, None) for name in POINTS)
    delimiter = table.get("delimiter", (str,))
    if delimiter is not None and (len(delimiter) != 1 or delimiter in '\r\n"'):
        raise RunError(
            f"{table.where}: delimiter = '{delimiter[:20]}', expected one character such as , or "
            "; or a tab"
        )
    log = Log(
        file=table.get("file", (str,)),
        topic=table.get("topic", (str,)),
        delimiter=delimiter,
        decimal=table.choice("decimal", (".", ","), ".")
        if "decimal" in table.values
        else table.get("decimal", (str,)),
        header=bool(table.get("header", (bool,), True)),
        skip_rows=table.integer("skip_rows", 0, 0, 10**9) or 0,
        skip_last_rows=table.integer("skip_last_rows", 0, 0, 10**9) or 0,
        clock=clock,
        rows=rows,
        markers=markers,
        base=base,
        block=_column(table, "block"),
        output=measured_of(table),
        episode=table.integer("episode", None, 0, 10**9),
        from_row=table.integer("from_row", 0, 0, 10**9) or 0,
        to_row=table.integer("to_row", None, 0, 10**9),
        pivot=pivot_of(table),
        frame_id=_frame_id(table),
    )
    if log.decimal == "," and log.delimiter == ",":
        raise RunError(
            f"{table.where}: comma is both delimiter and decimal; the file cannot be read so"
        )
    if log.output is not None and (markers is not None or base is not None):
        raise RunError(
            f"{table.where}: output and markers: a run holds outputs or places; make two runs of "
            "them"
        )
    if markers is not None and base is not None and markers.axes != base.axes:
        raise RunError(
            f"{table.where}: markers have {markers.axes} columns each, base {base.axes}; give "
            "both alike"
        )
    if (log.block is not None or base is not None) and markers is None and log.output is None:
        what = "block labels belong" if base is None else "base markers belong"
        raise RunError(f"{table.where}: {what} to the log with the markers; move them there")
    return log


def _frame_id(table: TomlTable) -> str | None:
    """Return the frame that a log declares; the leading stroke of ROS 1 does not count."""
    given = table.get("frame_id", (str,))
    name = None if given is None else str(given).removeprefix("/")[:FRAME]
    if name == "":
        raise RunError(f"{table.where}: frame_id is empty; name a frame, or leave it out")
    return name


def _column(table: TomlTable, key: str) -> Column | None:
    value = table.get(key, (str, int))
    return value if isinstance(value, str | int) else None


def _quantity(log: TomlTable, name: str, command_unit: str) -> Quantity:
    table = log.table(name)
    points: tuple[str, ...] = ()
    if name == "markers":
        points = ("not_seen", "likelihood", "least_likelihood", "labels", "swaps")
    elif name == "base":
        points = ("not_seen", "likelihood", "least_likelihood")
    elif name in CONDITIONS:
        points = ("not_seen",)
    table.only((*QUANTITY, *points, *(("unwrap",) if name in DRIVES else ())))
    listed, flat = table.values.get("columns", []), columns_of(table)
    sizes = (
        {len(e) if isinstance(e, list) else 0 for e in listed}
        if isinstance(listed, list)
        else set()
    )
    axes = 2 if sizes == {2} else 3
    if name in POINTS and (len(flat) % axes or not sizes <= {0, axes}):
        raise RunError(
            f'{table.where}: {len(flat)} columns, expected x, y, z of each marker: [["x1", "y1", '
            '"z1"], …], or x, y of each in a plane: [["x1", "y1"], …]'
        )
    if name in CONDITIONS and len(flat) != 1:
        raise RunError(f"{table.where}: {len(flat)} columns, expected one")
    own = command_unit if name in ("command", "present") else UNITS[name][0]
    allowed = UNITS[name] if own in UNITS[name] else (*UNITS[name], own)
    unit = table.choice("unit", allowed, FILE if name in POINTS else own)
    radius = table.number("spool_radius_mm", None, 1e-3, 1e4)
    if (
        name in ("command", "present")
        and command_unit == "mm"
        and unit not in LENGTH
        and radius is None
    ):
        raise RunError(
            f"{table.where}: unit {unit} and command_unit mm need spool_radius_mm; "
            f'without one set command_unit = "{unit}"'
        )
    if name in ("command", "present") and command_unit == "mm" and unit == "ticks":
        raise RunError(
            f"{table.where}: ticks are kept as ticks; call the columns "
            f"`{'present_' * (name == 'present')}ticks`"
        )
    if (
        name in ("command", "present")
        and command_unit != "mm"
        and unit != command_unit
        and {unit, command_unit} != set(ANGLE)
    ):
        raise RunError(
            f"{table.where}: unit {unit} cannot become command_unit {command_unit}; give both in "
            "one unit"
        )
    return Quantity(
        columns=tuple(flat),
        unit=unit,
        scale=scale_of(table, len(flat)),
        offset=per_column(table, "offset", len(flat), 0.0),
        held=table.choice("held", *_held(name)),
        spool_radius_mm=1.0 if radius is None else radius,
        labels=_labels(table, name, flat, axes),
        swaps=table.choice("swaps", ("report", "mend"), "report")
        if name == "markers"
        else "report",
        not_seen=not_seen_of(table) if name in (*POINTS, *CONDITIONS) else (),
        axes=axes if name in POINTS else 1,
        likelihood=_likelihood(table, len(flat) // axes) if name in POINTS else (),
        least_likelihood=table.number("least_likelihood", LIKELIHOOD, 0.0, 1e6) or 0.0,
        unwrap=_unwrap(table, len(flat)) if name in DRIVES and "unwrap" in table.values else None,
        scaled="scale" in table.values,
    )


def _likelihood(table: TomlTable, markers: int) -> tuple[Column, ...]:
    """Return the columns with the likelihood of each marker; () without any."""
    given = table.get("likelihood", (list,))
    if given is None:
        if "least_likelihood" in table.values:
            raise RunError(
                f"{table.where}: least_likelihood without likelihood; name the column of each "
                'marker: likelihood = ["tip.likelihood", …]'
            )
        return ()
    named = [one for one in given if isinstance(one, str | int) and not isinstance(one, bool)]
    if len(named) != markers or len(given) != markers:
        raise RunError(
            f"{table.where}: likelihood = {shown(given)}, expected {markers} columns, one for each "
            "marker"
        )
    return tuple(named)


def _unwrap(table: TomlTable, count: int) -> Array:
    """Return the turn of each column."""
    turns = per_column(table, "unwrap", count, 0.0)
    if not (np.isfinite(turns) & (turns > 0)).all():
        raise RunError(
            f"{table.where}: unwrap = {shown(table.values['unwrap'])}, expected the size of a "
            "turn: 4096"
        )
    return turns


def _held(name: str) -> tuple[tuple[str, ...], str]:
    """Return the allowed values of `held`, and the default."""
    if name in POINTS:
        return ("auto", "keep"), "auto"
    return ("auto", "keep", "unhold"), "auto" if name.startswith("present") else "keep"


def _labels(table: TomlTable, name: str, columns: list[Column], axes: int) -> tuple[str, ...]:
    """Return the markers' names: as given, else the common prefix of their column names."""
    if name != "markers":
        return ()
    count = len(columns) // axes
    given = table.get("labels", (list,))
    if given is not None:
        if len(given) != count or not all(isinstance(label, str) for label in given):
            raise RunError(
                f"{table.where}: labels = {shown(given)}, expected {count} texts, one for each "
                "marker"
            )
        return tuple(given)
    return tuple(
        _label([str(column) for column in columns[axes * k : axes * (k + 1)]], k)
        for k in range(count)
    )


def _label(triple: list[str], k: int) -> str:
    """Return the shared part of three names without x, y, z and unit: x1, y1, z1 are marker 1."""
    bare = [_UNIT.sub("", name) for name in triple]
    for turned in (False, True):  # x at the end, or the x in front
        cut = [
            re.sub(r"[xX]|[yY]|[zZ]", _GAP, name[::-1] if turned else name, count=1)
            for name in bare
        ]
        shared = _closed(cut[0][::-1] if turned else cut[0])
        if len(set(cut)) == 1 and shared:
            return f"marker {shared}" if shared.isdigit() else shared
    counted = {re.sub(r"[\[({]\d+[\])}]$", "", name).strip() for name in triple}  # p(1), p(2), p(3)
    return counted.pop() if len(counted) == 1 and not {""} & counted else f"marker {k}"


_LENGTHS = "|".join([*LENGTH, "[µ\u03bc]m", "(?:milli|centi|micro)?met(?:er|re)s?", "inch(?:es)?"])
_UNIT = re.compile(  # at the end of a name: `tip_x_mm`, `tip x (mm)`
    rf"(?:[\s_.:-]*[\[(]\s*(?:{_LENGTHS})\s*[\])]|[\s_.:-]+(?:{_LENGTHS}))$", re.IGNORECASE
)
_GAP = "\0"  # in the place of x, y or z
_MARKS = " ._-:"


def _closed(name: str) -> str:
    """Return a name without its gap, and without marks and brackets that held nothing else."""
    before, _, after = name.partition(_GAP)
    if before[-1:] + after[:1] in ("()", "[]"):  # tip (x)
        before, after = before[:-1], after[1:]
    if after[:1] in tuple(_MARKS):
        after = after.lstrip(_MARKS) if before[-1:] in tuple(_MARKS) else after
    elif after[:1] in (")", "]"):
        before = before.rstrip(_MARKS)
    return (before + after).strip(_MARKS)
