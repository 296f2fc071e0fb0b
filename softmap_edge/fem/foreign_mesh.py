"""Parse a mesh file with meshio in a child process, as plain arrays and groups of cells.

Groups are the named groups of the file.

The content selects the reader, not the file name: legacy VTK, VTK's XML (VTU) or Gmsh. Groups are
Gmsh's physical volumes, and cell data that label cells (material ids): integers with few distinct
values.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.files.atomic import Document

if TYPE_CHECKING:
    from meshio import Mesh

KINDS = ("tetra", "tetra10")
# most labels in an array, and least cells per label on average; else they number the cells
MOST_GROUPS, LEAST_CELLS = 64, 3
_HEAD = 4096  # bytes that identify a file format
_MOST_NAMES = 200  # limits of returned groups and cell types
OTHERS = [
    (b"solid", "an STL surface: mesh its volume first"),
    (b"ply", "a PLY surface: mesh its volume first"),
    (b"OFF", "an OFF surface: mesh its volume first"),
    (b"\x89HDF", "an HDF5 file"),
    (b"MeshVersionFormatted", "a Medit mesh"),
    (b"*HEADING", "an Abaqus deck"),
    (b"*NODE", "an Abaqus deck"),
    (b"CDF", "an Exodus file"),
]


def kind_of(path: Path) -> str:
    """Return a file's format by its content: "vtk", "vtu" or "msh"; else raise ValueError."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    if text.startswith(b"# vtk DataFile"):
        return "vtk"
    if text.startswith(b"$"):
        return "msh"
    if b"<VTKFile" in text:
        kind = re.search(rb"""<VTKFile[^>]*\btype\s*=\s*["'](\w+)["']""", text)
        if kind and kind[1] != b"UnstructuredGrid":
            raise ValueError(
                f"holds VTK's {kind[1].decode()[:40]}, expected an UnstructuredGrid of tetrahedra"
            )
        return "vtu"
    if text.startswith(b"<"):
        raise ValueError("is XML, but not VTK's (<VTKFile …>)")
    for mark, what in OTHERS:
        if text.startswith(mark):
            raise ValueError(f"is {what}")
    raise ValueError("is not a known mesh" if text else "is empty")


def parse(path: str, kind: str) -> Document:
    """Return `points` (n, 3), `cells` by kind, the names of all `types`, and `groups`.

    `types` are cell types; `groups` are masks (E,) of cells by name.

    It runs in a child process, and may raise any error.
    """
    import meshio

    if kind == "vtu":
        _check_pieces(Path(path).read_bytes())
        _take_any_version()
    # The readers themselves: meshio.read ends the process where it finds no reader.
    read: dict[str, Callable[[str], object]] = {
        "vtk": meshio.vtk.read,
        "vtu": meshio.vtu.read,
        "msh": meshio.gmsh.read,
    }
    mesh = read[kind](path)
    if not isinstance(mesh, meshio.Mesh):
        raise ValueError(f"no mesh in it, {type(mesh).__name__}")
    types = sorted({str(block.type) for block in mesh.cells})[:_MOST_NAMES]
    there = [name for name in KINDS if name in types]
    cells = {name: np.concatenate([b.data for b in mesh.cells if b.type == name]) for name in there}
    groups = _groups(mesh, there[0], len(cells[there[0]])) if len(there) == 1 else {}
    return {"points": np.asarray(mesh.points), "cells": cells, "types": types, "groups": groups}


def _check_pieces(content: bytes) -> None:
    """Reject several pieces: meshio keeps only the cells of the last one."""
    pieces = [
        int(n)
        for n in re.findall(rb"""<Piece\b[^>]*\bNumberOfCells\s*=\s*["'](\d{1,12})["']""", content)
    ]
    if len(pieces) > 1:
        raise ValueError(
            f"{len(pieces)} pieces of {', '.join(map(str, pieces[:5]))} cells; merge them into one"
        )


def _take_any_version() -> None:
    """Let meshio read unknown versions, in this process only: tetrahedra are the same in all."""
    from xml.etree import ElementTree

    parse_file, from_text = ElementTree.parse, ElementTree.fromstring

    def parse(
        source: str, parser: ElementTree.XMLParser | None = None
    ) -> ElementTree.ElementTree[ElementTree.Element]:
        tree = parse_file(source, parser)
        tree.getroot().attrib.pop("version", None)
        return tree

    def fromstring(text: str, parser: ElementTree.XMLParser | None = None) -> ElementTree.Element:
        root = from_text(text, parser)
        root.attrib.pop("version", None)
        return root

    vars(ElementTree).update(parse=parse, fromstring=fromstring)


def _groups(mesh: Mesh, kind: str, count: int) -> dict[str, NDArray[np.bool_]]:
    """Return a mask of the `count` cells of a kind for each group, by name.

    The value is None if a group holds all cells or none.
    """
    blocks = [k for k, block in enumerate(mesh.cells) if block.type == kind]
    labels = {str(name): _label(data, blocks, count) for name, data in mesh.cell_data.items()}
    groups = _sets(mesh, blocks)
    physical = labels.pop("gmsh:physical", None)
    if physical is not None and physical.any():
        labels.pop("gmsh:geometrical", None)
        if not groups:
            groups = _named(mesh, physical)
    if not groups:
        several = {name: values for name, values in labels.items() if values is not None}
        for name, values in several.items():
            for value in np.unique(values):
                groups[f"{value}" if len(several) == 1 else f"{name}={value}"] = values == value
    groups = {_clean(name): inside for name, inside in groups.items() if inside.any()}
    some = {name: inside for name, inside in groups.items() if not inside.all()}
    return dict(list(some.items())[:_MOST_NAMES])


def _label(data: Sequence[object], blocks: list[int], count: int) -> NDArray[np.int64] | None:
    """Return the labels (E,) of the cells if an array holds labels.

    Labels are integers with few distinct values, one per cell.
    """
    parts = [np.asarray(data[k]) for k in blocks]
    values = (
        np.concatenate([part.reshape(len(part), -1) for part in parts])
        if parts
        else np.zeros((0, 1))
    )
    if len(values) != count:
        raise ValueError(f"{len(values)} values of cell data for {count} cells")
    if values.shape[1] != 1 or values.dtype.kind not in "fiub" or not np.isfinite(values).all():
        return None
    if np.any(values % 1) or np.abs(values).max(initial=0) > 1e15:
        return None
    if len(np.unique(values)) > min(MOST_GROUPS, count // LEAST_CELLS):
        return None
    return values[:, 0].astype(np.int64)


def _named(mesh: Mesh, physical: NDArray[np.int64]) -> dict[str, NDArray[np.bool_]]:
    """Return the groups of Gmsh's physical tags, by the names of volumes if there are any."""
    names = {
        int(tag): str(name)
        for name, (tag, dimension) in mesh.field_data.items()
        if int(dimension) == 3
    }
    return {names.get(int(tag), str(tag)): physical == tag for tag in np.unique(physical) if tag}


def _sets(mesh: Mesh, blocks: list[int]) -> dict[str, NDArray[np.bool_]]:
    """Return the named sets of cells; a cell of Gmsh 4.1 may be in several."""
    groups = {}
    for name, parts in mesh.cell_sets.items():
        if str(name).startswith("gmsh:"):
            continue
        inside = [np.zeros(len(mesh.cells[k].data), bool) for k in blocks]
        for place, k in zip(inside, blocks):
            place[np.asarray(parts[k], np.int64)] = True
        groups[str(name)] = np.concatenate(inside)
    return groups


def _clean(name: str) -> str:
    """Return a name in a form for messages."""
    return "".join(c if c.isprintable() else "?" for c in name.strip().strip('"'))[:60] or "?"
