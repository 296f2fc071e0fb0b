"""List the text columns that a proposed mapping leaves out, with an example cell of each.

A column whose name differs from columns in use only by its number is listed by itself: some of its
cells are not numbers, so it was left out. Pinned by tests/logs/test_text_columns.py.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence

from softmap_edge.files.printable import listed
from softmap_edge.logs.numbered import without_numbers
from softmap_edge.logs.readers.cells import is_number

_CELL = 30  # characters of a cell that are quoted
_NAMED = 60  # columns that are listed
_AXIS = re.compile(r"(?<![^\W\d_])[xyz](?![^\W\d_])")


def mostly_numbers(texts: Sequence[str]) -> bool:
    """Return whether most cells of a text column start like numbers: `3_000`, `12 mm`."""
    filled = [text for text in texts if text.strip()]
    like = sum(1 for text in filled if re.match(r"[-+−]?[.,]?\d", text.strip()))
    return bool(filled) and 2 * like > len(filled)


def text_columns(
    log: str,
    texts: Mapping[str, Sequence[str]],
    used: Collection[str | None],
    drives: Collection[str],
) -> list[str]:
    """Return remarks on the text columns that are not part of the run.

    Args:
        log: the name of the log.
        texts: the cells of its first rows, by column.
        used: the columns of the run, or of another remark.
        drives: the columns of numbers with a role: commands, encoders, markers and others.
    """
    left = {name: cells for name, cells in texts.items() if name not in used and any(cells)}
    kin = {_stem(name): name for name in reversed(list(drives))}
    lines, others = [], []
    for name, cells in left.items():
        odd = [cell for cell in cells if cell.strip() and not is_number(cell)]
        example = (odd or [cell for cell in cells if cell])[0].strip()[:_CELL]
        like = kin.get(_stem(name))
        if like is not None and (odd or not cells):
            count = f"{len(odd)} of the first {len(cells)} cells are"
            lines.append(
                f"whether '{name}' of {log} belongs to '{like}', as its name suggests: {count} no "
                f"numbers, such as '{example}', so it is left out; write plain numbers in the log "
                "and propose again"
            )
        else:
            others.append(f"{name} (such as '{example}')")
    if others:
        lines.append(
            f"what these columns of {log} are: {listed(others, _NAMED)}; they hold text "
            "and are left out; a column that labels the parts of the protocol can be `block`"
        )
    return lines


def _stem(name: str) -> str:
    """Return a name without numbers and axes, and without a number in brackets."""
    return _AXIS.sub("#", without_numbers(re.sub(r"[(\[{](\d+)[)\]}]$", r"\1", name.lower())))
