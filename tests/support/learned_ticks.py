"""Runs in servo ticks that teach a model."""

from pathlib import Path

import numpy as np
from recorded_arms import arc, wander

from softmap_edge import Run

CASE = Path(__file__).parents[1] / "data/learn_from_ticks/ticks.csv"


def arm(channels=2, home=2048.0, size=900.0, seconds=60.0, seed=0, **more):
    """A run of an arm whose bending is that of its ticks from home, three markers, 0.1 mm of
    noise.
    """
    t = np.arange(0.0, seconds, 0.05)
    u = np.tile(wander(t, 9.0), 2)[:, :channels] * [1.0, 1.0, 0.6, 0.5][:channels]
    ticks = np.rint(home + size / 9.0 * u)
    bend = (ticks - home) * 9.0 / size
    bend = np.stack([bend[:, 0], bend[:, 1] if channels > 1 else 0 * bend[:, 0]], axis=1)
    seen = arc(bend) + np.random.default_rng(seed).normal(0, 0.1, (len(t), 3, 3))
    if more.pop("held", False):
        return Run(t=t, command=ticks, command_unit="ticks", t_seen=t, markers=seen, **more)
    return Run(t=t, ticks=ticks.astype(int), t_seen=t, markers=seen, **more)
