"""A model's shapes in the orientations of a run, to which clouds and frames are matched.

A prior is made in one orientation. Where frames declare another, the model's fields bend it: its
shapes on a grid of commands, in their leading modes, are then a table that is as quick as the
prior, one for each orientation of the run. Where these are more than MOST (a robot that is carried
about), the prior stands. Units: mm, g. Pinned by tests/alignment/test_registration.py,
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

NEAR = 0.02  # g: orientations nearer to each other are one; 1 degree
MOST = 6  # orientations of a run
NODES = {1: 41, 2: 25, 3: 9}  # commands a channel
MODES = 32


def priors_by_orientation(model: Model, run: Run) -> list[tuple[Rows, Shape]]:
    """Return the frames (n,) of each orientation that a run declares, and a model's prior in it.

    Args:
        model: its fields say how it hangs; its residual is in it, its effects are not.
        run: the recording; frames without an orientation of their own get the prior as it is.

    Returns:
        list: numbers of frames, each once, and a shape: commands (n, C) to points (n, 3N) mm.
    """
    return [
        (rows, prior_under_gravity(model, gravity)) for rows, gravity in _orientations(model, run)
    ]


def other_orientation(model: Model, run: Run) -> bool:
    """Return whether a model can predict the other orientations in which frames are.

    They are other than that of the prior. False if there are none.
    """
    return any(gravity is not None for _, gravity in _orientations(model, run))


def gravity_seen(run: Run) -> Floats:
    """Return the gravity (K, 3) g that a run declares at its seen frames."""
    assert run.gravity is not None
    at = np.searchsorted(run.t, run.t_seen, side="right") - 1
    return np.asarray(np.broadcast_to(run.gravity, (len(run.t), 3))[np.clip(at, 0, len(run.t) - 1)])


def _orientations(model: Model, run: Run) -> list[tuple[Rows, Floats | None]]:
    """Return the frames and the gravity (3,) g of each orientation; None for that of the prior."""
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
    """Return the prior of a model with its residual, as it is or under a gravity (3,) g."""
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
