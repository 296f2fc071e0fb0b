"""Clouds as others write them, and pixels without depth: each gives the points that a plain CSV gives."""

import json
import re
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from remedy_cases import write_clouds

from softmap_edge import builtin_model
from softmap_edge.alignment.cloud_files.pcd import unpack_lzf
from softmap_edge.alignment.clouds import clouds_of, read_clouds
from softmap_edge.cli import main
from softmap_edge.errors import RegistrationError
from softmap_edge.run.run import Run

CASES = Path(__file__).parent / "data/clouds"
RNG = np.random.default_rng(5)
POINTS = np.round(RNG.uniform(-60.0, 60.0, (240, 3)), 3)
COLOURS = RNG.integers(0, 256, (240, 3))
NORMALS = RNG.normal(size=(240, 3))
NORMALS /= np.linalg.norm(NORMALS, axis=1, keepdims=True)


def rows(*columns, split=" ", decimal=".", form="%.6f"):
    """Return a table as text."""
    table = np.column_stack([np.asarray(c, float).reshape(240, -1) for c in columns])
    lines = [split.join(f"{v:g}" if not v % 1 else form % v for v in row) for row in table]
    return "\n".join(lines).replace(".", decimal) + "\n"


# --- the case ------------------------------------------------------------------------------
@pytest.mark.parametrize("path", sorted(CASES.iterdir()), ids=lambda path: path.name)
def test_each_file_of_the_case_registers_as_a_plain_csv_does(path, tmp_path, capsys):
    assert main(["register", str(path), "--out", str(tmp_path / "run.npz"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert round(said["frames"][0]["residual_mm"], 2) == 0.17
    assert bool(said["notes"]) == (path.name in ("paraview.csv", "savez.npz"))  # a guess is reported
    np.testing.assert_allclose(
        clouds_of(read_clouds([path]))[0], clouds_of(read_clouds([CASES / "plain.xyz"]))[0], atol=1e-3
    )


# --- text ----------------------------------------------------------------------------------
TEXTS = {
    "cloudcompare.asc": "//X Y Z R G B\n" + rows(POINTS, COLOURS),
    "scan.pts": "240\n" + rows(POINTS, COLOURS[:, 0], COLOURS),
    "r.txt": '"x" "y" "z"\n'
    + "\n".join(f'"{k + 1}" {line}' for k, line in enumerate(rows(POINTS).splitlines())),
    "pandas.csv": ",x,y,z\n" + rows(np.arange(240), POINTS, split=","),
    "pandas_no_name.csv": "x,y,z\n" + rows(np.arange(240), POINTS, split=","),
    "index.csv": rows(np.arange(240), POINTS, split=","),
    "shuffled_index.txt": rows(RNG.permutation(240) + 1000, POINTS),
    "stamps.csv": rows(1.7e9 + 0.033 * np.arange(240) ** 1.1, POINTS, split=","),
    "colours_first.txt": rows(COLOURS, POINTS),
    "float_colours_first.txt": rows(COLOURS / 255.0, POINTS),
    "normals_first.txt": rows(NORMALS, POINTS),
    "whole_colours_first.txt": rows(COLOURS, np.round(POINTS)),
    "always.csv": rows(np.full(240, 255.0), POINTS, split=","),
    "tabs.tsv": "X [mm]\tY [mm]\tZ [mm]\n" + rows(POINTS, split="\t", decimal=","),
    "blanks.txt": rows(POINTS, split="  ", decimal=","),
    "trailing.csv": "x;y;z;\n" + rows(POINTS, split=";", decimal=",").replace("\n", ";\n"),
    "normals_paraview.csv": '"Normals:0","Normals:1","Normals:2","Points:0","Points:1","Points:2"\n'
    + rows(NORMALS, POINTS, split=","),
    "ros.csv": "time,point.x,point.y,point.z\n" + rows(np.arange(240), POINTS, split=","),
    "brackets.csv": "id,pos[0],pos[1],pos[2]\n" + rows(np.arange(240), POINTS, split=","),
    "late_names.txt": "# made by a tool\n# columns: z y x\n" + rows(POINTS[:, ::-1]),
    "mesh.obj": "# a mesh\nmtllib a.mtl\n" + rows(POINTS).replace("\n", "\nv ").join(["v ", ""])[:-2] + "f 1 2 3\n" * 9,
    "atoms.xyz": "240\nmolecule\n" + "\n".join(f"C {line}" for line in rows(POINTS).splitlines()),
    "colmap.txt": "# 3D point list with one line of data per point:\n"
    "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n# Number of points: 240, mean track\n"
    + "\n".join(line + " 1 2" * (k % 5) for k, line in
                enumerate(rows(RNG.permutation(240), POINTS, COLOURS, NORMALS[:, 0]).splitlines())),
}  # fmt: skip


@pytest.mark.parametrize("name", TEXTS)
def test_text_of_others(name, tmp_path):
    (tmp_path / name).write_text(TEXTS[name])
    expected = np.round(POINTS) if name.startswith("whole") else POINTS
    np.testing.assert_allclose(clouds_of(read_clouds([tmp_path / name]))[0], expected, atol=1e-6)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig", "latin-1"])
def test_text_of_other_alphabets(encoding, tmp_path):
    (tmp_path / "c.csv").write_bytes(("# 20 °C\nx,y,z\n" + rows(POINTS, split=",")).encode(encoding))
    np.testing.assert_allclose(clouds_of(read_clouds([tmp_path / "c.csv"]))[0], POINTS, atol=1e-6)


def test_the_guess_is_reported_also_where_the_cloud_is_refused(tmp_path, capsys):
    far = 50.0 * POINTS
    (tmp_path / "c.csv").write_text(rows(np.arange(240), far, split=","))
    notes = []
    read_clouds([tmp_path / "c.csv"], notes)
    guess = "c.csv: its columns have no names; columns 2, 3, 4 are taken for x, y, z; column 1 counts rows"
    assert notes == [guess]
    assert main(["register", str(tmp_path / "c.csv"), "--out", str(tmp_path / "r.npz")]) != 0
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


# --- PLY and PCD ---------------------------------------------------------------------------
def ply(path, order, faces_first):
    vertex = "element vertex 240\nproperty uchar red\nproperty double z\nproperty float nx\nproperty double x\n"
    vertex += "property double y\n"
    face = "element face 3\nproperty list uchar int vertex_indices\nproperty short tag\n"
    parts = [face, vertex] if faces_first else [vertex, face]
    name = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    head = f"ply\nformat {name} 1.0\ncomment by another\n{''.join(parts)}end_header\n"
    table = [(COLOURS[k, 0], POINTS[k, 2], NORMALS[k, 0], POINTS[k, 0], POINTS[k, 1]) for k in range(240)]
    faces = [(3, 0, 1, 2, 7), (4, 0, 1, 2, 3, 7), (3, 4, 5, 6, 7)]
    if not order:
        text = ["\n".join(" ".join(map(str, row)) for row in rows) + "\n" for rows in (table, faces)]
        path.write_text(head + "".join(text[::-1] if faces_first else text))
        return
    packed = [
        b"".join(struct.pack(f"{order}Bdfdd", *row) for row in table),
        b"".join(struct.pack(f"{order}B{row[0]}ih", *row) for row in faces),
    ]
    path.write_bytes(head.encode() + b"".join(packed[::-1] if faces_first else packed))


@pytest.mark.parametrize("order", ["", "<", ">"])
@pytest.mark.parametrize("faces_first", [False, True])
def test_ply_of_any_order(order, faces_first, tmp_path):
    ply(tmp_path / "c.ply", order, faces_first)
    notes = []
    np.testing.assert_allclose(clouds_of(read_clouds([tmp_path / "c.ply"], notes))[0], POINTS, rtol=1e-6)
    assert not notes


def lzf(data):
    """Pack bytes by LZF: copies of at most 264 bytes from up to 8 kB back, else up to 32 bytes as they are."""
    out, at, plain, seen = bytearray(), 0, bytearray(), {}

    def flush():
        for k in range(0, len(plain), 32):
            out.append(len(plain[k : k + 32]) - 1)
            out.extend(plain[k : k + 32])
        plain.clear()

    while at < len(data):
        key = bytes(data[at : at + 3])
        start = seen.get(key, -1) if len(key) == 3 else -1
        seen[key] = at
        if start >= 0 and at - start <= 8192:
            length = 3
            while length < 264 and at + length < len(data) and data[start + length] == data[at + length]:
                length += 1
            flush()
            back = at - start - 1
            code = length - 2
            out.append((min(code, 7) << 5) | (back >> 8))
            if code >= 7:
                out.append(code - 7)
            out.append(back & 255)
            at += length
        else:
            plain.append(data[at])
            at += 1
    flush()
    return bytes(out)


def pcd(path, kind, points=POINTS):
    """With colours first, padding, and a field of two numbers, of an image of 24 by 10 pixels."""
    dtype = [("rgb", "<u4"), ("_", "<u1", (3,)), ("z", "<f8"), ("pair", "<i2", (2,)), ("x", "<f8"), ("y", "<f8")]
    table = np.zeros(240, dtype)
    table["rgb"], table["pair"] = COLOURS[:, 0], COLOURS[:, :2]
    for k, axis in enumerate("xyz"):
        table[axis] = points[:, k]
    head = "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS rgb _ z pair x y\nSIZE 4 1 8 2 8 8\n"
    head += "TYPE U U F I F F\nCOUNT 1 3 1 2 1 1\nWIDTH 24\nHEIGHT 10\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 240\n"
    if kind == "ascii":
        lines = [" ".join(str(v) for name, *_ in dtype for v in np.atleast_1d(row[name])) for row in table]
        body = "\n".join(lines).encode()
    elif kind == "binary":
        body = table.tobytes()
    else:
        plain = b"".join(np.ascontiguousarray(table[name]).tobytes() for name, *_ in dtype)
        packed = lzf(plain)
        assert len(packed) < len(plain)
        body = struct.pack("<II", len(packed), len(plain)) + packed
    path.write_bytes(f"{head}DATA {kind}\n".encode() + body)


@pytest.mark.parametrize("kind", ["ascii", "binary", "binary_compressed"])
def test_pcd_of_any_fields(kind, tmp_path):
    holed = POINTS.copy()
    holed[::8] = np.nan
    pcd(tmp_path / "c.pcd", kind, holed)
    notes = []
    np.testing.assert_allclose(clouds_of(read_clouds([tmp_path / "c.pcd"], notes))[0], POINTS[np.arange(240) % 8 > 0])
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
        "# .PCD\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {n}\nHEIGHT 1\nPOINTS {n}\nDATA binary\n",
        "# .PCD\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {n}\nHEIGHT 1\nPOINTS {n}\nDATA ascii\n",
        "# .PCD\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {n}\nHEIGHT 1\nPOINTS {n}\nDATA binary_compressed\n",
        "ply\nformat ascii 1.0\nelement vertex {n}\nproperty float x\nproperty float y\nproperty float z\nend_header\n",
        "ply\nformat binary_big_endian 1.0\nelement face {n}\nproperty list uchar int i\nelement vertex {n}\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n",
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
    for cloud in clouds_of(read_clouds([tmp_path / "c.csv", tmp_path / "c.npz", tmp_path / "c.ply"])):
        np.testing.assert_allclose(cloud, POINTS, rtol=1e-6)


# --- pixels without depth ------------------------------------------------------------------
def finger():
    cloud = builtin_model().prior.evaluate(np.array([[4.0, -2.0]])).reshape(-1, 3)
    return np.round(cloud, 4)


@pytest.mark.parametrize(
    "place, share, says",
    [
        ([0, 0, 0], 0.5, "{n} of {m} points are at exactly 0, 0, 0 (pixels without depth) and are left out"),
        ([0, 0, 0], 0.9, "{n} of {m} points are at exactly 0, 0, 0 (pixels without depth) and are left out"),
        ([-0.0, 0, -0.0], 0.02, "{n} of {m} points are at exactly 0, 0, 0 (pixels without depth) and are left out"),
        ([12.5, -300.25, 41.0], 0.5, "{n} of {m} points are at (12.5, -300.25, 41), which repeats bit for bit"),
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
    assert main(["register", str(tmp_path / "c.npy"), "--out", str(tmp_path / "r.npz")]) == 0
    assert f"look at: c.npy: {says.format(n=lost, m=len(cloud))}" in capsys.readouterr().out
    assert len(clouds_of(read_clouds([tmp_path / "c.npy"]))[0]) == len(good)


def test_what_was_measured_is_kept(tmp_path):
    """One point at 0, 0, 0; every place twice; places in whole millimetres, of which many coincide."""
    once = np.vstack([POINTS, np.zeros((1, 3))])
    twice = np.vstack([POINTS, POINTS])
    whole = np.round(RNG.uniform(0.0, 8.0, (5000, 3)))
    for cloud in (once, twice, whole[whole.any(axis=1)]):
        np.save(tmp_path / "c.npy", cloud)
        notes = []
        assert len(clouds_of(read_clouds([tmp_path / "c.npy"], notes))[0]) == len(cloud) and not notes


def test_several_reasons_stand_in_one_line_and_a_cloud_of_nothing_is_refused(tmp_path):
    cloud = np.vstack([POINTS, np.zeros((3, 3)), np.full((2, 3), np.nan), np.full((40, 3), 7.0)])
    np.save(tmp_path / "c.npy", cloud)
    notes = []
    read_clouds([tmp_path / "c.npy"], notes)
    (line,) = notes
    assert line.startswith("c.npy: 45 of 285 points are left out: 2 not finite, 3 at exactly 0, 0, 0")
    assert "40 at (7, 7, 7)" in line
    np.save(tmp_path / "c.npy", np.zeros((90, 3)))
    with pytest.raises(RegistrationError, match=r"no point in it was seen .90 of 90 points are at exactly 0, 0, 0"):
        read_clouds([tmp_path / "c.npy"])


def test_a_run_of_clouds_leaves_them_out_too(tmp_path):
    points = np.vstack([POINTS, np.zeros((60, 3)), POINTS[:200]])
    run = Run(t=np.arange(3.0), command=np.zeros((3, 2)), t_seen=np.arange(2.0), points=points, start=[0, 300, 500])
    run.save(tmp_path / "run.npz")
    notes = []
    assert [len(c) for c in clouds_of(read_clouds([tmp_path / "run.npz"], notes))] == [240, 200]
    assert notes[0].startswith("run.npz: 1 of 2 clouds, the first is cloud 0: 60 of 300 points are at exactly 0, 0, 0")


def test_pixels_without_depth_change_nothing_that_uses_the_clouds_of_a_run(tmp_path, monkeypatch, capsys):
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
        assert main(["align", f"{name}.npz", "--base", "clamped", "--out", f"{name}_aligned.npz"]) == 0
        assert main(["register", f"{name}_aligned.npz", "--out", f"{name}_registered.npz"]) in (0, 1)
    assert "pixels without depth" in " ".join(shown[1].split()) and "without depth" not in shown[0]
    assert re.findall("seen.*\n.*base frame", shown[0]) == re.findall("seen.*\n.*base frame", shown[1]) != []
    one, other = (Run.load(f"{name}_registered.npz").vertices for name in ("clouds", "zeros"))
    np.testing.assert_array_equal(one, other)
