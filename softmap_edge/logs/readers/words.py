"""Count cells that hold no number by column: words for a missing value.

A column of numbers holds a word here and there: `#N/A` of a spreadsheet, `--` or `lost` of a
tracker, `NULL` of a database. A cell counts as such a word if it holds no digit, or if it is an
error that a program writes with digits (`#DIV/0!`, `1.#QNAN`, `nan(0x8000)`). Any other cell that
is no number, such as `12mm`, is a fault of the file. So is a column that holds mostly words.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from softmap_edge.files.printable import listed

# not reported to the user: their meaning is clear
EMPTY = {"", "nan", "na", "n/a", "null", "none", "-nan"}
MOSTLY = 0.5  # of the cells: a column with more words is no column of numbers
_ERROR = re.compile(r"#.*|[+-]?1\.#[a-z]+\d*|[+-]?(nan|inf)\S*", re.IGNORECASE)
_LONG = 20  # characters of a word that are shown
_LISTED = 6  # words that are named
_DISTINCT = 1000  # words that are counted one by one


def is_word(cell: str) -> bool:
    """Whether a cell that is no number stands for a missing value."""
    return not any(c.isdigit() for c in cell) or _ERROR.fullmatch(cell) is not None


def is_text(column: Sequence[str], is_number: Callable[[str], bool]) -> bool:
    """Whether a column holds text, by its first cells.

    It then is not numbers with a word here and there.
    """
    filled = [cell for cell in column if cell.lower() not in EMPTY]
    texts = [cell for cell in filled if not is_number(cell)]
    return len(texts) > MOSTLY * len(filled) or not all(map(is_word, texts))


@dataclass
class Words:
    """The words for missing values in a file: the count and the first line of each."""

    # (column, word) → [count, first line]
    found: dict[tuple[int, str], list[int]] = field(default_factory=dict)

    def take(self, cell: str, column: int, line: int) -> None:
        """Count a word."""
        word = cell[:_LONG] if len(self.found) < _DISTINCT else "…"
        seen = self.found.setdefault((column, word), [0, line])
        seen[0] += 1

    def mostly(self, rows: int) -> tuple[int, str, int] | None:
        """Return column, word and first line of a column of mostly words, if there is one."""
        counts: dict[int, int] = {}
        for (column, _), (count, _) in self.found.items():
            counts[column] = counts.get(column, 0) + count
        for (column, word), (_, line) in self.found.items():
            if counts[column] > MOSTLY * rows:
                return column, word, line
        return None

    def line(self, names: Sequence[str], rows: int) -> list[str]:
        """Return the sentence that names the words, if there are any."""
        if not self.found:
            return []
        each = (
            f"{names[column]} '{word}' in {count} of {rows} rows (first in line {first})"
            for (column, word), (count, first) in self.found.items()
        )
        return [f"words in columns of numbers are taken as missing: {listed(each, _LISTED)}"]
