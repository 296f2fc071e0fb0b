"""Recordings of arms with laws of their own, for models that are learned."""

import numpy as np
from scipy.spatial.transform import Rotation

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


def segmented(seed, segments=2, frames=400, gap=0.0, noise=0.5):
    """A run of an arm of `segments`, each pulled by three tendons that add up to zero.

    It stiffens as it bends, by a law that no polynomial of low degree follows. `gap` mm of play
    lies in each tendon.
    """
    rng = np.random.default_rng(seed)
    t = 0.25 * np.arange(frames)
    stops = rng.uniform(-16.0, 16.0, (frames // 12 + 2, segments, 3))
    stops -= stops.mean(axis=2, keepdims=True)
    u = np.stack(
        [
            np.interp(t, 3.0 * np.arange(len(stops)), column)
            for column in stops.reshape(len(stops), -1).T
        ],
        axis=1,
    )
    pulls = play(u, np.full(u.shape[1], gap)).reshape(frames, segments, 3)
    around = np.exp(2j * np.pi * np.arange(3) / 3.0)
    bends = (pulls @ around) / 16.0
    bends[:, 1:] -= 0.3 * bends[:, :1]  # each tendon runs through the segments below
    size = np.maximum(np.abs(bends), 1e-9)
    angles = 1.2 * 0.8 * np.tanh(1.6 * size)
    places, turned, tips = np.zeros((frames, 3)), np.tile(np.eye(3), (frames, 1, 1)), []
    for k in range(segments):
        heading, angle = np.angle(bends[:, k]), angles[:, k]
        out, up = (1.0 - np.cos(angle)) / angle, np.sin(angle) / angle
        local = 100.0 * np.stack([out * np.cos(heading), out * np.sin(heading), up], axis=1)
        places = places + np.einsum("nij,nj->ni", turned, local)
        tips.append(places)
        axis = np.stack([-np.sin(heading), np.cos(heading), 0.0 * heading], axis=1)
        turned = turned @ Rotation.from_rotvec(angle[:, None] * axis).as_matrix()
    markers = np.stack(tips, axis=1)
    return Run(t=t, command=u, t_seen=t, markers=markers + rng.normal(0.0, noise, markers.shape))


def one_pole(u, tau, step=0.02):
    """Commands (T, C) behind a first-order lag of `tau` s."""
    out, at = np.empty_like(u), u[0].copy()
    for i, now in enumerate(u):
        at = at + (now - at) * (1.0 - np.exp(-step / tau))
        out[i] = at
    return out


def growing_play(u, share, start):
    """Commands (T, C) behind a play of half width share·(|u| + start)."""
    out, at = np.empty_like(u), u[0].copy()
    for i, now in enumerate(u):
        half = share * (np.abs(now) + start)
        at = np.clip(at, now - half, now + half)
        out[i] = at
    return out


def with_slack_tendons(law, seed, seconds, slack=2.5, noise=0.15):
    """A run of an arm whose tendons are slack: within ±`slack` mm it hardly moves.

    The commands walk between random targets; `law` (T, C) → (T, C) acts on them.
    """
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, 0.02)
    corners = np.arange(0.0, seconds + 4.0, 1.7)
    stops = rng.uniform(-10.0, 10.0, (len(corners), 2))
    u = np.stack([np.interp(t, corners, stops[:, c]) for c in (0, 1)], axis=1)
    acting = law(u)
    taut = np.sign(acting) * np.maximum(np.abs(acting) - slack, 0.0)
    markers = arc(taut + 0.15 * np.clip(acting, -slack, slack))[::3]
    return Run(t=t, command=u, t_seen=t[::3], markers=markers + rng.normal(0, noise, markers.shape))
