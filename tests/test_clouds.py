"""Point clouds from files: every format as its writers write it, and what is no cloud is said in one line."""

import struct

import meshio
import numpy as np
import pytest

from softmap_edge.errors import RegistrationError, RunError
from softmap_edge.registration.clouds import clouds_of, read_clouds
from softmap_edge.run import Run

POINTS = np.random.default_rng(0).uniform(-60.0, 60.0, (200, 3))


def ply(path, points, binary):
    meshio.Mesh(points, []).write(path, binary=binary)


def camera_ply(path, points):
    """As depth cameras write it: binary, float32, with colours and without faces."""
    head = "ply\nformat binary_little_endian 1.0\ncomment a camera\n"
    head += f"element vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\n"
    head += "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
    rows = b"".join(struct.pack("<fffBBB", *p, 200, 100, 50) for p in points)
    path.write_bytes(head.encode() + rows)


@pytest.mark.parametrize(
    "form", ["ascii.ply", "binary.ply", "camera.ply", "plain.csv", "named.csv", "blanks.csv", "points.npz"]
)
def test_a_cloud_is_read_as_its_writers_write_it(form, tmp_path):
    path = tmp_path / form
    if form == "camera.ply":
        camera_ply(path, POINTS)
    elif path.suffix == ".ply":
        ply(path, POINTS, form == "binary.ply")
    elif path.suffix == ".npz":
        np.savez(path, points=POINTS)
    else:
        mark = " " if form == "blanks.csv" else ","
        colours = np.column_stack([POINTS, np.full(len(POINTS), 7.0)])
        np.savetxt(path, colours, delimiter=mark, header="x,y,z,red" if form == "named.csv" else "", comments="")
        if form != "named.csv":
            path.write_text(path.read_text().lstrip("\n"))
    run = read_clouds([path, path])
    assert run.frames == 2 and run.channels == 0
    for cloud in clouds_of(run):
        np.testing.assert_allclose(cloud, POINTS, rtol=1e-6)


def test_a_run_of_clouds_is_read_whole_and_points_that_are_not_finite_are_left_out(tmp_path):
    run = Run(t=np.arange(3.0), command=np.zeros((3, 2)), t_seen=np.arange(2.0), points=POINTS, start=[0, 50, 200])
    run.save(tmp_path / "run.npz")
    again = read_clouds([tmp_path / "run.npz"])
    assert again.hash() == run.hash() and [len(c) for c in clouds_of(again)] == [50, 150]
    holed = POINTS.copy()
    holed[::10] = np.nan
    np.savetxt(tmp_path / "holed.csv", holed, delimiter=",")
    assert len(clouds_of(read_clouds([tmp_path / "holed.csv"]))[0]) == 180


def nothing(path):
    path.write_bytes(b"")


def binary(path):
    path.write_bytes(bytes(range(256)) * 4)


def short_ply(path):
    camera_ply(path, POINTS)
    path.write_bytes(path.read_bytes()[:-500])


def huge_ply(path):
    path.write_text(
        "ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n"
    )


def two_columns(path):
    np.savetxt(path, POINTS[:, :2], delimiter=",")


def words(path):
    path.write_text("x,y,z\nhere,there,everywhere\n")


def objects(path):
    np.savez(path, points=np.array([None, {}], dtype=object))


def other_arrays(path):
    np.savez(path, cloud=POINTS)


def flat(path):
    np.savez(path, points=POINTS.ravel())


@pytest.mark.parametrize(
    "spoil, suffix",
    [(f, s) for f in (nothing, binary) for s in (".ply", ".csv", ".npz")]
    + [(short_ply, ".ply"), (huge_ply, ".ply"), (two_columns, ".csv"), (words, ".csv")]
    + [(objects, ".npz"), (other_arrays, ".npz"), (flat, ".npz"), (words, ".xyz")],
)
def test_what_is_no_cloud_is_said_in_one_line(spoil, suffix, tmp_path):
    path = tmp_path / f"cloud{suffix}"
    spoil(path)
    with pytest.raises((RegistrationError, RunError)) as fault:
        read_clouds([path])
    assert "\n" not in str(fault.value) and "cloud" in str(fault.value)
    with pytest.raises(RegistrationError, match="no such file"):
        read_clouds([tmp_path / "absent.ply"])


def test_a_run_without_clouds_is_refused(tmp_path):
    run = Run(
        t=np.arange(3.0),
        command=np.zeros((3, 2)),
        t_seen=np.arange(3.0),
        markers=np.zeros((3, 1, 3)) + [[[0, 0, 50.0]]],
    )
    run.save(tmp_path / "run.npz")
    with pytest.raises(RegistrationError, match="without clouds"):
        read_clouds([tmp_path / "run.npz"])
