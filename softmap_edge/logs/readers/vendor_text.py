"""Read text exports with extended headers: Qualisys TSV, Vicon Nexus CSV, LabVIEW LVM.

- Qualisys: lines `KEY<tab>value`; `FREQUENCY` is the rate, `MARKER_NAMES` (or `BODY_NAMES`) name
  the columns, in mm.
- Nexus: the section `Trajectories`, its rate in the next line, names over `X, Y, Z`, a line of
  units. Other sections (devices, forces) are skipped.
- LVM: the header states separator and decimal mark; a file without X columns states `Delta_X` of
  its first channel.

Pinned by tests/logs/test_vendor_text.py.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from softmap_edge.errors import RunError
from softmap_edge.logs.readers.cells import is_number, is_plain, split, trimmed
from softmap_edge.logs.readers.lines import first_lines, lines_that
from softmap_edge.logs.readers.paced import PacedColumns, paced
from softmap_edge.logs.readers.stated_rate import rate_of
from softmap_edge.logs.readers.text import TextColumns, open_text

_HEAD = 60  # lines in which the rows must begin
_QTM = ("NO_OF_FRAMES", "NO_OF_CAMERAS", "NO_OF_MARKERS", "NO_OF_BODIES", "FREQUENCY")
_SECTIONS = (
    "trajectories",
    "devices",
    "joints",
    "segments",
    "model outputs",
    "forces",
    "markers",
    "events",
)
_BODY = ("x", "y", "z", "roll", "pitch", "yaw", "residual", *(f"rot{k}" for k in range(9)))


def is_qtm(start: str) -> bool:
    """Return whether a file with this start is a TSV export of Qualisys Track Manager."""
    return start.split("\n", 1)[0].split("\t")[0].strip() in _QTM


def is_nexus(start: str) -> bool:
    """Return whether a file with this start is a Vicon Nexus CSV: a section and its rate."""
    lines = [line.strip(' ,\t\r"').lower() for line in start.split("\n")[:2]]
    return len(lines) == 2 and lines[0] in _SECTIONS and is_plain(lines[1])


def is_lvm(start: str) -> bool:
    """Return whether a file with this start is a LabVIEW measurement file."""
    return start.lstrip().startswith("LabVIEW Measurement")


def open_qtm(path: Path) -> TextColumns | PacedColumns:
    """Find the markers or bodies of a TSV export of Qualisys Track Manager.

    Raises:
        RunError: its header is damaged, or its rows do not match the names.
    """
    cells = [[cell.strip() for cell in line.split("\t")] for line in first_lines(path, _HEAD)]
    at = next((k for k, row in enumerate(cells) if any(row) and all(map(_value, row))), None)
    if at is None:
        raise RunError(f"{path}: holds no frames; export it again")
    stated = {row[0]: trimmed(row[1:]) for row in cells[:at]}
    bodies = "MARKER_NAMES" not in stated
    labels = stated.get("MARKER_NAMES") or stated.get("BODY_NAMES") or []
    width = len(trimmed(cells[at]))
    width = max((len(trimmed(row)) for row in cells[at:]), default=width)
    lead = [name.lower() for name in cells[at - 1][:2] if name.lower() in ("frame", "time")]
    each = (width - len(lead)) // len(labels) if labels else 0
    if not labels or each * len(labels) + len(lead) != width or each < 3:
        raise RunError(
            f"{path}: names {len(labels)} markers and its rows have {width} cells, expected three "
            "for each marker; export it again as TSV, with the names of the trajectories"
        )
    axes = _BODY if bodies else ("x", "y", "z", *(f"value {k}" for k in range(each - 3)))
    parts = [axes[k] if k < len(axes) else f"value {k}" for k in range(each)]
    names = [*lead, *(f"{label}.{_turn(part)}" for label in labels for part in parts)]
    places = [name for name in names if name[-2:] in (".x", ".y", ".z")]
    columns = TextColumns(path, names, at + 1, "\t", ".", units=dict.fromkeys(places, "mm"))
    if "time" in lead:
        first = {key: row[0] for key, row in stated.items() if row}
        return replace(
            columns, declared=replace(columns.declared, rate=rate_of(first, ("FREQUENCY",)))
        )
    return paced(
        columns, (stated.get("FREQUENCY") or [""])[0], "frame" if "frame" in lead else None
    )


def _turn(part: str) -> str:
    return f"rotation.{part}" if part.startswith(("roll", "pitch", "yaw", "rot")) else part


def _value(cell: str) -> bool:
    return not cell or is_number(cell) or cell.lower() in ("null", "nan")


def open_nexus(path: Path) -> TextColumns | PacedColumns:
    """Find the trajectories of a CSV export of Vicon Nexus.

    Raises:
        RunError: it has no such section, or its header is damaged.
    """
    sections = lines_that(path, lambda line: line.strip(' ,\t\r"').lower() in _SECTIONS)
    begin = next(
        (
            number
            for number, line in sections
            if "traj" in line.lower() or "markers" in line.lower()
        ),
        None,
    )
    if begin is None:
        named = ", ".join(line.strip(' ,\t\r"') for _, line in sections[:5])
        raise RunError(
            f"{path}: holds {named} and no section Trajectories; export the trajectories as well"
        )
    rate = first_lines(path, 1, begin + 1)[0].strip(' ,\t\r"')
    stop = next((number for number, _ in sections if number > begin), None)
    columns = replace(open_text(path, None, None, True, begin + 1, 0), stop=stop, notes=())
    frame = next((name for name in columns.names if name.lower() == "frame"), None)
    return paced(columns, rate, frame)


def open_lvm(path: Path, header: bool | None, order: str | None) -> TextColumns | PacedColumns:
    """Find the channels of a LabVIEW measurement file.

    Args:
        path: the file.
        header: whether a line names the channels; None: detect it.
        order: `dmy` or `mdy` for dates; None: the rows decide.

    Raises:
        RunError: it holds no rows, or its header is damaged.
    """
    lines = first_lines(path, _HEAD)
    pairs = [trimmed(split(line, _separator(lines))) for line in lines]
    stated = {row[0].lower(): row[1:] for row in pairs if len(row) > 1}
    decimal = (stated.get("decimal_separator") or [""])[0]
    columns = open_text(
        path, _separator(lines), decimal if decimal in (".", ",") else None, header, 0, 0, order
    )
    columns = replace(
        columns, notes=tuple(note for note in columns.notes if "above the table" not in note)
    )
    if (stated.get("x_columns") or ["One"])[0].lower() != "no" or "delta_x" not in stated:
        return columns
    step = stated["delta_x"][0].replace(",", ".")
    if not is_plain(step) or not float(step) > 0:
        raise RunError(
            f"{path}: Delta_X = '{step[:20]}', expected the step in s; correct it, or export with "
            "an X column"
        )
    return paced(columns, repr(1.0 / float(step)))


def _separator(lines: list[str]) -> str:
    """Return the delimiter stated in the header; a tab by default."""
    for line in lines:
        if line.startswith("Separator"):
            word = line[len("Separator") :].strip()
            return (
                ","
                if word.lower().startswith("comma") or line[len("Separator") :][:1] == ","
                else "\t"
            )
    return "\t"
