"""Diagnose: name the physical effect that a model lacks, with its evidence, its rivals and the error before and after.

    features → noise and form error → whitened search over effects → acceptance on held-out blocks → verdict

The verdict is one of identified, ambiguous, partly_explained, nothing, cannot_tell, measurement_fault; silence and
doubt are answers. `diagnose` is deterministic: the same input gives the same document. Method: the files
`noise.py`, `fit.py`, `search.py`, `evidence.py`, `conclusion.py`. Pinned by tests/test_diagnosis.py.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis.advice import asked
from softmap_edge.diagnosis.conclusion import OwnMisfit, conclude, parameters
from softmap_edge.diagnosis.declared import strange, wrong_sign
from softmap_edge.diagnosis.evidence import Untestable, equivalents, experiment, orientations, shown, unseen
from softmap_edge.diagnosis.fit import Fit, Problem
from softmap_edge.diagnosis.masked import masked
from softmap_edge.diagnosis.noise import Noise, command_kernel, estimate_noise, form_covariance, rod_noise, whitener
from softmap_edge.diagnosis.record import Record, record_of
from softmap_edge.diagnosis.search import Search
from softmap_edge.diagnosis.servo import servos
from softmap_edge.diagnosis.sound import sound_record, stray
from softmap_edge.errors import SoftmapError, brief
from softmap_edge.model import BEYOND
from softmap_edge.report.text import VERDICTS, check_diagnosis, diagnosis_text

if TYPE_CHECKING:
    from softmap_edge.model import Model
    from softmap_edge.run import Run

Floats = NDArray[np.float64]

SCHEMA = "softmap.diagnosis/1"
UNSAID = 0.05  # share of the frames that may lie outside what a model was made from
OWN_FALL = 0.7  # fall of the held-out error by a refit from which the model's own numbers are in doubt
ALIKE = 0.95  # cosine between two whitened signatures from which they cannot be told apart by their form
TWICE = (
    "it is diagnosed relative to a reference run: what is recorded next has to be recorded twice, as this run was and "
    "as the reference was, and the second given with --reference"
)
SIGNATURE_FRAMES = 1500  # frames on which the span of the signatures is found


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
            document = json.loads(Path(path).read_text(encoding="utf-8"), parse_int=_whole)
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
            params |= self.params_of(name)
        chain = (*model.chain_names, *(name for name in names if name not in model.chain_names))
        entries = [entry for entry in [*self.effects, *self.faults] if entry["name"] in names]
        found: Model = _with_error(model.with_effects(chain, params), entries)
        return found

    def __str__(self) -> str:
        return diagnosis_text(self.to_dict())


def diagnose(
    model: Model,
    run: Run | Sequence[Run],
    held_out: Run | None = None,
    effects: Sequence[str] | None = None,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
    library: Any = None,
    reference: Run | Sequence[Run] | None = None,
) -> Diagnosis:
    """Find out which effect a model lacks.

    Args:
        model: a Model; its own chain is kept and not searched again.
        run: the measured run, vertices or markers at K >= 8 seen frames; or several of one robot, which share all
            parameters but those of the camera's frame and clock.
        held_out: an independent run of another kind; effects that do not lower the error there are dropped.
        effects: names of the candidates; all of the registry by default.
        seed: kept in the document; the method itself draws nothing at random.
        progress: hears one line per stage.
        library: where effects come from; the compiled core by default.
        reference: a run of the same commands that stands for the model's own error (paired replay): what acts alike
            in both cancels out, and every error is relative to it. Several, where runs (or `held_out`) play other
            commands: each takes the one whose commands agree.

    Returns:
        Diagnosis: verdict, effects with parameters and sigma, rivals, what cannot be told, the held-out error ladder.

    Raises:
        SoftmapError: too few frames, unknown effects, a run of another robot, a reference of other commands.
    """
    record, remarks = sound_record(model, run, library, reference)
    registry = {e["name"]: e for e in record.library.effects()}
    candidates, impossible = _candidates(record, registry, effects)
    problem = _problem(record, candidates)
    search = Search(problem, candidates, progress)
    fit = search.run()
    if model.kind == "rod":
        fit = search.simplest(fit)
    fit = search.earliest(fit, lambda name: equivalents(record, name, registry))
    other = None if held_out is None else _judge(model, held_out, library, reference)
    demoted: list[str] = []
    if other is not None:
        fit, demoted = _demote(search, fit, lambda f: _error_on(f, other), 0.995)
    else:  # form error can swallow what a static effect does wrong on unseen blocks; in mm it shows
        fit, demoted = _demote(search, fit, search.held_out_mm, 1.0)
    gone = stray(record, fit)
    fit = fit if gone is None else search.null
    found = model.with_effects(fit.space.names, _shared(fit)) if fit.effects else model
    own = _own_misfit(record) if record.replay is None else None  # wrong numbers of its own cancel out too
    hidden = masked(search, fit)
    document = conclude(search, fit, other, demoted, impossible, own, seed, hidden)
    document["sentence"] += _outside(record) + ("" if record.replay is None else f" {record.replay}.")
    if gone is None and strange(document):
        gone = wrong_sign(record, search.held_out_mm(fit), lambda runs: _again(model, runs, candidates, library))
        if gone is not None:
            fit, found = search.null, model
            document = conclude(search, fit, other, demoted, impossible, own, seed, hidden)
    if gone is not None:
        document |= {"verdict": "measurement_fault", "sentence": gone, "rivals": []}
    remarks += [] if record.replay is None else [TWICE]
    remarks += [] if library is not None else asked(record.whole, len(record), problem.noise.source)
    told = servos(record.whole[0], [*candidates, *record.model.chain_names]) if library is None else []
    return Diagnosis(**document, servo=told, remarks=remarks, model=_with_error(found, document["effects"]))


def refit(model: Model, run: Run | Sequence[Run], library: Any = None) -> tuple[Model, dict[str, Any]]:
    """Fit the parameters of a model's own effects again to a run.

    Returns:
        tuple: the model with new parameters, and a document with parameters ± sigma and the error before and after.

    Raises:
        SoftmapError: the model has no effects.
    """
    own = tuple(model.chain_names)
    if not own:
        raise SoftmapError("the model has no effects to refit; `softmap diagnose` finds out which it lacks")
    record, _ = sound_record(model, run, library)
    problem = _problem(record, list(own))
    space = problem.space(own, free=own)
    now = space.scaled(record.own()[space.free])
    before = problem.fit((), [np.zeros(0)], free=("",))
    fit = problem.fit(own, [now, space.start], free=own)
    sigma = problem.uncertainty(fit, max(1.0, fit.chi2 / max(1.0, problem.numbers)))
    held = problem.fold_predictions(fit)
    squares = [record.squares(record.seen - p)[test].ravel() for p, (_, test) in zip(held, problem.folds)]
    document = {
        "params": parameters(record, fit, sigma, own),
        "before_rms_mm": record.rms_mm(record.seen - before.predicted),
        "after_held_out_rms_mm": float(np.sqrt(np.nanmean(np.concatenate(squares)))),
    }
    return model.with_effects(own, _shared(fit)), document


def showing(model: Model, run: Run, library: Any = None) -> list[dict[str, Any]]:
    """Say, before any fit, which effects would show in a run: how large each is at mid-range against the noise.

    Returns:
        list: for each effect `{name, shows, moved_mm, deviations, why, alike, experiment, minutes}`: `deviations` is
        the size of its signature in standard deviations, `alike` the effects whose signature is the same here within
        5 %, `experiment` what to record where it does not show or is not alone.

    Raises:
        SoftmapError: as `diagnose`.
    """
    record, _ = sound_record(model, run, library)
    registry = {e["name"]: e for e in record.library.effects()}
    candidates, impossible = _candidates(record, registry, None)
    problem = _problem(record, candidates)
    seen = {name: shown(problem, name) for name in candidates}
    size = {name: float(np.linalg.norm(white)) for name, (_, white) in seen.items()}
    found = {h.name: _showing(h.name, False, None, None, h.why, [], (h.experiment, h.minutes)) for h in impossible}
    for name, (moved, white) in seen.items():
        why = unseen(moved, size[name])
        twins = equivalents(record, name, registry)
        for other in candidates if why is None else ():
            product = size[name] * size[other]
            if other != name and product > 0 and abs(float(white @ seen[other][1])) > ALIKE * product:
                twins += [other] if other not in twins else []
        found[name] = _showing(name, why is None, moved, size[name], why, twins, experiment(registry, name))
    return [found[name] for name in registry if name in found]


def _showing(
    name: str,
    shows: bool,
    moved: float | None,
    size: float | None,
    why: str | None,
    alike: list[str],
    recorded: tuple[str, float],
) -> dict[str, Any]:
    block, minutes = recorded
    return dict(
        name=name, shows=shows, moved_mm=moved, deviations=size, why=why, alike=alike, experiment=block, minutes=minutes
    )


def _with_error(model: Any, entries: Sequence[Mapping[str, Any]]) -> Any:
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


def _shared(fit: Fit) -> dict[str, float]:
    """Return the fitted parameters of a model: what later runs had for themselves stays with them."""
    return {label: value for label, value in fit.params.items() if "@" not in label}


def _whole(digits: str) -> int | float:
    """Return a whole number of JSON; one beyond any float, which no arithmetic takes, as infinity."""
    return int(digits) if len(digits) < 300 else float(digits)


# --- preparation --------------------------------------------------------------------------------


def _again(model: Model, runs: Sequence[Run], candidates: Sequence[str], library: Any) -> float:
    """Return the held-out error mm that a search leaves on other runs."""
    search = Search(_problem(record_of(model, runs, library), candidates), candidates)
    return search.held_out_mm(search.run())


def _judge(model: Model, held_out: Run, library: Any, reference: Run | Sequence[Run] | None) -> Record:
    """Return the run that nothing is fitted to, relative to a reference if the others are."""
    try:
        return sound_record(model, held_out, library, reference)[0]
    except SoftmapError as fault:
        if reference is None:
            raise
        raise SoftmapError(
            f"the held-out run is judged relative to a reference too: {fault}; or leave --held-out out"
        ) from None


def _candidates(
    record: Record, registry: dict[str, dict[str, Any]], wanted: Sequence[str] | None
) -> tuple[list[str], list[Untestable]]:
    unknown = [name for name in wanted or () if name not in registry]
    if unknown:
        raise SoftmapError(f"no effect '{unknown[0]}'; there are {', '.join(registry)}")
    names = [n for n in registry if (wanted is None or n in wanted) and n not in record.model.chain_names]
    if not names:
        raise SoftmapError("no effect is left to look for: the model already has every candidate")
    lawless = [n for n in names if registry[n]["role"] == "prior" and record.model.lacking(n)]
    if wanted is None:  # a law that the prior does not have is no question, unless it is asked
        names = [n for n in names if n not in lawless]
    impossible = []
    for name in names:
        missing = record.missing(registry[name].get("needs", []))
        if record.model.channels == 0 and (registry[name]["role"] == "channel" or not record.layout((name,)).labels):
            impossible.append(Untestable(name, "nothing is commanded in this run", "a run with commands", 1.0))
        elif name in lawless:
            why = "the tendons of this model do not push, or it knows none: there is no such law to change"
            impossible.append(Untestable(name, why, "a model learned with a robot.toml whose tendons push", 1.0))
        elif lacking := record.model.lacking(name):
            why = f"this model has no field {lacking[0]}"
            impossible.append(Untestable(name, why, "a model built from a finger.toml by this version", 1.0))
        elif missing:
            block, minutes = experiment(registry, name)
            absent = ", ".join(missing)
            impossible.append(
                Untestable(name, f"the run does not declare {absent}", f"{block}; {absent} declared", minutes)
            )
    if record.model.kind == "rod" and {"gravity", "payload"} <= set(names) and orientations(record.gravity) == 1:
        # A rod's fields bend its own centreline by one unknown compliance: own weight and tip load differ by less than
        # its form error, and a tilt of gravity is an offset. The simpler member stands for the family.
        block, minutes = experiment(registry, "gravity")
        impossible.append(Untestable("gravity", "in one orientation a rod cannot tell it from payload", block, minutes))
    out = {h.name for h in impossible}
    return [n for n in names if n not in out], impossible


def _outside(record: Record) -> str:
    """Say how much of a run lies beyond the commands that the model was made from, where it extrapolates."""
    reach = getattr(record.model, "command_range", None)
    if reach is None or not len(record):
        return ""
    low, high = np.asarray(reach, float).T
    slack = BEYOND * (high - low)
    beyond = np.any((record.command < low - slack) | (record.command > high + slack), axis=1).mean()
    if beyond < UNSAID:
        return ""
    return f" {100 * beyond:.0f} % of the frames lie beyond the commands that the model was made from: a guess there."


def _own_misfit(record: Record) -> OwnMisfit | None:
    """Return what the effects that the model has already would reach with other numbers, if that is much."""
    if not record.model.chain_names:
        return None
    report = refit(record.model, record.whole, record.library)[1]
    before, after = report["before_rms_mm"], report["after_held_out_rms_mm"]
    return OwnMisfit(tuple(record.model.chain_names), before, after) if after <= OWN_FALL * before else None


def _problem(record: Record, candidates: Sequence[str], noise: Noise | None = None) -> Problem:
    """Measure the noise (if none is given), set up the form error and look along the candidates' signatures."""
    base = record.predict(record.model.chain_names, record.own()[None])[0]
    if len(record) < 8:
        raise SoftmapError(f"{len(record)} seen frames are too few to diagnose; record at least 8, better 60")
    thin = np.unique(np.linspace(0, len(record) - 1, min(len(record), SIGNATURE_FRAMES)).astype(int))
    signatures = [s for name in candidates for s in _signatures(record, name, base, thin)]
    stack = np.stack(signatures) if signatures else np.zeros((1, len(thin), record.features))
    kernel = command_kernel(record.command, record.spread, record.leaning)
    if record.model.kind == "rod":
        noise = noise or rod_noise(record.seen - base, record.t_seen, record.form_error)
        form = np.zeros((record.features, record.features))
    else:
        noise = noise or estimate_noise(record.seen - base, record.t_seen, record.state.visit)
        form = form_covariance(record.form_error, record.positions, record.section)
        if record.static is not None:  # a residual may be the model's own error or an effect: both are allowed for
            form = form + record.static.T @ record.static / len(record)
    return Problem(record, noise, whitener(noise, form, stack, kernel))


def _signatures(record: Record, name: str, base: Floats, frames: NDArray[Any]) -> list[Floats]:
    """Return what an effect does at its start values, all at once and each parameter alone."""
    names = tuple(record.model.chain_names) + (() if name in record.model.chain_names else (name,))
    layout, present = record.layout(names), record.layout(record.model.chain_names)
    own = dict(zip(present.labels, map(float, record.own())))
    null = np.array([own.get(label, n) for label, n in zip(layout.labels, layout.null)])
    mine = [i for i, label in enumerate(layout.labels) if label.split(".")[0] == name]
    every = null.copy()
    every[mine] = layout.start[mine]
    rows = [every]
    for i in mine:
        alone = null.copy()
        alone[i] = layout.start[i]
        rows.append(alone)
    shifts = record.predict(names, np.stack(rows)) - base
    return [s[frames] for s in shifts if np.any(np.abs(s) > 1e-9)]


def _error_on(fit: Fit, other: Record) -> float:
    """Return the error mm of a fit on an independent run."""
    return other.rms_mm(other.seen - fit.on(other))


def _demote(search: Search, fit: Fit, error: Callable[[Fit], float], share: float) -> tuple[Fit, list[str]]:
    """Drop members, or all at once, while the `error` (mm, on what was not fitted) is at most `share` without them."""
    demoted: list[str] = []
    while fit.effects:
        rests = [search.null, *(search.get(frozenset(fit.effects) - {e}) for e in fit.effects)]
        best = min(rests, key=error)
        if error(best) > share * error(fit):
            break
        demoted += [e for e in fit.effects if e not in best.effects]
        fit = best
    return fit, demoted
