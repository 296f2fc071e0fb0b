"""Read numbers with digits in groups of three: `25,039.0`, `25.039,0`, `1'234.5`, `1 234,5`.

A cell counts if it has no other reading: it also has another decimal mark, or several commas. A
cell such as `25,039` alone may be a decimal comma. It counts only if other cells of the log are
clear: grouped numbers, or decimals with the other mark (`0.05`). A log without clear cells, with
whole numbers below 1000 next to cells such as `1.003`, is ambiguous, so the mapping must state its
`decimal`. Pinned by tests/logs/test_thousands.py.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

_SPACES = "'\u2019\u00a0\u202f\u2009 "
_FORMS = {
    mark: re.compile(rf"[+-]?[1-9]\d{{0,2}}({group}\d{{3}})+({decimal}\d*)?([eE][+-]?\d+)?")
    for mark, group, decimal in (
        (",", ",", r"\."),
        (".", r"\.", ","),
        ("'", f"[{_SPACES}]", "[.,]"),
    )
}

_ALIKE = {mark: re.compile(rf"[+-]?[1-9]\d{{0,2}}(\{mark}\d{{3}})+") for mark in ".,"}
_DECIMAL = {
    mark: re.compile(rf"[+-]?(\d+\{mark}\d*|\{mark}\d+)([eEdDqQ][+-]?\d+)?") for mark in ".,"
}
_SMALL = re.compile(r"[+-]?[1-9]\d{0,2}")
_LEAST = 3  # different cells of either kind


@dataclass(frozen=True)
class Marks:
    """The evidence for decimal and group marks in the first cells of a log.

    Attributes:
        decimals: marks that some cell certainly uses as a decimal mark.
        alike: mark → a cell such as `1.003`, which is either a decimal or has groups of three
            digits.
        groups: mark → a cell that can only be a number in groups of three digits.
    """

    decimals: frozenset[str] = frozenset()
    alike: Mapping[str, str] = field(default_factory=dict)
    groups: Mapping[str, str] = field(default_factory=dict)

    def grouped(self, decimal: str) -> tuple[str, str] | None:
        """Return the group mark for this decimal mark, and a cell with it; None without any."""
        other = other_mark(decimal)
        if (mark := next((mark for mark in self.groups if mark != decimal), None)) is not None:
            return mark, self.groups[mark]
        return (
            (other, self.alike[other])
            if other in self.alike and other not in self.decimals
            else None
        )


def marks_of(cells: Iterable[str]) -> Marks:
    """Return the evidence of cells for the decimal and group marks of their log."""
    decimals, alike, groups = set[str](), dict[str, str](), dict[str, str]()
    for cell in cells:
        for mark in ".,":
            if mark in cell and is_alike(cell, mark):
                alike.setdefault(mark, cell)
            elif mark in cell and _DECIMAL[mark].fullmatch(cell):
                decimals.add(mark)
        if (group := grouping_of(cell)) is not None:
            groups.setdefault(group, cell)
    return Marks(frozenset(decimals), alike, groups)


def other_mark(mark: str) -> str:
    """Return `,` for `.`, and `.` for `,`."""
    return "." if mark == "," else ","


def is_alike(cell: str, mark: str) -> bool:
    """Return whether a cell like `1.003` may be a decimal or have groups of three digits."""
    return _ALIKE[mark].fullmatch(cell) is not None


def unclear(cells: Sequence[str], mark: str) -> str | None:
    """Return a cell of a column that may be decimal or grouped; None if the column is clear.

    It is unclear if every cell with the mark resembles a group and the column also holds whole
    numbers below 1000.

    Args:
        cells: of the column.
        mark: the possible decimal mark, `.` or `,`.
    """
    filled = {cell for cell in cells if cell}
    marked = {cell for cell in filled if mark in cell}
    plain = filled - marked
    if not all(is_alike(cell, mark) for cell in marked) or any(
        len(cell.lstrip("+-0")) > 3 for cell in plain
    ):
        return None
    small = {cell for cell in plain if _SMALL.fullmatch(cell)}
    return (
        next((cell for cell in cells if cell in marked), None)
        if min(len(marked), len(small)) >= _LEAST
        else None
    )


def grouping_of(cell: str) -> str | None:
    """Return the group mark of a clearly grouped number, `,`, `.` or `'`; else None."""
    if "," not in cell and not any(c in cell for c in _SPACES):
        return None
    clear = (mark for mark, form in _FORMS.items() if form.fullmatch(cell) and _clear(cell, mark))
    return next(clear, None)


def _clear(cell: str, mark: str) -> bool:
    """Return whether a cell also has a decimal mark, or several groups."""
    return mark == "'" or ("." in cell and "," in cell) or (mark == "," and cell.count(mark) > 1)


def plain(cell: str, mark: str | None) -> str | None:
    """Return a grouped number without groups and with a decimal point; None if it is not one.

    Args:
        cell: as in the file.
        mark: the group mark, if another cell of the log is clear; None to accept only cells that
            are clear by themselves.
    """
    own = grouping_of(cell)
    mark = own or mark
    if mark is None or not _FORMS[mark].fullmatch(cell):
        return None
    bare = re.sub(f"[{_SPACES}]", "", cell) if mark == "'" else cell.replace(mark, "")
    return bare.replace(",", ".")
