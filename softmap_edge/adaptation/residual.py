"""A residual: a smooth static function of the command, learned from a run.

It is added to a model and its effects.

    points(u_eff) = prior(u_eff) + Σ cₖ·Sₖ(u_eff) + residual(u_eff),
        residual = mean + modes · a(u_eff)

The model error is reduced to at most MODES modes that the commands predict. Their weights a(u) are
radial basis functions of the effective commands, with the smoothing that minimises the held-out
error (`sweep/scattered.py`). It does not depend on direction, speed, orientation or load. It
represents every static effect under the conditions of its run, and distinguishes none of them.
Points that the prior holds fixed do not move. A residual is valid only with the effects it was
learned with: when they change it is dropped, and diagnoses remove it
(`diagnosis/behind_residual.py`). Vertices registered to clouds are complete: registration places
the unseen ones (0.17 mm on two views of the virtual finger). They are not used for validation.
Units: mm. Limits: frames with a hidden tracked point are not used; beyond the run's commands the
residual extrapolates. Pinned by tests/adaptation/test_residual.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import SoftmapError
from softmap_edge.files.atomic import Document
from softmap_edge.model.training_range import span
from softmap_edge.model.views import laid
from softmap_edge.run.folds import Folds, run_folds
from softmap_edge.run.run import as_runs, known
from softmap_edge.sweep.scattered import ScatteredFit, fit_scattered, half_range

if TYPE_CHECKING:
    from softmap_edge.model.model import Model
    from softmap_edge.model.shapes import ModeArrays
    from softmap_edge.run.run import Run

Floats = NDArray[np.float64]
# commands (S, C), model errors (S, 3N) mm, visible points (S, N)
Missed = tuple[Floats, Floats, NDArray[np.bool_]]

MODES = 8  # modes of the model error, at most
# least share of the mean square of a mode's weights predicted on held-out blocks; less is noise
PREDICTED = 0.1
NODES = 64  # of the radial basis functions
# most frames, and most numbers (320 MB), that are used, evenly spread
ROWS, NUMBERS = 600, 40_000_000
LAID_SEEN = 0.3  # share of the vertices that a complete frame must show
# complete frames; distinct commands per channel, and one more
LEAST_FRAMES, LEAST_PLACES = 30, 3
APART = 60.0  # s between runs, so that no block spans two
LEAST_ALIKE, WORSE = 8, 1.1  # frames near other runs' commands, and error ratio, to report
CLOSE = 0.002  # of half the command range: nearer commands count as one
STILL = 1e-3  # of the largest motion: prior points that move less are fixed


def learn_residual(model: Model, run: Run | Sequence[Run]) -> tuple[Model, Document]:
    """Learn a residual from the error of a model on a run.

    Args:
        model: its prior and effects stay unchanged; an earlier residual is replaced.
        run: one or several runs, with the model's own points (vertices, or the same markers) in K
            >= 30 complete frames. Of vertices registered to clouds, unseen ones count at their
            registered places.

    Returns:
        tuple: the model with its residual, and a document with the errors before and after (mm RMS,
        held out on blocks) and the mean fall of the squared error in standard errors.

    Raises:
        SoftmapError: too few complete frames or different commands, points that are not the model's
            own.
    """
    base = model.with_residual(None)
    runs = as_runs(run)
    each, times = _missed(base, runs)
    commands, missed, seen = (np.concatenate(rows) for rows in zip(*each))
    taught = missed * ~_still(base, commands)
    parts = run_folds(times)
    count = _predicted(commands, taught, parts)
    left, gains = missed.copy(), []
    for train, test in parts:
        fitted = _fitted(commands[train], taught[train], count).compiled()
        left[test] -= fitted.evaluate(commands[test])
        gains.append(_rms(missed[test], seen[test]) ** 2 - _rms(left[test], seen[test]) ** 2)
    arrays = _fitted(commands, taught, count)
    found = base.with_residual(arrays)
    report = {
        "frames": len(missed),
        "of_frames": sum(one.frames for one in runs),
        "modes": count,
        "size_mm": _rms(arrays.compiled().evaluate(commands)),
        "before_rms_mm": _rms(missed, seen),
        "after_held_out_rms_mm": _rms(left, seen),
        "gain_in_se": float(
            np.mean(gains) / max(np.std(gains, ddof=1) / np.sqrt(len(gains)), 1e-12)
        ),
        "command_range": span(commands),
        "warnings": strangers(each),
    }
    made = dict(base.made_from) | {"residual": {"run": [one.hash() for one in runs], **report}}
    return replace(found, made_from=made), report


def strangers(runs: Sequence[Missed]) -> list[str]:
    """Report runs whose model errors differ from those of the other runs.

    A residual learned from the others increases the error on these.
    """
    notes = []
    for k, (commands, missed, seen) in enumerate(runs if len(runs) > 1 else ()):
        others = [run for number, run in enumerate(runs) if number != k]
        u, theirs, _ = (np.concatenate(rows) for rows in zip(*others))
        within = np.flatnonzero(
            ((commands >= u.min(axis=0)) & (commands <= u.max(axis=0))).all(axis=1)
        )
        some = np.unique(np.linspace(0, len(u) - 1, min(len(u), ROWS)).astype(int))
        if len(within) < LEAST_ALIKE or not seen[within].any():
            continue
        try:
            fitted = _fitted(u[some], theirs[some], MODES).compiled()
            rest = fitted.evaluate(np.ascontiguousarray(commands[within]))
        except SoftmapError:  # too few different commands to say
            continue
        before, after = (
            _rms(left, seen[within]) for left in (missed[within], missed[within] - rest)
        )
        if after > WORSE * before:
            notes.append(
                f"run {k + 1} of {len(runs)}: the error learned from the other runs makes this "
                f"one worse ({before:.2f} → {after:.2f} mm RMS): another robot, load or "
                "orientation; teach with runs of one state"
            )
    return notes


def _missed(base: Model, runs: Sequence[Run]) -> tuple[list[Missed], Floats]:
    """Return the model errors in the complete frames of all runs, and their times (S,) s."""
    if not runs:
        raise SoftmapError("no run is given; a residual is learned from at least one")
    each, times, end = list[Missed](), list[Floats](), 0.0
    room = max(LEAST_FRAMES, min(ROWS, NUMBERS // base.rest.size) // len(runs))
    for run in runs:
        seen = base.points_in_mm(run)
        if seen.shape[1] != len(base.rest) or (run.markers is not None and not base.markers):
            raise SoftmapError(
                f"the run shows {seen.shape[1]} markers on a model of {len(base.rest)} points: "
                "what lies between them is not seen, so no residual can be learned; use a run of "
                "vertices, or a rod learned from markers"
            )
        visible = known(run, seen)
        least = LAID_SEEN if laid(run) else 1.0
        complete = np.flatnonzero(visible.mean(axis=1) >= least)
        some = run.at(
            complete[
                np.unique(np.linspace(0, len(complete) - 1, min(len(complete), room)).astype(int))
            ]
        )
        if not some.frames:
            continue
        points = base.points_in_mm(some)
        missed = (points - base.predict(some)).reshape(some.frames, -1)
        each.append((base.effective_commands(some), missed, known(some, points)))
        times.append(some.t_seen - some.t_seen[0] + end)
        end = float(times[-1][-1]) + APART
    frames = sum(len(t) for t in times)
    if frames < LEAST_FRAMES:
        raise SoftmapError(
            f"{frames} frames show every point, at least {LEAST_FRAMES} are needed to learn a "
            "residual; record more, or from a side from which all is seen"
        )
    return each, np.concatenate(times)


def _still(base: Model, commands: Floats) -> NDArray[np.bool_]:
    """Return a mask of the 3N coordinates that the prior keeps fixed (clamp)."""
    moved = np.ptp(base.prior.evaluate(commands).reshape(len(commands), -1, 3), axis=0).max(axis=1)
    return np.repeat(moved < STILL * float(moved.max(initial=0.0)), 3)


def _reduced(taught: Floats, count: int) -> tuple[Floats, Floats]:
    """Return mean (3N,) and modes (count, 3N) of values (S, 3N); both 0 if nothing is learned."""
    mean = taught.mean(axis=0)
    modes = np.linalg.svd(taught - mean, full_matrices=False)[2][:count]
    return mean, np.where(np.any(taught != 0.0, axis=0), modes, 0.0)


def _predicted(commands: Floats, taught: Floats, parts: Folds) -> int:
    """Return how many modes the commands predict on held-out blocks, at least one.

    All modes up to the last predictable one count.
    """
    mean, modes = _reduced(taught, MODES)
    weights = (taught - mean) @ modes.T
    predicted = np.zeros_like(weights)
    for train, test in parts:
        alone = _fitted_weights(commands[train], weights[train])
        each = alone.of_modes(np.zeros(len(modes)), np.eye(len(modes)))
        predicted[test] = each.compiled().evaluate(commands[test])
    kept = np.sum((weights - predicted) ** 2, axis=0) < (1.0 - PREDICTED) * np.sum(
        weights**2, axis=0
    )
    return 1 + int(np.flatnonzero(kept).max(initial=0))


def _fitted(commands: Floats, taught: Floats, count: int) -> ModeArrays:
    """Return a scattered family of `count` modes for values (S, 3N) at commands (S, C)."""
    mean, modes = _reduced(taught, count)
    fitted = _fitted_weights(commands, (taught - mean) @ modes.T)
    return fitted.of_modes(mean.astype(np.float32), modes.astype(np.float32))


def _fitted_weights(commands: Floats, weights: Floats) -> ScatteredFit:
    """Return the fit of weights (S, m) at commands (S, C)."""
    scale = half_range(commands)
    _, first, place = np.unique(
        np.round(commands / scale / CLOSE), axis=0, return_index=True, return_inverse=True
    )
    place, required = place.reshape(-1), LEAST_PLACES * (commands.shape[1] + 1)
    if len(first) < required:
        raise SoftmapError(
            f"{len(first)} different commands are too few for a residual of {commands.shape[1]} "
            f"channels; record at least {required}"
        )
    count = np.bincount(place)[:, None]
    sums = np.zeros((len(first), weights.shape[1]))
    np.add.at(sums, place, weights)
    middle = np.zeros((len(first), commands.shape[1]))
    np.add.at(middle, place, commands)
    order = np.argsort(first)  # in recording order: neighbours in time are correlated
    return fit_scattered((middle / count)[order], (sums / count)[order], NODES)


def _rms(numbers: Floats, seen: NDArray[np.bool_] | None = None) -> float:
    """Return the RMS distance in mm of points (S, 3N), over those `seen` (S, N)."""
    squares = np.sum(numbers.reshape(len(numbers), -1, 3) ** 2, axis=2)
    return float(np.sqrt(np.mean(squares if seen is None else squares[seen])))
