"""Meshes in the formats of other programs: VTU, VTK and Gmsh, with names and materials."""

import base64
import struct
import zlib

import meshio
import numpy as np
from small_solids import SIZE, tetrahedra

NODES, CELLS = tetrahedra((1, 1, 6))


# cells of the half at the base, which bends most
HARD = NODES[CELLS].mean(axis=1)[:, 2] < SIZE[2] / 2


def xml(arrays, tail="", attributes=""):
    """A VTU file of the bar with arrays (points, connectivity, offsets, types) given as
    elements.
    """
    points, *cells = arrays
    return (
        '<?xml version="1.0"?>\n<!-- by another -->\n<VTKFile type="UnstructuredGrid" '
        f'version="1.0" byte_order="LittleEndian" {attributes}>\n<UnstructuredGrid><Piece '
        f'NumberOfPoints="{len(NODES)}" '
        f'NumberOfCells="{len(CELLS)}">\n<Points>{points}</Points>\n<Cells>{"".join(cells)}</Cells>\n</Piece>'
        f"</UnstructuredGrid>{tail}</VTKFile>\n"
    )


VALUES = [
    ('type="Float64" Name="Points" NumberOfComponents="3"', NODES),
    ('type="Int64" Name="connectivity"', CELLS.astype(np.int64)),
    ('type="Int64" Name="offsets"', 4 * np.arange(1, len(CELLS) + 1)),
    ('type="UInt8" Name="types"', np.full(len(CELLS), 10, np.uint8)),
]


def ascii_vtu(path):
    text = [
        f'<DataArray {what} format="ascii">{" ".join(map(repr, v.ravel().tolist()))}</DataArray>'
        for what, v in VALUES
    ]
    path.write_bytes(b"\xef\xbb\xbf" + xml(text).encode())


def base64_vtu(path):
    text = []
    for what, values in VALUES:
        raw = values.tobytes()
        packed = base64.b64encode(struct.pack("<Q", len(raw)) + raw).decode()
        text.append(f'<DataArray {what} format="binary">\n{packed}\n</DataArray>')
    path.write_text(xml(text, attributes='header_type="UInt64"'))


def raw_vtu(path):
    """As ParaView saves by default: compressed blocks behind the XML."""
    text, content = [], b""
    for what, values in VALUES:
        raw = values.tobytes()
        packed = zlib.compress(raw)
        text.append(f'<DataArray {what} format="appended" offset="{len(content)}"/>')
        content += struct.pack("<IIII", 1, len(raw), 0, len(packed)) + packed
    head = xml(text, "@", 'header_type="UInt32" compressor="vtkZLibDataCompressor"').encode()
    appended = b'<AppendedData encoding="raw">\n_' + content + b"\n</AppendedData>"
    path.write_bytes(head.replace(b"@", appended))


def gmsh22(path, names=True):
    mesh = meshio.Mesh(
        NODES, [("tetra", CELLS)], cell_data={"gmsh:physical": [1 + HARD.astype(np.int32)] * 1}
    )
    mesh.cell_data["gmsh:geometrical"] = [np.arange(len(CELLS), dtype=np.int32) % 3 + 1]
    mesh.field_data = (
        {"soft part": np.array([1, 3]), "hard": np.array([2, 3]), "skin": np.array([2, 2])}
        if names
        else {}
    )
    meshio.write(path, mesh, file_format="gmsh22", binary=False)


def gmsh41(path):
    """By hand: two volumes, of which both belong to `all` and one to `hard`."""
    order = np.argsort(HARD, kind="stable")
    soft = int(np.count_nonzero(~HARD))
    lines = [
        "$MeshFormat",
        "4.1 0 8",
        "$EndMeshFormat",
        "$PhysicalNames",
        "2",
        '3 1 "all"',
        '3 2 "hard"',
    ]
    lines += [
        "$EndPhysicalNames",
        "$Entities",
        "0 0 0 2",
        "1 0 0 0 1 1 1 1 1 0",
        "2 0 0 0 1 1 1 2 1 2 0",
    ]
    lines += ["$EndEntities", "$Nodes", f"1 {len(NODES)} 1 {len(NODES)}", f"3 1 0 {len(NODES)}"]
    lines += [str(k + 1) for k in range(len(NODES))] + [
        " ".join(map(repr, node)) for node in NODES.tolist()
    ]
    lines += ["$EndNodes", "$Elements", f"2 {len(CELLS)} 1 {len(CELLS)}"]
    for tag, part in ((1, order[:soft]), (2, order[soft:])):
        lines += [f"3 {tag} 4 {len(part)}"]
        lines += [f"{k + 1} {' '.join(str(n + 1) for n in CELLS[k])}" for k in part]
    path.write_text("\n".join([*lines, "$EndElements", ""]))


def scalars(path):
    """Legacy VTK by hand: whole numbers as SCALARS of the cells."""
    rows = "\n".join(f"4 {' '.join(map(str, cell))}" for cell in CELLS)
    places = "\n".join(" ".join(map(repr, node)) for node in NODES.tolist())
    count = len(CELLS)
    path.write_text(
        f"# vtk DataFile Version 3.0\nbar\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS {len(NODES)} "
        f"double\n{places}\nCELLS {count} {5 * count}\n{rows}\nCELL_TYPES {count}\n"
        + "10\n"
        * count
        + f"CELL_DATA {count}\n"
        "SCALARS MaterialIds int 1\nLOOKUP_TABLE default\n"
        + "\n".join(str(5 + 2 * h) for h in HARD)
        + "\n"
    )


def fenics(path):
    data = {
        "f": [1.0 + HARD],
        "quality": [np.linspace(0.1, 0.9, len(CELLS))],
        "id": [np.arange(100, 100 + len(CELLS))],
    }
    meshio.write(path, meshio.Mesh(NODES, [("tetra", CELLS)], cell_data=data), file_format="vtu")
