"""A diagnosis as text for a terminal: verdict, effects with numbers, rivals, the error ladder, what cannot be told."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from softmap_edge.diagnosis import Diagnosis

BAR = 30  # characters of the longest bar
HEADLINES = {
    "identified": "IDENTIFIED",
    "ambiguous": "AMBIGUOUS",
    "partly_explained": "PARTLY EXPLAINED",
    "nothing": "NOTHING ABOVE THE FLOOR",
    "cannot_tell": "THESE DATA CANNOT TELL",
    "measurement_fault": "MEASUREMENT FAULT",
}


def diagnosis_text(diagnosis: Diagnosis) -> str:
    """Return the report of a diagnosis as lines of text."""
    lines = [HEADLINES[diagnosis.verdict], *_wrapped(diagnosis.sentence), ""]
    for entry in [*diagnosis.effects, *diagnosis.faults]:
        lines += _effect(entry)
    if diagnosis.rivals:
        lines.append("rivals not ruled out")
        lines += [f"  {' + '.join(r['effects'])}: {r['why']}" for r in diagnosis.rivals]
        lines.append("")
    lines += _ladder(diagnosis.error)
    left = diagnosis.unexplained
    by = f", predicted by {left['predicted_by']}" if left["predicted_by"] else ""
    lines += [
        "",
        f"left over: {left['rms_mm']:.2f} mm beyond the noise, chi2/n {left['chi2_per_n']:.2f}, "
        f"blocked R2 {left['blocked_r2']:.2f}{by}",
    ]
    if diagnosis.not_testable:
        lines += ["", "these data cannot show"]
        lines += [f"  {h['name']}: {h['why']}; try: {h['experiment']}" for h in diagnosis.not_testable]
    return "\n".join(lines)


def _effect(entry: dict[str, Any]) -> list[str]:
    moved = entry["displacement_mm"]
    held = "" if moved["held_out"] is None else f", {moved['held_out']:.2f} mm on the independent run"
    lines = [
        f"{entry['name']}  ({entry['family']}, probability {entry['probability']:.2f}, "
        f"share {100 * entry['share']:.0f} %, moves the centreline by {moved['fitted']:.2f} mm{held})"
    ]
    for label, p in entry["params"].items():
        bound = "  at a bound" if p["at_bound"] else ""
        lines.append(f"  {label:<24} {p['value']:>10.4g} ± {p['sigma']:.2g} {p['unit']}{bound}")
    return [*lines, ""]


def _ladder(error: dict[str, Any]) -> list[str]:
    rows = [("model alone", error["model"]), ("static residual only", error["static_residual"])]
    rows += [(f"+ {step['added']}", step["value"]) for step in error["ladder"]]
    rows += [("+ static residual", error["with_static_residual"]), (f"floor ({error['floor_kind']})", error["floor"])]
    top = max(value for _, value in rows) or 1.0
    width = max(len(name) for name, _ in rows)
    lines = [f"held-out error, mm RMS over the places, on {error.get('held_out_on', 'held-out frames')}"]
    for name, value in rows:
        lines.append(f"  {name:<{width}} {value:7.3f}  {'█' * max(1, round(BAR * value / top))}")
    return lines


def _wrapped(text: str, width: int = 100) -> list[str]:
    lines, line = [], ""
    for word in text.split():
        if line and len(line) + len(word) + 1 > width:
            lines.append(line)
            line = word
        else:
            line = f"{line} {word}".strip()
    return [*lines, line]
