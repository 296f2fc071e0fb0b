"""Rows of a robot for tests of text logs: a time, two commands and a tip that moves in a circle, 20
a second.
"""

import math

NAMES = ["time", "cmd_1", "cmd_2", "tip_x", "tip_y", "tip_z"]
STEP = 0.05  # s


def values(k):
    """The numbers of row k without its time."""
    a = 2 * math.pi * k / 40
    return [
        5 * math.sin(a),
        4 * math.cos(a),
        10 + 4 * math.sin(a),
        3.6 * math.cos(a),
        90 - abs(math.sin(a)),
    ]


def rows(count=40, cut=",", point=".", time=None, first=0):
    """Lines of cells; `time(k)` is the text of the first one (or several)."""
    lines = []
    for k in range(first, first + count):
        cells = [f"{x:.3f}".replace(".", point) for x in values(k)]
        lines.append(cut.join([time(k) if time else f"{STEP * k:.3f}".replace(".", point), *cells]))
    return lines


def write(path, *lines):
    """Write lines (or lists of them) as a file."""
    flat = [line for entry in lines for line in (entry if isinstance(entry, list) else [entry])]
    path.write_text("\n".join(flat) + "\n", encoding="utf-8")
    return path
