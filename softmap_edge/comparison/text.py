"""Write reports of one comparison, or of two side by side, for a terminal.

Text only, no colour, 100 columns.

Bars of one block share a scale, so their lengths are comparable. Every number has its unit, and
every error the data it was measured on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from softmap_edge.comparison.in_unit import comparison_in_unit
from softmap_edge.errors import ReportError
from softmap_edge.files.numbers import BAR, bar, fall, folded, mm, percent
from softmap_edge.run.in_unit import PLACES, unit_of

if TYPE_CHECKING:
    from softmap_edge.comparison.comparison import Comparison
    from softmap_edge.run.conditions import Bin

# Names of the maps in a report.
WHERE = {
    "section": "along the body",
    "direction": "direction of motion",
    "speed": "speed",
    "dwell": "time since the last motion",
    "history": "largest past |command|",
    "command": "command",
    "time": "time",
    "orientation": "orientation",
    "temperature": "temperature",
}


def comparison_text(comparison: Comparison) -> str:
    """Return the report of one comparison: figures first, then the maps of the error.

    Args:
        comparison: the result of `compare`.

    Returns:
        str: lines of at most 100 columns.
    """
    comparison, unit = comparison_in_unit(comparison), unit_of(comparison.made_from)
    error, floor = comparison.error, comparison.noise_floor_mm
    effects = ", ".join(comparison.bundle.get("effects", [])) or "none added"
    lines = [
        f"Model of '{comparison.bundle.get('robot', '?')}' (effects: {effects}) against a run of "
        f"'{comparison.run.get('robot', '?')}', {comparison.frames} frames seen",
        "",
        f"{_distance(unit)}, {unit} (nothing was fitted here)",
    ]
    named = [
        ("rms", "rms_mm"),
        ("median", "median_mm"),
        ("95 %", "p95_mm"),
        ("max", "max_mm"),
        *([("tip rms", "tip_rms_mm")] if unit == PLACES else []),
    ]
    scale = max(error[key] for _, key in named)
    lines += [f"  {label:<12}{mm(error[key]):>7}  {bar(error[key], scale)}" for label, key in named]
    lines.append(f"  {'noise floor':<12}{mm(floor):>7}  {bar(floor or 0.0, scale)}")
    lines += _memoryless_lines(comparison, scale, unit)
    lines += folded(f"floor: {comparison.floor_kind}", 2)
    lines += ["", f"Where the error is (RMS {unit}; full bar = {mm(_top([comparison]))} {unit})"]
    scale = _top([comparison])
    for name, rows in comparison.where.items():
        if len(rows) < 2:
            continue
        lines.append(f"  {WHERE.get(name, name)}")
        for row in rows:
            lines.append(
                f"    {row.label:<26}{mm(row.rms_mm):>7}  {bar(row.rms_mm, scale):<{BAR}}  "
                f"{row.n:>5} frames"
            )
    lines += ["", *_worst_lines(comparison, unit)]
    return "\n".join(line.rstrip() for line in lines)


def pair_text(before: Comparison, after: Comparison) -> str:
    """Return two comparisons of one run side by side on one scale, with the fall of the error.

    Args:
        before, after: comparisons of the same run by two models.

    Returns:
        str: lines of at most 100 columns.

    Raises:
        ReportError: the comparisons are of different runs.
    """
    check_pair(before, after)
    unit = unit_of(before.made_from)
    before, after = comparison_in_unit(before), comparison_in_unit(after)
    floor = before.noise_floor_mm
    old, new = before.error["rms_mm"], after.error["rms_mm"]
    added = [
        name
        for name in after.bundle.get("effects", [])
        if name not in before.bundle.get("effects", [])
    ]
    gone = [
        name
        for name in before.bundle.get("effects", [])
        if name not in after.bundle.get("effects", [])
    ]
    change = "; ".join(
        f"{word}: {', '.join(names)}"
        for word, names in (("added", added), ("removed", gone))
        if names
    )
    lines = [
        f"Two models of '{before.bundle.get('robot', '?')}' on one run, {before.frames} frames "
        "seen, nothing " + "is fitted here" + (f" ({change})" if change else ""),
        "",
        *folded(_pair_sentence(old, new, floor, unit), 0),
        "",
        f"  {unit:<26}{'before':>8}{'after':>8}   {'fall':>6}",
    ]
    for label, key in (
        ("rms", "rms_mm"),
        ("median", "median_mm"),
        ("95 %", "p95_mm"),
        ("max", "max_mm"),
    ):
        lines.append(_pair_row(label, before.error[key], after.error[key]))
    if unit == PLACES:
        lines.append(_pair_row("tip rms", before.error["tip_rms_mm"], after.error["tip_rms_mm"]))
    lines += [f"  {'noise floor':<26}{mm(floor):>8}{mm(floor):>8}"]
    scale = _top([before, after])
    lines += [
        "",
        f"Where (RMS {unit} before, after; █ left, ░ fallen, ▓ risen; full bar = {mm(scale)} "
        f"{unit})",
    ]
    for name, rows in before.where.items():
        partners = {row.label: row for row in after.where.get(name, [])}
        if len(rows) < 2:
            continue
        lines.append(f"  {WHERE.get(name, name)}")
        for row in rows:
            lines.append(_pair_line(row, partners.get(row.label), scale))
    return "\n".join(line.rstrip() for line in lines)


def check_pair(before: Comparison, after: Comparison) -> None:
    """Raise ReportError unless both comparisons are of the same run."""
    first, second = before.run.get("sha256"), after.run.get("sha256")
    if first != second:
        raise ReportError(
            f"before and after are of different runs ({str(first)[:8]}, {str(second)[:8]}); "
            "compare both models on one"
        )


def _memoryless_lines(comparison: Comparison, scale: float, unit: str) -> list[str]:
    """Return the lowest error of all models without memory, and the frames that it is of."""
    floor = comparison.memoryless
    if floor is None:
        return folded("floor without memory: too few repeated poses to estimate it", 2)
    own = "" if floor.error_mm is None else f"; this model has {mm(floor.error_mm)} {unit} there"
    return [
        f"  {'no memory':<12}{mm(floor.mm):>7}  {bar(floor.mm, scale)}",
        *folded(
            "no memory: no model without memory has a smaller error on the frames of repeated "
            f"poses (same command, different shape){own}; {floor.poses} poses in {floor.passages} "
            f"passages, {floor.frames} frames",
            2,
        ),
    ]


def _top(comparisons: Sequence[Comparison]) -> float:
    values = [
        row.rms_mm
        for c in comparisons
        for rows in c.where.values()
        if len(rows) > 1
        for row in rows
    ]
    return max([v for v in values if math.isfinite(v)], default=0.0)


def _distance(unit: str) -> str:
    """The quantity that the figures of a comparison measure."""
    what = "points" if unit == PLACES else "outputs"
    return f"Distance between predicted and measured {what}"


def _worst_lines(comparison: Comparison, unit: str) -> list[str]:
    frame = comparison.worst.get("frame") or {}
    bins = comparison.worst.get("bins") or []
    named = "; ".join(
        f"{WHERE.get(b['where'], b['where'])} {b['label']} ({mm(b['rms_mm'])} {unit})" for b in bins
    )
    lines = folded(f"Worst: {named}." if named else "", 0)
    if frame:
        when = "" if comparison.made_from.get("timeless") else f" at {frame['t_s']:.2f} s"
        lines += folded(
            f"Worst frame: number {frame['index']}{when}, {mm(frame['rms_mm'])} {unit} RMS.", 0
        )
    return lines


def _pair_sentence(old: float, new: float, floor: float | None, unit: str) -> str:
    if new > old:
        return (
            f"The error ROSE from {mm(old)} to {mm(new)} {unit} RMS: the second model is worse on "
            "this run."
        )
    text = f"The error falls from {mm(old)} to {mm(new)} {unit} RMS"
    if floor and new > floor:
        return f"{text}; {percent(fall(old, new, floor))} of the removable error is gone."
    return f"{text} ({percent(fall(old, new))})."


def _pair_row(label: str, old: float, new: float) -> str:
    return f"  {label:<26}{mm(old):>8}{mm(new):>8}   {percent(fall(old, new)):>6}"


def _pair_line(row: Bin, partner: Bin | None, scale: float) -> str:
    """One bin before and after on one line: solid is unchanged, light removed, dark added."""
    after = math.nan if partner is None else partner.rms_mm
    both = (
        bar(max(row.rms_mm, after), scale, 40)
        if math.isfinite(after)
        else bar(row.rms_mm, scale, 40)
    )
    kept = len(bar(min(row.rms_mm, after), scale, 40)) if math.isfinite(after) else 0
    shown = "█" * kept + ("▓" if after > row.rms_mm else "░") * (len(both) - kept)
    return f"    {row.label:<24}{mm(row.rms_mm):>8}{mm(after):>8}   {shown}"
