"""Fit the map of ticks to the shapes themselves, starting from the matched commands.

    min Σ_k ρ(d_k)    Y_k = Rz(φ) f(A r_k + b) + left_k,   d_k² = g_kᵀ H_k⁻¹ g_k,   H_k = Jᵀ W J,
        g_k = Jᵀ W left_k
    var φ = [H⁻¹ (Σ_k s_k s_kᵀ) H⁻¹] n / (n − p)    of an M-estimator (Huber 1981, 7.6), s_k = the
                                                    score of each row

d_k is the distance of a held command from the map, in mm of shape. Errors that no command can
correct do not count. A slack command hardly moves the shape: a match of it jumps over the full
slack because of small model errors, and so does a fit to matched commands. Here its weight is its
effect on the shape. φ is a rotation of all shapes about the base's axis, fitted with the map on
request. It stands for tendons at other angles about the axis, or for the roll of the frame. Units:
mm, ticks, rad. Pinned by tests/calibration/test_calibration.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.calibration.affine import SETTLED, TUKEY, WIDER, weights
from softmap_edge.calibration.departures import CLEAR, Departure
from softmap_edge.calibration.held_out import HeldOut, SeenMarkers
from softmap_edge.calibration.matching import Shapes, weighted
from softmap_edge.model.orientation import priors_by_orientation

if TYPE_CHECKING:
    from softmap_edge.model.model import Model
    from softmap_edge.run.run import Run

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

EACH, MOST = 3, 600  # frames of each held command, and in total, used in the fit
ROUNDS = 30
EXACT = 1e-6  # mm: smaller scatter is ignored


@dataclass(frozen=True, eq=False)
class MapFit:
    """A map of ticks to commands, fitted to shapes.

    Attributes:
        coefficients: A and b, (C, C + 1).
        turn: rotation of all shapes about the axis of the base, rad.
        turn_sigma: its standard deviation, rad.
        weight: of each held command, (n,); 0 if it is an outlier.
    """

    coefficients: Floats
    turn: float
    turn_sigma: float
    weight: Floats

    def __call__(self, design: Floats) -> Floats:
        """Return the commands (n, C) for rows (n, C + 1) of ticks from home, and 1."""
        return np.asarray(design @ self.coefficients.T)


class Sights:
    """The data of a map fit: a few frames of each held command, ticks from home, and shapes."""

    def __init__(
        self, model: Model, run: Run, held: HeldOut, seen: SeenMarkers, home: Floats
    ) -> None:
        """Choose the frames of the held commands.

        Args:
            model: its shapes are compared with the run.
            run: with shapes.
            held: the held commands.
            seen: the frames of the run that may be used.
            home: (C,) ticks.
        """
        each = max(1, min(EACH, MOST // max(len(held), 1)))
        picked = [
            np.unique(part[np.linspace(0, len(part) - 1, each).astype(int)]) for part in held.frames
        ]
        frames, row = (
            np.concatenate(picked),
            np.repeat(np.arange(len(held)), [len(part) for part in picked]),
        )
        order = np.argsort(frames)
        frames, self.row = frames[order], row[order]
        self.rows = len(held)
        away = seen.ticks[np.searchsorted(seen.frame, frames)] - home
        self.design = np.column_stack([away, np.ones(len(away))])
        some = run.at(frames)
        self.points, weight = weighted(model, some)
        self.weight = weight / weight.sum(axis=1, keepdims=True)
        self.parts = [
            (at, Shapes(model, some, family)) for at, family in priors_by_orientation(model, some)
        ]

    def look(self, coefficients: Floats, turn: float) -> tuple[Floats, Floats]:
        """Return the errors of the shapes under a map, and their slopes.

        Args:
            coefficients: A and b, (C, C + 1).
            turn: rotation of all shapes, rad.

        Returns:
            tuple[Floats, Floats]: errors (n, N, 3) mm, and slopes (n, N, 3, C + 1) by commands and
                rotation.
        """
        u = self.design @ coefficients.T
        left, slopes = np.empty(self.points.shape), np.empty((*self.points.shape, u.shape[1] + 1))
        for at, shapes in self.parts:
            turned = shapes.turned(turn)
            there, own = turned(u[at]), self.weight[at]
            about = np.stack([-there[..., 1], there[..., 0], np.zeros(there.shape[:2])], axis=-1)
            all_ = [(self.points[at] - there)[..., None], turned.slopes(u[at]), about[..., None]]
            both = turned.without_roll(np.concatenate(all_, axis=-1), there, own)
            left[at], slopes[at] = both[..., 0], both[..., 1:]
        return left, slopes

    def normal(self, left: Floats, slopes: Floats) -> tuple[Floats, Floats]:
        """Return Jᵀ W J (n, C + 1, C + 1) and Jᵀ W left (n, C + 1) of each frame.

        They are for the commands and the rotation.
        """
        bend = np.einsum("kn,knxc,knxd->kcd", self.weight, slopes, slopes, optimize=True)
        return bend, np.einsum("kn,knxc,knx->kc", self.weight, slopes, left, optimize=True)

    def error_of(self, found: MapFit) -> Floats:
        """Return the RMS distance (rows,) mm of each held command from a map."""
        return self.errors(self.look(found.coefficients, found.turn)[0])

    def errors(self, left: Floats) -> Floats:
        """Return the RMS distance (rows,) mm of each held command, from errors (n, N, 3) mm."""
        square = np.einsum("kn,knx->k", self.weight, left**2)
        return np.asarray(np.sqrt(np.bincount(self.row, square) / np.bincount(self.row)))


def turned_shapes(sights: Sights, start: Floats, blocks: list[Mask]) -> list[Departure]:
    """Return the share of the held-out error that a rotation about the base's axis explains.

    Args:
        sights: the data.
        start: A and b at the start, (C, C + 1).
        blocks: held commands that are left out together, (rows,) each.

    Returns:
        list[Departure]: empty if the rotation is not significant.
    """
    error, features = np.full((2, sights.rows), np.nan), start.shape[1]
    for test in blocks:
        if (~test).sum() > 2 * features:
            for turned in (False, True):
                error[int(turned), test] = sights.error_of(fit_map(sights, start, turned, ~test))[
                    test
                ]
    found = fit_map(sights, start, True, np.ones(sights.rows, bool))
    good = np.flatnonzero((found.weight > 0) & np.isfinite(error).all(axis=0))
    if len(good) < 2:
        return []
    gain = error[0, good] ** 2 - error[1, good] ** 2
    before, after = (float(np.sqrt(np.mean(e**2))) for e in error[:, good])
    clear = gain.mean() > CLEAR * gain.std() / np.sqrt(len(gain)) and before > EXACT
    if not clear or abs(found.turn) < CLEAR * found.turn_sigma:
        return []
    size, sigma = np.degrees(found.turn), np.degrees(found.turn_sigma)
    sentence = (
        f"turned: all shapes stand {size:+.2f} ± {sigma:.2g} deg about the axis of the base from "
        f"where the map puts them (held-out error {before:.2g} → {after:.2g} mm RMS of shape): "
        "tendons at other angles about the axis, or the roll of the frame. No map of ticks turns "
        "shapes: A and b are without the turn, and `softmap diagnose` with the new bundle names "
        "it"
    )
    away = sights.design[np.flatnonzero(sights.row == good[np.argmax(gain)])[0], :-1]
    return [
        Departure(
            "turn", 1.0 - after / before, before, after, abs(float(size)), away.tolist(), sentence
        )
    ]


def fit_map(sights: Sights, start: Floats, turned: bool, use: Mask) -> MapFit:
    """Fit A and b, and optionally a rotation, to held commands.

    Args:
        sights: the data.
        start: A and b at the start, (C, C + 1).
        turned: whether to fit the rotation.
        use: held commands to fit, (rows,).
    """
    channels, features = start.shape
    size = np.maximum(np.sqrt(np.mean(sights.design**2, axis=0)), 1e-300)
    # what a coefficient moves
    spread = np.zeros((len(sights.design), channels, features, channels + 1))
    for c in range(channels):
        spread[:, c, :, c] = sights.design / size
    moves = spread.reshape(len(spread), -1, channels + 1)
    if turned:
        moves = np.concatenate(
            [moves, np.tile(np.eye(channels + 1)[-1:], (len(moves), 1, 1))], axis=1
        )
    scale = np.r_[np.tile(size, channels), np.ones(int(turned))]
    theta, damping = np.r_[start.ravel() * scale[: start.size], np.zeros(int(turned))], 1e-6

    def at(theta: Floats) -> tuple[Floats, Floats, Floats, Floats, float]:
        """Return errors, weights, matrix, scores, and the mean slope of ψ at coefficients."""
        left, slopes = sights.look(
            (theta / scale)[: start.size].reshape(start.shape), theta[-1] if turned else 0.0
        )
        bend, pull = sights.normal(left, slopes)
        rho, steep = _weights(bend[:, :-1, :-1], pull[:, :-1], sights.row, use)
        seen = rho[sights.row] / np.bincount(sights.row)[sights.row]
        matrix = np.einsum("k,kpc,kcd,kqd->pq", seen, moves, bend, moves, optimize=True)
        scores = np.zeros((sights.rows, len(theta)))
        np.add.at(scores, sights.row, seen[:, None] * np.einsum("kpc,kc->kp", moves, pull))
        return sights.errors(left), rho, matrix, scores, steep

    error, rho, matrix, scores, steep = at(theta)
    for _ in range(ROUNDS):
        step = np.linalg.lstsq(
            matrix + damping * np.diag(np.diag(matrix) + 1e-30), scores.sum(axis=0)
        )[0]
        tried = at(theta + step)
        if (rho * tried[0] ** 2).sum() > (1.0 + 1e-9) * (rho * error**2).sum():
            damping = max(8.0 * damping, 1e-3)
            continue
        theta, damping = theta + step, 0.2 * damping
        error, rho, matrix, scores, steep = tried
        if np.abs(step).max() < SETTLED * np.abs(theta).max():
            break
    inverse = np.linalg.pinv(matrix, hermitian=True) * float(rho[use].mean() / steep)
    free = use.sum() / max(use.sum() - len(theta) / channels, 1.0)
    sigma = np.sqrt(np.diag(inverse @ (scores.T @ scores) @ inverse) * free)
    turn, turn_sigma = (float(theta[-1]), float(sigma[-1])) if turned else (0.0, 0.0)
    return MapFit((theta / scale)[: start.size].reshape(start.shape), turn, turn_sigma, rho)


def _weights(bend: Floats, pull: Floats, row: NDArray[np.int64], use: Mask) -> tuple[Floats, float]:
    """Return Tukey's weights (rows,) of held commands by their distance, and the slope of ψ."""
    channels = pull.shape[1]
    h, g = np.zeros((len(use), channels, channels)), np.zeros((len(use), channels))
    per = np.bincount(row)
    np.add.at(h, row, bend / per[row, None, None])
    np.add.at(g, row, pull / per[row, None])
    h += (1e-6 * np.einsum("kcc->k", h)[:, None, None] + 1e-300) * np.eye(channels)
    distance = np.sqrt(
        np.maximum(np.einsum("kc,kc->k", g, np.linalg.solve(h, g[..., None])[..., 0]), 0.0)
    )
    scatter = max(float(np.median(distance[use])) / _middle(channels), EXACT)
    limit = TUKEY + WIDER * (channels - 1)
    weight, slope = weights(distance / scatter, limit, np.full(len(use), channels))
    return np.where(use, weight, 0.0), max(float(slope[use].mean()), 0.1)


def _middle(count: int) -> float:
    """Return the median length of `count` normal numbers (Wilson & Hilferty 1931, to 2 %)."""
    return float(np.sqrt(count * (1.0 - 2.0 / (9.0 * count)) ** 3))
