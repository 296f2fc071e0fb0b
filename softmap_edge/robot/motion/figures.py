"""Figures that a tip can be led along: letters, circle, figure of eight, and polylines from CSV or SVG.

A figure is a polyline (n, 2) in a plane, x to the right, y up, its middle at the origin, its larger half side 1;
corners are corners. The letters' strokes are ours, drawn without lifting. Pinned by tests/robot/test_curves.py.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import SoftmapError, no_name
from softmap_edge.files.atomic import MOST_TEXT

Floats = NDArray[np.float64]

MOST_POINTS = 20_000
WIDEST = 1e4  # mm: a larger one is a slip
FARTHEST = 1e6  # units of a file from its origin: beyond, differences of points lose their digits
_ROUND = np.linspace(0.0, 2 * np.pi, 181)
_FLATTENED = 24  # pieces of one Bézier curve


def _s() -> Floats:
    """Two arcs of 3/4 of a circle, from the upper right to the lower left."""
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
    "E": np.array([(0.6, 1), (-0.6, 1), (-0.6, 0), (0.4, 0), (-0.6, 0), (-0.6, -1), (0.6, -1)], float),
    "circle": np.stack([np.cos(_ROUND), np.sin(_ROUND)], axis=1),
    "eight": np.stack([np.sin(2 * _ROUND), np.sin(_ROUND)], axis=1),
}


def figure(name: str, amplitude: float) -> Floats:
    """Return a figure's points (n, 2) mm about its middle: one of `FIGURES`, or of a `.csv` or `.svg` file.

    Args:
        name: of the figure, or the file. amplitude: mm, half of its larger side.

    Raises:
        SoftmapError: no such figure, an amplitude that is none, or a file that holds no polyline.
    """
    if not 0 < amplitude <= WIDEST:
        raise SoftmapError(f"an amplitude of {amplitude:g} mm; give one above 0, up to {WIDEST:g}")
    suffix = Path(name).suffix.lower()
    if name in FIGURES:
        points = FIGURES[name]
    elif suffix in (".csv", ".svg"):
        points = _points_of(Path(name), suffix)
    else:
        raise SoftmapError(no_name("figure", name, [*FIGURES, "files .csv and .svg"]))
    low, high = points.min(axis=0), points.max(axis=0)
    half = float((high - low).max()) / 2
    if not half > 0:
        raise SoftmapError(f"{name}: all points are the same; a figure needs two that differ")
    return np.asarray((points - (low + high) / 2) / half * amplitude)


def even(points: Floats, count: int) -> Floats:
    """Return `count` points (count, D) at even distances along a polyline (n, D), its ends among them."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    kept = np.concatenate([[True], steps > 0])
    along = np.concatenate([[0.0], np.cumsum(steps[steps > 0])])
    at = np.linspace(0.0, along[-1], count)
    return np.stack([np.interp(at, along, column) for column in points[kept].T], axis=1)


def _points_of(file: Path, suffix: str) -> Floats:
    try:
        if file.exists() and not file.is_file():
            raise SoftmapError(f"{file}: no file; give a .csv or .svg")
        if file.stat().st_size > MOST_TEXT:
            raise SoftmapError(
                f"{file}: {file.stat().st_size >> 10} KB, figures of up to {MOST_TEXT >> 10} KB are read"
            )
        text = file.read_text("utf-8-sig")
    except OSError as fault:
        raise SoftmapError(f"{file}: {fault.strerror}") from None
    except UnicodeDecodeError:
        raise SoftmapError(f"{file}: no text in UTF-8") from None
    points = np.array(_csv(file, text) if suffix == ".csv" else _svg(file, text), float)
    if not 2 <= len(points) <= MOST_POINTS or not (np.abs(points) <= FARTHEST).all():  # also false for NaN
        raise SoftmapError(
            f"{file}: {len(points)} points; 2 to {MOST_POINTS} finite ones make a figure, within ±{FARTHEST:g}"
        )
    return points


def _csv(file: Path, text: str) -> list[tuple[float, float]]:
    """Read two columns x, y; a first line that is no numbers is their heading."""
    points = []
    for k, row in enumerate(csv.reader(text.splitlines())):
        if not any(cell.strip() for cell in row):
            continue
        try:
            x, y = (float(cell) for cell in row)
        except ValueError:
            if k == 0:
                continue
            raise SoftmapError(f"{file}: line {k + 1} is {','.join(row)!r:.60}; two numbers x,y are expected") from None
        points.append((x, y))
    return points


def _svg(file: Path, text: str) -> list[tuple[float, float]]:
    """Read the first path, polyline, polygon or line of a drawing; its y points down."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise SoftmapError(f"{file}: it declares a document type, which may hide anything; save it as a plain SVG")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as fault:
        raise SoftmapError(f"{file}: no XML ({fault})") from None
    for element in root.iter():
        kind = element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""
        if kind in ("path", "polyline", "polygon", "line") and (element.get("transform") or ""):
            raise SoftmapError(
                f"{file}: its first curve has a transform; apply it in the drawing program and save again"
            )
        if kind == "path":
            points = _path(file, element.get("d", ""))
        elif kind in ("polyline", "polygon"):
            numbers = [float(n) for n in _NUMBER.findall(element.get("points", ""))]
            points = list(zip(numbers[::2], numbers[1::2]))
            points += points[:1] if kind == "polygon" else []
        elif kind == "line":
            corners = [_NUMBER.match(element.get(name, "0")) for name in ("x1", "y1", "x2", "y2")]
            x1, y1, x2, y2 = (float(c[0]) if c else 0.0 for c in corners)
            points = [(x1, y1), (x2, y2)]
        else:
            continue
        return [(x, -y) for x, y in points]
    raise SoftmapError(f"{file}: no path, polyline, polygon or line in it")


_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?")
_TOKEN = re.compile(rf"([A-Za-z])|({_NUMBER.pattern})")
_COUNTS = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "Z": 0}


def _path(file: Path, d: str) -> list[tuple[float, float]]:
    """Flatten a path's first part: M L H V C S Q T Z, absolute or relative (SVG 1.1, 8.3)."""
    points: list[complex] = []
    at, first, control, before = 0j, 0j, 0j, ""
    for command, n in _commands(file, d):
        kind = command.upper()
        base = at if command.islower() else 0j
        if kind == "M":
            if points:
                break  # a second part would need the pen lifted
            at = first = base + complex(n[0], n[1])
            points.append(at)
            before = kind
            continue
        if not points:
            raise SoftmapError(f"{file}: its path begins with '{command}', not with M")
        ends = [base + complex(n[k], n[k + 1]) for k in range(0, len(n) - 1, 2)]
        if kind == "Z":
            ends = [first]
        elif kind == "H":
            ends = [complex(n[0] + base.real, at.imag)]
        elif kind == "V":
            ends = [complex(at.real, n[0] + base.imag)]
        elif kind in "ST":
            smooth = before in ("CS" if kind == "S" else "QT")
            ends.insert(0, 2 * at - control if smooth else at)
        corners = np.array([at, *ends])
        if len(corners) > 2:
            t = np.linspace(0.0, 1.0, _FLATTENED + 1)[1:, None]
            order = len(corners) - 1
            weights = [math.comb(order, k) * t**k * (1 - t) ** (order - k) for k in range(order + 1)]
            points.extend(np.sum(np.hstack(weights) * corners, axis=1).tolist())
            control = complex(corners[-2])
        else:
            points.append(ends[-1])
        at, before = ends[-1], kind
        if len(points) > MOST_POINTS:
            break
    return [(p.real, p.imag) for p in points]


def _commands(file: Path, d: str) -> Iterator[tuple[str, list[float]]]:
    """Yield each command of a path with its numbers."""
    command = ""
    numbers: list[float] = []
    for letter, number in (*_TOKEN.findall(d), ("", "")):
        if letter or not number:
            if numbers:
                raise SoftmapError(f"{file}: '{command}' of its path has {len(numbers)} numbers left over")
            command, numbers = letter, []
            if command and command.upper() not in _COUNTS:
                raise SoftmapError(f"{file}: '{command}' in its path; {' '.join(_COUNTS)} are read: make arcs curves")
            if command and command in "zZ":
                yield command, []
            continue
        numbers.append(float(number))
        count = _COUNTS.get(command.upper(), 0)
        if not count:
            raise SoftmapError(f"{file}: a number without a command in its path")
        if len(numbers) == count:
            yield command, numbers
            numbers = []
            command = {"M": "L", "m": "l"}.get(command, command)
