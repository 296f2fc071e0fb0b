"""Print every number of docs/learn/tdcr.md.

It compares an elastic rod and general regressors on a nine-tendon robot with a tracked tip.

Errors are mm at the tip, RMS. Every model is fitted to `train.csv`; `CV` holds out complete moves
(the labels of the log, dealt to ten folds, without frames within 2 s). `unseen` is `val.csv` with
moves of all three segments at once, which `train.csv` does not have. The regressors get the nine
tendon lengths at unit variance, the tip as target, and the settings of `trunk.py` except for the
Gaussian process. The published simulator is quoted, not run. Times are processor time over all
cores. `python -m benches.tdcr` (some minutes); `make data` downloads the logs.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.gaussian_process.kernels import Matern
from sklearn.preprocessing import StandardScaler

from benches.data import ROOT, find_or_say
from benches.trunk import PEERS as USUAL
from benches.trunk import Process, cross_validate
from softmap_edge import Diagnosis, Model, Robot, Run, compare, diagnose, import_logs, read_mapping
from softmap_edge.rod.learn import LearnedRod, learn, learned_model
from softmap_edge.rod.regression import rms
from softmap_edge.run.folds import folds

Floats = NDArray[np.float64]
Row = dict[str, float | str | None]

# On new moves a Matérn kernel with one length has a smaller error than the default (8 against 9.6
# mm); the better one is used.
PEERS = USUAL | {"Gaussian process": lambda: Process(Matern(3.0, (0.1, 100.0), nu=2.5))}
BLOCKS, GAP_S = 5, 2.0
SIMULATOR_MM = (
    # on val.csv: the calibrated simulator of ContinuumRoboticsLab/opencr-mujoco, the source of the
    # logs
    12.1
)


def read(folder: Path) -> tuple[Run, Run]:
    """Return the training run and the unseen one, by the example's mapping."""
    mapping = read_mapping(ROOT / "examples/tdcr.toml")
    train, unseen = (import_logs([folder / name], mapping).run for name in ("train.csv", "val.csv"))
    return train, unseen


def robots() -> dict[str, Robot]:
    """Return the robot of the file, with cables, and with other tendon laws."""
    cables = Robot.load(ROOT / "examples/tdcr_robot.toml")
    return {
        "elastic rod, two-sided": cables.with_slack(1.0),
        "elastic rod, cables": cables,
        "… with a fitted ratio": replace(cables, modes=cables.modes | {"slack": "fitted"}),
        "… with a pretension": replace(cables, modes=cables.modes | {"pretension": "shared"}),
    }


def error(model: Model, run: Run) -> float:
    """Return the RMS error at the tip, mm."""
    return rms(model.predict(run) - np.asarray(run.markers))


def rods(
    train: Run, unseen: Run, only: Sequence[str] = ()
) -> Iterator[tuple[Row, LearnedRod, Model]]:
    """Yield a table line for each (or some) tendon law, its fit, and its model."""
    for name, robot in robots().items():
        if only and name not in only:
            continue
        start = time.process_time()
        learned = learn(train, robot=robot)
        seconds, model = time.process_time() - start, learned_model(train, learned)
        errors = {
            "train_mm": error(model, train),
            "cv_mm": learned.error_mm,
            "unseen_mm": error(model, unseen),
        }
        yield (
            {"model": name, "numbers": len(learned.numbers), **errors, "seconds": seconds},
            learned,
            model,
        )


def peers(train: Run, unseen: Run) -> Iterator[Row]:
    """Yield a line of the table for each regressor."""
    parts = folds(train.t_seen, BLOCKS, GAP_S, train.block)
    (x, y), (ahead, seen) = (
        (run.commands("goal"), np.asarray(run.markers)) for run in (train, unseen)
    )
    scaler = StandardScaler().fit(x)
    for name, make in PEERS.items():
        start = time.process_time()
        held_out = rms(cross_validate(make, x, y, parts))
        model: Any = make().fit(scaler.transform(x), y.reshape(len(y), -1))
        errors = {
            what: rms(model.predict(scaler.transform(u)).reshape(markers.shape) - markers)
            for what, u, markers in (("train_mm", x, y), ("unseen_mm", ahead, seen))
        }
        seconds = time.process_time() - start
        yield {"model": name, "numbers": None, **errors, "cv_mm": held_out, "seconds": seconds}


def quoted() -> Row:
    """Return the line of the published simulator."""
    unknown = dict.fromkeys(("numbers", "train_mm", "cv_mm", "seconds"))
    return {"model": "published simulator", **unknown, "unseen_mm": SIMULATOR_MM}


def line(row: Row) -> str:
    """Format a row as text."""
    numbers = [
        (row["numbers"], "8.0f"),
        *((row[key], "9.1f") for key in ("train_mm", "cv_mm", "unseen_mm", "seconds")),
    ]
    return f"{row['model']:<26}" + "".join(
        f"{'–':>9}" if value is None else f"{value:9{f[1:]}}" for value, f in numbers
    )


def slack_share(model: Model, run: Run) -> tuple[float, float]:
    """Return the share of paid-out tendons under tension, and of shortened ones that are slack."""
    u = run.commands("goal")
    taut = model.prior.state(np.ascontiguousarray(u))[1] > 0
    return float(taut[u < -0.2].mean()), float((~taut[u > 0.2]).mean())


def story(model: Model, train: Run, unseen: Run) -> Iterator[Diagnosis]:
    """Yield the diagnosis of a model, and then of the model with its result added."""
    for _ in range(2):
        found = diagnose(model, train, unseen)
        yield found
        model = found.model


def main() -> int:
    """Print the table, the cables' numbers and the diagnosis from two-sided tendons.

    `--json`: the table alone.
    """
    parser = argparse.ArgumentParser(prog="benches.tdcr", description=__doc__)
    parser.add_argument("--data", type=Path, help="folder of the logs (default data/tdcr)")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    folder = args.data or find_or_say("tdcr")
    if folder is None:
        return 0
    train, unseen = read(folder)
    found = list(rods(train, unseen))
    if args.json:
        rows = [quoted(), *peers(train, unseen), *(row for row, _, _ in found)]
        print(json.dumps({"schema": "softmap.tdcr_bench/1", "gap_s": GAP_S, "rows": rows}))
        return 0
    print(f"{'model':<26}{'numbers':>9}{'train':>9}{'CV':>9}{'unseen':>9}{'CPU s':>9}")
    print(line(quoted()))
    for row in peers(train, unseen):
        print(line(row), flush=True)
    for row, _, _ in found:
        print(line(row))
    _, learned, model = found[1]
    print(
        f"\n{learned}\npaid out and taut, drawn in and slack: "
        f"{slack_share(model, train)}\n\n{compare(model, unseen)}"
    )
    for diagnosis in story(found[0][2], train, unseen):
        print(f"\n{diagnosis}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
