"""The level of ordinary static imperfections: the part of a model's misfit that depends on the command alone.

    r(k) = W c(u_k, lean_k) + …       c: monomials of the commands up to cubic, with those of the orientation
    level² = mean over held-out frames of |r|² − |r − W c|², over the places, mm²

W is a ridge regression of all features at once, in units of the noise, fitted on the other blocks of the run. So only
repeated errors count; memory, drift and noise do not. The level is a lower bound: errors outside the columns' span are
missing.
Units: mm. Limit: with more than three channels the columns hold no products. Pinned by tests/test_background.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis.jitter import polynomial
from softmap_edge.diagnosis.noise import Noise
from softmap_edge.diagnosis.record import Record
from softmap_edge.folds import Folds, run_folds

Floats = NDArray[np.float64]

RIDGES = (0.3, 10.0, 300.0, 1e4)  # in units of the noise: variance 1 / ridge of a weight


@dataclass(frozen=True)
class Background:
    """Static misfit of a run: its level in mm RMS over the places, one standard deviation, and the chosen ridge."""

    level_mm: float
    sigma_mm: float
    ridge: float

    def __str__(self) -> str:
        return f"static misfit: {self.level_mm:.2f} ± {self.sigma_mm:.2f} mm RMS"


def background(record: Record, predicted: Floats, noise: Noise) -> Background:
    """Estimate the static misfit of a prediction on a run.

    Args:
        record: the run.
        predicted: features (K, F) mm, of the model alone or with the effects found so far.
        noise: the noise of the run.

    Returns:
        Background: level 0 if no static map lowers the error on held-out blocks.

    Raises:
        SoftmapError: fewer than 8 frames.
    """
    residual = record.seen - predicted
    columns = _columns(record)
    white = np.linalg.inv(np.linalg.cholesky(noise.effective)).T
    parts = run_folds(record.t_seen, record.block)
    falls = {ridge: _held_out(columns, residual, white, parts, ridge, record) for ridge in RIDGES}
    ridge = max(falls, key=lambda r: float(falls[r][0].sum()))
    fall, count = falls[ridge][1], falls[ridge][2]
    level2 = max(0.0, float(fall.sum()) / max(1, count))
    spread = float(fall.std(ddof=1)) * np.sqrt(len(fall)) / max(1, count) if len(fall) > 1 else level2
    level = float(np.sqrt(level2))
    return Background(level, float(min(np.sqrt(spread), spread / (2.0 * max(level, 1e-12)))), ridge)


def _columns(record: Record) -> Floats:
    """Return the columns (K, m) of the static map: monomials of the commands, and their products with orientation."""
    command = polynomial(record.command)
    lean = record.leaning[:, np.ptp(record.leaning, axis=0) > 1e-9] if len(record) else record.leaning
    lean = (lean - lean.mean(axis=0)) / np.maximum(lean.std(axis=0), 1e-12)
    _, size, axes = np.linalg.svd(lean, full_matrices=False) if lean.size else (0, np.zeros(0), np.zeros((0, 0)))
    lean = lean @ axes[size > 1e-6 * size.max(initial=1.0)].T  # one axis for each further orientation
    columns = np.concatenate([command, *(command * one[:, None] for one in lean.T)], axis=1)
    return np.asarray(columns / np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-12))


def _held_out(
    columns: Floats, residual: Floats, white: Floats, parts: Folds, ridge: float, record: Record
) -> tuple[Floats, Floats, int]:
    """Return the falls (folds,) of the whitened and of the plain (mm²) held-out loss, and the number of places."""
    seen = np.isfinite(residual)
    clean = np.where(seen, residual, 0.0)
    whitened, plain, count = [], [], 0
    for train, test in parts:
        x = columns[train]
        gram = x.T @ x + ridge * np.eye(x.shape[1])
        explained = np.where(seen[test], columns[test] @ np.linalg.solve(gram, x.T @ clean[train]), 0.0)
        left = clean[test] - explained
        whitened.append(float(np.sum((clean[test] @ white) ** 2) - np.sum((left @ white) ** 2)))
        before, after = record.squares(np.where(seen[test], residual[test], np.nan)), record.squares(left)
        there = np.isfinite(before)
        plain.append(float(np.sum(before[there] - after[there])))
        count += int(there.sum())
    return np.array(whitened), np.array(plain), count
