"""Robust linear fit of commands: coefficients, their uncertainty, and outlier rows.

    u_i = Θ x_i + e_i,   cov e_i = S_i = E + P_i         P_i of each match, E the additional scatter
                                                         (from the MAD)
    min Σ ρ(d_i),  d_i² = e_iᵀ S_i⁻¹ e_i             Huber's ρ from least squares, then Tukey's
                                                     biweight with the same E
    cov Θ = k (Σ X_iᵀ S_i⁻¹ X_i)⁻¹,  k = mean(ψ²) / mean(ψ')² n / (n − p)
        of an M-estimator (Huber 1981, 7.6)

A row may hold only some of its commands: those not marked in `observed` have no weight. Units:
those of u and x. Limit: it fails with more than a third of outlier rows. Pinned by
tests/calibration/test_calibration.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# standard deviations; WIDER is added to Tukey's for each further command
HUBER, TUKEY, WIDER = 1.0, 4.685, 0.42
ROUNDS, SETTLED = 40, 1e-4
TO_SIGMA = 1.4826  # of the median absolute deviation
NO_SCATTER = 1e-9  # of the spread of the commands: below it, data count as exact


@dataclass(frozen=True, eq=False)
class AffineFit:
    """Coefficients (C, F) and their covariance (C·F, C·F), row by row.

    `weight` (n,) is 0 for rows that are wrong.

    `scatter` (C,) is the standard deviation of an observed command about the fit.
    """

    coefficients: Floats
    covariance: Floats
    weight: Floats
    scatter: Floats

    def __call__(self, design: Floats) -> Floats:
        """Return the commands (n, C) for rows (n, F)."""
        return np.asarray(design @ self.coefficients.T)

    def first(self, features: int) -> AffineFit:
        """Return the fit of the first features alone, without refitting."""
        cut = (
            np.arange(self.coefficients.size).reshape(self.coefficients.shape)[:, :features].ravel()
        )
        covariance = self.covariance[np.ix_(cut, cut)]
        return AffineFit(self.coefficients[:, :features], covariance, self.weight, self.scatter)

    @property
    def sigma(self) -> Floats:
        """Standard deviations (C, F)."""
        return np.sqrt(np.diag(self.covariance)).reshape(self.coefficients.shape)


def fit(design: Floats, u: Floats, covariance: Floats, observed: Mask) -> AffineFit:
    """Fit commands (n, C) as linear in a design (n, F), n > F.

    Args:
        design: (n, F).
        u: (n, C) commands.
        covariance: (n, C, C) of the commands.
        observed: (n, C) which commands are known, more than F of each.
    """
    count, features = design.shape
    size = np.maximum(np.sqrt(np.mean(design**2, axis=0)), 1e-300)
    known = int(observed.sum())
    x, freedom = design / size, known / max(known - features * u.shape[1], 1)
    own = np.nanmedian(np.where(observed, np.einsum("ncc->nc", covariance), np.nan), axis=0)
    floor = NO_SCATTER * np.maximum(np.ptp(u, axis=0), 1e-12)
    theta = np.linalg.lstsq(*_normal(x, u, _precision(floor**2, covariance)), rcond=None)[0]
    limit = TUKEY + WIDER * (u.shape[1] - 1)
    redescends = False
    for k in range(ROUNDS):
        left = np.where(observed, u - x @ theta.reshape(-1, features).T, 0.0)
        if not redescends:
            scatter = np.maximum(_scatter(left, observed, features), floor)
            precision = _precision(np.maximum(scatter**2 - own, floor**2), covariance)
        distance = np.sqrt(np.sum(left * (precision @ left[..., None])[..., 0], axis=1))
        weight, slope = weights(distance, limit if redescends else None, observed.sum(axis=1))
        before = theta
        theta = np.linalg.lstsq(*_normal(x, u, weight[:, None, None] * precision), rcond=None)[0]
        settled = bool(np.abs(theta - before).max() <= SETTLED * np.abs(theta).max())
        if redescends and settled:
            break
        redescends |= settled or k == ROUNDS // 2
    bend = float(np.mean(slope[observed.any(axis=1)]))
    wide = float(np.sum((weight * distance) ** 2) / max(known, 1)) * freedom
    spread = max(1.0, wide / max(bend, 0.1) ** 2)
    inverse = np.linalg.pinv(_normal(x, u, precision)[0], hermitian=True) * spread
    scale = np.tile(size, u.shape[1])
    coefficients = (theta / scale).reshape(u.shape[1], features)
    return AffineFit(coefficients, inverse / np.outer(scale, scale), weight, scatter)


def _scatter(left: Floats, observed: Mask, features: int) -> Floats:
    """Return the standard deviation (C,) from the median residual.

    Rows that a fit can make zero are left out.
    """
    # unobserved ones are sorted last
    own = np.sort(np.where(observed, np.abs(left), np.inf), axis=0)
    count = observed.sum(axis=0)
    middle = np.minimum(features + np.maximum(count - features, 1) // 2, count - 1)
    return np.asarray(TO_SIGMA * np.take_along_axis(own, middle[None], axis=0)[0])


def _precision(beyond: Floats, covariance: Floats) -> Floats:
    return np.asarray(np.linalg.inv(covariance + np.diag(beyond)), np.float64)


def _normal(x: Floats, u: Floats, precision: Floats) -> tuple[Floats, Floats]:
    """Return the matrix and the right side of least squares for the coefficients, row by row."""
    channels, features = u.shape[1], x.shape[1]
    pairs = (x[:, :, None] * x[:, None]).reshape(len(x), -1)
    matrix = (precision.reshape(len(x), -1).T @ pairs).reshape(
        channels, channels, features, features
    )
    right = (precision @ u[..., None])[..., 0].T @ x
    return matrix.transpose(0, 2, 1, 3).reshape(channels * features, -1), right.reshape(-1)


def weights(
    distance: Floats, limit: float | None, dims: NDArray[np.int64]
) -> tuple[Floats, Floats]:
    """Return weights (n,) of distances in standard deviations, and the mean slope of ψ.

    They are Huber's weights where `limit` is None.
    """
    if limit is None:
        weight = np.minimum(
            1.0, HUBER * np.sqrt(np.maximum(dims, 1)) / np.maximum(distance, 1e-300)
        )
        return weight, weight
    ratio = np.minimum(distance / limit, 1.0) ** 2
    weight = (1.0 - ratio) ** 2
    return weight, weight - 4.0 * ratio * (1.0 - ratio) / np.maximum(dims, 1)
