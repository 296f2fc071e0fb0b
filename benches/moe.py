"""Print the table of docs/do/mesh.md: a published mesh as 10-node tetrahedra.

It is compared with its refinement, and with bricks.

Differences are mm RMS over the free vertices of the mesh (its flange never moves and would lower
every figure). `refined` is the same solid with eight times the cells; `bricks` the built-in finger,
which has the same outer dimensions, modulus and routing but no channels. The tip is the mean over
the last tenth of the height. `python -m benches.moe` (two minutes; `--quick` omits the refined
mesh); `make data` downloads the mesh.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benches.data import ROOT, find_or_say
from softmap_edge import Finger, Simulator
from softmap_edge.fem.build import refined
from softmap_edge.fem.simulator import FingerTemplate

Floats = NDArray[np.float64]

REFINED_AT = np.array([[9.0, 0.0], [16.0, 0.0], [8.0, 8.0], [14.0, -14.0], [-5.0, 12.0]])  # mm
BRICKS_AT = np.array([[8.0, 0.0], [16.0, 0.0], [8.0, 8.0]])


def load(folder: Path) -> Finger:
    """Return the example's finger with its files in `folder`."""
    text = (ROOT / "examples/moe.toml").read_text(encoding="utf-8")
    return Finger.from_toml(text.replace("../data/moe_finger", str(folder)))


def free(simulator: Simulator) -> NDArray[np.bool_]:
    """Return a mask of the template's free vertices (N,)."""
    return np.asarray(simulator.template.vertices[:, 2] > 0.1)


def rms(difference: Floats) -> Floats:
    """Return the RMS length (K,) of differences (K, N, 3) mm."""
    return np.asarray(np.sqrt((difference**2).sum(axis=2).mean(axis=1)))


def beside_refined(finger: Finger, simulator: Simulator) -> Floats:
    """Return the difference (5,) mm RMS to the refined mesh at REFINED_AT."""
    return rms(refined(finger, simulator, REFINED_AT)[:, free(simulator)])


def beside_bricks(simulator: Simulator) -> tuple[Floats, Floats, Floats, Floats]:
    """Return difference and motion (3,) mm RMS at BRICKS_AT, then the same of the tip."""
    rest = simulator.template.vertices[free(simulator)]
    template = FingerTemplate(np.ascontiguousarray(rest), simulator.template.triangles[:0])
    one = simulator.path(BRICKS_AT)[:, free(simulator)]
    other = Simulator(Finger.builtin(), template=template).path(BRICKS_AT)
    tip = rest[:, 2] > 0.9 * rest[:, 2].max()
    apart, moved = one - other, one - rest
    length = [np.linalg.norm(d[:, tip].mean(axis=1), axis=1) for d in (apart, moved)]
    return rms(apart), rms(moved), length[0], length[1]


def main(argv: Sequence[str] | None = None) -> int:
    """Print both comparisons."""
    parser = argparse.ArgumentParser(prog="python -m benches.moe", description=main.__doc__)
    parser.add_argument("--quick", action="store_true", help="leave out the refined mesh")
    args = parser.parse_args(argv)
    folder = find_or_say("moe_finger")
    if folder is None:
        return 1
    finger = load(folder)
    simulator = Simulator(finger)
    print(
        f"{int(free(simulator).sum())} of {len(simulator.template.vertices)} vertices are not held"
    )
    for u, apart, moved, tip, way in zip(BRICKS_AT, *beside_bricks(simulator)):
        print(
            f"bricks at {u}: {apart:.2f} of {moved:.1f} mm RMS; the tip {tip:.1f} of {way:.1f} mm "
            f"({tip / way:.0%})"
        )
    if not args.quick:
        error = beside_refined(finger, simulator)
        print(f"refined: {np.sqrt((error**2).mean()):.2f} mm RMS in all")
        for u, one in zip(REFINED_AT, error):
            print(f"refined at {u}: {one:.2f} mm RMS")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
