"""Motion of the body while its commands are constant: a hum of one frequency, or irregular motion.

    s(t) = c(dwell) + d(dwell) t + a cos 2πft + b sin 2πft + e
        score of a frame along a mode of commanded motion

A line is one frequency with one phase over all dwells. It explains the share P of the variance that
remains in dwells after their drift is subtracted. Noise reaches P with probability (1 − P)^((n −
3)/2) for each mode and frequency (Scargle 1982, doi:10.1086/160554). Motion is irregular if the
scatter along the commanded modes is EXCESS times larger than isotropic noise would give there.
Units: mm, s, Hz.

Limits: with fewer than SPARE features besides modes and rigid motion, only lines are found. Motion
slower than a dwell is not found. Pinned by tests/noise/test_motion_at_rest.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from softmap_edge.noise.jitter import coordinates, in_all, white_variance
from softmap_edge.noise.repeats import LEAST_DWELL, filled, rows_of

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Ints = NDArray[np.int64]

SLOWEST, FASTEST = 0.05, 5.0  # Hz
# number tried at most, spacing times the duration, number tried at once
FREQUENCIES, FINE, CHUNK = 8000, 0.25, 400
FRAMES = 600  # of dwells, at most, in the search for a line
CHANCE = 1e-4  # probability of a line in noise, over all frequencies and modes
SHOWN = 0.1  # of the square of a wave that must be left when the line of each dwell is taken out
# times the variance of noise: scatter along commanded modes above this is motion of the body
EXCESS = 4.0
LEAST_MM = 0.12  # mm RMS: smaller motion is ignored
ENOUGH = 15  # degrees of freedom


@dataclass(frozen=True)
class MotionAtRest:
    """Motion of the body while the commands are constant.

    Attributes:
        rms_mm: size, RMS over time and places, mm.
        frequency_hz: frequency of a line, Hz; None if the motion is irregular.
        channels: RMS of the commands that would move the body in this way, one number a channel.
        dwells: number of dwells that show it.
    """

    rms_mm: float
    frequency_hz: float | None
    channels: tuple[float, ...]
    dwells: int

    def __str__(self) -> str:
        how = "irregularly" if self.frequency_hz is None else f"at {self.frequency_hz:.2g} Hz"
        most = max(self.channels, default=0.0)
        like = [str(c) for c, size in enumerate(self.channels) if size > 0.3 * most]
        along = f", as channel {', '.join(like)} would move it" if like else ""
        return f"the body moves while the commands stand: {self.rms_mm:.2g} mm RMS {how}{along}"


@dataclass(frozen=True)
class AtRest:
    """The motion at rest that was found in dwells, and the values without it.

    Attributes:
        values: the given values without the lines, (K, F) mm.
        found: descriptions of the motion.
        irregular: whether there is irregular motion, which stays in the values.
    """

    found: tuple[MotionAtRest, ...]
    values: Floats
    irregular: bool


@dataclass(frozen=True)
class _Scores:
    """Scores (n, b) of the settled frames along the commanded modes.

    They are detrended in each dwell, in units of their noise.
    """

    rows: NDArray[np.intp]
    dwells: list[NDArray[np.intp]]  # for each dwell, its places among the rows
    values: Floats
    sigma: Floats  # (b,) mm
    freedom: int


def motion_at_rest(
    values: Floats,
    seen: Floats,
    positions: Mask,
    t: Floats,
    command: Floats,
    dwell: Ints,
    modes: Floats,
) -> AtRest:
    """Find motion of the body along commanded modes while its commands are constant.

    Nothing is found if the dwells are too few to show it, or if the commands would need more than
    their complete range for such a motion.

    Args:
        values: features minus the prediction of a model, or the features themselves, (K, F) mm.
        seen: measured features, (K, F) mm.
        positions: which features are places, (V,).
        t: times of the frames, (K,) s.
        command: (K, C).
        dwell: number of the dwell of each frame, (K,); -1 outside dwells.
        modes: (b, F), from `commanded_modes`.

    Returns:
        AtRest: the motion found, and the values without it.
    """
    white = white_variance(values, seen, positions, in_all(modes), dwell)
    scores = _scores(values, seen, positions, modes, dwell, white)
    if scores is None or scores.freedom < ENOUGH:
        return AtRest((), values, False)
    found, rest = [], values
    line = _line(scores, t, modes, positions)
    if line is not None:
        frequency, pattern = line
        away = _wave(np.array([frequency]), t)[:, 0] @ pattern  # (K, F)
        size = _rms_mm(0.5 * np.sum(pattern**2, axis=0), positions)
        found.append(
            MotionAtRest(
                size,
                frequency,
                _channels(pattern / np.sqrt(2.0), seen, command),
                len(scores.dwells),
            )
        )
        rest = values - np.where((dwell >= 0)[:, None], away, 0.0)
        scores = _scores(rest, seen, positions, modes, dwell, white)
    irregular = (
        None if white is None or scores is None else _irregular(scores, modes, positions, white)
    )
    if (
        irregular is not None
        and scores is not None
        and irregular[0] > sum(one.rms_mm for one in found)
    ):
        # less than the line: it comes from the change of its shape between poses
        size, pattern = irregular
        found.append(
            MotionAtRest(size, None, _channels(pattern, seen, command), len(scores.dwells))
        )
    able = tuple(one for one in found if np.all(np.array(one.channels) <= np.ptp(command, axis=0)))
    return AtRest(able, rest, irregular is not None)


def _scores(
    values: Floats, seen: Floats, positions: Mask, modes: Floats, dwell: Ints, white: Floats | None
) -> _Scores | None:
    if not len(modes):
        return None
    rows = []
    dwells = []
    parts = []
    noise = []
    count = 0
    freedom = 0
    for frames in rows_of(dwell, LEAST_DWELL):
        part = filled(values[frames])
        basis = _level(len(part))
        part = part - basis @ (basis.T @ part)
        if white is None:
            score, covariance = part @ modes.T, np.eye(len(modes))[None]
        else:
            along = in_all(modes)(frames)
            combined = coordinates(part, filled(seen[frames]), positions, along, white)
            score, covariance = combined.commanded, combined.white[:, -len(modes) :, -len(modes) :]
        parts.append(score)
        noise.append(np.diagonal(covariance, axis1=1, axis2=2))
        rows.append(frames)
        dwells.append(np.arange(count, count + len(frames)))
        count, freedom = count + len(frames), freedom + len(frames) - 2
    if not rows:
        return None
    every = np.concatenate(parts)
    sigma = (
        np.sqrt(np.concatenate(noise).mean(axis=0))
        if white is not None
        else np.maximum(every.std(axis=0), 1e-12)
    )
    return _Scores(np.concatenate(rows), dwells, every, sigma, freedom)


def _wave(frequency: Floats, t: Floats) -> Floats:
    """Return cosine and sine (n, f, 2) of frequencies (f,) Hz at times (n,) s."""
    phase = 2.0 * np.pi * t[:, None] * frequency
    return np.stack([np.cos(phase), np.sin(phase)], axis=2)


def _line(
    scores: _Scores, t: Floats, modes: Floats, positions: Mask
) -> tuple[float, Floats] | None:
    """Return the frequency (Hz) of a line, and its cosine and sine response (2, F) mm; or None."""
    ends = np.cumsum([len(d) for d in scores.dwells])
    kept = scores.dwells[: max(1, int(np.searchsorted(ends, FRAMES, side="right")))]
    count = int(ends[len(kept) - 1])
    at, values, level = t[scores.rows[:count]], scores.values[:count], _levels(kept, count)
    power, span = np.sum(values**2, axis=0), float(np.ptp(at))
    fastest = min(FASTEST, SLOWEST + FREQUENCIES * FINE / max(span, 1e-9))
    grid = np.arange(SLOWEST, fastest, FINE / max(span, 1e-9))
    if not len(grid) or not np.all(power > 0):
        return None
    share = np.concatenate(
        [_explained(f, at, values, level) for f in np.array_split(grid, 1 + len(grid) // CHUNK)]
    )
    best, mode = np.unravel_index(int(np.argmax(share / power)), share.shape)
    freedom = count - level.shape[1]
    chance = (
        FINE
        * len(grid)
        * len(power)
        * (1.0 - share[best, mode] / power[mode]) ** max((freedom - 3) / 2, 0.5)
    )
    if chance > CHANCE:
        return None
    wave = _detrended(_wave(grid[best : best + 1], at)[:, 0], level)
    pattern = np.linalg.lstsq(wave, values, rcond=None)[0] @ modes
    size = _rms_mm(0.5 * np.sum(pattern**2, axis=0), positions)
    return (float(grid[best]), pattern) if size >= LEAST_MM else None


@lru_cache(maxsize=256)
def _level(frames: int) -> Floats:
    """Return the orthonormal linear drift (n, 2) of a dwell; a parabola would absorb slow lines."""
    return np.asarray(np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, frames), 2))[0])


def _levels(dwells: list[NDArray[np.intp]], count: int) -> Floats:
    """Return the linear drifts of all dwells, orthonormal, (n, 2 per dwell)."""
    out = np.zeros((count, 2 * len(dwells)))
    for d, rows in enumerate(dwells):
        out[rows, 2 * d : 2 * d + 2] = _level(len(rows))
    return out


def _detrended(columns: Floats, level: Floats) -> Floats:
    return np.asarray(columns - level @ (level.T @ columns))


def _explained(frequency: Floats, t: Floats, values: Floats, level: Floats) -> Floats:
    """Return the squares (f, b) of values (n, b) that lines at frequencies (f,) explain.

    It is 0 for frequencies that the frames hardly show: near half the frame rate, or with a period
    longer than the dwells.
    """
    wave = _detrended(_wave(frequency, t).reshape(len(t), -1), level).reshape(len(t), -1, 2)
    gram = np.einsum("nfi,nfj->fij", wave, wave)
    seen = np.linalg.eigvalsh(gram)[:, 0] > SHOWN * 0.5 * len(t)
    right = np.einsum("nfi,nb->fib", wave, values)
    share = np.sum(right * np.linalg.solve(gram + 1e-9 * len(t) * np.eye(2), right), axis=1)
    return np.asarray(np.where(seen[:, None], share, 0.0))


def _irregular(
    scores: _Scores, modes: Floats, positions: Mask, white: Floats
) -> tuple[float, Floats] | None:
    """Return the size (mm RMS) and the motions (b, F) mm of scatter above the noise, or None."""
    scaled = scores.values / scores.sigma
    more, axes = np.linalg.eigh(scaled.T @ scaled / scores.freedom - np.eye(len(modes)))
    moved = (np.sqrt(np.maximum(more, 0.0)) * axes).T * scores.sigma @ modes
    size = _rms_mm(np.sum(moved**2, axis=0), positions)
    if more.max() < EXCESS - 1.0 or size < max(LEAST_MM, _rms_mm(white, positions)):
        return None
    return size, moved


def _rms_mm(squares: Floats, positions: Mask) -> float:
    """Return the RMS distance over the places, from mean squares (F,) mm²."""
    return float(np.sqrt(np.mean(squares.reshape(-1, 3)[positions].sum(axis=1))))


def _channels(pattern: Floats, seen: Floats, command: Floats) -> tuple[float, ...]:
    """Return the RMS (C,) of the commands that would move the features by a pattern (n, F) mm."""
    span = np.ptp(command, axis=0)
    moved = np.flatnonzero(span > 0)
    x = command[:, moved] - command[:, moved].mean(axis=0)
    slope = np.linalg.lstsq(x, filled(seen) - filled(seen).mean(axis=0), rcond=None)[0]  # (C, F)
    needed = np.linalg.lstsq(slope.T, pattern.T, rcond=1e-3)[0]  # (C, n)
    sizes = np.zeros(command.shape[1])
    sizes[moved] = np.sqrt(np.sum(needed**2, axis=1))
    return tuple(float(size) for size in sizes)
