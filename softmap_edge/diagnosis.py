"""Diagnose: name the physical effect that a model lacks, with its evidence, its rivals and the error before and after.

    features → noise and form error → whitened search over effects → acceptance on held-out blocks → verdict

The verdict is one of identified, ambiguous, partly_explained, nothing, cannot_tell, measurement_fault; silence and
doubt are answers. `diagnose` is deterministic: the same input gives the same document. Method: docs/design.md
and the files `noise.py`, `fit.py`, `search.py`, `evidence.py`. Pinned by tests/test_diagnosis.py.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.conditions import cells
from softmap_edge.errors import SoftmapError
from softmap_edge.evidence import (
    DEFAULT_EXPERIMENT,
    EXPERIMENTS,
    Hidden,
    Leftover,
    equivalents,
    form_rms,
    ladder,
    ladder_on,
    leftover,
    not_testable,
    orientations,
)
from softmap_edge.fit import Fit, Problem, Record
from softmap_edge.noise import command_kernel, estimate_noise, form_covariance, rod_noise, whitener
from softmap_edge.search import Search

if TYPE_CHECKING:
    from softmap_edge.run import Run

Floats = NDArray[np.float64]

SCHEMA = "softmap.diagnosis/1"
VERDICTS = ("identified", "ambiguous", "partly_explained", "nothing", "cannot_tell", "measurement_fault")
TEMPERATURE = 4.0  # of the probabilities: forms of the library are never exact; not yet fitted on a bank
UNTESTABLE_SHARE = 1 / 3  # of the candidates that may be untestable before "nothing" becomes "cannot tell"
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
    model: Any = field(default=None, repr=False)

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
            if not isinstance(document.get(f.name), kind):
                raise SoftmapError(f"the diagnosis has no usable '{f.name}'; make it again with `softmap diagnose`")
            values[f.name] = document[f.name]
        if values["verdict"] not in VERDICTS:
            raise SoftmapError(f"unknown verdict {values['verdict']!r}; there are {', '.join(VERDICTS)}")
        return cls(**values)

    def params_of(self, name: str) -> dict[str, float]:
        """Return the fitted parameters of one named effect or fault by label.

        Raises:
            SoftmapError: the diagnosis does not name it.
        """
        for entry in [*self.effects, *self.faults]:
            if entry["name"] == name:
                return {label: float(p["value"]) for label, p in entry["params"].items()}
        named = ", ".join(e["name"] for e in [*self.effects, *self.faults]) or "none"
        raise SoftmapError(f"the diagnosis does not name '{name}'; it names {named}")

    def __str__(self) -> str:
        from softmap_edge.report import diagnosis_text

        return diagnosis_text(self.to_dict())


def diagnose(
    model: Any,
    run: Run,
    held_out: Run | None = None,
    effects: Sequence[str] | None = None,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
    library: Any = None,
) -> Diagnosis:
    """Find out which effect a model lacks.

    Args:
        model: a Model; its own chain is kept and not searched again.
        run: the measured run, vertices or markers at K >= 8 seen frames.
        held_out: an independent run of another kind; effects that do not lower the error there are dropped.
        effects: names of the candidates; all of the registry by default.
        seed: kept in the document; the method itself draws nothing at random.
        progress: hears one line per stage.
        library: where effects come from; the compiled core by default.

    Returns:
        Diagnosis: verdict, effects with parameters and sigma, rivals, what cannot be told, the held-out error ladder.

    Raises:
        SoftmapError: too few frames, unknown effects, a run of another robot.
    """
    record = Record(model, run, library)
    registry = {e["name"]: e for e in record.library.effects()}
    candidates, impossible = _candidates(record, registry, effects)
    problem = _problem(record, candidates)
    search = Search(problem, candidates, progress)
    fit = search.run()
    if model.kind == "rod":
        fit = search.simplest(fit)
    other = None if held_out is None else Record(model, held_out, library)
    demoted: list[str] = []
    if other is not None:
        fit, demoted = _demote(search, fit, other)
    return _conclude(search, fit, other, demoted, registry, impossible, seed)


def refit(model: Any, run: Run, library: Any = None) -> tuple[Any, dict[str, Any]]:
    """Fit the parameters of a model's own effects again to a run.

    Returns:
        tuple: the model with new parameters, and a document with parameters ± sigma and the error before and after.

    Raises:
        SoftmapError: the model has no effects.
    """
    own = tuple(model.chain_names)
    if not own:
        raise SoftmapError("the model has no effects to refit; `softmap diagnose` finds out which it lacks")
    record = Record(model, run, library)
    problem = _problem(record, list(own))
    space = problem.space(own, free=own)
    now = space.scaled(np.asarray(model.chain_params, float)[space.free])
    before = problem.fit((), [np.zeros(0)], free=("",))
    fit = problem.fit(own, [now, space.start], free=own)
    sigma = problem.uncertainty(fit, max(1.0, fit.chi2 / max(1.0, problem.numbers)))
    held = problem.fold_predictions(fit)
    squares = [record.squares(record.seen - p)[test].ravel() for p, (_, test) in zip(held, problem.folds)]
    document = {
        "params": _params(record, fit, sigma, own),
        "before_rms_mm": record.rms_mm(record.seen - before.predicted),
        "after_held_out_rms_mm": float(np.sqrt(np.nanmean(np.concatenate(squares)))),
    }
    return model.with_effects(own, fit.params), document


# --- preparation --------------------------------------------------------------------------------


def _candidates(
    record: Record, registry: dict[str, dict[str, Any]], wanted: Sequence[str] | None
) -> tuple[list[str], list[Hidden]]:
    unknown = [name for name in wanted or () if name not in registry]
    if unknown:
        raise SoftmapError(f"no effect '{unknown[0]}'; there are {', '.join(registry)}")
    names = [n for n in registry if (wanted is None or n in wanted) and n not in record.model.chain_names]
    if not names:
        raise SoftmapError("no effect is left to look for: the model already has every candidate")
    impossible = []
    for name in names:
        missing = [f for f in registry[name].get("needs", []) if getattr(record.run, f, None) is None]
        if registry[name]["role"] == "channel" and record.model.channels == 0:
            impossible.append(Hidden(name, "nothing is commanded in this run", "a run with commands", 1.0))
        elif missing:
            impossible.append(Hidden(name, f"the run does not declare {', '.join(missing)}", "declare it", 1.0))
    if record.model.kind == "rod" and {"gravity", "payload"} <= set(names) and orientations(record) == 1:
        # A rod's fields bend its own centreline by one unknown compliance: own weight and tip load differ by less than
        # its form error, and a tilt of gravity is an offset. The simpler member stands for the family.
        block, minutes = EXPERIMENTS["gravity"]
        impossible.append(Hidden("gravity", "in one orientation a rod cannot tell it from payload", block, minutes))
    out = {h.name for h in impossible}
    return [n for n in names if n not in out], impossible


def _problem(record: Record, candidates: Sequence[str]) -> Problem:
    """Measure the noise, set up the form error and look along the span of the candidates' signatures."""
    chain = record.library.Chain(list(record.model.chain_names), record.model.channels)
    own = np.asarray(record.model.chain_params, float).reshape(1, len(chain.labels))
    base = record.predict(record.model.chain_names, own)[0]
    if len(record) < 8:
        raise SoftmapError(f"{len(record)} seen frames are too few to diagnose; record at least 8, better 60")
    thin = np.unique(np.linspace(0, len(record) - 1, min(len(record), SIGNATURE_FRAMES)).astype(int))
    signatures = [s for name in candidates for s in _signatures(record, name, base, thin)]
    stack = np.stack(signatures) if signatures else np.zeros((1, len(thin), record.features))
    kernel = command_kernel(record.command, record.spread)
    if record.model.kind == "rod":
        noise = rod_noise(record.seen - base, record.t_seen, record.form_error)
        form = np.zeros((record.features, record.features))
    else:
        noise = estimate_noise(record.seen - base, record.t_seen, record.state.visit)
        form = form_covariance(record.form_error, record.positions, record.section)
    return Problem(record, noise, whitener(noise, form, stack, kernel))


def _signatures(record: Record, name: str, base: Floats, frames: NDArray[Any]) -> list[Floats]:
    """Return what an effect does at its start values, all at once and each parameter alone."""
    own = dict(zip(record.library.Chain(list(record.model.chain_names), record.model.channels).labels,
                   map(float, record.model.chain_params)))  # fmt: skip
    names = tuple(record.model.chain_names) + (() if name in record.model.chain_names else (name,))
    chain = record.library.Chain(list(names), record.model.channels)
    null = np.array([own.get(label, n) for label, n in zip(chain.labels, chain.null)])
    mine = [i for i, label in enumerate(chain.labels) if label.split(".")[0] == name]
    every = null.copy()
    every[mine] = np.asarray(chain.start)[mine]
    rows = [every]
    for i in mine:
        alone = null.copy()
        alone[i] = chain.start[i]
        rows.append(alone)
    shifts = record.predict(names, np.stack(rows)) - base
    return [s[frames] for s in shifts if np.any(np.abs(s) > 1e-9)]


def _demote(search: Search, fit: Fit, other: Record) -> tuple[Fit, list[str]]:
    """Drop members until each lowers the error on an independent run, whatever they do on this one."""
    demoted: list[str] = []

    def error(f: Fit) -> float:
        params = np.array([[f.params[label] for label in f.space.labels]])
        return other.rms_mm(other.seen - other.predict(f.space.names, params)[0])

    while fit.effects:
        rests = {e: search.get(frozenset(fit.effects) - {e}) for e in fit.effects}
        useless = min(rests, key=lambda e: error(rests[e]))
        if error(rests[useless]) > 0.995 * error(fit):
            break
        demoted.append(useless)
        fit = rests[useless]
    return fit, demoted


# --- conclusion ---------------------------------------------------------------------------------


def _conclude(
    search: Search,
    fit: Fit,
    other: Record | None,
    demoted: list[str],
    registry: dict[str, dict[str, Any]],
    impossible: list[Hidden],
    seed: int,
) -> Diagnosis:
    record = search.problem.record
    weights = {e: max(search.share(fit, e), 0.0) for e in fit.effects}
    order = sorted(fit.effects, key=lambda e: (-weights[e], e))
    found = search.rivals(fit)
    left = leftover(search, fit)
    hidden = [*not_testable(search, fit, registry), *impossible]
    rivals = _rivals(search, fit, found, registry)
    entries = _entries(search, fit, other, order, weights, rivals, registry)
    faults = [e for e in entries if registry[e["name"]]["kind"] == "fault"]
    physics = [e for e in entries if registry[e["name"]]["kind"] != "fault"]
    error = _error(search, order, other)
    verdict = _verdict(physics, faults, rivals, left, hidden, len(search.candidates) + len(impossible))
    return Diagnosis(
        verdict=verdict,
        sentence=_sentence(verdict, physics, faults, rivals, left, hidden, error, demoted),
        effects=physics,
        faults=faults,
        rivals=[{"effects": r["effects"], "why": r["why"]} for r in rivals],
        not_testable=[{"name": h.name, "why": h.why, "experiment": h.experiment} for h in hidden],
        where={"before": _where(record, search.null), "after": _where(record, fit)},
        error=error,
        unexplained={
            "rms_mm": left.rms_mm,
            "chi2_per_n": left.chi2_per_n,
            "blocked_r2": left.blocked_r2,
            "predicted_by": left.predicted_by,
        },
        next=_next(rivals, hidden),
        made_from=_made_from(search, order, other, demoted, registry, seed),
        model=record.model.with_effects(fit.space.names, fit.params) if fit.effects else record.model,
    )


def _entries(
    search: Search,
    fit: Fit,
    other: Record | None,
    order: list[str],
    weights: dict[str, float],
    rivals: list[dict[str, Any]],
    registry: dict[str, dict[str, Any]],
) -> list[dict[str, Any]]:
    record = search.problem.record
    sigma = search.problem.uncertainty(fit, search.dispersion(fit)) if len(fit.x) else np.zeros(0)
    probability = search.probabilities(fit, TEMPERATURE)
    total = max(sum(weights.values()), 1e-300)
    entries = []
    for name in order:
        open_rivals = sum(1 for r in rivals if r["member"] == name)
        held = None
        if other is not None:
            held = other.rms_mm(_shift_on(fit, other, name))
        entries.append(
            {
                "name": name,
                "family": registry[name]["family"],
                "stage": registry[name]["stage"],
                "probability": min(probability[name], 1.0 / (1 + open_rivals)),
                "share": weights[name] / total,
                "displacement_mm": {"fitted": record.rms_mm(search.displacement(fit, name)), "held_out": held},
                "params": _params(record, fit, sigma, (name,)),
            }
        )
    return entries


def _shift_on(fit: Fit, other: Record, name: str) -> Floats:
    """Return what one effect does on another run (K, F) mm, the others in place."""
    params = np.array([fit.params[label] for label in fit.space.labels])
    mine = np.array([label.split(".")[0] == name for label in fit.space.labels])
    chain = other.library.Chain(list(fit.space.names), other.model.channels)
    both = np.stack([params, np.where(mine, np.asarray(chain.null, float), params)])
    shift = other.predict(fit.space.names, both)
    return np.asarray(shift[0] - shift[1])


def _params(record: Record, fit: Fit, sigma: Floats, names: Sequence[str]) -> dict[str, dict[str, Any]]:
    values = fit.space.values(fit.x)
    in_commands = {e["name"] for e in record.library.effects() if e["role"] == "channel"}
    found = {}
    for j, i in enumerate(fit.space.free):
        label, unit = fit.space.labels[i], fit.space.units[i]
        if label.split(".")[0] not in names:
            continue
        if record.model.kind == "rod" and unit == "g":
            unit = "of the rod's own load scale"  # its stiffness is unknown, so grams would be a claim without ground
        if unit == "mm" and label.split(".")[0] in in_commands:
            unit = getattr(record.model, "command_unit", "mm")
        at_bound = bool(fit.x[j] <= fit.space.low[j] + 1e-6 or fit.x[j] >= fit.space.high[j] - 1e-6)
        found[label] = {"value": float(values[j]), "sigma": float(sigma[j]), "unit": unit, "at_bound": at_bound}
    return found


def _rivals(
    search: Search, fit: Fit, found: list[tuple[str, Fit, str]], registry: dict[str, dict[str, Any]]
) -> list[dict[str, Any]]:
    rivals = [{"member": member, "effects": list(other.effects), "why": why} for member, other, why in found]
    for member in fit.effects:
        for twin in equivalents(search.problem.record, member, list(registry)):
            swapped = [twin if e == member else e for e in fit.effects]
            if twin in fit.effects or any(set(swapped) == set(r["effects"]) for r in rivals):
                continue
            why = f"{twin} and {member} look alike under the conditions of this run"
            rivals.append({"member": member, "effects": swapped, "why": why})
    return rivals


def _verdict(
    physics: list[Any], faults: list[Any], rivals: list[Any], left: Leftover, hidden: list[Hidden], count: int
) -> str:
    if left.claim:
        return "partly_explained"
    if physics:
        return "ambiguous" if rivals else "identified"
    if faults:
        return "measurement_fault"
    return "cannot_tell" if len(hidden) >= UNTESTABLE_SHARE * count else "nothing"


def _sentence(
    verdict: str,
    physics: list[dict[str, Any]],
    faults: list[dict[str, Any]],
    rivals: list[dict[str, Any]],
    left: Leftover,
    hidden: list[Hidden],
    error: dict[str, Any],
    demoted: list[str],
) -> str:
    names = " + ".join(e["name"] for e in [*physics, *faults])
    after = error["ladder"][-1]["value"] if error["ladder"] else error["model"]
    fall = f"the held-out error falls from {error['model']:.2f} to {after:.2f} mm"
    lost = f" Dropped, because the error on the independent run did not fall: {', '.join(demoted)}." if demoted else ""
    cannot = f" These data cannot show {', '.join(h.name for h in hidden)}." if hidden else ""
    unknown = f"{left.rms_mm:.2f} mm RMS are left that {left.predicted_by or 'something unknown'} predicts"
    if verdict == "identified":
        return f"The model lacks {names}; {fall}.{lost}"
    if verdict == "ambiguous":
        also = "; ".join(dict.fromkeys(" + ".join(r["effects"]) for r in rivals))
        return f"The model lacks {names} or a rival that these data do not rule out ({also}); {fall}.{lost}"
    if verdict == "partly_explained" and names:
        return f"The model lacks {names}, and something that is not among the candidates: {unknown}; {fall}.{lost}"
    if verdict == "partly_explained":
        return f"Something that is not among the candidates is missing: {unknown}.{lost}"
    if verdict == "measurement_fault":
        return f"The measurement is at fault, not the model: {names}; {fall}.{lost}"
    if verdict == "cannot_tell":
        return (
            f"Nothing above the floor is seen, and these data could not show {', '.join(h.name for h in hidden)}.{lost}"
        )
    return f"Nothing above the floor: no candidate explains the {error['model']:.2f} mm that are left.{cannot}{lost}"


def _error(search: Search, order: list[str], other: Record | None) -> dict[str, Any]:
    problem, record = search.problem, search.problem.record
    found = ladder(search, order) if other is None else ladder_on(search, other, order)
    noise, form = problem.noise.rms_mm(record.positions), form_rms(record)
    measured = record.model.kind != "rod"
    replicates = measured and "replicates" in problem.noise.source
    return {
        "kind": "held-out rms",
        "unit": "mm",
        **found,
        "noise_floor": noise if measured else None,
        "model_floor": form,
        "floor": noise if replicates else form,
        "floor_kind": "noise of replicates" if replicates else "the model's own held-out error",
        "held_out_on": "blocks of this run" if other is None else "an independent run",
    }


def _where(record: Record, fit: Fit) -> dict[str, list[dict[str, Any]]]:
    """Return the measured error by section and by condition as bins `{label, low, high, n, rms_mm}`."""
    squares = record.squares(record.seen - fit.predicted)  # (K, places)
    sections = record.section[record.positions]

    def mean(values: Floats) -> float | None:
        good = values[np.isfinite(values)]
        return float(np.sqrt(good.mean())) if len(good) else None

    found: dict[str, list[dict[str, Any]]] = {
        "section": [
            {"label": str(int(s)), "low": None, "high": None, "n": len(record), "rms_mm": mean(squares[:, i])}
            for i, s in enumerate(sections)
        ]
    }
    for name, row in cells(record.state).items():
        found[name] = [
            {
                "label": c.label,
                "low": c.low,
                "high": c.high,
                "n": int(c.frames.sum()),
                "rms_mm": mean(squares[c.frames]),
            }
            for c in row
        ]
    return found


def _next(rivals: list[dict[str, Any]], hidden: list[Hidden]) -> list[dict[str, Any]]:
    """Return the blocks that would settle what is open; the separation is not simulated here and says so by null."""
    blocks: dict[str, dict[str, Any]] = {}
    for rival in rivals:
        other = next((e for e in rival["effects"] if e != rival["member"]), rival["member"])
        block, minutes = EXPERIMENTS.get(rival["member"], DEFAULT_EXPERIMENT)
        entry = blocks.setdefault(block, {"block": block, "minutes": minutes, "settles": [], "separation": None})
        entry["settles"] += [n for n in (rival["member"], other) if n not in entry["settles"]]
    for item in hidden:
        entry = blocks.setdefault(
            item.experiment, {"block": item.experiment, "minutes": item.minutes, "settles": [], "separation": None}
        )
        entry["settles"] += [item.name] if item.name not in entry["settles"] else []
    return list(blocks.values())


def _made_from(
    search: Search,
    order: list[str],
    other: Record | None,
    demoted: list[str],
    registry: dict[str, dict[str, Any]],
    seed: int,
) -> dict[str, Any]:
    from softmap_edge import __version__

    problem, record = search.problem, search.problem.record
    return {
        "softmap": __version__,
        "seed": seed,
        "run": _hash(record),
        "held_out": None if other is None else _hash(other),
        "frames": len(record),
        "robot": getattr(record.model, "robot", None),
        "own_effects": list(record.model.chain_names),
        "candidates": search.candidates,
        "demoted": demoted,
        "noise": problem.noise.source,
        "inflation": problem.noise.inflation,
        "modes": len(problem.whitener.form),
        "temperature": TEMPERATURE,
        "references": {name: registry[name]["reference"] for name in order},
    }


def _hash(record: Record) -> str:
    """Return a hash of what the diagnosis used of a run."""
    sha = hashlib.sha256()
    for array in (np.asarray(record.run.t, float), record.u, record.t_seen, record.seen):
        sha.update(np.ascontiguousarray(array).tobytes())
    return sha.hexdigest()
