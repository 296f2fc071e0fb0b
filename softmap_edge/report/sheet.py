"""One sheet on where the error is: some poses and the commands, before and after, on one scale.

Poses are measured shapes in parallel projection, base above and tip below, whatever the direction
of gravity. Each dot in the command plane is a frame. Lengths in mm. Needs matplotlib.
"""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from softmap_edge.comparison.series import ExamplePose, Series
from softmap_edge.files.numbers import mm
from softmap_edge.report.figures import (
    ERROR_MAP,
    FAINT,
    INK,
    PALE,
    STYLE,
    WIDE,
    png,
    rms,
    vertex_normals,
)

Floats = NDArray[np.float64]

TURN, TILT = 35.0, 12.0  # degrees: about the body's axis, and elevation of the viewer
LIGHT = np.array([-0.4, 0.5, 0.77])  # right, up, towards the viewer
TOP = 99.0  # percentile of the errors at the end of the colour scale
FLAT = 0.03  # share of the largest range of a command: channels that move less span no plane


def sheet(series: Series) -> bytes:
    """Draw poses and commands, coloured by their error, before and after (PNG)."""
    two = series.after is not None
    moments = ("before", "after") if two else ("before",)
    frames = [getattr(series, m) for m in moments]
    points = [
        values for pose in series.poses for m in moments if (values := getattr(pose, m)) is not None
    ]
    known = np.concatenate([f[np.isfinite(f)] for f in [*frames, *points]])
    scale = Normalize(0.0, float(np.percentile(known, TOP)) if known.size else 1.0)
    plane = _plane_of(series.command)
    with matplotlib.rc_context(STYLE):
        panels = len(moments) * (1 if plane is None else 2)
        figure = Figure(figsize=(WIDE, 3.6 if panels == 4 else 4.2), layout="constrained")
        grid = figure.subplots(1, panels, squeeze=False, width_ratios=[1.0] * panels)[0]
        for k, moment in enumerate(moments):
            values = getattr(series, moment)
            _draw_poses(grid[k], series, moment, scale)
            grid[k].set_title(f"{moment if two else 'error'}: {mm(rms(values))} mm rms")
            if plane is not None:
                axes = grid[len(moments) + k]
                _draw_commands(axes, series, plane, values, scale)
                axes.set_title(f"{moment}, by command" if two else "by command")
        mappable = matplotlib.cm.ScalarMappable(scale, ERROR_MAP)
        bar = figure.colorbar(
            mappable, ax=grid, shrink=0.8, aspect=24, pad=0.01, extend="max", label="error, mm"
        )
        bar.outline.set_visible(False)
        return png(figure)


def _plane_of(command: Floats) -> tuple[int, int] | None:
    """Return the two channels that move most, in order; one twice if alone; None if none moves."""
    if not command.shape[1]:
        return None
    span = np.ptp(command, axis=0)
    order = [
        int(c)
        for c in np.argsort(-span, kind="stable")
        if span[c] > FLAT * span.max() and span[c] > 0
    ]
    if not order:
        return None
    first, second = sorted(order[:2]) if len(order) > 1 else (order[0], order[0])
    return first, second


def _draw_commands(
    axes: Axes, series: Series, plane: tuple[int, int], values: Floats, scale: Normalize
) -> None:
    """Draw one dot per frame in the plane of two commands; with one command, its error above it."""
    x = series.command[:, plane[0]]
    one = plane[0] == plane[1]
    y = values if one else series.command[:, plane[1]]
    worst_last = np.argsort(np.where(np.isfinite(values), values, -1.0), kind="stable")
    axes.scatter(
        x[worst_last],
        y[worst_last],
        c=values[worst_last],
        s=16,
        cmap=ERROR_MAP,
        norm=scale,
        linewidths=0,
    )
    unit = series.command_unit
    axes.set(xlabel=f"u{plane[0]}, {unit}", ylabel="error, mm" if one else f"u{plane[1]}, {unit}")
    axes.grid(color=FAINT, linewidth=0.8)
    axes.set_axisbelow(True)
    if not one:
        axes.set_aspect("equal", adjustable="datalim")


def _draw_poses(axes: Axes, series: Series, moment: str, scale: Normalize) -> None:
    right, up, towards = view()
    for pose in sorted(series.poses, key=lambda p: float(np.nanmean(p.points @ towards))):
        values = getattr(pose, moment)
        if series.triangles is None:
            _draw_markers(axes, pose, values, right, up, scale)
        else:
            _draw_surface(axes, pose, values, series.triangles, (right, up, towards), scale)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_axis_off()


def view() -> tuple[Floats, Floats, Floats]:
    """Return unit vectors (3,) right, up and to the viewer, in the base frame; z points down."""
    turn, tilt = np.radians(TURN), np.radians(TILT)
    right = np.array([np.cos(turn), np.sin(turn), 0.0])
    level = np.array([-np.sin(turn), np.cos(turn), 0.0])
    up = np.sin(tilt) * level - np.cos(tilt) * np.array([0.0, 0.0, 1.0])
    return right, up, np.asarray(np.cross(right, up))


def _draw_surface(
    axes: Axes,
    pose: ExamplePose,
    values: Floats,
    triangles: NDArray[np.int64],
    view: tuple[Floats, ...],
    scale: Normalize,
) -> None:
    """Draw the visible triangles of one pose, far ones first, shaded."""
    right, up, towards = view
    seen = ~np.isnan(pose.points[:, 0])
    faces = triangles[seen[triangles].all(axis=1)]
    if not len(faces):
        return
    points = np.where(seen[:, None], pose.points, 0.0)
    normal = vertex_normals(points, faces)[faces].mean(axis=1)
    corners = points[faces]
    order = np.argsort((corners @ towards).mean(axis=1))
    order = order[normal[order] @ towards > -0.15]
    frame = np.stack([normal @ right, normal @ up, normal @ towards], axis=1)
    light = np.clip(0.76 + 0.3 * (frame @ LIGHT / np.linalg.norm(LIGHT)), 0.0, 1.0)
    rgb = np.asarray(ERROR_MAP(scale(np.nanmean(values[faces], axis=1))))
    rgb[:, :3] *= light[:, None]
    flat = np.stack([corners @ right, corners @ up], axis=2)
    axes.add_collection(
        PolyCollection(
            list(flat[order]), facecolors=rgb[order], edgecolors=rgb[order], linewidths=0.3
        )
    )


def _draw_markers(
    axes: Axes, pose: ExamplePose, values: Floats, right: Floats, up: Floats, scale: Normalize
) -> None:
    """Draw the markers of one pose, joined in their order."""
    x, y = pose.points @ right, pose.points @ up
    axes.plot(x, y, color=PALE, linewidth=1.6, zorder=1)
    axes.scatter(
        x, y, c=values, s=60, cmap=ERROR_MAP, norm=scale, edgecolors=INK, linewidths=0.6, zorder=2
    )
