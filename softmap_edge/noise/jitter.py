"""Jitter of the frame of reference with a memory, estimated between visits of one pose.

    y = q(pose) + trend(t) + J(t) + e  six rigid coordinates of a settled frame, about the base
    J: Ornstein-Uhlenbeck process, one memory τ, covariance (6, 6)
    e: white noise, estimated from the part that no rigid motion explains
    trend: 1, t, t² of each run

A smooth trend over the run is drift or creep, not jitter. The coordinates are fitted together with
the tangents of the body's shapes (`shape_manifold.py`). So effects on the drive, such as play and
creep, cancel.

Memory and variances maximise the likelihood in the eigenbasis of the detrended correlation
(Lindstrom & Bates 1988, doi:10.1080/01621459.1988.10478693). Rotations share one variance and
shifts another, equal in all directions. An axis gets a variance of its own only if it clearly
differs. Units: mm, rad, s.

Limits: jitter is not detected without revisited poses, or with so few features that none is left
next to rigid motion and the tangents. A memory longer than an eighth of the run counts as a trend.
Pinned by tests/noise/test_jitter.py with jitter of known covariance and memory.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from softmap_edge.noise.repeats import LEAST_DWELL, RUN, drift, filled, poses, rows_of
from softmap_edge.run.conditions import Conditions

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Ints = NDArray[np.int64]
Along = Callable[[NDArray[np.intp]], Floats]  # frames (n,) to motions (n, F, b) by commands

RIGID = 6
# s: trial memories; 0 is independent jitter in each frame
MEMORIES = (0.0, 0.3, 0.6, 1.2, 2.5, 5.0, 10.0, 20.0, 40.0)
LONGEST = 0.125  # of the duration: a longer memory is a trend
# trial variances, in units of the white part
SIZES = np.r_[0.0, np.geomspace(1e-2, 1e4, 61)]
REVISITS = 4  # visits beyond the first of each pose; with fewer, nothing is estimated
FRAMES = 300  # settled frames at most in the likelihood
# log-likelihood that jitter must gain; it fits seven numbers (chi² 24 of 7: 1 in 1000)
CLEAR = 12.0
# gain required for a separate variance of an axis (1 in 100), and for a memory
AXIS, KEPT = 3.3, 5.0
STRONG = 2.0  # white variances that memoryless jitter must reach in some axis
COMMANDED, LEAST_MODE = 4, 0.005  # commanded modes at most, and the least size against the first
UNSEEN = 1e-9  # of the white variance: for a rotation that the points do not show
# mm RMS by which the frame, and commanded motion, may move the points: a rotation that the points
# do not show, as with markers on one line, stays near zero
RIGIDLY, FARTHEST = 3.0, 300.0
SPARE = 1  # features that must remain to show the white part
DEGREE, MANY = 3, 3  # of the smooth map, and the channels above which it has no products


@dataclass(frozen=True)
class Jitter:
    """Rigid jitter of the frame of reference.

    Attributes:
        covariance: of rotations (rad) and shifts (mm) about the base, (6, 6).
        memory_s: correlation time, s; 0 if each frame has new jitter.
        revisits: number of visits beyond the first of each pose; they show the jitter.
    """

    covariance: Floats
    memory_s: float
    revisits: int

    def of_features(self, features: Floats, positions: Mask) -> Floats:
        """Return the mean covariance of the features by this jitter.

        Args:
            features: measured features, (K, F) mm.
            positions: which features are places, (V,).

        Returns:
            Floats: covariance (F, F) mm², averaged over the frames.
        """
        columns = rigid(features, positions)  # (K, F, 6)
        flat = np.swapaxes(columns, 0, 1).reshape(features.shape[1], -1)
        moved = np.swapaxes(columns @ self.covariance, 0, 1).reshape(features.shape[1], -1)
        return np.asarray(moved @ flat.T / max(1, len(features)))


@dataclass(frozen=True)
class Coordinates:
    """Coordinates of frames: six rigid ones, and one for each commanded mode.

    Attributes:
        values: coordinates, (n, m).
        white: their covariance by white noise, (n, m, m).
        columns: derivative of the features by the coordinates, (n, F, m).
    """

    values: Floats
    white: Floats
    columns: Floats

    @property
    def rigid(self) -> Floats:
        """Rotations (rad) and shifts (mm), (n, 6)."""
        return self.values[:, :RIGID]

    @property
    def commanded(self) -> Floats:
        """Scores (n, b) mm of the commanded modes."""
        return self.values[:, RIGID:]

    @property
    def explained(self) -> Floats:
        """Displacement of the features by all coordinates, (n, F) mm."""
        return np.asarray((self.columns @ self.values[:, :, None])[:, :, 0])


def rigid(features: Floats, positions: Mask) -> Floats:
    """Return the derivatives of features by rotations (rad) and shifts (mm) about the base.

    A direction rotates with the frame and does not shift.

    Args:
        features: (K, F) mm.
        positions: which features are places, (V,); the others are directions.

    Returns:
        Floats: derivatives (K, F, 6), rotations first.
    """
    vectors = features.reshape(len(features), -1, 3)
    out = np.zeros((*vectors.shape, RIGID))
    x, y, z = np.moveaxis(vectors, 2, 0)
    out[:, :, 1, 0], out[:, :, 2, 0] = -z, y
    out[:, :, 0, 1], out[:, :, 2, 1] = z, -x
    out[:, :, 0, 2], out[:, :, 1, 2] = -y, x
    out[:, :, :, 3:] = np.where(positions[:, None, None], np.eye(3), 0.0)
    return out.reshape(len(features), -1, RIGID)


def commanded_modes(seen: Floats, command: Floats, most: int = COMMANDED) -> Floats:
    """Return orthonormal modes of a smooth map from commands to features.

    Args:
        seen: measured features, (K, F) mm; NaN where unseen.
        command: (K, C).
        most: largest number of modes.

    Returns:
        Floats: modes (b, F); none if too few frames determine the map.
    """
    columns = polynomial(command)
    if columns.shape[1] < 2 or len(seen) < 2 * columns.shape[1]:
        return np.zeros((0, seen.shape[1]))
    known = filled(seen)
    smooth = columns @ np.linalg.lstsq(columns, known, rcond=None)[0]
    _, size, modes = np.linalg.svd(smooth - smooth.mean(axis=0), full_matrices=False)
    count = int((size > LEAST_MODE * size[0]).sum()) if len(size) and size[0] > 0 else 0
    return np.asarray(modes[: min(count, most)])


def in_all(modes: Floats) -> Along:
    """Return the motion along modes (b, F), which is the same in all frames."""
    return lambda rows: np.broadcast_to(modes.T, (len(rows), *modes.T.shape))


def polynomial(command: Floats) -> Floats:
    """Return the monomials (K, m) of commands (K, C), up to cubic.

    The commands are scaled to ±1. Above `MANY` channels there are no products of channels.
    """
    span = np.ptp(command, axis=0) if len(command) else np.zeros(command.shape[1])
    x = command[:, span > 0]
    x = 2.0 * (x - x.min(axis=0, initial=np.inf)) / span[span > 0] - 1.0 if len(command) else x
    one = np.ones((len(command), 1))
    if x.shape[1] > MANY:
        return np.concatenate([one, x, x**2, x**3], axis=1)
    sets = [
        c for n in range(1, DEGREE + 1) for c in combinations_with_replacement(range(x.shape[1]), n)
    ]
    return np.concatenate(
        [one, *(np.prod(x[:, list(c)], axis=1, keepdims=True) for c in sets)], axis=1
    )


def coordinates(
    values: Floats, seen: Floats, positions: Mask, along: Floats, white: Floats
) -> Coordinates:
    """Return the coordinates of frames by weighted least squares.

    Args:
        values: deviations, (n, F) mm; NaN is ignored.
        seen: measured features, (n, F) mm, all finite; they give the displacement by a rotation.
        positions: which features are places, (V,).
        along: motions that commands cause, (n, F, b): tangents of each frame, or modes of all.
        white: variance of the features, (F,) mm²; its inverse is the weight.

    Returns:
        Coordinates: six rigid coordinates and b commanded ones for each frame.
    """
    columns = np.concatenate([rigid(seen, positions), along], axis=2)  # (n, F, 6 + b)
    scale = np.maximum(np.sqrt(np.mean(columns**2, axis=(0, 1))), 1e-12)
    known = np.isfinite(values)
    weighted = columns / scale / np.sqrt(white)[:, None] * known[:, :, None]
    prior = np.r_[np.full(RIGID, RIGIDLY), np.full(along.shape[2], FARTHEST)] ** -2.0
    gram = np.swapaxes(weighted, 1, 2) @ weighted + np.diag(prior)
    inverse = np.linalg.solve(gram, np.swapaxes(weighted, 1, 2))  # (n, 6 + b, F)
    found = np.einsum("nmf,nf->nm", inverse, np.where(known, values, 0.0) / np.sqrt(white)) / scale
    covariance = inverse @ np.swapaxes(inverse, 1, 2) / np.outer(scale, scale)
    return Coordinates(found, covariance, columns)


def white_variance(
    values: Floats, seen: Floats, positions: Mask, along: Along, dwell: Ints
) -> Floats | None:
    """Return the variance in dwells that neither rigid motion nor commands explain.

    Args:
        values: (K, F) mm.
        seen: measured features, (K, F) mm.
        positions: which features are places, (V,).
        along: motions that commands cause, at given frames.
        dwell: number of the dwell of each frame, (K,); -1 outside dwells.

    Returns:
        Floats | None: variance (F,) mm²; None if too few features or frames remain to show it.
    """
    left = values.shape[1] - RIGID - along(np.arange(1)).shape[2]
    if left < SPARE:
        return None
    total, degrees = np.zeros(values.shape[1]), 0
    flat = np.ones(values.shape[1])
    for frames in rows_of(dwell, LEAST_DWELL):
        part, shape = filled(values[frames]), filled(seen[frames])
        part = part - drift(len(part)) @ (drift(len(part)).T @ part)
        found = coordinates(part, shape, positions, along(frames), flat)
        total += np.sum((part - found.explained) ** 2, axis=0)
        degrees += len(frames) - drift(len(frames)).shape[1]
    if not degrees:
        return None
    pooled = float(total.mean()) / degrees * values.shape[1] / left
    own = total / degrees * values.shape[1] / left
    return np.asarray(np.maximum(0.5 * own + 0.5 * pooled, 1e-8))


def frame_jitter(
    values: Floats,
    seen: Floats,
    positions: Mask,
    state: Conditions,
    dwell: Ints,
    along: Along,
    white: Floats,
) -> Jitter | None:
    """Estimate the jitter of the frame between visits of the same poses.

    Args:
        values: features minus the shapes that commands make (`shape_manifold.py`), (K, F) mm.
        seen: measured features, (K, F) mm.
        positions: which features are places, (V,).
        state: conditions of the frames.
        dwell: number of the dwell of each frame, (K,); -1 outside dwells.
        along: the tangents of these shapes.
        white: variance (F,) mm², from `white_variance`.

    Returns:
        Jitter | None: None if the run shows no jitter, or revisits too few poses to show it.
    """
    groups = poses(state, np.where(np.isfinite(values).any(axis=1), dwell, -1))
    revisits = sum(len(pose) - 1 for pose in groups)
    if revisits < REVISITS:
        return None
    rows, pose = _thinned(groups)
    apart, shape = _about(values[rows], pose)[0], _about(seen[rows], pose)[1]
    found = coordinates(apart, shape, positions, along(rows), white)
    root = _root(found.white[:, :RIGID, :RIGID].mean(axis=0), shape)
    flat = np.linalg.solve(root, found.rigid.T).T  # white part of unit variance
    t, run = state.time[rows], dwell[rows] >> RUN
    free = _detrending(t, pose, run)  # (n, n - p), orthonormal complement of groups and trends
    y = free.T @ flat
    axes = np.linalg.eigh(y.T @ y)[1]
    # (6, 6): turns and shifts along each axis
    seen_as = np.linalg.solve(root, np.eye(RIGID)).T @ axes
    parts = np.stack(
        [np.sum(seen_as[half] ** 2, axis=0) for half in (slice(0, 3), slice(3, 6))], axis=1
    )
    likely = [(*_likelihood(y @ axes, free, t, run, tau, parts), tau) for tau in _memories(t, run)]
    fresh, kept = likely[0], max(likely, key=lambda one: one[0])
    gain, sizes, memory = kept if kept[0] > fresh[0] + KEPT else fresh
    # new jitter in each frame shows in dwells anyway
    if gain < CLEAR or (memory == 0.0 and sizes.max() < STRONG):
        return None
    turn = root @ axes
    return Jitter((turn * sizes) @ turn.T, memory, revisits)


def _root(noise: Floats, shapes: Floats) -> Floats:
    """Return the Cholesky factor of the white covariance (6, 6).

    It also exists if the points do not show a rotation, as with markers on one line.
    """
    radius = float(np.sqrt(np.mean(shapes**2)))
    scale = np.r_[np.full(3, radius), np.ones(3)]
    alike = noise * np.outer(scale, scale)  # mm²
    return np.asarray(
        np.linalg.cholesky(alike + UNSEEN * np.trace(alike) * np.eye(RIGID)) / scale[:, None]
    )


def _thinned(groups: Sequence[Sequence[NDArray[np.intp]]]) -> tuple[NDArray[np.intp], Ints]:
    """Return the frames of all visits, thinned to FRAMES, and the number of the pose of each."""
    rows = np.concatenate([np.concatenate(list(pose)) for pose in groups])
    which = np.concatenate([np.full(sum(map(len, pose)), i) for i, pose in enumerate(groups)])
    order = np.argsort(rows)
    keep = order[np.unique(np.linspace(0, len(rows) - 1, min(FRAMES, len(rows))).astype(int))]
    return rows[keep], which[keep]


def _about(values: Floats, pose: Ints) -> tuple[Floats, Floats]:
    """Return values (n, F) about the mean of their pose, and these means (n, F).

    Unseen values are NaN; the means are all finite.
    """
    known = np.isfinite(values)
    each = [
        (np.where(known, values, 0.0)[at].sum(axis=0), known[at].sum(axis=0)) for at in _each(pose)
    ]
    mean = np.stack(
        [np.where(count > 0, total / np.maximum(count, 1), np.nan) for total, count in each]
    )
    return values - mean[pose], filled(mean)[pose]


def _each(pose: Ints) -> list[Mask]:
    return [pose == p for p in range(int(pose.max()) + 1)]


def _detrending(t: Floats, pose: Ints, run: Ints) -> Floats:
    """Return an orthonormal basis (n, m) of all that is neither a pose mean nor a slow drift.

    It is the complement of the pose means and of a quadratic in time for each run.
    """
    columns = [(pose == p).astype(float) for p in np.unique(pose)]
    for one in np.unique(run):
        s = (t - t[run == one].mean()) / max(float(np.ptp(t[run == one])), 1e-9) * (run == one)
        columns += [s, s * s]
    basis = np.stack(columns, axis=1)
    left, size, _ = np.linalg.svd(basis, full_matrices=True)
    return np.asarray(left[:, int((size > 1e-9 * size[0]).sum()) :])


def _memories(t: Floats, run: Ints) -> list[float]:
    longest = LONGEST * max(float(np.ptp(t[run == one])) for one in np.unique(run))
    return [tau for tau in MEMORIES if tau <= longest or tau == 0.0]


def _likelihood(
    y: Floats, free: Floats, t: Floats, run: Ints, tau: float, parts: Floats
) -> tuple[float, Floats]:
    """Return the gain in log-likelihood of y (m, 6) with memory `tau`, and the variances (6,).

    The gain is relative to white noise. By default an axis has the variance of jitter that is equal
    in all directions; `parts` (6, 2) are the shares of rotations and shifts in each axis. An axis
    gets a variance of its own only if that is clearly more likely. Otherwise a poorly visible axis
    would often get no variance, or all of the noise.
    """
    between = np.abs(t[:, None] - t[None, :])
    apart = np.exp(-between / tau) * (run[:, None] == run[None, :]) if tau else np.eye(len(t))
    values, vectors = np.linalg.eigh(free.T @ apart @ free)
    power = (vectors.T @ y) ** 2  # (m, 6)
    spread = 1.0 + SIZES[:, None] * np.maximum(values, 0.0)  # (s, m)
    gain = -0.5 * np.log(spread).sum(axis=1)[:, None] - 0.5 * (1.0 / spread - 1.0) @ power  # (s, 6)
    axis = np.arange(y.shape[1])
    alike = _alike(gain, parts)  # (6,)
    own = np.argmax(gain, axis=0)
    expected = np.array([np.interp(alike[i], SIZES, gain[:, i]) for i in axis])
    apart_from = gain[own, axis] - expected > AXIS
    return float(np.where(apart_from, gain[own, axis], expected).sum()), np.where(
        apart_from, SIZES[own], alike
    )


def _alike(gain: Floats, parts: Floats) -> Floats:
    """Return the variances (6,) of jitter that is equal in all directions.

    `gain` (s, 6) is the gain in log-likelihood for each of SIZES; `parts` is as in `_likelihood`.
    """
    # the largest share of turns, or of shifts, in an axis
    unit = np.maximum(parts.max(axis=0), 1e-300)
    best, found = 0.0, np.zeros(len(parts))
    for turn in SIZES[::2] / unit[0]:
        sizes = parts[:, 0] * turn + parts[:, 1] * (SIZES[::2, None] / unit[1])  # (s, 6)
        total = sum(np.interp(sizes[:, i], SIZES, gain[:, i]) for i in range(len(parts)))
        one = int(np.argmax(total))
        if float(np.asarray(total)[one]) > best:
            best, found = float(np.asarray(total)[one]), sizes[one]
    return found
