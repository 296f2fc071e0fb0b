"""Point clouds from files: every format as its writers write it, and what is no cloud is reported
in one line.
"""

import json
import struct

import meshio
import numpy as np
import pytest

from softmap_edge import builtin_model
from softmap_edge.alignment.clouds import clouds_of, read_clouds
from softmap_edge.cli import main
from softmap_edge.errors import RegistrationError, RunError
from softmap_edge.run.run import Run

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
    "form",
    ["ascii.ply", "binary.ply", "camera.ply", "plain.csv", "named.csv", "blanks.csv", "points.npz"],
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
        np.savetxt(
            path,
            colours,
            delimiter=mark,
            header="x,y,z,red" if form == "named.csv" else "",
            comments="",
        )
        if form != "named.csv":
            path.write_text(path.read_text().lstrip("\n"))
    run = read_clouds([path, path])
    assert run.frames == 2 and run.channels == 0
    for cloud in clouds_of(run):
        np.testing.assert_allclose(cloud, POINTS, rtol=1e-6)


def test_a_run_of_clouds_is_read_completely_and_points_that_are_not_finite_are_left_out(tmp_path):
    run = Run(
        t=np.arange(3.0),
        command=np.zeros((3, 2)),
        t_seen=np.arange(2.0),
        points=POINTS,
        start=[0, 50, 200],
    )
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
    np.savez(path, cloud=POINTS, other=POINTS)


def flat(path):
    np.savez(path, points=POINTS.ravel())


@pytest.mark.parametrize(
    "spoil, suffix",
    [(f, s) for f in (nothing, binary) for s in (".ply", ".csv", ".npz")]
    + [(short_ply, ".ply"), (huge_ply, ".ply"), (two_columns, ".csv"), (words, ".csv")]
    + [(objects, ".npz"), (other_arrays, ".npz"), (flat, ".npz"), (words, ".xyz")],
)
def test_what_is_no_cloud_is_reported_in_one_line(spoil, suffix, tmp_path):
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


def test_a_run_of_several_clouds_next_to_other_files_is_refused(tmp_path):
    run = Run(
        t=np.arange(3.0),
        command=np.zeros((3, 2)),
        t_seen=np.arange(2.0),
        points=POINTS,
        start=[0, 50, 200],
    )
    run.save(tmp_path / "run.npz")
    np.savez(tmp_path / "one.npz", points=POINTS)
    np.savez(tmp_path / "timeless.npz", points=POINTS, start=[0, 50, 200])
    for files in (["one.npz", "run.npz"], ["run.npz", "one.npz"], ["run.npz", "run.npz"]):
        with pytest.raises(
            RegistrationError,
            match=r"run\.npz: a run of 2 clouds.*give it alone, or one cloud a file",
        ):
            read_clouds([tmp_path / file for file in files])
    with pytest.raises(
        RegistrationError, match=r"timeless\.npz: `start` of 2 clouds without `t_seen`"
    ):
        read_clouds([tmp_path / "timeless.npz"])
    run.at([1]).save(tmp_path / "single.npz")
    assert [
        len(c) for c in clouds_of(read_clouds([tmp_path / "one.npz", tmp_path / "single.npz"]))
    ] == [200, 150]


@pytest.mark.parametrize(
    "header, order, note",
    [
        ("y,x,z", [1, 0, 2], ""),
        ("# Z [mm],X [mm],Y [mm]", [2, 0, 1], ""),
        ('red,"z_mm","y_mm","x_mm"', [None, 2, 1, 0], ""),
        ("nx;X;Y;Z;vx", [None, 0, 1, 2, None], ""),
        (
            "Points:0,Points:1,Points:2",
            [0, 1, 2],
            "names no x, y, z; Points:0, Points:1, Points:2 are taken",
        ),
        ("a,b,c,d", [0, 1, 2, None], "names no x, y, z; columns 1, 2, 3 are taken"),
    ],
)
def test_columns_are_those_that_the_header_names(header, order, note, tmp_path):
    rows = np.column_stack(
        [np.full(len(POINTS), 7.0) if k is None else POINTS[:, k] for k in order]
    )
    np.savetxt(
        tmp_path / "c.csv",
        rows,
        delimiter=";" if ";" in header else ",",
        header=header,
        comments="",
    )
    notes = []
    np.testing.assert_allclose(clouds_of(read_clouds([tmp_path / "c.csv"], notes))[0], POINTS)
    assert len(notes) == bool(note) and note in "".join(notes)


@pytest.mark.parametrize(
    "header, says",
    [("x,y,depth", "not each"), ("x,y,z,x", "not each"), ("x_m,y_m,z_m", "states m;")],
)
def test_a_header_of_other_columns_or_units_is_refused(header, says, tmp_path):
    rows = POINTS if header.count(",") == 2 else np.column_stack([POINTS, POINTS[:, 0]])
    np.savetxt(tmp_path / "c.csv", rows, delimiter=",", header=header, comments="")
    with pytest.raises(RegistrationError, match=says):
        read_clouds([tmp_path / "c.csv"])


def test_points_that_are_left_out_are_reported(tmp_path, capsys):
    cloud = builtin_model().prior.evaluate(np.array([[4.0, -2.0]])).reshape(-1, 3)
    cloud[:30] = np.nan
    files = [str(tmp_path / f"{k}.csv") for k in range(7)]
    for path in files:
        np.savetxt(path, cloud, delimiter=",")
    assert main(["run", "register", *files, "--out", str(tmp_path / "run.npz")]) == 0
    said = capsys.readouterr().out
    assert (
        f"look at: 4.csv: 30 of {len(cloud)} points are not finite and are left out\n  and 2 more"
        in said
    )
    assert "5.csv" not in said
    assert main(["run", "register", *files, "--out", str(tmp_path / "again.npz"), "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["notes"]) == 7
