"""One self-contained HTML page of `softmap evaluate`: tables beside the paper's, shapes over clouds, errors, costs.

As all pages of reports: pictures are inside it, there is no script, and whatever comes from a file is escaped.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.files.atomic import write_atomically
from softmap_edge.files.numbers import mm
from softmap_edge.report.style import PAGE, cards, escaped, picture, section
from softmap_training.evaluate import Row
from softmap_training.evaluate_text import MEANING, PAPER, RECORDED, SIMULATED, TOLD, cell, cost, samples, there, title

Document = Mapping[str, Any]

OTHER = "grey: the paper's figures, of other data"


def write_page(
    path: str | Path,
    document: Document,
    simulated: Sequence[Row],
    recorded: Sequence[Row],
    curve: Sequence[Row],
    t_seen: NDArray[np.float64] | None,
) -> Path:
    """Write the page of a document softmap.evaluation/1 and the rows that it was made of.

    Args:
        path: the file to write.
        document, simulated, recorded, curve: as `softmap evaluate` has them.
        t_seen: (K,) s of the recording's frames.
    """
    from softmap_training import evaluate_figures as figures

    parts = [_hero(document), _warnings(document)]
    if recorded and t_seen is not None:
        parts += _recorded(document, recorded, curve, t_seen, figures)
    if simulated:
        parts += _simulated(document, simulated, figures)
    parts += [_costs(document), _origin(document)]
    page = PAGE.replace("@TITLE@", "Evaluation").replace("@BODY@", "\n".join(part for part in parts if part))
    target = Path(path)
    write_atomically(target, page)
    return target


def _hero(document: Document) -> str:
    rows = []
    best = min(document["simulated"], key=lambda row: row["vertex_mm"]["mean"], default=None)
    if best is not None:
        value = f"{mm(best['vertex_mm']['mean'])} mm"
        rows.append(("best on simulated shapes", value, f"vertex; {best['name']}", "after"))
    main = _main(document)
    for row in document["falls"]:
        if row["what"] == "without residual":
            share = row[f"{main}_share"]
            label = f"{main} error with {row['name']}"
            paper = _change(row["paper_chamfer_share"])
            note = f"against {row['against']}; chamfer {_change(row['chamfer_share'])} (the paper, other data: {paper})"
            rows.append((label, _change(share), note, "after" if share > 0 else "before"))
    seeds = document["made_from"]["seeds"]
    about = f"{len(seeds)} seed{'s' * (len(seeds) > 1)} of what is fitted here; mean ± standard deviation over frames"
    return (
        '<header><p class="eyebrow">SOFTMAP-Edge · Evaluation</p>'
        f'<h1>{escaped(_sentence(document))}</h1><p class="about">{escaped(about)}</p></header>'
        f'<div class="cards">{cards(rows)}</div>'
    )


def _sentence(document: Document) -> str:
    parts = []
    if document["simulated"]:
        parts.append(f"{len(document['simulated'])} models on simulated shapes that taught nothing")
    if document["recorded"]:
        parts.append(f"{len(document['recorded'])} models on a recording of clouds")
    return " and ".join(parts) + ", with the paper's figures"


def _main(document: Document) -> str:
    """Return the error that tells most of a recording: to the true vertices where they are known."""
    return "vertex" if any("vertex_mm" in row for row in document["recorded"]) else "surface"


def _warnings(document: Document) -> str:
    rows = "".join(f"<li>{escaped(text)}</li>" for text in document["warnings"])
    return section("Look at", f"<ul>{rows}</ul>") if rows else ""


def _recorded(
    document: Document, rows: Sequence[Row], curve: Sequence[Row], t: NDArray[np.float64], figures: Any
) -> list[str]:
    main = _main(document)
    paper = [(f"the paper: {said}", document["paper"]["recorded"][name]) for name, said in PAPER]
    found = [section("Recording", _table(document["recorded"], RECORDED, title, paper), _meaning(document["recorded"]))]
    if document["falls"]:
        found.append(section("What the residual changes", _falls(document["falls"]), OTHER))
    judge = next((row for row in rows if row.told["what"] == "with residual"), rows[-1])
    by = judge.errors[main].mean(axis=0)
    frames = int(np.argsort(by)[len(by) // 2]), int(by.argmax())
    shown = rows if len(rows) <= figures.ACROSS else [*rows[:2], *rows[-2:]]
    panels = [
        (f"{row.name}\n{what}, {t[k]:.1f} s: {mm(float(row.errors['surface'][0, k]))} mm", row, k)
        for what, k in zip(("typical", "worst"), frames)
        for row in shown
    ]
    note = (
        f"Predicted surfaces, and the points of the cloud by their distance from them (outliers and a hole belong to "
        f"it), their mean above. Typical and worst by {TOLD.get(main, main)} of “{escaped(judge.name)}”."
    )
    found.append(section("Shapes over clouds", picture(figures.shapes_over(panels), "Shapes over clouds"), note))
    errors = ("chamfer", main)
    drawn = picture(figures.over_frames(rows, errors, t), "Error of each frame over time")
    found.append(section("Error over frames", drawn, "Mean over the seeds, mm."))
    if curve:
        drawn = picture(figures.over_samples(curve, rows, errors), "Error against frames that taught")
        note = (
            "Complete blocks of the recording that teaches, validated on the other; bars: standard deviation of seeds"
        )
        table = _table(document["samples"], RECORDED, samples)
        found.append(section("Error against the number of real samples", drawn + table, note))
    return found


def _simulated(document: Document, rows: Sequence[Row], figures: Any) -> list[str]:
    table = _table(document["simulated"], SIMULATED, title)
    found = [section("Simulated shapes that taught nothing", table, f"{_meaning(document['simulated'])}; {OTHER}.")]
    panels = []
    for row in rows:
        worst = int(row.errors["chamfer"][0].argmax())
        panels.append((f"{row.name}: {mm(float(row.errors['chamfer'][0, worst]))} mm", row, worst))
    drawn = picture(figures.shapes_over(panels), "The worst simulated shape of each model")
    note = "Predicted surfaces, and the true vertices by their distance from them; above each its Chamfer distance."
    return [*found, section("The worst simulated shape of each model", drawn, note)]


def _meaning(rows: Sequence[Document]) -> str:
    return "; ".join(MEANING[error] for error in there(rows, RECORDED))


def _table(
    rows: Sequence[Document],
    errors: Sequence[str],
    called: Callable[[Document], str],
    paper: Sequence[tuple[str, Document]] = (),
) -> str:
    shown = there(rows, errors)
    body = []
    for row in rows:
        cells = "".join(f"<td>{escaped(cell(row, error))}{_spread(row, error)}</td>" for error in shown)
        judged = f"<br><small>{escaped(row['judged'])}</small>" if row.get("judged") else ""
        body.append(f"<tr><td><b>{escaped(called(row))}</b>{judged}</td>{cells}</tr>")
        if row.get("paper"):
            body.append(_grey("the paper, other data", row["paper"], shown))
    body += [_grey(f"{name}, other data", one, shown) for name, one in paper]
    head = "".join(f"<th>{escaped(TOLD.get(error, error))}</th>" for error in shown)
    head = f"<tr><th>mm, mean ± sd over frames</th>{head}</tr>"
    return f"<table><thead>{head}</thead><tbody>{''.join(body)}</tbody></table>"


def _spread(row: Document, error: str) -> str:
    value = row.get(f"{error}_mm", {}).get("sd_of_seeds")
    return "" if value is None else f"<br><small>± {mm(value)} over {row['seeds']} seeds</small>"


def _grey(name: str, row: Document, errors: Sequence[str]) -> str:
    cells = "".join(f"<td><small>{escaped(cell(row, error))}</small></td>" for error in errors)
    return f"<tr><td><small>{escaped(name)}</small></td>{cells}</tr>"


def _falls(rows: Sequence[Document]) -> str:
    errors = [error for error in RECORDED if any(f"{error}_share" in row for row in rows)]
    head = "".join(f"<th>{escaped(TOLD.get(error, error))}</th>" for error in (*errors, "the paper's chamfer"))
    body = []
    for row in rows:
        shares = [row.get(f"{error}_share") for error in errors]
        cells = "".join(f"<td>{_change(share)}</td>" for share in shares)
        paper = f"<td><small>{_change(row['paper_chamfer_share'])}, other data</small></td>"
        body.append(
            f"<tr><td><b>{escaped(row['name'])}</b><br><small>against {escaped(row['against'])}</small></td>{cells}"
            f"{paper}</tr>"
        )
    return f"<table><thead><tr><th></th>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>"


def _change(share: float | None) -> str:
    """Return by what share an error changed, a fall below zero."""
    return "–" if share is None else f"{-100 * share:+.1f} %".replace("-", "−")


def _costs(document: Document) -> str:
    body = []
    for row in {row["name"]: row for row in (*document["simulated"], *document["recorded"])}.values():
        cells = "".join(f"<td>{escaped(text)}</td>" for text in cost(row))
        body.append(f"<tr><td><b>{escaped(row['name'])}</b></td>{cells}</tr>")
    head = "".join(f"<th>{text}</th>" for text in ("", "ms for one shape", "numbers", "s of training"))
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>"
    return section("What it takes", table, "Median of single shapes on one core of this machine.")


def _origin(document: Document) -> str:
    text = json.dumps(document["made_from"], indent=1, ensure_ascii=False, sort_keys=True)
    return f"<details><summary>What made this page</summary><pre>{escaped(text)}</pre></details>"
