"""Bounded Levenberg-Marquardt: minimise a sum of squares within bounds.

It is damped by the diagonal of the normal equations.

Parameters at a bound with an outward gradient are fixed in a step. Pinned by
tests/rod/test_elastic.py (exact recovery) and tests/rod/test_learned_memory.py.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Term = Callable[
    [Floats, bool], tuple[Floats, Floats]
]  # x, whether slopes are needed → residuals (m,), their slopes (m, D) or (0, D)

ITERATIONS = 60
ENOUGH = 1e-7  # share of the sum of squares: a smaller fall ends the descent


def descend(
    term: Term,
    x: Floats,
    low: Floats,
    high: Floats,
    iterations: int = ITERATIONS,
    enough: float = ENOUGH,
) -> tuple[Floats, float]:
    """Minimise the sum of squares of `term` within bounds; return the minimiser and the sum."""
    x = np.clip(x, low, high)
    residual = term(x, False)[0]
    cost, damping = float(residual @ residual), 1e-3
    for _ in range(iterations):
        jacobian = term(x, True)[1]
        gradient, square = jacobian.T @ residual, jacobian.T @ jacobian
        free = ~(((x <= low) & (gradient > 0)) | ((x >= high) & (gradient < 0)))
        scale = np.maximum(np.diag(square), 1e-12 * max(float(np.trace(square)), 1e-300))
        fall = 0.0
        while damping < 1e12 and free.any():
            system = square + damping * np.diag(scale)
            step = np.zeros(len(x))
            try:
                step[free] = -np.linalg.solve(system[np.ix_(free, free)], gradient[free])
            # two parameters with the same effect, and damping lost in round-off
            except np.linalg.LinAlgError:
                damping *= 8.0
                continue
            ahead = np.clip(x + step, low, high)
            reached = term(ahead, False)[0]
            fall = cost - float(reached @ reached)
            if fall > 0:
                x, residual, cost = ahead, reached, cost - fall
                damping = max(damping * 0.1, 1e-12)
                break
            damping *= 8.0
        if fall <= enough * cost:
            break
    return x, cost
