"""Mesh files as others write them: XML by its content, materials by their names, damage and malice
in a child.
"""

import json
import shutil
from pathlib import Path

import meshio
import numpy as np
import pytest
from foreign_meshes import (
    CELLS,
    HARD,
    NODES,
    ascii_vtu,
    base64_vtu,
    fenics,
    gmsh22,
    gmsh41,
    raw_vtu,
    scalars,
)
from small_solids import SIZE, mesh_finger, sag

from softmap_edge.cli import main
from softmap_edge.errors import FingerError
from softmap_edge.fem.doubts import doubts
from softmap_edge.fem.finger import Finger, Region
from softmap_edge.fem.mesh_file import read_mesh
from softmap_edge.fem.simulator import Simulator

CASES = Path(__file__).parents[1] / "data/meshes"


# --- XML -----------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", ["vtu", "vtk"])
def test_the_case_in_xml_is_built(kind, tmp_path, capsys):
    finger = str(CASES / f"finger_{kind}.toml")
    assert main(["build", finger, "--out", str(tmp_path / "b"), "--steps", "5"]) == 0
    assert "look at" not in capsys.readouterr().out


def legacy(path):
    meshio.write(path, meshio.Mesh(NODES, [("tetra", CELLS)]), file_format="vtk42", binary=True)


@pytest.mark.parametrize("write", [ascii_vtu, base64_vtu, raw_vtu, legacy])
@pytest.mark.parametrize("name", ["bar.vtk", "bar.vtu", "bar.msh", "bar"])
def test_the_content_decides_and_not_the_ending(write, name, tmp_path):
    write(tmp_path / name)
    mesh = read_mesh(tmp_path / name)
    np.testing.assert_allclose(mesh.points, NODES, atol=1e-9)
    np.testing.assert_array_equal(np.sort(mesh.cells, axis=None), np.sort(CELLS, axis=None))
    assert not mesh.groups


@pytest.mark.parametrize("write", [ascii_vtu, raw_vtu])
def test_a_version_that_meshio_does_not_know_is_read(write, tmp_path):
    write(tmp_path / "bar.vtu")
    content = (tmp_path / "bar.vtu").read_bytes()
    (tmp_path / "bar.vtu").write_bytes(
        content.replace(b'" version="1.0" byte', b'" version="2.2" byte')
    )
    np.testing.assert_allclose(read_mesh(tmp_path / "bar.vtu").points, NODES, atol=1e-9)


@pytest.mark.parametrize(
    "content, says",
    [
        (b"solid bar\nfacet normal 0 0 1\n", "an STL surface: mesh its volume first"),
        (b"\x89HDF\r\n\x1a\n", "an HDF5 file"),
        (b"<svg/>", "XML, but not VTK"),
        (b'<VTKFile type="PolyData" version="0.1"><PolyData/></VTKFile>', "holds VTK's PolyData"),
        (
            b'<VTKFile type="UnstructuredGrid"><Piece NumberOfCells="3"/><Piece NumberOfCells="4"/>',
            "2 pieces of 3, 4",
        ),
        (b"", "is empty"),
        (bytes(range(256)), "not a known mesh"),
    ],
)
def test_what_is_no_mesh_of_tetrahedra_is_named(content, says, tmp_path):
    (tmp_path / "bar.vtu").write_bytes(content)
    with pytest.raises(FingerError, match=says) as fault:
        read_mesh(tmp_path / "bar.vtu")
    assert "\n" not in str(fault.value) and "bar.vtu" in str(fault.value)


# --- malice --------------------------------------------------------------------------------
def bomb(path):
    entities = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 12))
    path.write_text(
        '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY e0 '
        f'"aaaaaaaaaa">{entities}]><VTKFile>&e11;</VTKFile>'
    )


def many_nodes(path):
    path.write_text(
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n99999999999\n1 0 0 0\n$EndNodes\n"
    )


def many_cells(path):
    path.write_text(
        "# vtk DataFile Version 4.2\nx\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 99999999999 "
        "float\n1 2 3\n"
    )


@pytest.mark.parametrize("write", [bomb, many_nodes, many_cells])
def test_what_claims_too_much_ends_in_the_child(write, tmp_path):
    write(tmp_path / "m.vtu")
    with pytest.raises(FingerError, match="cannot be read as") as fault:
        read_mesh(tmp_path / "m.vtu")
    assert "\n" not in str(fault.value)


# --- several materials ---------------------------------------------------------------------
def test_the_case_of_two_materials_names_them_and_gives_one_its_own_modulus(tmp_path, capsys):
    for name in ("beam.msh", "finger.toml"):
        shutil.copy(CASES / name, tmp_path / name)
    finger = tmp_path / "finger.toml"
    line = (
        "look at: beam.msh names 2 groups of cells; silicone (20 cells), hard_tip (22 cells) get "
        "young_mpa = 0.4"
    )
    assert main(["build", str(finger), "--out", str(tmp_path / "b"), "--steps", "5"]) == 0
    assert line in capsys.readouterr().out
    finger.write_text(finger.read_text() + '[[region]]\nname = "hard_tip"\nyoung_mpa = 4.0\n')
    assert main(["build", str(finger), "--out", str(tmp_path / "c"), "--steps", "5", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["notes"] == []


def two_arrays(path):
    data = {
        "material": [1 + HARD.astype(int)],
        "half": [(NODES[CELLS].mean(axis=1)[:, 0] > 0).astype(int)],
    }
    meshio.write(path, meshio.Mesh(NODES, [("tetra", CELLS)], cell_data=data), file_format="vtu")


MATERIALS = [
    (gmsh22, "hard", ["soft part", "hard"]),
    (lambda path: gmsh22(path, names=False), "2", ["1", "2"]),
    (gmsh41, "hard", ["hard"]),
    (scalars, "7", ["5", "7"]),
    (fenics, "2", ["1", "2"]),
    (two_arrays, "material=2", ["material=1", "material=2", "half=0", "half=1"]),
]


def finger_of(folder, write, tail=""):
    """The finger of a mesh file; `tail` joins its [mesh]."""
    finger = mesh_finger(folder / "bar.vtk", NODES, CELLS, tail=tail)
    write(folder / "bar.vtk")
    return finger


@pytest.mark.parametrize(
    "write, hard, names", MATERIALS, ids=["named", "tags", "4.1", "scalars", "fenics", "two"]
)
def test_a_named_region_is_what_a_box_of_its_cells_is(write, hard, names, tmp_path):
    finger = finger_of(tmp_path, write)
    assert list(read_mesh(tmp_path / "bar.vtk").groups) == names
    (line,) = doubts(finger)
    assert all(f"{name} (" in line for name in names) and "get young_mpa" in line
    named = finger.replace(regions=(Region(2.0, name=hard),))
    boxed = finger.replace(regions=(Region(2.0, z=(0.0, SIZE[2] / 2)),))
    assert abs(sag(finger)) > 1.2 * abs(sag(boxed))
    np.testing.assert_allclose(sag(named), sag(boxed), rtol=1e-9)
    finer = [sag(f.other_mesh()) for f in (named, boxed, finger)]
    np.testing.assert_allclose(finer[0], finer[1], rtol=1e-9)
    assert abs(finer[2]) > 1.2 * abs(finer[0])
    left = [name for name in names if name != hard]
    assert len(doubts(named)) == (len(left) > 1)


def test_a_box_of_a_named_region_is_what_both_hold(tmp_path):
    finger = finger_of(tmp_path, gmsh22)
    both = finger.replace(regions=(Region(2.0, name="hard", z=(0.25 * SIZE[2], 1e3)),))
    boxed = finger.replace(regions=(Region(2.0, z=(0.25 * SIZE[2], 0.5 * SIZE[2])),))
    np.testing.assert_allclose(sag(both), sag(boxed), rtol=1e-9)


def test_named_regions_are_kept_and_checked(tmp_path):
    finger = finger_of(tmp_path, gmsh22)
    named = finger.replace(
        regions=(Region(2.0, name="soft part"), Region(1.0, name="hard", side_deg=90.0))
    )
    assert Finger.from_toml(named.to_toml()) == named and not doubts(named)
    with pytest.raises(FingerError, match="has no group 'top'; it names soft part, hard"):
        Simulator(finger.replace(regions=(Region(2.0, name="top"),)))
    with pytest.raises(FingerError, match="only the cells of a .mesh. file have names"):
        Finger.builtin().replace(regions=(Region(2.0, name="tip"),))
    with pytest.raises(FingerError, match="give at least one of x_mm, y_mm, z_mm, side_deg, name"):
        finger.replace(regions=(Region(2.0),))


def one_material(path):
    data = {"MaterialIds": [np.full(len(CELLS), 3)], "id": [np.arange(100, 100 + len(CELLS))]}
    meshio.write(path, meshio.Mesh(NODES, [("tetra", CELLS)], cell_data=data), file_format="vtu")


def surface_too(path):
    """Physical surfaces, and one volume: no second material."""
    cells = [("triangle", CELLS[:4, :3]), ("tetra", CELLS)]
    tags = [np.array([4, 4, 5, 5], np.int32), np.ones(len(CELLS), np.int32)]
    mesh = meshio.Mesh(NODES, cells, cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags})
    mesh.field_data = {"skin": np.array([4, 2]), "back": np.array([5, 2]), "body": np.array([1, 3])}
    meshio.write(path, mesh, file_format="gmsh22", binary=False)


@pytest.mark.parametrize("write", [one_material, surface_too, legacy])
def test_one_material_is_not_worth_a_line(write, tmp_path):
    assert doubts(finger_of(tmp_path, write)) == []
