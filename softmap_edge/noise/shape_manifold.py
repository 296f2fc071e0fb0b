"""The shapes that a body takes under its commands, whatever came before.

    s = V (x - m)        scores of a shape along its b largest commanded modes
    x ~ P(s)             polynomial: the manifold of shapes; b is the rank of the commands

Play, creep and friction of the drive move a body to another of its shapes, so they stay on the
manifold, however large they are. A motion of the frame of reference leaves it, but for its part
along the tangents dP/ds. What remains of a frame beyond P is therefore frame jitter and noise. The
degree is the one with the least error on frames that are left out. Shapes of two orientations, or
of two runs, are two manifolds. Units: mm. Limits: an effect with memory that changes the shapes
themselves, as friction along the body, leaves the manifold as well. Pinned by
tests/noise/test_shape_manifold.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement
from math import comb

import numpy as np
from numpy.typing import NDArray

from softmap_edge.noise.repeats import RUN, filled, same_way
from softmap_edge.run.conditions import Conditions

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Ints = NDArray[np.int64]
Rows = NDArray[np.intp]

MOST = 6  # dimensions at most
# of the polynomial: degree and coefficients at most, and frames that each coefficient needs
DEGREE, COEFFICIENTS, FRAMES = 4, 60, 12
THINNED = 1500  # frames at most that a polynomial is fitted to
# of the choice of the degree: folds, and parts of each, which hold frames that follow each other
FOLDS, PARTS = 5, 4
ROUNDS = 10  # in which unseen features are set to those of the manifold
LEAST = 1e-2  # of the largest singular value: a direction of the commands that moves less is none


@dataclass(frozen=True)
class _Polynomial:
    """The features of scaled scores: coefficients (m, F) mm of monomials up to a degree.

    It is `curved` if the frames are enough to show a curvature, whether there is one or not.
    """

    degree: int
    coefficients: Floats
    curved: bool

    def at(self, scores: Floats) -> Floats:
        """Return the features (n, F) mm at scores (n, b)."""
        return np.asarray(monomials(scores, self.degree) @ self.coefficients)

    def tangents(self, scores: Floats) -> Floats:
        """Return the derivatives (n, F, b) mm of the features by the scores (n, b)."""
        return np.asarray(np.einsum("kmb,mf->kfb", slopes(scores, self.degree), self.coefficients))

    def towards(self, x: Floats, known: Mask, scores: Floats) -> Floats:
        """Return the Gauss-Newton step (n, b) of scores to what is known of features (n, F)."""
        along = self.tangents(scores) * known[:, :, None]
        gram = np.swapaxes(along, 1, 2) @ along
        gram += (
            1e-9 * (1.0 + np.trace(gram, axis1=1, axis2=2)[:, None, None]) * np.eye(len(scores.T))
        )
        left = np.einsum("nfb,nf->nb", along, x - self.at(scores))
        return np.clip(np.linalg.solve(gram, left[:, :, None])[:, :, 0], -0.5, 0.5)


@dataclass(frozen=True)
class Shapes:
    """Deviation of frames from the manifolds of their shapes.

    Attributes:
        remainder: features minus the manifold, (K, F) mm; NaN where unseen, and where an
            orientation has too few frames to show how its manifold is curved.
        scores: place of each frame on its manifold, (K, b), within -1 and 1.
        kind: number of each frame's manifold, (K,).
        manifolds: one of each orientation of each run.
    """

    remainder: Floats
    scores: Floats
    kind: Ints
    manifolds: tuple[_Polynomial, ...]

    @property
    def coefficients(self) -> int:
        """How many coefficients of a feature were fitted, in all curved manifolds together."""
        return sum(len(one.coefficients) for one in self.manifolds if one.curved)

    def tangents(self, rows: Rows) -> Floats:
        """Return derivatives (n, F, b) mm of the features of frames by their scores."""
        out = np.empty((len(rows), self.remainder.shape[1], self.scores.shape[1]))
        for kind, one in enumerate(self.manifolds):
            at = self.kind[rows] == kind
            out[at] = one.tangents(self.scores[rows[at]])
        return out


def shapes(seen: Floats, state: Conditions, dwell: Ints) -> Shapes | None:
    """Return how frames deviate from the shapes that their commands make.

    Args:
        seen: features (K, F) mm, NaN where unseen.
        state: conditions of the frames.
        dwell: (K,) number of the dwell, -1 outside dwells; it holds the number of the run.

    Returns:
        Shapes: None if the frames of all orientations are too few, or if the commands have more
            dimensions than a manifold may have.
    """
    dimensions = rank(state.command)
    if dimensions > MOST:
        return None
    remainder, scores = np.full(seen.shape, np.nan), np.zeros((len(seen), dimensions))
    kind = np.zeros(len(seen), dtype=np.int64)
    manifolds: list[_Polynomial] = []
    for rows in _of_one_kind(state, dwell):
        manifold, scores[rows], fitted = _manifold(seen[rows], state.command[rows], dimensions)
        kind[rows] = len(manifolds)
        manifolds.append(manifold)
        if manifold.curved:
            remainder[rows] = seen[rows] - fitted
    if not any(one.curved for one in manifolds):
        return None
    return Shapes(remainder, scores, kind, tuple(manifolds))


def rank(command: Floats) -> int:
    """Return in how many independent directions commands (K, C) move."""
    span = np.ptp(command, axis=0) if len(command) else np.zeros(command.shape[1])
    x = command[:, span > 0] / span[span > 0]
    size = np.linalg.svd(x - x.mean(axis=0), compute_uv=False) if x.size else np.zeros(0)
    return int((size > LEAST * size[0]).sum()) if len(size) else 0


def monomials(x: Floats, degree: int) -> Floats:
    """Return the monomials (K, m) of x (K, b) up to a degree."""
    return np.asarray(np.prod(x[:, None, :] ** _powers(x.shape[1], degree), axis=2))


def slopes(x: Floats, degree: int) -> Floats:
    """Return the derivatives (K, m, b) of the monomials of x (K, b) up to a degree."""
    powers = _powers(x.shape[1], degree)
    out = np.empty((len(x), *powers.shape))
    for d in range(x.shape[1]):
        lower = powers - (np.arange(x.shape[1]) == d) * (powers[:, d : d + 1] > 0)
        out[:, :, d] = powers[:, d] * np.prod(x[:, None, :] ** lower, axis=2)
    return out


def _powers(dimensions: int, degree: int) -> Ints:
    """Return the powers (m, b) of the monomials of b numbers up to a degree."""
    sets = [
        c for n in range(degree + 1) for c in combinations_with_replacement(range(dimensions), n)
    ]
    powers = np.array([[one.count(d) for d in range(dimensions)] for one in sets], dtype=np.int64)
    return powers.reshape(len(sets), dimensions)


def _manifold(seen: Floats, command: Floats, dimensions: int) -> tuple[_Polynomial, Floats, Floats]:
    """Return the manifold of features (K, F) mm, the scores (K, b), and the shapes (K, F) mm there.

    An unseen feature is where the manifold has it.
    """
    kept = np.unique(np.linspace(0, len(seen) - 1, min(len(seen), THINNED)).astype(int))
    counts = {d: comb(dimensions + d, d) for d in range(1, DEGREE + 1)}
    degrees = [d for d, count in counts.items() if count <= min(COEFFICIENTS, len(kept) // FRAMES)]
    curved = len(degrees) > 1
    degrees = degrees or [1 if counts[1] < len(kept) else 0]
    fold = np.arange(len(kept)) * PARTS * FOLDS // len(kept) % FOLDS
    known, x = np.isfinite(seen), filled(seen)
    gaps = np.flatnonzero(~known.all(axis=1))
    for _ in range(ROUNDS if len(gaps) else 1):
        scores = _scores(x, command, dimensions)
        errors = [_held_out(monomials(scores[kept], d), x[kept], fold) for d in degrees]
        degree = degrees[int(np.argmin(errors))]
        columns = monomials(scores[kept], degree)
        one = _Polynomial(degree, np.linalg.lstsq(columns, x[kept], rcond=None)[0], curved)
        scores[gaps] += one.towards(x[gaps], known[gaps], scores[gaps])
        fitted = one.at(scores)
        x = np.where(known, x, fitted)
    return one, scores, fitted


def _scores(x: Floats, command: Floats, dimensions: int) -> Floats:
    """Return scores (K, b) of features x (K, F) along their modes that are linear in commands."""
    about, columns = x - x.mean(axis=0), command - command.mean(axis=0)
    linear = columns @ np.linalg.lstsq(columns, about, rcond=None)[0]
    scores = about @ np.linalg.svd(linear, full_matrices=False)[2][:dimensions].T
    return np.asarray(scores / np.maximum(np.abs(scores).max(axis=0, initial=0.0), 1e-12))


def _held_out(columns: Floats, x: Floats, fold: Rows) -> float:
    """Return the error of x (K, F) by columns (K, m) on folds (K,) that are left out in turn."""
    error = 0.0
    for one in range(FOLDS):
        others = fold != one
        found = np.linalg.lstsq(columns[others], x[others], rcond=None)[0]
        error += float(np.sum((x[~others] - columns[~others] @ found) ** 2))
    return error


def _of_one_kind(state: Conditions, dwell: Ints) -> list[Rows]:
    """Return the frames of each orientation of each run; a moving frame is of the next dwell's."""
    count = len(dwell)
    next_dwell = np.minimum.accumulate(np.where(dwell >= 0, np.arange(count), count)[::-1])[::-1]
    last = int(np.flatnonzero(dwell >= 0)[-1]) if (dwell >= 0).any() else 0
    run = dwell[np.minimum(next_dwell, last)] >> RUN
    left, found = np.arange(count), []
    while len(left):
        kind = run[left] == run[left[0]]
        if state.gravity is not None:
            kind &= same_way(state.gravity[left], state.gravity[left[0]])
        found.append(left[kind])
        left = left[~kind]
    return found
