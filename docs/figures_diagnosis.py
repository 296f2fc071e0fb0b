"""Make the picture of docs/understand/diagnosis.md: the steps from a run to a verdict.

`python docs/figures_diagnosis.py` writes diagnosis.svg into `docs/pictures/`; `--out` names another
folder.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from softmap_edge.report.figures import AFTER, BEFORE, FAINT, INK, STYLE, WIDE, svg

STEPS = (  # title, text, condition that leads on
    (
        "1 · Clean",
        "model − run = error\nleave out faulty frames\nestimate the noise",
        "error above\nthe noise",
    ),
    ("2 · Family", "fit every family\nof effects, compare\nheld-out error", "best family\ncounts"),
    (
        "3 · Law",
        "fit the known laws\nof this family;\nas good as the family?",
        "no further\nfamily",
    ),
    ("4 · Validate", "fit each claim to the\nother blocks, test it on\nwithheld blocks", ""),
)
VERDICTS = (  # where a step ends, and why
    ("nothing above the floor", "no error beyond\nthe noise"),
    ("ambiguous", "several families\nfit equally well"),
    ("ambiguous, partly explained", "law open,\nlaw unknown"),
    ("identified", "one explanation,\nconfirmed"),
)
WIDTH, HEIGHT, GAP = 2.0, 1.5, 0.9


def picture() -> bytes:
    """Draw the steps as boxes from left to right, and the verdict to which each may lead (SVG)."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDE, 3.1), layout="constrained")
        axes = figure.subplots()
        for k, (title, text, question) in enumerate(STEPS):
            left = k * (WIDTH + GAP)
            box = FancyBboxPatch(
                (left, 0.0),
                WIDTH,
                HEIGHT,
                boxstyle="round,pad=0.05",
                facecolor=FAINT,
                edgecolor=INK,
            )
            axes.add_patch(box)
            axes.text(
                left + WIDTH / 2,
                HEIGHT - 0.12,
                title,
                ha="center",
                va="top",
                weight="bold",
                size=10,
            )
            axes.text(left + WIDTH / 2, 0.12, text, ha="center", va="bottom", size=8.5)
            _arrow(axes, (left + WIDTH / 2, -0.08), (left + WIDTH / 2, -0.55))
            colour = AFTER if k == len(STEPS) - 1 else BEFORE
            verdict, why = VERDICTS[k]
            axes.text(left + WIDTH / 2, -0.62, verdict, ha="center", va="top", size=9, color=colour)
            axes.text(left + WIDTH / 2, -0.85, why, ha="center", va="top", size=8)
            if question:
                axes.text(
                    left + WIDTH + GAP / 2,
                    HEIGHT + 0.12,
                    question,
                    ha="center",
                    va="bottom",
                    size=8.5,
                )
                _arrow(
                    axes, (left + WIDTH + 0.08, HEIGHT / 2), (left + WIDTH + GAP - 0.08, HEIGHT / 2)
                )
        third = 2 * (WIDTH + GAP) + 0.3
        second = third - WIDTH - GAP + 0.6
        axes.annotate(
            "next family",
            xy=(second, HEIGHT + 0.06),
            xytext=(third, HEIGHT + 0.75),
            arrowprops={
                "arrowstyle": "->",
                "connectionstyle": "angle,angleA=180,angleB=90",
                "color": INK,
            },
            size=8.5,
            ha="left",
            va="center",
        )
        axes.set(xlim=(-0.1, len(STEPS) * (WIDTH + GAP) - GAP + 0.1), ylim=(-1.3, HEIGHT + 0.95))
        axes.set_axis_off()
        return svg(figure)


def _arrow(
    axes: matplotlib.axes.Axes, start: tuple[float, float], end: tuple[float, float]
) -> None:
    axes.annotate("", xy=end, xytext=start, arrowprops={"arrowstyle": "->", "color": INK})


def main(argv: Sequence[str] | None = None) -> int:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    pictures = Path(__file__).with_name("pictures")
    parser.add_argument("--out", type=Path, default=pictures, help="folder for the picture")
    args = parser.parse_args(argv)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "diagnosis.svg").write_bytes(picture())
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
