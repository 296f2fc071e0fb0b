"""Cameras of the bank: levels of difficulty, correlated errors, small background laws.

Every point has an error of its own; the whole frame shivers (memory of a second) and creeps (half a
minute); patches are hidden. And no finger is as its model says even when nothing is hidden: a
little play, creep, lag, an imperfect mounting. Units: mm, degrees, s. Randomness only from the
generator that is given. Pinned by tests/benches/test_bank.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benches.bank.law import Floats, Law
from benches.bank.laws_body import Askew, OtherWeight, Prony
from benches.bank.laws_drive import Gear, Horns, Loop
from benches.bank.rotations import turn


@dataclass(frozen=True)
class Level:
    """Difficulty: σ of point and frame, share of hidden points, background, law's displacement.

    `clouds`: cameras see the points described here as clouds (`clouds.py`); their noise, outliers
    and holes come on top. `memory_s` of the shivering frame; `tails`: degrees of freedom of
    Student's noise, 0 for a Gaussian; `lost`: share of frames that are displaced by some 10 mm.
    """

    name: str
    point_mm: float
    shiver_mm: float
    shiver_deg: float
    creep_mm: float
    hidden: float
    background: float
    moves_mm: tuple[float, float]
    clouds: bool = False
    memory_s: float = 1.0
    tails: float = 0.0
    lost: float = 0.0


LEVELS = {
    level.name: level
    for level in (
        Level("easy", 0.15, 0.03, 0.02, 0.0, 0.0, 0.3, (2.0, 4.0)),
        Level("real", 0.30, 0.05, 0.03, 0.03, 0.08, 1.0, (1.2, 3.6)),
        Level("hard", 0.30, 0.05, 0.03, 0.03, 0.08, 1.0, (0.4, 0.95)),
        Level("clouds", 0.0, 0.05, 0.03, 0.03, 0.0, 1.0, (1.2, 3.6), clouds=True),
    )
}


def background(level: Level, rng: np.random.Generator, channels: int) -> tuple[Law, ...]:
    """Draw small background errors: about 0.1 mm of the section centroids in all.

    This is times the level's share.
    """
    size = level.background

    def sign(count: int) -> Floats:
        return np.asarray(rng.uniform(0.5, 1.0, count) * rng.choice([-1.0, 1.0], count))

    shift = 0.015 * size * sign(channels)
    return (
        Loop(0.0007 * size, 0.8),
        Gear(tuple(0.02 * size * np.abs(sign(channels))), 0.002),
        Prony(
            tuple(0.004 * size * np.abs(sign(channels))), float(rng.uniform(4, 8)), (0.3, 0.4, 0.3)
        ),
        Horns(tuple(np.concatenate([shift, -shift]))),
        OtherWeight(0.004 * size * float(sign(1)[0]), (*(0.15 * size * sign(2)), 0.0)),
        Askew(tuple(0.02 * size * sign(3)), tuple(0.02 * size * sign(3))),
    )


def looked(
    points: Floats, t: Floats, level: Level, rng: np.random.Generator
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return what is seen of points (K, N, 3) mm at t (K,) s, and which (K, N) are."""
    shiver, creep = _wandering(t, level.memory_s, 6, rng), _wandering(t, 30.0, 3, rng)
    noise = (
        rng.standard_t(level.tails, size=points.shape)
        if level.tails
        else rng.normal(size=points.shape)
    )
    seen = points + level.point_mm * noise
    seen = np.einsum("kij,knj->kni", turn(np.radians(level.shiver_deg) * shiver[:, 3:]), seen)
    seen += (level.shiver_mm * shiver[:, :3] + level.creep_mm * creep)[:, None]
    if level.lost > 0.0:
        astray = rng.uniform(size=t.size) < level.lost
        seen[astray] += rng.normal(scale=10.0, size=(int(astray.sum()), 1, 3))
    visible = np.ones(points.shape[:2], bool)
    if level.hidden > 0.0:
        patch = _wandering(t, 5.0, 3, rng)
        count = round(level.hidden * points.shape[1])
        for k, way in enumerate(patch):
            centre = points[k].mean(axis=0) + 40.0 * way
            visible[k, np.argsort(np.linalg.norm(points[k] - centre, axis=1))[:count]] = False
    return seen, visible


def _wandering(t: Floats, memory: float, count: int, rng: np.random.Generator) -> Floats:
    """Return `count` Ornstein-Uhlenbeck processes of variance 1 at t (K,) s."""
    out = np.empty((t.size, count))
    state = rng.normal(size=count)
    for k in range(t.size):
        keep = np.exp(-(t[k] - t[k - 1]) / memory) if k else 1.0
        state = keep * state + np.sqrt(1.0 - keep * keep) * rng.normal(size=count)
        out[k] = state
    return out


def rms(difference: Floats, seen: NDArray[np.bool_] | None = None) -> float:
    """Return the RMS length mm of 3-vectors, of those that are seen."""
    squares = np.sum(difference**2, axis=-1)
    return float(np.sqrt(np.mean(squares if seen is None else squares[seen])))


def sections(points: Floats, place: Floats, count: int = 9) -> Floats:
    """Return centroids (K, count, 3) mm of slices of points (K, N, 3) along the body.

    The points are at `place` (N,) mm.
    """
    which = np.minimum((place / place.max() * count).astype(int), count - 1)
    return np.stack(
        [points[:, which == s].mean(axis=1) for s in range(count) if np.any(which == s)], axis=1
    )


def names(laws: Sequence[Law]) -> tuple[str, ...]:
    """Return the names of laws."""
    return tuple(law.NAME for law in laws)
