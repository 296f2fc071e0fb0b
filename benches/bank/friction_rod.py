"""Friction of the cables in their guides along the body: hysteretic in shape, not in the command.

A cable that slides towards the base over guide i passes less tension to the segment beyond. One
that slides back passes more:

    T_{i+1} = T_i exp(−(μ θ_i + μ₀) z_i),     z' = x'/δ (1 − z sgn x'),     x_i = −Σ_{j≥i} ℓ_j

θ_i is the bending angle of the cable at the guide, μ₀ a tight hole, ℓ_j the lengths of its segments
and x_i its slide (Dahl: it yields a little before it slides). While the finger is loaded the base
bends more, so that the tip leads. After a reversal the guides let go one after another from the
base. The tension obeys k (Σ ℓ − Σ ℓ⁰ + d) = T₀ Σ ℓ_j T_j/T₀ / Σ ℓ, and the nodes are in balance
with T_j. There is no energy to minimise, so plain Newton steps start from the frictionless rod.
Limit: the slides are those of the finger without friction. With those of the finger with friction
(`passes`) the guides let go in a slightly different order after a reversal: a quarter of the
displacement by friction at μ = 0.1. Units: mm, N, rad. Pinned by tests/benches/test_bank_shop.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benches.bank.law import Floats, Past
from benches.bank.newton_step import newton_step
from benches.bank.rod import TOLERANCE, Loads, Poses, balance, guides, settle
from benches.bank.rotations import turn
from benches.bank.section import Design, finger

EVERY_S = 0.1  # of the path along which slides are followed
STEPS = 80
WHOLE = 15  # of them in full; later steps would alternate between a taut and a slack cable
LONGEST = (3.0, 0.1)  # mm and rad of one node in one step


def dragged(design: Design, loads: Loads, start: Poses) -> Poses:
    """Return rods in balance under cables with friction (`loads.tension`).

    Their tension varies along them; each is solved from a near state.

    Raises:
        ArithmeticError: a rod does not settle.
    """
    x, frame, tension = start.x.copy(), start.frame.copy(), start.tension.copy()
    error, open_ = np.full(len(x), np.inf), np.arange(len(x))
    for count in range(STEPS):
        here = loads.rows(open_)
        found = balance(design, here, x[open_], frame[open_])
        tension[open_] = found.pull
        error[open_] = np.max(np.abs(found.slope) * [1, 1, 1, 0.1, 0.1, 0.1], axis=(1, 2))
        going = error[open_] > TOLERANCE
        if not going.any():
            return Poses(x, frame, tension, error)
        open_, blocks = open_[going], tuple(b[going] for b in found.blocks)
        taut = found.pull[going] > 0.0
        step = newton_step(
            blocks, found.slope[going], found.lengths[going], taut, design.cable, found.drawn[going]
        )
        size = np.maximum(
            np.linalg.norm(step[..., :3], axis=2).max(axis=1) / LONGEST[0],
            np.linalg.norm(step[..., 3:], axis=2).max(axis=1) / LONGEST[1],
        )
        step *= (1.0 if count < WHOLE else 0.4) / np.maximum(size, 1.0)[:, None, None]
        x[open_, 1:] += step[..., :3]
        frame[open_, 1:] = turn(step[..., 3:]) @ frame[open_, 1:]
    raise ArithmeticError(
        f"{len(open_)} of {len(x)} rods do not settle with friction: {error.max():.2g} N are left"
    )


def along(
    mu: Floats,
    tight: float,
    give_mm: float,
    past: Past,
    guess: Callable[[Floats], Poses],
    passes: int = 0,
) -> Floats:
    """Return tensions (K, 4, segments) along the cables, relative to the base.

    They are at the seen frames.

    Args:
        mu: friction (4,) of each cable.
        tight: of each guide.
        give_mm: yield before a cable slides, mm.
        past: history of the cables.
        guess: from pulls (P, 4) mm to about the state of the plain finger.
        passes: along the path with friction.
    """
    keep = max(1, round(EVERY_S / (past.t[1] - past.t[0])))
    t, pull, gravity = past.t[::keep], past.pull[::keep], past.gravity[::keep]
    design = finger(1)
    poses = guess(pull)
    loads = Loads(pull, gravity, np.zeros((len(pull), 3)))
    if passes:
        poses = settle(design, loads, poses)
    share = _shares(design, poses, mu, tight, give_mm)
    for _ in range(passes):
        poses = dragged(design, replace(loads, tension=share), poses)
        share = _shares(design, poses, mu, tight, give_mm)
    at = np.clip(np.interp(past.taken, t, np.arange(len(t))), 0, len(t) - 1)
    low = np.minimum(at.astype(int), len(t) - 2)
    part = (at - low)[:, None, None]
    return np.asarray((1.0 - part) * share[low] + part * share[low + 1])


def _shares(design: Design, poses: Poses, mu: Floats, tight: float, give_mm: float) -> Floats:
    """Return the tension (P, 4, segments) along the cables over a path of poses.

    It is relative to that at the base.
    """
    line = np.diff(guides(design, poses.x, poses.frame), axis=2)
    span = np.linalg.norm(line, axis=3)
    way = line / span[..., None]
    # (P, 4, segments - 1)
    bent = np.arccos(np.clip(np.sum(way[:, :, 1:] * way[:, :, :-1], axis=3), -1.0, 1.0))
    beyond = np.cumsum(span[..., ::-1], axis=2)[..., ::-1][..., 1:]
    slid = -np.diff(beyond, axis=0)
    z, out = np.zeros(bent.shape[1:]), np.zeros(bent.shape)
    for k, step in enumerate(slid):
        sign = np.sign(step)
        z = sign + (z - sign) * np.exp(-np.abs(step) / give_mm)
        out[k + 1] = z
    lost = np.cumsum((mu[:, None] * bent + tight) * out, axis=2)
    return np.exp(-np.concatenate([np.zeros((*lost.shape[:2], 1)), lost], axis=2))
