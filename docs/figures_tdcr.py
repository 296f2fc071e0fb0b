"""Make the pictures of docs/learn/tdcr.md.

The tip of a nine-tendon robot on moves that its rods were not fitted to.

`python docs/figures_tdcr.py` writes them into `docs/pictures/`; `--out` names another folder. It
needs the logs (`make data`) and says so where they are absent.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))  # benches/ is next to docs/
from benches.data import find_or_say
from benches.tdcr import read, rods
from softmap_edge import Run
from softmap_edge.report.figures import AFTER, BEFORE, FAINT, INK, STYLE, WIDE, svg
from softmap_edge.rod.regression import rms

Floats = NDArray[np.float64]
LAWS = {"elastic rod, two-sided": ("two-sided", BEFORE), "elastic rod, cables": ("cables", AFTER)}
# one of each kind
MOVES = ("rep1_all3_same_dir300", "rep1_all3_scurve_dir60", "rep1_all3_spiral_dir300")


def main(argv: Sequence[str] | None = None) -> int:
    """Fit both rods and draw what they predict of the unseen run."""
    parser = argparse.ArgumentParser(description=__doc__)
    pictures = Path(__file__).with_name("pictures")
    parser.add_argument("--out", type=Path, default=pictures, help="folder for the pictures")
    args = parser.parse_args(argv)
    folder = find_or_say("tdcr")
    if folder is None:
        return 0
    train, unseen = read(folder)
    predicted = {
        str(row["model"]): model.predict(unseen)[:, 0]
        for row, _, model in rods(train, unseen, tuple(LAWS))
    }
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "tdcr_paths.svg").write_bytes(paths(unseen, predicted))
    (args.out / "tdcr_moves.svg").write_bytes(moves(unseen, predicted))
    for name, points in predicted.items():
        print(f"{name}: {rms((points - tip(unseen))[:, None]):.2f} mm on unseen moves")
    return 0


def tip(run: Run) -> Floats:
    """Return the tip (K, 3) mm as it was seen."""
    return np.asarray(run.seen_points)[:, -1]


def paths(run: Run, predicted: Mapping[str, Floats]) -> bytes:
    """Draw three moves from above and from the side (SVG).

    Measured, and as each law of the tendons predicts them.
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDE, 6.2), layout="constrained")
        panels = figure.subplots(2, len(MOVES))
        for column, move in zip(panels.T, MOVES):
            frames = np.asarray(run.block) == move
            for axes, (first, second) in zip(column, ((0, 1), (0, 2))):
                seen = tip(run)[frames]
                axes.plot(
                    seen[:, first],
                    seen[:, second],
                    color=INK,
                    linewidth=1.0,
                    marker=".",
                    label="measured",
                )
                for name, points in predicted.items():
                    law, colour = LAWS[name]
                    axes.plot(
                        points[frames][:, first],
                        points[frames][:, second],
                        color=colour,
                        linewidth=1.4,
                        label=law,
                    )
                axes.set(xlabel=f"{'xyz'[first]}, mm", ylabel=f"{'xyz'[second]}, mm")
                axes.set_aspect("equal", adjustable="datalim")
                axes.grid(color=FAINT, linewidth=0.8)
            column[0].set_title(shown(move))
        panels[0, 0].legend(frameon=False)
        return svg(figure)


def moves(run: Run, predicted: Mapping[str, Floats]) -> bytes:
    """Draw the error of each unseen move by law of the tendons (SVG)."""
    labels = [str(label) for label in np.asarray(run.block)]
    names = [name for name in dict.fromkeys(labels) if not name.endswith("_hold")]
    place = np.arange(len(names))
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDE, 3.2), layout="constrained")
        axes = figure.add_subplot()
        for side, (name, points) in zip((-0.2, 0.2), predicted.items()):
            law, colour = LAWS[name]
            off = points - tip(run)
            errors = [
                rms(off[np.array([label == move for label in labels])][:, None]) for move in names
            ]
            axes.bar(
                place + side,
                errors,
                0.4,
                color=colour,
                label=f"{law}: {rms(off[:, None]):.1f} mm in all",
            )
        axes.set_xticks(place, [shown(name) for name in names], rotation=45, ha="right")
        axes.set_ylabel("tip error, mm RMS")
        axes.grid(axis="y", color=FAINT, linewidth=0.8)
        axes.set_axisbelow(True)
        axes.legend(frameon=False, ncols=2)
        return svg(figure)


def shown(label: str) -> str:
    """Return a label of the log as it is written in a picture."""
    return label.removeprefix("rep1_all3_").replace("_", " ")


if __name__ == "__main__":
    raise SystemExit(main())
