"""Read the tetrahedra of a mesh file (VTK, VTU or Gmsh) and its groups of cells.

The file is data only; nothing in it is executed.

meshio parses in a child process with limits on memory and time (foreign_mesh.py); any failure
becomes a one-line error. The core checks the mesh itself (rust/fem/tetrahedra.rs).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import FingerError, brief
from softmap_edge.fem.foreign_mesh import kind_of, parse
from softmap_edge.files.atomic import Document, own_text
from softmap_edge.files.child import ChildFault, in_child

_MOST_BYTES = 64 << 20  # limit of a mesh file; 60 000 tetrahedra need 4 MB
_MOST_TEXT = 1 << 20  # limit of a file of guides
_FARTHEST = 1e9  # in any unit: beyond any finger, and far below overflow of float64
_KINDS = {"vtk": "legacy VTK", "vtu": "VTU", "msh": "Gmsh's MSH"}
_MEGABYTES = 800  # memory limit of the parsing child
# processor time for a small file, s, and parsing rate, bytes/s
_SECONDS, _PER_SECOND = 2.5, 1 << 20


@dataclass(frozen=True, eq=False)
class MeshFile:
    """The content of a mesh file.

    Nodes (n, 3) in its own frame and unit, tetrahedra (E, 4) or (E, 10), and `groups`: masks of the
    cells (E,) of each material, physical volume or label, by name; empty for a single material.
    """

    points: NDArray[np.float64]
    cells: NDArray[np.int64]
    groups: dict[str, NDArray[np.bool_]]


def read_mesh(path: Path) -> MeshFile:
    """Return the tetrahedra of a mesh file and its groups of cells.

    Raises:
        FingerError: not a mesh file, meshio is missing, or no tetrahedra of one kind.
    """
    _check(path, _MOST_BYTES, "a mesh; give a VTK (.vtk, .vtu) or Gmsh (.msh) file")
    stat = path.stat()
    return _read(path, stat.st_mtime_ns, stat.st_size, stat.st_ino)


@lru_cache(maxsize=4)  # a build reads it several times
def _read(path: Path, *_state: int) -> MeshFile:
    mesh = _parsed(path)
    there, points = mesh["cells"], mesh["points"]
    if len(there) != 1:
        types = ", ".join(mesh["types"][:8]) or "nothing"
        raise FingerError(
            f"{path}: holds {types}; expected tetrahedra of 4 or of 10 nodes, all alike: mesh the "
            "volume and save it"
        )
    cells = next(iter(there.values()))
    if (
        points.ndim != 2
        or points.shape[1] != 3
        or points.dtype.kind not in "fiu"
        or cells.dtype.kind not in "iu"
    ):
        raise FingerError(
            f"{path}: points of shape {points.shape}, expected (n, 3) numbers; export it again"
        )
    if not np.all(np.abs(points) < _FARTHEST):
        raise FingerError(f"{path}: a point beyond ±{_FARTHEST:g} or not a number; export it again")
    _check_joined(path, np.asarray(points, np.float64), cells)
    nodes, corners = np.ascontiguousarray(points, np.float64), np.ascontiguousarray(cells, np.int64)
    return MeshFile(nodes, corners, mesh["groups"])


def _check_joined(path: Path, points: NDArray[np.float64], cells: NDArray[np.int64]) -> None:
    """Reject duplicate cells, which would count twice, and coincident nodes.

    At coincident nodes, cells touch without being joined.
    """
    twice = len(cells) - len(np.unique(np.sort(cells[:, :4], axis=1), axis=0))
    if twice:
        raise FingerError(
            f"{path}: {twice} of {len(cells)} tetrahedra are there twice; save each once"
        )
    grid = max(float(np.ptp(points, axis=0).max(initial=0.0)), 1e-300) * 1e-9
    apart = len(points) - len(np.unique(np.rint(points / grid), axis=0))
    if apart:
        raise FingerError(
            f"{path}: {apart} of {len(points)} nodes lie where another one does, so that cells "
            "touch and are not joined; merge coincident nodes and save again"
        )


def read_guides(path: Path) -> tuple[tuple[float, float, float], ...]:
    """Return the guides of a tendon from a JSON list of [x, y, z], in the mesh file's frame.

    Raises FingerError.
    """
    _check(path, _MOST_TEXT, "guides; give a JSON list of [x, y, z]")
    try:
        rows = json.loads(own_text(path, _MOST_TEXT))
        points = tuple((float(x), float(y), float(z)) for x, y, z in rows)
    except (OSError, ValueError, TypeError, OverflowError, RecursionError) as error:
        raise FingerError(
            f"{path}: not a JSON list of [x, y, z] ({brief(error)}); give one row a guide"
        ) from None
    if not 2 <= len(points) <= 1000 or not all(
        abs(v) < _FARTHEST for point in points for v in point
    ):
        raise FingerError(
            f"{path}: {len(points)} guides; allowed are 2 to 1000, each number within "
            f"±{_FARTHEST:g}"
        )
    return points


def _check(path: Path, most: int, what: str) -> None:
    try:
        size = path.stat().st_size if path.is_file() else -1
    except (OSError, ValueError):
        size = -1
    if size < 0:
        raise FingerError(
            f"{path}: is not there or not a file of {what}, relative to the finger's file"
        )
    if size > most:
        raise FingerError(f"{path}: {size} bytes, at most {most} are read as {what}")


def _parsed(path: Path) -> Document:
    """Return the result of `parse` in a child process; any failure there becomes one error."""
    try:
        import meshio  # noqa: F401  # here, so that the child has it
    except ImportError:
        raise FingerError("mesh files need meshio: pip install 'softmap-edge[mesh]'") from None
    try:
        kind = kind_of(path)
    except (OSError, ValueError) as error:
        raise FingerError(
            f"{path}: {error}; meshes are read as VTK (.vtk, .vtu) or Gmsh (.msh): save it as one "
            "of them"
        ) from None
    try:
        seconds = _SECONDS + path.stat().st_size / _PER_SECOND
        parsed: Document = in_child(parse, str(path), kind, megabytes=_MEGABYTES, seconds=seconds)
    except ChildFault as error:
        raise FingerError(
            f"{path}: cannot be read as {_KINDS[kind]} ({brief(error)}); export it again"
        ) from None
    return parsed
