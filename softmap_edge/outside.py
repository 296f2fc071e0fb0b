"""Where a run leaves what a model was made from: its commands, loads that are not applied, points out of reach."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError

if TYPE_CHECKING:
    from softmap_edge.model import Model
    from softmap_edge.run import Run

Floats = NDArray[np.float64]
BEYOND = 0.05  # share of its range by which a command may leave it before a word is said


def beyond(model: Model, run: Run) -> list[str]:
    """Return a sentence for each channel that leaves the range of the model, and for loads that it cannot apply."""
    u, notes = model.commands(run), []
    for c, (low, high) in enumerate(model.command_range if len(u) else ()):
        least, most = float(u[:, c].min()), float(u[:, c].max())
        slack = BEYOND * (high - low)
        if least < low - slack or most > high + slack:
            notes.append(
                f"channel {c} goes from {least:.3g} to {most:.3g} {model.command_unit}, the model of '{model.robot}' "
                f"was made from {low:.3g} to {high:.3g}; beyond, it extrapolates"
            )
    gravity = model.gravity_reference if run.gravity is None else run.gravity
    told = [] if np.allclose(gravity, model.gravity_reference, atol=1e-3) else ["another gravity"]
    told += [] if run.load is None or not np.any(run.load) else ["a load"]
    if told and not model.stiffness_known:
        notes.append(
            f"the run declares {' and '.join(told)}; how stiff '{model.robot}' is is not known to its model, so "
            "that is not applied"
        )
    return notes


def check_commands(model: Model, run: Run, u: Floats) -> None:
    """Raise RunError where a run's commands (T, C) are not of this model's robot."""
    if u.shape[1] != model.channels:
        raise RunError(
            f"the run has {u.shape[1]} commands a sample, this model of '{model.robot}' takes {model.channels}; "
            "it is a run of another robot, or the mapping misses columns"
        )
    if u.shape[1] and {run.command_unit, model.command_unit} == {"mm", "N"}:
        raise RunError(
            f"the run's commands are in {run.command_unit}, this model of '{model.robot}' takes "
            f"{model.command_unit}; a length is no tension: give the run's own unit or another model"
        )


def elsewhere(model: Model, run: Run) -> list[str]:
    """Say so where the points of a run are farther from the base than the robot can reach.

    Args:
        run: with K frames seen. Returns: no sentence, or one.
    """
    if not run.frames:
        return []
    rest, seen = np.asarray(model.rest, float), model.seen_points(run)
    shown = seen if run.visible is None else np.where(run.visible[..., None], seen, np.nan)
    reach = float(np.linalg.norm(rest, axis=1).max())  # of a straight body from its clamp, the origin
    far = np.linalg.norm(shown - rest.mean(axis=0), axis=-1)
    off = float(np.median(far[np.isfinite(far)])) if np.isfinite(far).any() else 0.0
    if not off > 2.5 * reach:
        return []
    return [
        f"the points are {off:.4g} mm from where '{model.robot}' rests, which reaches {reach:.3g} mm: if they are "
        "in the frame of a camera, `softmap align` brings them to the base"
    ]
