"""Find the markers of a proposed mapping: places, base, unit, likelihood, and labels of blocks.

What is left out, and what the log does not show, is added to the findings. Pinned by
tests/logs/test_guess.py, tests/logs/test_likelihood.py and tests/logs/test_relative_places.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from softmap_edge.files.printable import listed
from softmap_edge.logs.flags import REASON
from softmap_edge.logs.guess_bare import places_by_value
from softmap_edge.logs.guess_columns import label_of, length_unit, points_of, stated_of
from softmap_edge.logs.guess_sheets import Sheet
from softmap_edge.logs.guess_text import Found
from softmap_edge.logs.left_out import by_reason, no_place, no_role, worth
from softmap_edge.logs.likelihood import PIXEL_WORDS
from softmap_edge.logs.mapping import LENGTH, LIKELIHOOD, PIXEL
from softmap_edge.logs.never_seen import at_one_number, never_seen
from softmap_edge.logs.not_seen import not_seen
from softmap_edge.logs.plausible import frame_of, is_base, is_relative
from softmap_edge.logs.triples import LeftOut, Triples
from softmap_edge.logs.unit_words import LENGTH_WORDS, unit_in_name

Array = NDArray[np.float64]


def find_points(sheets: list[Sheet], found: Found) -> None:
    """Add the markers of the logs, their base and their unit to the findings."""
    each = [
        (points_of(sheet) if sheet.header else _bare_places(sheets, found, k), sheet)
        for k, sheet in enumerate(sheets)
    ]
    found.left = [(sheet, one) for triples, sheet in each for one in triples.left]
    found.unknown += [
        no_role(sheet.called, one) if one.why == REASON else no_place(sheet.called, one)
        for sheet, one in by_reason(found.left)
    ]
    best, sheet = max(each, key=worth)
    triples = _seen_places(sheet, best.places, found)
    if not triples:
        found.unknown.append(
            "where the markers are: no columns named x, y, z of a place; nothing is seen in this "
            "run"
        )
        return
    found.base = [triple for triple in triples if is_base(triple[0])]
    triples = [triple for triple in triples if triple not in found.base]
    _leave_other_frame(sheet, triples, found)
    if not triples:
        triples, found.base = found.base, []
    unit, why = _unit(sheet, triples, best, found)
    found.points = (sheet, triples, unit)
    _add_scales(sheet, triples, unit, found)
    found.assumed.append(
        f"markers: {len(triples)} of {sheet.called}, in the order of the columns, base first; {why}"
    )
    _add_assumed(sheet, triples, best, found)
    found.label = label_of(sheet)
    if found.label is not None:
        found.assumed.append(
            f"blocks: '{found.label}' names the part of the protocol; folds are cut by it"
        )


def _unit(sheet: Sheet, triples: list[list[str]], best: Triples, found: Found) -> tuple[str, str]:
    """Return the unit of markers and its reason; one that is not known is added to the findings."""
    flat = [name for triple in triples for name in triple]
    named = LENGTH_WORDS.get(unit_in_name(flat[0], LENGTH_WORDS) or "")
    odd = None if named else stated_of(sheet, flat[0], LENGTH_WORDS)
    stated = odd is not None and odd.lower() in PIXEL_WORDS
    pictured = stated or (len(triples[0]) == 2 and bool(best.likelihood) and not named)
    if pictured:
        found.unknown.append(
            f"the mm of one pixel: {'the log states px' if stated else 'x, y, likelihood'} of "
            "places in a picture, and a pixel is not a mm. Put the mm of one pixel into scale, from "
            "a length that you know in the picture, and origin_mm in mm; lens distortion is not "
            "corrected"
        )
        return PIXEL, "a tracker of pictures measures in pixels"
    if named:
        return named, f"their names state {named}"
    unit, why = length_unit(places_of(sheet, triples), sheet.units.get(flat[0]))
    if odd is not None:
        found.unknown.append(
            f"the unit of the markers: the log states '{odd}', which is not a unit of places in "
            f"this program: {unit} is written by size alone. Give unit and scale: mm for one "
            f"'{odd}'"
        )
    return unit, why


def _add_scales(sheet: Sheet, triples: list[list[str]], unit: str, found: Found) -> None:
    """Add the factors of columns in another unit than the first one to the findings."""
    flat = [name for triple in triples for name in triple]
    found.scales = _scales(sheet, [*flat, *(name for triple in found.base for name in triple)])
    if found.scales:
        units = ", ".join(dict.fromkeys(_length_of(sheet, name) or unit for name in found.scales))
        found.assumed.append(
            f"markers: {next(iter(found.scales))} and others are in {units}, as the log states; "
            f"they are converted to the unit of {flat[0]}"
        )


def _add_assumed(sheet: Sheet, triples: list[list[str]], best: Triples, found: Found) -> None:
    """Add the likelihoods of the markers, and what is assumed of the markers and their base."""
    found.likelihood = best.likelihood
    if best.likelihood:
        names = list(best.likelihood.values())
        low = sheet.rows_of(names) < LIKELIHOOD
        found.assumed.append(
            f"markers: {', '.join(names[:4])}{' …' * (len(names) > 4)} are likelihoods, "
            f"not coordinates; places below {LIKELIHOOD:g} count as not seen ({int(low.sum())} of "
            f"{low.size} here), which is the limit that DeepLabCut takes"
        )
    if len(triples[0]) == 2:
        found.assumed.append(
            "markers: they lie in a plane, for there is no z; the third coordinate counts as 0 "
            "and as not measured"
        )
    if best.by_size:
        loose = ", ".join(one[0] for one in best.by_size[:4])
        found.assumed.append(
            f"markers: {loose}{' …' * (len(best.by_size) > 4)} and what belongs to it, by size "
            "alone"
        )
    if any(is_relative(one[0]) for one in triples):
        relative = listed((one[0] for one in triples if is_relative(one[0])), 4)
        found.assumed.append(
            f"markers: {relative} are relative to the base by their names, so the base is the "
            "origin of the log. A base that moves is not seen: `mount` and `camera_drift` cannot be "
            "tested"
        )
    if found.base:
        places = " ".join(f"b{k}:X,Y,Z" for k in range(len(found.base)))
        found.assumed.append(
            f"base: {len(found.base)} markers are on the clamp by their names, and measured in the "
            f"same frame as the others; `softmap run align RUN --base {places}` brings the run to "
            "the base by them. Leave `base` out if its frame is another one"
        )


def _leave_other_frame(sheet: Sheet, triples: list[list[str]], found: Found) -> None:
    """Leave markers of the base out if their names state another frame than those of the robot."""
    frames = [{frame_of(place[0]) for place in places} for places in (triples, found.base)]
    if not all(frames) or None in frames[0] | frames[1] or frames[0] & frames[1]:
        return
    own, other = (listed(sorted(filter(None, names)), 3) for names in frames)
    found.unknown.append(
        f"where the base is in the frame of the markers: by their names the markers of "
        f"{sheet.called} are in '{own}' and those of the base in '{other}'. The base is left out; "
        "bring both to one frame, and name its columns in `base`"
    )
    reason = f"places in another frame ('{other}')"
    found.left += [(sheet, LeftOut(tuple(place), reason)) for place in found.base]
    found.base = []


def _length_of(sheet: Sheet, name: str) -> str | None:
    """Return the unit of length that the log states for a column."""
    word = unit_in_name(name, LENGTH_WORDS)
    unit = LENGTH_WORDS[word] if word else sheet.units.get(name)
    return unit if unit in LENGTH else None


def _scales(sheet: Sheet, names: list[str]) -> dict[str, float]:
    """Return the factors of columns that the log states in another unit than the first one."""
    first = _length_of(sheet, names[0])
    units = {name: _length_of(sheet, name) for name in names}
    return {
        name: LENGTH[unit] / LENGTH[first]
        for name, unit in units.items()
        if first is not None and unit is not None and unit != first
    }


def _seen_places(sheet: Sheet, places: list[list[str]], found: Found) -> list[list[str]]:
    """Return the places without those at 0, 0, 0 in every row, which are reported.

    Markers on the clamp stay, since they may be the origin of the log.
    """
    points = [sheet.rows_of(one)[:, None] for one in places]
    gone = [k for k, one in enumerate(places) if len(never_seen(points[k])) and not is_base(one[0])]
    if not gone or len(gone) == len(places):
        return places
    for k in gone:
        what = at_one_number(points[k], [0], [", ".join(places[k])])[0]
        found.unknown.append(
            f"whether this is a place in {sheet.called}: {what}: the marker was never seen, or "
            "is the origin of the log; left out. To keep it, add it to `markers` and set "
            'not_seen = "keep"'
        )
        found.left.append((sheet, LeftOut(tuple(places[k]), "a marker that was never seen")))
    return [one for k, one in enumerate(places) if k not in gone]


def places_of(sheet: Sheet, places: list[list[str]]) -> Array:
    """Return markers (rows, M, 3) from columns, NaN where not seen; z is 0 in a plane."""
    flat = [name for one in places for name in one]
    points = sheet.rows_of(flat).reshape(len(sheet.numbers), len(places), -1)
    points[not_seen(points).mask] = np.nan
    return np.concatenate([points, np.zeros((*points.shape[:2], 3 - points.shape[2]))], axis=2)


def _bare_places(sheets: list[Sheet], found: Found, k: int) -> Triples:
    """Return the positions in a log whose columns have no names."""
    triples = places_by_value(sheets[k], set(found.times[k].columns))
    if triples:
        numbers = ", ".join(" ".join(triple) for triple in triples)
        found.unknown.append(
            f"whether columns {numbers} are places: no line names them, their values look like x, "
            "y, z"
        )
    return Triples(triples)
