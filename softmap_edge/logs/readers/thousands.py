"""Read numbers whose digits are in groups of three: `25,039.0`, `25.039,0`, `1'234.5`, `1 234,5`.

A cell counts if it cannot mean anything else: it has a decimal mark of another kind as well, or several commas. A cell
such as `25,039` alone may be a decimal comma. It counts only in a log in which another cell is clear. Pinned by
tests/logs/test_thousands.py.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

_SPACES = "'\u2019\u00a0\u202f\u2009 "
_FORMS = {
    mark: re.compile(rf"[+-]?[1-9]\d{{0,2}}({group}\d{{3}})+({decimal}\d*)?([eE][+-]?\d+)?")
    for mark, group, decimal in ((",", ",", r"\."), (".", r"\.", ","), ("'", f"[{_SPACES}]", "[.,]"))
}


def grouping_of(cell: str) -> str | None:
    """Return the mark between the groups of a cell that can only be a grouped number: `,`, `.` or `'`; else None."""
    if "," not in cell and not any(c in cell for c in _SPACES):
        return None
    clear = (mark for mark, form in _FORMS.items() if form.fullmatch(cell) and _clear(cell, mark))
    return next(clear, None)


def _clear(cell: str, mark: str) -> bool:
    """Whether a cell has a decimal mark as well, or several groups."""
    return mark == "'" or ("." in cell and "," in cell) or (mark == "," and cell.count(mark) > 1)


def grouping_in(cells: Iterable[str]) -> str | None:
    """Return the mark between groups of digits that the cells of a log have; None without a clear one."""
    return next((mark for cell in cells if (mark := grouping_of(cell)) is not None), None)


def plain(cell: str, mark: str | None) -> str | None:
    """Return a grouped number without its groups and with a decimal point; None if it is none.

    Args:
        cell: as in the file.
        mark: between groups, where another cell of the log is clear; None to read only what is clear by itself.
    """
    own = grouping_of(cell)
    mark = own or mark
    if mark is None or not _FORMS[mark].fullmatch(cell):
        return None
    bare = re.sub(f"[{_SPACES}]", "", cell) if mark == "'" else cell.replace(mark, "")
    return bare.replace(",", ".")
