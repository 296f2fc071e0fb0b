"""The inputs of a row of the table: one data set, its runs, and the known right law."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benches.data import ROOT
from softmap_edge import Model, Run

Floats = NDArray[np.float64]
# validation data without another run: the blocks of the diagnosis
BLOCKS = "blocks of the run"

# predictions of the right law, fitted manually, on each held-out run (K, Q)
Law = Callable[[], Mapping[str, Floats]]


@dataclass(frozen=True)
class Case:
    """A data set.

    Attributes:
        name: name of the row.
        about: a paragraph for the page: the data, the known missing physics, omissions.
        values: converts markers (K, M, 3) to (K, Q): the targets of peers and errors; outputs do
            not change.
        fit: the run for learning and diagnosis.
        held: runs for validation only, by name; without one, the held-out blocks of the diagnosis
            are used.
        model: makes the model before the diagnosis.
        law: fits the right law manually, in (K, Q) of `targets`; None if it is unknown.
        law_name: name of that law.
        unit: unit of the errors; "NRMSE" divides by the standard deviation of the held-out outputs.
        lags: lags of the peers' commands, in rows of the fit run.
        expected: the right answer, for the page.
        diagnose: whether our diagnosis runs; otherwise the row has peers and laws only.
        moving: whether commands move; otherwise no peer can be trained.
        per_library_law: whether each memory law of the library is fitted as well.
    """

    name: str
    about: str
    values: Callable[[Floats], Floats]
    fit: Run
    held: Mapping[str, Run]
    model: Callable[[], Model]
    law: Law | None
    law_name: str
    unit: str
    expected: str
    lags: tuple[int, ...] = (0, 1, 2, 4, 8, 16, 32, 64)
    diagnose: bool = True
    moving: bool = True
    per_library_law: bool = False


@cache
def _texts() -> dict[str, str]:
    """Return the texts of the page."""
    return tomllib.loads(Path(__file__).with_name("texts.toml").read_text(encoding="utf-8"))


def text(name: str, **numbers: object) -> str:
    """Return a text of the page with its numbers filled in."""
    found = _texts()[name].strip()
    return found.format(**numbers) if numbers else found


def folder(name: str) -> Path | None:
    """Return the folder of a data set: in `data`, or `../shared/data`; None if absent.

    `data` is the folder in the checkout.
    """
    return next(
        (p for p in (ROOT / "data" / name, ROOT.parent / "shared/data" / name) if p.is_dir()), None
    )


def places(markers: Floats) -> Floats:
    """Return markers (K, M, 3) mm as (K, 3M)."""
    return np.asarray(markers, float).reshape(len(markers), -1)


def along_x(markers: Floats) -> Floats:
    """Return the x of markers (K, M, 3) that represent an output, (K, M), in any unit."""
    return np.asarray(markers[..., 0], float)


def targets(case: Case, run: Run) -> Floats:
    """Return the measurements (K, Q) of a run: outputs in their unit, else coordinates.

    Coordinates are those of the case.
    """
    return run.outputs if run.output is not None else case.values(np.asarray(run.markers, float))


def predicted(case: Case, model: Model, run: Run) -> Floats:
    """Return a model's prediction of a run, (K, Q), like `targets`."""
    points = np.asarray(model.predict(run), float)
    return case.values(points) if model.output is None else model.output.values(points)


def error(case: Case, run: Run, answer: Floats) -> float:
    """Return the error of a prediction (K, Q): NRMSE or mm.

    NRMSE divides by the standard deviation of the measurement.

    In mm, it is the RMS distance of the visible markers.
    """
    seen = targets(case, run)
    off = np.asarray(answer, float) - seen
    if case.unit == "NRMSE":
        return float(np.sqrt(np.nanmean(off**2)) / np.nanstd(seen))
    return float(np.sqrt(np.nanmean(np.sum(off.reshape(len(off), -1, 3) ** 2, axis=2))))
