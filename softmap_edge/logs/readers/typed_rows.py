"""Read the older OptiTrack CSV (Tracking Tools, ARENA), where each row's first cell is its type.

A `frame` row holds index, time (s), the rigid bodies and the markers of one frame, each list after
its count: `frame,INDEX,TIME,BODIES[,id,x,y,z,qx,qy,qz,qw,yaw,pitch,roll …],MARKERS[,x,y,z,id,name
…]`. A row lists only what was seen, so a marker missing from it was not seen. Units are m. Pinned
by tests/logs/test_vendor_text.py.
"""

from __future__ import annotations

from array import array
from pathlib import Path

import numpy as np

from softmap_edge.errors import RunError
from softmap_edge.logs.readers.cells import is_plain, split
from softmap_edge.logs.readers.columns import HeldColumns
from softmap_edge.logs.readers.lines import lines_of

_TYPES = (
    "comment",
    "righthanded",
    "lefthanded",
    "info",
    "rigidbody",
    "frame",
    "marker",
    "trackable",
    "tool",
)
BODY = 11  # cells of a rigid body: id, position, quaternion, angles
MARKER = 5  # cells of a marker: position, id, name
MOST_NAMES = 2000  # bodies and markers of one file
MOST_CELLS = 20_000_000  # of the table in memory: 160 MB
_QUATERNION = ("rotation.x", "rotation.y", "rotation.z", "rotation.w")


def is_typed(start: str) -> bool:
    """Return whether a file with this start has typed rows."""
    kinds = [
        line.split(",", 1)[0].strip().lower() for line in start.split("\n")[:-1] if line.strip()
    ]
    return (
        bool(kinds)
        and all(kind in _TYPES for kind in kinds)
        and bool({"frame", "info"} & set(kinds))
    )


def open_typed(path: Path) -> HeldColumns:
    """Read the markers and rigid bodies of an export with typed rows.

    Raises:
        RunError: a row does not match its counts, or the file holds too many names.
    """
    columns: dict[str, int] = {"frame": 0, "time": 1}
    # columns and values of all rows, concatenated, and the end of each row
    where, values, ends = array("i"), array("d"), [0]
    for number, line in lines_of(path):
        if line[:6].lower() != "frame,":
            continue
        for name, value in _frame(path, number, split(line, ",")).items():
            where.append(columns.setdefault(name, len(columns)))
            values.append(value)
        ends.append(len(values))
        if len(columns) > 7 * MOST_NAMES or (len(ends) - 1) * len(columns) > MOST_CELLS:
            raise RunError(
                f"{path}: more than {MOST_NAMES} names, or {MOST_CELLS} cells; export a shorter "
                "part, or as C3D"
            )
    rows, names = len(ends) - 1, list(columns)
    if not rows:
        raise RunError(f"{path}: holds no rows of type frame; export it again, as CSV 1.2 or C3D")
    numbers = np.full((rows, len(names)), np.nan)
    numbers[np.repeat(np.arange(rows), np.diff(ends)), np.frombuffer(where, np.intc)] = (
        np.frombuffer(values)
    )
    units = {
        name: "m" for name in names if name[-2:] in (".x", ".y", ".z") and ".rotation." not in name
    }
    note = f"an export with rows of types: {rows} frames, places in m as this format has them"
    return HeldColumns(path, names, numbers, units | {"time": "s"}, notes=(note,))


def _frame(path: Path, number: int, cells: list[str]) -> dict[str, float]:
    """Return the values of one `frame` row by column name."""
    bodies = _count(path, number, cells, 3)
    markers = 4 + BODY * bodies
    count = _count(path, number, cells, markers)
    if len(cells) < markers + 1 + MARKER * count:
        raise RunError(
            f"{path}: line {number} states {bodies} bodies and {count} markers and has "
            f"{len(cells)} cells, expected {markers + 1 + MARKER * count}; remove the line, or "
            "export as CSV 1.2 or C3D"
        )
    row = {"frame": _float(path, number, cells[1]), "time": _float(path, number, cells[2])}
    for k in range(bodies):
        at = 4 + BODY * k
        for name, cell in zip(("x", "y", "z", *_QUATERNION), cells[at + 1 : at + 8]):
            row[f"body {cells[at]}.{name}"] = _float(path, number, cell)
    for k in range(count):
        at = markers + 1 + MARKER * k
        label = cells[at + 4] or f"marker {cells[at + 3]}"
        if f"{label}.x" in row:
            label = f"{label} #{cells[at + 3]}"
        for name, cell in zip("xyz", cells[at : at + 3]):
            row[f"{label}.{name}"] = _float(path, number, cell)
    return row


def _count(path: Path, number: int, cells: list[str], at: int) -> int:
    if at < len(cells) and cells[at].isdigit() and len(cells[at]) < 6:
        return int(cells[at])
    found = cells[at][:20] if at < len(cells) else "nothing"
    raise RunError(
        f"{path}: line {number}, cell {at + 1}: {found} is not a count of bodies or markers; remove "
        "the line, or export as CSV 1.2 or C3D"
    )


def _float(path: Path, number: int, cell: str) -> float:
    if not cell:
        return np.nan
    if is_plain(cell):
        return float(cell)
    raise RunError(
        f"{path}: line {number}: '{cell[:40]}' is not a number; remove the line, or export it again"
    )
