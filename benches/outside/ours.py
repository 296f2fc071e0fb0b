"""Our answer on a data set: effects learned and diagnosed, held-out error before and after.

It uses only the public interface (`learn_model`, `diagnose`, `Model.predict`, `Model.acting`), so
the row represents the product.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benches.outside.case import BLOCKS, Case, error, predicted, targets
from benches.outside.rate_free import cubic
from softmap_edge import Model, Run, _core, diagnose

Floats = NDArray[np.float64]

# families whose laws are fitted one by one
MEMORY = ("reversal hysteresis", "delay", "slow drift", "slack")
STARTS = (0.15, 0.5)  # share of each number's range


@dataclass(frozen=True)
class Answer:
    """Our answer on a data set.

    Attributes:
        learned: the effects of the model's own chain, with numbers.
        verdict: one of the six verdicts, or "–" without a diagnosis.
        families: families found, by name and share if the document has them.
        names: names of effects and faults, with probability and numbers.
        before, after: held-out errors by run.
        seconds: processor time for model and diagnosis, s.
    """

    learned: str
    verdict: str
    families: str
    names: str
    before: dict[str, float]
    after: dict[str, float]
    seconds: float
    document: dict[str, Any] = field(default_factory=dict, repr=False)


def answer(case: Case) -> tuple[Answer, Model]:
    """Return our answer, and the model before the diagnosis."""
    start = time.process_time()
    model = case.model()
    learned = [f"{label} {value:.3g}" for label, value in model.params.items()]
    learned += [f"unknown law of {one.family}" for one in model.learned_in if not one.name]
    chain = ", ".join(learned) or "no memory"
    before = {
        name: error(case, run, predicted(case, model, run)) for name, run in case.held.items()
    }
    if not case.diagnose:
        return Answer(chain, "–", "–", "–", before, before, time.process_time() - start), model
    found = diagnose(model, case.fit)
    document = found.to_dict()
    after = {
        name: error(case, run, predicted(case, found.model, run)) for name, run in case.held.items()
    }
    if not case.held:
        ladder = document["error"]
        before = {BLOCKS: float(ladder["model"])}
        after = {
            BLOCKS: float(ladder["ladder"][-1]["value"] if ladder["ladder"] else ladder["model"])
        }
    said = [_named(row) for row in [*document["faults"], *document["effects"]]]
    families = ", ".join(str(row.get("name", row)) for row in document.get("families") or []) or "–"
    spent = time.process_time() - start
    return Answer(
        chain, found.verdict, families, "; ".join(said) or "–", before, after, spent, document
    ), model


def _named(row: dict[str, Any]) -> str:
    """Format an entry of a diagnosis: its name, probability and numbers."""
    sure = row.get("probability")
    numbers = ", ".join(_number(label, value) for label, value in row["params"].items())
    return (
        f"{row['name']}{'' if sure is None else f' {sure:.2f}'}{f' ({numbers})' if numbers else ''}"
    )


def _number(label: str, value: dict[str, Any]) -> str:
    unit = value.get("unit") or ""
    return f"{label.split('.', 1)[-1]} {value['value']:.3g} {'' if unit == '1' else unit}".rstrip()


def library_laws(case: Case, model: Model) -> dict[str, dict[str, float]]:
    """Return each memory law's held-out error with a refitted static map, by its name.

    The output is a cubic of the command plus a cubic of the law's output; the law's numbers are
    fitted by least squares.
    """
    found = {"no law": _law_error(case, model, None)}
    for effect in _core.effects():
        if effect["role"] == "channel" and effect["family"] in MEMORY and not effect["needs"]:
            found[effect["name"]] = _law_error(case, model, effect["name"])
    return found


def _law_error(case: Case, model: Model, name: str | None) -> dict[str, float]:
    bare, seen = model.bare(), targets(case, case.fit)
    half = float(np.abs(case.fit.commands()).max())

    def columns(run: Run, x: Floats) -> Floats:
        now = run.command_at(run.t_seen)[:, 0] / half
        if name is None:
            return cubic(now)
        acting = bare.acting((name,), x[None], run)[0, :, 0] / half
        return np.column_stack([cubic(now), cubic(acting)[:, 1:]])

    def off(x: Floats) -> Floats:
        a = columns(case.fit, x)
        return np.asarray(a @ np.linalg.lstsq(a, seen, rcond=None)[0] - seen).ravel() / np.std(seen)

    best = np.zeros(0)
    if name is not None:
        chain = _core.Chain([name], model.channels)
        low, high = (np.asarray(getattr(chain, side), float) for side in ("low", "high"))
        tries = [
            least_squares(
                off,
                low + share * (high - low),
                bounds=(low, high),
                x_scale=high - low,
                diff_step=1e-2,
                max_nfev=25,
            )
            for share in STARTS
        ]
        best = min(tries, key=lambda one: float(one.cost)).x
    weights = np.linalg.lstsq(columns(case.fit, best), seen, rcond=None)[0]
    return {
        which: error(case, run, columns(run, best) @ weights) for which, run in case.held.items()
    }
