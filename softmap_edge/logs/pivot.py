"""A mapping's `pivot`: which columns of a long table name the frame and the marker of a row."""

from __future__ import annotations

from dataclasses import dataclass

from softmap_edge.errors import RunError
from softmap_edge.files.toml import TomlTable, quoted, shown
from softmap_edge.logs.measured import Column

KEY = "pivot"
_MOST = 3  # columns that name a frame or a marker together


@dataclass(frozen=True)
class Pivot:
    """A log with one row for each marker of each frame.

    Attributes:
        frame: the columns that are equal in all rows of a frame, such as the time.
        marker: the columns that name the marker of a row.
    """

    frame: tuple[Column, ...]
    marker: tuple[Column, ...]

    def line(self) -> str:
        """Return the key as it stands in a mapping."""
        return f"{KEY} = {{ frame = {_written(self.frame)}, marker = {_written(self.marker)} }}"


def pivot_of(log: TomlTable) -> Pivot | None:
    """Return the pivot that a `[[log]]` declares; None without one.

    Raises:
        RunError: it lacks a column, or a key is invalid.
    """
    if KEY not in log.values:
        return None
    table = log.table(KEY)
    table.only(("frame", "marker"))
    return Pivot(_columns(table, "frame"), _columns(table, "marker"))


def _columns(table: TomlTable, key: str) -> tuple[Column, ...]:
    """Return one column, or several in a list."""
    given = table.get(key, (str, int, list))
    listed = given if isinstance(given, list) else [] if given is None else [given]
    found = tuple(one for one in listed if isinstance(one, str | int) and not isinstance(one, bool))
    if not 0 < len(found) == len(listed) <= _MOST or len(set(found)) < len(found):
        raise RunError(
            f"{table.where}: {key} = {shown(given)}, expected a column or a list of up to {_MOST}: "
            'pivot = { frame = "t", marker = "id" }'
        )
    return found


def _written(columns: tuple[Column, ...]) -> str:
    cells = [quoted(column) if isinstance(column, str) else str(column) for column in columns]
    return cells[0] if len(cells) == 1 else f"[{', '.join(cells)}]"
