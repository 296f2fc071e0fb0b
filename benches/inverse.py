"""Rows of inverse kinematics on the paper-sized network: the letters, waypoint by waypoint, beside SciPy and the paper's way.

The peer is `scipy.optimize.least_squares(method="lm")`, MINPACK's Levenberg-Marquardt in Fortran, on the same passes and the
same exact slopes through the same binding, from the same warm starts and to the same distance; its way through Python
between passes is what a user of SciPy pays. Pinned by tests/test_benches.py.
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from benches.network import paper_sized
from benches.row import ratio, side_by_side
from softmap_edge.motion.curves import even, figure
from softmap_edge.motion.kinematics import Kinematics

Floats = NDArray[np.float64]

LETTERS, AMPLITUDE, WAYPOINTS = "SHOE", 15.0, 150
CLOSE = 1e-8  # relative, of commands and of squared distances: SciPy's own usual value


def rows() -> list[dict[str, object]]:
    """Return the time of a waypoint beside SciPy's, and by how much distances are above those of the paper's way."""
    kinematics = Kinematics(paper_sized().model, axes="xy")
    targets = letters(kinematics)
    ours, theirs = side_by_side(lambda: kinematics.solve(targets), lambda: by_scipy(kinematics, targets))
    found, peer = kinematics.solve(targets), by_scipy(kinematics, targets)
    begun = time.perf_counter()
    published = kinematics.solve(targets, method="paper")
    paper = time.perf_counter() - begun
    count = len(targets)
    if not np.median(_distance(kinematics, peer, targets)) < 1e-4:
        raise RuntimeError("SciPy does not reach the waypoints: a ratio would say nothing")
    name = "inverse kinematics of a waypoint, paper-sized network"
    above = float((found.distance - published.distance).max())
    return [
        ratio(name, ours / count, theirs / count, "SciPy's LM", "wanted ≥ 5, aim ≤ 1 ms"),
        ratio(name, ours / count, paper / count, "the paper's way", "stated"),
        {"name": "its distance above that of the paper's way, at most", "value": above, "unit": "mm",
         "wanted": "wanted ≤ 1e-5 (round-off)"},
    ]  # fmt: skip


def letters(kinematics: Kinematics, waypoints: int = WAYPOINTS) -> Floats:
    """Return the waypoints (T, 3) mm of all letters about the tip at rest."""
    rest = kinematics.model.tip(np.zeros((1, kinematics.model.channels)))[0]
    targets = np.tile(rest, (len(LETTERS) * waypoints, 1))
    targets[:, :2] += np.concatenate([even(figure(letter, AMPLITUDE), waypoints) for letter in LETTERS])
    return targets


def by_scipy(kinematics: Kinematics, targets: Floats) -> Floats:
    """Return what must act (T, C) for each target as SciPy finds it, each from where the last one was found."""
    from scipy.optimize import least_squares

    tip, u, found = kinematics.tip, np.zeros(kinematics.model.channels), []
    for target in targets[:, :2]:

        def off(v: Floats, target: Floats = target) -> Floats:
            return np.asarray(tip.evaluate(v[None])[0, :2] - target)

        def slopes(v: Floats) -> Floats:
            return np.asarray(tip.jacobian(v[None])[0, :2])

        u = least_squares(off, u, slopes, method="lm", xtol=CLOSE, ftol=CLOSE, gtol=CLOSE).x
        found.append(u)
    return np.array(found)


def _distance(kinematics: Kinematics, acting: Floats, targets: Floats) -> Floats:
    return np.asarray(np.linalg.norm((kinematics.model.tip(acting) - targets)[:, :2], axis=1))
