"""Plain NumPy rollouts of the same effects: a Python loop over time, vectorised over parameter sets and channels."""

from __future__ import annotations

import numpy as np


def backlash_and_creep(gap, strength, tau, u, t):
    """Return (B, T, C) mm: play of full width `gap` (B,) mm, then a relaxation of `strength` (B,), `tau` (B,) s."""
    half, strength = gap[:, None] / 2, strength[:, None]
    out = np.empty((len(gap), *u.shape))
    played = np.broadcast_to(u[0], (len(gap), u.shape[1])).copy()
    crept = played.copy()
    out[:, 0] = played + strength * crept
    for k in range(1, len(t)):
        before, played = played, np.clip(played, u[k] - half, u[k] + half)
        part = ((t[k] - t[k - 1]) / tau)[:, None]
        kept = np.exp(-part)
        mean = (1 - kept) / part  # exact for what is linear between samples, as in rust/effects/lag.rs
        crept = kept * crept + (mean - kept) * before + (1 - mean) * played
        out[:, k] = played + strength * crept
    return out
