"""The document softmap.diagnosis/2.

The result of a diagnosis, with printing, reading and writing.

Documents of schema 1 are read as well. They come from untrusted files, so everything is checked on
reading. Pinned by tests/diagnosis/test_diagnosis.py and tests/model/test_mutated_files.py.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from softmap_edge import _core
from softmap_edge.diagnosis.findings import (
    Alternative,
    ErrorLadder,
    FamilyFinding,
    Finding,
    NextBlock,
    ServoFinding,
    Unexplained,
    Untestable,
    Where,
    plain,
    read,
)
from softmap_edge.diagnosis.spools import RADIUS
from softmap_edge.errors import ReportError, SoftmapError, brief
from softmap_edge.files.atomic import Document, read_document
from softmap_edge.model.chain_labels import readings, valued
from softmap_edge.model.learned_in import LearnedIn
from softmap_edge.model.manifest import LARGEST
from softmap_edge.model.model import Model
from softmap_edge.model.parameter_layout import ranges_of

SCHEMA, BEFORE = "softmap.diagnosis/2", "softmap.diagnosis/1"
VERDICTS = {
    "identified": "identified",
    "ambiguous": "ambiguous: more than one explanation fits",
    "partly_explained": "partly explained: an unknown error remains",
    "nothing": "nothing above the floor",
    "cannot_tell": "inconclusive: these data cannot show all effects",
    "measurement_fault": "measurement fault",
}


_LATER = (
    "model",
    "families",
    "servo",
    "learned_in",
    "remarks",
)  # not in every document of the schema


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The result of a diagnosis; `to_dict()` is the document softmap.diagnosis/2.

    It prints as text.

    `model` is the model with the accepted effects added; None after `from_dict`.
    """

    verdict: str
    sentence: str = ""
    effects: tuple[Finding, ...] = ()
    faults: tuple[Finding, ...] = ()
    families: tuple[FamilyFinding, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    not_testable: tuple[Untestable, ...] = ()
    where: Where = field(default_factory=Where)
    error: ErrorLadder = field(default_factory=ErrorLadder)
    unexplained: Unexplained = field(default_factory=Unexplained)
    next: tuple[NextBlock, ...] = ()
    made_from: Document = field(default_factory=dict)
    servo: tuple[ServoFinding, ...] = ()
    # effects that were present while the model was learned
    learned_in: tuple[LearnedIn, ...] = ()
    remarks: tuple[str, ...] = ()  # on the run itself: excluded data, and what it cannot show
    # never None from `diagnose`
    model: Model | None = field(default=None, repr=False)

    def to_dict(self) -> Document:
        """Return the document softmap.diagnosis/2."""
        return {"schema": SCHEMA} | {
            f.name: plain(getattr(self, f.name)) for f in fields(self) if f.name != "model"
        }

    @classmethod
    def from_dict(cls, document: Mapping[str, object]) -> Diagnosis:
        """Return the diagnosis of a document.

        Raises:
            SoftmapError: another schema, a missing or mistyped key, an unknown verdict.
        """
        schema = (
            document.get("schema") if isinstance(document, Mapping) else type(document).__name__
        )
        if schema not in (SCHEMA, BEFORE):
            raise ReportError(
                f"not a diagnosis: schema is {schema!r}, {SCHEMA!r} is read; make it with "
                "`softmap diagnose`"
            )
        renewed = _in_present_words(document)
        found = read(
            cls, {key: value for key, value in renewed.items() if key != "model"}, "diagnosis"
        )
        if found.verdict not in VERDICTS:
            raise ReportError(f"unknown verdict {found.verdict!r}; there are {', '.join(VERDICTS)}")
        names = [entry.name for entry in (*found.effects, *found.faults)]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise ReportError(f"damaged diagnosis: it names '{twice}' twice; diagnose again")
        return found

    @classmethod
    def load(cls, path: str | Path) -> Diagnosis:
        """Read a document of `softmap diagnose --out`.

        Raises:
            SoftmapError: not valid JSON, or not a diagnosis.
        """
        try:
            document = json.loads(read_document(path), parse_int=_integer)
        except UnicodeDecodeError:
            raise SoftmapError(
                f"{path}: not a text; give a diagnosis, which `softmap diagnose --out` writes"
            ) from None
        except (ValueError, RecursionError) as error:
            raise SoftmapError(
                f"{path} is not JSON ({brief(error)}); make it with `softmap diagnose --out`"
            ) from None
        if isinstance(document, dict) and document.get("schema") == SCHEMA:
            written = [f.name for f in fields(cls) if f.name not in _LATER]
            if missing := [name for name in written if name not in document]:
                raise ReportError(
                    f"{path}: damaged diagnosis: it has no '{missing[0]}'; diagnose again"
                )
        return cls.from_dict(document)

    def params_of(self, name: str) -> dict[str, float]:
        """Return the fitted parameters of one named effect or fault, by label.

        Parameters per run are those of the first run.

        Raises:
            SoftmapError: the diagnosis does not name it.
        """
        for entry in (*self.effects, *self.faults):
            if entry.name == name:
                params = entry.params | (entry.refitted.params if entry.refitted else {})
                return {label: p.value for label, p in params.items() if "@" not in label}
        named = ", ".join(e.name for e in (*self.effects, *self.faults)) or "none"
        raise SoftmapError(f"the diagnosis does not name '{name}'; it names {named}")

    def added(self, model: Model, names: Sequence[str]) -> Model:
        """Return a model with named effects of this diagnosis, and the parameters fitted with them.

        Raises:
            SoftmapError: the diagnosis does not name one of them, or is of another model or robot.
        """
        self.check_robot(model)
        params: dict[str, float] = dict(model.params)
        for name in names:
            params = {
                label: value for label, value in params.items() if label.split(".")[0] != name
            }
            params |= self._checked(model, name)
        chain = (*model.chain_names, *(name for name in names if name not in model.chain_names))
        entries = [entry for entry in (*self.effects, *self.faults) if entry.name in names]
        found: Model = with_error(model.with_effects(chain, params), entries)
        return found

    def check_robot(self, model: Model) -> None:
        """Raise SoftmapError if this is a diagnosis of another robot than the model's."""
        robot = self.made_from.get("robot", model.robot)
        if robot != model.robot:
            raise SoftmapError(
                f"the diagnosis is of '{robot}', the model of '{model.robot}'; give the bundle of "
                f"'{robot}' with --bundle"
            )

    def _checked(self, model: Model, name: str) -> dict[str, float]:
        """Return all fitted parameters of one effect, within its bounds."""
        params, chain = self.params_of(name), _core.Chain([name], model.channels)
        if far := next((label for label in params if abs(params[label]) > LARGEST), None):
            raise SoftmapError(
                f"{far} is {params[far]:.6g} in the diagnosis, allowed are ±{LARGEST:g}; diagnose "
                "again"
            )
        values = valued(chain, params, np.full(len(chain.labels), np.nan))
        ranges = ranges_of(model, chain)
        for i, (value, low, high) in enumerate(zip(values, ranges.low, ranges.limit)):
            room = 1e-6 * (high - low)
            known = readings(chain.labels[i], chain.group_labels[i])
            label = next((name for name in known if name in params), known[-1])
            if label not in params:
                raise SoftmapError(
                    f"the diagnosis has no {label}; it is not of this model, diagnose again"
                )
            # a known radius has no bounds
            if not low - room <= value <= high + room and label != RADIUS:
                raise SoftmapError(
                    f"{label} is {value:.6g} in the diagnosis, allowed {low:.6g} to {high:.6g}; "
                    "diagnose again"
                )
        return params

    def __str__(self) -> str:
        from softmap_edge.diagnosis.text import diagnosis_text

        return diagnosis_text(self.to_dict())


def _in_present_words(document: Mapping[str, object]) -> Mapping[str, object]:
    """Return a document of an earlier version with the words of this one.

    Schema 1 has `rivals` in place of `alternatives`. An identified law was called `resolved`.
    """
    if document.get("schema") == BEFORE:
        document = {**document, "alternatives": document.get("rivals", [])}
    families = document.get("families")
    if not isinstance(families, list):
        return document
    rows = [
        {**row, "law": "identified"}
        if isinstance(row, Mapping) and row.get("law") == "resolved"
        else row
        for row in families
    ]
    return {**document, "families": rows}


def with_error(model: Model, entries: Sequence[Finding]) -> Model:
    """Return a model with the error fitted together with its added effects.

    A rod with other parameters has another error.
    """
    for entry in entries:
        if entry.refitted is None:
            continue
        error = np.asarray(entry.refitted.error_mm, float)
        if error.shape != (model.form_error.size,) or not np.all((error >= 0) & (error < LARGEST)):
            raise SoftmapError(
                f"the diagnosis is not of this model of '{model.robot}'; diagnose again"
            )
        places = np.sum(error.reshape(-1, 3) ** 2, axis=1)
        model = replace(
            model,
            form_error=error.reshape(model.form_error.shape),
            vertex_error_mm=float(np.sqrt(np.mean(places))),
        )
    return model


def _integer(digits: str) -> int | float:
    """Return an integer of JSON; infinity if it is beyond the range of floats."""
    return int(digits) if len(digits) < 300 else float(digits)
