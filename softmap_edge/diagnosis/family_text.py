"""Describe the findings on two levels: each family, its law, and the share of both.

A line for people (`Memory: backlash, gap 1.39 mm on channel 0 and 0.77 mm on channel 1`) and the
facts about it. Reports use it (`report/families.py`). Documents of schema 1 hold no families.
Pinned by tests/report/test_loop_figure.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from softmap_edge.files.atomic import Document
from softmap_edge.files.numbers import folded, mm, number, percent, tamed

LEARNED = "Learned with the model: present in the robot at that time"
TITLE = "What the model lacks: the family of effects, then its law"
Row = Document


def family_line(row: Row, findings: Sequence[Row]) -> str:
    """Return a detected family and its law as one line.

    Args:
        row: an entry of `families` of a diagnosis document.
        findings: the entries of `effects` and `faults`, for the fitted parameters of the law.

    Returns:
        str: no line break, no full stop.
    """
    name, effects = str(row.get("name", "?")), [str(one) for one in row.get("effects") or []]
    law = row.get("law")
    if law == "unknown":
        return f"Unknown law of the family {name}"
    if law == "open":
        fits = [*effects, *map(str, row.get("generic") or [])]
        what = "Static, non-linear map of the commands" if name == "static map" else _capital(name)
        return f"{what}; law open" + (f": {', '.join(fits)}" if fits else "")
    known = {str(one.get("name")): one for one in findings}
    laws = [_law(one, known[one].get("params") or {}) for one in effects if one in known]
    alike = [one for one in effects if one not in known]
    return (
        f"{_capital(name)}: "
        f"{', or '.join([*([' and '.join(laws)] if laws else []), *alike]) or '?'}"
    )


def _capital(name: str) -> str:
    return name[:1].upper() + name[1:]


def _law(effect: str, params: Mapping[str, Row]) -> str:
    """Return an effect with its parameters.

    For example 'backlash, gap 1.39 mm on channel 0 and 0.77 mm on channel 1'.
    """
    groups: dict[str, list[str]] = {}
    for label, value in params.items():
        name, _, index = label.split(".")[-1].partition("[")
        unit = "" if value.get("unit") in (None, "1") else f" {value['unit']}"
        channel, side = index.rstrip("+-]"), index.rstrip("]")[-1:]
        cable = f"the {side} cable of " if side in ("+", "-") else ""
        on = f" on {cable}channel {channel}" if index else ""
        groups.setdefault(name, []).append(f"{mm(value.get('value'))}{unit}{on}")
    return ", ".join(
        [effect, *(f"{name} {' and '.join(values)}" for name, values in groups.items())]
    )


def family_facts(row: Row, unit: str) -> list[str]:
    """Return the facts about a family, besides its line: shares, displacement, alternatives."""
    facts = [f"{percent(row.get('share'))} of the explained error"]
    if number(row.get("moved_mm")) is not None:
        facts.append(f"{mm(row['moved_mm'])} {unit} RMS (fitted)")
    if number(row.get("law_share")) is not None:
        which = "its law" if row.get("law") == "identified" else "the best known law"
        facts.append(f"{which} explains {percent(row['law_share'])} of what the family can do")
    if others := [str(one) for one in row.get("alternatives") or []]:
        facts.append(f"cannot be distinguished here from: {', '.join(others)}")
    return facts


def family_lines(document: Document, unit: str) -> list[str]:
    """Return the section on families of a report for a terminal; none if none was detected."""
    rows = document.get("families") or []
    lines = ["", TITLE] if rows else []
    for row in rows:
        first, *rest = folded(family_line(row, findings_of(document)), 4)
        lines += [f"  · {first.lstrip()}", *rest, *folded(" · ".join(family_facts(row, unit)), 6)]
    return lines


def learned_line(row: Row) -> str:
    """Return an effect that the model was learned with as one line.

    Args:
        row: an entry of `learned_in` of a diagnosis document.

    Returns:
        str: 'backlash, gap 1.40 mm (memory, identified); alternatives: hysteresis'.
    """
    if row.get("law") == "unknown":
        return tamed(f"unknown law of {row.get('family', '?')}, not in the model")
    params = {str(one.get("label")): one for one in row.get("params") or []}
    others = [
        str(one.get("name") or f"an unknown law of {one.get('family')}")
        for one in row.get("alternatives") or []
    ]
    line = (
        f"{_law(str(row.get('name', '?')), params)} ({row.get('family', '?')}, "
        f"{row.get('law', '?')})"
    )
    return tamed(line + (f"; alternatives: {', '.join(dict.fromkeys(others))}" if others else ""))


def findings_of(document: Document) -> list[Row]:
    """Return the entries of `effects` and `faults` of a diagnosis document."""
    return [*(document.get("effects") or []), *(document.get("faults") or [])]
