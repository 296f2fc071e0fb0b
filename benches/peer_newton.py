"""A plain NumPy/SciPy Newton step of the same finger: vectorised bricks, one sparse LU.

It is the peer of the simulator.

The same energy as rust/fem/element.rs (neo-Hookean with mean dilatation), assembled for all bricks
at once with einsum and solved with SuperLU in its symmetric mode, the fastest of SciPy here.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu


class NumpySolid:
    """Bricks (E, 8) over nodes (n, 3) mm with Young's modulus (MPa) and Poisson's ratio.

    `fixed` nodes are clamped.
    """

    def __init__(self, nodes, bricks, young, poisson, fixed):
        self.nodes, self.bricks = np.asarray(nodes, float), np.asarray(bricks)
        self.mu, self.kappa = young / (2 * (1 + poisson)), young / (3 * (1 - 2 * poisson))
        # counter-clockwise, as the bricks' corners are numbered
        around = ((-1, -1), (1, -1), (1, 1), (-1, 1))
        corners = np.array([[x, y, z] for z in (-1, 1) for x, y in around], float)
        points = corners / np.sqrt(3)
        slope = np.empty((8, 8, 3))
        for q, xi in enumerate(points):
            terms = 1 + corners * xi
            for axis in range(3):
                others = [a for a in range(3) if a != axis]
                slope[q, :, axis] = corners[:, axis] * terms[:, others].prod(axis=1) / 8
        jacobian = np.einsum("eai,qaj->eqij", self.nodes[self.bricks], slope)
        self.weight = np.linalg.det(jacobian)  # (E, 8)
        self.gradient = np.einsum("qaj,eqji->eqai", slope, np.linalg.inv(jacobian))  # (E, 8, 8, 3)
        self.volume = self.weight.sum(axis=1)
        dofs = (3 * self.bricks[:, :, None] + np.arange(3)).reshape(len(bricks), 24)
        free = np.ones(3 * len(nodes), bool)
        free[(3 * np.asarray(fixed)[:, None] + np.arange(3)).ravel()] = False
        self.number = np.where(free, np.cumsum(free) - 1, -1)
        self.free = np.flatnonzero(free)
        rows, columns = self.number[dofs][:, :, None], self.number[dofs][:, None, :]
        rows, columns = np.broadcast_arrays(rows, columns)
        self.kept = (rows >= 0) & (columns >= 0)
        self.rows, self.columns, self.dofs = rows[self.kept], columns[self.kept], dofs

    def tangent(self, x):
        """Return force (3n,) N and stiffness (free, free) N/mm at deformed nodes x (n, 3) mm."""
        f = np.einsum("eai,eqaj->eqij", x[self.bricks], self.gradient)
        j = np.linalg.det(f)
        theta = np.einsum("eq,eq->e", self.weight, j) / self.volume
        pressure = 0.5 * self.kappa * (theta - 1 / theta)
        bulk = 0.5 * self.kappa * (1 + 1 / theta**2) / self.volume
        inverse = np.linalg.inv(f)
        g = np.einsum("eqji,eqaj->eqai", inverse, self.gradient)  # F^-T ∇N
        v = np.einsum("eqij,eqaj->eqai", f, self.gradient)
        scale = self.weight * self.mu * j ** (-2 / 3)
        first = np.einsum("eqij,eqij->eq", f, f)
        force = np.einsum("eq,eqai->eai", scale, v - (first / 3)[..., None, None] * g)
        swell = np.einsum("eq,eqai->eai", self.weight * j, g)
        force += pressure[:, None, None] * swell
        inner = np.einsum("eq,eqai,eqbi->eab", scale, self.gradient, self.gradient)
        k = np.einsum("eab,ij->eaibj", inner, np.eye(3))
        cross = np.einsum("eq,eqai,eqbj->eaibj", scale * -2 / 3, v, g)
        k += cross + cross.transpose(0, 3, 4, 1, 2)
        k += np.einsum("eq,eqai,eqbj->eaibj", scale * first * 2 / 9, g, g)
        turned = scale * first / 3
        k += np.einsum("eq,eqaj,eqbi->eaibj", turned, g, g)
        pj = pressure[:, None] * self.weight * j
        k += np.einsum("eq,eqai,eqbj->eaibj", pj, g, g) - np.einsum("eq,eqaj,eqbi->eaibj", pj, g, g)
        k += np.einsum("e,eai,ebj->eaibj", bulk, swell, swell)
        values = k.reshape(len(k), 24, 24)[self.kept]
        n = len(self.free)
        matrix = sp.csc_matrix((values, (self.rows, self.columns)), shape=(n, n))
        total = np.bincount(self.dofs.ravel(), force.reshape(-1), minlength=3 * len(x))
        return total, matrix

    def newton_step(self, x):
        """Return the Newton direction (free,) mm at x."""
        force, matrix = self.tangent(x)
        factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        return -factor.solve(force[self.free])
