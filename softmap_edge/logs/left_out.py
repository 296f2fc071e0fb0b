"""Choose the log with the markers, and list the columns left out of a proposed mapping.

Each of these columns has a reason.
"""

from __future__ import annotations

import numpy as np

from softmap_edge.files.printable import listed
from softmap_edge.logs.guess_sheets import Sheet
from softmap_edge.logs.triples import LeftOut, Triples

_NAMED = 12  # columns of one kind that are listed


def no_place(log: str, one: LeftOut) -> str:
    """Return the remark on columns of a log that resemble a position but are none."""
    return no_role(log, one) + "; name them in `markers` if they are a place"


def no_role(log: str, one: LeftOut) -> str:
    """Return the remark on columns of a log that are left out."""
    return (
        f"what {listed(one.columns, _NAMED)} of {log} are: they look like {one.why}, and are left "
        "out"
    )


def worth(pair: tuple[Triples, Sheet]) -> tuple[int, bool, int]:
    """Return the criteria for the log with the markers: positions in space, motion, number."""
    places = pair[0].places
    flat = [name for one in places for name in one]
    moving = any(
        len(np.unique(values[np.isfinite(values)])) > 1 for values in map(pair[1].column, flat)
    )
    return len(places) and len(places[0]), moving, len(places)


def by_reason(left: list[tuple[Sheet, LeftOut]]) -> list[tuple[Sheet, LeftOut]]:
    """Return columns that were left out, with all quaternions of a log together."""
    found: list[tuple[Sheet, LeftOut]] = []
    for sheet, one in left:
        k = next(
            (k for k, (other, last) in enumerate(found) if other is sheet and last.why == one.why),
            None,
        )
        if k is None or len(one.columns) != 4:
            found.append((sheet, one))
        else:
            found[k] = (sheet, LeftOut((*found[k][1].columns, *one.columns), one.why))
    return found
