"""Write a proposed mapping as commented TOML."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.files.printable import one_line
from softmap_edge.files.toml import quoted
from softmap_edge.logs.guess_columns import Role
from softmap_edge.logs.guess_sheets import Sheet
from softmap_edge.logs.guess_time import TimeFound, cell
from softmap_edge.logs.mapping import ANGLE, FILE, LENGTH, LIKELIHOOD, PIXEL, SCHEMA
from softmap_edge.logs.triples import LeftOut

Array = NDArray[np.float64]
MANY = 5000  # frames: enough for a diagnosis; more take longer
SEEN_HZ = 20


@dataclass
class Found:
    """The findings so far."""

    assumed: list[str] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)
    command: tuple[Sheet, Role] | None = None
    present: tuple[Sheet, Role] | None = None
    others: list[tuple[Sheet, Role]] = field(default_factory=list)
    points: tuple[Sheet, list[list[str]], str] | None = None
    base: list[list[str]] = field(default_factory=list)  # markers on the clamp
    # triples of columns that are not a position
    left: list[tuple[Sheet, LeftOut]] = field(default_factory=list)
    # factor to the unit of the markers, for columns of places that the log states in another unit
    scales: dict[str, float] = field(default_factory=dict)
    # the column with the likelihood of each place, by its first column
    likelihood: dict[str, str] = field(default_factory=dict)
    label: str | None = None
    times: dict[int, TimeFound] = field(default_factory=dict)


def mapping_text(sheets: list[Sheet], found: Found, frame: list[str]) -> str:
    """Return the mapping, with the lines of the marker frame."""
    files = len({sheet.file for sheet in sheets}) + any(sheet.parts > 1 for sheet in sheets)
    lines = [f'schema = "{SCHEMA}"', '# robot = "…"   # a name']
    unit = found.command[1].unit if found.command is not None else None
    if unit is not None and unit not in (*LENGTH, "ticks"):
        note = "" if unit in ANGLE else "   # UNKNOWN: as the log states it"
        lines.append(f"command_unit = {quoted(unit)}{note}")
    if unit == "ticks":
        lines.append(
            'command_unit = "ticks"   # of a model that is learned; `softmap model calibrate` '
            "takes them as well"
        )
    if any(time.calendar for time in found.times.values()):
        lines.append("zero_time = true   # the log counts from a date, or from midnight")
    for k, sheet in enumerate(sheets):
        inside = _inside(sheet, found)
        if inside:
            for file in (sheet.file, *sheet.more):
                one = replace(sheet, file=file)
                lines += ["", "[[log]]", *_head(one, files), found.times[k].line, *inside]
    if found.points is not None:
        lines += frame
        sheet = found.points[0]
        t = seconds(sheets, found, sheet)
        rate = (len(t) - 1) / max(float(t[-1] - t[0]), 1e-9)
        if (
            len(t) > MANY
            and rate > 1.2 * SEEN_HZ
            and not any(time.unit == "none" for time in found.times.values())
        ):
            lines += [
                "",
                "[seen]",
                f"rate_hz = {SEEN_HZ}   # enough for a diagnosis; leave it out to keep every frame",
            ]
        if found.label is None:
            lines += [
                "",
                "[blocks]",
                "count = 5   # folds of equal time; a column of labels (block = …) is better",
            ]
        lines += [
            "",
            "[constant]",
            "# gravity = [0.0, 0.0, 1.0]   # UNKNOWN: hanging (0, 0, 1), standing (0, 0, -1)",
            "# marker_rest_mm = [[0.0, 0.0, 0.0], …]   # UNKNOWN: each marker on the resting robot, "
            "base frame; models without markers of their own need it",
        ]
        lines += [
            "# sigma_mm = 0.1   # noise of a marker coordinate, if you know it",
            "# load_g = 0.0   # known mass at the tip",
        ]
    return "\n".join(lines) + "\n"


def _head(sheet: Sheet, files: int) -> list[str]:
    lines = [f"file = {quoted(sheet.file)}"] if files > 1 else []
    lines += [] if sheet.topic is None else [f"topic = {quoted(sheet.topic)}"]
    if sheet.episode is not None:
        lines.append(
            f"episode = {sheet.episode}   # ASSUMED: the first of the file; each episode is a run "
            "of its own"
        )
    if sheet.below:
        what = one_line(sheet.below[0].strip()[:40])
        lines.append(f"skip_last_rows = {len(sheet.below)}   # no rows: '{what}'")
    lines += [] if sheet.pivot is None else [sheet.pivot.line()]
    return lines + ([] if sheet.header else ["header = false   # columns are numbers from 0"])


def _inside(sheet: Sheet, found: Found) -> list[str]:
    lines = []
    for kind, pair in (
        ("command", found.command),
        ("present", found.present),
        *((r.kind, (s, r)) for s, r in found.others),
    ):
        if pair is not None and pair[0] is sheet:
            stated = f", unit = {quoted(pair[1].unit)}" if pair[1].unit else ""
            lines.append(
                f"{kind} = {{ columns = "
                f"[{', '.join(cell(sheet, c) for c in pair[1].columns)}]{stated} }}"
            )
    if found.points is not None and found.points[0] is sheet:
        _, triples, unit = found.points
        for kind, places in (("markers", triples), ("base", found.base)):
            rows = [
                f"    [{', '.join(cell(sheet, name) for name in triple)}]," for triple in places
            ]
            scale = _scale(found, unit, [name for triple in places for name in triple])
            question = "   # UNKNOWN: scale, the mm of one pixel" * (unit == PIXEL)
            likely = [found.likelihood[place[0]] for place in places if found.likelihood]
            columns = ", ".join(cell(sheet, name) for name in likely)
            least = f", likelihood = [{columns}], least_likelihood = {LIKELIHOOD:g}" * bool(likely)
            first = f'{kind} = {{ unit = "{unit}", {scale}columns = [{question}'
            lines += [first, *rows, f"]{least} }}"] if rows else []
        lines += [] if found.label is None else [f"block = {cell(sheet, found.label)}"]
    return lines


def _scale(found: Found, unit: str, names: list[str]) -> str:
    """Return the key `scale` of places in several units; empty for one unit."""
    if unit == PIXEL:
        return "scale = 1.0, "
    factors = [found.scales.get(name, 1.0) for name in names]
    if unit == FILE or set(factors) <= {1.0}:
        return ""
    return f"scale = [{', '.join(f'{factor:g}' for factor in factors)}], "


def seconds(sheets: list[Sheet], found: Found, sheet: Sheet) -> Array:
    """Return the times (T,) s of the rows of a sheet."""
    return found.times[next(k for k, other in enumerate(sheets) if other is sheet)].seconds
