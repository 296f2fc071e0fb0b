"""Fit general methods to the same run and model as our diagnosis, for the same held-out runs.

Each learns the error of the model on the run (seen − predicted) from the commands, at once or at
several earlier times, and is validated in the same way. None uses a measured output of a held-out
run, so every figure is a simulation error. Settings are library defaults unless named below; draws
use `SEED`; everything runs on one thread.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping

import numpy as np
import pysindy
import torch
from numpy.typing import NDArray
from sklearn.decomposition import PCA
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.preprocessing import StandardScaler

from benches.outside.case import Case, error, predicted, targets
from softmap_edge import Model, Run

Floats = NDArray[np.float64]

SEED = 1
# frames for training a Gaussian process, and for tuning its kernel
PROCESS_FRAMES, TUNED_ON = 800, 300
HIDDEN, STEPS, RATE = 32, 400, 1e-2  # width of the network: two layers, full batches
STATES = 3  # components of the residual that SINDy integrates
SPARSE, RIDGE = 1e-3, 1e-2  # threshold and ridge of SINDy, on scaled features
FARTHEST = 10.0  # times the largest measured residual: beyond, SINDy has diverged

Predict = Callable[[Floats], Floats]


def peers(case: Case, model: Model) -> dict[str, dict[str, float]]:
    """Return the held-out errors of each peer by its name, and by the name of the held-out run."""
    train = targets(case, case.fit) - predicted(case, model, case.fit)
    ways: Mapping[str, Callable[[], Mapping[str, Floats]]] = {
        "trees": lambda: _lagged(case, train, _trees),
        "process": lambda: _lagged(case, train, _process),
        "network": lambda: _static(case, train),
        "sindy": lambda: _sindy(case, train),
    }
    found: dict[str, dict[str, float]] = {}
    for name, way in ways.items():
        residual = way()
        found[name] = {
            which: error(case, run, predicted(case, model, run) + residual[which])
            for which, run in case.held.items()
        }
    return found


def late(case: Case, run: Run, lags: tuple[int, ...]) -> Floats:
    """Return the commands of a run at its frames and `lags` frames earlier, (K, C · lags)."""
    step = float(np.median(np.diff(case.fit.t_seen)))
    return np.hstack([run.command_at(run.t_seen - lag * step) for lag in lags])


def _lagged(
    case: Case, train: Floats, make: Callable[[Floats, Floats], Predict]
) -> dict[str, Floats]:
    scaler = StandardScaler().fit(late(case, case.fit, case.lags))
    predict = make(scaler.transform(late(case, case.fit, case.lags)), train)
    return {
        name: predict(scaler.transform(late(case, run, case.lags)))
        for name, run in case.held.items()
    }


def _trees(x: Floats, y: Floats) -> Predict:
    """Gradient-boosted trees, one for each principal component of the residual."""
    parts = _components(y)
    scores = parts.transform(y)
    models = [
        HistGradientBoostingRegressor(random_state=SEED).fit(x, column) for column in scores.T
    ]
    return lambda at: np.asarray(
        parts.inverse_transform(np.column_stack([m.predict(at) for m in models]))
    )


def _process(x: Floats, y: Floats) -> Predict:
    """A Gaussian process of one length scale, on a subset drawn with `SEED`."""
    order = np.random.default_rng(SEED).permutation(len(x))
    kernel = ConstantKernel(1.0, (1e-2, 1e3)) * RBF(3.0, (0.1, 100.0)) + WhiteKernel(
        1e-2, (1e-6, 1.0)
    )
    some, all_ = order[:TUNED_ON], order[:PROCESS_FRAMES]
    with warnings.catch_warnings():
        # a scale at its bound is still the best found
        warnings.simplefilter("ignore", ConvergenceWarning)
        tuned = GaussianProcessRegressor(kernel, normalize_y=True).fit(x[some], y[some]).kernel_
    process = GaussianProcessRegressor(tuned, normalize_y=True, optimizer=None).fit(
        x[all_], y[all_]
    )
    return lambda at: np.asarray(process.predict(at)).reshape(len(at), -1)


def _static(case: Case, train: Floats) -> dict[str, Floats]:
    """A network of the present command: the limit without memory."""
    torch.manual_seed(SEED)
    torch.set_num_threads(1)
    now = (0,)
    scaler, scale = (
        StandardScaler().fit(late(case, case.fit, now)),
        np.maximum(train.std(axis=0), 1e-12),
    )

    def tensor(run: Run) -> torch.Tensor:
        return torch.as_tensor(scaler.transform(late(case, run, now)), dtype=torch.float64)

    x, y = tensor(case.fit), torch.as_tensor(train / scale, dtype=torch.float64)
    layers = [
        torch.nn.Linear(x.shape[1], HIDDEN),
        torch.nn.Tanh(),
        torch.nn.Linear(HIDDEN, HIDDEN),
        torch.nn.Tanh(),
    ]
    net = torch.nn.Sequential(*layers, torch.nn.Linear(HIDDEN, y.shape[1])).double()
    optimiser = torch.optim.Adam(net.parameters(), RATE, weight_decay=1e-5)
    for _ in range(STEPS):
        optimiser.zero_grad()
        torch.mean((net(x) - y) ** 2).backward()
        optimiser.step()
    with torch.no_grad():
        return {name: net(tensor(run)).numpy() * scale for name, run in case.held.items()}


def _sindy(case: Case, train: Floats) -> dict[str, Floats]:
    """A sparse polynomial map to the next residual: of itself, the command, its rate, |rate|.

    The rate and its size are the memory features: a Bouc–Wen force is a polynomial of degree two in
    them. The map is iterated from frame to frame and starts at the mean residual. If it diverges,
    the mean residual is the prediction.
    """
    parts = _components(train)
    states = parts.transform(train)
    size = np.maximum(np.abs(states).max(axis=0), 1e-12)
    step = float(np.median(np.diff(case.fit.t_seen)))
    taught = _memory(case.fit, case.fit.t_seen, step)
    spread = np.maximum(taught.std(axis=0), 1e-12)
    model = pysindy.DiscreteSINDy(
        optimizer=pysindy.STLSQ(threshold=SPARSE, alpha=RIDGE),
        feature_library=pysindy.PolynomialLibrary(degree=2),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # STLSQ warns if it drops every term
        model.fit(states / size, t=1, u=taught / spread)
    powers, weights = model.feature_library.powers_, np.asarray(model.coefficients())

    def rolled(run: Run) -> Floats:
        times = np.arange(run.t[0], run.t_seen[-1] + step, step)
        at, rows = np.zeros(len(size)), np.zeros((len(times), len(size)))
        for k, command in enumerate(_memory(run, times, step) / spread):
            rows[k] = at
            at = weights @ np.prod(np.concatenate([at, command]) ** powers, axis=1)
            if not np.all(np.abs(at) < FARTHEST):
                return np.zeros((run.frames, len(size)))
        return np.stack([np.interp(run.t_seen, times, column) for column in rows.T], axis=1)

    return {
        name: np.asarray(rolled(run) * size @ parts.components_ + parts.mean_)
        for name, run in case.held.items()
    }


def _memory(run: Run, times: Floats, step: float) -> Floats:
    """Return command, rate and size of the rate at times (n,), (n, 3C)."""
    rate = (run.command_at(times + 0.5 * step) - run.command_at(times - 0.5 * step)) / step
    return np.hstack([run.command_at(times), rate, np.abs(rate)])


def _components(y: Floats) -> PCA:
    """Return the leading components of a residual (K, Q), `STATES` at most."""
    return PCA(min(STATES, *y.shape), random_state=SEED).fit(y)
