"""The static map, solved again for every law of memory: a ridge regression on its terms.

This is variable projection.

    targets (n, q) ≈ base(v) + [1, terms(v)] W,   v = effective commands (n, C)

Targets in mm represent the markers: chords turned into the plane (Σ length × angle of those below).
Their squared error is about that of the markers. With a described rod they are the coordinates of
the markers, and `base` is that rod. The *held-out loss* of a fold is its sum of squares, predicted
from the other folds. Folds are contiguous because neighbouring frames are alike (`run/folds.py`).
The search fits laws with the map's `ridge`, which is almost zero. It compares them at the ridge of
the lowest held-out loss. Source: variable projection, Golub and Pereyra 1973, doi:10.1137/0710036.
Pinned by tests/rod/test_learned_memory.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.model.basis import Basis
from softmap_edge.rod.regression import RIDGE_STEPS, normalise
from softmap_edge.rod.signals import splines
from softmap_edge.run.folds import Folds

Floats = NDArray[np.float64]
Index = NDArray[np.intp]

# ridge of added columns of unit spread
ADDED_RIDGES = tuple(np.geomspace(1e-6, 1.0, 7).tolist())
SPLINED = 1e-4  # ridge of the B-splines of a splined map
STILL = 1e-9  # spread of a column that does not move
# of a column's mean square, added to each system: dependent columns share evenly
FLOOR = 1e-9


@dataclass(frozen=True, eq=False)
class StaticMap:
    """Targets (n, q) mm, the folds of the cross-validation, and the `basis` of its terms.

    A `splined` map has B-splines of each channel as well.
    """

    targets: Floats
    parts: Folds
    basis: Basis
    ridge: float = RIDGE_STEPS[0]
    splined: bool = False
    base: Callable[[Floats], Floats] | None = None

    def tuned(self, acting: Floats) -> StaticMap:
        """Return the map with the ridge of the lowest held-out loss, if its terms are splines."""
        if not self.basis.intervals:
            return self
        columns, penalty = self._columns(acting)
        folded = _Folded(columns, self.left(acting), self.parts)
        sums = [float(folded.losses(ridge * penalty).sum()) for ridge in RIDGE_STEPS]
        return replace(self, ridge=RIDGE_STEPS[int(np.argmin(sums))])

    def left(self, acting: Floats) -> Floats:
        """Return the targets (n, q) mm of the polynomial at effective commands `acting` (n, C)."""
        return self.targets if self.base is None else self.targets - self.base(acting)

    def residual(self, acting: Floats, rows: Index | None = None) -> Floats:
        """Return seen − mapped (n, q) mm, the map solved on frames `rows` (None: all)."""
        columns, penalty, targets = *self._columns(acting), self.left(acting)
        penalty = self.ridge * penalty
        rows = np.arange(len(targets)) if rows is None else rows
        kept = columns[rows]
        weights = np.linalg.solve(
            _system(kept.T @ kept, len(rows), penalty), kept.T @ targets[rows]
        )
        return np.asarray(targets - columns @ weights)

    def scanned(self, acting: Floats) -> float:
        """Return the held-out loss mm² at the usual ridge: fast, and without overfitting.

        A map of few motions cannot overfit.
        """
        columns, penalty = self._columns(acting)
        return float(_Folded(columns, self.left(acting), self.parts).losses(penalty).sum())

    def losses(self, acting: Floats, extra: Floats | None = None) -> Floats:
        """Return the held-out loss (folds,) mm², with `extra` columns (n, J) if given."""
        (columns, penalty), targets = self._columns(acting), self.left(acting)
        folded = _Folded(columns, targets, self.parts)
        alone = [folded.losses(ridge * penalty) for ridge in RIDGE_STEPS]
        best = int(np.argmin([losses.sum() for losses in alone]))
        if extra is None:
            return alone[best]
        spread = extra.std(axis=0)
        moving = spread > STILL
        folded = _Folded(
            np.concatenate([columns, extra[:, moving] / spread[moving]], axis=1),
            targets,
            self.parts,
        )
        added = np.ones(int(moving.sum()))
        found = [
            folded.losses(np.append(RIDGE_STEPS[best] * penalty, ridge * added))
            for ridge in ADDED_RIDGES
        ]
        return min(found, key=lambda losses: float(losses.sum()))

    def _columns(self, acting: Floats) -> tuple[Floats, Floats]:
        """Return the columns (n, 1 + F) of the map and their penalties at a ridge of 1."""
        penalty = np.append(0.0, self.basis.penalty(acting.shape[1]))
        rows = [np.ones((len(acting), 1)), self.basis.columns(acting)]
        if self.splined:
            q = normalise(acting)
            rows.append(splines(q, np.zeros(q.shape[1]), np.ones(q.shape[1])))
            penalty = np.append(penalty, np.full(rows[-1].shape[1], SPLINED))
        return np.concatenate(rows, axis=1), penalty


class _Folded:
    """Sums of products of columns (n, p) and targets (n, q) per fold: ridges are small solves."""

    def __init__(self, columns: Floats, targets: Floats, parts: Folds) -> None:
        square, mixed = columns.T @ columns, columns.T @ targets
        self.systems = []
        for train, test in parts:
            out = np.ones(len(columns), bool)
            out[train] = False
            gone = columns[out]
            part = square - gone.T @ gone, mixed - gone.T @ targets[out]
            self.systems.append((len(train), *part, columns[test], targets[test]))

    def losses(self, penalty: Floats) -> Floats:
        """Return the held-out loss (folds,) under a penalty (p,) per frame."""
        found = []
        for frames, square, mixed, columns, targets in self.systems:
            weights = np.linalg.solve(_system(square, frames, penalty), mixed)
            found.append(float(((columns @ weights - targets) ** 2).sum()))
        return np.array(found)


def _system(square: Floats, frames: int, penalty: Floats) -> Floats:
    """Return the normal equations' matrix with its ridge."""
    return square + np.diag(
        frames * penalty + FLOOR * max(float(np.trace(square)) / len(square), 1e-12)
    )
