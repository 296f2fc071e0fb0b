"""Read the tetrahedra of a mesh file (legacy VTK or Gmsh) with meshio. Data only; nothing in it is ever run.

meshio parses; whatever it stumbles over becomes one line. The core checks the mesh itself (rust/fem/tetrahedra.rs).
"""

from __future__ import annotations

import io
import json
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import FingerError, brief

_MOST_BYTES = 64 << 20  # of a mesh file; 60 000 tetrahedra take 4 MB
_MOST_TEXT = 1 << 20  # of a file of guides
_FARTHEST = 1e9  # of any unit: beyond any finger, and far from where float64 overflows
_KINDS = ("tetra", "tetra10")


def read_tetrahedra(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the nodes (n, 3) of a mesh file, in its own frame and unit, and its tetrahedra (E, 4) or (E, 10).

    Raises FingerError when the file is no mesh, meshio is absent, or there are no tetrahedra of one kind.
    """
    _check(path, _MOST_BYTES, "a mesh; give a VTK (.vtk) or Gmsh (.msh) file")
    mesh = _parsed(path)
    blocks = {kind: [b.data for b in mesh.cells if b.type == kind] for kind in _KINDS}
    there = {kind: found for kind, found in blocks.items() if found}
    if len(there) != 1:
        types = ", ".join(sorted({str(b.type) for b in mesh.cells})[:8]) or "nothing"
        raise FingerError(
            f"{path}: holds {types}; expected tetrahedra of 4 or of 10 nodes, all alike: mesh the volume and save it"
        )
    points = np.asarray(mesh.points)
    cells = np.concatenate(next(iter(there.values())))
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "fiu" or cells.dtype.kind not in "iu":
        raise FingerError(f"{path}: points of shape {points.shape}, expected (n, 3) numbers; export it again")
    if not np.all(np.abs(points) < _FARTHEST):
        raise FingerError(f"{path}: a point beyond ±{_FARTHEST:g} or not a number; export it again")
    _check_joined(path, np.asarray(points, np.float64), cells)
    return np.ascontiguousarray(points, np.float64), np.ascontiguousarray(cells, np.int64)


def _check_joined(path: Path, points: NDArray[np.float64], cells: NDArray[np.int64]) -> None:
    """Refuse cells given twice, which count twice, and nodes at one place, where cells touch and are not joined."""
    twice = len(cells) - len(np.unique(np.sort(cells[:, :4], axis=1), axis=0))
    if twice:
        raise FingerError(f"{path}: {twice} of {len(cells)} tetrahedra are there twice; save each once")
    grid = max(float(np.ptp(points, axis=0).max(initial=0.0)), 1e-300) * 1e-9
    apart = len(points) - len(np.unique(np.rint(points / grid), axis=0))
    if apart:
        raise FingerError(
            f"{path}: {apart} of {len(points)} nodes lie where another one does, so that cells touch and are not "
            "joined; merge coincident nodes and save again"
        )


def read_guides(path: Path) -> tuple[tuple[float, float, float], ...]:
    """Return the guides of a tendon from a JSON list of [x, y, z], in the mesh file's frame. Raises FingerError."""
    _check(path, _MOST_TEXT, "guides; give a JSON list of [x, y, z]")
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
        points = tuple((float(x), float(y), float(z)) for x, y, z in rows)
    except (OSError, ValueError, TypeError, OverflowError, RecursionError) as error:
        raise FingerError(f"{path}: not a JSON list of [x, y, z] ({brief(error)}); give one row a guide") from None
    if not 2 <= len(points) <= 1000 or not all(abs(v) < _FARTHEST for point in points for v in point):
        raise FingerError(f"{path}: {len(points)} guides; allowed are 2 to 1000, each number within ±{_FARTHEST:g}")
    return points


def _check(path: Path, most: int, what: str) -> None:
    try:
        size = path.stat().st_size if path.is_file() else -1
    except (OSError, ValueError):
        size = -1
    if size < 0:
        raise FingerError(f"{path}: is not there or not a file of {what}, relative to the finger's file")
    if size > most:
        raise FingerError(f"{path}: {size} bytes, at most {most} are read as {what}")


def _parsed(path: Path) -> Any:
    try:
        import meshio
    except ImportError:
        raise FingerError("mesh files need meshio: pip install 'softmap-edge[mesh]'") from None
    # The readers themselves: meshio.read ends the process where it finds no reader.
    readers = {".vtk": meshio.vtk.read, ".msh": meshio.gmsh.read}
    if path.suffix.lower() not in readers:
        raise FingerError(f"{path}: known are {' and '.join(readers)}; save the mesh as one of them")
    try:
        # It also talks: to the terminal, in colours.
        with warnings.catch_warnings(), redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            warnings.simplefilter("ignore")
            mesh = readers[path.suffix.lower()](str(path))
        if not isinstance(mesh, meshio.Mesh):
            raise ValueError(f"no mesh in it, {type(mesh).__name__}")
        return mesh
    # A parser of text formats may fail in any way on a damaged file; all of them mean the same here.
    except (Exception, SystemExit) as error:
        raise FingerError(
            f"{path}: cannot be read as {path.suffix} ({type(error).__name__}: {brief(error)}); export it again"
        ) from None
