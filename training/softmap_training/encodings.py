"""Encode shapes by differences: the outputs of a network, and their linear map to positions.

laplacian   δ = L v, the cotangent Laplacian of the vertices (Sorkine et al. 2004,
            doi:10.1145/1057432.1057456); back:
            the v of least |L v − δ|² + w² |v_h − q_h|² with the clamped vertices h at their places
            q
arap        nine numbers R_i a vertex, the rotation that takes its edges at rest to where they are
            (Sorkine & Alexa
            2007), and the places of a few handle vertices, since rotations know nothing of a body
            that is compressed; back: the v of least Σ w_ij |(v_i − v_j) − ½(R_i + R_j)(v⁰_i −
            v⁰_j)|² + w² |v_h − q_h|²

Both are linear in the prediction, so they are a fixed last layer of a network. The paper does not
specify the clamped vertices, the handles, or the elementwise prediction of R. Units: mm. Pinned by
tests/training/test_baselines.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from softmap_edge import _core

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

HELD = 100.0  # w of a clamped vertex
HANDLE, HANDLES = 1.0, 27  # w of a handle, and number of handles


@dataclass(frozen=True, eq=False)
class Encoding:
    """`codes` (S, m) of shapes; inverse: points (S, 3N) = mean (3N,) + codes · modes (m, 3N)."""

    codes: Floats
    mean: Floats
    modes: Floats


def laplacian(
    rest: Floats, triangles: NDArray[np.int32], held: Indices, points: Floats
) -> Encoding:
    """Encode points (S, 3N) mm as Laplacian coordinates."""
    matrix, _ = _laplacian(rest, triangles, held)
    shapes = points.reshape(len(points), -1, 3)
    codes = np.einsum("ij,sjc->sic", matrix, shapes).reshape(len(points), -1)
    hold = np.zeros(len(rest))
    hold[held] = HELD**2
    back = np.linalg.solve(
        matrix.T @ matrix + np.diag(hold), np.column_stack([matrix.T, np.diag(hold)])
    )
    return Encoding(codes, (back[:, len(rest) :] @ rest).ravel(), _each_axis(back[:, : len(rest)]))


def arap(rest: Floats, triangles: NDArray[np.int32], held: Indices, points: Floats) -> Encoding:
    """Encode points (S, 3N) mm as rotations of vertices and handles.

    Codes are nine values for each vertex, then three for each handle.
    """
    matrix, (first, other, weight) = _laplacian(rest, triangles, held)
    edge = rest[first] - rest[other]
    shapes = points.reshape(len(points), -1, 3)
    now = shapes[:, first] - shapes[:, other]
    ends = _ends(first, other, len(rest))
    outer = (weight[:, None, None] * now[..., :, None] * edge[:, None, :]).reshape(
        len(points), len(weight), 9
    )
    spread = np.stack([ends @ one for one in outer]).reshape(len(points), len(rest), 3, 3)
    left, _, right = np.linalg.svd(spread)
    flip = np.ones((*spread.shape[:2], 3))
    flip[..., 2] = np.sign(np.linalg.det(left @ right))
    handles = _apart(rest, HANDLES)
    codes = np.column_stack(
        [
            ((left * flip[..., None, :]) @ right).reshape(len(points), -1),
            shapes[:, handles].reshape(len(points), -1),
        ]
    )
    # The right side of vertex i: Σ_j ½ w_ij (R_i + R_j)(v⁰_i − v⁰_j), as a map of the nine values
    # of each R.
    count = len(rest)
    on = np.zeros((count, count, 3))  # on[i, k]: the vector that R_k is applied to, for vertex i
    half = 0.5 * weight[:, None] * edge
    for a, b, sign in ((first, other, 1.0), (other, first, -1.0)):
        np.add.at(on, (a, a), sign * half)
        np.add.at(on, (a, b), sign * half)
    hold = np.zeros(count)
    hold[held] = HELD**2
    grip = np.zeros(count)
    grip[handles] = HANDLE**2
    system = np.linalg.inv(matrix + np.diag(hold + grip))
    solved = np.einsum("vi,ikc->vkc", system, on)  # (V, K, 3)
    modes = np.zeros((count, 3, 3, count, 3))  # R_k's row r and column c → axis r of vertex v
    for r in range(3):
        modes[:, r, :, :, r] = solved.transpose(1, 2, 0)
    mean = (system[:, held] * HELD**2 @ rest[held]).ravel()
    modes = modes.reshape(9 * count, 3 * count)
    return Encoding(
        codes, mean, np.concatenate([modes, _each_axis(system[:, handles] * HANDLE**2)])
    )


def _laplacian(
    rest: Floats, triangles: NDArray[np.int32], held: Indices
) -> tuple[Floats, tuple[Indices, Indices, Floats]]:
    """Return the cotangent Laplacian (N, N), and the edges with their weights."""
    first, other, weight = _core.Registration(
        rest, np.asarray(triangles).tolist(), held.tolist()
    ).edges()
    matrix = np.zeros((len(rest), len(rest)))
    matrix[first, other] = matrix[other, first] = -weight
    matrix[np.arange(len(rest)), np.arange(len(rest))] = -matrix.sum(axis=1)
    return matrix, (first, other, weight)


def _apart(places: Floats, count: int) -> Indices:
    """Return distant vertices: the highest, then each farthest from the previous ones."""
    chosen = [int(np.argmax(places[:, 2]))]
    near = np.linalg.norm(places - places[chosen[0]], axis=1)
    while len(chosen) < min(count, len(places)):
        chosen.append(int(np.argmax(near)))
        near = np.minimum(near, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return np.array(chosen)


def _ends(first: Indices, other: Indices, count: int) -> csr_array:
    """Return the map (N, E) that sums over the edges of each vertex."""
    edges = np.arange(len(first))
    ones = np.ones(2 * len(first))
    return csr_array(
        (ones, (np.concatenate([first, other]), np.concatenate([edges, edges]))),
        (count, len(first)),
    )


def _each_axis(back: Floats) -> Floats:
    """Expand a map (N, m) of one coordinate to all coordinates, (3m, 3N).

    It maps codes to points, row by row of the codes.
    """
    return np.asarray(np.kron(back.T, np.eye(3)))
