"""Loops over one cycle: each output, or the tip, against a command, measured and predicted.

Pinned by tests/run/test_output.py and tests/report/test_loop_figure.py. Needs matplotlib.
"""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from softmap_edge.comparison.series import Loop, Series
from softmap_edge.files.atomic import Document
from softmap_edge.report.figures import AFTER, BEFORE, FAINT, INK, PALE, STYLE, WIDE, clean, svg
from softmap_edge.report.pages import Picture
from softmap_edge.run.in_unit import PLACES

Floats = NDArray[np.float64]

TURN = 0.2  # share of a command's range: smaller reverse moves do not make a cycle
MOST_LOOPS = 6  # loops drawn for a run with many outputs or commands


def loop_picture(
    series: Series, unit: str, diagnosis: Document | None, kind: str
) -> Picture | None:
    """Return the figure of the loops.

    It is made for all outputs, and for a body if a family with memory was detected.

    Args:
        series: of the run on the page
        unit: of its errors
        diagnosis: the document, or None
        kind: an addition to the caption
    """
    body = unit == PLACES
    remembers = any(row.get("kind") == "memory" for row in (diagnosis or {}).get("families") or [])
    if not series.loops or (body and not remembers):
        return None
    what = "Tip" if body else "Output"
    note = f"The cycle with the largest error before, {unit} (faint: all measurements)"
    if body:
        note += (
            ". The tip's displacement along the direction in which the command moves it; 0 is "
            "where it is at command 0"
        )
    return Picture(
        f"{what} against command: the loop",
        loops(series, unit),
        f"{what} against command, measured and predicted",
        f"{note}{kind}.",
    )


def loops(series: Series, unit: str) -> bytes:
    """Draw each output, or the tip, against its command, with the error below it (SVG).

    The tip is in `unit`. The curves are measured, predicted before, and predicted after, for the
    cycle with the largest error before. All measurements are drawn behind.
    """
    most = min(len(series.loops), MOST_LOOPS)
    columns = min(most, 2)
    tall = -(-most // columns)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDE, 5.4 * tall), layout="constrained")
        grid = figure.subplots(
            2 * tall, columns, squeeze=False, sharex="col", height_ratios=[3.4, 2.0] * tall
        )
        for k in range(tall * columns):
            row, column = divmod(k, columns)
            upper, lower = grid[2 * row, column], grid[2 * row + 1, column]
            if k < most:
                _draw(upper, lower, series.loops[k], unit, series.command_unit)
            else:
                upper.set_axis_off()
                lower.set_axis_off()
        return svg(figure)


def _draw(upper: Axes, lower: Axes, loop: Loop, unit: str, command_unit: str) -> None:
    """Draw one loop into the upper axes and its error into the lower ones."""
    rows = worst_cycle(loop)
    command, seen = loop.command[rows], loop.seen[rows]
    shown = [("predicted" if loop.after is None else "before", loop.before, BEFORE)]
    if loop.after is not None:
        shown.append(("after", loop.after, AFTER))
    upper.plot(loop.command, loop.seen, color=FAINT, linewidth=0.9, zorder=1)
    upper.plot(
        command,
        seen,
        color=INK,
        linewidth=0.9,
        marker="o",
        markersize=2.6,
        label="measured",
        zorder=1.5,
    )
    for name, values, colour in shown:
        upper.plot(command, values[rows], color=colour, linewidth=1.4, label=name)
        lower.plot(
            command, seen - values[rows], color=colour, linewidth=1.2, marker="o", markersize=2.0
        )
    lower.axhline(0.0, color=PALE, linewidth=0.8, zorder=1)
    upper.set_ylabel(f"{clean(loop.name, 30)}, {unit}")
    lower.set(xlabel=f"command, {command_unit}", ylabel=f"measured − predicted, {unit}")
    for axes in (upper, lower):
        axes.grid(color=FAINT, linewidth=0.8)
        axes.set_axisbelow(True)
    upper.legend(
        loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, borderaxespad=0.2
    )


def worst_cycle(loop: Loop) -> slice:
    """Return the frames of a command's cycle (three reversals) with the largest error before.

    Without a cycle, return all frames. Cycles in which the other commands stand still are
    preferred, because motion by other commands is not part of this loop.
    """
    turns = _turns(loop.command)
    squares = np.nan_to_num(loop.seen - loop.before) ** 2
    cycles = [slice(start, end + 1) for start, end in zip(turns, turns[2:])]
    if loop.others is not None:
        least = TURN * np.ptp(loop.others, axis=0)
        cycles = [
            rows for rows in cycles if np.all(np.ptp(loop.others[rows], axis=0) <= least)
        ] or cycles
    return max(cycles, key=lambda rows: float(squares[rows].mean()), default=slice(0, len(squares)))


def _turns(command: Floats) -> list[int]:
    """Return the frames at which a command reverses by more than `TURN` of its range."""
    least = TURN * float(np.ptp(command))
    turns = list[int]()
    extreme = 0
    way = 0.0
    for k, value in enumerate(command):
        if way == 0.0 and abs(value - command[0]) > least:
            way, extreme = float(np.sign(value - command[0])), k
        elif way * (value - command[extreme]) > 0:
            extreme = k
        elif way and way * (command[extreme] - value) > least:
            turns.append(extreme)
            way, extreme = -way, k
    return turns
