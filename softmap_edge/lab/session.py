"""A session of the lab: runs, a model, checks, a diagnosis, and the steps that were accepted.

    load → check ─passed for exactly these inputs→ diagnose, try, fit, accept → check again …

The model is the bundle with the accepted steps, so undo and redo replay the journal. `key` is a
hash of the runs and of this model: a check or a diagnosis holds for one key only. Methods may be
called from several threads. Pinned by tests/lab/test_session.py.
"""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from softmap_edge import _core
from softmap_edge.checks.lost_points import without_lost
from softmap_edge.checks.summary import summary
from softmap_edge.comparison.comparison import compare, model_digest
from softmap_edge.diagnosis.diagnose import diagnose
from softmap_edge.diagnosis.document import VERDICTS, Diagnosis
from softmap_edge.diagnosis.refit import refit
from softmap_edge.errors import LabError, SoftmapError
from softmap_edge.experiment.choose import next_experiment
from softmap_edge.files.atomic import Document, finite, write_atomically
from softmap_edge.files.numbers import fall
from softmap_edge.files.printable import one_line
from softmap_edge.lab.journal import MODEL, Journal, Step, as_inputs, step_document
from softmap_edge.lab.views import Prediction, View, predicted_by, rms_of, view_of
from softmap_edge.model.bundle import save_bundle
from softmap_edge.model.effect_info import registry
from softmap_edge.model.model import Model
from softmap_edge.model.parameter_layout import ranges_of
from softmap_edge.run.run import Run

SCHEMA = "softmap.lab.page/1"


@dataclass(frozen=True)
class NamedRun:
    """A run and the path of its file."""

    path: str
    run: Run

    @property
    def name(self) -> str:
        """The name of the file in one printable line."""
        return one_line(Path(self.path).name)


@dataclass(frozen=True)
class Checked:
    """The result of a check: the inputs that it holds for, faults, and remarks."""

    key: str
    faults: tuple[str, ...]
    remarks: tuple[str, ...]


class Session:
    """Runs, a model and a session folder; every accepted step is written at once.

    Args:
        folder: the session folder, new or of the same inputs.
        runs: the first is fitted, the others validate.
        model: the model before all steps.
        bundle: path of its bundle, None for the built-in finger.

    Raises:
        LabError: as `journal.Journal`, a run holds no points, or a step of the journal does not
            fit the model.
    """

    def __init__(
        self, folder: str | Path, runs: Sequence[NamedRun], model: Model, bundle: str | None
    ) -> None:
        self.runs = tuple(runs)
        self.bundle = bundle
        self._base = model
        if outputs := [one.name for one in runs if one.run.output is not None]:
            raise LabError(
                f"{outputs[0]}: the lab shows points, and this run holds outputs; use `softmap "
                "compare`"
            )
        self._lock = threading.RLock()
        self._digest = [one.run.hash() for one in runs]
        inputs = as_inputs(
            [(str(Path(one.path).resolve()), hash_) for one, hash_ in zip(runs, self._digest)],
            (bundle if bundle is None else str(Path(bundle).resolve()), model_digest(model)),
        )
        self.journal = Journal(folder, inputs)
        self._checked: Checked | None = None
        self._views: dict[int, View] = {}
        self._after: dict[int, Prediction] = {}
        self._revision = 0  # of the views: a check may hide points
        self._comparisons: dict[tuple[int, str], Document] = {}
        try:
            self.model = self._replayed()
            self._write_model()
        except BaseException:
            self.journal.close()
            raise

    def close(self) -> None:
        """Let another program open the folder."""
        self.journal.close()

    # --- state -----------------------------------------------------------------------------

    @property
    def key(self) -> str:
        """A hash of the runs and of the model with the accepted steps."""
        return hashlib.sha256(
            "".join([*self._digest, model_digest(self.model)]).encode()
        ).hexdigest()

    def document(self) -> Document:
        """Return the state for the page."""
        with self._lock:
            state = self.journal.state
            return {
                "schema": SCHEMA,
                "folder": one_line(str(self.journal.folder)),
                "runs": [{"name": one.name, "frames": one.run.frames} for one in self.runs],
                "robot": one_line(self.model.robot),
                "bundle": "built-in finger" if self.bundle is None else one_line(self.bundle),
                "effects": list(self.model.chain_names),
                "params": self.model.params,
                "check": self._check_document(),
                "revision": self._revision,
                "diagnosis_current": state.diagnosed_for == self.key,
                "accepted": [step_document(step) for step in state.accepted],
                "undone": [step_document(step) for step in state.undone],
                "base_errors_mm": [
                    rms_of(view.before, view)
                    for k in range(len(self.runs))
                    if (view := self._views.get(k)) is not None
                ],
            }

    def _check_document(self) -> Document:
        checked = self._present_check()
        if checked is None:
            return {"state": "not done", "faults": [], "remarks": []}
        return {
            "state": "failed" if checked.faults else "passed",
            "faults": list(checked.faults),
            "remarks": list(checked.remarks),
        }

    def diagnosis(self) -> Document | None:
        """Return the newest diagnosis of the folder, for the page; None without one.

        Besides the entries of the document it has `verdict_text` and `removed`, the share of the
        removable error that the named effects remove (None if there is nothing to count).
        """
        file = self.journal.state.diagnosed
        if file is None:
            return None
        document = Diagnosis.load(self.journal.folder / file).to_dict()
        error = document["error"]
        last: float | None = error["ladder"][-1]["value"] if error["ladder"] else None
        before, floor = error["model"], error["floor"]
        return document | {
            "verdict_text": VERDICTS[document["verdict"]],
            "removed": fall(before, last, floor)
            if finite(before) and finite(last) and finite(floor)
            else None,
        }

    def library(self) -> list[Document]:
        """Return the effects that can be added, with the ranges of their parameters here."""
        rows = []
        for info in registry().values():
            chain = _core.Chain([info.name], self.model.channels)
            ranges = ranges_of(self.model, chain)
            first: dict[str, int] = {}  # place of each parameter's first label in the chain
            for k, label in enumerate(chain.group_labels):
                first.setdefault(label, k)
            meanings = {p.name: p for p in info.parameters}
            parameters: list[Document] = []
            for label, k in first.items():
                meaning = meanings.get(label.split(".", 1)[1])
                parameters.append(
                    {
                        "label": label,
                        "unit": chain.units[k],
                        "null": float(chain.null[k]),
                        "start": float(ranges.start[k]),
                        "low": float(min(ranges.low[k], chain.null[k])),
                        "high": float(ranges.high[k]),
                        "integer": meaning is not None and meaning.integer,
                        "doc": "" if meaning is None else meaning.doc,
                    }
                )
            rows.append(
                {
                    "name": info.name,
                    "family": info.family,
                    "doc": info.doc,
                    "fault": info.is_fault,
                    "parameters": parameters,
                }
            )
        return rows

    # --- see and where -----------------------------------------------------------------------

    def view(self, run: int) -> tuple[View, Prediction | None]:
        """Return a run with the prediction before all steps and, with any, after them."""
        with self._lock:
            one = self._run(run)
            if run not in self._views:
                self._views[run] = view_of(self._base, one.run)
            if not self.journal.state.accepted:
                return self._views[run], None
            if run not in self._after:
                self._after[run] = predicted_by(self.model, self._views[run])
            return self._views[run], self._after[run]

    def seen(self, run: int) -> tuple[View, Prediction | None]:
        """Return the view of a run that is loaded, at once.

        Raises:
            LabError: it is not loaded.
        """
        if (view := self._views.get(run)) is None:
            raise LabError(f"run {run} is not loaded; load it first")
        return view, self._after.get(run)

    def comparison(self, run: int) -> Document:
        """Return the comparison of the present model with a run."""
        one, key = self._run(run), (run, self.key)
        if key not in self._comparisons:
            found = compare(self.model, one.run)
            bound = {"floor_is_bound": found.floor_is_bound}
            self._comparisons[key] = found.to_dict() | bound
        return self._comparisons[key]

    def _run(self, number: int) -> NamedRun:
        if not 0 <= number < len(self.runs):
            raise LabError(f"there is no run {number}; there are 0 to {len(self.runs) - 1}")
        return self.runs[number]

    # --- check and diagnose ------------------------------------------------------------------

    def check(self) -> Checked:
        """Check all runs with the present model, as `softmap check` does."""
        key, model = self.key, self.model
        faults: list[str] = []
        remarks: list[str] = []
        for number, one in enumerate(self.runs):
            try:
                found = summary(one.run, model)
                if found.not_seen:
                    self._hide_lost(number)
                lines = [*found.not_seen, *filter(None, [found.unanswered])]
                faults += [f"{one.name}: {line}" for line in lines]
                remarks += [f"{one.name}: {line}" for line in found.warnings]
                remarks += [f"{one.name}: {word.text}" for word in found.cannot_tell]
            except SoftmapError as fault:
                faults.append(f"{one.name}: {fault}")
        with self._lock:
            self._checked = Checked(key, tuple(faults), tuple(remarks))
            return self._checked

    def _hide_lost(self, number: int) -> None:
        """Hide points that stand for "not seen", as a comparison does; the search takes seconds."""
        run, _ = without_lost(self.runs[number].run)
        with self._lock:
            if number not in self._views or self._views[number].run is not run:
                self._views[number] = view_of(self._base, run)
                self._after.pop(number, None)
                self._revision += 1

    def _present_check(self) -> Checked | None:
        """Return the check of these runs and the present model; None without one."""
        checked = self._checked
        return checked if checked is not None and checked.key == self.key else None

    def _require_check(self, what: str) -> None:
        checked = self._present_check()
        if checked is None:
            raise LabError(f"{what} needs a check of these runs and this model first")
        if checked.faults:
            raise LabError(f"{what} needs a check that passes; {checked.faults[0]}")

    def diagnose(self, progress: Callable[[str], None]) -> None:
        """Diagnose the first run; keep the diagnosis in the folder. The second validates it."""
        self._require_check("a diagnosis")
        key, model = self.key, self.model
        held_out = self.runs[1].run if len(self.runs) > 1 else None
        found = diagnose(model, self.runs[0].run, held_out, progress=progress)
        with self._lock:
            file = f"diagnosis-{self.journal.state.diagnoses + 1}.json"
            text = json.dumps(found.to_dict(), indent=1)
            write_atomically(self.journal.folder / file, text)
            self.journal.append({"do": "diagnosed", "file": file, "inputs": key})

    def experiments(self, progress: Callable[[float], None]) -> list[Document]:
        """Simulate what to record next for the open questions of the present diagnosis.

        Args:
            progress: called with the completed share.
        """
        state = self.journal.state
        if state.diagnosed is None or state.diagnosed_for != self.key:
            raise LabError("experiments need a diagnosis of these runs and this model first")
        found = Diagnosis.load(self.journal.folder / state.diagnosed)
        blocks = next_experiment(self.model, found, [self.runs[0].run], progress=progress)
        return [one.to_dict() | {"alone": one.alone} for one in blocks]

    # --- add --------------------------------------------------------------------------------

    def with_effects(self, names: Sequence[str], params: Mapping[str, float]) -> Model:
        """Return the model with exactly these effects."""
        known = registry()
        if unknown := [name for name in names if name not in known]:
            raise LabError(f"there is no effect '{one_line(unknown[0])[:60]}'")
        return self.model.with_effects(names, dict(params))

    def fit(self, names: Sequence[str], params: Mapping[str, float]) -> Document:
        """Fit effects to the first run, from these parameters; return a report."""
        self._require_check("a fit")
        model, report = refit(self.with_effects(names, params), self.runs[0].run)
        return report.to_dict() | {"values": model.params}

    def accept(self, names: Sequence[str], params: Mapping[str, float]) -> None:
        """Accept a chain of effects with all their parameters."""
        self._require_check("a step")
        model = self.with_effects(names, params)
        self._accept(Step(tuple(model.chain_names), model.params), model)

    def accept_diagnosis(self) -> None:
        """Accept the effects that the newest diagnosis names."""
        self._require_check("a step")
        state = self.journal.state
        if state.diagnosed is None or state.diagnosed_for != self.key:
            raise LabError("there is no diagnosis of these runs and this model; diagnose first")
        found = Diagnosis.load(self.journal.folder / state.diagnosed)
        names = tuple(effect.name for effect in found.effects)
        if not names:
            raise LabError(f"the diagnosis names no effect (verdict {found.verdict})")
        step = Step(names, diagnosis=state.diagnosed)
        self._accept(step, found.added(self.model, names))

    def _accept(self, step: Step, model: Model) -> None:
        with self._lock:
            after = {run: predicted_by(model, self.view(run)[0]) for run in range(len(self.runs))}
            errors = tuple(rms_of(after[run], self._views[run]) for run in after)
            done = step_document(replace(step, errors_mm=errors))
            self.journal.append({"do": "accepted"} | done)
            self._changed(model, after)

    def undo(self) -> None:
        """Take back the last accepted step."""
        self._move("undone")

    def redo(self) -> None:
        """Accept again the step that was last taken back."""
        self._move("redone")

    def _move(self, do: str) -> None:
        with self._lock:
            self.journal.append({"do": do})
            self._changed(self._replayed(), {})

    def _changed(self, model: Model, after: dict[int, Prediction]) -> None:
        self.model, self._after = model, after
        self._write_model()

    def _replayed(self) -> Model:
        """Return the model with the accepted steps."""
        model = self._base
        for number, step in enumerate(self.journal.state.accepted, 1):
            try:
                if step.diagnosis is None:
                    model = model.with_effects(step.effects, dict(step.params))
                else:
                    found = Diagnosis.load(self.journal.folder / step.diagnosis)
                    model = found.added(model, step.effects)
            except (SoftmapError, OSError) as fault:
                raise LabError(
                    f"{one_line(str(self.journal.folder))}: step {number} cannot be read again: "
                    f"{one_line(str(fault))}; give another --folder"
                ) from None
        return model

    def _write_model(self) -> None:
        """Write the bundle with the accepted steps; the journal stays the record of them."""
        if self.journal.state.accepted or (self.journal.folder / MODEL).exists():
            save_bundle(self.model, self.journal.folder / MODEL)
