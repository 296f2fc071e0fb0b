"""One Newton step of many rods at once: a block-tridiagonal solve.

The stiff cables are joined by Woodbury's formula.

Units: mm, N, rad. Pinned by tests/benches/test_bank_rod.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def newton_step(
    blocks: tuple[Floats, ...],
    force: Floats,
    lengths: Floats,
    taut: NDArray[np.bool_],
    stiffness: Floats,
    drawn: Floats | None = None,
) -> Floats:
    """Return the Newton step (B, n, 6): −(K + Σ k d lᵀ)⁻¹ f over the taut cables.

    K is block-tridiagonal, and d = l unless `drawn` is given.
    """
    below, diagonal, above = blocks
    drawn = (lengths if drawn is None else drawn) * taut[:, None, None, :]
    lengths = lengths * taut[:, None, None, :]
    right = np.concatenate([-force[..., None], drawn], axis=3)  # (B, n, 6, 5)
    n = right.shape[1]
    kept: list[tuple[Floats, Floats]] = []
    d, r = diagonal[:, 0], right[:, 0]
    for i in range(n):
        both = np.linalg.solve(d, np.concatenate([above[:, i], r], axis=2) if i < n - 1 else r)
        if i == n - 1:
            kept.append((np.zeros(0), both))
            break
        up, y = both[..., :6], both[..., 6:]
        kept.append((up, y))
        d = diagonal[:, i + 1] - below[:, i] @ up
        r = right[:, i + 1] - below[:, i] @ y
    answer = np.empty_like(right)
    answer[:, -1] = kept[-1][1]
    for i in range(n - 2, -1, -1):
        answer[:, i] = kept[i][1] - kept[i][0] @ answer[:, i + 1]
    plain, by_cable = answer[..., 0], answer[..., 1:]
    inner = np.einsum("bnkc,bnkd->bcd", lengths, by_cable) + np.diag(
        1.0 / np.maximum(stiffness, 1e-12)
    )
    share = np.linalg.solve(inner, np.einsum("bnkc,bnk->bc", lengths, plain)[..., None])
    return np.asarray(plain - (by_cable @ share[:, None])[..., 0])
