"""Coverage of the commands of a learned model: polynomial leverage of the effective commands.

    h(v) = φᵀ (ΦᵀΦ/n + ε)⁻¹ φ,   φ = [1, monomials(q)],   q = (v − middle)/half

The monomials are the squares and products of the commands or, for a map of cable pulls, its own
terms. h/n is the diagonal of this regression's hat matrix: the variance of a prediction there, in
units of the noise variance. h is large for a command whose channels are each within their range but
were never moved together. For directions without motion in the runs, ε sets the tolerance. The
limit is the largest h of the training frames. Source: Hoaglin and Welsch, The American Statistician
32 (1978) 17. Pinned by tests/model/test_coverage.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import SoftmapError
from softmap_edge.files.npz import Arrays
from softmap_edge.model.basis import RIDGE, SQUARES, Basis

Floats = NDArray[np.float64]

# of a feature's mean square: 1 % of the range along a direction without motion counts as 10
EPSILON = 1e-5
FAR = 0.15  # of the range, from its ends: where a pair of channels is tested
MOST_PAIRS = 4  # pairs that a sentence lists
# times the largest leverage: a single channel reaches this 10 % of its half range beyond
LARGER = 1.5


@dataclass(frozen=True, eq=False)
class Coverage:
    """The commands of the training data: `middle`, `half` (C,), `root` (F, F) and `most` (1,).

    A command is covered if its leverage h = |φ root|² is at most `most`.
    """

    middle: Floats
    half: Floats
    root: Floats
    most: Floats
    basis: Basis = SQUARES

    @classmethod
    def of(cls, acting: Floats, basis: Basis = SQUARES) -> Coverage:
        """Return the coverage of the training data's effective commands (n, C), with a basis."""
        middle, half = basis.span(acting)
        features = _features((acting - middle) / half, basis)
        strength, directions = np.linalg.eigh(features.T @ features / len(features))
        root = directions / np.sqrt(np.maximum(strength, 0.0) + EPSILON)
        return cls(
            middle, half, root, np.array([float(((features @ root) ** 2).sum(axis=1).max())]), basis
        )

    def excess(self, acting: Floats) -> Floats:
        """Return the leverage (n,) of effective commands (n, C) over the largest trained."""
        features = _features((acting - self.middle) / self.half, self.basis)
        return np.asarray(((features @ self.root) ** 2).sum(axis=1) / self.most[0])

    def outside(self, acting: Floats) -> NDArray[np.bool_]:
        """Return which commands (n,) are outside the training data."""
        return np.asarray(self.excess(acting) > LARGER)

    def to_npz(self) -> Arrays:
        """Return the arrays for `prior.npz`."""
        return {
            "coverage_middle": self.middle,
            "coverage_half": self.half,
            "coverage_root": self.root,
            "coverage_most": self.most,
            "coverage_basis": np.array([self.basis.degree, self.basis.pulled], float),
        }

    @classmethod
    def from_npz(cls, arrays: Mapping[str, NDArray[np.generic]], channels: int) -> Coverage | None:
        """Read the arrays of `prior.npz`; return None if it has none.

        Raises:
            SoftmapError: arrays are missing, or do not match a model with that many channels.
        """
        if not any(name.startswith("coverage_") for name in arrays):
            return None
        given = (
            np.asarray(arrays.get("coverage_basis", [SQUARES.degree, SQUARES.pulled]), float)
            .ravel()
            .tolist()
        )
        if given not in [
            [degree, pulled] for degree in range(1, len(RIDGE) + 1) for pulled in (0.0, 1.0)
        ]:
            raise SoftmapError(
                f"coverage: 'basis' is {given[:3]}, expected a degree and 0 or 1; learn the "
                "bundle again"
            )
        basis = Basis(int(given[0]), given[1] == 1.0)
        count = 1 + basis.count(channels)
        shapes = {"middle": (channels,), "half": (channels,), "root": (count, count), "most": (1,)}
        values = {
            name: np.asarray(arrays.get(f"coverage_{name}", np.zeros(0)), float) for name in shapes
        }
        wrong = [name for name, shape in shapes.items() if values[name].shape != shape]
        if wrong or not (values["half"] > 0).all() or not values["most"][0] > 0:
            name = wrong[0] if wrong else "half"
            raise SoftmapError(
                f"coverage: '{name}' of shape {values[name].shape} does not fit {channels} "
                "channels, or is not above 0; learn the bundle again"
            )
        return cls(**values, basis=basis)


def apart(commands: Floats) -> list[tuple[int, int]]:
    """Return the pairs of channels that were moved, but never far enough together.

    The criterion is the leverage of [1, u, v, u·v] at the four corners of their ranges (`FAR`
    inside). A circle covers the corners, a cross does not.

    Args:
        commands: of a run, shape (n, C); constant channels are omitted.
    """
    middle, half = SQUARES.span(commands)
    q = (commands - middle) / half
    moving = np.flatnonzero(np.ptp(commands, axis=0) > 0)
    return [
        (int(i), int(j)) for i, j in combinations(moving, 2) if _never_together(q[:, i], q[:, j])
    ]


def _never_together(u: Floats, v: Floats) -> bool:
    """Return whether all four corners of two channels (n,), within −1 … 1, are uncovered."""
    corners = (1.0 - 2.0 * FAR) * np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)])
    moved, asked = (
        np.stack([np.ones(len(x)), x, y, x * y], axis=1) for x, y in ((u, v), corners.T)
    )
    strength, directions = np.linalg.eigh(moved.T @ moved / len(moved))
    root = directions / np.sqrt(np.maximum(strength, 0.0) + EPSILON)
    most = ((moved @ root) ** 2).sum(axis=1).max()
    return bool((((asked @ root) ** 2).sum(axis=1) > LARGER * most).all())


def pairs_text(pairs: list[tuple[int, int]]) -> str:
    """Return pairs of channels as text for a sentence."""
    named = ", ".join(f"{i} and {j}" for i, j in pairs[:MOST_PAIRS])
    return named + (f" and {len(pairs) - MOST_PAIRS} more pairs" if len(pairs) > MOST_PAIRS else "")


def _features(q: Floats, basis: Basis) -> Floats:
    return np.concatenate([np.ones((len(q), 1)), basis.terms(q)], axis=1)
