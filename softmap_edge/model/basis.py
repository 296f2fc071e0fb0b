"""Terms of a static map of the commands or of cable pulls: monomials, or products of splines.

Learning fits their weights (`rod/regression.py`), a bundle stores them, and coverage uses the same
terms. Pinned by tests/rod/test_rod.py, tests/rod/test_pulled_rod.py and
tests/rod/test_splined_rod.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core

Floats = NDArray[np.float64]

RIDGE = (3e-5, 9e-4, 3e-4, 3e-4, 3e-4)  # by degree 1…5, for |q| ≤ 1
SPLINE_DEGREE = 3
# penalty of unit roughness at a ridge of 1: ridges then range from interpolation to a linear map
ROUGHNESS = 1e-3


@dataclass(frozen=True)
class Basis:
    """The terms of a static map.

    They are all monomials up to `degree` of the normalised commands or of the cable pulls. With
    `intervals` they are tensor products of cubic B-splines with that many intervals per command. A
    command above 0 pulls one cable and lets the other fall slack, and vice versa: a `pulled` basis
        has
    two variables per command, max(u, 0) and max(−u, 0).

    Splines are expressed in the eigenvectors of their roughness R = Σ_c |second differences along
    c|². A ridge on each, in proportion to its roughness, is then the smoothness penalty of a
    P-spline (Eilers and Marx 1996, doi:10.1214/ss/1038425655).
    """

    degree: int
    pulled: bool = False
    intervals: int = 0

    def span(self, u: Floats) -> tuple[Floats, Floats]:
        """Return `centre` and `scale` (C,) that normalise commands (n, C) to −1 … 1."""
        if not self.pulled:
            return commanded_range(u)
        most = np.abs(u).max(axis=0)
        return np.zeros(u.shape[1]), np.where(most > 0, most, 1.0)

    def columns(self, u: Floats) -> Floats:
        """Return the terms (n, F) of commands (n, C), normalised by their own range."""
        centre, scale = self.span(u)
        return self.terms((u - centre) / scale)

    def terms(self, q: Floats) -> Floats:
        """Return the terms (n, F) of normalised commands (n, C)."""
        if self.intervals:
            splines = _core.tensor_splines(np.ascontiguousarray(q), self.intervals)
            return np.asarray(splines @ _smooth(q.shape[1], self.intervals)[0])
        if self.pulled:
            q = np.concatenate([np.maximum(q, 0.0), np.maximum(-q, 0.0)], axis=1)
        return _core.monomials(np.ascontiguousarray(q), self.degree)

    def penalty(self, channels: int) -> Floats:
        """Return the penalty (F,) of each term at a ridge of 1."""
        if self.intervals:
            return _smooth(channels, self.intervals)[1]
        degrees = _core.monomial_degrees((1 + self.pulled) * channels, self.degree)
        return np.array([RIDGE[degree - 1] for degree in degrees])

    def in_core(self, weights: Floats, channels: int) -> Floats:
        """Return weights (1 + F, outputs) of the terms, intercept first, as the core takes them."""
        if not self.intervals:
            return weights
        return np.concatenate([weights[:1], _smooth(channels, self.intervals)[0] @ weights[1:]])

    def count(self, channels: int) -> int:
        """Return the number of terms F."""
        return len(self.penalty(channels))

    def __str__(self) -> str:
        """Return a short description of the map."""
        if self.intervals:
            return f"cubic splines of {self.intervals} intervals"
        return f"degree {self.degree}" + (" in the pulls of the cables" if self.pulled else "")


@cache
def _smooth(channels: int, intervals: int) -> tuple[Floats, Floats]:
    """Return roughness eigenvectors (S, F) of tensor splines, and their penalties (F,).

    The constant is omitted.
    """
    each = intervals + SPLINE_DEGREE
    second = np.diff(np.eye(each), 2, axis=0)
    rough: Floats = np.zeros((each**channels, each**channels))
    for c in range(channels):
        before, behind = np.eye(each**c), np.eye(each ** (channels - 1 - c))
        rough = rough + np.asarray(np.kron(np.kron(before, second.T @ second), behind))
    values, directions = np.linalg.eigh(rough)
    flat = directions[:, : 2**channels]  # products of linear functions, which have no roughness
    constant = np.full(len(rough), len(rough) ** -0.5)
    flat = np.linalg.svd(flat - np.outer(constant, constant @ flat))[0][:, : 2**channels - 1]
    penalty = np.concatenate([np.full(flat.shape[1], RIDGE[0]), ROUGHNESS * values[2**channels :]])
    return np.concatenate([flat, directions[:, 2**channels :]], axis=1), penalty


SQUARES = Basis(2)


def commanded_range(u: Floats) -> tuple[Floats, Floats]:
    """Return the centre and half width (C,) of the range of commands (n, C).

    The half width is 1 for a constant command.
    """
    low, high = u.min(axis=0), u.max(axis=0)
    return (low + high) / 2.0, np.where(high > low, (high - low) / 2.0, 1.0)
