"""Estimate the response of servos: delay and lag between sent goals and measured positions.

Each servo is a pure delay followed by a first-order lag (the library's own `latency` and `lag`),
fitted by least squares on a grid that is refined once. A constant offset is ignored. Pinned by
tests/robot/test_track.py.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.files.atomic import Document

Floats = NDArray[np.float64]

LONGEST = (0.5, 0.4)  # s: largest delay and lag of the search
MOVES = 30.0  # ticks that a servo must move for an estimate


def fit_response(t: Floats, goal: Floats, position: Floats) -> tuple[float, float] | None:
    """Return delay and lag (s) of `position` (T, C) behind `goal` (T, C) ticks at `t` (T,) s.

    They are the medians over the servos that move; None if no servo moves.
    """
    found = []
    for asked, measured in zip(goal.T, position.T):
        if np.ptp(asked) < MOVES or np.ptp(measured) < MOVES / 2:
            continue
        delay, lag, steps = 0.25, 0.2, (0.25, 0.2)
        for _ in range(3):
            delays = np.clip(np.linspace(delay - steps[0], delay + steps[0], 26), 0.0, LONGEST[0])
            lags = np.clip(np.linspace(lag - steps[1], lag + steps[1], 21), 0.0, LONGEST[1])
            sets = np.stack(np.meshgrid(delays, lags, indexing="ij"), axis=-1).reshape(-1, 2)
            made = _core.Chain(["latency", "lag"], 1).rollout(sets, asked[:, None], t)[..., 0]
            miss = made - measured
            best = int(np.argmin(np.var(miss, axis=1)))
            delay, lag = map(float, sets[best])
            steps = (steps[0] / 10, steps[1] / 8)
        found.append((delay, lag))
    if not found:
        return None
    middle = np.median(found, axis=0)
    return float(middle[0]), float(middle[1])


def response_of(periods: Sequence[Document]) -> tuple[float, float] | None:
    """Return delay and lag of the servos from a recording.

    It uses complete periods in which goals were sent and all servos were read.
    """
    complete = [
        p for p in periods if p["torque"] and None not in p["goal"] and None not in p["position"]
    ]
    if len(complete) < 50:
        return None
    t = np.array([p["now"] for p in complete], float) * 1e-9
    goal, position = (np.array([p[key] for p in complete], float) for key in ("goal", "position"))
    return fit_response(t - t[0], goal, position)
