"""Blocks and fingers of a few tetrahedra."""

import meshio
import numpy as np

from softmap_edge import _core
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Simulator

SIZE = (16.0, 14.0, 60.0)


# Six tetrahedra of a brick, around its diagonal from corner 0 to corner 6.
CUT = [[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]]


BLOCK = """
name = "bar"
[block]
size_mm = [16.0, 14.0, 60.0]
cells = [2, 2, 8]
[material]
young_mpa = 0.3
poisson = 0.46
density_kg_m3 = 1070.0
[mounting]
gravity_g = [0.3, 0.0, 0.0]
"""


def tetrahedra(cells=(2, 2, 6)):
    """Nodes (n, 3) and 4-node cells of the bar, in the base frame."""
    bricks = _core.Mesh.block(SIZE, cells)
    return np.asarray(bricks.nodes), np.concatenate([bricks.cells[:, four] for four in CUT])


def mesh_finger(path, nodes, cells, spoil=lambda mesh: None, tail="", **options):
    """Write a mesh as VTK or Gmsh and return the finger that names it."""
    mesh = meshio.Mesh(nodes, [("tetra", np.asarray(cells))])
    spoil(mesh)
    meshio.write(
        path,
        mesh,
        **({"file_format": "vtk42", "binary": False} if path.suffix == ".vtk" else options),
    )
    lines = f'[mesh]\nfile = "{path.name}"\n'
    (path.parent / "finger.toml").write_text(
        BLOCK.replace(BLOCK[BLOCK.index("[block]") : BLOCK.index("[mat")], lines + tail)
    )
    return Finger.load(path.parent / "finger.toml")


def sag(finger):
    simulator = Simulator(finger)
    rest = simulator.template.vertices
    end = rest[:, 2] > SIZE[2] - 1e-6
    return (simulator.rest() - rest)[end, 0].mean()
