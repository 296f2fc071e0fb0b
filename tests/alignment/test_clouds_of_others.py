"""Clouds as others write them, and pixels without depth: each gives the points that a plain CSV
gives.
"""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from clouds_of_others import COLOURS, NORMALS, POINTS, RNG, TEXTS, lzf, pcd, ply, rows
from remedy_cases import write_clouds

from softmap_edge import builtin_model
from softmap_edge.alignment.cloud_files.pcd import unpack_lzf
from softmap_edge.alignment.clouds import clouds_of, read_clouds
from softmap_edge.cli import main
from softmap_edge.errors import RegistrationError
from softmap_edge.run.run import Run

CASES = Path(__file__).parents[1] / "data/clouds"
NORMALS /= np.linalg.norm(NORMALS, axis=1, keepdims=True)


# --- the case ------------------------------------------------------------------------------
@pytest.mark.parametrize("path", sorted(CASES.iterdir()), ids=lambda path: path.name)
def test_each_file_of_the_case_registers_as_a_plain_csv_does(path, tmp_path, capsys):
    assert main(["run", "register", str(path), "--out", str(tmp_path / "run.npz"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert round(said["frames"][0]["residual_mm"], 2) == 0.17
    # a guess is reported
    assert bool(said["notes"]) == (path.name in ("paraview.csv", "savez.npz"))
    np.testing.assert_allclose(
        clouds_of(read_clouds([path]))[0],
        clouds_of(read_clouds([CASES / "plain.xyz"]))[0],
        atol=1e-3,
    )


@pytest.mark.parametrize("name", TEXTS)
def test_text_of_others(name, tmp_path):
    (tmp_path / name).write_text(TEXTS[name])
    expected = np.round(POINTS) if name.startswith("whole") else POINTS
    np.testing.assert_allclose(clouds_of(read_clouds([tmp_path / name]))[0], expected, atol=1e-6)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig", "latin-1"])
def test_text_of_other_alphabets(encoding, tmp_path):
    (tmp_path / "c.csv").write_bytes(
        ("# 20 °C\nx,y,z\n" + rows(POINTS, split=",")).encode(encoding)
    )
    np.testing.assert_allclose(clouds_of(read_clouds([tmp_path / "c.csv"]))[0], POINTS, atol=1e-6)


def test_the_guess_is_reported_also_where_the_cloud_is_refused(tmp_path, capsys):
    far = 50.0 * POINTS
    (tmp_path / "c.csv").write_text(rows(np.arange(240), far, split=","))
    notes = []
    read_clouds([tmp_path / "c.csv"], notes)
    guess = (
        "c.csv: its columns have no names; columns 2, 3, 4 are taken for x, y, z; column 1 counts "
        "rows"
    )
    assert notes == [guess]
    assert main(["run", "register", str(tmp_path / "c.csv"), "--out", str(tmp_path / "r.npz")]) != 0
    assert guess in capsys.readouterr().err


@pytest.mark.parametrize(
    "text, says",
    [
        (rows(np.arange(240), POINTS[:, :2], split=","), "2 of 3 columns can be coordinates .column 1 counts rows"),
        ("Points:0,Points:1,Points:2,Pos:0,Pos:1,Pos:2\n" + rows(POINTS, POINTS, split=","), "2 triples"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "an OFF mesh; clouds are read as PLY"),
        ("<?xml version='1.0'?><VTKFile/>", "an XML file"),
        ("20\n12\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n" + rows(POINTS, COLOURS), "PTX"),
        ("x,y,z\n1,2,3\n4,five,6\n7,8,9\n1,2,3\n", "could not convert string"),
    ],
)  # fmt: skip
def test_what_is_no_cloud_or_no_clear_one_is_refused(text, says, tmp_path):
    (tmp_path / "c.csv").write_text(text)
    with pytest.raises(RegistrationError, match=says) as fault:
        read_clouds([tmp_path / "c.csv"])
    assert "\n" not in str(fault.value)


@pytest.mark.parametrize("order", ["", "<", ">"])
@pytest.mark.parametrize("faces_first", [False, True])
def test_ply_of_any_order(order, faces_first, tmp_path):
    ply(tmp_path / "c.ply", order, faces_first)
    notes = []
    np.testing.assert_allclose(
        clouds_of(read_clouds([tmp_path / "c.ply"], notes))[0], POINTS, rtol=1e-6
    )
    assert not notes


@pytest.mark.parametrize("kind", ["ascii", "binary", "binary_compressed"])
def test_pcd_of_any_fields(kind, tmp_path):
    holed = POINTS.copy()
    holed[::8] = np.nan
    pcd(tmp_path / "c.pcd", kind, holed)
    notes = []
    np.testing.assert_allclose(
        clouds_of(read_clouds([tmp_path / "c.pcd"], notes))[0], POINTS[np.arange(240) % 8 > 0]
    )
    assert notes == ["c.pcd: 30 of 240 points are not finite and are left out"]


def test_lzf_unpacks_what_was_packed():
    assert unpack_lzf(b"\x00a\xe0\x10\x00", 26) == b"a" * 26  # a copy that overlaps what it makes
    for data in (b"", b"abcabcabcd" * 99, RNG.bytes(3000), bytes(9000)):
        assert unpack_lzf(lzf(data), len(data)) == data
    for wrong in (b"\x20\x05", b"\x05ab", b"\xe0"):
        with pytest.raises((ValueError, IndexError)):
            unpack_lzf(wrong, 9)


@pytest.mark.parametrize(
    "head",
    [
        "# .PCD\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {n}\nHEIGHT 1\nPOINTS {n}\nDATA "
        "binary\n",
        "# .PCD\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {n}\nHEIGHT 1\nPOINTS {n}\nDATA "
        "ascii\n",
        "# .PCD\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {n}\nHEIGHT 1\nPOINTS {n}\nDATA "
        "binary_compressed\n",
        "ply\nformat ascii 1.0\nelement vertex {n}\nproperty float x\nproperty float y\nproperty "
        "float z\nend_header\n",
        "ply\nformat binary_big_endian 1.0\nelement face {n}\nproperty list uchar int i\nelement "
        "vertex {n}\nproperty float x\nproperty float y\nproperty float z\nend_header\n",
    ],
)
@pytest.mark.parametrize("count", [9_000_000, 10**12, 10**15])
def test_a_header_that_claims_too_much_is_refused_before_memory_is_taken(head, count, tmp_path):
    (tmp_path / "c").write_bytes(head.format(n=count).encode() + b"1 2 3\n" * 150)
    with pytest.raises(RegistrationError, match=r"claim|at most|compressed|lists"):
        read_clouds([tmp_path / "c"])


# --- arrays --------------------------------------------------------------------------------
def arrays():
    named = np.zeros(240, [("rgb", "<u4"), ("Z", "<f4"), ("X", "<f8"), ("Y", "<f8")])
    named["X"], named["Y"], named["Z"] = POINTS.T
    return {
        "plain.npy": POINTS,
        "fortran.npy": np.asfortranarray(POINTS),
        "big.npy": POINTS.astype(">f8"),
        "columns.npy": POINTS.T,
        "image.npy": POINTS.reshape(24, 10, 3),
        "fields.npy": named,
        "colours.npy": np.hstack([COLOURS, POINTS]),
        "unnamed.npz": [POINTS],
        "coloured.npz": [COLOURS.astype(np.uint8), POINTS],
        "named.npz": {"pcd": POINTS, "stamp": np.array(3.0)},
        "fields.npz": [named],
    }


@pytest.mark.parametrize("name", arrays())
def test_arrays_of_others(name, tmp_path):
    array, path = arrays()[name], tmp_path / name
    if isinstance(array, dict):
        np.savez(path, **array)
    elif isinstance(array, list):
        np.savez_compressed(path, *array)
    else:
        np.save(path, array)
    np.testing.assert_allclose(clouds_of(read_clouds([path]))[0], POINTS, rtol=1e-5)


def test_the_content_decides_and_not_the_ending(tmp_path):
    pcd(tmp_path / "c.csv", "binary")
    ply(tmp_path / "c.npz", "<", False)
    np.save(tmp_path / "c.npy", POINTS)
    (tmp_path / "c.npy").rename(tmp_path / "c.ply")
    for cloud in clouds_of(
        read_clouds([tmp_path / "c.csv", tmp_path / "c.npz", tmp_path / "c.ply"])
    ):
        np.testing.assert_allclose(cloud, POINTS, rtol=1e-6)


# --- pixels without depth ------------------------------------------------------------------
def finger():
    cloud = builtin_model().prior.evaluate(np.array([[4.0, -2.0]])).reshape(-1, 3)
    return np.round(cloud, 4)


@pytest.mark.parametrize(
    "place, share, says",
    [
        (
            [0, 0, 0],
            0.5,
            "{n} of {m} points are at exactly 0, 0, 0 (pixels without depth) and are left out",
        ),
        (
            [0, 0, 0],
            0.9,
            "{n} of {m} points are at exactly 0, 0, 0 (pixels without depth) and are left out",
        ),
        (
            [-0.0, 0, -0.0],
            0.02,
            "{n} of {m} points are at exactly 0, 0, 0 (pixels without depth) and are left out",
        ),
        (
            [12.5, -300.25, 41.0],
            0.5,
            "{n} of {m} points are at (12.5, -300.25, 41), which repeats bit for bit",
        ),
        ([-1, -1, -1], 0.2, "{n} of {m} points are at (-1, -1, -1), which repeats bit for bit"),
        ([np.nan] * 3, 0.5, "{n} of {m} points are not finite and are left out"),
    ],
)
def test_pixels_without_depth_are_left_out_and_counted(place, share, says, tmp_path, capsys):
    good = finger()
    lost = int(share / (1 - share) * len(good)) + 2
    cloud = np.vstack([good, np.tile(np.array(place, float), (lost, 1))])
    cloud = cloud[np.random.default_rng(1).permutation(len(cloud))]
    np.save(tmp_path / "c.npy", cloud)
    assert main(["run", "register", str(tmp_path / "c.npy"), "--out", str(tmp_path / "r.npz")]) == 0
    assert f"look at: c.npy: {says.format(n=lost, m=len(cloud))}" in capsys.readouterr().out
    assert len(clouds_of(read_clouds([tmp_path / "c.npy"]))[0]) == len(good)


def test_what_was_measured_is_kept(tmp_path):
    """One point at 0, 0, 0; every place twice; places in integer millimetres, of which many
    coincide.
    """
    once = np.vstack([POINTS, np.zeros((1, 3))])
    twice = np.vstack([POINTS, POINTS])
    whole = np.round(RNG.uniform(0.0, 8.0, (5000, 3)))
    for cloud in (once, twice, whole[whole.any(axis=1)]):
        np.save(tmp_path / "c.npy", cloud)
        notes = []
        assert (
            len(clouds_of(read_clouds([tmp_path / "c.npy"], notes))[0]) == len(cloud) and not notes
        )


def test_several_reasons_stand_in_one_line_and_a_cloud_of_nothing_is_refused(tmp_path):
    cloud = np.vstack([POINTS, np.zeros((3, 3)), np.full((2, 3), np.nan), np.full((40, 3), 7.0)])
    np.save(tmp_path / "c.npy", cloud)
    notes = []
    read_clouds([tmp_path / "c.npy"], notes)
    (line,) = notes
    assert line.startswith(
        "c.npy: 45 of 285 points are left out: 2 not finite, 3 at exactly 0, 0, 0"
    )
    assert "40 at (7, 7, 7)" in line
    np.save(tmp_path / "c.npy", np.zeros((90, 3)))
    with pytest.raises(
        RegistrationError, match=r"no point in it was seen .90 of 90 points are at exactly 0, 0, 0"
    ):
        read_clouds([tmp_path / "c.npy"])


def test_a_run_of_clouds_leaves_them_out_too(tmp_path):
    points = np.vstack([POINTS, np.zeros((60, 3)), POINTS[:200]])
    run = Run(
        t=np.arange(3.0),
        command=np.zeros((3, 2)),
        t_seen=np.arange(2.0),
        points=points,
        start=[0, 300, 500],
    )
    run.save(tmp_path / "run.npz")
    notes = []
    assert [len(c) for c in clouds_of(read_clouds([tmp_path / "run.npz"], notes))] == [240, 200]
    assert notes[0].startswith(
        "run.npz: 1 of 2 clouds, the first is cloud 0: 60 of 300 points are at exactly 0, 0, 0"
    )


def test_pixels_without_depth_change_nothing_that_uses_the_clouds_of_a_run(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    write_clouds()
    run = Run.load("clouds.npz")
    pixels = np.random.default_rng(5).integers(1, 900, run.frames)
    parts = [np.vstack([cloud, np.zeros((n, 3))]) for cloud, n in zip(clouds_of(run), pixels)]
    start = np.cumsum([0, *map(len, parts)])
    replace(run, points=np.vstack(parts), start=start).save("zeros.npz")
    shown = []
    for name in ("clouds", "zeros"):
        assert main(["check", f"{name}.npz"]) == 0
        shown.append(capsys.readouterr().out)
        assert (
            main(
                ["run", "align", f"{name}.npz", "--base", "clamped", "--out", f"{name}_aligned.npz"]
            )
            == 0
        )
        assert main(
            ["run", "register", f"{name}_aligned.npz", "--out", f"{name}_registered.npz"]
        ) in (0, 1)
    assert "pixels without depth" in " ".join(shown[1].split()) and "without depth" not in shown[0]
    assert (
        re.findall("seen.*\n.*base frame", shown[0])
        == re.findall("seen.*\n.*base frame", shown[1])
        != []
    )
    one, other = (Run.load(f"{name}_registered.npz").vertices for name in ("clouds", "zeros"))
    np.testing.assert_array_equal(one, other)
