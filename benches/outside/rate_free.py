"""Play and stop operators, and least squares with a static map.

They are the basis of manually written laws of memory.

play_g(x): follows x with a total slack of g;   stop_s(x): follows x until it slips at ±s
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from softmap_edge import Run

Floats = NDArray[np.float64]
Columns = Callable[[Run, Floats], Floats]  # columns of a run for the searched numbers: (K, n)


def play(x: Floats, gap: float) -> Floats:
    """Return the output of a play of full gap `gap` for x (T,); it starts in the middle."""
    found, at, half = np.empty(len(x)), float(x[0]), 0.5 * gap
    for k, value in enumerate(x.tolist()):
        at = min(max(at, value - half), value + half)
        found[k] = at
    return found


def stop(x: Floats, slip: float) -> Floats:
    """Return the elongation of a spring that slips at ±slip, along x (T,)."""
    found, held = np.empty(len(x)), 0.0
    for k, step in enumerate(np.diff(x, prepend=x[0]).tolist()):
        held = min(max(held + step, -slip), slip)
        found[k] = held
    return found


def cubic(x: Floats) -> Floats:
    """Return 1, x, x², x³ as columns."""
    return np.stack([np.ones_like(x), x, x**2, x**3], axis=1)


def at_frames(run: Run, rows: Floats, late: float = 0.0) -> Floats:
    """Return rows (T,) of a run at its frames (K,), `late` s late."""
    return np.interp(run.t_seen - late, run.t, rows)


def fitted(
    columns: Columns,
    fit: Run,
    seen: Floats,
    held: Mapping[str, Run],
    starts: Sequence[Sequence[float]],
    low: Sequence[float],
    high: Sequence[float],
) -> dict[str, Floats]:
    """Return predictions (K, Q) on held-out runs, with searched numbers and solved weights.

    The search uses several starts.

    Args:
        columns: returns the columns (K, n) of a run for the searched numbers.
        seen: measurement (K, Q) of `fit`.
        starts: starts of the numbers.
        low: lower bounds of the numbers.
        high: upper bounds of the numbers.
    """

    def off(x: Floats) -> Floats:
        a = columns(fit, x)
        return np.asarray(a @ np.linalg.lstsq(a, seen, rcond=None)[0] - seen).ravel()

    # laws of slips and gaps are not smooth: steps of half a percent
    tries = [
        least_squares(
            off,
            start,
            bounds=(low, high),
            x_scale=np.subtract(high, low),
            diff_step=5e-3,
            max_nfev=40,
        )
        for start in starts
    ]
    best = min(tries, key=lambda one: float(one.cost)).x
    weights = np.linalg.lstsq(columns(fit, best), seen, rcond=None)[0]
    return {name: np.asarray(columns(run, best) @ weights) for name, run in held.items()}
