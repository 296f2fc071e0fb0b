"""Read an imported sweep: commands and their shapes.

The shapes come from another simulator, or from motion capture.

An `.npz` archive (numpy.savez); docs/do/import_sweep.md explains every field with an example.

    command          (S, C)     required; mm of tendon, + pulls, or in `command_unit`
    vertices         (S, N, 3)  required; mm in the base frame: vertices of a mesh, or markers; in
                                every row the same
    triangles        (F, 3)     of the vertices, whole numbers from 0
    robot            text       a name
    command_unit     text       mm (default), rad, deg, ticks …
    gravity          (3,)       unit vector in the base frame under which the shapes were found;
                                hanging by default
    base             (3,)       mm, centre of the clamped base; the origin by default
    load             (L,)       g, a known weight at the tip, and with it
    loaded_command   (L, C)     the commands at which it hung,
    loaded_vertices  (L, N, 3)  the shapes that it gave,
    mass             number     g, the body's own mass beyond the clamp

Every field is checked; the error names the first wrong field and the expected value. Other fields
are ignored with a note.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import SweepError
from softmap_edge.files.npz import archive_names, read_npz
from softmap_edge.model.training_range import BEYOND

Floats = NDArray[np.float64]

SCHEMA = "softmap.shapes/1"
LIMIT = 2 << 30  # bytes of an unpacked archive
MOST_POINTS, MOST_CHANNELS = 10_000, 64
SAME = 1e-6  # of a channel's range: nearer commands count as one
SAME_SHAPE = 0.1  # of the sweep's motion: allowed difference of two shapes of one command
SHORTEST_LEVER = 0.01  # of the length: tendons rarely run nearer to the axis
_PLACE = 1e4  # mm
MOST_GRAMS = 1e5
_NUMBERS = {
    "command": ("S", "C"),
    "vertices": ("S", "N", "3"),
    "gravity": ("3",),
    "base": ("3",),
    "load": ("L",),
    "loaded_command": ("L", "C"),
    "loaded_vertices": ("L", "N", "3"),
    "mass": (),
}
_KNOWN_LOAD = ("load", "loaded_command", "loaded_vertices", "mass")
_TEXTS = ("robot", "command_unit", "schema")


@dataclass(frozen=True, eq=False)
class ShapeSweep:
    """A checked sweep: every command once; `notes` report changes and open points."""

    command: Floats  # (S, C)
    vertices: Floats  # (S, N, 3) mm
    triangles: NDArray[np.int32]  # (F, 3), none without a mesh
    robot: str
    command_unit: str
    gravity: Floats | None  # (3,)
    base: Floats  # (3,) mm
    load: Floats | None = None  # (L,) g
    loaded_command: Floats | None = None  # (L, C)
    loaded_vertices: Floats | None = None  # (L, N, 3) mm
    mass: float | None = None  # g
    notes: tuple[str, ...] = ()
    # axes of the grid of the commands, with rows in its order
    axes: tuple[Floats, ...] | None = field(default=None)

    @classmethod
    def load_file(cls, path: str | Path) -> ShapeSweep:
        """Read and check a file; raise SweepError with one line."""
        content = read_npz(Path(path), SweepError, LIMIT)
        try:
            return _checked(content)
        except SweepError as fault:
            raise SweepError(f"{Path(path).name}: {fault}") from None


def is_shape_sweep(path: Path) -> bool:
    """Whether a file is an archive with commands and shapes, without the times of a run."""
    names = archive_names(path)
    return {"command.npy", "vertices.npy"} <= names and "t.npy" not in names


def is_own_sweep(path: Path) -> bool:
    """Whether a sweep was written by `softmap model sweep`, which carries its finger."""
    return "finger.npy" in archive_names(path)


def _checked(content: Mapping[str, NDArray[np.generic]]) -> ShapeSweep:
    schema = _text(content, "schema", SCHEMA)
    if schema != SCHEMA:
        raise SweepError(f"schema {schema!r:.80}, expected {SCHEMA} or none")
    numbers = {name: _numbers(content, name) for name in _NUMBERS if name in content}
    if "t_seen" in content and "vertices" not in content:
        raise SweepError(
            "it is a run; a model is learned from runs with `softmap learn`, and built from a sweep"
        )
    for name in ("command", "vertices"):
        if name not in numbers:
            raise SweepError(
                f"`{name}` is missing; a sweep holds command (S, C) and vertices (S, N, 3) in mm"
            )
    _shapes(numbers)
    command, vertices = numbers["command"], numbers["vertices"]
    given = [name for name in _KNOWN_LOAD if name in numbers]
    if given and len(given) < len(_KNOWN_LOAD):
        missing = [name for name in _KNOWN_LOAD if name not in numbers]
        raise SweepError(
            f"`{given[0]}` without `{missing[0]}`; a known load is load (L,) g, loaded_command "
            "(L, C), loaded_vertices (L, N, 3) mm and mass, the body's own in g: give all four "
            "or none"
        )
    _ranges(numbers, _text(content, "command_unit", "mm"))
    notes = [
        f"{name} is not known here and ignored"
        for name in content
        if name not in (*_NUMBERS, *_TEXTS, "triangles")
    ]
    _varied(command)
    command, vertices = _once(command, vertices, notes)
    _enough(command, vertices)
    axes = grid_axes(command)
    if axes is not None:
        order = np.lexsort(
            tuple(np.searchsorted(a - _gap(a), command[:, c]) for c, a in enumerate(axes))[::-1]
        )
        command, vertices = command[order], vertices[order]
    if "command_unit" not in content:
        _lever(command, vertices)
    gravity = numbers.get("gravity")
    if gravity is None and given:
        raise SweepError(
            "a known load pulls along `gravity`, which is missing; give it as a unit vector in "
            "the base frame"
        )
    return ShapeSweep(
        command=command,
        vertices=vertices,
        triangles=_triangles(content, vertices.shape[1]),
        robot=_text(content, "robot", "robot"),
        command_unit=_text(content, "command_unit", "mm"),
        gravity=gravity,
        base=numbers.get("base", np.zeros(3)),
        load=numbers.get("load"),
        loaded_command=numbers.get("loaded_command"),
        loaded_vertices=numbers.get("loaded_vertices"),
        mass=float(numbers["mass"]) if "mass" in numbers else None,
        notes=tuple(notes),
        axes=axes,
    )


def _text(content: Mapping[str, NDArray[np.generic]], name: str, otherwise: str) -> str:
    if name not in content:
        return otherwise
    value = content[name]
    text = str(value.reshape(-1)[0]) if value.dtype.kind == "U" and value.size == 1 else ""
    if not 0 < len(text) <= 100 or not text.isprintable():
        raise SweepError(
            f"`{name}` is {value.dtype} of shape {value.shape}, expected one printable text of 1 "
            "to 100 letters"
        )
    return text


def _numbers(content: Mapping[str, NDArray[np.generic]], name: str) -> Floats:
    value = content[name]
    axes = _NUMBERS[name]
    if value.dtype.kind not in "iuf":
        raise SweepError(f"`{name}` holds {value.dtype}, expected real numbers")
    if value.ndim != len(axes):
        hint = (
            "; one channel is a column, shape (S, 1)"
            if name == "command" and value.ndim == 1
            else ""
        )
        raise SweepError(f"`{name}` has shape {value.shape}, expected ({', '.join(axes)}){hint}")
    bad = ~np.isfinite(value)
    if bad.any():
        where = [int(i) for i in np.argwhere(bad)[0]]
        raise SweepError(
            f"`{name}` holds {int(bad.sum())} values that are not finite, the first at {where}; "
            "leave out the rows of commands that failed"
        )
    return np.asarray(value, np.float64)


def _shapes(numbers: Mapping[str, Floats]) -> None:
    sizes: dict[str, tuple[int, str]] = {"3": (3, "")}
    for name, value in numbers.items():
        for axis, length in zip(_NUMBERS[name], value.shape):
            known, by = sizes.setdefault(axis, (length, name))
            if known != length:
                hint = f" as in `{by}`" if by else ": x, y, z"
                raise SweepError(
                    f"`{name}` has shape {value.shape}, its axis {axis} should be {known}{hint}"
                )
    rows, points, channels = sizes["S"][0], sizes["N"][0], sizes["C"][0]
    if channels == 0:
        raise SweepError("`command` has no columns (C = 0); a sweep moves at least one tendon")
    if channels > MOST_CHANNELS or not 1 <= points <= MOST_POINTS:
        raise SweepError(
            f"{channels} channels and {points} points, allowed are 1 to {MOST_CHANNELS} and 1 to "
            f"{MOST_POINTS}; a few hundred points describe a finger: keep every n-th"
        )
    if rows < 2:
        raise SweepError(f"{rows} command{'s' * (rows != 1)}; a sweep holds many, a shape for each")


def _ranges(numbers: Mapping[str, Floats], unit: str) -> None:
    for name in ("vertices", "loaded_vertices", "base"):
        if name in numbers and numbers[name].size and float(np.abs(numbers[name]).max()) > _PLACE:
            raise SweepError(
                f"`{name}` reaches {float(np.abs(numbers[name]).max()):.4g} mm, at most "
                f"{_PLACE:g} is plausible"
            )
    places = numbers["vertices"].reshape(-1, 3)
    if numbers["vertices"].shape[1] == 1:  # the size of one point is its distance from the base
        places = np.vstack([places, numbers.get("base", np.zeros(3))])
    extent = float(np.ptp(places, axis=0).max())
    if 0.0 < extent < 1.0:
        raise SweepError(
            f"all `vertices` lie within {extent:.3g} mm, which looks like metres; multiply by 1000"
        )
    most = float(np.abs(numbers["command"]).max(initial=0.0))
    if most > (1000.0 if unit == "mm" else 1e9):
        raise SweepError(
            f"`command` reaches {most:.4g} {unit}; at most 1000 mm of tendon is plausible: name "
            "the unit in `command_unit`"
        )
    if "loaded_command" in numbers and numbers["loaded_command"].size:
        slack = BEYOND * np.ptp(numbers["command"], axis=0)
        low, high = numbers["command"].min(axis=0) - slack, numbers["command"].max(axis=0) + slack
        outside = np.any(
            (numbers["loaded_command"] < low) | (numbers["loaded_command"] > high), axis=1
        )
        if outside.any():
            raise SweepError(
                f"`loaded_command` row {int(np.argmax(outside))} lies outside the commands of the "
                "sweep; hang the load on where the unloaded shape is known"
            )
    for name in ("load", "mass"):
        value = numbers.get(name, np.ones(1))
        if value.size and not (float(value.min()) > 0.0 and float(value.max()) <= MOST_GRAMS):
            raise SweepError(
                f"`{name}` holds {float(value.min()):.4g} to {float(value.max()):.4g} g, expected "
                f"more than 0 and at most {MOST_GRAMS:g}"
            )
    if "load" in numbers and not numbers["load"].size:
        raise SweepError(
            "`load` is empty; give at least one shape under a known load, or leave its fields out"
        )
    # any number is converted, without a warning
    length = math.hypot(*numbers["gravity"]) if "gravity" in numbers else 1.0
    if abs(length - 1.0) > 1e-3:
        raise SweepError(f"`gravity` has length {length:.4g}, expected a unit vector")


def _once(command: Floats, vertices: Floats, notes: list[str]) -> tuple[Floats, Floats]:
    """Average the shapes of repeated commands, unless they differ too much."""
    step = SAME * np.maximum(np.ptp(command, axis=0), 1e-12)
    kinds, first, which = np.unique(
        np.round(command / step), axis=0, return_index=True, return_inverse=True
    )
    if len(kinds) == len(command):
        return command, vertices
    which = which.reshape(-1)
    count = np.bincount(which)
    mean = np.zeros((len(kinds), *vertices.shape[1:]))
    np.add.at(mean, which, vertices)
    mean /= count[:, None, None]
    apart = np.sqrt(np.mean(np.sum((vertices - mean[which]) ** 2, axis=2), axis=1))
    moved = float(np.sqrt(np.mean(np.sum((vertices - vertices.mean(axis=0)) ** 2, axis=2))))
    worst = int(np.argmax(apart))
    if apart[worst] > SAME_SHAPE * moved:
        rows = np.flatnonzero(which == which[worst])[:2].tolist()
        raise SweepError(
            f"rows {rows[0]} and {rows[1]} are the same command, but their shapes lie "
            f"{2 * apart[worst]:.3g} mm apart (RMS; the sweep moves by {moved:.3g} mm); a sweep "
            "has one shape a command: leave out rows that had not settled"
        )
    notes.append(
        f"{len(command) - len(kinds)} rows repeat a command and were averaged (up to "
        f"{float(apart.max()):.2g} mm apart)"
    )
    order = np.argsort(first, kind="stable")
    return command[np.sort(first)], mean[order]


def _varied(command: Floats) -> None:
    """Reject channels that do not move."""
    spread = np.ptp(command, axis=0)
    if not spread.any():
        raise SweepError(
            "there is one command only, in every row; a sweep holds many, a shape for each"
        )
    for c, column in enumerate(command.T):
        levels = len(np.unique(np.round(column / (SAME * spread[c])))) if spread[c] > 0.0 else 1
        if levels < 3:
            raise SweepError(
                f"channel {c} takes {levels} value{'s' * (levels != 1)} ({column.min():.4g} to "
                f"{column.max():.4g}); at least 3 are needed, 9 or more are better; leave out a "
                "channel that never moves"
            )


def _enough(command: Floats, vertices: Floats) -> None:
    rows, channels = command.shape
    spread = np.ptp(command, axis=0)
    if rows < 2 * (channels + 1) + 1:
        raise SweepError(
            f"{rows} different commands of {channels} channels are too few, at least "
            f"{2 * (channels + 1) + 1} are needed"
        )
    scaled = (command - command.mean(axis=0)) / spread
    if np.linalg.svd(scaled, compute_uv=False)[-1] < 1e-3 * np.sqrt(rows):
        raise SweepError(
            "some channels always move together, so their effects cannot be distinguished; move "
            "each on its own"
        )
    if float(np.ptp(vertices, axis=0).max()) < 1e-3:
        raise SweepError(
            "the vertices are the same for every command; give the shape of each command"
        )


def _lever(command: Floats, vertices: Floats) -> None:
    """Reject commands without a unit that seem to be radians or metres, not mm of tendon."""
    home = int(np.argmin(np.sum(command**2, axis=1)))
    size = float(np.linalg.norm(np.ptp(vertices[home], axis=0)))
    travel = np.linalg.norm(vertices - vertices[home], axis=2).max(axis=1)
    pulled = np.linalg.norm(command - command[home], axis=1)
    row = int(np.argmax(travel / np.maximum(pulled, 1e-300)))
    # A tendon at a lever r bends a body of length l by pull/r: its tip moves by l · pull / (2 r).
    lever = size * pulled[row] / (2.0 * max(float(travel[row]), 1e-300))
    if size > 1.0 and lever < SHORTEST_LEVER * size:
        looks = (
            "metres: multiply them by 1000"
            if lever < 0.05 * SHORTEST_LEVER * size
            else "radians: give command_unit"
        )
        raise SweepError(
            f"row {row} of `command` is {pulled[row]:.3g} from home and moves a body of "
            f"{size:.3g} mm by {travel[row]:.3g} mm, as if tendons ran {lever:.2g} mm away from "
            f"its middle; the commands look like {looks} (or, if they are mm, say command_unit = "
            "'mm')"
        )


def _triangles(content: Mapping[str, NDArray[np.generic]], points: int) -> NDArray[np.int32]:
    if "triangles" not in content:
        return np.zeros((0, 3), np.int32)
    value = content["triangles"]
    if value.dtype.kind not in "iu" or value.ndim != 2 or value.shape[1] != 3:
        raise SweepError(
            f"`triangles` is {value.dtype} of shape {value.shape}, expected whole numbers (F, 3)"
        )
    if value.size and not 0 <= int(value.min()) <= int(value.max()) < points:
        raise SweepError(
            f"`triangles` runs from {value.min()} to {value.max()}, expected 0 to {points - 1}, "
            "the vertices"
        )
    return value.astype(np.int32)


def grid_axes(command: Floats) -> tuple[Floats, ...] | None:
    """Return the axes of the tensor grid of commands (S, C), C ≤ 3, given in any order.

    Return None if there is no such grid.
    """
    if command.shape[1] > 3:
        return None
    axes: list[Floats] = []
    for column in command.T:
        levels = np.sort(column)
        new = np.r_[True, np.diff(levels) > SAME * np.ptp(levels)]
        axes.append(
            np.array([float(part.mean()) for part in np.split(levels, np.flatnonzero(new)[1:])])
        )
        if np.prod([float(len(axis)) for axis in axes]) > len(command):
            return None
    if int(np.prod([len(axis) for axis in axes])) != len(command):
        return None
    cells = [np.searchsorted(axis - _gap(axis), command[:, c]) for c, axis in enumerate(axes)]
    flat = np.ravel_multi_index(
        tuple(np.clip(i - 1, 0, len(a) - 1) for i, a in zip(cells, axes)), [len(a) for a in axes]
    )
    return tuple(axes) if len(np.unique(flat)) == len(command) else None


def _gap(axis: Floats) -> float:
    """Return half the smallest step of an axis: a command within it belongs to the node."""
    return 0.5 * float(np.diff(axis).min())
