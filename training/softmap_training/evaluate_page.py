"""Write the HTML page of `softmap evaluate`: tables, shapes over clouds, errors, costs.

The tables include the paper's figures.

Its text is in `templates/evaluation.html`; it has the frame of all reports
(`softmap_edge/report/pages.py`).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.files.atomic import write_atomically
from softmap_edge.files.numbers import mm
from softmap_edge.report.pages import Card, Picture, pictures_missing, render
from softmap_training.evaluate import Row
from softmap_training.evaluate_text import (
    COLUMN_TITLES,
    MEANING,
    PAPER,
    RECORDED,
    SIMULATED,
    cell,
    cost,
    samples,
    there,
    title,
)

Document = Mapping[str, Any]

TEMPLATES = Path(__file__).with_name("templates")
OTHER = "grey: the paper's figures, of other data"


@dataclass(frozen=True)
class Cell:
    """A table cell; `note` is small text below, `grey` makes the cell small."""

    text: str
    note: str = ""
    grey: bool = False


@dataclass(frozen=True)
class TableRow:
    """A row of a table: its heading and its cells."""

    name: str
    cells: list[Cell]
    note: str = ""
    grey: bool = False


@dataclass(frozen=True)
class Table:
    """A table of the page."""

    head: list[str]
    rows: list[TableRow]


@dataclass(frozen=True)
class Section:
    """A section of the page: a figure, a table or both, with a note below."""

    title: str
    note: str = ""
    table: Table | None = None
    picture: Picture | None = None


@dataclass(frozen=True)
class EvaluationPage:
    """The data of `templates/evaluation.html`; `install` states how to get missing figures."""

    heading: str
    about: str
    cards: list[Card]
    install: str | None
    warnings: list[str]
    sections: list[Section]
    origin: str
    title: str = "Evaluation"
    badge: str = ""


def write_page(
    path: str | Path,
    document: Document,
    simulated: Sequence[Row],
    recorded: Sequence[Row],
    curve: Sequence[Row],
    t_seen: NDArray[np.float64] | None,
) -> Path:
    """Write the page of a document softmap.evaluation/1 and its rows.

    Args:
        path: the file to write.
        document, simulated, recorded, curve: the results of `softmap evaluate`.
        t_seen: (K,) s of the recording's frames.
    """
    install = pictures_missing()
    figures = None
    if install is None:
        from softmap_training import evaluate_figures as figures
    sections: list[Section] = []
    if recorded and t_seen is not None:
        sections += _recorded(document, recorded, curve, t_seen, figures)
    if simulated:
        sections += _simulated(document, simulated, figures)
    seeds = document["made_from"]["seeds"]
    page = EvaluationPage(
        heading=_sentence(document),
        about=f"{len(seeds)} seed{'s' * (len(seeds) > 1)} of what is fitted here; "
        "mean ± standard deviation over frames",
        cards=_cards(document),
        install=install,
        warnings=list(document["warnings"]),
        sections=[*sections, _costs(document)],
        origin=json.dumps(document["made_from"], indent=1, ensure_ascii=False, sort_keys=True),
    )
    target = Path(path)
    write_atomically(target, render("evaluation.html", page, TEMPLATES))
    return target


def _cards(document: Document) -> list[Card]:
    rows = []
    best = min(document["simulated"], key=lambda row: row["vertex_mm"]["mean"], default=None)
    if best is not None:
        value = f"{mm(best['vertex_mm']['mean'])} mm"
        rows.append(Card("best on simulated shapes", value, f"vertex; {best['name']}", "after"))
    main = _main(document)
    for row in document["falls"]:
        if row["what"] == "without residual":
            share = row[f"{main}_share"]
            label = f"{main} error with {row['name']}"
            paper = _change(row["paper_chamfer_share"])
            note = (
                f"against {row['against']}; chamfer {_change(row['chamfer_share'])} (the paper, "
                f"other data: {paper})"
            )
            rows.append(Card(label, _change(share), note, "after" if share > 0 else "before"))
    return rows


def _sentence(document: Document) -> str:
    parts = []
    if document["simulated"]:
        parts.append(f"{len(document['simulated'])} models on simulated shapes that taught nothing")
    if document["recorded"]:
        parts.append(f"{len(document['recorded'])} models on a recording of clouds")
    return " and ".join(parts) + ", with the paper's figures"


def _main(document: Document) -> str:
    """Return the most informative error of a recording: to the true vertices, if known."""
    return "vertex" if any("vertex_mm" in row for row in document["recorded"]) else "surface"


def _recorded(
    document: Document,
    rows: Sequence[Row],
    curve: Sequence[Row],
    t: NDArray[np.float64],
    figures: ModuleType | None,
) -> list[Section]:
    main = _main(document)
    paper = [(f"the paper: {said}", document["paper"]["recorded"][name]) for name, said in PAPER]
    table = _table(document["recorded"], RECORDED, title, paper)
    found = [Section("Recording", _meaning(document["recorded"]), table)]
    if document["falls"]:
        found.append(Section("What the residual changes", OTHER, _falls(document["falls"])))
    errors = ("chamfer", main)
    if figures is not None:
        found.append(_shapes(rows, main, t, figures))
        image = figures.over_frames(rows, errors, t)
        found.append(
            _drawn(
                "Error over frames",
                image,
                "Error of each frame over time",
                "Mean over the seeds, mm.",
            )
        )
    if curve:
        name, alt = "Error against the number of real samples", "Error against frames that taught"
        picture = (
            None
            if figures is None
            else Picture(name, figures.over_samples(curve, rows, errors), alt)
        )
        note = (
            "Complete blocks of the recording that teaches, validated on the other; bars: "
            "standard deviation of seeds"
        )
        found.append(Section(name, note, _table(document["samples"], RECORDED, samples), picture))
    return found


def _shapes(rows: Sequence[Row], main: str, t: NDArray[np.float64], figures: ModuleType) -> Section:
    """Return predicted shapes over the clouds of a typical and of the worst frame."""
    row = next((row for row in rows if row.details["what"] == "with residual"), rows[-1])
    by = row.errors[main].mean(axis=0)
    frames = int(np.argsort(by)[len(by) // 2]), int(by.argmax())
    shown = rows if len(rows) <= figures.ACROSS else [*rows[:2], *rows[-2:]]
    panels = [
        (f"{row.name}\n{what}, {t[k]:.1f} s: {mm(float(row.errors['surface'][0, k]))} mm", row, k)
        for what, k in zip(("typical", "worst"), frames)
        for row in shown
    ]
    note = (
        "Predicted surfaces, and the points of the cloud by their distance from them (outliers "
        "and a hole belong to it), their mean above. Typical and worst by "
        f"{COLUMN_TITLES.get(main, main)} of “{row.name}”."
    )
    return _drawn("Shapes over clouds", figures.shapes_over(panels), "Shapes over clouds", note)


def _drawn(name: str, image: bytes, alt: str, note: str) -> Section:
    return Section(name, note, picture=Picture(name, image, alt))


def _simulated(
    document: Document, rows: Sequence[Row], figures: ModuleType | None
) -> list[Section]:
    table = _table(document["simulated"], SIMULATED, title)
    name = "Simulated shapes that taught nothing"
    found = [Section(name, f"{_meaning(document['simulated'])}; {OTHER}.", table)]
    if figures is None:
        return found
    panels = []
    for row in rows:
        worst = int(row.errors["chamfer"][0].argmax())
        panels.append((f"{row.name}: {mm(float(row.errors['chamfer'][0, worst]))} mm", row, worst))
    name = "The worst simulated shape of each model"
    note = (
        "Predicted surfaces, and the true vertices by their distance from them; above each its "
        "Chamfer distance."
    )
    return [*found, _drawn(name, figures.shapes_over(panels), name, note)]


def _meaning(rows: Sequence[Document]) -> str:
    return "; ".join(MEANING[error] for error in there(rows, RECORDED))


def _table(
    rows: Sequence[Document],
    errors: Sequence[str],
    called: Callable[[Document], str],
    paper: Sequence[tuple[str, Document]] = (),
) -> Table:
    shown = there(rows, errors)
    body = []
    for row in rows:
        cells = [Cell(cell(row, error), _spread(row, error)) for error in shown]
        body.append(TableRow(called(row), cells, row.get("judged") or ""))
        if row.get("paper"):
            body.append(_grey("the paper, other data", row["paper"], shown))
    body += [_grey(f"{name}, other data", one, shown) for name, one in paper]
    return Table(
        ["mm, mean ± sd over frames", *(COLUMN_TITLES.get(error, error) for error in shown)], body
    )


def _spread(row: Document, error: str) -> str:
    value = row.get(f"{error}_mm", {}).get("sd_of_seeds")
    return "" if value is None else f"± {mm(value)} over {row['seeds']} seeds"


def _grey(name: str, row: Document, errors: Sequence[str]) -> TableRow:
    return TableRow(name, [Cell(cell(row, error), grey=True) for error in errors], grey=True)


def _falls(rows: Sequence[Document]) -> Table:
    errors = [error for error in RECORDED if any(f"{error}_share" in row for row in rows)]
    body = []
    for row in rows:
        paper = Cell(f"{_change(row['paper_chamfer_share'])}, other data", grey=True)
        cells = [Cell(_change(row.get(f"{error}_share"))) for error in errors]
        body.append(TableRow(row["name"], [*cells, paper], f"against {row['against']}"))
    return Table(
        ["", *(COLUMN_TITLES.get(error, error) for error in (*errors, "the paper's chamfer"))], body
    )


def _change(share: float | None) -> str:
    """Return the relative change of an error, negative for a fall."""
    return "–" if share is None else f"{-100 * share:+.1f} %".replace("-", "−")


def _costs(document: Document) -> Section:
    every = {row["name"]: row for row in (*document["simulated"], *document["recorded"])}
    body = [TableRow(name, [Cell(text) for text in cost(row)]) for name, row in every.items()]
    table = Table(["", "ms for one shape", "numbers", "s of training"], body)
    return Section("What it takes", "Median of single shapes on one core of this machine.", table)
