"""The Zarr 3 store of a dense sweep: created atomically, filled by chunk, checked on opening.

    command (S, C)  as commanded, mm or N · vertices (S, N, 3) mm float32 · pull (S, T) N ·
                    triangles (F, 3) int32
    done (chunks,) bool  which chunks of rows are complete; attributes: what the sweep is of, and
                         the schema

S runs over the grid in C order, the last command fastest; a chunk is `chunk` rows, in `vertices`
and `pull` one file. A store is built next to its final path and moved there. A chunk is done only
once both of its files exist, and each file replaces its old one atomically (zarr's LocalStore). So
a kill at any time leaves a resumable store. Stores are untrusted: formats before 3, whose codecs
may run code, are rejected; only the types above and compressing codecs are read. Pinned by
tests/sweep/test_zarr_sweep.py.
"""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray

from softmap_edge.errors import SimulationError, SoftmapError, brief
from softmap_edge.fem.bodies import Meshed
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import UNITS, FingerTemplate, tensor_grid
from softmap_edge.version import __version__

Floats = NDArray[np.float64]

SCHEMA = "softmap.sweep.zarr/1"
SPLIT = "softmap.split/1"  # the rule of SimulatedSet.split
ARRAYS = {
    "command": "float64",
    "vertices": "float32",
    "pull": "float64",
    "triangles": "int32",
    "done": "bool",
}
CODECS = {"BytesCodec", "ZstdCodec"}
MOST_TEXT = 16 << 20  # limit of a zarr.json, bytes
MOST_NUMBERS = 1 << 27  # limit of a read: a chunk, or an array other than `vertices`
MOST_ROWS = 10_000_000
REMEDY = "make it again with `softmap model sweep`"


@dataclass(frozen=True)
class Store:
    """An open store: attributes, small arrays in memory, `vertices` and `pull` on demand.

    Attributes are kept as read.

    path · attributes · axes: one (n,) for each command · command (S, C) · triangles (F, 3) · done
    (chunks,) · vertices (S, N, 3), pull (S, T), marks (chunks,), where `done` is kept: zarr arrays.
    """

    path: Path
    attributes: dict[str, Any]
    axes: tuple[Floats, ...]
    command: Floats
    triangles: NDArray[np.int32]
    done: NDArray[np.bool_]
    vertices: Any
    pull: Any
    marks: Any

    @property
    def chunk(self) -> int:
        """Rows of a chunk."""
        return int(self.attributes["chunk"])

    def rows(self, chunk: int) -> slice:
        """Return the rows of a chunk."""
        return slice(chunk * self.chunk, min((chunk + 1) * self.chunk, len(self.command)))

    def write(self, chunk: int, vertices: Floats, pull: Floats) -> None:
        """Write a chunk: vertices (n, N, 3) mm and pull (n, T) N of its rows.

        The chunk is done once both are written.

        Raises SimulationError for other arrays, as from a worker of another version.
        """
        rows = self.rows(chunk)
        count = rows.stop - rows.start
        for name, values, array in (
            ("vertices", vertices, self.vertices),
            ("pull", pull, self.pull),
        ):
            if values.shape != (count, *array.shape[1:]) or not np.isfinite(values).all():
                raise SimulationError(
                    f"{self.path}: chunk {chunk} came back with {name} of shape {values.shape}, "
                    f"expected finite numbers of shape {(count, *array.shape[1:])}; give every "
                    "worker this version of softmap-edge"
                )
        self.vertices[rows] = vertices.astype(np.float32)
        self.pull[rows] = pull
        self.done[chunk] = True
        self.marks[:] = self.done

    def read(self, chunk: int) -> NDArray[np.float32]:
        """Return the vertices (n, N, 3) mm of a chunk.

        Raises SimulationError if they are damaged or missing.
        """
        try:
            found = np.asarray(self.vertices[self.rows(chunk)])
        except Exception as fault:  # codecs may raise any error
            raise SimulationError(
                f"{self.path}: chunk {chunk} is damaged ({brief(fault)}); {REMEDY}"
            ) from None
        if not np.isfinite(found).all():
            raise SimulationError(
                f"{self.path}: chunk {chunk} holds numbers that are not finite, or is gone; "
                f"{REMEDY}"
            )
        return found

    def check_same(self, required: dict[str, Any]) -> None:
        """Raise SimulationError if the attributes differ from those of `attributes_of`."""
        for name in ("finger", "mesh_sha256", "gravity", "tip_force", "axes", "chunk"):
            there, here = self.attributes[name], required[name]
            if there != here:
                raise SimulationError(
                    f"{self.path}: a sweep stands there with {_difference(name, there, here)}; "
                    "give another name, or the same finger, --steps and --chunk to go on with it"
                )


def attributes_of(finger: Finger, axes: Sequence[Floats], chunk: int) -> dict[str, Any]:
    """Return the attributes for a sweep of `finger` over `axes`.

    The sweep is under its own gravity, in chunks of `chunk` rows.
    """
    return {
        "schema": SCHEMA,
        "finger": finger.to_toml(),
        "mesh_sha256": _mesh(finger),
        "units": UNITS | {"command": finger.command_unit},
        "gravity": [float(g) for g in finger.gravity],
        "tip_force": [0.0, 0.0, 0.0],
        "axes": [[float(u) for u in axis] for axis in axes],
        "chunk": min(chunk, math.prod(len(axis) for axis in axes)),
        "split": SPLIT,
        "written_by": f"softmap-training with softmap-edge {__version__}",
    }


def make(path: Path, attributes: dict[str, Any], template: FingerTemplate, tendons: int) -> None:
    """Make an empty store at `path` atomically."""
    command = tensor_grid([np.array(axis) for axis in attributes["axes"]])
    size, chunk = len(command), attributes["chunk"]
    points = len(template.vertices)
    if size > MOST_ROWS or chunk * points * 3 > MOST_NUMBERS:
        raise SimulationError(
            f"{size} commands in chunks of {chunk}, {points} vertices each: at most {MOST_ROWS} "
            f"commands and {MOST_NUMBERS // (3 * points)} a chunk; take fewer --steps or a "
            "smaller --chunk"
        )
    made = path.parent / f".{path.name}.new"
    shutil.rmtree(made, ignore_errors=True)
    group = zarr.open_group(made, mode="w", zarr_format=3)
    group.attrs.update(attributes)
    small = {"command": command, "triangles": np.asarray(template.triangles, np.int32)}
    small["done"] = np.zeros(math.ceil(size / chunk), bool)
    for name, values in small.items():
        group.create_array(
            name,
            shape=values.shape,
            chunks=tuple(max(n, 1) for n in values.shape),
            dtype=ARRAYS[name],
        )
        group[name][:] = values
    for name, each in (("vertices", (points, 3)), ("pull", (tendons,))):
        array = {
            "shape": (size, *each),
            "chunks": (chunk, *(max(n, 1) for n in each)),
            "dtype": ARRAYS[name],
        }
        group.create_array(name, **array, fill_value=np.nan)
    try:
        made.rename(path)
    except OSError as error:
        raise type(error)(error.errno, error.strerror, str(path)) from None


def open_store(path: Path, mode: str = "r") -> Store:
    """Open a store, `mode` "r" or "r+".

    Raises SimulationError with one line if it is not a store, damaged or too large.
    """
    if not (path / "zarr.json").is_file():
        raise SimulationError(
            f"{path}: no Zarr 3 store; make one with `softmap model sweep --out NAME.zarr`"
        )
    try:
        return _opened(path, mode)
    except SoftmapError as error:
        raise SimulationError(f"{path}: {error}; {REMEDY}") from None
    except Exception as fault:  # zarr, its codecs and json may raise any error
        raise SimulationError(
            f"{path}: a damaged store ({brief(fault) or type(fault).__name__}); {REMEDY}"
        ) from None


def _opened(path: Path, mode: str) -> Store:
    for folder in (path, *(path / name for name in ARRAYS)):
        size = (folder / "zarr.json").stat().st_size
        if size > MOST_TEXT:
            raise SimulationError(
                f"{size >> 20} MB of metadata, at most {MOST_TEXT >> 20} are read"
            )
    text = (path / "zarr.json").read_bytes()
    schema = json.loads(text).get("attributes", {}).get("schema")
    if schema != SCHEMA:
        raise SimulationError(f"schema {str(schema)[:80]!r}, expected {SCHEMA}")
    group = zarr.open_group(path, mode=mode, zarr_format=3, use_consolidated=False)
    attributes = dict(group.attrs)
    finger = Finger.from_toml(str(attributes["finger"]))
    grid = [np.array(axis, np.float64) for axis in attributes["axes"]]
    chunk = attributes["chunk"]
    if type(chunk) is not int or chunk < 1 or attributes["split"] != SPLIT:
        raise SimulationError(
            f"chunk {str(chunk)[:40]} and split {str(attributes['split'])[:40]!r}, unknown here"
        )
    units = UNITS | {"command": finger.command_unit}
    if attributes["units"] != units:
        raise SimulationError(f"units {attributes['units']!r:.120}, expected {units}")
    for axis in grid:
        if (
            axis.ndim != 1
            or not axis.size
            or not np.isfinite(axis).all()
            or (np.diff(axis) <= 0).any()
        ):
            raise SimulationError("axes that are no ascending numbers")
    for name in ("gravity", "tip_force"):
        vector = np.array(attributes[name], np.float64)
        if vector.shape != (3,) or not np.isfinite(vector).all():
            raise SimulationError(f"{name} is not three numbers")
    arrays = {name: _array(group, name) for name in ARRAYS}
    _check_sizes(arrays, [len(axis) for axis in grid], chunk, len(finger.tendons))
    command, triangles, done = (
        np.asarray(arrays[name][:]) for name in ("command", "triangles", "done")
    )
    if not np.array_equal(command, tensor_grid(grid)):
        raise SimulationError("command is not the grid of its axes")
    points = arrays["vertices"].shape[1]
    if triangles.size and not 0 <= triangles.min() <= triangles.max() < points:
        raise SimulationError(f"triangles point outside the {points} vertices")
    return Store(
        path,
        attributes,
        tuple(grid),
        command,
        triangles,
        done,
        *(arrays[n] for n in ("vertices", "pull", "done")),
    )


def _array(group: zarr.Group, name: str) -> Any:
    array = group[name]
    if not isinstance(array, zarr.Array):
        raise SimulationError(f"{name} is no array")
    if str(array.dtype) != ARRAYS[name]:
        raise SimulationError(f"{name} holds {str(array.dtype)[:40]}, expected {ARRAYS[name]}")
    strange = {type(codec).__name__ for codec in array.metadata.codecs} - CODECS
    if strange:
        raise SimulationError(f"{name} is written with {sorted(strange)[0][:40]}, expected zstd")
    return array


def _check_sizes(arrays: dict[str, Any], lengths: list[int], chunk: int, tendons: int) -> None:
    size, points = math.prod(lengths), arrays["vertices"].shape[1:2]
    faces = arrays["triangles"].shape[:1]
    expected = {
        "command": (size, len(lengths)),
        "vertices": (size, *points, 3),
        "pull": (size, tendons),
        "triangles": (*faces, 3),
        "done": (math.ceil(size / chunk),),
    }
    for name, shape in expected.items():
        array = arrays[name]
        if array.shape != shape:
            raise SimulationError(f"{name} of shape {array.shape}, expected {shape}")
        piece = array.chunks if name in ("vertices", "pull") else shape
        if (
            size > MOST_ROWS
            or math.prod(piece) > MOST_NUMBERS
            or math.prod(array.chunks) > MOST_NUMBERS
        ):
            raise SimulationError(
                f"{name}: pieces of {piece} numbers, at most {MOST_NUMBERS} are read at once"
            )
        if name in ("vertices", "pull") and array.chunks != (
            chunk,
            *(max(n, 1) for n in shape[1:]),
        ):
            raise SimulationError(
                f"{name} in pieces of {array.chunks}, expected {chunk} whole rows"
            )


def _mesh(finger: Finger) -> str:
    """Return the SHA-256 of a finger's mesh file, or nothing without one."""
    return (
        hashlib.sha256(Path(finger.solid.file).read_bytes()).hexdigest()
        if isinstance(finger.solid, Meshed)
        else ""
    )


def _difference(name: str, there: Any, here: Any) -> str:
    if name == "finger":
        pairs = zip(f"{there}\n".splitlines(), f"{here}\n".splitlines())
        line = next(
            ((a, b) for a, b in pairs if a != b), ("a finger of another length", "this one")
        )
        return f"another finger ('{line[0][:60]}', not '{line[1][:60]}')"
    if name == "axes":
        counts = [" x ".join(str(len(axis)) for axis in axes) for axes in (there, here)]
        return (
            f"another grid ({counts[0]}, not {counts[1]})"
            if counts[0] != counts[1]
            else "a grid of other commands"
        )
    if name == "chunk":
        return f"chunks of {there} rows, not {here}"
    return f"another {name.replace('_', ' ')} ({str(there)[:40]}, not {str(here)[:40]})"
