"""Measure time and memory of `softmap import` of a million rows.

The log has 17 columns at 1 kHz (time, three commands, three encoders read at 250 Hz, three markers
with dropouts in mm, a label); the command runs in a separate process, whose peak of resident memory
is read from the system. Run `python -m benches.import_rows`.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

MAPPING = """schema = "softmap.mapping/1"
robot = "long"
[[log]]
block = "part"
time = { column = "t" }
command = { columns = ["u0", "u1", "u2"] }
present = { columns = ["q0", "q1", "q2"] }
markers = { columns = [["x0", "y0", "z0"], ["x1", "y1", "z1"], ["x2", "y2", "z2"]] }
"""
NAMES = [
    "t",
    "u0",
    "u1",
    "u2",
    "q0",
    "q1",
    "q2",
    *(f"{axis}{k}" for k in range(3) for axis in "xyz"),
    "part",
]


def write_log(folder: Path, rows: int) -> None:
    """Write log.csv and map.toml; 1 % of the frames lack a marker."""
    rng = np.random.default_rng(0)
    with (folder / "log.csv").open("w") as file:
        file.write(",".join(NAMES) + "\n")
        for start in range(0, rows, 50_000):
            k = np.arange(start, min(start + 50_000, rows))
            t = k / 1000.0
            u = 8.0 * np.sin(t[:, None] * [0.5, 0.7, 0.9])
            q = 8.0 * np.sin((k // 4 * 4 / 1000.0)[:, None] * [0.5, 0.7, 0.9] - 0.01)
            points = (
                np.repeat([0.0, 0.0, 40.0, 0.0, 0.0, 80.0, 0.0, 0.0, 120.0], len(k))
                .reshape(9, -1)
                .T
            )
            points = (
                points + u @ rng.normal(size=(3, 9)) + rng.normal(scale=0.05, size=points.shape)
            )
            lines = np.char.mod("%.6f", np.column_stack([t, u, q, points])).tolist()
            for row in np.flatnonzero(rng.random(len(k)) < 0.01):
                lines[row][7:10] = ["", "", ""]
            part = [f"part {row // 10_000}" for row in k]
            file.writelines(",".join(line) + f",{label}\n" for line, label in zip(lines, part))
    (folder / "map.toml").write_text(MAPPING)


def measure(folder: Path) -> tuple[float, float, float, int]:
    """Import the log in a new process; return seconds, peak memory in MB, and rows.

    Seconds are wall-clock time and processor time.
    """
    argv = [
        "import",
        str(folder / "log.csv"),
        "--map",
        str(folder / "map.toml"),
        "--out",
        str(folder / "run.npz"),
        "--json",
    ]
    code = (
        f"from softmap_edge.cli import main; main({argv!r}); "
        "print(open('/proc/self/status').read())"
    )
    start, before = time.perf_counter(), os.times()
    said = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    ).stdout
    seconds, after = time.perf_counter() - start, os.times()
    work = (
        after.children_user + after.children_system - before.children_user - before.children_system
    )
    # of this process alone, unlike ru_maxrss
    peak = int(re.findall(r"^VmHWM:\s+(\d+) kB", said, re.MULTILINE)[0])
    return seconds, work, peak / 1024.0, int(json.loads(said.splitlines()[0])["rows"])


def main() -> int:
    """Print seconds and memory for some lengths."""
    parser = argparse.ArgumentParser(prog="benches.import_rows", description=__doc__)
    parser.add_argument("rows", nargs="*", type=int, default=[15_000, 100_000, 1_000_000])
    for rows in parser.parse_args().rows:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            write_log(folder, rows)
            size = (folder / "log.csv").stat().st_size / 2**20
            seconds, work, megabytes, _ = measure(folder)
            print(
                f"{rows:>9} rows, {size:6.1f} MB: {seconds:6.2f} s ({work:.2f} s of work), "
                f"{megabytes:6.0f} MB (goal ≤ 30 s, ≤ 1024 MB)",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
