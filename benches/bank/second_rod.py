"""The second-order response of the rod to large loads (`_core.Second`).

Second derivatives by loads, moduli and tensions.

At an equilibrium the cables are replaced by ones of almost no stiffness with the same tension. So
held, the rod is settled with a little more and a little less of each cause l (a g of gravity, a N
at the tip, 1 in a logarithm of the modulus, a N in a cable), and the difference of its answers to
every cause k is their derivative: places x_kl, lengths of cables L_kl. A cable that hangs is looked
at with the tension of one step. g_k is the share by which the answers grow for a unit of k: the
mean over gravity, tip and cables of Σ⟨x_l, x_kl⟩/Σ⟨x_l, x_l⟩. Units: mm, N, g. Pinned by
tests/benches/test_bank.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benches.bank.body_rod import REACH, grid, guessed, hanging
from benches.bank.law import Floats
from benches.bank.rod import Loads, Poses, settle
from benches.bank.section import Design, finger
from softmap_edge import _core
from softmap_edge.model.shapes import pairs_of

NODES = 7  # commands a channel
SOFT = 1e-4  # N/mm
REACHED = 0.3  # mm that a step moves the point that moves most,
MODULUS = 0.1  # but no more of a logarithm of the modulus
MODES = 12

# fields (k, S, 3N) and stretch (S, 4, k)
Answers = Callable[[Design, Loads, Poses], tuple[Floats, Floats]]
Length = Callable[[Design, Loads, Poses], Floats]
Stiffer = Callable[[Design, str, float], Design]
CAUSES = (*_core.LOADS, *_core.MODULI)  # and the cables


def bends(answers: Answers, length: Length, stiffer: Stiffer) -> dict[str, Floats]:
    """Return `fields` (S, pairs, 3N), `stretch` (S, pairs, 4), `growth` (S, causes).

    They are on the grid of NODES.

    `answers` to CAUSES and cables, `length` of cables, `stiffer` a design by so much of one of
    `_core.MODULI`.
    """
    design, loads = finger(1), hanging(grid(np.linspace(-REACH, REACH, NODES)))
    poses = settle(design, loads, guessed(loads.pull))
    soft = replace(design, cable=np.full_like(design.cable, SOFT))
    told = length(design, replace(loads, pull=np.zeros_like(loads.pull)), poses)
    tension = design.cable * np.maximum(told + loads.pull, 0.0)
    first, _ = answers(design, loads, poses)
    count, dead, given = len(first), len(_core.LOADS), len(CAUSES)
    fields, stretch = np.zeros((count, *first.shape)), np.zeros((count, len(told), 4, count))
    for l in range(count):
        size = REACHED / np.abs(first[l]).max()
        if dead <= l < given:
            size = min(size, MODULUS)
        held = tension.copy()
        if l >= given:
            held[:, l - given] = np.maximum(held[:, l - given], size)
        ends = []
        for sign in (size, -size):
            more = replace(loads, pull=(held + sign * (np.arange(4) == l - given)) / SOFT - told)
            more = replace(
                more, gravity=more.gravity + sign * _unit(l), tip=more.tip + sign * _unit(l - 3)
            )
            made = stiffer(soft, CAUSES[l], sign) if dead <= l < given else soft
            ends.append(answers(made, more, settle(made, more, poses)))
        fields[l] = (ends[0][0] - ends[1][0]) / (2 * size)
        stretch[l] = (ends[0][1] - ends[1][1]) / (2 * size)
    k, l = np.triu_indices(count)
    both = (fields + np.swapaxes(fields, 0, 1)) / 2
    longer = (stretch + np.swapaxes(stretch, 0, 3)) / 2
    kinds = np.repeat([0, 1, 3, 2], [3, dead - 3, given - dead, count - given])
    size = np.einsum("lsm,lsm->ls", first, first)
    share = (kinds != 3)[:, None] / (
        3 * np.stack([size[kinds == kind].sum(axis=0) for kind in kinds])
    )
    growth = np.einsum("ls,lsm,klsm->sk", share, first, both)
    return {
        "fields": both[k, l].swapaxes(0, 1),
        "stretch": longer[k, :, :, l].swapaxes(0, 1),
        "growth": growth,
    }


def _unit(axis: int) -> Floats:
    return np.asarray((np.arange(3) == axis).astype(float))


def second_of(found: dict[str, Floats]) -> _core.Second:
    """Return the second level of loads in a few modes."""
    fields = found["fields"]  # (S, P, 3N)
    size = np.sqrt(np.mean(fields**2, axis=(0, 2), keepdims=True)) + 1e-12
    modes = np.linalg.svd((fields / size).reshape(-1, fields.shape[2]), full_matrices=False)[2][
        :MODES
    ]
    both = np.concatenate([fields @ modes.T, found["stretch"]], axis=2)
    axes = [np.linspace(-REACH, REACH, NODES)] * 2
    place = np.zeros((found["growth"].shape[1],) * 2, int)
    k, l = np.triu_indices(len(place))
    place[k, l] = place[l, k] = np.arange(len(k))
    plain, moduli = (
        np.concatenate(
            [
                both[:, place[tuple(np.transpose(pairs))]].reshape(len(fields), -1),
                found["growth"][:, own],
            ],
            axis=1,
        )
        for pairs, own in pairs_of(len(_core.LOADS), len(_core.MODULI), 4)
    )
    return _core.Second(axes, plain, 4, np.ascontiguousarray(modes), moduli)
