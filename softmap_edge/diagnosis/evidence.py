"""Evidence for a finished search.

The error ladder, effects that this run cannot show, and structure in the unexplained error.

Ladder: RMS distance in mm over the places (section centroids or markers), always on frames that
took no part in the fit: blocks of time, or an independent run. The static baseline is a ridge on a
polynomial of the command. It is the best that a corrector without memory or physics can reach.
Testability: whitened size of an effect's signature at a typical strength (see `typical_difference`)
on this run. Units: mm. Known limit: the ridge detects smooth dependence on the conditions, not
single events. Pinned by tests/diagnosis/test_diagnosis.py and tests/diagnosis/test_evidence.py.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis.decision import VISIBLE_MM
from softmap_edge.diagnosis.findings import Rung, Unexplained, Untestable
from softmap_edge.diagnosis.fit import Fit, Problem
from softmap_edge.diagnosis.fits import Fits
from softmap_edge.diagnosis.record import Record
from softmap_edge.model.effect_info import registry
from softmap_edge.noise.noise_model import scaled_commands
from softmap_edge.run.conditions import Bin, cells, last_direction, orientations

Floats = NDArray[np.float64]

DETECTABLE = 5.0  # whitened size below which a signature is not visible, standard deviations
RIDGE = 3.0  # ridge on standardised columns
IDLE = 0.05  # of an effect's size: smaller changes count as none
SEEN_R2 = 0.02  # share above which a condition is named as a predictor of the unexplained error
STATIC_RIDGE = 0.03  # ridge of a static residual, per training frame
Errors = tuple[float, float, tuple[Rung, ...], float, tuple[float, ...]]


def equivalents(record: Record, name: str) -> list[str]:
    """Return effects whose form this run cannot distinguish from `name`.

    All effects of the registry are considered, tried or not.
    """
    resolved = {
        "orientation": orientations(record.state.gravity) > 1,
        "load": record.load is not None and float(np.ptp(record.load)) > 0,
        "roll": record.roll_seen,
        "base": True,  # handled where an effect is named (`conclusion._twins`)
        "never": False,
    }
    effects = registry()
    known = {twin: by for twin, info in effects.items() if (by := info.alike.get(name)) is not None}
    known |= effects[name].alike
    return [twin for twin, by in known.items() if not resolved[by]]


def not_testable(fits: Fits, fit: Fit) -> list[Untestable]:
    """Return the candidates outside the fit whose signature this run does not show.

    The effects have typical strength.
    """
    problem, found = fits.problem, []
    for name in fits.candidates:
        if name in fit.effects:
            continue
        moved, white = detectability(problem, name)
        why = unseen(moved, float(np.linalg.norm(white)) / np.sqrt(fits.dispersion(fit)))
        if why is not None:
            found.append(Untestable(name, why, *registry()[name].experiment))
    return found


def detectability(problem: Problem, name: str) -> tuple[float, Floats]:
    """Return the effect size and signature at typical strength.

    The size is in mm RMS of the centreline; the whitened signature is (n,).
    """
    signature = np.where(
        np.isfinite(problem.record.seen), typical_difference(problem, name), np.nan
    )
    return problem.record.rms_mm(signature), problem.white(
        problem.whitener.modes(signature) * problem.gain
    )


def unseen(moved: float, size: float) -> str | None:
    """Return why a signature is not visible, if it is not.

    `size` is in standard deviations, the effect size `moved` in mm RMS.
    """
    if moved < VISIBLE_MM:
        return (
            f"too weak to detect here: a typical value moves the centreline by only {moved:.2f} "
            "mm RMS"
        )
    if size < DETECTABLE:
        return (
            f"a typical value has a signature of {size:.1f} standard deviations here; "
            f"{DETECTABLE:g} are needed"
        )
    return None


def typical_difference(problem: Problem, name: str) -> Floats:
    """Return the feature difference (K, F) mm of an effect at a typical strength.

    This strength is halfway from null to the end of its range. On a logarithmic scale, it is the
    start, or halfway up from there, whichever moves the body more.
    """
    space = problem.space((name,))
    # some effects are absent at their high end
    far = 0.5 * np.where(space.usual_high > 0, space.usual_high, space.low)
    middle = np.where(space.log, space.start, far)
    high = np.where(space.log, np.minimum(0.5, space.usual_high), far)
    middle, high = (np.where(space.declared, p, 0.0) for p in (middle, high))
    points = np.stack([np.clip(p, space.low, space.high) for p in (middle, high)])
    if np.array_equal(*points):
        points = points[:1]
    shifts = problem.record.predict(space.names, space.params(points)) - problem.unchanged
    largest: Floats = shifts[int(np.argmax([problem.record.rms_mm(s) for s in shifts]))]
    return largest


# --- what is left -------------------------------------------------------------------------------


def unexplained_structure(problem: Problem, residual: Floats, numbers: int) -> Unexplained:
    """Find structure in the unexplained error (K, F) mm after a number of fitted parameters."""
    record = problem.record
    white = problem.whitener.shrink(problem.whitener.modes(residual) * problem.gain)
    chi2 = float(np.sum(white**2)) / max(1.0, problem.numbers - numbers)
    groups = condition_columns(record)
    total = _blocked_r2(problem, np.concatenate(list(groups.values()), axis=1), white)
    alone = {name: _blocked_r2(problem, columns, white) for name, columns in groups.items()}
    best = max(alone, key=lambda name: alone[name])
    r2, noise = max(total, alone[best]), problem.noise.rms_mm(record.positions)
    beyond = float(np.sqrt(max(0.0, record.rms_mm(residual) ** 2 - noise**2)))
    return Unexplained(beyond, chi2, r2, best if r2 > SEEN_R2 else None)


def at_bound(fit: Fit) -> NDArray[np.bool_]:
    """Return which free parameters (P,) are at a bound.

    Excluded are bounds at which the effect is absent (no payload, one creep time, a channel without
    backlash), the largest integer, and natural limits: 0 or 1 of a share, half a turn, the shortest
    time.
    """
    space = fit.space
    null, found = space.scaled(space.null), np.zeros(len(fit.x), bool)
    units = np.array([space.units[i] for i in space.free], object)
    lasting = np.array([space.labels[i] == "anchor_slip.width" for i in space.free], bool)
    for x in (space.low, space.high):
        value = space.values(x)
        nature = (units == "1") & ((value == 0.0) | (value == 1.0)) & ~lasting
        nature |= (units == "deg") & (np.abs(value) == 180.0)
        found |= (np.abs(fit.x - x) <= 1e-6) & (np.abs(x - null) > 1e-6) & ~nature
    found &= ~space.integer
    for i in np.flatnonzero(found):
        found[i] = not _idle(fit, space.free_labels[i])
    return np.asarray(found)


def _idle(fit: Fit, label: str) -> bool:
    """Whether a parameter of an effect has no influence, relative to the others.

    It may then have any value up to its null.
    """
    space, record = fit.space, fit.problem.record
    null = dict(zip(space.free_labels, space.null))
    own = [other for other in null if other.split(".")[0] == label.split(".")[0]]
    params = [{**fit.params, **{name: null[name] for name in names}} for names in ([label], own)]
    rows = np.array([[row[name] for name in space.labels] for row in params])
    one, every = (
        record.rms_mm(fit.predicted - p) for p in record.predict(space.names, space.full(rows))
    )
    return one <= IDLE * every


def condition_columns(record: Record) -> dict[str, Floats]:
    """Return the columns for the unexplained error, by condition; each (K, n)."""
    state, k = record.state, len(record)
    u = scaled_commands(record.command, 0.5 * record.spread)
    v = state.velocity
    pace = v / np.maximum(np.abs(v).max(axis=0, initial=0.0), 1e-9)
    sign = last_direction(state.velocity, state.moving)
    time = (
        (state.time - state.time.mean()) / max(float(np.ptp(state.time)), 1e-9) if k else state.time
    )
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
    """Return the polynomial (K, n) of scaled commands (K, C).

    It is cubic up to two channels, else quadratic.
    """
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
    """Return predictions (K, m) of a ridge trained on frames `train`.

    Columns (K, n) are standardised there.
    """
    mean, spread = columns[train].mean(axis=0), columns[train].std(axis=0)
    z = (columns - mean) / np.where(spread > 1e-9, spread, np.inf)
    centre = values[train].mean(axis=0)
    gram = z[train].T @ z[train] + strength * np.eye(z.shape[1])
    return np.asarray(centre + z @ np.linalg.solve(gram, z[train].T @ (values[train] - centre)))


def _blocked_r2(problem: Problem, columns: Floats, values: Floats) -> float:
    """Return the held-out share of the mean square that a ridge explains."""
    predicted = np.zeros_like(values)
    for train, test in problem.folds:
        predicted[test] = ridge(columns, values, train, RIDGE * problem.noise.inflation)[test]
    return float(1.0 - np.sum((values - predicted) ** 2) / max(float(np.sum(values**2)), 1e-300))


def by_condition(record: Record, residual: Floats) -> dict[str, tuple[Bin, ...]]:
    """Return an error (K, F) mm by section and by condition, where any is seen."""
    squares = record.squares(residual)  # (K, places)

    def row(label: str, low: float | None, high: float | None, n: int, values: Floats) -> list[Bin]:
        good = values[np.isfinite(values)]
        return [Bin(label, low, high, n, float(np.sqrt(good.mean())))] if len(good) else []

    sections = record.section[record.positions]
    found = {
        "section": tuple(
            b
            for i, s in enumerate(sections)
            for b in row(str(int(s)), None, None, len(record), squares[:, i])
        )
    }
    for name, cell_row in cells(record.state, record.model.command_unit).items():
        bins = [
            b
            for c in cell_row
            for b in row(c.label, c.low, c.high, int(c.frames.sum()), squares[c.frames])
        ]
        found[name] = tuple(bins)
    return found


# --- the ladder ---------------------------------------------------------------------------------


def ladder(
    fits: Fits, order: Sequence[str], split: Collection[str], other: Record | None = None
) -> Errors:
    """Return held-out errors (mm): model, static baseline, each effect, both; per fold.

    They are from held-out blocks, or from an independent run `other`. That run uses the parameters
    and static residual of the diagnosed run.
    """
    problem, record = fits.problem, fits.problem.record
    steps = [fits.null, *(fits.get(order[: i + 1], split) for i in range(len(order)))]
    per_fold: tuple[float, ...] = ()
    if other is None:
        predictions = fits.losses(steps[-1])[1]
        per_fold = tuple(
            record.rms_mm(record.seen - p, t) for p, (_, t) in zip(predictions, problem.folds)
        )

    def error(fit: Fit, static: bool = False) -> float:
        if other is None:
            return _held_out(problem, fits.losses(fit)[1], static)
        residual = other.seen - fit.on(other)
        if static:
            residual = residual - _static(
                record, other, record.seen - fit.predicted, np.arange(len(record))
            )
        return other.rms_mm(residual)

    rungs = tuple(Rung(e, error(f)) for e, f in zip(order, steps[1:]))
    return error(fits.null), error(fits.null, True), rungs, error(steps[-1], True), per_fold


def _held_out(problem: Problem, predictions: Floats, static: bool) -> float:
    record = problem.record
    squares = []
    for prediction, (train, test) in zip(predictions, problem.folds):
        residual = record.seen - prediction
        if static:
            residual = residual - _static(record, record, residual, train)
        squares.append(record.squares(residual)[test].ravel())
    return float(np.sqrt(np.nanmean(np.concatenate(squares))))


def _static(record: Record, at: Record, residual: Floats, train: NDArray[np.int64]) -> Floats:
    """Return a static residual (K of `at`, F), trained on frames `train` of `record`.

    Each feature is trained on the frames that show it.
    """
    half = 0.5 * record.spread
    columns = np.concatenate(
        [static_basis(scaled_commands(r.command, half)) for r in (record, at)]
    )[:, 1:]
    found = np.zeros((len(at), residual.shape[1]))
    visible, which = np.unique(np.isfinite(residual[train]).T, axis=0, return_inverse=True)
    for i, seen in enumerate(visible):
        rows, features = train[seen], np.flatnonzero(which.reshape(-1) == i)
        if len(rows):
            values = np.zeros((len(columns), len(features)))
            values[: len(record)] = np.where(np.isfinite(residual), residual, 0.0)[:, features]
            found[:, features] = ridge(columns, values, rows, STATIC_RIDGE * len(rows))[
                len(record) :
            ]
    return found
