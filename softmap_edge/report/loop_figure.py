"""The loop of a run of outputs: each output against its command, measured and predicted, over one cycle.

Pinned by tests/test_output.py. Needs matplotlib.
"""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from softmap_edge.diagnosis.series import Loop, Series
from softmap_edge.report.figures import AFTER, BEFORE, FAINT, INK, STYLE, WIDE, clean, svg

Floats = NDArray[np.float64]

TURN = 0.2  # of the range of a command: smaller moves back are no cycle
MOST_LOOPS = 6  # of a run with many outputs


def loops(series: Series, unit: str) -> bytes:
    """Draw each output (in `unit`) against its command: measured, and predicted before and after (SVG).

    One cycle of the command, that with the largest error before; all that was measured stands behind.
    """
    most = min(len(series.loops), MOST_LOOPS)
    columns = min(most, 2)
    tall = -(-most // columns)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDE, 4.2 * tall), layout="constrained")
        grid = figure.subplots(tall, columns, squeeze=False).ravel()
        for axes, loop in zip(grid, series.loops[:most]):
            rows = worst_cycle(loop)
            axes.plot(loop.command, loop.seen, color=FAINT, linewidth=0.9, zorder=1)
            axes.plot(loop.command[rows], loop.seen[rows], color=INK, linewidth=1.0, label="measured", zorder=3)
            old = "predicted" if loop.after is None else "before"
            axes.plot(loop.command[rows], loop.before[rows], color=BEFORE, linewidth=1.4, label=old)
            if loop.after is not None:
                axes.plot(loop.command[rows], loop.after[rows], color=AFTER, linewidth=1.4, label="after")
            axes.set(xlabel=f"command, {series.command_unit}", ylabel=f"{clean(loop.name, 30)}, {unit}")
            axes.grid(color=FAINT, linewidth=0.8)
            axes.set_axisbelow(True)
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, borderaxespad=0.2)
        for axes in grid[most:]:
            axes.set_axis_off()
        return svg(figure)


def worst_cycle(loop: Loop) -> slice:
    """Return the frames of the cycle of a command (three turns) with the largest error before; else all of them."""
    turns = _turns(loop.command)
    squares = np.nan_to_num(loop.seen - loop.before) ** 2
    cycles = [slice(start, end + 1) for start, end in zip(turns, turns[2:])]
    return max(cycles, key=lambda rows: float(squares[rows].mean()), default=slice(0, len(squares)))


def _turns(command: Floats) -> list[int]:
    """Return the frames at which a command turns round by more than `TURN` of its range."""
    least, turns, extreme, way = TURN * float(np.ptp(command)), list[int](), 0, 0.0
    for k, value in enumerate(command):
        if way == 0.0 and abs(value - command[0]) > least:
            way, extreme = float(np.sign(value - command[0])), k
        elif way * (value - command[extreme]) > 0:
            extreme = k
        elif way and way * (command[extreme] - value) > least:
            turns.append(extreme)
            way, extreme = -way, k
    return turns
