"""Regressors to compare with the networks: commands (n, C) mm to points (n, 3N) mm.

xgboost    gradient-boosted trees to the weights of the leading modes of the training shapes (Chen &
           Guestrin 2016)
gp         a Gaussian process on each mode: squared-exponential kernel, a length for each command,
           one noise; lengths
           and noise by the marginal likelihood of all modes (Rasmussen & Williams 2006, ch. 2 and
           5)
table      ours: radial basis functions with a linear tail on the modes, kernel and smoothing by
           leaving out
deepsoro   in the manner of DeepSoRo (Wang et al. 2020): a code of the command folds a grid of
           points, twice, onto the
           body; taught by the Chamfer distance, so its points are no vertices, and are compared as
           they come

The paper gives only their names; all other choices are in `choices.py`. Pinned by
tests/training/test_baselines.py.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from softmap_edge.sweep.scattered import fit_scattered, half_range
from softmap_training import choices
from softmap_training.errors import TrainingError

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Name = Literal["xgboost", "gp", "table", "deepsoro"]
NAMES: tuple[Name, ...] = get_args(Name)


@dataclass(frozen=True, eq=False)
class Fitted:
    """A regressor.

    `predict` returns points (n, 3N) mm at commands (n, C) mm; `numbers` is the count of learned
    parameters. If its points are not vertices, it has `triangles` (F, 3) and the ONNX file `onnx`.
    """

    predict: Callable[[Floats], Floats]
    seconds: float
    numbers: int
    triangles: NDArray[np.int32] | None = None
    onnx: bytes | None = None


def fit_baseline(
    name: Name,
    commands: Floats,
    points: Floats,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
    epochs: int | None = None,
    folder: Path | None = None,
) -> Fitted:
    """Fit a regressor to the training part of a set: commands (S, C) mm, points (S, 3N) mm.

    `epochs` and the `folder` of checkpoints apply to networks only.

    Raises:
        TrainingError: an unknown regressor, or a missing dependency.
    """
    if name not in NAMES:
        raise TrainingError(f"no baseline '{name}'; there are {', '.join(NAMES)}")
    ahead = time.perf_counter()
    if name == "deepsoro":
        from softmap_training.deepsoro import fit_deepsoro

        bodies = list(points.reshape(len(points), -1, 3))
        return fit_deepsoro(commands, bodies, len(bodies[0]), seed, None, epochs, folder, progress)
    mean, modes, weights = reduced(points)
    fits = {"xgboost": _xgboost, "gp": _gp, "table": _table}
    regress, numbers = fits[name](commands, weights, seed)

    def predict(u: Floats) -> Floats:
        return mean + regress(u) @ modes

    return Fitted(predict, time.perf_counter() - ahead, numbers)


Regressor = tuple[Callable[[Floats], Floats], int]


def reduced(points: Floats) -> tuple[Floats, Floats, Floats]:
    """Return mean (3N,), leading modes (m, 3N) and weights (S, m) of points (S, 3N)."""
    mean = points.mean(axis=0)
    left, size, modes = np.linalg.svd(points - mean, full_matrices=False)
    keep = choices.PRIOR_MODES
    return mean, modes[:keep], left[:, :keep] * size[:keep]


def _table(commands: Floats, weights: Floats, seed: int) -> Regressor:
    fit = fit_scattered(commands, weights)
    count = weights.shape[1]
    shape = fit.of_modes(np.zeros(count), np.eye(count)).compiled()
    return lambda u: np.asarray(shape.evaluate(np.ascontiguousarray(u))), fit.coefficients.size


def _xgboost(commands: Floats, weights: Floats, seed: int) -> Regressor:
    try:
        import xgboost
    except ImportError:
        raise TrainingError(
            "xgboost is not installed: pip install 'softmap-training[baselines]'"
        ) from None
    trees = xgboost.XGBRegressor(random_state=seed, n_jobs=1, **choices.XGBOOST)
    trees.fit(commands, weights)
    nodes = sum(tree.count("\n") for tree in trees.get_booster().get_dump())
    return lambda u: np.asarray(trees.predict(u), np.float64), nodes


def _gp(commands: Floats, weights: Floats, seed: int) -> Regressor:
    from scipy.linalg import cho_solve
    from scipy.optimize import minimize

    middle, half = commands.mean(axis=0), half_range(commands)
    q, scale = (commands - middle) / half, weights.std(axis=0)
    # the first modes are signal; the last are round-off without a length scale
    y = weights / scale
    leading = y[:, : choices.GP_MODES]
    some = np.random.default_rng(seed).permutation(len(q))[: choices.GP_SOME]

    def kernel(a: Floats, b: Floats, lengths: Floats) -> Floats:
        apart = (a[:, None] / lengths - b[None] / lengths) ** 2
        return np.asarray(np.exp(-0.5 * apart.sum(axis=2)))

    def cost(logs: Floats) -> float:
        k = kernel(q[some], q[some], np.exp(logs[:-1])) + (np.exp(logs[-1]) ** 2 + 1e-9) * np.eye(
            len(some)
        )
        try:
            lower = np.linalg.cholesky(k)
        except np.linalg.LinAlgError:
            return 1e12
        fit = np.sum(leading[some] * cho_solve((lower, True), leading[some]))
        return float(0.5 * fit + leading.shape[1] * np.log(np.diag(lower)).sum())

    start = np.array([*[np.log(0.5)] * q.shape[1], np.log(1e-2)])
    bounds = [*[(np.log(0.02), np.log(20.0))] * q.shape[1], (np.log(1e-4), np.log(1.0))]
    logs = minimize(
        cost, start, method="L-BFGS-B", bounds=bounds, options={"maxiter": choices.GP_STEPS}
    ).x
    lengths = np.exp(logs[:-1])
    lower = np.linalg.cholesky(
        kernel(q, q, lengths) + (np.exp(logs[-1]) ** 2 + 1e-9) * np.eye(len(q))
    )
    alpha = cho_solve((lower, True), y) * scale
    return lambda u: kernel((u - middle) / half, q, lengths) @ alpha, alpha.size
