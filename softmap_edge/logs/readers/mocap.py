"""Read text exports of motion capture: TRC (OpenSim, Cortex, QTM) and CSV of OptiTrack's Motive.

Both have several header lines; the rows below are an ordinary text log. Columns are `frame`,
`time`, and `NAME.x`, `NAME.y`, `NAME.z` for each marker or rigid body; for Motive also
`NAME.rotation.x` and the error of a marker. An empty cell is an unseen marker. The header states
the unit.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from softmap_edge.errors import RunError
from softmap_edge.logs.readers.cells import is_number, split
from softmap_edge.logs.readers.lines import first_lines
from softmap_edge.logs.readers.stated_rate import rate_of
from softmap_edge.logs.readers.text import TextColumns

_HEAD = 40  # lines in which the rows must begin
_UNITS = {
    "meters": "m",
    "metres": "m",
    "millimeters": "mm",
    "millimetres": "mm",
    "centimeters": "cm",
    "m": "m",
}
_UNITS |= {"mm": "mm", "cm": "cm", "meter": "m", "millimeter": "mm"}
_UNITS |= dict.fromkeys(("in", "inch", "inches"), "in") | dict.fromkeys(
    ("ft", "foot", "feet"), "ft"
)


def is_trc(line: str) -> bool:
    """Return whether a file with this first line is TRC."""
    return line.startswith("PathFileType")


def is_motive(line: str) -> bool:
    """Return whether a file with this first line is Motive's CSV."""
    return line.replace('"', "").startswith("Format Version,")


def open_trc(path: Path) -> TextColumns:
    """Find the markers of a TRC file.

    Raises:
        RunError: its header is damaged.
    """
    lines = first_lines(path, _HEAD)
    cells = [[cell.strip() for cell in line.split("\t")] for line in lines]
    if len(cells) < 5 or not cells[3] or cells[3][0].lower().rstrip("#") != "frame":
        raise RunError(
            f"{path}: is not a TRC file (its fourth line does not name Frame#, Time and markers); "
            "export it again"
        )
    stated = dict(zip(cells[1], cells[2]))
    labels = [cell for cell in cells[3][2:] if cell]
    axes = [cell for cell in cells[4] if cell]
    if not labels or len(axes) != 3 * len(labels):
        raise RunError(
            f"{path}: line 4 names {len(labels)} markers, line 5 has {len(axes)} coordinates, "
            "expected three for each; export it again"
        )
    names = ["frame", "time", *(f"{label}.{axis}" for label in labels for axis in "xyz")]
    columns = _rows(
        path, names, "\t", cells, 5, stated.get("Units", ""), stated.get("NumFrames", "")
    )
    return replace(
        columns,
        declared=replace(columns.declared, rate=rate_of(stated, ("DataRate", "CameraRate"))),
    )


def open_motive(path: Path) -> TextColumns:
    """Find the markers and rigid bodies of a CSV export of Motive.

    Raises:
        RunError: its header is damaged.
    """
    lines = first_lines(path, _HEAD)
    cells = [split(line, ",") for line in lines]
    at = next((k for k, row in enumerate(cells) if row and row[0].lower() == "frame"), None)
    named = next((row for row in cells[:at] if len(row) > 1 and row[1].lower() == "name"), None)
    if at is None or named is None or at < 2 or len(cells[at]) < 3:
        raise RunError(
            f"{path}: is not a CSV export of Motive (no lines Name and Frame in its head); export it "
            "again"
        )
    width = len(cells[at])
    kinds = next((row for row in cells[:at] if len(row) > 1 and row[1].lower() == "type"), [])
    rows = [row + [""] * (width - len(row)) for row in (kinds, named, cells[at - 1], cells[at])]
    names = ["frame", "time"]
    taken = set(names)  # in addition to the list: a damaged header may hold 500 000 cells
    for kind, name, what, axis in list(zip(*rows))[2:]:
        column = (
            f"{name}.{axis.lower()}"
            if what == "Position"
            else f"{name}.{what.lower()}.{axis.lower()}"
        )
        column = column if axis else f"{name}.{what}"
        names.append(column if column not in taken else f"{column} ({kind})")
        taken.add(names[-1])
    stated = dict(zip(cells[0][::2], cells[0][1::2]))
    count = stated.get("Total Exported Frames", "")
    columns = _rows(path, names, ",", cells, at + 1, stated.get("Length Units", ""), count)
    rates = ("Export Frame Rate", "Capture Frame Rate")
    return replace(columns, declared=replace(columns.declared, rate=rate_of(stated, rates)))


def _rows(
    path: Path,
    names: list[str],
    delimiter: str,
    cells: list[list[str]],
    at: int,
    unit: str,
    count: str,
) -> TextColumns:
    """Return where the rows below the header begin, the unit of the coordinates, and the count."""
    while at < len(cells) and not (cells[at] and cells[at][0] and is_number(cells[at][0])):
        at += 1
    if at == len(cells):
        raise RunError(f"{path}: holds no frames; export it again")
    extra = len(cells[at]) - len(names)
    if extra > 0 and not any(cells[at][len(names) :]):  # tabs at the end of each line
        names = [*names, *[""] * extra]
    known = _UNITS.get(unit.strip().lower())
    places = [
        name for name in names if name[-2:] in (".x", ".y", ".z") and ".rotation." not in name
    ]
    units = dict.fromkeys(places, known) if known else {}
    rows = int(count) if re.fullmatch(r"[0-9]{1,9}", count.strip()) else None
    return TextColumns(path, names, at + 1, delimiter, ".", units=units, stated_rows=rows)
