"""Compute conditions of each seen frame (speed, direction, dwell, history, ...) and their cells.

    v(t)  = [u(t) - u(t - w)] / w  w = 3 median sample periods, 0.1 to 0.5 s  mm/s, (C,)
    speed = |v|;  moving where speed > 0.5 % of the largest command span per second
    dwell = time since the last motion, 0 while moving; history = largest |command| so far, this
        frame included

Units: mm, s, degree Celsius. Known limit: motion slower than 0.5 % of the span per second counts
as rest, and the start of a dwell is accurate to one sample. Pinned by
tests/comparison/test_compare.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from softmap_edge.run.run import Run

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# velocity window: median periods; shortest and longest, s
WINDOW_SAMPLES, WINDOW_SHORTEST, WINDOW_LONGEST = 3.0, 0.1, 0.5
STILL = 0.005  # of the largest command span, per second: slower is rest
NEAR = np.cos(np.radians(20.0))  # orientations within 20 degrees count as one
WARMING = 3.0  # °C, change of temperature that counts
# change of the unit gravity vector between frames (about 1°): another orientation
TURNED = 0.02
ALIKE = 0.02  # of the largest: commands that differ by less are one size
HOME = 0.1  # of the largest |command|: closer to zero is "home"
DWELL_EDGES = (0.0, 0.5, 2.0, 5.0, 10.0, 30.0)  # s since the command stopped
FINE_CHANNELS = 3  # with more channels, cells of a command are its sign, not thirds of its range


@dataclass(frozen=True)
class Conditions:
    """The conditions at K seen frames of a run with C channels."""

    command: Floats  # (K, C) mm
    velocity: Floats  # (K, C) mm/s
    speed: Floats  # (K,) mm/s
    moving: Mask  # (K,)
    # (K,) number of the frame's dwell, uninterrupted and in one orientation; -1 while moving
    visit: NDArray[np.int64]
    dwell: Floats  # (K,) s
    history: Floats  # (K,) mm
    time: Floats  # (K,) s, as in the run
    gravity: Floats | None  # (K, 3) unit vector, base frame
    temperature: Floats | None  # (K,) degree Celsius


@dataclass(frozen=True)
class Cell:
    """A class of frames: its name, its bounds if any, and which of the K frames belong to it."""

    label: str
    low: float | None
    high: float | None
    frames: Mask  # (K,)


@dataclass(frozen=True)
class Bin:
    """A class of a condition: its name, bounds (or None), number of frames, RMS error in mm."""

    label: str
    low: float | None
    high: float | None
    n: int
    rms_mm: float


def conditions(run: Run, command: Floats) -> Conditions:
    """Compute the conditions of a run at its seen frames.

    Args:
        run: a run with `t` (T,) s, `t_seen` (K,) s and perhaps `gravity` and `temperature`; K = 0
            is valid.
        command: (T, C) mm as the model takes them (goal or present position); C = 0 is valid.

    Returns:
        Conditions: one entry per seen frame.
    """
    seen, u = np.asarray(run.t_seen, float), np.asarray(command, float)
    t = seen if run.t is None else np.asarray(run.t, float)
    if len(t) == 0 or u.shape[1] == 0:
        return _uncommanded(run, t, seen)
    period = float(np.median(np.diff(t))) if len(t) > 1 else WINDOW_SHORTEST
    window = float(np.clip(WINDOW_SAMPLES * period, WINDOW_SHORTEST, WINDOW_LONGEST))
    threshold = max(STILL * float(np.max(np.ptp(u, axis=0))), 1e-9)

    def velocity(at: Floats) -> Floats:
        past = np.maximum(at - window, t[0])
        return (_sample(at, t, u) - _sample(past, t, u)) / window

    grid_moving = np.linalg.norm(velocity(t), axis=1) > threshold  # (T,)
    index = np.clip(np.searchsorted(t, seen, side="right") - 1, 0, len(t) - 1)
    # (K,) -1: no motion yet
    last = np.maximum.accumulate(np.where(grid_moving, np.arange(len(t)), -1))[index]
    v = velocity(seen)
    speed = np.linalg.norm(v, axis=1)
    moving = speed > threshold
    gravity = _at_seen(run.gravity, t, seen, 3)
    visit = last + 1
    # a rotation of the robot at rest ends the dwell
    if gravity is not None and len(seen):
        turned = np.r_[False, np.linalg.norm(np.diff(gravity, axis=0), axis=1) > TURNED]
        visit = visit + (len(t) + 1) * np.cumsum(turned)
    stopped = np.where(last >= 0, t[last] - window + period, t[0])
    return Conditions(
        command=_sample(seen, t, u),
        velocity=v,
        speed=speed,
        moving=moving,
        visit=np.where(moving, -1, visit).astype(np.int64),
        dwell=np.where(moving, 0.0, np.maximum(seen - stopped, 0.0)),
        history=np.maximum.accumulate(np.max(np.abs(u), axis=1))[index],
        time=seen,
        gravity=gravity,
        temperature=_at_seen(run.temperature, t, seen, 1),
    )


def cells(state: Conditions, unit: str = "mm") -> dict[str, list[Cell]]:
    """Sort the frames into classes, one list per condition; empty classes are omitted.

    Args:
        state: the conditions of K frames.
        unit: of the commands, for the labels.

    Returns:
        dict: direction, speed, dwell, history, command, time; orientation and temperature where the
        run has them.
    """
    found = {
        "direction": _directions(state),
        "speed": [
            Cell("still", 0.0, 0.0, ~state.moving),
            *_ranges(state.speed, _edges(state.speed[state.moving], 3), f"{unit}/s", state.moving),
        ],
        "dwell": [Cell("moving", None, 0.0, state.moving), *_dwells(state)],
        "history": _ranges(state.history, _sizes(state.history, 4), unit),
        "command": _commands(state, unit),
        "time": _ranges(state.time, _steps(state.time, 8), "s"),
    }
    if state.gravity is not None:
        found["orientation"] = _orientations(state.gravity)
    if state.temperature is not None:
        found["temperature"] = _ranges(state.temperature, _steps(state.temperature, 4), "°C")
    return {name: [cell for cell in row if cell.frames.any()] for name, row in found.items()}


def _uncommanded(run: Run, t: Floats, seen: Floats) -> Conditions:
    count, zero = len(seen), np.zeros(len(seen))
    return Conditions(
        command=np.zeros((count, 0)),
        velocity=np.zeros((count, 0)),
        speed=zero,
        moving=np.zeros(count, bool),
        visit=np.zeros(count, np.int64),
        dwell=seen - seen[0] if count else zero,
        history=zero,
        time=seen,
        gravity=_at_seen(run.gravity, t, seen, 3),
        temperature=_at_seen(run.temperature, t, seen, 1),
    )


def _sample(at: Floats, t: Floats, values: Floats) -> Floats:
    """Interpolate (T, C) columns at times `at`; hold the border value outside the record."""
    return np.stack([np.interp(at, t, column) for column in values.T], axis=1)


def _at_seen(raw: Floats | None, t: Floats, seen: Floats, width: int) -> Floats | None:
    """Return a declared field at the seen frames.

    A vector gives (K, 3), a number (K,), its mean over channels.
    """
    if raw is None:
        return None
    value = np.asarray(raw, float)
    if width == 3:
        return np.tile(value, (len(seen), 1)) if value.ndim == 1 else _sample(seen, t, value)
    column = (
        np.full(len(t), float(value)) if value.ndim == 0 else value.reshape(len(t), -1).mean(axis=1)
    )
    return np.asarray(np.interp(seen, t, column))


def _edges(values: Floats, count: int) -> Floats:
    """Return the bounds of up to `count` classes of about equal size.

    Classes narrower than a tenth of the largest value are merged.
    """
    if len(values) == 0:
        return np.zeros(0)
    quantiles = np.quantile(values, np.linspace(0.0, 1.0, count + 1))
    step = 10.0 ** np.floor(np.log10(max(float(np.max(np.abs(values))), 1e-9)) - 1)
    low, high = np.floor(quantiles[0] / step) * step, np.ceil(quantiles[-1] / step) * step
    least, kept = 0.1 * float(np.max(np.abs(values))), [float(low)]
    for inner in np.round(quantiles[1:-1] / step) * step:
        if inner - kept[-1] > least and high - inner > least:
            kept.append(float(inner))
    return np.round(np.unique([*kept, float(high)]), 9)


def _steps(values: Floats, count: int) -> Floats:
    """Return the bounds of `count` equally wide classes from the smallest to the largest value."""
    if len(values) == 0:
        return np.zeros(0)
    return np.unique(np.linspace(float(np.min(values)), float(np.max(values)), count + 1))


def _sizes(values: Floats, count: int) -> Floats:
    """Return the bounds of `_steps`; one class if the values differ only by servo ticks."""
    largest = float(np.max(values, initial=0.0))
    alike = len(values) > 0 and float(np.ptp(values)) <= ALIKE * largest
    return np.array([float(f"{largest:.3g}")]) if alike else _steps(values, count)


def _labels(edges: Floats) -> list[str]:
    """Return bounds as texts with three digits, or as many as needed to distinguish them."""
    kinds = len(np.unique(edges))
    return next(
        labels
        for digits in range(3, 18)
        if len(set(labels := [f"{e:.{digits}g}" for e in edges])) == kinds
    )


def _ranges(values: Floats, edges: Floats, unit: str, among: Mask | None = None) -> list[Cell]:
    among = np.ones(len(values), bool) if among is None else among
    if len(edges) == 1:
        return [Cell(f"{edges[0]:g} {unit}", float(edges[0]), float(edges[0]), among)]
    if len(edges) == 0 or edges[-1] <= edges[0]:
        return []
    which, labels = (
        np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2),
        _labels(edges),
    )
    return [
        Cell(
            f"{labels[k]} … {labels[k + 1]} {unit}",
            float(edges[k]),
            float(edges[k + 1]),
            among & (which == k),
        )
        for k in range(len(edges) - 1)
    ]


def _dwells(state: Conditions) -> list[Cell]:
    edges = (*DWELL_EDGES, np.inf)
    found = []
    for low, high in zip(edges[:-1], edges[1:]):
        label = f"{low:g} … {high:g} s" if np.isfinite(high) else f"over {low:g} s"
        frames = ~state.moving & (state.dwell >= low) & (state.dwell < high)
        found.append(Cell(label, low, float(high) if np.isfinite(high) else None, frames))
    return found


def _directions(state: Conditions) -> list[Cell]:
    found = [Cell("still", None, None, ~state.moving)]
    if state.velocity.shape[1] == 0:
        return found
    fastest = np.argmax(np.abs(state.velocity), axis=1)
    pace = (
        np.take_along_axis(state.velocity, fastest[:, None], axis=1)[:, 0]
        if len(fastest)
        else state.speed
    )
    for channel in range(state.velocity.shape[1]):
        for sign, mark in ((1, "+"), (-1, "−")):
            frames = state.moving & (fastest == channel) & (np.sign(pace) == sign)
            found.append(Cell(f"u{channel} {mark}", None, None, frames))
    return found


def _commands(state: Conditions, unit: str) -> list[Cell]:
    """Return the cells of the largest channel: home, then its signed range in thirds.

    With more than three channels only its sign counts.
    """
    channels = state.command.shape[1]
    size = np.max(np.abs(state.command), axis=1, initial=0.0)
    top = float(np.max(size, initial=0.0))
    home = size <= HOME * top
    found = [Cell("home", -HOME * top, HOME * top, home)]
    if channels == 0 or top == 0.0:
        return found
    largest = np.argmax(np.abs(state.command), axis=1)
    value = np.take_along_axis(state.command, largest[:, None], axis=1)[:, 0]
    parts = np.array([HOME, 0.4, 0.7, 1.0] if channels <= FINE_CHANNELS else [HOME, 1.0]) * top
    for channel in range(channels):
        bounds = [(-b, -a) for a, b in zip(parts[:-1], parts[1:])][::-1] + list(
            zip(parts[:-1], parts[1:])
        )
        for low, high in bounds:
            magnitude = np.abs(value)
            inside = (magnitude > min(abs(low), abs(high))) & (
                magnitude <= max(abs(low), abs(high))
            )
            frames = ~home & (largest == channel) & (np.sign(value) == np.sign(low + high)) & inside
            name = f"u{channel} {low:+.3g} … {high:+.3g} {unit}".replace("-", "−")
            found.append(Cell(name, float(low), float(high), frames))
    return found


def _orientations(gravity: Floats) -> list[Cell]:
    """Return classes of nearly equal gravity directions (to a quarter), named by the vector."""
    rounded = np.round(gravity * 4.0) / 4.0 + 0.0
    kinds, which = np.unique(rounded, axis=0, return_inverse=True)
    which = which.reshape(-1)
    names = [_direction_name(gravity[which == k].mean(axis=0)) for k in range(len(kinds))]
    return [Cell(name, None, None, which == k) for k, name in enumerate(names)]


def _direction_name(g: Floats) -> str:
    axis = int(np.argmax(np.abs(g)))
    if np.delete(np.abs(g), axis).max() < 0.02:
        return f"gravity {'+' if g[axis] > 0 else '−'}{'xyz'[axis]}"
    return "gravity " + " ".join(f"{value:+.2f}" for value in g).replace("-", "−")


def orientations(gravity: Floats | None) -> int:
    """Return the number of orientations, (T, 3) or (3,), that differ by more than 20 degrees.

    It is 1 if none is declared.
    """
    if gravity is None:
        return 1
    rows = np.atleast_2d(np.asarray(gravity, float))
    found: list[Floats] = []
    for row in rows[np.linspace(0, len(rows) - 1, min(len(rows), 200)).astype(int)]:
        unit = row / max(float(np.linalg.norm(row)), 1e-12)
        if all(float(unit @ other) < NEAR for other in found):
            found.append(unit)
    return max(1, len(found))


def last_direction(velocity: Floats, moving: NDArray[np.bool_]) -> Floats:
    """Return the sign (K, C) of each channel's last motion up to each frame, 0 before the first."""
    sign = np.where(moving[:, None], np.sign(np.round(velocity, 6)), 0.0)
    index = np.maximum.accumulate(np.where(sign != 0, np.arange(len(sign))[:, None], 0), axis=0)
    return np.take_along_axis(sign, index, axis=0) if len(sign) else sign
