"""Find logs that are parts of one log: files with equal columns that are consecutive in time.

Files with equal columns that overlap in time are separate logs or other recordings of the same
robot. They stay separate, and the answer lists them. Pinned by tests/logs/test_csv_parts.py.
"""

from __future__ import annotations

import fnmatch
import glob
import os
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from softmap_edge.logs.guess_sheets import ROWS, Sheet
from softmap_edge.logs.guess_time import TimeFound, time_of
from softmap_edge.logs.numbered import without_numbers


def joined_parts(sheets: Sequence[Sheet]) -> tuple[list[Sheet], list[str], list[str]]:
    """Return the sheets, with the parts of one log joined into one sheet.

    Args:
        sheets: the first rows of each log.

    Returns:
        The sheets, sentences on what was joined, and sentences on overlapping logs.
    """
    found: list[Sheet] = []
    notes: list[str] = []
    apart: list[str] = []
    for group in _alike(sheets):
        times = [time_of(sheet, alone=False) for sheet in group]
        order = _order(group, times)
        if order is None:
            found += group
            apart += _overlap(group, times)
            continue
        others = [sheet.path.name for sheet in sheets if all(sheet is not one for one in group)]
        found.append(_one([group[k] for k in order], others))
        names = " and ".join(group[k].path.name for k in order)
        notes.append(
            f"{names[:300]}: the same columns, one after another in time, so they are parts of "
            "one log"
        )
    return found, notes, apart


def _alike(sheets: Sequence[Sheet]) -> list[list[Sheet]]:
    """Return the sheets in groups of equal columns, each at its first position."""
    count = [sum(other.path == sheet.path for other in sheets) for sheet in sheets]
    found: dict[object, list[Sheet]] = {}
    for k, sheet in enumerate(sheets):
        alone = sheet.topic is not None or sheet.episode is not None or count[k] > 1
        clocks = tuple(sorted(sheet.clocks.items()))
        found.setdefault(k if alone else (sheet.header, *sheet.names, clocks), []).append(sheet)
    return list(found.values())


def _order(group: Sequence[Sheet], times: Sequence[TimeFound]) -> list[int] | None:
    """Return the order of the parts of one log; None if they are not parts."""
    if len(group) < 2 or not times[0].columns:
        return None
    if any((one.columns, one.unit) != (times[0].columns, times[0].unit) for one in times):
        return None
    spans = [(float(np.nanmin(one.seconds)), float(np.nanmax(one.seconds))) for one in times]
    order = sorted(range(len(group)), key=lambda k: spans[k])
    apart = all(spans[k][1] <= spans[later][0] for k, later in zip(order, order[1:]))
    return order if apart else None


def _overlap(group: Sequence[Sheet], times: Sequence[TimeFound]) -> list[str]:
    """Return the sentence on equally named logs that overlap in time; empty for a single log."""
    if len(group) < 2 or not group[0].header or not times[0].columns:
        return []
    names = " and ".join(sheet.path.name for sheet in group)
    return [
        f"{names[:300]} have the same columns and overlap in time, so they are not parts of one "
        "log: if they are runs of one robot, import each by itself, then join the runs with "
        "`softmap run join`"
    ]


def _one(group: Sequence[Sheet], others: Sequence[str]) -> Sheet:
    """Return the parts of one log as one sheet, up to the number of rows examined."""
    taken: list[Sheet] = []
    for sheet in group:
        if sum(len(one.numbers) for one in taken) < ROWS:
            taken.append(sheet)
    numbers = np.concatenate([one.numbers for one in taken])[:ROWS]
    pattern = _pattern([sheet.path.name for sheet in group], others)
    first = replace(group[0], numbers=numbers, parts=len(group))
    if pattern is None:
        return replace(first, more=tuple(sheet.file for sheet in group[1:]))
    return replace(first, path=first.path.with_name(pattern), file=pattern)


def _pattern(names: Sequence[str], others: Sequence[str]) -> str | None:
    """Return a pattern that matches these file names and none of the others; else None."""
    by_number = {without_numbers(glob.escape(name), "*") for name in names}
    start = os.path.commonprefix(list(names))
    end = os.path.commonprefix([name[len(start) :][::-1] for name in names])[::-1]
    patterns: list[str] = list(by_number) if len(by_number) == 1 else []
    for pattern in [*patterns, f"{glob.escape(start)}*{glob.escape(end)}"]:
        fits = [fnmatch.fnmatch(name, pattern) for name in (*names, *others)]
        if all(fits[: len(names)]) and not any(fits[len(names) :]):
            return pattern
    return None
