"""Damaged clouds and meshes give an error of ours: no crash, no hang, no memory without bound.

Each format is one line of FORMATS; `damage.py` says how files are spoiled and used. 50 of each
here, 500 and 10 000 by `make prove`.
"""

import contextlib
import io
import resource

import damage
import numpy as np
import pytest
from damage import (
    Format,
    assert_10000,
    assert_some,
    run_all,
    spoil_bytes,
    spoil_npz_file,
    spoil_text,
    spoil_text_file,
)

MOST = 1 << 30  # bytes that one file may take
SLOWEST = 10.0  # s


# --- sound samples -------------------------------------------------------------------------
def text_sample(name):
    def sample(folder):
        from clouds_of_others import TEXTS

        lines = TEXTS[name].split("\n")
        # damage meets the head as often as the rows
        (folder / name).write_text("\n".join(lines[:24]) + "\n")
        return folder / name

    return sample


def pcd_sample(kind):
    def sample(folder):
        from clouds_of_others import pcd

        pcd(folder / "c.pcd", kind)
        return folder / "c.pcd"

    return sample


def ply_sample(order, faces_first):
    def sample(folder):
        from clouds_of_others import ply

        ply(folder / "c.ply", order, faces_first)
        return folder / "c.ply"

    return sample


def npy_sample(folder):
    np.save(folder / "c.npy", np.random.default_rng(0).uniform(-60, 60, (40, 5)))
    return folder / "c.npy"


def npz_sample(folder):
    np.savez(folder / "c.npz", np.random.default_rng(0).uniform(-60, 60, (40, 3)), np.zeros(3))
    return folder / "c.npz"


# --- damage --------------------------------------------------------------------------------
def spoil_head_or_rest(sample, folder, rng):
    """Injure the text of a header half of the time, else any bytes."""
    data = sample.read_bytes()
    end = next(
        k
        for mark in (
            b"end_header\n",
            b"binary_compressed\n",
            b"binary\n",
            b"ascii\n",
            b"}",
            b"</Points>",
        )
        if (k := data.find(mark) + len(mark)) >= len(mark)
    )
    head = rng.random() < 0.5
    bad = (
        spoil_text(data[:end].decode("latin-1"), rng) + data[end:]
        if head
        else spoil_bytes(data, rng)
    )
    (folder / sample.name).write_bytes(bad)
    return folder / sample.name


# --- use -----------------------------------------------------------------------------------
def use_cloud(path):
    from softmap_edge.alignment.clouds import clouds_of, read_clouds

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    notes = []
    (cloud,) = clouds_of(read_clouds([path], notes))
    assert (
        cloud.shape[1] == 3 and np.isfinite(cloud).all() and all("\n" not in note for note in notes)
    )
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) << 10 < MOST


def use_run_or_cloud(path):
    from softmap_edge.alignment.clouds import read_clouds

    read_clouds([path])


# --- meshes --------------------------------------------------------------------------------
def mesh_sample(write):
    def sample(folder):
        import foreign_meshes

        with contextlib.redirect_stderr(io.StringIO()):  # meshio warns that text is slow
            getattr(foreign_meshes, write)(folder / "bar")
        return folder / "bar"

    return sample


def use_mesh(path):
    from softmap_edge.fem.bodies import Meshed

    solid = Meshed(str(path))
    mesh = solid.cells([])
    assert all(len(inside) == len(mesh.cells) for inside in solid.groups().values())


CLOUDS = [
    *(Format(f"cloud {name}", text_sample(name), spoil_text_file, use_cloud, 50)
      for name in ("tabs.tsv", "colmap.txt", "mesh.obj", "normals_paraview.csv", "scan.pts")),
    *(Format(f"cloud {kind}.pcd", pcd_sample(kind), spoil_head_or_rest, use_cloud, 50)
      for kind in ("ascii", "binary", "binary_compressed")),
    Format("cloud text.ply", ply_sample("", True), spoil_head_or_rest, use_cloud, 50),
    Format("cloud little.ply", ply_sample("<", False), spoil_head_or_rest, use_cloud, 50),
    Format("cloud big.ply", ply_sample(">", True), spoil_head_or_rest, use_cloud, 50),
    Format("cloud.npy", npy_sample, spoil_head_or_rest, use_cloud, 50),
    Format("cloud.npz", npz_sample, spoil_npz_file, use_run_or_cloud, 50),
]  # fmt: skip
MESHES = [
    Format("VTU of text", mesh_sample("ascii_vtu"), spoil_head_or_rest, use_mesh, 50),
    Format("VTU with raw blocks", mesh_sample("raw_vtu"), spoil_head_or_rest, use_mesh, 50),
    Format("VTU with cell data", mesh_sample("fenics"), spoil_head_or_rest, use_mesh, 50),
    Format("VTK with scalars", mesh_sample("scalars"), spoil_text_file, use_mesh, 50),
    Format("Gmsh 2.2 with names", mesh_sample("gmsh22"), spoil_text_file, use_mesh, 50),
    Format("Gmsh 4.1 with names", mesh_sample("gmsh41"), spoil_text_file, use_mesh, 50),
]
FORMATS = CLOUDS + MESHES


@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_damaged_shapes(form, tmp_path):
    assert_some(__file__, form, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_500_damaged_shapes(form, tmp_path):
    assert_some(__file__, form, tmp_path, 500)


@pytest.mark.prove
@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_10000_damaged_shapes(form, tmp_path):
    assert_10000(__file__, form, tmp_path)


if __name__ == "__main__":
    damage.PATIENCE = SLOWEST
    run_all(FORMATS)
