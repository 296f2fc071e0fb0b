"""The figure of a calibration: matched commands and the map, and errors over ticks (SVG).

Left, in the plane of the first two commands: a dot for the mapped command (a cross if it was
excluded), and an arrow towards the matched one, magnified by the printed factor. Right, for each
servo, the residual of every command. Needs matplotlib; only `softmap model calibrate --plot`
imports it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from softmap_edge.report.figures import AFTER, BEFORE, FAINT, FLOOR, INK, STYLE, WIDE, svg

if TYPE_CHECKING:
    from softmap_edge.calibration.found import Calibrated

Floats = NDArray[np.float64]

COLOURS = (AFTER, INK, FLOOR)  # of the commands' residuals
MOST = 3  # servos and commands that are drawn at most
ARROW = 0.12  # share of the plane: approximate length of the longest arrow
LEGEND: Any = {
    "ncols": 4,
    "frameon": False,
    "borderaxespad": 0.2,
    "columnspacing": 1.2,
    "handletextpad": 0.3,
}


def calibration_figure(found: Calibrated) -> bytes:
    """Draw matched pairs and residuals of a calibration (SVG)."""
    servos = min(MOST, found.held.ticks.shape[1])
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDE, 4.6), layout="constrained")
        grid = figure.add_gridspec(servos, 2, width_ratios=(1.0, 1.15))
        _plane(figure.add_subplot(grid[:, 0]), found)
        for servo in range(servos):
            axes = figure.add_subplot(grid[servo, 1])
            _residuals(axes, found, servo)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.3), **LEGEND)
        return svg(figure)


def _plane(axes: Axes, found: Calibrated) -> None:
    held, unit = found.held, found.calibration.unit
    mapped, good = found.calibration.commands(held.ticks), found.weight > 0
    if held.u.shape[1] == 1:
        axes.plot(held.ticks[:, 0], mapped[:, 0], color=AFTER, linewidth=1.2)
        axes.plot(held.ticks[:, 0], held.u[:, 0], "o", color=INK, markersize=3.5)
        axes.set(xlabel="servo 0, ticks", ylabel=f"command 0, {unit}")
        return
    u, at, observed = held.u[:, :2], mapped[:, :2], held.observed[:, :2]
    step = np.where(observed, u - at, 0.0)
    length = np.linalg.norm(step[good], axis=1)
    usual = float(np.quantile(length, 0.95)) if len(length) else 0.0
    width = float(np.ptp(at, axis=0).max())
    factors = np.array([1, 2, 5, 10, 20, 50, 100, 200, 500, 1000])
    factor = int(factors[factors * max(usual, 1e-12) <= ARROW * width].max(initial=1))
    complete = good & observed.all(axis=1)
    for rows, colour in ((good, AFTER), (~good, BEFORE)):
        axes.quiver(
            at[rows, 0],
            at[rows, 1],
            *(factor * step[rows]).T,
            angles="xy",
            scale_units="xy",
            scale=1.0,
            color=colour,
            width=0.004,
            zorder=2,
        )
    axes.plot(*at[complete].T, "o", color=INK, markersize=3.5, linestyle="none", label="held")
    part = good & ~observed.all(axis=1)
    axes.plot(
        *at[part].T,
        "o",
        color=INK,
        markersize=4.0,
        fillstyle="none",
        linestyle="none",
        label="one pair slack",
    )
    if not good.all():
        axes.plot(
            *at[~good].T, "x", color=BEFORE, markersize=6.0, linestyle="none", label="set aside"
        )
    axes.set(xlabel=f"command 0, {unit}", ylabel=f"command 1, {unit}", aspect="equal")
    axes.set_title(f"residuals, drawn {factor} times as long" if factor > 1 else "residuals")
    axes.grid(color=FAINT, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), **LEGEND)


def _residuals(axes: Axes, found: Calibrated, servo: int) -> None:
    left, ticks, good = found.left, found.held.ticks[:, servo], found.weight > 0
    axes.axhline(0.0, color=FLOOR, linewidth=0.8)
    for command in range(min(MOST, left.shape[1])):
        colour = COLOURS[command]
        axes.plot(
            ticks[good],
            left[good, command],
            "os^"[command],
            color=colour,
            markersize=3.5,
            linestyle="none",
            label=f"command {command}",
        )
    shown = left[good]
    reach = 1.15 * float(np.nanmax(np.abs(shown), initial=1e-6))
    if not good.all():
        beyond = np.clip(left[~good], -reach, reach)
        axes.plot(
            np.repeat(ticks[~good], beyond.shape[1]),
            beyond.ravel(),
            "x",
            color=BEFORE,
            markersize=5.0,
            linestyle="none",
            label="set aside (clipped)",
            clip_on=False,
        )
    axes.axvline(
        found.calibration.home[servo],
        color=FLOOR,
        linewidth=1.0,
        linestyle=":",
        zorder=0,
        label="home",
    )
    if servo == 0:
        axes.set_title("what the map leaves of the matched commands")
    axes.set(xlabel=f"servo {servo}, ticks", ylabel=found.calibration.unit, ylim=(-reach, reach))
    axes.grid(axis="y", color=FAINT, linewidth=0.8)
    axes.set_axisbelow(True)
