"""Prepare a search: candidate effects, and a run with its noise and model-form error.

Pinned by tests/diagnosis/test_diagnosis.py and tests/diagnosis/test_fit.py.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis.findings import Untestable
from softmap_edge.diagnosis.fit import Problem
from softmap_edge.diagnosis.record import Record
from softmap_edge.errors import SoftmapError, no_effect
from softmap_edge.model.effect_info import EffectInfo, registry
from softmap_edge.noise.memoryless import repeats_of
from softmap_edge.noise.noise_model import (
    Noise,
    command_kernel,
    form_covariance,
    measure_noise,
    rod_noise,
    whitener,
)
from softmap_edge.run.conditions import orientations
from softmap_edge.run.folds import LEAST_FRAMES

Floats = NDArray[np.float64]

SIGNATURE_FRAMES = 150  # frames for the span of the signatures


def candidates_of(
    record: Record, requested: Sequence[str] | None
) -> tuple[list[str], list[Untestable]]:
    """Return the candidate effects of a run, all or `requested`, and why others are excluded.

    Raises:
        SoftmapError: an unknown effect, or no candidates.
    """
    known = registry()
    unknown = [name for name in requested or () if name not in known]
    if unknown:
        raise SoftmapError(no_effect(unknown[0], known))
    names = [
        n
        for n in known
        if (requested is None or n in requested) and n not in record.model.chain_names
    ]
    if record.model.output is not None and requested is None:
        names = [n for n in names if known[n].on_outputs]
    if not names:
        raise SoftmapError("no effect is left to look for: the model already has every candidate")
    lawless = [n for n in names if known[n].role == "prior" and record.model.missing_for(n)]
    if requested is None:  # a law that the prior lacks is not a candidate, unless requested
        names = [n for n in names if n not in lawless]
    reasons = [_impossible(record, known[name], name in lawless) for name in names]
    impossible = [reason for reason in reasons if reason is not None]
    if {"gravity", "payload"} <= set(names) and _rod_in_one_orientation(record):
        block, minutes = known["gravity"].experiment
        why = "in one orientation a rod cannot distinguish it from payload"
        impossible.append(Untestable("gravity", why, block, minutes))
    out = {one.name for one in impossible}
    return [n for n in names if n not in out], impossible


def _impossible(record: Record, effect: EffectInfo, lawless: bool) -> Untestable | None:
    """Return why a run or a model cannot show an effect at all, if so.

    Args:
        record: the model and its run.
        effect: the effect.
        lawless: whether the prior has no such law to change.
    """
    name, channels = effect.name, record.model.channels
    if channels == 0 and (effect.on_commands or not record.layout((name,)).labels):
        return Untestable(name, "nothing is commanded in this run", "a run with commands", 1.0)
    if effect.needs_time and any(run.timeless for run in record.recorded_runs):
        remedy = "the same moves, the time of each row logged"
        return Untestable(name, "the log has no time", remedy, 1.0)
    if not record.layout((name,)).labels:
        why = f"it is between channels, and the model has {channels}"
        return Untestable(name, why, "a robot of more channels", of_model=True)
    if lawless:
        why = "the model has no such law to change: its tendons do not push, or it has none"
        remedy = "a model learned with a robot.toml whose tendons push"
        return Untestable(name, why, remedy, of_model=True)
    if record.model.missing_for(name):
        why = "a model with the geometry of the body is needed"
        remedy = "a model built from a finger.toml by this version"
        return Untestable(name, why, remedy, of_model=True)
    if name == "twist" and not record.roll_seen:
        why = "clouds of a round finger do not show what it does about its own axis"
        remedy = "the same moves with markers or a texture on the finger"
        return Untestable(name, why, remedy, 1.0)
    if missing := record.missing(effect.needs):
        block, minutes = effect.experiment
        absent = ", ".join(missing)
        why = f"the run does not declare {absent}"
        return Untestable(name, why, f"{block}; {absent} declared", minutes)
    return None


def _rod_in_one_orientation(record: Record) -> bool:
    """Whether the weight of a rod and a load at its tip cannot be distinguished.

    A rod's fields bend its own centreline by one unknown compliance. Its weight and a tip load
    differ by less than its model-form error. A tilt of gravity is an offset. The simpler member
    represents the family.
    """
    return record.model.kind == "rod" and orientations(record.state.gravity) == 1


def problem_of(
    record: Record, candidates: Sequence[str], noise: Noise | None = None, residual: bool = True
) -> Problem:
    """Measure the noise (if not given), set up the model-form error, and whiten.

    Whitening uses the signatures of the candidates.

    If a residual was removed, the model error includes it, unless `residual` is false.

    Raises:
        SoftmapError: fewer than 8 frames.
    """
    base = record.predict(record.model.chain_names, record.own()[None])[0]
    if len(record) < LEAST_FRAMES:
        raise SoftmapError(
            f"{len(record)} seen frames are too few to diagnose; record {LEAST_FRAMES} or more, "
            "better 60"
        )
    thin = np.linspace(0, len(record) - 1, min(len(record), SIGNATURE_FRAMES)).astype(np.intp)
    thin = np.union1d(record.begins, thin)
    few = record.some(thin)
    signatures = [s for name in candidates for s in _signatures(few, name, base[thin])]
    stack = np.stack(signatures) if signatures else np.zeros((1, len(thin), record.features))
    kernel = command_kernel(record.command, record.spread, record.leaning)
    noise = noise or noise_of(record, record.seen - base)
    if record.error_is_noise:
        form = np.zeros((record.features, record.features))
    else:
        form = form_covariance(record.form_error, record.positions, record.section)
        # it may be model error or an effect: allow for both
        if residual and record.static is not None:
            form = form + record.static.T @ record.static / len(record)
    return Problem(record, noise, whitener(noise, form, stack, kernel))


def noise_of(record: Record, residual: Floats) -> Noise:
    """Return the noise of a record from a model's residual (K, F) mm."""
    noise = measure_noise(residual, record.seen, record.positions, record.t_seen, record.state)
    if not record.error_is_noise:
        return noise
    again = repeats_of(residual, record.state, load_seen(record))
    return rod_noise(residual, record.t_seen, record.form_error, noise, again)


def load_seen(record: Record) -> Floats | None:
    """Return the declared loads (K,) g at the frames; 0 if a run, None if all declare none."""
    if record.load is None:
        return None
    parts = record.parts
    return np.concatenate(
        [
            np.zeros(p.frames)
            if p.load is None
            else np.interp(
                np.asarray(p.run.t_seen, float), p.run.t, np.broadcast_to(p.load, p.run.t.shape)
            )
            for p in parts
        ]
    )


def _signatures(record: Record, name: str, base: Floats) -> list[Floats]:
    """Return the change of `base` (K, F) mm by an effect at its start values.

    The first has all parameters at once, the others each parameter alone.
    """
    names = tuple(record.model.chain_names) + (() if name in record.model.chain_names else (name,))
    layout, own = record.layout(names), record.own_values()
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
    return [s for s in shifts if np.any(np.abs(s) > 1e-9)]
