"""Plain NumPy rollouts of the same effects: a Python loop over time.

The loop is vectorised over parameter sets and channels.
"""

from __future__ import annotations

import numpy as np

EFFECTS = ["backlash", "creep"]


def numbers(chain, params):
    """Return the numbers of both effects for `backlash_and_creep`, from `params` (B, P).

    The numbers are those of their chain.
    """
    groups = np.array(chain.group_labels)
    gap, strength, tau, spread = (
        params[:, groups == label].copy()
        for label in ("backlash.gap", "creep.strength", "creep.tau", "creep.spread")
    )
    return gap, strength, tau[:, 0], spread[:, 0]


def backlash_and_creep(gap, strength, tau, spread, u, t):
    """Return (B, T, C) mm: play of full width `gap` (B, C) mm, then creep.

    Creep is `strength` (B, C) times two relaxations' mean.

    The time constants `tau · spread` and `tau / spread` (B,) are in s.
    """
    half = gap / 2
    times = np.stack([tau * spread, tau / spread])  # (2, B)
    out = np.empty((len(gap), *u.shape))
    played = np.broadcast_to(u[0], (len(gap), u.shape[1])).copy()
    crept = np.stack([played, played])
    out[:, 0] = played + strength * crept.mean(axis=0)
    for k in range(1, len(t)):
        before, played = played, np.clip(played, u[k] - half, u[k] + half)
        part = ((t[k] - t[k - 1]) / times)[:, :, None]
        kept = np.exp(-part)
        # exact for commands linear between samples, as in rust/effects/lag.rs
        mean = (1 - kept) / part
        crept = kept * crept + (mean - kept) * before + (1 - mean) * played
        out[:, k] = played + 0.5 * strength * (crept[0] + crept[1])
    return out
