"""PLY clouds with list properties anywhere among the vertex's properties."""

import struct

import numpy as np
import pytest

from softmap_edge.alignment.cloud_files.ply import read_ply
from softmap_edge.errors import RegistrationError

POINTS = np.random.default_rng(3).normal(0, 30, (40, 3)).astype("f4").astype(float)
LIST, FEW = ("property list uchar int links", "Bi"), ("property list ushort double w", "Hd")
X, Y, Z = ((f"property float {axis}", "f") for axis in "xyz")
ORDERS = {
    "first": [LIST, X, Y, Z],
    "between": [X, LIST, Y, FEW, Z],
    "last": [Z, Y, X, LIST],
    "twice": [FEW, LIST, Y, X, ("property uchar red", "B"), Z],
}


def ply(kinds, form, points=POINTS, length=lambda k: k % 4):
    """Return the bytes of a PLY file; lists of `length(row)` items."""
    head = [f"ply\nformat {form} 1.0\nelement vertex {len(points)}", *(line for line, _ in kinds)]
    content = b""
    for k, point in enumerate(points):
        cells = []
        for line, kind in kinds:
            if len(kind) == 2:
                cells += [(kind[0], length(k)), *((kind[1], j + 7) for j in range(length(k)))]
            else:
                cells.append((kind, dict(zip("xyz", point)).get(line[-1], 200)))
        if form == "ascii":
            content += (" ".join(f"{value:.9g}" for _, value in cells) + "\n").encode()
        else:
            order = "<" if "little" in form else ">"
            content += b"".join(struct.pack(order + kind, value) for kind, value in cells)
    return ("\n".join([*head, "end_header"]) + "\n").encode() + content


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("kinds", ORDERS)
def test_lists_of_a_vertex_are_passed_over(kinds, form, tmp_path):
    path = tmp_path / "cloud.ply"
    path.write_bytes(ply(ORDERS[kinds], form))
    notes = []
    assert np.allclose(read_ply(path, notes), POINTS, atol=1e-5) and notes == []


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("kinds", ORDERS)
def test_a_file_that_is_cut_is_refused(kinds, form, tmp_path):
    path = tmp_path / "cut.ply"
    content = ply(ORDERS[kinds], form)
    path.write_bytes(content[: -len(content) // 3])
    with pytest.raises(RegistrationError, match="cannot be read as PLY"):
        read_ply(path, [])


@pytest.mark.parametrize("count", [-1, 2_000_000, 2**31 - 1])
@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_a_length_beyond_the_file_is_refused(count, form, tmp_path):
    head = f"ply\nformat {form} 1.0\nelement vertex 1\nproperty list int uchar w\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    row = f"{count} 1 2 3\n".encode() if form == "ascii" else struct.pack("<i3f", count, 1, 2, 3)
    path = tmp_path / "long.ply"
    path.write_bytes(head.encode() + row)
    with pytest.raises(RegistrationError, match="a list of .* items, 0 to 1000000 are read"):
        read_ply(path, [])


@pytest.mark.parametrize("claimed", [10**7 + 1, 10**15 - 1, 1_000_001])
def test_a_count_of_vertices_beyond_bounds_is_refused(claimed, tmp_path):
    path = tmp_path / "many.ply"
    content = ply(ORDERS["first"], "binary_little_endian")
    path.write_bytes(content.replace(b"vertex 40", b"vertex %d" % claimed))
    with pytest.raises(RegistrationError, match="cannot be read as PLY"):
        read_ply(path, [])


def test_lists_alone_are_no_points(tmp_path):
    path = tmp_path / "lists.ply"
    path.write_bytes(ply([LIST, FEW, X, Y], "ascii"))
    with pytest.raises(RegistrationError, match="2 numbers, x, y, z are needed"):
        read_ply(path, [])
