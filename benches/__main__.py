"""Print the speed of the core and of plain NumPy/SciPy, and the waiting times of a user.

Both compute the same results.

Ratios are medians of alternating runs in this one process; machine and versions are printed first.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import scipy

from benches import diagnosis_time, geometry, inverse, level, loop, network, teleop
from benches.peer_elastic import markers as peer_markers
from benches.peer_newton import NumpySolid
from benches.peer_rollout import EFFECTS, backlash_and_creep, numbers
from benches.row import ratio, side_by_side
from softmap_edge import _core
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Simulator
from softmap_edge.model.bundle import builtin_model
from softmap_edge.rod.robot import Robot
from softmap_edge.run.run import Run
from softmap_edge.version import __version__


def main() -> int:
    """Run every benchmark; with `--json` print one document."""
    parser = argparse.ArgumentParser(prog="benches", description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument(
        "--quick",
        action="store_true",
        help=(
            "leave out what takes minutes: the 41×41 sweep, full diagnoses, 1000 frames, the "
            "trunk robot's table"
        ),
    )
    args = parser.parse_args()
    rows = [
        newton_step(),
        rollouts(),
        elastic_rod(),
        equilibrium(),
        imports(),
        table_against_simulator(),
    ]
    rows += [elastic_fit(), *geometry.rows(args.quick), *loop.rows(args.quick)]
    rows += [*network.rows(), *inverse.rows(), *level.rows(), *teleop.rows()]
    if not args.quick:
        rows += [full_sweep(), million_rows(), *diagnosis_time.rows()]
    document = {"schema": "softmap.bench/1", "machine": machine(), "rows": rows}
    if args.json:
        print(json.dumps(document))
        return 0
    print("  ".join(f"{key} {value}" for key, value in document["machine"].items()))
    for row in rows:
        peer = (
            f"{row['peer']:10.4g} {row['unit']:<3} {row['peer_name']}, ratio {row['ratio']:.1f}"
            if "peer" in row
            else ""
        )
        print(f"{row['name']:<58} {row['value']:10.4g} {row['unit']:<3} {peer:<44} {row['wanted']}")
    if not args.quick:
        trunk()
    return 0


def trunk() -> None:
    """Print the errors of the rod and general regressors on a real robot, if its logs exist."""
    from benches.data import find
    from benches.trunk import print_table
    from benches.trunk_load import FREE, read

    folder = find("trunk")
    if folder is None:
        print("trunk robot: not run: no data; `make data` brings the logs")
        return
    print(
        "\ntrunk robot, unloaded, five blocks 2 s apart (`python -m benches.trunk` goes on with "
        "the load)",
        flush=True,
    )
    print_table(read(folder, FREE))


def machine() -> dict[str, str]:
    """Print processor, cores and versions."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return {
        "cpu": names[0] if names else platform.processor(),
        "cores": str(os.cpu_count()),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "softmap-edge": __version__,
    }


def newton_step() -> dict[str, object]:
    """One assembly and one solve of the 1204-node finger, without its cables in both."""
    finger = Finger.builtin()
    solid, mesh = Simulator(finger).solid, finger.solid.cells([95.0])
    nodes = mesh.nodes
    peer = NumpySolid(nodes, mesh.cells, finger.young_mpa, finger.poisson, mesh.fixed)
    bent = nodes + 0.02 * np.sin(nodes / 7.0) * (nodes[:, 2:] / nodes[:, 2].max())
    ours_s, peer_s = side_by_side(lambda: solid.newton_step(bent), lambda: peer.newton_step(bent))
    return ratio("Newton step, 1204 nodes", ours_s, peer_s, "NumPy/SciPy", "goal ≥ 4")


def rollouts() -> dict[str, object]:
    """51 parameter sets of two effects over 2000 steps."""
    rng = np.random.default_rng(0)
    t = np.arange(2000) * 0.02
    u = 8 * np.sin(0.7 * t[:, None] + [0.0, 1.0]) * np.sin(0.1 * t)[:, None]
    chain = _core.Chain(EFFECTS, 2)
    params = np.asarray(chain.start) * rng.uniform(0.9, 1.1, (51, len(chain.start)))
    own = numbers(chain, params)
    ours_s, peer_s = side_by_side(
        lambda: chain.rollout(params, u, t), lambda: backlash_and_creep(*own, u, t)
    )
    return ratio("rollouts of two effects, 51 × 2000 steps", ours_s, peer_s, "NumPy", "goal ≥ 8")


def nine_tendons():
    """The robot of examples/tdcr_robot.toml and 1600 commands that move all its tendons.

    Commands shorten and pay out the tendons.
    """
    robot = Robot.load(Path(__file__).parents[1] / "examples/tdcr_robot.toml")
    t = np.arange(1600) * 0.5
    return robot, t, 6.0 * np.sin((0.1 + 0.037 * np.arange(robot.layout.channels)) * t[:, None])


def elastic_rod() -> dict[str, object]:
    """1600 equilibria of three segments and nine cables."""
    robot, _, u = nine_tendons()
    layout = robot.layout
    rod, places = layout.compiled(robot.start), layout.places()
    ours_s, peer_s = side_by_side(
        lambda: rod.evaluate(u), lambda: peer_markers(robot.start, places, layout.ends, u)
    )
    return ratio(
        "1600 equilibria of an elastic rod, nine cables", ours_s, peer_s, "NumPy", "aim ≥ 4"
    )


def elastic_fit() -> dict[str, object]:
    """The complete `learn` on 1600 frames: 17 parameters, four starts, ten folds, 2 mm of noise."""
    from softmap_edge.rod.learn import learn

    robot, t, u = nine_tendons()
    markers = robot.layout.compiled(robot.start).evaluate(u).reshape(len(u), -1, 3)
    markers += 2.0 * np.random.default_rng(0).normal(size=markers.shape)
    run = Run(t=t, command=u, t_seen=t, markers=markers, block=np.arange(len(t)) // 20)
    start = time.perf_counter()
    learn(run, robot=robot)
    name = "learn an elastic rod, 1600 frames, 17 numbers"
    return {
        "name": name,
        "value": time.perf_counter() - start,
        "unit": "s",
        "wanted": "goal ≤ 30",
    }


def equilibrium() -> dict[str, object]:
    """One equilibrium of a path, 0.8 mm from the previous one."""
    simulator = Simulator(Finger.builtin())
    path = np.stack([np.arange(1, 21) * 0.8, np.zeros(20)], axis=1)
    start = time.perf_counter()
    simulator.path(path)
    return {
        "name": "one equilibrium, 0.8 mm apart",
        "value": (time.perf_counter() - start) / len(path) * 1e3,
        "unit": "ms",
        "wanted": "aim ≤ 40",
    }


def full_sweep() -> dict[str, object]:
    """41 × 41 commands over ±16 mm on all cores."""
    axis = np.linspace(-16, 16, 41)
    start = time.perf_counter()
    Simulator(Finger.builtin()).sweep([axis, axis])
    return {
        "name": "sweep 41 × 41",
        "value": time.perf_counter() - start,
        "unit": "s",
        "wanted": "aim ≤ 45",
    }


def million_rows() -> dict[str, object]:
    """Time `softmap import` of a log of a million rows and 17 columns.

    `python -m benches.import_rows` reports its memory.
    """
    from benches.import_rows import measure, write_log

    with tempfile.TemporaryDirectory() as name:
        write_log(Path(name), 1_000_000)
        seconds, _, megabytes, _ = measure(Path(name))
    name = f"import of 1 000 000 rows, peak {megabytes:.0f} MB"
    return {"name": name, "value": seconds, "unit": "s", "wanted": "aim ≤ 30, ≤ 1024 MB"}


def imports() -> dict[str, object]:
    """`import softmap_edge` in a fresh interpreter, minus the interpreter's start."""

    def started(code: str) -> float:
        best = []
        for _ in range(5):
            start = time.perf_counter()
            subprocess.run([sys.executable, "-c", code], check=True)
            best.append(time.perf_counter() - start)
        return float(np.median(best))

    seconds = started("import softmap_edge") - started("pass")
    return {"name": "import softmap_edge", "value": seconds, "unit": "s", "wanted": "aim ≤ 0.2"}


def table_against_simulator() -> dict[str, object]:
    """Mean vertex error of the built-in table at commands off its grid.

    The reference is the simulator on the same mesh.
    """
    model, rng = builtin_model(), np.random.default_rng(7)
    low, high = model.command_range.T
    commands = rng.uniform(low, high, (40, model.channels))
    truth = Simulator(Finger.builtin()).path(commands)
    error = np.linalg.norm(model.prior.evaluate(commands).reshape(truth.shape) - truth, axis=2)
    return {
        "name": "table against simulator, held-out commands, mean vertex",
        "value": float(error.mean()),
        "unit": "mm",
        "wanted": "aim ≤ 0.1",
    }


if __name__ == "__main__":
    sys.exit(main())
