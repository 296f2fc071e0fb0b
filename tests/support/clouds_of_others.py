"""Point clouds as other programs write them."""

import struct

import numpy as np

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
    "mesh.obj": "# a mesh\nmtllib a.mtl\n"
    + rows(POINTS).replace("\n", "\nv ").join(["v ", ""])[:-2]
    + "f 1 2 3\n" * 9,
    "atoms.xyz": "240\nmolecule\n" + "\n".join(f"C {line}" for line in rows(POINTS).splitlines()),
    "colmap.txt": "# 3D point list with one line of data per point:\n"
    "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n# Number of points: 240, mean track\n"
    + "\n".join(
        line + " 1 2" * (k % 5)
        for k, line in enumerate(
            rows(RNG.permutation(240), POINTS, COLOURS, NORMALS[:, 0]).splitlines()
        )
    ),
}


# --- PLY and PCD ---------------------------------------------------------------------------
def ply(path, order, faces_first):
    vertex = (
        "element vertex 240\nproperty uchar red\nproperty double z\nproperty float nx\nproperty "
        "double x\n"
    )
    vertex += "property double y\n"
    face = "element face 3\nproperty list uchar int vertex_indices\nproperty short tag\n"
    parts = [face, vertex] if faces_first else [vertex, face]
    name = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    head = f"ply\nformat {name} 1.0\ncomment by another\n{''.join(parts)}end_header\n"
    table = [
        (COLOURS[k, 0], POINTS[k, 2], NORMALS[k, 0], POINTS[k, 0], POINTS[k, 1]) for k in range(240)
    ]
    faces = [(3, 0, 1, 2, 7), (4, 0, 1, 2, 3, 7), (3, 4, 5, 6, 7)]
    if not order:
        text = [
            "\n".join(" ".join(map(str, row)) for row in rows) + "\n" for rows in (table, faces)
        ]
        path.write_text(head + "".join(text[::-1] if faces_first else text))
        return
    packed = [
        b"".join(struct.pack(f"{order}Bdfdd", *row) for row in table),
        b"".join(struct.pack(f"{order}B{row[0]}ih", *row) for row in faces),
    ]
    path.write_bytes(head.encode() + b"".join(packed[::-1] if faces_first else packed))


def lzf(data):
    """Pack bytes by LZF: copies of at most 264 bytes from up to 8 kB back, else up to 32 bytes as
    they are.
    """
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
            while (
                length < 264
                and at + length < len(data)
                and data[start + length] == data[at + length]
            ):
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
    dtype = [
        ("rgb", "<u4"),
        ("_", "<u1", (3,)),
        ("z", "<f8"),
        ("pair", "<i2", (2,)),
        ("x", "<f8"),
        ("y", "<f8"),
    ]
    table = np.zeros(240, dtype)
    table["rgb"], table["pair"] = COLOURS[:, 0], COLOURS[:, :2]
    for k, axis in enumerate("xyz"):
        table[axis] = points[:, k]
    head = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS rgb _ z pair x y\nSIZE 4 "
        "1 8 2 8 8\n"
    )
    head += (
        "TYPE U U F I F F\nCOUNT 1 3 1 2 1 1\nWIDTH 24\nHEIGHT 10\nVIEWPOINT 0 0 0 1 0 0 "
        "0\nPOINTS 240\n"
    )
    if kind == "ascii":
        lines = [
            " ".join(str(v) for name, *_ in dtype for v in np.atleast_1d(row[name]))
            for row in table
        ]
        body = "\n".join(lines).encode()
    elif kind == "binary":
        body = table.tobytes()
    else:
        plain = b"".join(np.ascontiguousarray(table[name]).tobytes() for name, *_ in dtype)
        packed = lzf(plain)
        assert len(packed) < len(plain)
        body = struct.pack("<II", len(packed), len(plain)) + packed
    path.write_bytes(f"{head}DATA {kind}\n".encode() + body)
