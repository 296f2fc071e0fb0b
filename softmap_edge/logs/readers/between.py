"""Leave out lines between the rows of a text log: repeated headers, remarks, labelled summaries.

Pinned by tests/logs/test_between.py.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from softmap_edge.files.printable import listed
from softmap_edge.logs.readers.cells import is_value, split
from softmap_edge.logs.readers.heads import plain_name, plain_names
from softmap_edge.logs.readers.summaries import labelled_lines

_LISTED = 3  # lines that are listed
_MARKS = "#%"
_CUTS = re.compile(r"[,;\t|]")


def without_heads(lines: list[str]) -> list[str]:
    """Return a log's first lines with repeated headers blanked.

    These lines follow a row and repeat an earlier line of names. Names in another order also count,
    because both parts are one table whatever the header of the second part.
    """
    seen: set[tuple[str, ...]] = set()
    found, rows = list(lines), False
    for k, line in enumerate(lines):
        cells = plain_names(_CUTS.split(line))
        values = sum(map(is_value, cells))
        rows = rows or 2 * values > len(cells) > 1
        if len(cells) < 2 or 2 * values > len(cells) or not any(map(str.isalpha, line)):
            continue
        names = tuple(sorted(cells))
        if rows and names in seen:
            found[k] = ""
        seen.add(names)
    return found


@dataclass
class Between:
    """The numbers of the lines left out during one reading."""

    heads: list[int] = field(default_factory=list)
    remarks: list[int] = field(default_factory=list)
    summaries: list[int] = field(default_factory=list)

    @property
    def found(self) -> list[int]:
        """Return the numbers of all lines left out."""
        return [*self.heads, *self.remarks, *self.summaries]

    def rows(
        self,
        block: list[str],
        numbers: NDArray[np.int64],
        head: Sequence[str],
        mark: str,
        width: int,
    ) -> tuple[list[str], NDArray[np.int64]]:
        """Return the lines without headers, remarks and summaries, with their numbers, and counts.

        Args:
            block: lines that are not blank.
            numbers: their line numbers in the file, (lines,).
            head: the lines above the rows that hold names, units or text.
            mark: the separator of cells.
            width: cells of a row.
        """
        lines, again = frozenset(head), {plain_names(split(line, mark)) for line in head}
        longest = max(
            (cell for line in head if len(c := split(line, mark)) == width for cell in c),
            key=_letters,
            default="",
        )
        key = max(plain_name(longest).split(), key=_letters, default="")
        some = [
            k
            for k, line in enumerate(block)
            if line[0] in _MARKS or line in lines or (key and key in line.casefold())
        ]
        gone: set[int] = set()
        for k in some:
            cells = split(block[k], mark)
            if plain_names(cells) in again:
                self.heads.append(int(numbers[k]))
                gone.add(k)
            elif block[k][0] in _MARKS and len(cells) != width:
                self.remarks.append(int(numbers[k]))
                gone.add(k)
        summed = [k for k in labelled_lines(block, mark) if k not in gone]
        self.summaries += numbers[summed].tolist()
        gone |= set(summed)
        if not gone:
            return block, numbers
        kept = [k for k in range(len(block)) if k not in gone]
        return [block[k] for k in kept], numbers[kept]

    def lines(self) -> list[str]:
        """Return the sentences that list the lines."""
        sentences = []
        if self.heads:
            sentences.append(
                f"lines that repeat the head of the table were left out: {_named(self.heads)}"
            )
        if self.remarks:
            sentences.append(f"remarks between the rows were left out: {_named(self.remarks)}")
        if self.summaries:
            sentences.append(
                "rows with the label of a summary, such as Mean, were left out: "
                f"{_named(self.summaries)}"
            )
        return sentences


def _letters(cell: str) -> int:
    return sum(map(str.isalpha, cell))


def _named(lines: list[int]) -> str:
    return f"{len(lines)} (line {listed(lines, _LISTED)})"
