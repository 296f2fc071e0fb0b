"""A model's shapes in the orientations of a run, for matching clouds and frames.

A prior is made for one orientation. If frames declare another, the model's fields bend it: the
leading modes of its shapes on a grid of commands form a table as fast as the prior, one per
orientation of the run. With more than MOST orientations (a robot that is carried about), the prior
is used unchanged. Units: mm, g. Pinned by tests/alignment/test_registration.py,
tests/calibration/test_calibration.py.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.run.run import Run

if TYPE_CHECKING:
    from softmap_edge.model.model import Model
    from softmap_edge.model.predictors import Shape

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]

NEAR = 0.02  # g: orientations that differ by less are one; about 1 degree
MOST = 6  # orientations of a run
NODES = {1: 41, 2: 25, 3: 9}  # grid commands per channel
MODES = 32


def priors_by_orientation(model: Model, run: Run) -> list[tuple[Rows, Shape]]:
    """Return the frames (n,) of each orientation declared by a run, and the model's prior there.

    Args:
        model: with fields that give its shape in an orientation; its residual is included, its
            effects are not.
        run: the recording; frames without a declared orientation get the unchanged prior.

    Returns:
        list: numbers of frames, each once, and a shape: commands (n, C) to points (n, 3N) mm.
    """
    return [
        (rows, prior_under_gravity(model, gravity)) for rows, gravity in _orientations(model, run)
    ]


def other_orientation(model: Model, run: Run) -> bool:
    """Return whether frames declare other orientations than the prior's that can be predicted."""
    return any(gravity is not None for _, gravity in _orientations(model, run))


def gravity_seen(run: Run) -> Floats:
    """Return the gravity (K, 3) g that a run declares at its seen frames."""
    assert run.gravity is not None
    at = np.searchsorted(run.t, run.t_seen, side="right") - 1
    return np.asarray(np.broadcast_to(run.gravity, (len(run.t), 3))[np.clip(at, 0, len(run.t) - 1)])


def _orientations(model: Model, run: Run) -> list[tuple[Rows, Floats | None]]:
    """Return the frames and gravity (3,) g of each orientation; None for that of the prior."""
    every = np.arange(run.frames)
    if (
        run.gravity is None
        or not model.structure.stiffness_known
        or not model.fields
        or model.channels not in NODES
    ):
        return [(every, None)]
    gravity = gravity_seen(run)
    found: list[tuple[Rows, Floats | None]] = []
    left = every
    while len(left):
        one = gravity[left[0]]
        same = np.linalg.norm(gravity[left] - one, axis=1) < NEAR
        alike = float(np.linalg.norm(one - model.gravity_reference)) < NEAR
        found.append((left[same], None if alike else one))
        left = left[~same]
        if len(found) > MOST:
            return [(every, None)]
    return found or [(every, None)]


def prior_under_gravity(model: Model, gravity: Floats | None = None) -> Shape:
    """Return the prior of a model with its residual, unchanged or under a gravity (3,) g."""
    if gravity is None:
        return model.structure.corrected_prior
    axes = [np.linspace(low, high, NODES[model.channels]) for low, high in model.command_range]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, model.channels)
    t = np.arange(float(len(grid)))
    asked = Run(t=t, command=grid, t_seen=t, gravity=gravity, command_unit=model.command_unit)
    bare = model.with_effects((), {}) if model.chain_names else model
    if model.residual is not None:
        bare = bare.with_structure(residual=model.residual)
    shapes = np.asarray(bare.predict(asked)).reshape(len(grid), -1)
    mean = shapes.mean(axis=0)
    left, size, modes = np.linalg.svd(shapes - mean, full_matrices=False)
    return _core.Table(
        axes, left[:, :MODES] * size[:MODES], mean, np.ascontiguousarray(modes[:MODES])
    )
