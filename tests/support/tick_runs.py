"""Runs in servo ticks of the built-in finger under the published map, for what calibrates and what
converts.
"""

import numpy as np

from softmap_edge import _core, builtin_model
from softmap_edge.run.run import Run

MODEL = builtin_model()
A = np.array([[0.003106, -0.001274], [-0.001511, -0.002801]])  # mm/tick, as published
B = np.array([-1.363, 0.758])  # mm
HOME = np.array([1039.05, 1832.25])
ROWS, DWELL = 40, 4.0  # rows and seconds of a dwell, the first of them on the way


def commands(ticks):
    return (ticks - HOME) @ A.T + B


def record(hold, seed=0, frames=1, off=0.1, wrong=0.1, law=None, play=0.0, noise=0.5):
    """A run that holds `hold` (n, C) ticks: shapes of the model, `off` mm of command in each dwell,
    `wrong` dwells.
    """
    rng, n = np.random.default_rng(seed), len(hold)
    ramp = np.minimum(np.arange(1, ROWS + 1) / 10.0, 1.0)[:, None]
    before = np.vstack([hold[:1], hold[:-1]])
    ticks = np.rint(np.concatenate([a + (b - a) * ramp for a, b in zip(before, hold)]))
    t = np.arange(len(ticks)) * DWELL / ROWS
    u = commands(ticks if law is None else HOME + law(ticks - HOME))
    if play:
        u = _core.Chain(["backlash"], 2).rollout(np.array([[play]]), u, t)[0]
    t_seen = (np.arange(n)[:, None] * DWELL + 2.0 + 1.8 * np.arange(frames) / frames).ravel()
    acting = np.column_stack([np.interp(t_seen, t, c) for c in u.T])
    acting += np.repeat(rng.normal(size=(n, 2)) * off, frames, axis=0)
    lost = np.repeat(rng.random(n) < wrong, frames)
    acting[lost] = rng.uniform(-12.0, 12.0, (lost.sum(), 2))
    seen = MODEL.prior.evaluate(acting).reshape(len(t_seen), -1, 3)
    seen += rng.normal(size=seen.shape) * noise
    return Run(t=t, ticks=ticks.astype(int), t_seen=t_seen, vertices=seen, sigma=np.array(noise))


def scattered(seed, n=30):
    """Ticks (n, 2) all over the range; home again every eighth time."""
    away = np.random.default_rng(seed).uniform(-3300.0, 3300.0, (n, 2))
    away[::8] = 0.0
    return np.rint(HOME + away)
