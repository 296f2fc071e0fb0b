"""Format the tables of `softmap evaluate` as text."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from softmap_edge.files.numbers import mm
from softmap_training.evaluate import ERRORS

Document = Mapping[str, Any]

PAPER = (
    ("deepsoro", "DeepSoRo"),
    ("without residual", "without residual"),
    ("with residual", "with residual"),
)
SIMULATED, RECORDED = ("chamfer", "vertex"), ERRORS
COLUMN_TITLES = {"whole": "complete body"}  # column titles that differ from the keys
MEANING = {
    "chamfer": "chamfer: prediction to target + target to prediction, unsquared",
    "visible": "visible: the same, of the vertices alone that registration finds in the cloud",
    "surface": "surface: from the points of the cloud to the predicted surface (one-sided)",
    "whole": "complete body: Chamfer to the true vertices, unseen sides too",
    "vertex": "vertex: from each vertex to its true place",
}
NAME, CELL, SHARE = 32, 17, 12


def lines(document: Document) -> list[str]:
    """Return the lines of a document softmap.evaluation/1."""
    found: list[str] = []
    if document["simulated"]:
        found += _table("Simulated shapes that taught nothing", document["simulated"], SIMULATED)
    if document["recorded"]:
        found += _table("Recording", document["recorded"], RECORDED)
        wide = _wide(map(title, document["recorded"]))
        for name, said in PAPER:
            one = document["paper"]["recorded"][name]["chamfer_mm"]
            cells = f"{mm(one['mean'])} ± {mm(one['sd'])}"
            found.append(f"  {'   the paper: ' + said:<{wide}}{cells:>{CELL}}   other data")
    rows = [*document["simulated"], *document["recorded"]]
    found += ["", *(f"  {MEANING[error]}" for error in there(rows, RECORDED))]
    if document["falls"]:
        found += _falls(document["falls"])
    if document["samples"]:
        found += _table(
            "The residual against the number of real samples",
            document["samples"],
            RECORDED,
            samples,
        )
    every = {row["name"]: row for row in (*document["simulated"], *document["recorded"])}
    wide = _wide(every)
    found += [
        "",
        "What it takes",
        f"  {'':<{wide}}{'ms a shape':>12}{'numbers':>12}{'s of training':>15}",
    ]
    for name, row in every.items():
        found.append(
            f"  {name:<{wide}}" + "".join(f"{c:>{w}}" for c, w in zip(cost(row), (12, 12, 15)))
        )
    return found[1:]


def _wide(names: Iterable[str]) -> int:
    """Return the width of a column of names."""
    return max([NAME, *(len(name) + 1 for name in names)])


def title(row: Mapping[str, Any]) -> str:
    """Return the title of a row."""
    return str(row["name"])


def samples(row: Mapping[str, Any]) -> str:
    """Return the title of a row with its number of training frames."""
    return f"{row['name']}, {row['frames']} frames"


def cost(row: Mapping[str, Any]) -> tuple[str, str, str]:
    """Format ms per shape, number of parameters, and seconds of training."""
    time = f"{row['milliseconds']:.3f}" if "milliseconds" in row else "–"
    trained = f"{row['seconds']:.0f}" if "seconds" in row else "–"
    return time, f"{row['parameters']:,}".replace(",", " ") if "parameters" in row else "–", trained


def cell(row: Mapping[str, Any], error: str) -> str:
    """Format mean ± standard deviation over frames, or a dash if a row has no such error."""
    one = row.get(f"{error}_mm")
    return "–" if one is None else f"{mm(one['mean'])} ± {mm(one['sd'])}"


def there(rows: Sequence[Document], errors: Sequence[str]) -> list[str]:
    """Return the errors that occur in any row."""
    return [error for error in errors if any(f"{error}_mm" in row for row in rows)]


def _table(
    head: str, rows: Sequence[Document], errors: Sequence[str], called: Any = title
) -> list[str]:
    shown = there(rows, errors)
    found = ["", f"{head} (mm, mean ± sd over frames)"]
    wide = _wide(map(called, rows))
    found.append(
        f"  {'':<{wide}}" + "".join(f"{COLUMN_TITLES.get(error, error):>{CELL}}" for error in shown)
    )
    for row in rows:
        found.append(
            f"  {called(row):<{wide}}" + "".join(f"{cell(row, error):>{CELL}}" for error in shown)
        )
        if row["seeds"] > 1:
            spread = [row.get(f"{error}_mm", {}).get("sd_of_seeds") for error in shown]
            cells = "".join(
                f"{'' if value is None else '± ' + mm(value):>{CELL}}" for value in spread
            )
            found.append(f"  {'   from seed to seed, ' + str(row['seeds']):<{wide}}{cells}")
        if row.get("judged"):
            found.append(f"     {row['judged']}")
        if row.get("paper"):
            cells = "".join(f"{cell(row['paper'], error):>{CELL}}" for error in shown)
            found.append(f"  {'   the paper, other data':<{wide}}{cells}")
    return found


def _falls(rows: Sequence[Document]) -> list[str]:
    errors = [error for error in RECORDED if any(f"{error}_share" in row for row in rows)]
    head = "".join(f"{COLUMN_TITLES.get(error, error):>{SHARE}}" for error in errors)
    names = [f"{row['name']} against {row['against']}" for row in rows]
    wide = _wide(names)
    found = [
        "",
        "What the residual changes",
        f"  {'':<{wide}}{head}   the paper's chamfer, other data",
    ]
    for name, row in zip(names, rows):
        shares = [row.get(f"{error}_share") for error in errors]
        cells = "".join(
            f"{'–' if share is None else f'{-100 * share:+.1f} %':>{SHARE}}" for share in shares
        )
        found.append(f"  {name:<{wide}}{cells}   {-100 * row['paper_chamfer_share']:+.1f} %")
    return found
