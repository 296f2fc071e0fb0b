"""The figure of a tracked path (SVG): target and actual path, reachable set, and error.

For a plan, it shows the commands instead of the error. Needs matplotlib; only `softmap track
--picture` imports it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from softmap_edge.report.figures import AFTER, BEFORE, FAINT, FLOOR, INK, STYLE, WIDE, svg
from softmap_edge.robot.motion.kinematics import AXES

if TYPE_CHECKING:
    from softmap_edge.robot.drive.track import Course, Tracked
    from softmap_edge.robot.motion.kinematics import Kinematics, Plan

Floats = NDArray[np.float64]

FINE = 25  # grid points along each of two commands at which the reachable set is drawn
COLOURS = (AFTER, BEFORE, INK, FLOOR)  # of commands
EDGE = "edge of reach"
LEAST_MM = 0.1  # least span of the error axis: smaller errors are round-off


def track_figure(kinematics: Kinematics, course: Course, tracked: Tracked | None) -> bytes:
    """Draw a course, and the observed path if there is one (SVG)."""
    seen = tracked is not None and len(tracked.t) > 0
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDE, 4.4), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.2))
        across, up = (AXES.index(axis) for axis in kinematics.axes[:2])
        _reach(left, kinematics, across, up)
        plan = course.plan
        target = plan.targets[course.counts]
        left.plot(target[:, across], target[:, up], color=INK, linewidth=2.4, label="target")
        if seen and tracked is not None:
            left.plot(
                tracked.tip[:, across], tracked.tip[:, up], color=AFTER, linewidth=1.2, label="seen"
            )
            _errors(right, course, tracked)
        else:
            expected = plan.tip[course.counts]
            left.plot(
                expected[:, across], expected[:, up], color=AFTER, linewidth=1.2, label="expected"
            )
            _commands(right, plan, kinematics.model.command_unit)
        out = plan.unreachable[course.counts] > 0.01
        if out.any():
            left.plot(
                target[out, across],
                target[out, up],
                ".",
                color=BEFORE,
                markersize=4,
                label="out of reach",
            )
        left.set(xlabel=f"{AXES[across]}, mm", ylabel=f"{AXES[up]}, mm", aspect="equal")
        _closer(left, [line.get_xydata() for line in left.lines if line.get_label() != EDGE])
        left.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
        right.set_xlabel("time, s")
        right.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
        return svg(figure)


def workspace_figure(
    kinematics: Kinematics, rest: Floats, target: Floats | None, nearest: Floats | None
) -> bytes:
    """Draw the reachable set of the tip from above and from the side (SVG).

    With a `target` (3,) mm and the point `nearest` to it.
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDE, 4.4), layout="constrained")
        for axes, (across, up) in zip(figure.subplots(1, 2), ((0, 1), (0, 2))):
            _reach(axes, kinematics, across, up)
            axes.plot(*rest[[across, up]], "o", color=INK, markersize=4, label="at rest")
            if target is not None and nearest is not None:
                axes.plot(
                    *zip(target[[across, up]], nearest[[across, up]]), color=BEFORE, linewidth=1.0
                )
                axes.plot(*target[[across, up]], "x", color=BEFORE, markersize=7, label="target")
                axes.plot(
                    *nearest[[across, up]],
                    "o",
                    color=AFTER,
                    markersize=4,
                    label="nearest within reach",
                )
            axes.set(xlabel=f"{AXES[across]}, mm", ylabel=f"{AXES[up]}, mm", aspect="equal")
            axes.margins(0.05)
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
        return svg(figure)


def _errors(axes: Axes, course: Course, tracked: Tracked) -> None:
    """Draw the observed tip error, and the error that the model itself expects."""
    plan = course.plan
    axes.plot(tracked.t, tracked.error, color=AFTER, linewidth=1.2, label="seen")
    expected = plan.distance[course.counts]
    # part of the path is out of reach; otherwise the line lies on the axis
    if expected.max() > LEAST_MM:
        axes.plot(plan.t[course.counts], expected, color=FLOOR, linewidth=1.0, label="expected")
    axes.set(ylabel="tip off by, mm", ylim=(0.0, max(LEAST_MM, axes.get_ylim()[1])))


def _commands(axes: Axes, plan: Plan, unit: str) -> None:
    """Draw the commands that lead the tip along the figure, and to its start."""
    for c, command in enumerate(plan.commands.T):
        axes.plot(plan.t, command, color=COLOURS[c % len(COLOURS)], linewidth=1.2, label=f"u{c}")
    axes.set_ylabel(f"command, {unit}")


def _closer(axes: Axes, paths: list[ArrayLike]) -> None:
    """Limit the axes to the paths and their surroundings.

    A boundary of the reachable set outside is left out of the legend.
    """
    points = np.concatenate([np.asarray(path, float) for path in paths])
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = (low + high) / 2, 0.8 * float((high - low).max())
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))
    for line in axes.lines:
        if (
            line.get_label() == EDGE
            and (np.abs(np.asarray(line.get_xydata()) - middle) > half).any(axis=1).all()
        ):
            line.set_label("_")


def _reach(axes: Axes, kinematics: Kinematics, across: int, up: int) -> None:
    """Draw the reachable set of the tip."""
    bounds = kinematics.acting_bounds
    if len(bounds) != 2:
        places, _ = kinematics.reach.samples
        axes.plot(
            places[:, across],
            places[:, up],
            ".",
            color=FAINT,
            markersize=3,
            zorder=0,
            label="within reach",
        )
        return
    sides = [np.linspace(low, high, FINE) for low, high in bounds.tolist()]
    grid = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1)
    places = np.asarray(kinematics.tip.evaluate(grid.reshape(-1, 2))).reshape(FINE, FINE, 3)[
        ..., [across, up]
    ]
    cells = np.stack(
        [places[:-1, :-1], places[1:, :-1], places[1:, 1:], places[:-1, 1:]], axis=2
    ).reshape(-1, 4, 2)
    axes.add_collection(
        PolyCollection(cells.tolist(), facecolors=FAINT, edgecolors=FAINT, linewidths=0.6, zorder=0)
    )
    edge = np.concatenate([places[0], places[:, -1], places[-1, ::-1], places[::-1, 0]])
    axes.plot(edge[:, 0], edge[:, 1], color=FLOOR, linewidth=0.8, label=EDGE)
