"""Runs of the built-in finger with a law of one's own, for tests of the diagnosis."""

from dataclasses import replace

import numpy as np

from softmap_edge.model.bundle import builtin_model
from softmap_edge.run.protocol import standard_protocol
from softmap_edge.run.run import Run

# The least that a reader relies on.
SOUND = (
    {
        "schema": "softmap.diagnosis/2",
        "verdict": "identified",
        "sentence": "The model lacks backlash.",
        "effects": [
            {
                "name": "backlash",
                "params": {"backlash.gap": {"value": 0.4, "sigma": 0.1, "unit": "mm"}},
            }
        ],
    }
    | {name: [] for name in ("faults", "alternatives", "not_testable", "next")}
    | {name: {} for name in ("where", "error", "unexplained", "made_from")}
)


def named(diagnosis):
    return {e.name for e in [*diagnosis.effects, *diagnosis.faults]}


def thinned(protocol, every=3):
    """A protocol that is seen at every third frame: bodies solved in finite elements take less."""
    return replace(protocol, t_seen=protocol.t_seen[::every], block=protocol.block[::every])


def finger_run(names=(), params=None, acting=None, noise=0.25, seed=0):
    """A run of the standard protocol on the built-in finger itself; `acting` replaces the command
    that acts.
    """
    shown = standard_protocol(2)
    model = builtin_model()
    rest = np.broadcast_to(model.rest, (shown.frames, *model.rest.shape))
    run = Run(
        shown.t,
        shown.command,
        shown.t_seen,
        vertices=rest,
        gravity=shown.gravity,
        robot=model.robot,
    )
    true = model.with_effects(names, params or {})
    points = true.predict(run if acting is None else replace(run, command=acting(shown.command)))
    return replace(
        run, vertices=points + noise * np.random.default_rng(seed).normal(size=points.shape)
    )
