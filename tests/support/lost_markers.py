"""Marker recordings in which some markers are lost."""

import numpy as np

K = 400


T = np.arange(K) * 0.05


SINES = np.c_[8 * np.sin(1.3 * T), 8 * np.cos(0.9 * T)]


RNG = np.random.default_rng(0)


def body(u, count=4, noise=0.05, digits=3, seed=1):
    """Markers (K, M, 3) mm on a finger that bends with u (K, 2), as a log with `digits` has
    them. Calls of one `seed` draw the same noise.
    """
    rng = np.random.default_rng(seed)
    s = np.linspace(1 / count, 1, count)
    points = [
        np.c_[4 * u[:, 0] * a**2, 4 * u[:, 1] * a**2, 100 * a - 0.02 * (u**2).sum(axis=1) * a]
        for a in s
    ]
    points = np.stack(points, axis=1) + noise * rng.normal(size=(len(u), count, 3))
    return points if digits is None else np.round(points, digits)


def played(u, gap):
    """What follows u behind a play."""
    y = np.zeros_like(u)
    for k in range(1, len(u)):
        y[k] = np.clip(y[k - 1], u[k] - gap, u[k] + gap)
    return y


STAIRS = np.repeat(RNG.integers(-2, 3, (K // 20, 2)) * 4.0, 20, axis=0)


HOME = np.repeat(
    np.where(np.arange(K // 10)[:, None] % 2, 5 * RNG.normal(size=(K // 10, 2)), 0.0), 10, axis=0
)


ANGLE = RNG.uniform(0, 2 * np.pi, K)


RING = np.where(np.arange(K)[:, None] % 2, 8 * np.c_[np.cos(ANGLE), np.sin(ANGLE)], 0.0)


STILL = body(0 * SINES, noise=0)


GOOD = {
    "noise": (body(SINES), SINES),
    "no noise": (body(SINES, noise=0, digits=None), SINES),
    "whole millimetres": (body(SINES, noise=0, digits=0), SINES),
    "stairs without noise": (body(STAIRS, noise=0), STAIRS),
    "stairs": (body(STAIRS), STAIRS),
    "a play without noise": (body(played(SINES, 3), noise=0), SINES),
    "a wide play": (body(played(SINES, 6), noise=0), SINES),
    "home again and again": (body(HOME, noise=0), HOME),
    "home between full pulls": (body(RING, noise=0), RING),
    "no commands": (body(SINES), None),
    "one marker": (body(SINES, count=1), SINES),
    "one marker behind a play": (body(played(SINES, 5), count=1, noise=0), SINES),
}


BUT_ALSO = {
    "displacements": (body(HOME, noise=0) - STILL, HOME),
    "displacements between full pulls": (body(RING, noise=0) - STILL, RING),
    "displacements that rest": (
        body(np.clip(SINES, 0, None), noise=0) - STILL,
        np.clip(SINES, 0, None),
    ),
    "displacements without commands": (body(STAIRS, noise=0) - STILL, None),
    "a stop": (body(np.clip(SINES, -4, 5), noise=0), SINES),
    "it never moves": (STILL, SINES),
    "a clamp marker at the origin": (
        np.concatenate([np.zeros((K, 1, 3)), body(SINES)], axis=1),
        SINES,
    ),
    "a slow camera": (np.repeat(body(SINES)[::3], 3, axis=0)[:K], SINES),
}


ROWS = {
    "here and there": RNG.random(K) < 0.1,
    "at the start": np.arange(K) < 10,
    "in one stretch": (np.arange(K) > 200) & (np.arange(K) < 230),
    "once": np.arange(K) == 77,
}
