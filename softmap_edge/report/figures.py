"""The figures of a report: errors over time, body and conditions, the tip's path, ladder.

Each function returns one image as bytes (SVG, or PNG for thousands of triangles); equal data give
equal bytes. The colours of before, after and floor are the same in all figures. Lengths in mm,
times in s. Needs matplotlib; only `html.py` imports it.
"""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.text import Annotation, Text
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from softmap_edge.comparison.series import Series
from softmap_edge.comparison.text import WHERE
from softmap_edge.diagnosis.text import ladder_steps
from softmap_edge.files.atomic import Document, finite
from softmap_edge.files.numbers import mm
from softmap_edge.run.in_unit import PLACES

Floats = NDArray[np.float64]

ABOVE_NOISE = 3.0  # the colours of an error reach at least this multiple of the noise floor
# s of a long run that are drawn, and least number of frames in such a stretch
STRETCH, MANY = 20.0, 10
BEFORE = "#cf5c36"
AFTER = "#1f7a8c"
FLOOR = "#7d8597"
INK = "#1f2933"
FAINT = "#e7eaef"
PALE = "#9aa5b1"
ERROR_MAP = LinearSegmentedColormap.from_list(
    "error", ["#dceef0", "#f6e7c1", "#efa35c", "#cf5c36", "#6a1b1a"]
)
STYLE: Any = {  # matplotlib types the keys one by one
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "text.color": INK,
    "text.parse_math": False,
    "axes.labelcolor": INK,
    "axes.edgecolor": PALE,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "xtick.color": "#52606d",
    "ytick.color": "#52606d",
    "svg.hashsalt": "softmap",
    "svg.fonttype": "path",
}
WIDE = 10.4  # inches: the width of a picture that fills the page
LABEL = 1.5  # inches left of a bar, for its label
DOT, LABEL_AT = 16.0, 13.0  # points: diameter of a marker; from its middle to its label
POINTS = 1200  # lines with more points show the RMS of equal stretches
SIDES = (
    ("seen along −x", (1, 0)),
    ("seen along −y", (0, 1)),
    ("seen along +x", (-1, 0)),
    ("seen along +y", (0, -1)),
)
LIGHT = np.array([-0.35, 0.55, 0.76])  # from the upper left, towards the viewer
SPLIT_BELOW = 8000  # templates with fewer triangles are refined for smooth colours


@dataclass(frozen=True)
class Surface:
    """A template to draw: points (P, 3) mm, faces (F, 3), values and normals.

    Each point has a value and an outward normal.
    """

    points: Floats
    faces: NDArray[np.int64]
    values: Floats  # (P,)
    normals: Floats  # (P, 3)


def over_time(series: Series, unit: str = PLACES) -> bytes:
    """Draw the RMS error (in `unit`) of each frame against time, before and after (SVG)."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDE, 2.9), layout="constrained")
        axes = figure.add_subplot()
        t, before = _thinned(series.t_seen, series.before)
        name = "error" if series.after is None else "before"
        axes.fill_between(t, before, color=BEFORE, alpha=0.13, linewidth=0)
        axes.plot(
            t,
            before,
            color=BEFORE,
            linewidth=1.3,
            label=f"{name}: {mm(rms(series.before))} {unit} rms",
        )
        if series.after is not None:
            t, after = _thinned(series.t_seen, series.after)
            axes.fill_between(t, after, color=AFTER, alpha=0.22, linewidth=0)
            axes.plot(
                t,
                after,
                color=AFTER,
                linewidth=1.3,
                label=f"after: {mm(rms(series.after))} {unit} rms",
            )
        if series.noise_floor_mm is not None:
            whose = "camera" if unit == PLACES else "sensor"
            label = (
                f"{whose} noise: {'at most ' * series.floor_is_bound}{mm(series.noise_floor_mm)} "
                f"{unit}"
            )
            axes.axhline(
                series.noise_floor_mm,
                color=FLOOR,
                linewidth=1.0,
                linestyle=(0, (4, 3)),
                label=label,
            )
        axes.set(xlabel="time, s", ylabel=f"RMS error of a frame, {unit}", ylim=(0, None))
        axes.margins(x=0.005)
        axes.grid(axis="y", color=FAINT, linewidth=0.8)
        axes.set_axisbelow(True)
        axes.legend(
            loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, borderaxespad=0.2
        )
        return svg(figure)


def tip_path(series: Series) -> bytes:
    """Draw the tip's measured and predicted path in the plane in which it moves most (SVG).

    For a long run, draw the STRETCH with the largest error before, over all measured positions.
    """
    first, second = _plane(series.tip_seen)
    rows = worst_stretch(series)
    shown = [("predicted", series.tip_before, BEFORE)]
    if series.tip_after is not None:
        shown = [
            ("predicted before", series.tip_before, BEFORE),
            ("predicted after", series.tip_after, AFTER),
        ]
    with matplotlib.rc_context(STYLE):
        figure = Figure(
            figsize=(WIDE, _tip_height(series.tip_seen[:, [first, second]], len(shown))),
            layout="constrained",
        )
        panels = figure.subplots(1, len(shown), sharex=True, sharey=True, squeeze=False)[0]
        for axes, (name, path, colour) in zip(panels, shown):
            axes.plot(
                series.tip_seen[:, first],
                series.tip_seen[:, second],
                color=FAINT,
                linewidth=0.9,
                zorder=1,
            )
            seen = series.tip_seen[rows]
            axes.plot(seen[:, first], seen[:, second], color=INK, linewidth=0.9, label="measured")
            axes.plot(
                path[rows, first], path[rows, second], color=colour, linewidth=1.3, label=name
            )
            axes.set(xlabel=f"{'xyz'[first]} of the tip, mm", aspect="equal")
            axes.grid(color=FAINT, linewidth=0.8)
            axes.legend(
                loc="lower right",
                bbox_to_anchor=(1.0, 1.0),
                ncols=2,
                frameon=False,
                borderaxespad=0.2,
            )
        panels[0].set_ylabel(f"{'xyz'[second]} of the tip, mm")
        return svg(figure)


def worst_stretch(series: Series) -> slice:
    """Return the frames of the STRETCH of a run with the largest error before.

    A run that is hardly longer is returned completely.
    """
    t = series.t_seen
    if len(t) < 3 or t[-1] - t[0] < 2 * STRETCH:
        return slice(0, len(t))
    ends = np.searchsorted(t, t + STRETCH, side="right")
    squares = np.concatenate([[0.0], np.cumsum(np.nan_to_num(series.before) ** 2)])
    begins = np.flatnonzero(t <= t[-1] - STRETCH)
    mean = (squares[ends] - squares[:-1])[begins] / np.maximum(ends[begins] - begins, MANY)
    start = int(begins[np.argmax(mean)])
    return slice(start, int(ends[start]))


def body(series: Series) -> bytes:
    """Draw the RMS error of each point on the body, before and after, on one colour scale (PNG)."""
    shown = [("error" if series.point_after is None else "before", series.point_before)]
    if series.point_after is not None:
        shown.append(("after", series.point_after))
    top = max(float(np.nanmax(values)) for _, values in shown)
    # errors within the noise are pale
    top = max(top, ABOVE_NOISE * (series.noise_floor_mm or 0.0))
    scale = Normalize(0.0, top if top > 0 else 1.0)
    with matplotlib.rc_context(STYLE):
        if series.triangles is None:
            figure = _marker_figure(series.template, shown, scale)
        else:
            figure = _surface_figure(series.template, series.triangles, shown, scale)
        return png(figure)


def where_maps(
    before: Mapping[str, Sequence[Document]], after: Mapping[str, Sequence[Document]] | None
) -> bytes:
    """Draw the error in every class of every condition, before and after, on one scale (SVG).

    Args:
        before, after: maps name → bins `{label, low, high, n, rms_mm}`; after may be None.

    Returns:
        The picture.
    """
    names = [name for name, rows in before.items() if len(rows) > 1]
    columns = _packed([(name, len(before[name])) for name in names], 3)
    heights = [sum(_panel_height(count) for _, count in column) for column in columns]
    height = max(heights, default=1.0)
    values = [row["rms_mm"] for name in names for row in before[name]]
    values += [row["rms_mm"] for name in names for row in (after or {}).get(name, [])]
    top = max([v for v in values if math.isfinite(v)], default=1.0) or 1.0
    letters = max(map(len, map(mm, values)), default=0) * (1 if after is None else 2) + (
        0 if after is None else 3
    )
    # inches; room for the longest number next to the longest bar
    bars = WIDE / 3 - LABEL - 0.53
    top *= bars / (bars - max(0.0, 0.056 * letters - 0.48))
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDE, height))
        for index, column in enumerate(columns):
            used = 0.0
            for name, count in column:
                tall = _panel_height(count)
                left, wide = (index * WIDE / 3 + LABEL) / WIDE, (WIDE / 3 - LABEL - 0.53) / WIDE
                axes = figure.add_axes(
                    (left, 1 - (used + tall - 0.22) / height, wide, (tall - 0.52) / height)
                )
                _bars(axes, before[name], None if after is None else after.get(name, []), top)
                axes.set_title(
                    WHERE.get(name, name), x=-(LABEL - 0.07) / (WIDE / 3 - LABEL - 0.53), pad=5
                )
                used += tall
        return svg(figure)


def ladder_bars(error: Document) -> bytes:
    """Draw the held-out error as effects are added one by one, down to the floor (SVG)."""
    steps = ladder_steps(error)
    floor = error.get("floor")
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDE, 0.75 + 0.36 * len(steps)), layout="constrained")
        axes = figure.add_subplot()
        for position, (name, value) in enumerate(steps):
            colour = BEFORE
            if position > 0:
                colour = AFTER if name.startswith("+") else PALE
            axes.barh(
                position,
                value,
                color=colour,
                height=0.66,
                alpha=0.55 if "static baseline" in name else 1.0,
            )
            axes.annotate(
                f"{mm(value)}", (value, position), (5, 0), textcoords="offset points", va="center"
            )
        if finite(floor):
            axes.axvline(floor, color=INK, linewidth=1.1, linestyle=(0, (4, 3)))
            axes.annotate(
                f"floor {mm(floor)}",
                (floor, -0.62),
                (4, 0),
                textcoords="offset points",
                size=8,
                color="#52606d",
            )
        axes.set_yticks(range(len(steps)), [clean(name, 46) for name, _ in steps])
        axes.set_ylim(len(steps) - 0.45, -0.95)
        axes.set_xlim(0, 1.1 * max([value for _, value in steps], default=1.0))
        axes.set_xlabel(
            f"{clean(str(error.get('kind', 'held-out rms')), 40)}, "
            f"{clean(str(error.get('unit', 'mm')), 8)}"
        )
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
        return svg(figure)


def _tip_height(path: Floats, panels: int) -> float:
    """Return the height (inches) of a path drawn to scale, within limits that suit a page."""
    wide, tall = np.nanmax(path, axis=0) - np.nanmin(path, axis=0)
    return float(np.clip((WIDE / panels - 0.9) * tall / max(float(wide), 1e-9) + 0.9, 2.6, 6.0))


def _bars(
    axes: Axes, before: Sequence[Document], after: Sequence[Document] | None, top: float
) -> None:
    """Draw one condition: a bar per class, the after-bar inside the before-bar."""
    partner = {str(row["label"]): row["rms_mm"] for row in after or []}
    names = [str(row["label"]) for row in before]
    place = np.arange(len(before))
    old = [row["rms_mm"] for row in before]
    axes.barh(place, old, height=0.74, color=BEFORE, alpha=0.9 if after is None else 0.42)
    if after is not None:
        axes.barh(place, [partner.get(name, math.nan) for name in names], height=0.4, color=AFTER)
    for k, (value, name) in enumerate(zip(old, names)):
        text = mm(value) if after is None else f"{mm(value)} → {mm(partner.get(name))}"
        end = max(value, partner.get(name, 0.0))
        axes.annotate(
            text,
            (end, k),
            (3, 0),
            textcoords="offset points",
            va="center",
            size=6.5,
            color="#52606d",
        )
    shown = [clean(name, 26) for name in names]
    axes.set_yticks(place, shown, size=7.5 if max(map(len, shown), default=0) <= 22 else 6.6)
    axes.set_ylim(len(before) - 0.4, -0.6)
    axes.set_xlim(0, top)
    axes.set_xticks([])
    axes.tick_params(axis="y", length=0)
    axes.spines["bottom"].set_visible(False)


def _panel_height(bins: int) -> float:
    return 0.66 + 0.2 * bins


def _packed(panels: Sequence[tuple[str, int]], count: int) -> list[list[tuple[str, int]]]:
    """Put panels, tallest first, each into the shortest of some columns of similar height."""
    columns: list[list[tuple[str, int]]] = [[] for _ in range(count)]
    for panel in sorted(panels, key=lambda p: -p[1]):
        min(columns, key=lambda c: sum(_panel_height(n) for _, n in c)).append(panel)
    order = {name: k for k, (name, _) in enumerate(panels)}
    columns = [sorted(column, key=lambda p: order[p[0]]) for column in columns]
    return sorted(columns, key=lambda c: order[c[0][0]] if c else len(order))


def _surface_figure(
    rest: Floats,
    triangles: NDArray[np.int64],
    shown: Sequence[tuple[str, Floats]],
    scale: Normalize,
) -> Figure:
    """Draw four sides of the template, base left: one column per model, two for one model."""
    span, girth = float(np.ptp(rest[:, 2])), float(max(np.ptp(rest[:, 0]), np.ptp(rest[:, 1])))
    rows = 4 if len(shown) > 1 else 2
    tall = float(np.clip((WIDE - 1.2) / 2 * girth / max(span, 1e-9), 0.45, 2.2)) + 0.2
    figure = Figure(figsize=(WIDE, rows * tall + 0.35), layout="constrained")
    grid = figure.subplots(rows, 2, squeeze=False)
    for column, (name, values) in enumerate(shown):
        surface = _refined(rest, triangles, values)
        for index, (side, towards) in enumerate(SIDES):
            axes = grid[index, column] if len(shown) > 1 else grid[divmod(index, 2)]
            _project(axes, surface, np.array([*towards, 0.0]), scale)
            axes.set_aspect("equal")
            axes.set_axis_off()
            axes.set_title(side, loc="right", size=7, weight="normal", color="#52606d", pad=2)
        grid[0, column].set_title(
            f"{name}: worst point {mm(float(np.nanmax(values)))} mm rms", pad=5
        )
    _colour_bar(figure, grid, scale)
    return figure


def _colour_bar(figure: Figure, panels: NDArray[np.object_], scale: Normalize) -> None:
    mappable = matplotlib.cm.ScalarMappable(scale, ERROR_MAP)
    bar = figure.colorbar(
        mappable, ax=panels, shrink=0.85, aspect=22, pad=0.01, label="RMS error of a point, mm"
    )
    bar.outline.set_visible(False)


def _marker_figure(places: Floats, shown: Sequence[tuple[str, Floats]], scale: Normalize) -> Figure:
    """Draw markers at their mean places in the plane of largest spread, coloured by error."""
    first, second = _plane(places)
    figure = Figure(figsize=(WIDE, 3.6), layout="constrained")
    panels = figure.subplots(1, len(shown), squeeze=False, sharex=True, sharey=True)[0]
    for axes, (name, values) in zip(panels, shown):
        x, y = places[:, first], places[:, second]
        axes.plot(x, y, color=PALE, linewidth=2, zorder=1)
        axes.scatter(
            x,
            y,
            c=values,
            s=240,
            cmap=ERROR_MAP,
            norm=scale,
            edgecolors=INK,
            linewidths=0.8,
            zorder=2,
        )
        for k, value in enumerate(values):
            axes.annotate(
                f"marker {k + 1}: {mm(float(value))} mm",
                (x[k], y[k]),
                (LABEL_AT, 0),
                textcoords="offset points",
                va="center",
                size=8,
                in_layout=False,  # else a moved label would shrink the axes
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5},
                arrowprops={"arrowstyle": "-", "color": PALE, "linewidth": 0.6},
            )
        axes.set_title(f"{name}: worst marker {mm(float(np.nanmax(values)))} mm rms")
        axes.set(xlabel=f"mean {'xyz'[first]}, mm", ylabel=f"mean {'xyz'[second]}, mm")
        axes.margins(x=0.4, y=0.2)
        axes.grid(color=FAINT, linewidth=0.8)
        axes.set_axisbelow(True)
    _colour_bar(figure, panels, scale)
    figure.draw_without_rendering()  # the layout decides where the markers are
    for axes in panels:
        _spread_labels(axes)
    return figure


def _spread_labels(axes: Axes) -> None:
    """Move the labels of points so that none covers another label or another point.

    A label stays next to its point, on the side with more room, if nothing is there. Else it takes
    the nearest free place above or below, with a line to its point; inside the axes if it can. If
    there are too many labels for any free place, it stays.
    """
    labels = [text for text in axes.texts if isinstance(text, Annotation)]
    points = axes.transData.transform([label.xy for label in labels])
    pixels = axes.figure.dpi / 72.0
    dots = [Bbox.from_bounds(*(p - DOT * pixels / 2), *(2 * [DOT * pixels])) for p in points]
    frame = axes.get_window_extent()
    middle, placed = 0.5 * (points[:, 0].min() + points[:, 0].max()), list[Bbox]()
    for k, label in enumerate(labels):
        width, height = _extent(label).size
        high = 1.1 * height / pixels  # a line of text, points
        most = int(frame.height / pixels / high)
        rows = sorted(range(-most, most + 1), key=abs)
        sides = (-1, 1) if points[k, 0] > middle else (1, -1)
        taken = [*placed, *dots[:k], *dots[k + 1 :]]
        candidates = [*product((True, False), rows, sides), (False, 0, sides[0])]
        for number, (within, row, side) in enumerate(candidates, 1):
            near = points[k] + pixels * np.array([side * LABEL_AT, row * high])
            box = Bbox.from_bounds(
                near[0] - width * (side < 0), near[1] - height / 2, width, height
            )
            inside = frame.y0 <= box.y0 and box.y1 <= frame.y1
            inside &= not within or (frame.x0 <= box.x0 and box.x1 <= frame.x1)
            free = inside and not any(box.overlaps(other) for other in taken)
            if free or number == len(candidates):
                break
        placed.append(box)
        label.set_horizontalalignment("left" if side > 0 else "right")
        label.xyann = (side * LABEL_AT, row * high)
        if label.arrow_patch is not None:
            label.arrow_patch.set_visible(row != 0)


def _extent(label: Annotation) -> Bbox:
    """Return the box of a label's text, without its line, pixels."""
    label.get_window_extent()  # moves the text to its place
    return Text.get_window_extent(label)


def _project(axes: Axes, surface: Surface, view: Floats, scale: Normalize) -> None:
    """Draw a surface seen from `view`, a unit vector in the x-y plane.

    Far triangles are drawn first; all are shaded by the light.
    """
    across = np.cross(np.array([0.0, 0.0, 1.0]), view)
    corners = surface.points[surface.faces]  # (F, 3, 3)
    normal = surface.normals[surface.faces].mean(axis=1)
    order = np.argsort((corners @ view).mean(axis=1))
    order = order[normal[order] @ view > -0.1]  # the back is not visible
    # right, up, towards the viewer
    frame = np.stack([normal[:, 2], normal @ across, normal @ view], axis=1)
    light = np.clip(0.74 + 0.3 * (frame @ LIGHT / np.linalg.norm(LIGHT)), 0.0, 1.0)
    rgb = ERROR_MAP(scale(surface.values[surface.faces].mean(axis=1)))
    rgb[:, :3] *= light[:, None]
    flat = np.stack([corners[..., 2], corners @ across], axis=2)
    axes.add_collection(
        PolyCollection(
            list(flat[order]), facecolors=rgb[order], edgecolors=rgb[order], linewidths=0.4
        )
    )
    axes.autoscale_view()


def vertex_normals(points: Floats, faces: NDArray[np.int64]) -> Floats:
    """Return outward vertex normals (N, 3): averaged face normals, away from the body's axis."""
    corners = points[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    centre, axis = corners.mean(axis=1), points.mean(axis=0)
    reach = 0.5 * float(max(np.ptp(points[:, 0]), np.ptp(points[:, 1])))
    low, high = float(points[:, 2].min()) + reach, float(points[:, 2].max()) - reach
    inner = np.column_stack(
        [np.full((len(faces), 2), axis[:2]), np.clip(centre[:, 2], min(low, high), max(low, high))]
    )
    normal *= np.where(np.sum(normal * (centre - inner), axis=1) < 0, -1.0, 1.0)[:, None]
    total = np.zeros_like(points)
    np.add.at(total, faces.ravel(), np.repeat(normal, 3, axis=0))
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1), 1e-12)[:, None])


def _refined(rest: Floats, triangles: NDArray[np.int64], values: Floats) -> Surface:
    """Split triangles into four until flat colours look smooth; large meshes are unchanged."""
    known = np.where(np.isfinite(values), values, np.nanmean(values))
    data, faces = np.column_stack([rest, known, vertex_normals(rest, triangles)]), triangles
    while len(faces) < SPLIT_BELOW:
        edges = np.sort(
            np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1
        )
        unique, which = np.unique(edges, axis=0, return_inverse=True)
        a, b, c = which.reshape(3, -1) + len(data)
        p, q, r = faces.T
        data = np.concatenate([data, data[unique].mean(axis=1)])
        quads = [(p, a, c), (a, q, b), (c, b, r), (a, b, c)]
        faces = np.concatenate([np.column_stack(corner) for corner in quads])
    return Surface(data[:, :3], faces, data[:, 3], data[:, 4:])


def _plane(points: Floats) -> tuple[int, int]:
    """Return the two coordinates of largest spread, in the order x, y, z."""
    spread = np.nanmax(points, axis=0) - np.nanmin(points, axis=0)
    first, second = sorted(np.argsort(-spread, kind="stable")[:2].tolist())
    return first, second


def _thinned(t: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return a line of at most `POINTS` points: the RMS of equal stretches, at their mean times."""
    if len(t) <= POINTS:
        return t, values
    parts = np.array_split(np.arange(len(t)), POINTS)
    return np.array([t[p].mean() for p in parts]), np.array([rms(values[p]) for p in parts])


def rms(values: Floats) -> float:
    """Return the RMS of the finite values; NaN if there are none."""
    known = values[np.isfinite(values)]
    return math.sqrt(float(np.mean(known**2))) if len(known) else math.nan


def clean(text: str, longest: int) -> str:
    """Return a label without control characters, cut to a suitable length."""
    printable = "".join(ch if ch.isprintable() else " " for ch in str(text))
    return printable if len(printable) <= longest else printable[: longest - 1] + "…"


def svg(figure: Figure) -> bytes:
    """Return a figure as SVG; the same figure gives the same bytes."""
    return _saved(figure, "svg", metadata={"Date": None, "Creator": None})


def png(figure: Figure) -> bytes:
    """Return a figure as PNG, 200 dots per inch."""
    return _saved(figure, "png", dpi=200, metadata={"Software": None})


def _saved(figure: Figure, form: str, **options: Any) -> bytes:
    target = io.BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")  # a robot's name may be in any script
        figure.savefig(target, format=form, facecolor="white", **options)
    return target.getvalue()
