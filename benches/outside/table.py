"""Write the table of outside data, one row per held-out run, as JSON and in Markdown."""

from __future__ import annotations

import json
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from benches.outside.case import Case, text
from benches.outside.ours import Answer
from softmap_edge.version import __version__

SCHEMA = "softmap.outside_bench/1"
PEERS = {
    "trees": "boosted trees, lags",
    "process": "Gaussian process, lags",
    "network": "static network",
    "sindy": "pySINDy, memory",
}


@dataclass(frozen=True)
class Row:
    """The results on one data set: our answer, and the others' held-out errors.

    Errors are by name and held-out run.
    """

    name: str
    unit: str
    expected: str
    law_name: str
    answer: Answer
    peers: dict[str, dict[str, float]]
    law: dict[str, float]
    library: dict[str, dict[str, float]]


def document(rows: Sequence[Row], skipped: dict[str, str]) -> str:
    """Return the figures as JSON without times, so that equal figures give equal text."""
    body = [_plain(asdict(row)) for row in rows]
    return (
        json.dumps(
            {"schema": SCHEMA, "softmap-edge": __version__, "rows": body, "skipped": skipped},
            indent=1,
        )
        + "\n"
    )


def _plain(row: dict) -> dict:
    row["answer"] = {
        key: value for key, value in row["answer"].items() if key not in ("document", "seconds")
    }
    return row


def lines(rows: Sequence[Row]) -> list[str]:
    """Return the table in Markdown, one line per held-out run."""
    head = [
        "data",
        "held out",
        "unit",
        "our answer",
        "before",
        "after",
        *PEERS.values(),
        "right law by hand",
    ]
    found = [_line(head), _line(["---"] * 4 + ["---:"] * (len(head) - 4))]
    for row in rows:
        for k, (which, before) in enumerate(row.answer.before.items()):
            others = [_figure(row.peers.get(name, {}).get(which)) for name in PEERS]
            first = (
                [row.name, which, row.unit, _said(row.answer)]
                if k == 0
                else ["", which, row.unit, ""]
            )
            after = row.answer.after[which] if row.answer.verdict != "–" else None
            found.append(
                _line(
                    [*first, _figure(before), _figure(after), *others, _figure(row.law.get(which))]
                )
            )
    return found


def _said(answer: Answer) -> str:
    if answer.verdict == "–":
        return "–"
    families = "" if answer.families == "–" else f"families: {answer.families}; "
    return f"**{answer.verdict}**: {families}{answer.names} (learned: {answer.learned})"


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _figure(value: float | None) -> str:
    """Format an error with three significant digits."""
    return (
        "–"
        if value is None
        else f"{value:.3f}"
        if value < 1
        else f"{value:.2f}"
        if value < 10
        else f"{value:.1f}"
    )


def page(rows: Sequence[Row], cases: dict[str, Case], skipped: dict[str, str]) -> str:
    """Return the page docs/benchmarks/outside.md."""
    found = text("page") + "\n\n" + "\n".join(lines(rows)) + "\n"
    if skipped:
        found += (
            "\nSkipped: " + "; ".join(f"{name} ({why})" for name, why in skipped.items()) + ".\n"
        )
    for row in rows:
        found += f"\n## {row.name}\n\n{cases[row.name].about}\n\n{_paragraph(row)}\n"
        if row.library:
            found += (
                "\nEach memory law of the library with a refitted static map, held-out NRMSE:\n\n"
                + "\n".join(_library(row))
                + "\n"
            )
    return found


def _paragraph(row: Row) -> str:
    right = f"Right answer: {row.expected}. " if row.answer.verdict != "–" else ""
    said = f"Our answer: {_said(row.answer)}. " if row.answer.verdict != "–" else ""
    return f"{right}{said}By hand: {row.law_name}."


def _library(row: Row) -> list[str]:
    names = list(row.answer.before)
    found = [_line(["law", *names]), _line(["---", *["---:"] * len(names)])]
    order = sorted(row.library, key=lambda name: row.library[name][names[0]])
    return found + [
        _line([name, *(_figure(row.library[name][which]) for which in names)]) for name in order
    ]


def machine() -> str:
    """Return the software and machine behind the figures, for the terminal."""
    return f"softmap-edge {__version__}, Python {platform.python_version()}, {platform.machine()}"
