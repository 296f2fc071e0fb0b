"""Cut a solid of bricks into coarse 10-node tetrahedra: another element for the same body.

Each face of a brick is cut from its lowest-numbered corner, so two bricks agree on a shared face. A
brick is the six tetrahedra from its lowest-numbered corner to the triangles of the three faces
without it (Dompierre et al., How to subdivide pyramids, prisms and hexahedra into tetrahedra,
1999). With a node in the middle of each brick and twelve tetrahedra, the factor is four times as
large. Edges stay straight. Pinned by tests/synthetic/test_virtual.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from softmap_edge import _core
from softmap_edge.fem.bodies import Block, Tapered
from softmap_edge.fem.numbers import at

ACROSS, LAYERS = 2, 8  # bricks across the core; least number along the body
# outward
FACES = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))


@dataclass(frozen=True)
class Cut:
    """A solid as coarse tetrahedra, bricks about as tall as wide, for a `Simulator`."""

    solid: Tapered | Block

    @property
    def height_mm(self) -> float:
        """Height from the clamped base to the tip, mm."""
        return self.solid.height_mm

    def cells(self, ends: Sequence[float]) -> _core.Mesh:
        """Return the cells; `ends` are the heights in mm where tendons start and end."""
        return cut(self.bricks(ends))

    def bricks(self, ends: Sequence[float]) -> _core.Mesh:
        """Return the bricks that are cut."""
        least = max(LAYERS, len(set(ends)) + 1)  # between two ends there is a layer
        if isinstance(self.solid, Block):
            x, y, z = self.solid.cells_each_way
            tall = max(least, round(self.height_mm / min(self.solid.size[:2])))
            return replace(
                self.solid, cells_each_way=(min(x, ACROSS), min(y, ACROSS), min(z, tall))
            ).cells(ends)
        wide = 2.0 * at(self.solid.profile, 0.5 * self.height_mm)
        layers = min(self.solid.layers, max(least, round(self.height_mm / wide)))
        return replace(self.solid, core=min(self.solid.core, ACROSS), rings=1, layers=layers).cells(
            ends
        )


def cut(bricks: _core.Mesh) -> _core.Mesh:
    """Return the mesh of six 10-node tetrahedra for each of the bricks."""
    cells = np.asarray(bricks.cells)
    faces = cells[:, FACES]  # (E, 6, 4)
    turned = (faces.argmin(axis=2)[..., None] + np.arange(4)) % 4
    faces = np.take_along_axis(faces, turned, axis=2)  # each rotated to its smallest corner
    apex = cells.min(axis=1)
    far = faces[faces[..., 0] != apex[:, None]]  # (3 E, 4)
    inward = np.stack([far[:, [2, 1, 0]], far[:, [3, 2, 0]]], axis=1).reshape(-1, 3)
    return _core.Mesh.tetrahedra(
        bricks.nodes, np.column_stack([inward, np.repeat(apex, len(FACES))]), 0
    )
