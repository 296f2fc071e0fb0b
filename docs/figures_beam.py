"""Make the picture of docs/learn/beam.md: a silicone beam, measured and predicted markers.

It is seen from the side.

`python docs/figures_beam.py` writes it into `docs/pictures/`; `--out` names another folder. It
needs the recordings (`make data`) and says so where they are absent.
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
from benches.beam import LOADS_G, NEWTON_PER_G, fitted, read
from benches.data import find_or_say
from softmap_edge import Finger, Run, Simulator
from softmap_edge.geometry.sections import attach
from softmap_edge.report.figures import AFTER, BEFORE, FAINT, INK, STYLE, WIDE, svg


def main(argv: Sequence[str] | None = None) -> int:
    """Fit the beam to its own weight and draw it under each load."""
    parser = argparse.ArgumentParser(description=__doc__)
    pictures = Path(__file__).with_name("pictures")
    parser.add_argument("--out", type=Path, default=pictures, help="folder for the pictures")
    args = parser.parse_args(argv)
    folder = find_or_say("beam")
    if folder is None:
        return 0
    runs = read(folder)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "beam_side.svg").write_bytes(side(fitted(runs).finger, runs))
    print(f"drawn: {len(runs)} recordings")
    return 0


def side(beam: Finger, runs: dict[str, Run]) -> bytes:
    """Draw the beam's middle plane under each load: outline and markers (SVG).

    The outline is predicted, the markers are predicted and seen.
    """
    solid = Simulator(beam)
    rest = solid.template.vertices
    shown = {load: name for name, load in LOADS_G.items()}
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDE, 3.0), layout="constrained")
        for axes, (load, name) in zip(figure.subplots(1, len(shown)), shown.items()):
            shape = solid.path(np.zeros((1, 0)), load=load * NEWTON_PER_G * np.array(beam.gravity))[
                0
            ]
            for height in (rest[:, 0].min(), rest[:, 0].max()):
                line = np.flatnonzero(
                    np.isclose(rest[:, 0], height) & np.isclose(rest[:, 1], rest[:, 1].min())
                )
                line = line[np.argsort(rest[line, 2])]
                axes.plot(rest[line, 2], rest[line, 0], color=FAINT)
                axes.plot(shape[line, 2], shape[line, 0], color=INK, linewidth=1.2)
            places = np.asarray(runs[name].marker_rest)
            predicted = attach(places, rest) @ shape
            seen = np.nanmean(np.asarray(runs[name].markers), axis=0)
            axes.scatter(
                predicted[:, 2], predicted[:, 0], s=26, color=AFTER, label="predicted", zorder=3
            )
            axes.scatter(
                seen[:, 2], seen[:, 0], s=26, color=BEFORE, marker="x", label="seen", zorder=4
            )
            axes.set(
                title="own weight" if not load else f"{load:g} g",
                xlabel="along the beam, mm",
                ylabel="height, mm",
            )
            axes.set(xlim=(-4.0, 112.0), ylim=(-52.0, 24.0))
            axes.set_aspect("equal")
        figure.axes[0].legend(frameon=False, loc="lower left")
        return svg(figure)


if __name__ == "__main__":
    raise SystemExit(main())
