"""Plain NumPy rollouts of the same effects: a Python loop over time, vectorised over parameter sets and channels."""

from __future__ import annotations

import numpy as np


def backlash_and_creep(gap, strength, tau, u, t):
    """Return (B, T, C) mm: play of full width `gap` (B,) mm, then a relaxation of `strength` (B,), `tau` (B,) s."""
    half = gap[:, None] / 2
    out = np.empty((len(gap), *u.shape))
    played = np.broadcast_to(u[0], (len(gap), u.shape[1])).copy()
    crept = played.copy()
    previous = t[0]
    for k, (x, now) in enumerate(zip(u, t)):
        played = np.clip(played, x - half, x + half)
        crept = crept + (1 - np.exp(-(now - previous) / tau))[:, None] * (played - crept)
        out[:, k] = played + strength[:, None] * crept
        previous = now
    return out
