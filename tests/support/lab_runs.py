"""Shared by tests of the lab: a finger with backlash, measured by its own model, and a session."""

from dataclasses import replace

import numpy as np

from softmap_edge import Run, builtin_model
from softmap_edge.lab.session import NamedRun, Session

GAP = 1.5  # mm
HIDDEN = {"backlash.gap": GAP}


def measured(seed=0, frames=160):
    """Return a run of circles and lines of the built-in finger with backlash and 0.05 mm noise."""
    model, rng = builtin_model(), np.random.default_rng(seed)
    t = np.arange(0.0, 60.0, 0.05)
    u = 8.0 * np.column_stack([np.sin(0.5 * t) * np.cos(0.07 * t), np.sin(0.31 * t + seed)])
    seen = np.linspace(1.0, 59.0, frames)
    run = Run(t=t, command=u, t_seen=seen, robot=model.robot, gravity=model.gravity_reference,
              vertices=np.tile(model.rest, (frames, 1, 1)))  # fmt: skip
    points = model.with_effects(["backlash"], HIDDEN).predict(run)
    return replace(run, vertices=points + rng.normal(0.0, 0.05, points.shape))


def session(folder, *runs):
    """Return a session of such runs, or of these, with the built-in finger."""
    given = [
        NamedRun(f"run{k}.npz", run) for k, run in enumerate(runs or (measured(), measured(1)))
    ]
    return Session(folder, given, builtin_model(), None)
