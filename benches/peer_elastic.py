"""The elastic-tendon rod in plain NumPy: all commands at once.

Newton's method with halved steps, then the arcs.
"""

from __future__ import annotations

import numpy as np


def markers(numbers, places, ends, u):
    """Return the tip (n, 3) mm of a rod of `numbers` (P,) at `places`.

    The rod is straight at rest; commands are u (n, tendons).
    """
    slack, angle, radius, drawn, stiffness, length, _, base, tilt = (
        numbers[places[kind]] for kind in places
    )
    segments = len(length)
    reach = np.zeros((len(ends), 2 * segments))
    for j, end in enumerate(ends):
        reach[j, : 2 * end + 2] = np.tile(
            radius[j] * np.array([np.cos(angle[j]), np.sin(angle[j])]), end + 1
        )
    bends = equilibrium(np.repeat(stiffness, 2), reach, u + drawn, slack[0])
    point, turn = np.tile(base, (len(u), 1)), rotations(np.tile(tilt, (len(u), 1)))
    for s in range(segments):
        v = bends[:, 2 * s : 2 * s + 2]
        beta = np.maximum(np.linalg.norm(v, axis=1), 1e-9)
        across = ((1 - np.cos(beta)) / beta**2)[:, None] * v
        chord = length[s] * np.column_stack([across, np.sin(beta) / beta])
        point = point + np.einsum("nij,nj->ni", turn, chord)
        turn = turn @ rotations(v)
    return point


def equilibrium(stiffness, reach, drawn, slack):
    """Return the bending (n, 2S) rad of least energy for tendons shortened by `drawn` mm.

    `drawn` is (n, tendons).
    """

    def energy(bent, stretch):
        weight = np.where(stretch > 0, 1.0, slack)
        return 0.5 * ((stiffness * bent**2).sum(axis=1) + (weight * stretch**2).sum(axis=1))

    bent = np.zeros((len(drawn), len(stiffness)))
    stretch = drawn.copy()
    for _ in range(100):
        weight = np.where(stretch > 0, 1.0, slack)
        hessian = np.einsum("nj,ja,jb->nab", weight, reach, reach) + np.diag(stiffness)
        goal = np.linalg.solve(hessian, ((weight * drawn) @ reach)[..., None])[..., 0]
        share, before = np.ones(len(drawn)), energy(bent, stretch)
        for _ in range(40):
            ahead = bent + share[:, None] * (goal - bent)
            high = energy(ahead, drawn - ahead @ reach.T) > before
            if not high.any():
                break
            share[high] *= 0.5
        moved = np.abs(ahead - bent).max()
        bent, stretch = ahead, drawn - ahead @ reach.T
        if moved < 1e-12:
            break
    return bent


def rotations(v):
    """Return the rotations (n, 3, 3) of bending by v (n, 2) rad."""
    beta = np.maximum(np.linalg.norm(v, axis=1), 1e-9)[:, None, None]
    cross = np.zeros((len(v), 3, 3))
    cross[:, 0, 2], cross[:, 2, 0], cross[:, 1, 2], cross[:, 2, 1] = (
        v[:, 0],
        -v[:, 0],
        v[:, 1],
        -v[:, 1],
    )
    return np.eye(3) + np.sin(beta) / beta * cross + (1 - np.cos(beta)) / beta**2 * (cross @ cross)
