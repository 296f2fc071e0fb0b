"""Time inverse kinematics on the paper-sized network: letters, against SciPy and the paper.

The peer of the factor of five is `scipy.optimize.least_squares(method="lm")`, MINPACK's
Levenberg-Marquardt, from the same warm starts, on passes of onnxruntime with slopes by differences:
the usual code without the core. SciPy on the core's own passes and exact slopes is not a peer but a
part of ours; that row separates the cost of the search from that of the passes. There the ratio is
limited: a waypoint costs only passes, three or four with slopes (from the 0.1 mm error at a
waypoint of this network, a Newton step leaves 0.006 mm, the next 2e-5), and SciPy uses passes of
the same core. SciPy stays mm away at a few waypoints in a hundred, in folds that ours leaves by
other starts. Pinned by tests/benches/test_benches.py.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from benches.network import paper_sized
from benches.row import ratio, side_by_side
from softmap_edge.robot.motion.figures import even, figure
from softmap_edge.robot.motion.kinematics import Kinematics

Floats = NDArray[np.float64]

LETTERS, AMPLITUDE, WAYPOINTS = "SHOE", 15.0, 150
STEP_MM = 0.01  # step of differences: the limit of single precision
CLOSE = 1e-8  # relative tolerance of commands and squared distances: SciPy's default


def rows(waypoints: int = WAYPOINTS) -> list[dict[str, object]]:
    """Return the time per waypoint, for some waypoints per letter, and SciPy's.

    Also return the excess of the distances over those of the paper's method.
    """
    made = paper_sized()
    kinematics = Kinematics(made.model, axes="xy")
    targets, rows = letters(kinematics, waypoints), []
    index = made.model.tip_indices

    def tips(rows: Floats) -> Floats:
        points = made.onnxruntime(rows.astype(np.float32)).reshape(len(rows), -1, 3)
        return np.asarray(points[:, index].mean(axis=1, dtype=np.float64))

    def by_onnxruntime(v: Floats) -> Floats:
        return tips(v[None])[0]

    def differences(v: Floats) -> Floats:
        found = tips(v + STEP_MM * np.concatenate([np.zeros((1, 2)), np.eye(2)]))
        return (found[1:] - found[0]).T[:2] / STEP_MM

    def by_core(v: Floats) -> Floats:
        return np.asarray(kinematics.tip.evaluate(v[None])[0])

    def slopes(v: Floats) -> Floats:
        return np.asarray(kinematics.tip.jacobian(v[None])[0, :2])

    name = "inverse kinematics of a waypoint, paper-sized network"
    peers: list[tuple[str, str, Callable[[], Floats]]] = [
        (
            "SciPy's LM, onnxruntime",
            "goal ≥ 5, aim ≤ 1 ms",
            lambda: by_scipy(by_onnxruntime, differences, targets),
        ),
        (
            "SciPy's LM, on our passes",
            "stated: the search alone",
            lambda: by_scipy(by_core, slopes, targets),
        ),
        ("the paper's way", "stated", lambda: kinematics.solve(targets, method="paper").acting),
    ]
    for peer, wanted, work in peers:
        ours, theirs = side_by_side(lambda: kinematics.solve(targets), work)
        off = np.linalg.norm((kinematics.model.tip(work()) - targets)[:, :2], axis=1)
        if not np.median(off) < 1e-2:
            raise RuntimeError(
                f"{peer} is {np.median(off):.2g} mm off the waypoints: a ratio would say nothing"
            )
        rows.append(ratio(name, ours / len(targets), theirs / len(targets), peer, wanted))
    found, published = kinematics.solve(targets), kinematics.solve(targets, method="paper")
    above = float((found.distance - published.distance).max())
    last = {
        "name": "its distance above that of the paper's way, at most",
        "value": above,
        "unit": "mm",
    }
    return [*rows, last | {"wanted": "goal ≤ 2e-5 (round-off)"}]


def letters(kinematics: Kinematics, waypoints: int = WAYPOINTS) -> Floats:
    """Return the waypoints (T, 3) mm of all letters about the tip at rest."""
    rest = kinematics.model.tip(np.zeros((1, kinematics.model.channels)))[0]
    targets = np.tile(rest, (len(LETTERS) * waypoints, 1))
    targets[:, :2] += np.concatenate(
        [even(figure(letter, AMPLITUDE), waypoints) for letter in LETTERS]
    )
    return targets


def by_scipy(
    place: Callable[[Floats], Floats], slopes: Callable[[Floats], Floats], targets: Floats
) -> Floats:
    """Return effective commands (T, 2) for each target by SciPy, each from the last one.

    place: the tip (3,) at a command (2,). slopes: its slopes (2, 2) there, of x and y.
    """
    from scipy.optimize import least_squares

    u, found = np.zeros(2), []
    for target in targets[:, :2]:

        def off(v: Floats, target: Floats = target) -> Floats:
            return place(v)[:2] - target

        u = least_squares(off, u, slopes, method="lm", xtol=CLOSE, ftol=CLOSE, gtol=CLOSE).x
        found.append(u)
    return np.array(found)
