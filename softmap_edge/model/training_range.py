"""Find commands, shapes, loads and points of a run that lie outside the data of its model.

`made_from` of a trained prior and of a residual holds the range of their training commands
(`span`), with which effective commands are compared. A learned rod stores the leverage of its
commands (`coverage.py`), which also covers combinations of channels.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError

if TYPE_CHECKING:
    from softmap_edge.model.model import Model
    from softmap_edge.run.run import Run

Floats = NDArray[np.float64]
BEYOND = 0.05  # share of its range by which a command may exceed it without a note
UNLIKE = 0.015  # of the robot's length: a shape this far from all shapes of the model is foreign


def command_extrapolation(model: Model, run: Run) -> list[str]:
    """Return a sentence for each way in which commands exceed the range of the model.

    These are channels out of range, parts learned over a smaller range, and loads that the model
    cannot apply.
    """
    u, notes = model.commands(run), []
    # for a trained prior, `training_extrapolation` reports this once
    noted = _taught(model, "prior") is not None
    if model.coverage is not None:
        notes, noted = _uncovered(model, run), True
    for c, (low, high) in enumerate(model.command_range if len(u) and not noted else ()):
        least, most = float(u[:, c].min()), float(u[:, c].max())
        slack = BEYOND * (high - low)
        if least < low - slack or most > high + slack:
            notes.append(
                f"channel {c} goes from {least:.3g} to {most:.3g} {model.command_unit}, the model "
                f"of '{model.robot}' was made from {low:.3g} to {high:.3g}; beyond, it "
                "extrapolates"
            )
    notes += training_extrapolation(model, run)
    gravity = model.gravity_reference if run.gravity is None else run.gravity
    declared = (
        [] if np.allclose(gravity, model.gravity_reference, atol=1e-3) else ["another gravity"]
    )
    declared += [] if run.load is None or not np.any(run.load) else ["a load"]
    if declared and not model.structure.stiffness_known:
        notes.append(
            f"the run declares {' and '.join(declared)}; how stiff '{model.robot}' is is not "
            "known to its model, so that is not applied"
        )
    return notes


def _uncovered(model: Model, run: Run) -> list[str]:
    """Return a sentence if effective commands are not covered by the training data."""
    coverage, unit = model.coverage, model.command_unit
    if coverage is None or not run.frames:
        return []
    u = model.effective_commands(run)
    outside = coverage.outside(u)
    count = int(outside.sum())
    if not count:
        return []
    low, high = coverage.middle - coverage.half, coverage.middle + coverage.half
    least, most = u.min(axis=0), u.max(axis=0)
    left = (least < low - BEYOND * (high - low)) | (most > high + BEYOND * (high - low))
    where = ", ".join(
        f"channel {c} goes from {least[c]:.3g} to {most[c]:.3g} {unit}, there from {low[c]:.3g} "
        f"to {high[c]:.3g}"
        for c in np.flatnonzero(left)
    )
    if not where:
        where = "each channel stays within its range, but they were never moved together like this"
    return [
        f"{count} of {len(u)} frames ({100 * count / len(u):.0f} %) are unlike what "
        f"'{model.robot}' was learned from (leverage up to {float(coverage.excess(u).max()):.3g} "
        "times the largest there): "
        f"{where}; the model extrapolates, and its errors there are unknown"
    ]


def training_extrapolation(model: Model, run: Run) -> list[str]:
    """Return sentences where a run exceeds the training data of its prior or residual."""
    learned = {"prior": True, "residual": model.residual is not None}
    ranges = {part: _taught(model, part) for part, there in learned.items() if there}
    known = {part: found for part, found in ranges.items() if found is not None}
    if not known or not run.frames:
        return []
    u = model.effective_commands(run)
    notes = []
    for what, (low, high) in known.items():
        outside = (u < low - BEYOND * (high - low)) | (u > high + BEYOND * (high - low))
        if outside.any():
            count = int(outside.any(axis=1).sum())
            least, most, unit = u.min(axis=0), u.max(axis=0), model.command_unit
            exceeded = ", ".join(
                f"channel {c} from {low[c]:.3g} to {high[c]:.3g} {unit}, here from {least[c]:.3g} "
                f"to {most[c]:.3g}"
                for c in np.flatnonzero(outside.any(axis=0))
            )
            notes.append(
                f"{count} of {len(u)} frames ({100 * count / len(u):.0f} %) leave what taught the "
                f"{what} of '{model.robot}': {exceeded}; beyond, it extrapolates"
            )
    return notes


def shape_mismatch(model: Model, mae: Floats) -> list[str]:
    """Return a sentence where shapes differ from all shapes of the model at any command.

    Args:
        mae: (K,) mm, mean absolute error of each frame to the nearest shape
            (`calibration/matching.py`); NaN if unknown.
    """
    known, limit = mae[np.isfinite(mae)], UNLIKE * float(np.linalg.norm(model.rest, axis=1).max())
    count = int((known > limit).sum())
    if not count:
        return []
    return [
        f"{count} of {len(known)} shapes ({100 * count / len(known):.0f} %) are like none that "
        f"'{model.robot}' makes at any command: {limit:.2g} mm off or more, up to "
        f"{known.max():.2g} (mean absolute error; median of all {np.median(known):.2g}): a "
        "contact, a load, another frame; its results on them are extrapolated"
    ]


def span(commands: Floats) -> list[list[float]]:
    """Return [smallest, largest] of each channel of commands (n, C), for `made_from`.

    They are stored there under `command_range`.
    """
    return [[float(channel.min()), float(channel.max())] for channel in commands.T]


def _taught(model: Model, key: str) -> tuple[Floats, Floats] | None:
    """Return the smallest and largest training commands (C,) of a part of a model.

    None if its file has none.
    """
    part: object = model.made_from.get(key)
    try:
        found = np.asarray(part.get("command_range") if isinstance(part, Mapping) else None, float)
    except (TypeError, ValueError):
        return None
    fits = found.shape == (model.channels, 2) and bool(np.isfinite(found).all())
    return (found[:, 0], found[:, 1]) if fits else None


def check_commands(model: Model, run: Run, u: Floats) -> None:
    """Raise RunError if a run's commands (T, C) do not fit this model's robot."""
    if u.shape[1] != model.channels:
        raise RunError(
            f"the run has {u.shape[1]} commands a sample, this model of '{model.robot}' takes "
            f"{model.channels}; it is a run of another robot, or the mapping misses columns"
        )
    units = {run.command_unit, model.command_unit}
    if u.shape[1] and len(units) > 1 and "ticks" in units:
        way = (
            "give the run in ticks as it was recorded"
            if model.command_unit == "ticks"
            else "calibrate the model (`softmap model calibrate RUN --bundle DIR --out DIR2`) "
            "and give that bundle"
        )
        raise RunError(
            f"the run's commands are in {run.command_unit}, this model of '{model.robot}' takes "
            f"{model.command_unit}, and nothing converts them; {way}, or `softmap learn` a model "
            f"from runs in {run.command_unit}"
        )
    if u.shape[1] and units == {"mm", "N"}:
        raise RunError(
            f"the run's commands are in {run.command_unit}, this model of '{model.robot}' takes "
            f"{model.command_unit}; a length is not a tension: give the run's own unit or another "
            "model"
        )


def out_of_reach(model: Model, run: Run) -> list[str]:
    """Return a sentence if points of a run are farther from the base than the robot can reach.

    Args:
        model: the model.
        run: with K seen frames.

    Returns:
        list: one sentence, or none.
    """
    if not run.frames:
        return []
    rest, seen = np.asarray(model.rest, float), model.seen_points(run)
    shown = seen if run.visible is None else np.where(run.visible[..., None], seen, np.nan)
    # of the straight body, from its clamp at the origin
    reach = float(np.linalg.norm(rest, axis=1).max())
    far = np.linalg.norm(shown - rest.mean(axis=0), axis=-1)
    off = float(np.median(far[np.isfinite(far)])) if np.isfinite(far).any() else 0.0
    if not off > 2.5 * reach:
        return []
    return [
        f"the points are {off:.4g} mm from where '{model.robot}' rests, which reaches {reach:.3g} "
        "mm: if they are in the frame of a camera, `softmap run align` brings them to the base"
    ]
