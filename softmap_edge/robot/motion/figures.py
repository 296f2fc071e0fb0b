"""Figures for the tip to follow: letters, circle, figure eight, polylines from CSV files.

A figure is a polyline (n, 2) in a plane, x to the right, y up. It is centred at the origin, and
half of its larger side is 1; corners are not rounded. The letters are drawn in one stroke. Pinned
by tests/robot/test_curves.py.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import SoftmapError, no_name
from softmap_edge.files.atomic import MOST_TEXT

Floats = NDArray[np.float64]

MOST_POINTS = 20_000  # points of a polyline in a file
WIDEST = 1e4  # mm: a larger figure is a typing error
FARTHEST = 1e6  # units of a file: beyond, differences between points lose precision
_ROUND = np.linspace(0.0, 2 * np.pi, 181)
DRAWING = (
    "drawings are not read; sample its curve and save a .csv with one point x,y a line, y up: "
    "docs/do/track.md has a command that does it"
)


def _s() -> Floats:
    """Return an S: two arcs of 3/4 of a circle, from the upper right to the lower left."""
    upper = np.linspace(np.radians(20), np.radians(270), 60)
    lower = np.linspace(np.radians(90), np.radians(-160), 60)
    return np.concatenate(
        [
            np.stack([0.55 * np.cos(upper), 0.5 + 0.5 * np.sin(upper)], axis=1),
            np.stack([0.55 * np.cos(lower), -0.5 + 0.5 * np.sin(lower)], axis=1)[1:],
        ]
    )


FIGURES: dict[str, Floats] = {
    "S": _s(),
    "H": np.array([(-0.6, -1), (-0.6, 1), (-0.6, 0), (0.6, 0), (0.6, 1), (0.6, -1)], float),
    "O": np.stack([0.7 * np.sin(_ROUND), np.cos(_ROUND)], axis=1),
    "E": np.array(
        [(0.6, 1), (-0.6, 1), (-0.6, 0), (0.4, 0), (-0.6, 0), (-0.6, -1), (0.6, -1)], float
    ),
    "circle": np.stack([np.cos(_ROUND), np.sin(_ROUND)], axis=1),
    "eight": np.stack([np.sin(2 * _ROUND), np.sin(_ROUND)], axis=1),
}


def figure(name: str, amplitude: float) -> Floats:
    """Return a figure's points (n, 2) mm about its centre: one of `FIGURES`, or of a `.csv` file.

    Args:
        name: name of the figure, or the file
        amplitude: half of its larger side, mm

    Raises:
        SoftmapError: unknown figure, an amplitude out of range, or a file without a polyline
    """
    if not 0 < amplitude <= WIDEST:
        raise SoftmapError(f"an amplitude of {amplitude:g} mm; give one above 0, up to {WIDEST:g}")
    suffix = Path(name).suffix.lower()
    if name in FIGURES:
        points = FIGURES[name]
    elif suffix == ".csv":
        points = _points_of(Path(name))
    elif suffix == ".svg":
        raise SoftmapError(f"{name}: {DRAWING}")
    else:
        raise SoftmapError(no_name("figure", name, [*FIGURES, "files .csv"]))
    low, high = points.min(axis=0), points.max(axis=0)
    half = float((high - low).max()) / 2
    if not half > 0:
        raise SoftmapError(f"{name}: all points are the same; a figure needs two that differ")
    return np.asarray((points - (low + high) / 2) / half * amplitude)


def even(points: Floats, count: int) -> Floats:
    """Return `count` evenly spaced points (count, D) along a polyline (n, D), with its ends."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    kept = np.concatenate([[True], steps > 0])
    along = np.concatenate([[0.0], np.cumsum(steps[steps > 0])])
    at = np.linspace(0.0, along[-1], count)
    return np.stack([np.interp(at, along, column) for column in points[kept].T], axis=1)


def _points_of(file: Path) -> Floats:
    try:
        if file.exists() and not file.is_file():
            raise SoftmapError(f"{file}: no file; give a .csv")
        if file.stat().st_size > MOST_TEXT:
            raise SoftmapError(
                f"{file}: {file.stat().st_size >> 10} KB, figures of up to {MOST_TEXT >> 10} KB "
                "are read"
            )
        text = file.read_text("utf-8-sig")
    except OSError as fault:
        raise SoftmapError(f"{file}: {fault.strerror}") from None
    except UnicodeDecodeError:
        raise SoftmapError(f"{file}: no text in UTF-8") from None
    points = np.array(_csv(file, text), float)
    # also false for NaN
    if not 2 <= len(points) <= MOST_POINTS or not (np.abs(points) <= FARTHEST).all():
        raise SoftmapError(
            f"{file}: {len(points)} points; 2 to {MOST_POINTS} finite ones make a figure, within "
            f"±{FARTHEST:g}"
        )
    return points


def _csv(file: Path, text: str) -> list[tuple[float, float]]:
    """Read two columns x, y; a first line without numbers is their heading."""
    points = []
    for k, row in enumerate(csv.reader(text.splitlines())):
        if not any(cell.strip() for cell in row):
            continue
        try:
            x, y = (float(cell) for cell in row)
        except ValueError:
            if k == 0:
                continue
            raise SoftmapError(
                f"{file}: line {k + 1} is {','.join(row)!r:.60}; two numbers x,y are expected"
            ) from None
        points.append((x, y))
    return points
