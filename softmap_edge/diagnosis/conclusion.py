"""From a finished search to what a diagnosis says: effects with parameters, rivals, and what is open.

Nothing is searched here, and nothing is decided that `search.py` (which effects are accepted) or `evidence.py` (what
the run can show) has not measured. Every entry is plain data, ready for JSON. Units: mm. Pinned by
tests/test_diagnosis.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis.conditions import cells
from softmap_edge.diagnosis.evidence import (
    Untestable,
    at_bound,
    equivalents,
    experiment,
    ladder,
    ladder_on,
    leftover,
    not_alone,
    not_testable,
)
from softmap_edge.diagnosis.fit import Fit
from softmap_edge.diagnosis.masked import Masked
from softmap_edge.diagnosis.record import Record
from softmap_edge.diagnosis.rivals import RIVAL_SHARE, RIVAL_WORSE, rivals_of, stands_for, worse
from softmap_edge.diagnosis.search import Search
from softmap_edge.diagnosis.wording import OwnMisfit, at_bounds, sentence_of, verdict_of
from softmap_edge.folds import labelled
from softmap_edge.own_effect import hashes

Floats = NDArray[np.float64]

# Of the probabilities, fitted on development seeds of the bank (docs/bank.md): where forms are not exact one of so many
# whitened numbers speaks for itself; odds of an open rival and of what lies beyond a bound; odds that something unknown
# stands in the place of what is named, times the share of the mean square of the misfit that is left.
TEMPERATURE, RIVAL, BEYOND_BOUND, UNKNOWN = 400.0, 0.25, 0.4, 30.0
LIKELY = 0.5  # probability below which nothing is identified


def conclude(
    search: Search,
    fit: Fit,
    other: Record | None = None,
    demoted: Sequence[str] = (),
    impossible: Sequence[Untestable] = (),
    own: OwnMisfit | None = None,
    seed: int = 0,
    masked: Masked | None = None,
) -> dict[str, Any]:
    """Say what a finished search means.

    Args:
        search: the search; its fits and cross-validations are used again.
        fit: the set of effects that it chose.
        other: an independent run on which errors are held out; blocks of the searched one without it.
        demoted: effects that were dropped because the independent run spoke against them.
        impossible: effects that were never candidates, and why.
        own: what the model's own effects would reach with other numbers, if that is much.
        seed: kept in the document.
        masked: what a residual that was taken out may hide.

    Returns:
        dict: the entries of softmap.diagnosis/1, all but its schema.
    """
    record = search.problem.record
    registry = {e["name"]: e for e in record.library.effects()}
    weights = {e: max(search.share(fit, e), 0.0) for e in fit.effects}
    order = sorted(fit.effects, key=lambda e: (e not in search.faults, -weights[e], e))
    found = [r for r in rivals_of(search, fit) if not set(r[1].effects) & set(demoted)]  # what was dropped is no rival
    left = leftover(search, fit)
    behind = [] if masked is None else masked.untestable(registry)
    names = {h.name for h in behind}
    hidden = [*behind, *(h for h in (*not_testable(search, fit, registry), *impossible) if h.name not in names)]
    rivals = _rivals(search, fit, found, registry, {h.name for h in impossible})
    if own is not None and fit.effects:
        fall = own.before_mm - search.held_out_mm(fit)
        if own.before_mm - own.after_mm >= RIVAL_SHARE * fall:
            block = ("`softmap refit` on this run, then diagnose again", 0.0)
            rivals.insert(0, {"member": order[0], "effects": list(own.names), "why": str(own), "experiment": block})
    shared = not_alone(search, fit, left)
    unknown = left.claim and (shared is None or leftover(search, shared[0]).claim)
    entries = _entries(search, fit, shared and shared[0], other, order, weights, rivals, registry)
    odds = UNKNOWN * (left.rms_mm / max(search.held_out_mm(search.null), 1e-9)) ** 2 if unknown else 0.0
    odds = odds or (BEYOND_BOUND if at_bounds(entries) else 0.0)  # it is not among the sets either
    for entry in entries:
        sure = entry["probability"]
        entry["probability"] = None if sure is None else sure / (1.0 + odds * sure)
    faults = [e for e in entries if registry[e["name"]]["kind"] == "fault"]
    physics = [e for e in entries if registry[e["name"]]["kind"] != "fault"]
    error = _error(search, order, other)
    doubts = [*([str(own)] if own else []), *([shared[1]] if shared else []), *at_bounds(entries), *record.doubts]
    doubts += [] if rivals or unknown else _unlikely(search, fit, entries)
    unsure = any(registry[e]["kind"] != "fault" for r in rivals for e in r["effects"])  # a fault that may be physics
    count = len(search.candidates) + len(impossible)
    verdict = verdict_of(physics or (faults if unsure else []), faults, [*rivals, *doubts], unknown, hidden, count)
    if verdict == "nothing" and behind:
        verdict, hidden = "cannot_tell", behind
    return {
        "verdict": verdict,
        "sentence": sentence_of(verdict, physics, faults, rivals, left, hidden, error, demoted)
        + "".join(f" But {doubt}." for doubt in doubts)
        + ("" if masked is None else f" {masked}."),
        "effects": physics,
        "faults": faults,
        "rivals": [{"effects": r["effects"], "why": r["why"]} for r in rivals],
        "not_testable": [{"name": h.name, "why": h.why, "experiment": h.experiment} for h in hidden],
        "where": {"before": _where(record, search.null), "after": _where(record, fit)},
        "error": error,
        "unexplained": {
            "rms_mm": left.rms_mm,
            "chi2_per_n": left.chi2_per_n,
            "blocked_r2": left.blocked_r2,
            "predicted_by": left.predicted_by,
        },
        "next": [*_mended(faults), *_next(rivals, hidden, registry, fit.effects)],
        "made_from": _made_from(search, order, other, demoted, registry, seed, masked),
    }


def _entries(
    search: Search,
    fit: Fit,
    larger: Fit | None,
    other: Record | None,
    order: list[str],
    weights: dict[str, float],
    rivals: list[dict[str, Any]],
    registry: dict[str, dict[str, Any]],
) -> list[dict[str, Any]]:
    record = search.problem.record
    sigma = search.problem.uncertainty(fit, search.dispersion(fit)) if len(fit.x) else np.zeros(0)
    if larger is not None:  # where another may act too, numbers are no surer than what it would make of them
        mine, theirs = fit.space.values(fit.x), larger.params
        sigma = np.hypot(sigma, mine - [theirs[label] for label in fit.space.free_labels])
    weights_of_sets = search.weights(fit, TEMPERATURE)
    entries = []
    for name in order:
        total = sum(weights[e] for e in order if (e in search.faults) == (name in search.faults))
        open_rivals = [r for r in rivals if r["member"] == name]
        place = {name}.union(*(set(r["effects"]) - set(fit.effects) for r in open_rivals))  # who may stand there
        there = min(1.0, sum(weight for effects, weight in weights_of_sets.items() if effects & place))
        held = None
        if other is not None:
            held = other.rms_mm(_shift_on(fit, other, name))
        entries.append(
            {
                "name": name,
                "family": registry[name]["family"],
                "stage": registry[name]["stage"],
                # The temperature is of bodies that were simulated: what a regressed rod errs by is not of their kind.
                "probability": None if record.model.kind == "rod" else there / (1.0 + RIVAL * len(open_rivals)),
                "share": weights[name] / max(total, 1e-300),
                "displacement_mm": {"fitted": record.rms_mm(search.displacement(fit, name)), "held_out": held},
                "params": parameters(record, fit, sigma, (name,)),
                **refitted(search, fit, sigma, name),
            }
        )
    return entries


def refitted(search: Search, fit: Fit, sigma: Floats, name: str) -> dict[str, Any]:
    """Return the changes of the prior's own numbers that were fitted along with an effect, and what it errs by then.

    The second is the error (F,) mm of each feature on blocks that trained nothing: with other numbers it is another
    model, and the noise that a rod's next diagnosis counts with.
    """
    changes = parameters(search.problem.record, fit, sigma, (name,), declared=False)
    if not changes:
        return {}
    record = search.problem.record
    squares = np.full_like(record.seen, np.nan)
    for prediction, (_, test) in zip(search.cv(fit)[2], search.problem.folds):
        squares[test] = (record.seen[test] - prediction[test]) ** 2
    error = np.sqrt(np.nanmean(squares, axis=0))
    if record.replay is not None:  # what is missed on the reference too is still missed
        own = [np.ravel(record.model.run_form_error(part.run)) for part in getattr(record, "parts", [record])]
        error = np.maximum(error, np.sqrt(np.mean(np.square(own), axis=0)))
    return {"refitted": {"params": changes, "error_mm": error.tolist()}}


def _shift_on(fit: Fit, other: Record, name: str) -> Floats:
    """Return what one effect does on another run (K, F) mm, the others in place."""
    layout = other.layout(fit.space.names)
    params = layout.values(fit.params)
    mine = np.array([label.split(".")[0] == name for label in layout.labels])
    both = np.stack([params, np.where(mine, layout.null, params)])
    shift = other.predict(fit.space.names, both)
    return np.asarray(shift[0] - shift[1])


def parameters(
    record: Record, fit: Fit, sigma: Floats, names: Sequence[str], declared: bool = True
) -> dict[str, dict[str, Any]]:
    """Return the fitted parameters of the effects `names` by label: value, sigma, unit, and whether at a bound.

    Those that the effects declare, or the numbers of the prior that were open with them. A number that stands for a
    case has its `meaning` in words.
    """
    values, bound = fit.space.values(fit.x), at_bound(fit)
    in_commands = {e["name"] for e in record.library.effects() if e["role"] == "channel"}
    found = {}
    for j, i in enumerate(fit.space.free):
        label, unit = fit.space.labels[i], fit.space.units[i]
        if label.split(".")[0] not in names or fit.space.declared[j] != declared:
            continue
        if unit == "g" and not getattr(record.model, "stiffness_known", True):
            unit = "of the model's own load scale"  # grams would be a claim without ground
        if label.split(".")[0] in in_commands:
            unit = unit.replace("mm", getattr(record.model, "command_unit", "mm"))
        found[label] = {"value": float(values[j]), "sigma": float(sigma[j]), "unit": unit, "at_bound": bool(bound[j])}
        if fit.space.integer[j]:
            chain = record.library.Chain([label.split(".")[0]], record.model.channels)
            said = dict(zip(chain.labels, chain.meanings([fit.params[own] for own in chain.labels])))
            found[label] |= {"meaning": said[label]} if said[label] else {}
    return found


def _unlikely(search: Search, fit: Fit, entries: list[dict[str, Any]]) -> list[str]:
    """Return a doubt where most of the probability lies on sets without what is named."""
    poor = [e["name"] for e in entries if e["probability"] is not None and e["probability"] < LIKELY]
    others = {key: w for key, w in search.weights(fit, TEMPERATURE).items() if key and not key >= set(poor)}
    if not poor or not others:
        return []
    best = max(others, key=lambda key: (others[key], sorted(key)))
    return [
        f"{' + '.join(poor)} is less likely than not among the sets that were tried, {' + '.join(sorted(best))} next "
        f"({100 * others[best]:.0f} %)"
    ]


def _rivals(
    search: Search,
    fit: Fit,
    found: list[tuple[str, Fit, str]],
    registry: dict[str, dict[str, Any]],
    impossible: set[str],
) -> list[dict[str, Any]]:
    """Return the rivals that were `found`, and what looks alike by form: tried, or `impossible` to try."""
    rivals = [{"member": member, "effects": list(other.effects), "why": why} for member, other, why in found]
    record = search.problem.record
    held = {label.split(".")[0] for label in record.untold}
    for member in fit.effects:
        for twin in equivalents(record, member, registry):
            swapped = [twin if e == member else e for e in fit.effects]
            if twin in fit.effects or any(set(swapped) == set(r["effects"]) for r in rivals):
                continue
            told_by = registry[member]["alike"].get(twin) or registry[twin]["alike"].get(member)
            tried = "; it was not tried"
            if told_by == "roll" and twin in held:
                tried = ": clouds do not show the roll that would tell them apart"
            elif twin in search.candidates:
                other = search.get(frozenset(swapped))
                share = stands_for(search, other, fit, member)
                tried = (
                    f"; fitted here it does {100.0 * max(share, 0.0):.0f} % of it" if told_by == "orientation" else ""
                )
                unable = told_by != "orientation" and share < RIVAL_SHARE  # forms of loads are off too far to rule out
                if unable or (told_by == "never" and worse(search, other, fit) > RIVAL_WORSE):
                    continue
            elif twin not in impossible:
                continue  # nobody asked for it
            why = f"{twin} and {member} look alike under the conditions of this run{tried}"
            rivals.append({"member": member, "effects": swapped, "why": why})
    return rivals


def _error(search: Search, order: list[str], other: Record | None) -> dict[str, Any]:
    problem, record = search.problem, search.problem.record
    found = ladder(search, order) if other is None else ladder_on(search, other, order)
    noise, form = problem.noise.rms_mm(record.positions), record.form_mm
    measured = record.model.kind != "rod"
    replicates = measured and problem.noise.replicates
    return {
        "kind": "held-out rms",
        "unit": "mm",
        **found,
        "noise_floor": noise if measured else None,
        "model_floor": form,
        "floor": noise if replicates else form,
        "floor_kind": "noise of replicates" if replicates else "the model's own held-out error",
        "held_out_on": (_judge(record) if other is None else "an independent run")
        + ("" if record.replay is None else ", relative to the reference"),
    }


def _judge(record: Record) -> str:
    kind = "labelled blocks" if labelled(record.block) else "blocks"
    return f"{kind} of the run that was fitted"


def _where(record: Record, fit: Fit) -> dict[str, list[dict[str, Any]]]:
    """Return the measured error by section and by condition as bins `{label, low, high, n, rms_mm}`, if any is seen."""
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
    for name, row in cells(record.state, getattr(record.model, "command_unit", "mm")).items():
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
    return {name: [row for row in rows if row["rms_mm"] is not None] for name, rows in found.items()}


def _mended(faults: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return what is put right by hand before anything is recorded."""
    told = {e["name"]: p["meaning"] for e in faults for p in e["params"].values() if p.get("meaning")}
    block = "put it right, plugs or columns and signs of the mapping, and diagnose again: {}"
    return [
        {"block": block.format(said), "minutes": 2.0, "settles": [name], "separation": None}
        for name, said in told.items()
    ]


def _next(
    rivals: list[dict[str, Any]],
    hidden: list[Untestable],
    registry: dict[str, dict[str, Any]],
    named: Sequence[str],
) -> list[dict[str, Any]]:
    """Return the blocks that would settle what is open; the separation is not simulated here and says so by null."""
    blocks: dict[str, dict[str, Any]] = {}
    for rival in rivals:
        other = next((e for e in rival["effects"] if e not in named), rival["member"])
        block, minutes = rival.get("experiment") or experiment(registry, rival["member"])
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
    demoted: Sequence[str],
    registry: dict[str, dict[str, Any]],
    seed: int,
    masked: Masked | None,
) -> dict[str, Any]:
    from softmap_edge import __version__

    problem, record = search.problem, search.problem.record
    return {
        "softmap": __version__,
        "seed": seed,
        "run": record.whole[0].hash() if len(record.whole) == 1 else [run.hash() for run in record.whole],
        "held_out": None if other is None else other.whole[0].hash(),
        "reference": None if record.replay is None else asdict(record.replay),
        "residual": None if masked is None else asdict(masked),
        "frames": len(record),
        "robot": getattr(record.model, "robot", None),
        "own_effects": list(record.model.chain_names),
        "python_effects": hashes([*record.model.chain_names, *search.candidates]),
        "candidates": search.candidates,
        "demoted": list(demoted),
        "noise": problem.noise.source,
        "inflation": problem.noise.inflation,
        "modes": len(problem.whitener.form),
        "temperature": TEMPERATURE,
        "references": {name: registry[name]["reference"] for name in order},
    }
