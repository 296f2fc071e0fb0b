"""Recordings of arms with laws of their own, for models that are learned."""

import numpy as np

from softmap_edge import Run


def wander(t, size=10.0):
    """Two commands (T, 2) that reverse at many places and never repeat within a minute."""
    x = 0.6 * np.sin(0.7 * t) + 0.4 * np.sin(1.9 * t + 1)
    return size * np.stack([x, 0.6 * np.sin(0.9 * t + 2) + 0.4 * np.sin(2.3 * t)], axis=1)


def play(u, gaps):
    """Commands (T, C) behind gaps (C,): the drive must first cross the gap."""
    at, out = u[0].copy(), np.empty_like(u)
    for i, now in enumerate(u):
        for c, gap in enumerate(gaps):
            if now[c] - at[c] > gap / 2:
                at[c] = now[c] - gap / 2
            elif at[c] - now[c] > gap / 2:
                at[c] = now[c] + gap / 2
        out[i] = at
    return out


def arc(acting, rings=3, length=110.0):
    """Markers (T, rings, 3) mm on an arm of constant curvature that bends by 0.07 rad a mm,
    softening as it bends.
    """
    bend = 0.07 * acting * (1.0 - 0.002 * acting**2 / 4.0)
    angle, heading = np.hypot(*bend.T), np.arctan2(bend[:, 1], bend[:, 0])
    s = np.linspace(0.0, 1.0, rings + 1)[1:, None]
    turned = np.maximum(s * angle, 1e-9)
    radius = length * s / turned
    out = radius * (1.0 - np.cos(turned))
    return np.stack(
        [out * np.cos(heading), out * np.sin(heading), radius * np.sin(turned)], axis=2
    ).swapaxes(0, 1)


def recorded(gaps=(0.0, 0.0), seconds=90.0, seed=0, noise=0.1, drive=wander, **more):
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, 0.02)
    u = drive(t)
    markers = arc(play(u, gaps))[::3]
    return Run(
        t=t, command=u, t_seen=t[::3], markers=markers + rng.normal(0, noise, markers.shape), **more
    )
