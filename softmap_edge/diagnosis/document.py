"""The document softmap.diagnosis/1: what a diagnosis says, as an object that prints itself, reads and writes itself.

It comes from files that nobody vouches for: everything is checked where it is read. Pinned by tests/test_diagnosis.py
and tests/test_mutated_files.py.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from softmap_edge import _core
from softmap_edge.chain_labels import valued
from softmap_edge.diagnosis.layout import ranges_of
from softmap_edge.errors import SoftmapError, brief
from softmap_edge.report.text import SCHEMA, VERDICTS, check_diagnosis, diagnosis_text
from softmap_edge.whole_file import read_document

if TYPE_CHECKING:
    from softmap_edge.model import Model


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What a run says about a model; prints itself, and `to_dict()` is the document softmap.diagnosis/1.

    `model` is the model with the accepted effects added; None after `from_dict`.
    """

    verdict: str
    sentence: str
    effects: list[dict[str, Any]]
    faults: list[dict[str, Any]]
    rivals: list[dict[str, Any]]
    not_testable: list[dict[str, Any]]
    where: dict[str, Any]
    error: dict[str, Any]
    unexplained: dict[str, Any]
    next: list[dict[str, Any]]
    made_from: dict[str, Any]
    servo: list[dict[str, Any]] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)  # on the run itself: what was set aside, what it cannot tell
    model: Any = field(default=None, repr=False)  # a Model; callers of `diagnose` need not look for None

    def to_dict(self) -> dict[str, Any]:
        """Return the document softmap.diagnosis/1."""
        names = [f.name for f in fields(self) if f.name != "model"]
        return {"schema": SCHEMA} | {name: getattr(self, name) for name in names}

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> Diagnosis:
        """Return the diagnosis of a document.

        Raises:
            SoftmapError: another schema, a missing or mistyped key, an unknown verdict.
        """
        if not isinstance(document, Mapping) or document.get("schema") != SCHEMA:
            got = document.get("schema") if isinstance(document, Mapping) else type(document).__name__
            raise SoftmapError(
                f"not a diagnosis: schema is {got!r}, {SCHEMA!r} is read; make it with `softmap diagnose`"
            )
        values = {}
        for f in fields(cls):
            if f.name == "model":
                continue
            kind = {"verdict": str, "sentence": str}.get(
                f.name, dict if f.name in ("where", "error", "unexplained", "made_from") else list
            )
            if f.name in ("servo", "remarks") and f.name not in document:  # a document of before there was any
                continue
            if not isinstance(document.get(f.name), kind):
                raise SoftmapError(f"the diagnosis has no usable '{f.name}'; make it again with `softmap diagnose`")
            values[f.name] = document[f.name]
        if values["verdict"] not in VERDICTS:
            raise SoftmapError(f"unknown verdict {values['verdict']!r}; there are {', '.join(VERDICTS)}")
        check_diagnosis(document)
        return cls(**values)

    @classmethod
    def load(cls, path: str | Path) -> Diagnosis:
        """Read the document that `softmap diagnose --out` wrote.

        Raises:
            SoftmapError: no readable JSON, or not a diagnosis.
        """
        try:
            document = json.loads(read_document(path), parse_int=_whole)
        except (ValueError, RecursionError) as error:
            raise SoftmapError(f"{path} is not JSON ({brief(error)}); make it with `softmap diagnose --out`") from None
        return cls.from_dict(document)

    def params_of(self, name: str) -> dict[str, float]:
        """Return the fitted parameters of one named effect or fault by label; those of the first run, if it is its own.

        Raises:
            SoftmapError: the diagnosis does not name it.
        """
        for entry in [*self.effects, *self.faults]:
            if entry["name"] == name:
                params = entry["params"] | (entry.get("refitted") or {}).get("params", {})
                return {label: float(p["value"]) for label, p in params.items() if "@" not in label}
        named = ", ".join(e["name"] for e in [*self.effects, *self.faults]) or "none"
        raise SoftmapError(f"the diagnosis does not name '{name}'; it names {named}")

    def added(self, model: Model, names: Sequence[str]) -> Model:
        """Return a model with effects that this diagnosis names, with what was fitted along with them.

        Raises:
            SoftmapError: the diagnosis does not name one of them, or is one of another model.
        """
        params: dict[str, float] = dict(model.params)
        for name in names:
            params = {label: value for label, value in params.items() if label.split(".")[0] != name}
            params |= self._checked(model, name)
        chain = (*model.chain_names, *(name for name in names if name not in model.chain_names))
        entries = [entry for entry in [*self.effects, *self.faults] if entry["name"] in names]
        found: Model = with_error(model.with_effects(chain, params), entries)
        return found

    def _checked(self, model: Model, name: str) -> dict[str, float]:
        """Return the fitted parameters of one effect, all of them and none beyond its bounds."""
        params, chain = self.params_of(name), _core.Chain([name], model.channels)
        values = valued(chain, params, np.full(len(chain.labels), np.nan))
        ranges = ranges_of(model, _core, chain)
        for i, (value, low, high) in enumerate(zip(values, ranges.low, ranges.limit)):
            room = 1e-6 * (high - low)
            label = chain.labels[i] if chain.labels[i] in params else chain.group_labels[i]
            if label not in params:
                raise SoftmapError(f"the diagnosis has no {label}; it is not of this model, diagnose again")
            if not low - room <= value <= high + room:
                raise SoftmapError(
                    f"{label} is {value:.6g} in the diagnosis, allowed {low:.6g} to {high:.6g}; diagnose again"
                )
        return params

    def __str__(self) -> str:
        return diagnosis_text(self.to_dict())


def with_error(model: Any, entries: Sequence[Mapping[str, Any]]) -> Any:
    """Return a model that errs by what the effects say that were added to it: with other numbers it is another rod."""
    for entry in entries:
        if not entry.get("refitted"):
            continue
        try:
            error = np.asarray(entry["refitted"].get("error_mm"), float)
        except (TypeError, ValueError):
            error = np.zeros(0)
        if error.shape != (model.form_error.size,) or not np.all(np.isfinite(error) & (error >= 0)):
            raise SoftmapError(f"the diagnosis is not of this model of '{model.robot}'; diagnose again")
        places = np.sum(error.reshape(-1, 3) ** 2, axis=1)
        model = replace(
            model,
            form_error=error.reshape(model.form_error.shape),
            vertex_error_mm=float(np.sqrt(np.mean(places))),
        )
    return model


def _whole(digits: str) -> int | float:
    """Return a whole number of JSON; one beyond any float, which no arithmetic takes, as infinity."""
    return int(digits) if len(digits) < 300 else float(digits)
