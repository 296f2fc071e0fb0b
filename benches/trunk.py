"""Print every number of docs/learn/own_log.md.

It compares the rod on the trunk robot with general regressors.

Blocked cross-validation RMS over three markers and at the tip (mm), on the unloaded run of the
trunk logs. Every model gets commands after the drive's delay and lag identified with the rod;
encoders are un-held. The regressors get the nine marker coordinates as targets and inputs of unit
variance: same frames, blocks and inputs for all. The effect of the load is in `trunk_load.py`. Run
`python -m benches.trunk` (some minutes); `make data` downloads the logs.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.linear_model import Ridge
from sklearn.multioutput import MultiOutputRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from benches.data import find_or_say
from benches.trunk_load import FREE, read, report
from softmap_edge.rod.learn import LearnedRod, learn
from softmap_edge.rod.regression import Drive, Record
from softmap_edge.run.folds import Folds, folds
from softmap_edge.run.run import Run, Source

Floats = NDArray[np.float64]
BLOCKS, GAP_S = 5, 2.0
GP_TUNING_FRAMES = 500  # length scales are fitted on these, then all training frames are used
SEED = 1
INPUTS: tuple[tuple[Source, str], ...] = (("goal", "delayed commands"), ("present", "encoders"))


class Process:
    """A Gaussian process; without a `kernel`, one length scale per input for all outputs."""

    def __init__(self, kernel: Any = None) -> None:
        self.kernel = kernel

    def fit(self, x: Floats, y: Floats) -> Process:
        some = np.random.default_rng(SEED).permutation(len(x))[:GP_TUNING_FRAMES]
        shape = self.kernel or RBF(np.full(x.shape[1], 3.0), (0.1, 100.0))
        kernel = ConstantKernel(10.0, (1e-2, 1e4)) * shape + WhiteKernel(1e-2, (1e-5, 1.0))
        tuned = GaussianProcessRegressor(kernel, normalize_y=True).fit(x[some], y[some]).kernel_
        self.process = GaussianProcessRegressor(tuned, normalize_y=True, optimizer=None).fit(x, y)
        return self

    def predict(self, x: Floats) -> Floats:
        return np.asarray(self.process.predict(x))


PEERS: dict[str, Callable[[], Any]] = {
    "ridge, linear": lambda: Ridge(1.0),
    "ridge, quadratic": lambda: make_pipeline(PolynomialFeatures(2), Ridge(10.0)),
    "ridge, cubic": lambda: make_pipeline(PolynomialFeatures(3), Ridge(10.0)),
    "gradient boosting": lambda: MultiOutputRegressor(
        HistGradientBoostingRegressor(random_state=SEED)
    ),
    "Gaussian process": Process,
}


def main() -> int:
    """Print the table; with `--json` one document."""
    parser = argparse.ArgumentParser(prog="benches.trunk", description=__doc__)
    parser.add_argument("--data", type=Path, help="folder of the trunk logs (default data/trunk)")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    folder = args.data or find_or_say("trunk")
    if folder is None:
        return 0
    run = read(folder, FREE)
    if args.json:
        rows = list(table(run))
        print(
            json.dumps(
                {"schema": "softmap.trunk_bench/1", "blocks": BLOCKS, "gap_s": GAP_S, "rows": rows}
            )
        )
        return 0
    print_table(run)
    print()
    for text in report(folder):
        print(text, flush=True)
    return 0


def print_table(run: Run) -> None:
    """Print the cross-validation errors of the rod and its peers, line by line."""
    print(f"{'model':<20} {'input':<17} {'3 markers mm':>12} {'tip mm':>8} {'seconds':>8}")
    for line in table(run):
        errors = f"{line['rms_mm']:12.2f} {line['tip_mm']:8.2f} {line['seconds']:8.1f}"
        print(f"{line['model']:<20} {line['input']:<17} {errors}", flush=True)


def table(run: Run) -> Iterator[dict[str, float | str]]:
    """Yield cross-validation errors of the rod and of its peers, on commands and encoders."""
    for source, name in INPUTS:
        start = time.perf_counter()
        rod = learn(run, source, BLOCKS, GAP_S)
        yield row("rod", name, rod.residuals, time.perf_counter() - start)
        (frames,) = rod.frames
        parts = folds(run.t_seen[frames], BLOCKS, GAP_S)
        x, y = inputs(run, rod), np.asarray(run.markers)[frames]
        for peer, make in PEERS.items():
            start = time.perf_counter()
            residuals = cross_validate(make, x, y, parts)
            yield row(peer, name, residuals, time.perf_counter() - start)


def inputs(run: Run, rod: LearnedRod) -> Floats:
    """Return the effective commands of the rod at its frames (n, C), after the learned effects."""
    (frames,) = rod.frames
    drive = Drive(Record(run.commands(rod.input), run.t, run.t_seen[frames]))
    return drive.acting(rod.chain_names, rod.chain_params)


def cross_validate(make: Callable[[], Any], x: Floats, y: Floats, parts: Folds) -> Floats:
    """Return predicted − seen (n, K, 3) mm, each block predicted from frames beyond its gaps."""
    residuals = np.empty_like(y)
    for train, test in parts:
        scaler = StandardScaler().fit(x[train])
        model = make().fit(scaler.transform(x[train]), y[train].reshape(len(train), -1))
        residuals[test] = (
            model.predict(scaler.transform(x[test])).reshape(len(test), -1, 3) - y[test]
        )
    return residuals


def row(model: str, source: str, residuals: Floats, seconds: float) -> dict[str, float | str]:
    """Return one line of the table."""
    square = (residuals**2).sum(axis=2)
    errors = {
        "rms_mm": float(np.sqrt(square.mean())),
        "tip_mm": float(np.sqrt(square[:, -1].mean())),
    }
    return {"model": model, "input": source, **errors, "seconds": seconds}


if __name__ == "__main__":
    raise SystemExit(main())
