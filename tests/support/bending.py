"""A bending marker rod with its own formula: circle arcs, markers off the line, seen in dwells and
moves.

It uses none of the library's laws. Units: mm, s, rad.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

LENGTH, MARKERS = 100.0, 8


def shape(command):
    """Return markers (K, M, 3) mm of commands (K, 2) mm: a curvature that stiffens, two markers a
    station.
    """
    kappa = 0.012 * np.tanh(np.asarray(command) / 12.0)  # rad a mm
    s = np.linspace(0.15, 1.0, MARKERS) * LENGTH
    bend = np.linalg.norm(kappa, axis=1)[:, None]
    with np.errstate(invalid="ignore"):
        way = np.where(bend > 1e-12, kappa / np.maximum(bend, 1e-12), 0.0)
    angle = bend * s
    aside = np.where(bend > 1e-9, (1 - np.cos(angle)) / np.maximum(bend, 1e-9), 0.0)
    up = np.where(bend > 1e-9, np.sin(angle) / np.maximum(bend, 1e-9), s)
    points = np.stack([aside * way[:, :1], aside * way[:, 1:], up], axis=2)
    tangent = np.stack(
        [np.sin(angle) * way[:, :1], np.sin(angle) * way[:, 1:], np.cos(angle)], axis=2
    )
    side = np.where(np.arange(MARKERS) % 2 == 0, 8.0, -8.0)[:, None] * np.cross(
        tangent, [0.0, 1.0, 0.0]
    )
    return points + side


def visits(places, rng, rate=2.0, dwell=6.0, move=2.0):
    """Return times, commands at 20 Hz and seen times of a tour that dwells at each of `places` (n,
    2) mm.
    """
    corners = [(0.0, np.asarray(places[0], float))]
    now = 0.0
    for place in places:
        now += move
        corners.append((now, np.asarray(place, float)))
        now += dwell
        corners.append((now, np.asarray(place, float)))
    t = np.arange(0.0, now, 0.05)
    command = np.stack(
        [np.interp(t, [c[0] for c in corners], [c[1][i] for c in corners]) for i in (0, 1)], axis=1
    )
    seen = np.arange(0.3, now - 0.1, 1.0 / rate) + rng.uniform(
        -0.1, 0.1, len(np.arange(0.3, now - 0.1, 1.0 / rate))
    )
    return t, command, seen


def tour(rng, rounds=6):
    """Return places (n, 2) mm: home and four others, several times in different order."""
    others = np.array([[9.0, 0], [-9, 0], [0, 9], [0, -9]])
    return [p for _ in range(rounds) for p in ([0.0, 0.0], *others[rng.permutation(4)])]


def wander(t, tau, rng, count=1):
    """Return an Ornstein-Uhlenbeck process (K, count) of unit variance at times t (K,)."""
    out, state = np.empty((len(t), count)), rng.normal(size=count)
    for k in range(len(t)):
        keep = np.exp(-(t[k] - t[k - 1]) / tau) if k else 1.0
        state = keep * state + np.sqrt(1 - keep**2) * rng.normal(size=count)
        out[k] = state
    return out


def shaken(points, turns, shifts):
    """Return points (K, M, 3) in a frame that is turned by small turns (K, 3) rad and shifted (K,
    3) mm.
    """
    return points + np.cross(turns[:, None, :], points) + shifts[:, None, :]


def at(t, command, seen):
    return np.stack([np.interp(seen, t, c) for c in command.T], axis=1)


def record(t, command, seen, **more):
    """The fields of a run that `conditions` reads."""
    return SimpleNamespace(t=t, t_seen=seen, **({"gravity": None, "temperature": None} | more))
