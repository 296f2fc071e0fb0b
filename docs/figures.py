"""Make the pictures of the pages: a hidden backlash found and added; protocol; mesh.

The backlash is in a second finger.

`python docs/figures.py` writes them into `docs/pictures/`; `--out` names another folder, `--seed`
another finger. The picture of the mesh needs its data (`make data`) and is left as it is without
them.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

sys.path.insert(0, str(Path(__file__).parents[1]))  # benches/ is next to docs/
from benches.data import find
from benches.moe import load
from softmap_edge import builtin_model, diagnose, series
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Simulator
from softmap_edge.report.figures import (
    AFTER,
    BEFORE,
    FAINT,
    INK,
    STYLE,
    WIDE,
    body,
    svg,
)
from softmap_edge.run.protocol import Protocol, other_protocol, standard_protocol
from softmap_edge.synthetic.finger import hide

SEED = 1  # of the second finger; any other gives the same picture with other numbers


def plan(protocol: Protocol) -> bytes:
    """Draw a protocol's commands in its first orientation, its parts shaded and named (SVG)."""
    turned = protocol.t[np.flatnonzero(np.any(protocol.gravity != protocol.gravity[0], axis=1))[0]]
    rows, frames = protocol.t < turned, protocol.t_seen < turned
    t, seen = protocol.t[rows], protocol.t_seen[frames]
    kinds = np.array([label.split("[")[0] for label in protocol.block[frames]])
    starts = np.flatnonzero(np.r_[True, kinds[1:] != kinds[:-1]])
    edges = np.r_[seen[starts], t[-1]]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDE, 3.2), layout="constrained")
        panels = figure.subplots(protocol.command.shape[1], 1, sharex=True, sharey=True)
        for c, (axes, colour) in enumerate(zip(panels, (BEFORE, AFTER))):
            axes.plot(t, protocol.command[rows, c], color=colour, linewidth=1.2)
            at_seen = np.interp(seen, protocol.t, protocol.command[:, c])
            axes.plot(seen, at_seen, ".", color=INK, markersize=2.2)
            for k, (low, high) in enumerate(zip(edges[:-1], edges[1:])):
                axes.axvspan(low, high, color=FAINT, alpha=0.9 if k % 2 else 0.35, linewidth=0)
            axes.set_ylabel(f"channel {c}, mm")
            axes.margins(x=0)
        for low, high, kind in zip(edges[:-1], edges[1:], kinds[starts]):
            name = kind.replace(" ", "\n") if high - low < 12 else kind
            panels[0].annotate(
                name,
                ((low + high) / 2, 1.03),
                xycoords=("data", "axes fraction"),
                ha="center",
                size=7.5,
            )
        panels[-1].set_xlabel("time, s")
        return svg(figure)


def mesh_and_bricks(folder: Path) -> bytes:
    """Draw the mesh finger and the equal built-in finger, bent by 0, 8 and 16 mm (SVG).

    They have the same dimensions.
    """
    commands = np.array([[0.0, 0.0], [8.0, 0.0], [16.0, 0.0]])
    meshed, bricks = Simulator(load(folder)), Simulator(Finger.builtin())
    rest = bricks.template.vertices
    levels = [np.flatnonzero(np.abs(rest[:, 2] - z) < 1e-6) for z in np.unique(rest[:, 2].round(6))]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDE, 3.6), layout="constrained")
        panels = figure.subplots(1, 3, sharex=True, sharey=True)
        for axes, command, points, outline in zip(
            panels, commands, meshed.path(commands), bricks.path(commands)
        ):
            dots = axes.plot(points[:, 0], points[:, 2], ".", color=AFTER, markersize=2.0)[0]
            for side in (np.argmax, np.argmin):
                line = np.array([outline[level[side(rest[level, 0])]] for level in levels])
                edge = axes.plot(line[:, 0], line[:, 2], color=BEFORE, linewidth=1.2)[0]
            axes.set_aspect("equal")
            axes.set_title(f"{command[0]:g} mm of the first pair", size=9.0)
            axes.set_xlabel("x, mm")
        panels[0].set_ylabel("z, mm")
        names = [
            "mesh of 10-node tetrahedra, its surface vertices",
            "bricks of the same dimensions, their outline",
        ]
        figure.legend([dots, edge], names, loc="outside lower center", ncols=2, frameon=False)
        return svg(figure)


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, diagnose, and draw the run of another kind that was never fitted."""
    parser = argparse.ArgumentParser(description=__doc__)
    pictures = Path(__file__).with_name("pictures")
    parser.add_argument("--out", type=Path, default=pictures, help="folder for the pictures")
    parser.add_argument("--seed", type=int, default=SEED, help=f"of the second finger ({SEED})")
    args = parser.parse_args(argv)
    model, truth = builtin_model(), hide(["backlash"], args.seed)
    found = diagnose(model, truth.measure(standard_protocol(model.channels)))
    seen = series(truth.measure(other_protocol(model.channels), seed=1), model, found.model)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "error_on_the_body.png").write_bytes(body(seen))
    (args.out / "protocol.svg").write_bytes(plan(standard_protocol(model.channels)))
    if (folder := find("moe_finger")) is None:
        print("mesh.svg is not drawn again: the mesh is absent (make data brings it)")
    else:
        (args.out / "mesh.svg").write_bytes(mesh_and_bricks(folder))
    print(found.sentence)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
