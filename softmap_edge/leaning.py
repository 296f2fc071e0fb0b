"""The shapes of a model as they are in the orientation of a run: what clouds and frames are matched against.

A prior is made in one orientation. Where a run declares another, the model's fields bend it: its shapes on a grid of
commands, in their leading modes, are then a table that is as quick as the prior. One orientation a run; where it has
several, the prior stands. Units: mm, g. Pinned by tests/test_registration.py, tests/test_calibration.py.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.run import Run

if TYPE_CHECKING:
    from softmap_edge.model import Model
    from softmap_edge.predictors import Shape

Floats = NDArray[np.float64]

NEAR = 0.02  # g: an orientation nearer to the prior's is the prior's; 1 degree
NODES = {1: 41, 2: 25, 3: 9}  # commands a channel
MODES = 32


def prior_in(model: Model, run: Run | None) -> Shape:
    """Return the prior of a model, with its residual, under the orientation that a run declares.

    Args:
        model: its fields say how it hangs; its effects are not in it.
        run: the recording; None, or one without an orientation of its own, gives the prior as it is.

    Returns:
        Shape: commands (n, C) to points (n, 3N) mm.
    """
    plain = model.prior if model.residual is None else _core.Sum(model.prior, model.residual)
    if not leans(model, run) or model.channels not in NODES:
        return plain
    assert run is not None and run.gravity is not None
    axes = [np.linspace(low, high, NODES[model.channels]) for low, high in model.command_range]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, model.channels)
    t, gravity = np.arange(float(len(grid))), np.atleast_2d(run.gravity)[0]
    asked = Run(t=t, command=grid, t_seen=t, gravity=gravity, command_unit=model.command_unit)
    bare = model.with_effects((), {}) if model.chain_names else model
    if model.residual is not None:
        bare = bare.with_residual(model.arrays["residual"])
    shapes = np.asarray(bare.predict(asked)).reshape(len(grid), -1)
    mean = shapes.mean(axis=0)
    left, size, modes = np.linalg.svd(shapes - mean, full_matrices=False)
    return _core.Table(axes, left[:, :MODES] * size[:MODES], mean, np.ascontiguousarray(modes[:MODES]))


def leans(model: Model, run: Run | None) -> bool:
    """Return whether a run declares one orientation, and another than that of the model's prior."""
    if run is None or run.gravity is None or not model.stiffness_known or not model.fields:
        return False
    rows = np.atleast_2d(run.gravity)
    alone = float(np.linalg.norm(rows - rows[0], axis=1).max()) < NEAR
    return alone and float(np.linalg.norm(rows[0] - model.gravity_reference)) > NEAR
