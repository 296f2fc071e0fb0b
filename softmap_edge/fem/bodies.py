"""The solid of a finger: a round tapered body, a plain block, or an imported mesh of tetrahedra.

Each reads its part of `finger.toml`, makes its cells in the compiled core, and defines another mesh
of the same solid. The base frame has its origin at the centre of the clamped base, with z to the
tip. Nodes at z = 0 or below are fixed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import FingerError
from softmap_edge.fem.numbers import (
    COMPARE,
    Pairs,
    Vector,
    check_count,
    check_keys,
    check_pairs,
    check_vector,
    listed,
    rows,
    sequence,
    shown,
)
from softmap_edge.files.atomic import Document
from softmap_edge.files.toml import quoted

Floats = NDArray[np.float64]

_MOST_CORE = 16
_MOST_LAYERS = 400
_UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}
_KEYS = ("profile_mm", "block", "mesh")  # of the top level


@dataclass(frozen=True)
class Tapered:
    """A round body: (z, radius) pairs in mm from z = 0.

    It also holds the cells across the core, rings around it, and layers along z.
    """

    profile: Pairs
    core: int
    rings: int
    layers: int

    def __post_init__(self) -> None:
        check_pairs("profile_mm", self.profile)
        if self.profile[0][0] != 0.0 or min(radius for _, radius in self.profile) <= 0:
            raise FingerError(
                "profile_mm: z must start at 0 and each radius above 0 mm; measure from the base"
            )
        for field, most in (("core", _MOST_CORE), ("rings", 16), ("layers", _MOST_LAYERS)):
            check_count(f"mesh.{field}", getattr(self, field), 1, most, "3, 1, 42 is usual")

    @property
    def height_mm(self) -> float:
        """Height from the clamped base to the tip, mm."""
        return self.profile[-1][0]

    def cells(self, ends: Sequence[float]) -> _core.Mesh:
        """Return the cells; `ends` are the heights in mm where tendons start and end."""
        return _core.Mesh.finger(list(self.profile), list(ends), self.core, self.rings, self.layers)

    def other_mesh(self) -> Tapered:
        """Return the same solid on another mesh, finer where allowed."""
        core = self.core + 1 if self.core < _MOST_CORE else self.core - 1
        return replace(self, core=core, layers=max(1, round(self.layers * 0.9)))

    def along(self, share: float) -> Tapered:
        """Return the same solid with another number of layers along z."""
        return replace(self, layers=min(_MOST_LAYERS, max(1, round(share * self.layers))))

    def to_toml(self) -> tuple[str, str]:
        """Return the lines of the file's top level and its tables."""
        mesh = f"\n[mesh]\ncore = {self.core}\nrings = {self.rings}\nlayers = {self.layers}"
        return f"profile_mm = {listed(self.profile)}", mesh


@dataclass(frozen=True)
class Block:
    """A block: width, depth and height in mm, x and y through its middle; cells each way."""

    size: Vector
    cells_each_way: tuple[int, int, int]

    def __post_init__(self) -> None:
        check_vector("block.size_mm", self.size, 0.1, 2000.0, "measure width, depth and height")
        if len(self.cells_each_way) != 3:
            raise FingerError(
                f"block.cells: {shown(list(self.cells_each_way))}; expected three numbers, as [4, "
                "4, 20]"
            )
        for count in self.cells_each_way:
            check_count("block.cells", count, 1, _MOST_LAYERS, "[4, 4, 20] is usual")

    @property
    def height_mm(self) -> float:
        """Height from the clamped base to the tip, mm."""
        return self.size[2]

    def cells(self, ends: Sequence[float]) -> _core.Mesh:
        """Return the cells; a tendon ends at the layer below its declared end."""
        return _core.Mesh.block(self.size, self.cells_each_way)

    def other_mesh(self) -> Block:
        """Return the same solid with finer cells."""
        x, y, z = self.cells_each_way
        return replace(
            self, cells_each_way=(x + 1, y + 1, min(_MOST_LAYERS, max(z + 1, round(1.2 * z))))
        )

    def along(self, share: float) -> Block:
        """Return the same solid with another number of layers along z."""
        x, y, z = self.cells_each_way
        return replace(self, cells_each_way=(x, y, min(_MOST_LAYERS, max(1, round(share * z)))))

    def to_toml(self) -> tuple[str, str]:
        """Return the lines of the file's top level and its tables."""
        return (
            "",
            f"\n[block]\nsize_mm = {listed(self.size)}\ncells = {list(self.cells_each_way)!r}",
        )


@dataclass(frozen=True)
class Meshed:
    """A mesh file of tetrahedra, and its pose in the base frame.

    file: VTK, VTU or Gmsh · unit: of its coordinates · axes: which of the file's axes are x, y and
    z of the base frame, as ("z", "x", "y") or with a minus · origin: the base frame's origin in the
    file's axes, mm · refine: how often each cell is split into eight.
    """

    file: str
    unit: str = "mm"
    axes: tuple[str, str, str] = ("x", "y", "z")
    origin: Vector = (0.0, 0.0, 0.0)
    refine: int = 0

    def __post_init__(self) -> None:
        if (
            not isinstance(self.file, str)
            or not 1 <= len(self.file) <= 1000
            or not self.file.isprintable()
        ):
            raise FingerError(
                "mesh.file: expected the name of a VTK, VTU or Gmsh file, relative to this file"
            )
        if not isinstance(self.unit, str) or self.unit not in _UNITS:
            raise FingerError(f"mesh.unit: {shown(self.unit)}; allowed are {', '.join(_UNITS)}")
        check_vector(
            "mesh.origin_mm", self.origin, -1e5, 1e5, "give a point of the file's frame in mm"
        )
        check_count("mesh.refine", self.refine, 0, 3, "0 is usual, 1 has eight times the cells")
        self._turn()

    @property
    def height_mm(self) -> None:
        """Unknown before the file is read; the core checks what depends on it."""
        return None

    def place(self, points: Floats) -> Floats:
        """Return points (n, 3) of the file in the base frame, mm."""
        return np.ascontiguousarray(
            (np.asarray(points, float) * _UNITS[self.unit] - self.origin) @ self._turn().T
        )

    def cells(self, ends: Sequence[float]) -> _core.Mesh:
        """Read the file and return its cells.

        Raises FingerError, CoreError with one line for a bad mesh.
        """
        from softmap_edge.fem.mesh_file import read_mesh

        mesh = read_mesh(Path(self.file))
        return _core.Mesh.tetrahedra(self.place(mesh.points), mesh.cells, self.refine)

    def nodes(self) -> Floats:
        """Return the nodes (n, 3) mm of the file in the base frame. Raises FingerError."""
        from softmap_edge.fem.mesh_file import read_mesh

        return self.place(read_mesh(Path(self.file)).points)

    def groups(self) -> dict[str, NDArray[np.bool_]]:
        """Return a mask of the refined mesh's cells (E,) for each group of the file, by name.

        Raises FingerError.
        """
        from softmap_edge.fem.mesh_file import read_mesh

        groups = read_mesh(Path(self.file)).groups
        return {name: np.repeat(inside, 8**self.refine) for name, inside in groups.items()}

    def other_mesh(self) -> Meshed:
        """Return the same solid with each cell split into eight."""
        return replace(self, refine=self.refine + 1)

    def along(self, share: float) -> Meshed:
        """Return the refined mesh: an imported mesh has no layers to choose."""
        return self.other_mesh()

    def to_toml(self) -> tuple[str, str]:
        """Return the lines of the file's top level and its tables."""
        lines = [f"\n[mesh]\nfile = {quoted(self.file)}\nunit = {quoted(self.unit)}"]
        lines.append(
            f"axes = [{', '.join(map(quoted, self.axes))}]\norigin_mm = {listed(self.origin)}"
        )
        return "", "\n".join([*lines, f"refine = {self.refine}"])

    def _turn(self) -> Floats:
        """Return the rotation (3, 3) from the file's frame to the base frame."""
        turn = np.zeros((3, 3))
        for row, axis in enumerate(self.axes if len(self.axes) == 3 else ()):
            if isinstance(axis, str) and axis.lstrip("+-") in ("x", "y", "z") and len(axis) <= 2:
                turn[row, "xyz".index(axis[-1])] = -1.0 if axis[0] == "-" else 1.0
        if round(float(np.linalg.det(turn))) != 1:
            raise FingerError(
                f"mesh.axes: {shown(list(self.axes))}; expected the file's axes that are x, y and "
                "z of the base frame, "
                'right-handed, as ["z", "x", "y"] for a finger along y'
            )
        return turn


Solid = Tapered | Block | Meshed


def solid_from(document: Document, folder: Path) -> Solid:
    """Return the solid of a file; `folder` is the base of relative file names.

    Raises FingerError.
    """
    given = [key for key in _KEYS if key in document]
    mesh = document.get("mesh")
    if "mesh" in document and not isinstance(mesh, dict):
        raise FingerError(
            "mesh: expected a table [mesh] with core, rings, layers, or with the file of a mesh"
        )
    if given == ["profile_mm", "mesh"] and mesh is not None and "file" not in mesh:
        check_keys("mesh", mesh, ("core", "rings", "layers"))
        return Tapered(rows("profile_mm", document["profile_mm"]), **mesh)
    if given == ["block"]:
        block = document["block"]
        if not isinstance(block, dict):
            raise FingerError("block: expected a table [block] with size_mm, cells")
        check_keys("block", block, ("size_mm", "cells"))
        return Block(
            sequence("block.size_mm", block["size_mm"]), sequence("block.cells", block["cells"])
        )
    if given == ["mesh"] and mesh is not None and "file" in mesh:
        check_keys("mesh", mesh, ("file",), ("unit", "axes", "origin_mm", "refine"))
        parts = {key: mesh[key] for key in ("unit", "refine") if key in mesh}
        if "axes" in mesh:
            parts["axes"] = sequence("mesh.axes", mesh["axes"])
        if "origin_mm" in mesh:
            parts["origin"] = sequence("mesh.origin_mm", mesh["origin_mm"])
        file = mesh["file"]
        return Meshed(
            str(folder / file) if isinstance(file, str) and "\0" not in file else "", **parts
        )
    lacking = {
        "profile_mm": "'mesh' is missing",
        "mesh": "'profile_mm' is missing",
        "": "'profile_mm' is missing",
    }
    there = " and ".join(given)
    raise FingerError(
        f"the file: {lacking.get(there, there + ' given')}; the solid is profile_mm with [mesh] "
        f"(core, rings, layers), or [block], or [mesh] with a file; {COMPARE}"
    )
