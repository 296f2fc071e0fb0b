"""As-rigid-as-possible surfaces by libigl (MPL 2.0).

It has the solver, and the published registration as a loop around it.
"""

from __future__ import annotations

import igl
import numpy as np
from pykdtree.kdtree import KDTree


class Handles:
    """A surface at `rest` (N, 3) mm whose `handles` (H,) are moved.

    It uses spokes, as in rust/geometry/arap.rs.
    """

    def __init__(self, rest, triangles, handles, rounds):
        self.rest, self.data = rest, igl.ARAPData()
        self.data.energy, self.data.max_iter = igl.ARAP_ENERGY_TYPE_SPOKES, rounds
        igl.arap_precomputation(rest, triangles, 3, handles.astype(np.int32), self.data)

    def deformed(self, goals):
        """Return the vertices (N, 3) after all rounds from rest; `goals` (H, 3) of the handles."""
        return igl.arap_solve(goals, self.data, self.rest)


class Published:
    """Eq. 1 of the paper by libigl: pull each vertex to its nearest point of the cloud.

    One round of libigl's solver follows each time.

    libigl has no soft constraints, but its implicit time step acts as one: mass · |v − (v⁰ +
    h·velocity)|² / stiffness, with h = 1 and the velocity towards the nearest point. The mass is
    the area of a vertex: λ on average.
    """

    def __init__(self, rest, triangles, strength, rounds, settled_mm):
        self.rest, self.data, self.rounds, self.settled_mm = (
            rest,
            igl.ARAPData(),
            rounds,
            settled_mm,
        )
        a, b, c = rest[triangles].transpose(1, 0, 2)
        area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
        data = self.data
        data.energy, data.max_iter, data.with_dynamics, data.h = (
            igl.ARAP_ENERGY_TYPE_SPOKES,
            1,
            True,
            1.0,
        )
        data.ym = 2.0 * area / len(rest) / strength  # its energy is half of ours
        igl.arap_precomputation(rest, triangles, 3, np.zeros(0, np.int32), data)

    def register(self, cloud):
        """Return the vertices (N, 3) registered to a cloud (M, 3) from rest."""
        tree, places, none = KDTree(cloud), self.rest, np.zeros((0, 3))
        for _ in range(self.rounds):
            _, nearest = tree.query(places)
            self.data.vel = cloud[nearest] - places
            before, places = places, igl.arap_solve(none, self.data, places)
            if np.linalg.norm(places - before, axis=1).max() < self.settled_mm:
                break
        return places
