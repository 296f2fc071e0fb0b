"""Count cells without a number by column: words for a missing value.

A column of numbers may hold occasional words: `#N/A` of a spreadsheet, `--` or `lost` of a tracker,
`NULL` of a database. A cell is such a word if it holds no digit, or is a program's error code with
digits (`#DIV/0!`, `1.#QNAN`, `nan(0x8000)`). Any other cell that is not a number, such as `12mm`,
is a fault of the file. So is a column that holds mostly words.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from softmap_edge.files.printable import listed

# not reported: their meaning is clear
EMPTY = {"", "nan", "na", "n/a", "null", "none", "-nan"}
MOSTLY = 0.5  # of the cells: a column with more words is not a column of numbers
_ERROR = re.compile(r"#.*|[+-]?1\.#[a-z]+\d*|[+-]?(nan|inf)\S*", re.IGNORECASE)
_LONG = 20  # characters of a word that are shown
_LISTED = 6  # words that are listed
_DISTINCT = 1000  # distinct words that are counted


def is_word(cell: str) -> bool:
    """Return whether a cell that is not a number stands for a missing value."""
    return not any(c.isdigit() for c in cell) or _ERROR.fullmatch(cell) is not None


def is_text(column: Sequence[str], is_number: Callable[[str], bool]) -> bool:
    """Return whether a column's first cells are text, not numbers with occasional words."""
    filled = [cell for cell in column if cell.lower() not in EMPTY]
    texts = [cell for cell in filled if not is_number(cell)]
    return len(texts) > MOSTLY * len(filled) or not all(map(is_word, texts))


@dataclass
class Words:
    """The words for missing values in a file: count and first line of each."""

    # (column, word) → [count, first line]
    found: dict[tuple[int, str], list[int]] = field(default_factory=dict)

    def take(self, cell: str, column: int, line: int) -> None:
        """Count a word."""
        word = cell[:_LONG] if len(self.found) < _DISTINCT else "…"
        seen = self.found.setdefault((column, word), [0, line])
        seen[0] += 1

    def mostly(self, rows: int) -> tuple[int, str, int] | None:
        """Return column, word and first line of a column of mostly words; None if there is none."""
        counts: dict[int, int] = {}
        for (column, _), (count, _) in self.found.items():
            counts[column] = counts.get(column, 0) + count
        for (column, word), (_, line) in self.found.items():
            if counts[column] > MOSTLY * rows:
                return column, word, line
        return None

    def line(self, names: Sequence[str], rows: int) -> list[str]:
        """Return the sentence that lists the words; empty if there are none."""
        if not self.found:
            return []
        each = (
            f"{names[column]} '{word}' in {count} of {rows} rows (first in line {first})"
            for (column, word), (count, first) in self.found.items()
        )
        return [f"words in columns of numbers are taken as missing: {listed(each, _LISTED)}"]
