"""Draw the figures of `softmap evaluate --html`.

They show shapes over clouds, the error over frames, and over the number of training frames.

Each function returns the bytes of one figure (SVG, or PNG for thousands of triangles); equal data
give equal bytes. Lengths in mm, times in s. Needs matplotlib; imported by `evaluate_page.py` only.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.files.numbers import mm
from softmap_edge.report.figures import AFTER, BEFORE, FAINT, FLOOR, INK, STYLE, WIDE, png, svg
from softmap_edge.report.sheet import LIGHT, view
from softmap_training.evaluate import Row

Floats = NDArray[np.float64]

COLOURS = (AFTER, "#7b5ea7", "#b8860b", INK, "#5c8001")  # colours of models with a residual
BODY = np.array([0.90, 0.92, 0.94])
AWAY = LinearSegmentedColormap.from_list(
    "away", [AFTER, "#8fb9a8", "#e9c46a", "#e76f51", "#6a1b1a"]
)
ACROSS = 4  # panels per row
PANEL, TALL = 2.2, 3.1  # width of a panel, and its largest height, inches
DRAWN = 1500  # points of a cloud in a figure
TOP = 90.0  # percentile of the distances at the end of the colour scale
NAMES: Any = {
    "frameon": False,
    "borderaxespad": 0.2,
    "loc": "lower left",
    "bbox_to_anchor": (0.0, 1.0),
    "ncols": 5,
}
AXIS = {
    "chamfer": "Chamfer", "visible": "Chamfer, visible", "surface": "cloud → surface",
    "whole": "Chamfer, complete body",
    "vertex": "true vertices",
}  # fmt: skip


def colours(rows: Sequence[Row]) -> dict[str, str]:
    """Return a colour for each row, by name: fixed ones without a residual and for the decoder."""
    fixed, left = (
        {"deepsoro": FLOOR, "without residual": BEFORE},
        iter(COLOURS * (1 + len(rows) // len(COLOURS))),
    )
    used: dict[str, str] = {}
    for row in rows:
        colour = fixed.get(row.details["what"])
        used[row.name] = next(left) if colour is None or colour in used.values() else colour
    return used


def shapes_over(panels: Sequence[tuple[str, Row, int]]) -> bytes:
    """Draw predicted surfaces and measured points, coloured by distance (PNG).

    panels: title, row and frame of each panel.
    """
    found = [_apart(row, frame) for _, row, frame in panels]
    scale = Normalize(
        0.0, float(np.percentile(np.concatenate([away for _, away in found]), TOP)) or 1.0
    )
    rows = -(-len(panels) // ACROSS)
    limits = _limits([row.shapes[frame] for _, row, frame in panels])
    (left, right), (low, high) = limits
    tall = min(TALL, PANEL * (high - low) / (right - left)) + 0.45  # inches, with the title
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDE, tall * rows), layout="constrained")
        grid = figure.subplots(rows, ACROSS, squeeze=False)
        for axes in grid.ravel()[len(panels) :]:
            axes.set_axis_off()
        for axes, (name, row, frame), (points, away) in zip(grid.ravel(), panels, found):
            _surface(axes, row.shapes[frame], row.triangles)
            across, up, _ = view()
            order = np.argsort(away)
            seen = points[order]
            axes.scatter(
                seen @ across,
                seen @ up,
                c=away[order],
                s=2.6,
                cmap=AWAY,
                norm=scale,
                linewidths=0,
                zorder=3,
            )
            axes.set(aspect="equal", xlim=limits[0], ylim=limits[1])
            axes.set_axis_off()
            axes.set_title(name, fontsize=8)
        used = grid.ravel()[: len(panels)].tolist()
        bar = figure.colorbar(
            matplotlib.cm.ScalarMappable(scale, AWAY),
            ax=used,
            shrink=0.5,
            aspect=30,
            pad=0.03,
            extend="max",
            label="from the surface, mm",
        )
        bar.outline.set_visible(False)
        return png(figure)


def over_frames(rows: Sequence[Row], errors: Sequence[str], t: Floats) -> bytes:
    """Draw errors of each frame over time, a panel for each error (SVG)."""
    used = colours(rows)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDE, 0.5 + 2.2 * len(errors)), layout="constrained")
        for axes, error in zip(
            figure.subplots(len(errors), 1, sharex=True, squeeze=False)[:, 0], errors
        ):
            for row in rows:
                if error in row.errors:
                    axes.plot(
                        t,
                        row.errors[error].mean(axis=0),
                        color=used[row.name],
                        linewidth=1.1,
                        label=row.name,
                    )
            axes.set(ylabel=f"{AXIS[error]}, mm", ylim=(0, None))
            _tidy(axes)
        axes.set_xlabel("time, s")
        _named(figure.axes[0], rows, used)
        return svg(figure)


def over_samples(curve: Sequence[Row], rows: Sequence[Row], errors: Sequence[str]) -> bytes:
    """Draw errors against the number of a residual's training frames, and without it (SVG).

    Errors are mean ± sd over seeds.
    """
    used = colours(rows)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDE, 3.3), layout="constrained")
        for axes, error in zip(figure.subplots(1, len(errors), squeeze=False)[0], errors):
            for name in dict.fromkeys(row.name for row in curve):
                some = [row for row in curve if row.name == name]
                x = [row.details["frames"] for row in some]
                means = [row.errors[error].mean(axis=1) for row in some]
                y = [mean.mean() for mean in means]
                spread = [mean.std(ddof=1) if len(mean) > 1 else 0.0 for mean in means]
                axes.errorbar(
                    x,
                    y,
                    spread,
                    color=used[name],
                    marker="o",
                    markersize=4,
                    linewidth=1.3,
                    capsize=3,
                )
            for row in rows:
                if (
                    row.details["what"] == "without residual"
                    and row.details["base"] == curve[0].details["base"]
                ):
                    level = float(row.errors[error].mean())
                    axes.axhline(level, color=BEFORE, linewidth=1.1, linestyle=(0, (4, 3)))
                    axes.annotate(
                        f"without residual {mm(level)}",
                        (1.0, level),
                        (0, 3),
                        xycoords=axes.get_yaxis_transform(),
                        textcoords="offset points",
                        size=7.5,
                        color=BEFORE,
                        ha="right",
                    )
            ticks = sorted({row.details["frames"] for row in curve})
            axes.set_xscale("log")
            axes.set_xticks(ticks, [str(n) for n in ticks])
            axes.set_xticks([], minor=True)
            axes.set(xlabel="frames that taught", ylabel=f"{AXIS[error]}, mm")
            axes.margins(y=0.25)
            _tidy(axes)
        _named(
            figure.axes[0],
            [row for row in rows if any(row.name == one.name for one in curve)],
            used,
        )
        return svg(figure)


def _named(axes: Axes, rows: Sequence[Row], used: dict[str, str]) -> None:
    from matplotlib.lines import Line2D

    lines = [Line2D([], [], color=used[row.name], linewidth=1.6, label=row.name) for row in rows]
    axes.legend(handles=lines, **NAMES)


def _tidy(axes: Axes) -> None:
    axes.margins(x=0.02)
    axes.grid(axis="y", color=FAINT, linewidth=0.8)
    axes.set_axisbelow(True)


def _apart(row: Row, frame: int) -> tuple[Floats, Floats]:
    """Return some measured points (M, 3) of a frame, and their distances (M,) mm.

    The distances are from the predicted surface.
    """
    cloud = row.seen[frame]
    cloud = np.ascontiguousarray(cloud[:: max(1, len(cloud) // DRAWN)])
    surface = _core.Surface(
        np.ascontiguousarray(row.shapes[frame]), np.asarray(row.triangles).tolist()
    )
    return cloud, np.asarray(surface.nearest(cloud)[1])


def _limits(shapes: Sequence[Floats]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the common axis limits of all panels."""
    right, up, _ = view()
    every = np.concatenate(shapes)
    places = np.stack([every @ right, every @ up], axis=1)
    low, high = places.min(axis=0), places.max(axis=0)
    margin = 0.06 * (high - low).max()
    return tuple((float(a - margin), float(b + margin)) for a, b in zip(low, high))  # type: ignore[return-value]


def _surface(axes: Axes, shape: Floats, triangles: NDArray[np.int32]) -> None:
    """Draw a surface from the default view, far triangles first; a sheet has two sides."""
    right, up, towards = view()
    corners = shape[np.asarray(triangles, np.int64)]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
    normal *= np.where(normal @ towards < 0, -1.0, 1.0)[:, None]
    light = np.stack([normal @ right, normal @ up, normal @ towards], axis=1) @ (
        LIGHT / np.linalg.norm(LIGHT)
    )
    rgb = BODY * np.clip(0.72 + 0.34 * light, 0.0, 1.1)[:, None]
    order = np.argsort((corners @ towards).mean(axis=1))
    flat = np.stack([corners @ right, corners @ up], axis=2)
    colour = np.clip(rgb, 0.0, 1.0)[order]
    axes.add_collection(
        PolyCollection(list(flat[order]), facecolors=colour, edgecolors=colour, linewidths=0.3)
    )
