"""Open points of a diagnosis as HTML: servos, alternatives, effects that are not testable, what to record next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from softmap_edge.diagnosis.text import alternative_name, servo_row, untestable_rows
from softmap_edge.files.numbers import mm, number, tamed
from softmap_edge.report.style import escaped
from softmap_edge.run.in_unit import unit_of


def open_questions(found: Mapping[str, Any]) -> str:
    """Return the part of a page on what a diagnosis document leaves open; nothing where there is none."""
    sets = found.get("alternatives") or []
    alternatives = [(alternative_name(row), tamed(row.get("why", ""))) for row in sets]
    rows = untestable_rows(found)
    untestable = [(names, f"{why} — {experiment}" if experiment else why) for names, why, experiment in rows]
    steps = [(f"{row.get('block', '?')}", _settles(row)) for row in found.get("next") or []]
    parts = [
        _definitions("Servos: between command and encoder", [servo_row(row) for row in found.get("servo") or []]),
        _definitions("Alternatives: other explanations of these data", alternatives),
        _definitions("Not testable with these data", untestable),
        _definitions("Next experiment", steps),
        _remarks(found.get("remarks") or []),
        _unexplained(found.get("unexplained") or {}, unit_of(found.get("made_from") or {})),
    ]
    inner = "".join(part for part in parts if part)
    return f'<div class="columns">{inner}</div>' if inner else ""


def _settles(row: Mapping[str, Any]) -> str:
    settles, apart = row.get("settles"), number(row.get("separation"))
    named = ", ".join(map(str, settles)) if isinstance(settles, (list, tuple)) else str(settles or "")
    time = "" if (minutes := number(row.get("minutes"))) is None else f"{minutes:g} min: "
    return f"{time}settles {named}" + ("" if apart is None else f"; expected separation {apart:.3g} (chi², simulated)")


def _definitions(title: str, rows: Sequence[tuple[Any, Any]]) -> str:
    if not rows:
        return ""
    inner = "".join(f"<dt>{escaped(term)}</dt><dd>{escaped(meaning)}</dd>" for term, meaning in rows)
    return f"<section><h2>{escaped(title)}</h2><dl>{inner}</dl></section>"


def _remarks(rows: Sequence[str]) -> str:
    if not rows:
        return ""
    inner = "".join(f"<li>{escaped(tamed(row))}</li>" for row in rows)
    return f"<section><h2>About the run</h2><ul>{inner}</ul></section>"


def _unexplained(left: Mapping[str, Any], unit: str) -> str:
    if not left:
        return ""
    by = left.get("predicted_by")
    named = ", ".join(map(str, by)) if isinstance(by, (list, tuple)) else str(by or "nothing that was tried")
    chi, share = number(left.get("chi2_per_n")), number(left.get("blocked_r2"))
    rows = [
        ("size", f"{mm(left.get('rms_mm'))} {unit} RMS beyond the noise, fitted"),
        ("against the noise", "–" if chi is None else f"chi² per number {chi:.3g} (1 is noise alone), fitted"),
        ("predictable share", "–" if share is None else f"R² {share:.2g} on held-out blocks"),
        ("follows", named),
    ]
    return _definitions("Unexplained error", rows)
