"""The sections of a page on families: what the diagnosis detected, and what the model was learned with.

Pinned by tests/report/test_loop_figure.py and tests/diagnosis/test_taught.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from softmap_edge.diagnosis.family_text import LEARNED, TITLE, family_line, findings_of, learned_line
from softmap_edge.files.numbers import mm, percent
from softmap_edge.report.style import escaped, section
from softmap_edge.run.in_unit import PLACES

PAGE_NOTE = (
    "A family holds all effects that depend on the same inputs. Its share is its part of the explained error. The "
    "law's share compares the best known law with the flexible representative of the family."
)


def learned_section(document: Mapping[str, Any]) -> str:
    """Return the section of a page on what the model was learned with; nothing where there is none."""
    rows = document.get("learned_in") or []
    inner = "".join(f"<li>{escaped(learned_line(row))}</li>" for row in rows)
    return section(LEARNED, f"<ul>{inner}</ul>", "") if rows else ""


def family_section(document: Mapping[str, Any], unit: str) -> str:
    """Return the section on families of a page; nothing where none was detected."""
    rows = document.get("families") or []
    if not rows:
        return ""
    titles = (
        "family and law", "share of the<br>explained error", "the law explains<br>of the family",
        f"moves {'the body' if unit == PLACES else 'the output'},<br>{escaped(unit)} RMS, fitted",
        "cannot be distinguished<br>here from",
    )  # fmt: skip
    head = "".join(f"<th>{title}</th>" for title in titles)
    body = "".join(
        f"<tr><td><b>{escaped(family_line(row, findings_of(document)))}</b></td><td>{percent(row.get('share'))}</td>"
        f"<td>{percent(row.get('law_share'))}</td><td>{mm(row.get('moved_mm'))}</td>"
        f"<td>{escaped(', '.join(map(str, row.get('alternatives') or [])) or 'none')}</td></tr>"
        for row in rows
    )
    return section(TITLE, f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>", PAGE_NOTE)
