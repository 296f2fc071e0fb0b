"""Fit radial basis functions with a linear tail to shapes at scattered commands.

Cross-validation gives the smoothing and the error.

    a(u) = Σ_i w_i φ(|q − q_i|) + b + t·q,   φ(r) = r or r³,   q = u/scale
    minimise |a(u_k) − a_k|² + λ wᵀ(±φ)w   with  Σ w_i = 0, Σ w_i q_i = 0
        (G. Wahba, Spline Models, 1990)

Every command is a node, up to `NODES`; beyond, nodes are spread and all rows are fitted by least
squares. Kernel and λ minimise the leave-out error. A row is left out together with all rows within
`reach`: the distance of a random command between two rows from its nearest row. If rows follow a
path, as in a recording, neighbours are correlated. Then the middles of contiguous tenths are
tested, with the full tenth left out. In closed form, with the smoother H, e_G = (1 − H_GG)⁻¹ r_G.
Kernel and λ are chosen on the same rows, so the error is slightly low. Rows at the border need
extrapolation: they count in this choice, but not in the error. Measured: fitted to the first 60 %
of a recording of data/trunk (six motors), the stated error is 5.5 mm, and 6.1 mm on its last 30 %.
Evaluation: rust/shape/scattered.rs. Pinned by tests/sweep/test_scattered.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from softmap_edge.files.npz import Stored
from softmap_edge.geometry.centreline import distances, farthest
from softmap_edge.model.shapes import ModeArrays, Nodes, Numbers

Floats = NDArray[np.float64]

NODES = 600  # most nodes; more slow every prediction
ROWS = 2500  # most commands of a fit, evenly spread over the file
TESTS = 300  # rows that are left out one by one
# of the rows: with so many nearest to the row before or after, the rows are a path
FOLLOWING = 0.5
BLOCKS = 20  # tested blocks along a path; half a block on either side is also left out
NARROW = 1e-6  # half range assumed for a constant command
POWERS = (1, 3)
SMOOTHINGS = tuple(10.0**k for k in range(-9, 2))  # λ over the largest squared singular value
PAIRS, PAIRS_SEED = 500, 5
LARGEST_GROUP = 0.1  # of the rows
TINY = 1e-14  # of a row's own weight: keeps rows solvable that the fit interpolates exactly
BORDER = 0.9  # of half the range
ENOUGH_INNER = 0.25  # of the rows


@dataclass(frozen=True, eq=False)
class ScatteredFit:
    """A fit: the arguments of `_core.Scattered`, and its validation.

    `left_out` (k, m) are the held-out residuals of rows (k,) `tested`, in the given order; `reach`
    is the gap between rows as a share of half the range.
    """

    nodes: Floats  # (n, C)
    scale: Floats  # (C,)
    power: int
    coefficients: Floats  # (n + 1 + C, m)
    smoothing: float
    left_out: Floats
    tested: NDArray[np.intp]
    reach: float

    @property
    def over(self) -> Nodes:
        """The nodes of its coefficients, in the form of a bundle."""
        return Nodes(self.nodes, self.scale, self.power)

    def of_modes(self, mean: Numbers, modes: Numbers) -> ModeArrays:
        """Return the shape for these coefficients of modes (m, M) about a mean (M,)."""
        return ModeArrays(self.over, mean, Stored(modes), Stored(self.coefficients))


def fit_scattered(commands: Floats, values: Floats, most: int = NODES) -> ScatteredFit:
    """Fit `values` (S, m) at distinct commands (S, C), with at most `most` nodes."""
    rows = (
        np.arange(len(commands))
        if len(commands) <= ROWS
        else np.linspace(0, len(commands) - 1, ROWS).astype(int)
    )
    scale = half_range(commands)
    q, values = commands[rows] / scale, values[rows]
    reach = gap(q)
    groups = _groups(q, reach)
    tested = np.concatenate([group[:count] for count, group in groups])
    inner = np.all(np.abs(q[tested] - 0.5 * (q.max(axis=0) + q.min(axis=0))) <= BORDER, axis=1)
    inner |= bool(np.mean(inner) < ENOUGH_INNER)
    nodes = farthest(q, most)
    tail = np.column_stack([np.ones(len(q)), q])
    best: tuple[float, ScatteredFit] | None = None
    for power in POWERS:
        system = _System(q, nodes, tail, power)
        for share in SMOOTHINGS:
            left_out = system.left_out(values, share, groups)
            error = float(np.sum(left_out**2))
            if best is None or error < best[0]:
                solved = system.solve(values, share)
                where = rows[tested[inner]]
                fit = ScatteredFit(
                    commands[rows[nodes]],
                    scale,
                    power,
                    solved,
                    share,
                    left_out[inner],
                    where,
                    reach,
                )
                best = error, fit
    assert best is not None
    return best[1]


def half_range(commands: Floats) -> Floats:
    """Return half the range of each command (S, C); 1 for a constant one.

    A constant command carries no information.
    """
    half = 0.5 * np.ptp(commands, axis=0)
    return np.where(half > NARROW, half, 1.0)


def gap(q: Floats) -> float:
    """Return the median distance of random commands from the nearest row of (S, C).

    Random commands are drawn between two rows.
    """
    rng = np.random.default_rng(PAIRS_SEED)
    pairs = rng.integers(len(q), size=(PAIRS, 2))
    between = 0.5 * (q[pairs[:, 0]] + q[pairs[:, 1]])[pairs[:, 0] != pairs[:, 1]]
    return float(np.median(distances(between, q).min(axis=1))) if len(between) else 0.0


def _groups(q: Floats, reach: float) -> list[tuple[int, NDArray[np.intp]]]:
    """Return groups of rows to leave out, and how many of each, from its first, are tested."""
    rows = len(q)
    apart = distances(q, q)
    np.fill_diagonal(apart, np.inf)
    following = np.abs(np.argmin(apart, axis=1) - np.arange(rows)) == 1
    if rows >= 10 * BLOCKS and np.mean(following) > FOLLOWING:
        edges = np.linspace(0, rows, BLOCKS + 1).astype(int)
        half = rows // (2 * BLOCKS)
        parts = [
            (np.arange(a, b), np.r_[max(0, a - half) : a, b : min(rows, b + half)])
            for a, b in pairwise(edges)
        ]
        return [(len(middle), np.concatenate([middle, around])) for middle, around in parts]
    tested = np.unique(np.linspace(0, rows - 1, min(TESTS, rows)).astype(int))
    return [(1, _near(q, int(k), reach, max(1, int(LARGEST_GROUP * rows)))) for k in tested]


def _near(q: Floats, row: int, reach: float, largest: int) -> NDArray[np.intp]:
    """Return the rows within `reach` of a row, itself first, at most `largest`."""
    apart = np.sqrt(np.sum((q - q[row]) ** 2, axis=1))
    apart[row] = -1.0
    near = np.argsort(apart, kind="stable")[:largest]
    return np.asarray(near[apart[near] <= reach])


class _System:
    """A kernel's penalised least squares, diagonalised: any smoothing costs one product."""

    def __init__(self, q: Floats, nodes: NDArray[np.intp], tail: Floats, power: int) -> None:
        # the kernel that is positive where the tail is annihilated
        sign = -1.0 if power == 1 else 1.0
        kernel = sign * distances(q, q[nodes]) ** power  # (S, n)
        full = np.linalg.qr(tail[nodes], mode="complete")[0]
        null = full[:, tail.shape[1] :]  # (n, r) weights that annihilate the tail
        strength, vectors = np.linalg.eigh(null.T @ kernel[nodes] @ null)
        keep = (
            strength > 1e-13 * max(float(strength[-1]), 1e-300)
            if len(strength)
            else np.zeros(0, bool)
        )
        self.weights = null @ (vectors[:, keep] / np.sqrt(strength[keep]))  # (n, r)
        design = kernel @ self.weights
        self.sign, self.kernel, self.tail = sign, kernel, tail
        self.linear = np.linalg.qr(tail)[0]
        design -= self.linear @ (self.linear.T @ design)
        self.u, self.s, self.vt = np.linalg.svd(design, full_matrices=False)

    def _kept(self, share: float) -> Floats:
        """Return λ/(s² + λ): the share of each direction removed by smoothing."""
        level = share * float(self.s[0]) ** 2 if len(self.s) else 1.0
        return np.asarray(level / (self.s**2 + max(level, 1e-300)))

    def left_out(
        self, values: Floats, share: float, groups: list[tuple[int, NDArray[np.intp]]]
    ) -> Floats:
        """Return residuals (k, m) of each group's tested rows by the fit without the group."""
        lost = self._kept(share)
        inside = self.u.T @ values
        outside = values - self.linear @ (self.linear.T @ values)
        outside -= self.u @ (self.u.T @ outside)
        residual = outside + self.u @ (lost[:, None] * inside)
        found = []
        for count, group in groups:
            u, line = self.u[group], self.linear[group]
            apart = np.eye(len(group)) - line @ line.T - u @ u.T + (u * lost) @ u.T
            found.append(
                np.linalg.solve(apart + TINY * np.eye(len(group)), residual[group])[:count]
            )
        return np.concatenate(found)

    def solve(self, values: Floats, share: float) -> Floats:
        """Return coefficients (n + 1 + C, m): weights of nodes, then constant and slopes."""
        level = share * float(self.s[0]) ** 2 if len(self.s) else 1.0
        inner = self.vt.T @ (
            (self.s / (self.s**2 + max(level, 1e-300)))[:, None] * (self.u.T @ values)
        )
        weights = self.weights @ inner
        tail = np.linalg.lstsq(self.tail, values - self.kernel @ weights, rcond=None)[0]
        return np.vstack([self.sign * weights, tail])
