"""What a finished search is worth: the error ladder, effects that this run cannot show, and structure that is left.

Ladder: RMS distance in mm over the places (section centroids or markers), always on frames that trained nothing: blocks
of time, or an independent run. A static residual is a ridge on a polynomial of the command; it is what a corrector
without memory or physics could reach.
Testability: whitened size of an effect's signature at mid-range (see `strongest`) on this very run.
Leftover: RMS beyond noise, a claim where it is LEFT times what the model's own error, noise and untrue forms allow; the
blocked R² of a ridge on velocity, direction, dwell, history, time, temperature, orientation and command says by what.
Units: mm. Known limit: the ridge sees what is smooth in these conditions, not what happens once. Pinned by
tests/test_diagnosis.py and tests/test_evidence.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis.conditions import last_direction, orientations
from softmap_edge.diagnosis.fit import Fit, Problem
from softmap_edge.diagnosis.noise import scaled_commands
from softmap_edge.diagnosis.record import Record
from softmap_edge.diagnosis.search import VISIBLE_MM, Search

Floats = NDArray[np.float64]

DETECTABLE = 5.0  # whitened size (standard deviations) below which a signature counts as not shown
RIDGE = 3.0  # ridge on standardised columns
LEFT_R2, SEEN_R2 = 0.12, 0.02  # from which a condition is named as what predicts a leftover, and is kept at all
STATIC_RIDGE = 0.03  # of a static residual, for each frame that trains it
# How far the form of an effect is off, of what it moves, by role or by name, and of one at its bound; how far the noise
# may be off; how many times what these and the model's own error leave is something else. From development seeds of the
# bank (docs/bank.md).
FORMS = {"channel": 0.15, "prior": 0.15, "shape": 0.25, "sensing": 0.2}
FORMS |= {"dead_zone": 0.3, "friction": 0.3, "hysteresis": 0.35, "mullins": 0.3, "saturation": 0.3}
FORMS |= {"tendon_creep": 0.3, "thermal_softening": 0.25, "camera_drift": 0.4}
BEYOND, NOISE, LEFT = 0.7, 0.4, 1.25
FARTHER = 2.0  # times as far as its bound an amount is looked for before what is left is called unknown
LASTS = ("anchor_slip.width",)  # shares that no nature ends
TURNED = ("routing", "twist", "mount")  # whose angles are amounts
OTHER_BEYOND = ("contact", "eccentric_pulley")  # an obstacle that holds the body; a sine so long that it is a line
CLEAR = 1.5  # times what is visible that must be left: every finger has small faults of its own
HALVED = 0.5  # of the held-out error: an effect that, added, leaves less was not left out for want of evidence
MUCH = 3.0  # times the form error that must be left for a second effect to be asked for


@dataclass(frozen=True)
class Untestable:
    """An effect that this run cannot show (or cannot tell from another): why, and the experiment that would."""

    name: str
    why: str
    experiment: str
    minutes: float


@dataclass(frozen=True)
class Leftover:
    """What is left after the best fit: mm RMS beyond the noise, chi²/n, blocked R², what predicts it, is it a claim."""

    rms_mm: float
    chi2_per_n: float
    blocked_r2: float
    predicted_by: str | None
    claim: bool


def equivalents(record: Record, name: str, registry: Mapping[str, dict[str, Any]]) -> list[str]:
    """Return the effects of the registry, tried or not, that this run cannot tell from `name` by their form."""
    resolved = {
        "orientation": orientations(record.state.gravity) > 1,
        "load": record.load is not None and float(np.ptp(record.load)) > 0,
        "roll": record.roll_seen,
        "never": False,
    }
    told = {twin: by for twin in registry if (by := registry[twin]["alike"].get(name)) is not None}
    told |= {twin: by for twin, by in registry[name]["alike"].items() if twin in registry}
    return [twin for twin, by in told.items() if not resolved[by]]


def experiment(registry: Mapping[str, dict[str, Any]], name: str) -> tuple[str, float]:
    """Return what to record so that an effect shows itself, and the minutes that takes."""
    block, minutes = registry[name]["experiment"]
    return str(block), float(minutes)


def not_testable(search: Search, fit: Fit, registry: dict[str, dict[str, Any]]) -> list[Untestable]:
    """Return the candidates outside the fit whose signature at mid-range this run does not show."""
    problem, found = search.problem, []
    for name in search.candidates:
        if name in fit.effects:
            continue
        block, minutes = experiment(registry, name)
        moved, white = shown(problem, name)
        why = unseen(moved, float(np.linalg.norm(white)) / np.sqrt(search.dispersion(fit)))
        if why is not None:
            found.append(Untestable(name, why, block, minutes))
    return found


def shown(problem: Problem, name: str) -> tuple[float, Floats]:
    """Return how an effect at mid-range shows in a run: mm RMS of the centreline, and its whitened signature (n,)."""
    signature = np.where(np.isfinite(problem.record.seen), strongest(problem, name), np.nan)
    return problem.record.rms_mm(signature), problem.white(problem.whitener.modes(signature) * problem.gain)


def unseen(moved: float, size: float) -> str | None:
    """Return why a signature of `size` standard deviations that moves the body by `moved` mm is not seen, if so."""
    if moved < VISIBLE_MM:
        return f"at mid-range it would move the centreline by {moved:.2f} mm RMS on these commands"
    if size < DETECTABLE:
        return f"at mid-range its signature has {size:.1f} standard deviations here, {DETECTABLE:g} are needed"
    return None


def strongest(problem: Problem, name: str) -> Floats:
    """Return the feature difference (K, F) mm that an effect makes at mid-range.

    That is half-way from null to the end of its range; on a logarithmic scale its start or half-way up from there,
    whichever moves the body more.
    """
    space = problem.space((name,))
    far = 0.5 * np.where(space.usual_high > 0, space.usual_high, space.low)  # some are absent at their high end
    middle = np.where(space.log, space.start, far)
    high = np.where(space.log, np.minimum(0.5, space.usual_high), far)
    middle, high = (np.where(space.declared, p, 0.0) for p in (middle, high))
    points = np.stack([np.clip(p, space.low, space.high) for p in (middle, high)])
    own = problem.space(())
    before = problem.record.predict(own.names, own.params(np.zeros((1, 0))))[0]
    shifts = problem.record.predict(space.names, space.params(points)) - before
    largest: Floats = shifts[int(np.argmax([problem.record.rms_mm(s) for s in shifts]))]
    return largest


# --- what is left -------------------------------------------------------------------------------


def leftover(search: Search, fit: Fit) -> Leftover:
    """Look for structure in what the best fit leaves."""
    problem, record = search.problem, search.problem.record
    white = problem.whitener.shrink(fit.modes)
    chi2 = fit.chi2 / max(1.0, problem.numbers - len(fit.x))
    groups = condition_columns(record)
    total = _blocked_r2(problem, np.concatenate(list(groups.values()), axis=1), white)[0]
    alone = {name: _blocked_r2(problem, columns, white)[0] for name, columns in groups.items()}
    best = max(alone, key=lambda name: alone[name])
    r2 = max(total, alone[best])
    rms, most = _left_mm(problem, fit), max(CLEAR * search.visible_mm, LEFT * allowed(search, fit))
    claim, more = rms > most, _amounts_at_bound(fit)
    if claim and more.any():  # what may lie beyond the bound is not unknown
        claim = _left_mm(problem, problem.beyond(fit, more, FARTHER)) > most
    return Leftover(rms, chi2, r2, best if r2 > SEEN_R2 else None, bool(claim))


def _left_mm(problem: Problem, fit: Fit) -> float:
    """Return what a fit leaves beyond the noise, mm RMS."""
    record, noise = problem.record, problem.noise.rms_mm(problem.record.positions)
    return float(np.sqrt(max(0.0, record.rms_mm(record.seen - fit.predicted) ** 2 - noise**2)))


def allowed(search: Search, fit: Fit) -> float:
    """Return what may be left in mm RMS with nothing missing: of the model's own error, the noise and untrue forms.

    Forms are off by FORMS of all that is explained, the mean square over the effects by how far each moves: those that
    were found, and those that the model has already, which were found once. A
    field whose strength is at its bound may leave much of what it moves: more of it may be there. Any other effect
    with a number at its bound has no more than is usual: it may stand for something else.
    """
    record = search.problem.record
    bare, mine = _own_moves(record, search.screening.roles)
    moved = np.array([*mine.values(), *(record.rms_mm(search.displacement(fit, e)) for e in fit.effects)])
    roles, space = search.screening.roles, fit.space
    beyond, strained = (
        {space.labels[i].split(".")[0] for i in space.free[which]} for which in (_amounts_at_bound(fit), at_bound(fit))
    )
    forms = {e: FORMS[roles[e]] if e in strained else FORMS.get(e, FORMS[roles[e]]) for e in (*mine, *fit.effects)}
    off = [BEYOND if roles[e] == "shape" and e in beyond else form for e, form in forms.items()]
    share = float(np.linalg.norm(np.array(off) * moved) / max(float(np.linalg.norm(moved)), 1e-300))
    static = 0.0 if record.static is None else record.rms_mm(record.static)  # a residual that was taken out
    explained = record.rms_mm(np.where(np.isfinite(record.seen), fit.predicted - bare, np.nan))
    noise = NOISE * search.problem.noise.rms_mm(record.positions)
    own = 0.0 if record.model.kind == "rod" else record.form_mm  # a rod's error is its noise, taken off already
    return float(np.linalg.norm([own, static, noise, share * explained]))


def _own_moves(record: Record, roles: Mapping[str, str]) -> tuple[Floats, dict[str, float]]:
    """Return what the prior alone predicts (K, F), and how far each of the model's own effects moves the body, mm.

    A law of the prior's own is the prior.
    """
    names = tuple(record.model.chain_names)
    layout, own = record.layout(names), record.own()
    belongs = np.array([label.split(".")[0] for label in layout.labels])
    added = [name for name in names if roles[name] != "prior"]
    if not added:
        return record.predict(names, own[None])[0], {}
    rows = [np.where(np.isin(belongs, some), layout.null, own) for some in ([], added, *([name] for name in added))]
    now, bare, *without = record.predict(names, np.stack(rows))
    return bare, {name: record.rms_mm(now - other) for name, other in zip(added, without)}


def at_bound(fit: Fit) -> NDArray[np.bool_]:
    """Return which free parameters (P,) are at a bound.

    One where the effect ends (no payload, one creep time) is none, nor is the last of whole numbers, nor an end by
    nature: nothing or all of a share, half a turn. A slip that lasts as long as it may is no slip.
    """
    space = fit.space
    null, found = space.scaled(space.null), np.zeros(len(fit.x), bool)
    units = np.array(["" if space.labels[i] in LASTS else space.units[i] for i in space.free], object)
    for x in (space.low, space.high):
        value = space.values(x)
        nature = (units == "1") & ((value == 0.0) | (value == 1.0)) | (units == "deg") & (np.abs(value) == 180.0)
        found |= (np.abs(fit.x - x) <= 1e-6) & (np.abs(x - null) > 1e-6) & ~nature
    return np.asarray(~space.integer & found)


def _amounts_at_bound(fit: Fit) -> NDArray[np.bool_]:
    """Return which free parameters (P,) are amounts (absent at zero, on no log scale) at a bound, so that more may act.

    An angle says which way, but for tendons and sections that are turned; and more of some acts as something else.
    """
    space = fit.space
    amounts = [
        effect not in OTHER_BEYOND and (unit != "deg" or effect in TURNED)
        for effect, unit in ((space.labels[i].split(".")[0], space.units[i]) for i in space.free)
    ]
    return np.asarray(at_bound(fit) & np.array(amounts, bool) & (space.null == 0.0) & ~space.log & space.declared)


def not_alone(search: Search, fit: Fit, left: Leftover) -> tuple[Fit, str] | None:
    """Return the larger set that may act instead of what was found, and why, if there is one.

    Two effects that look alike share what they explain, so that the second adds too little to be named (`SHARE`) and
    the numbers of the first stand for both. It shows in what is left: far above the form error, and halved by it.
    """
    if not fit.effects or left.rms_mm <= max(search.visible_mm, MUCH * search.problem.record.form_mm):
        return None
    more = [(search.held_out_mm(other), other) for other in search.larger(fit)]
    before, (after, best) = search.held_out_mm(fit), min(more, key=lambda pair: pair[0], default=(np.inf, fit))
    if after > HALVED * before:
        return None
    extra = next(iter(set(best.effects) - set(fit.effects)))
    return best, (
        f"with {extra} as well {after:.2f} of {before:.2f} mm RMS are left (held out): both may act, and the numbers "
        f"of {' + '.join(fit.effects)} are those of one alone"
    )


def condition_columns(record: Record) -> dict[str, Floats]:
    """Return the columns that a leftover may depend on, by condition; each (K, n)."""
    state, k = record.state, len(record)
    u = scaled_commands(record.command, 0.5 * record.spread)
    v = state.velocity
    pace = v / np.maximum(np.abs(v).max(axis=0, initial=0.0), 1e-9)
    sign = last_direction(state.velocity, state.moving)
    time = (state.time - state.time.mean()) / max(float(np.ptp(state.time)), 1e-9) if k else state.time
    history = state.history / max(float(state.history.max(initial=0.0)), 1e-9)
    dwell = np.log1p(state.dwell)
    groups = {
        "direction of motion": np.concatenate([sign, sign * np.abs(u)], axis=1),
        "speed": np.concatenate([pace, np.abs(pace)], axis=1),
        "dwell": np.concatenate([dwell[:, None], dwell[:, None] * u], axis=1),
        "largest past command": np.concatenate([history[:, None], history[:, None] * u], axis=1),
        "time": np.concatenate([time[:, None], time[:, None] ** 2, time[:, None] * u], axis=1),
        "command": static_basis(u)[:, 1:],
    }
    if state.temperature is not None and np.ptp(state.temperature) > 0:
        warm = (state.temperature - state.temperature.mean())[:, None]
        groups["temperature"] = np.concatenate([warm, warm * u], axis=1)
    if state.gravity is not None and np.ptp(state.gravity, axis=0).max() > 0.1:
        groups["orientation"] = state.gravity
    return {name: columns for name, columns in groups.items() if columns.shape[1]}


def static_basis(u: Floats) -> Floats:
    """Return the polynomial (K, n) of scaled commands (K, C): cubic up to two channels, else quadratic."""
    columns = [np.ones(len(u))]
    channels = u.shape[1]
    for i in range(channels):
        columns.append(u[:, i])
        for j in range(i, channels):
            columns.append(u[:, i] * u[:, j])
            if channels <= 2:
                columns += [u[:, i] * u[:, j] * u[:, k] for k in range(j, channels)]
    return np.stack(columns, axis=1)


def ridge(columns: Floats, values: Floats, train: NDArray[np.int64], strength: float) -> Floats:
    """Return predictions (K, m) of a ridge trained on frames `train`; columns (K, n) are standardised there."""
    mean, spread = columns[train].mean(axis=0), columns[train].std(axis=0)
    z = (columns - mean) / np.where(spread > 1e-9, spread, np.inf)
    centre = values[train].mean(axis=0)
    gram = z[train].T @ z[train] + strength * np.eye(z.shape[1])
    return np.asarray(centre + z @ np.linalg.solve(gram, z[train].T @ (values[train] - centre)))


def _blocked_r2(problem: Problem, columns: Floats, values: Floats) -> tuple[float, Floats]:
    """Return the held-out share of the mean square that a ridge explains, and its held-out predictions."""
    predicted = np.zeros_like(values)
    for train, test in problem.folds:
        predicted[test] = ridge(columns, values, train, RIDGE * problem.noise.inflation)[test]
    return float(1.0 - np.sum((values - predicted) ** 2) / max(float(np.sum(values**2)), 1e-300)), predicted


# --- the ladder ---------------------------------------------------------------------------------


def ladder(search: Search, order: Sequence[str]) -> dict[str, Any]:
    """Return the held-out errors in mm on blocks of the run: model, static residual, effects one by one, both."""
    problem, record = search.problem, search.problem.record
    steps = [search.get(order[: i + 1]) for i in range(len(order))]
    last = search.cv(steps[-1] if steps else search.null)[2]
    null = search.cv(search.null)[2]
    return {
        "model": _held_out(problem, null),
        "static_residual": _held_out(problem, null, static=True),
        "ladder": [{"added": e, "value": _held_out(problem, search.cv(f)[2])} for e, f in zip(order, steps)],
        "with_static_residual": _held_out(problem, last, static=True),
        "per_fold": [record.rms_mm(record.seen - p, t) for p, (_, t) in zip(last, problem.folds)],
    }


def _held_out(problem: Problem, predictions: Floats, static: bool = False) -> float:
    record = problem.record
    squares = []
    for prediction, (train, test) in zip(predictions, problem.folds):
        residual = record.seen - prediction
        if static:
            residual = residual - _static(record, record, residual, train)
        squares.append(record.squares(residual)[test].ravel())
    return float(np.sqrt(np.nanmean(np.concatenate(squares))))


def ladder_on(search: Search, other: Record, order: Sequence[str]) -> dict[str, Any]:
    """Return the same errors on an independent run; parameters and static residual come from the diagnosed run."""
    record = search.problem.record
    every = np.arange(len(record))

    def error(fit: Fit, static: bool = False) -> float:
        residual = other.seen - fit.on(other)
        if static:
            residual = residual - _static(record, other, record.seen - fit.predicted, every)
        return other.rms_mm(residual)

    steps = [search.get(order[: i + 1]) for i in range(len(order))]
    return {
        "model": error(search.null),
        "static_residual": error(search.null, static=True),
        "ladder": [{"added": e, "value": error(f)} for e, f in zip(order, steps)],
        "with_static_residual": error(steps[-1] if steps else search.null, static=True),
        "per_fold": [],
    }


def _static(record: Record, at: Record, residual: Floats, train: NDArray[np.int64]) -> Floats:
    """Return a static residual (K of `at`, F) trained on frames `train` of `record`, each feature where it is seen."""
    half = 0.5 * record.spread
    columns = np.concatenate([static_basis(scaled_commands(r.command, half)) for r in (record, at)])[:, 1:]
    found = np.zeros((len(at), residual.shape[1]))
    shown, which = np.unique(np.isfinite(residual[train]).T, axis=0, return_inverse=True)
    for i, seen in enumerate(shown):
        rows, features = train[seen], np.flatnonzero(which.reshape(-1) == i)
        if len(rows):
            values = np.zeros((len(columns), len(features)))
            values[: len(record)] = np.where(np.isfinite(residual), residual, 0.0)[:, features]
            found[:, features] = ridge(columns, values, rows, STATIC_RIDGE * len(rows))[len(record) :]
    return found
