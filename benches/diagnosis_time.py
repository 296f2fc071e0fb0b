"""Measure the cost of a diagnosis over the complete library on one core, in a fresh process.

The rows are processor time and peak memory.

`python -m benches.diagnosis_time [--profile]` prints the rows of `make bench`, with `--profile` a
profile. The fingers are solved frame by frame (benches do not diagnose their own model), once for
each: minutes. The trunk's log is the real one if available, else a synthetic one of the same
length: three segments of constant curvature, 15 000 rows at 100 Hz, six channels, three markers at
a fifth of the rate, and a bending load.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from softmap_edge import Model, Run, learn_model
from softmap_edge.model.bundle import builtin_model, save_bundle

FINGERS: dict[str, tuple[list[str], float]] = {
    "nothing": ([], 0.5),
    "one effect": (["backlash"], 1.0),
    "four effects": (["backlash", "creep", "payload", "gain"], 3.0),
}
LOG_S, LOG_MB = 30.0, 500.0
CHILD = """
import cProfile, json, pstats, resource, sys, time
import softmap_edge.diagnosis.diagnose
from softmap_edge import Run, diagnose, load_bundle
model, run = load_bundle(sys.argv[1]), Run.load(sys.argv[2])
profile, start = cProfile.Profile(), time.process_time()
if sys.argv[3] == "profile":
    profile.enable()
found = diagnose(model, run)
taken = time.process_time() - start
profile.disable()
if sys.argv[3] == "profile":
    pstats.Stats(profile, stream=sys.stderr).sort_stats("tottime").print_stats(25)
print(json.dumps({
    "seconds": taken, "megabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    "verdict": found.verdict, "named": [e.name for e in [*found.effects, *found.faults]],
    "candidates": len(found.made_from["candidates"]), "frames": run.frames, "rows": len(run.t),
}))
"""


def rows(profile: bool = False) -> Iterator[dict[str, object]]:
    """Yield one row of the benchmark for each diagnosis."""
    from softmap_edge.run.protocol import standard_protocol
    from softmap_edge.synthetic.finger import hide

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        save_bundle(builtin_model(), folder / "finger")
        for what, (hidden, wanted) in FINGERS.items():
            hide(hidden, 1).measure(standard_protocol()).save(folder / "run.npz")
            found = alone(folder / "finger", folder / "run.npz", profile)
            yield row(f"diagnosis of {what}, {found['frames']} frames", found, f"goal ≤ {wanted:g}")
        model, run, source = log()
        save_bundle(model, folder / "trunk")
        run.save(folder / "log.npz")
        found = alone(folder / "trunk", folder / "log.npz", profile)
        yield row(
            f"diagnosis of {found['rows']} rows × 6, {source}",
            found,
            f"goal ≤ {LOG_S:g}, ≤ {LOG_MB:g} MB",
        )


def row(name: str, found: dict[str, object], wanted: str) -> dict[str, object]:
    """Return a row with the result, because a fast wrong answer has no value."""
    named = " + ".join(found["named"]) or found["verdict"]
    name = f"{name}, {found['candidates']} effects, {found['megabytes']:.0f} MB ({named})"
    return {"name": name, "value": found["seconds"], "unit": "s", "wanted": wanted}


def alone(bundle: Path, run: Path, profile: bool) -> dict[str, object]:
    """Diagnose in a separate process, on one core if the system supports it."""
    environment = os.environ | {"RAYON_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    argv = [sys.executable, "-c", CHILD, str(bundle), str(run), "profile" if profile else "plain"]
    done = subprocess.run(
        argv, env=environment, stdout=subprocess.PIPE, text=True, check=True, preexec_fn=_one_core
    )
    return json.loads(done.stdout)


def _one_core() -> None:
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def log() -> tuple[Model, Run, str]:
    """Return a rod learned without a load, a loaded log of 15 000 rows, and their origin."""
    from benches.data import find
    from benches.trunk_load import FREE, LOADED, read, reference

    folder = find("trunk")
    if folder is not None:
        return reference(read(folder, FREE))[0], read(folder, LOADED), "trunk robot with 100 g"
    return learn_model(made(0.0)), made(12.0), "made log with a load"


def made(sag_mm: float) -> Run:
    """Return a log of three segments of constant curvature whose tip sags by up to `sag_mm`."""
    rng = np.random.default_rng(0)
    t = np.arange(15_000) * 0.01
    waves = 2 * np.pi * t[:, None, None] * rng.uniform(0.05, 0.3, (6, 4))
    u = 12.0 * np.sin(waves + rng.uniform(0, 6, (6, 4))).mean(axis=2)
    # rad about y and x, at the end of each segment
    angle = np.cumsum(u.reshape(-1, 3, 2) / 30.0, axis=1)
    before = np.concatenate([np.zeros((len(t), 1, 2)), angle[:, :-1]], axis=1)
    middle = 0.5 * (angle + before)
    step = 100.0 * np.stack(
        [np.sin(middle[..., 0]), np.sin(middle[..., 1]), np.ones(middle.shape[:2])], axis=-1
    )
    step *= 100.0 / np.linalg.norm(step, axis=-1, keepdims=True)
    places = np.cumsum(step, axis=1) - sag_mm * (np.arange(1, 4)[:, None] / 3) ** 2 * [
        1.0,
        0.0,
        0.0,
    ]
    markers = places[::5] + 0.3 * rng.normal(size=(3000, 3, 3))
    return Run(
        t=t,
        command=u,
        t_seen=t[::5],
        markers=markers,
        gravity=np.array([0.0, 0.0, 1.0]),
        robot="made trunk",
    )


if __name__ == "__main__":
    for one in rows("--profile" in sys.argv):
        print(f"{one['name']:<100} {one['value']:8.2f} {one['unit']}  {one['wanted']}", flush=True)
