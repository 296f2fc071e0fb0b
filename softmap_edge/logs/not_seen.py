"""Find places that stand for "not seen": constants that a tracker writes for a marker that it lost.

Many exporters write a lost marker as 0, 0, 0, as −1, −1, −1 or as 9999.99, or repeat its last place (`held_places`). A
real marker repeats a place only where the robot rests. A place of a marker that moves counts as not seen if

    marked    its three numbers are equal (0, 0, 0), or it repeats to the last digit, and
    alone     it lies far from every other place of the marker, or
    jumps     the marker jumps there and back, farther than it ever moves between two frames, or
    driven    it stays the same while a command crosses half of its range, and no other place repeats

A place that only repeats, with three different numbers, needs `alone` and one of the others. A marker that is alone at
rest, under one command that no other frame shares, is not judged. A marker that stands still in all frames stays.
Limits: a place that occurs once and is not three equal numbers; fewer than `LEAST` frames.
Pinned by tests/test_not_seen.py.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.logs.held_places import Held, held_places

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST = 5  # frames of a marker: fewer say nothing
MOVES = 3  # different places of a marker that moves
ALONE = 3.0  # of the usual distance between places of the marker that are neighbours
APART = 0.25  # of the extent of its other places, likewise; of a number, its complete extent
JUMPS = 2.0  # of the longest of its other steps
DRIVEN = 0.5  # of the range of a command: more than a play
DISTINCT = 0.9  # of the other places that occur once: a sensor with noise repeats none
AT_REST, NEAR = 0.05, 0.1  # of the range of each command: one command, and a command nearly the same
MOST = 3  # repeated places of one marker that are looked at
MANY = 64  # points of a frame: of more, such as vertices, only three equal numbers are looked at
_SAMPLE = 300  # places between which distances are taken
_TOLD = 5  # markers that are named one by one


@dataclass(frozen=True)
class Constant:
    """A place that stands for "not seen": `place` (D,) of marker `marker` in `frames` (n,)."""

    marker: int
    place: tuple[float, ...]
    frames: NDArray[np.intp]


@dataclass(frozen=True)
class Lost:
    """Which points (K, M) stand for "not seen", and why."""

    mask: Mask
    constants: tuple[Constant, ...] = ()
    held: tuple[Held, ...] = ()

    def lines(self, labels: Sequence[str], remedy: str) -> list[str]:
        """Return a sentence for each place that stands for "not seen", and one for places that are held."""
        count = len(self.mask)
        told = []
        for place in dict.fromkeys(one.place for one in self.constants):
            ones = [one for one in self.constants if one.place == place]
            frames = np.unique(np.concatenate([one.frames for one in ones]))
            where = f"({', '.join(f'{x + 0.0:.10g}' for x in place)})" if len(place) > 1 else f"{place[0]:.10g}"
            named = _named([(labels[one.marker], len(one.frames)) for one in ones])
            told.append(f"{len(frames)} of {count} frames at exactly {where} are taken as not seen: {named}; {remedy}")
        if self.held:
            frames = np.unique(np.concatenate([one.frames for one in self.held]))
            each: dict[str, int] = {}
            for one in self.held:
                each[labels[one.marker]] = each.get(labels[one.marker], 0) + len(one.frames)
            told.append(
                f"{len(frames)} of {count} frames repeat the last place of a marker to the last digit while the robot "
                f"moves, and are taken as not seen: {_named(list(each.items()))}; {remedy}"
            )
        return told


def _named(counts: list[tuple[str, int]]) -> str:
    counts = sorted(counts, key=lambda pair: -pair[1])
    more = f" and {len(counts) - _TOLD} more" if len(counts) > _TOLD else ""
    return ", ".join(f"{name} {count}" for name, count in counts[:_TOLD]) + more


def not_seen(points: Array, commands: Array | None = None) -> Lost:
    """Find the points that stand for "not seen".

    Args:
        points: (K, M, D) places as the file has them, in order of time, NaN where nothing was seen; D = 1 for outputs.
        commands: (K, C) at these frames, in any unit; None where nothing is known of them.
    """
    shown = np.array(points, float)
    u = _normalised(commands, len(shown))
    found: list[Constant] = []
    for m in range(shown.shape[1]):
        for frames in _constants(shown[:, m], u, shown.shape[1] > MANY):
            found.append(Constant(m, tuple(float(x) for x in shown[frames[0], m]), frames))
            shown[frames, m] = np.nan
    held = held_places(shown, u) if shown.shape[1] <= MANY else []
    for one in held:
        shown[one.frames, one.marker] = np.nan
    lost = np.isfinite(points).all(axis=2) & ~np.isfinite(shown).all(axis=2)
    return Lost(np.asarray(lost, np.bool_), tuple(found), tuple(held))


def declared(points: Array, numbers: Sequence[float]) -> Lost:
    """Return the points (K, M, D) whose numbers all equal one of those that a mapping declares as not seen."""
    mask, found = np.zeros(points.shape[:2], bool), []
    for number in numbers:
        at = np.asarray((points == number).all(axis=2))
        mask |= at
        place = (float(number),) * points.shape[2]
        found += [Constant(int(m), place, np.flatnonzero(at[:, m])) for m in np.flatnonzero(at.any(axis=0))]
    return Lost(mask, tuple(found))


def _normalised(commands: Array | None, frames: int) -> Array | None:
    """Return commands (K, C) of channels that move, each in its range; None without one."""
    if commands is None or commands.shape != (frames, commands.shape[-1]) or not len(commands):
        return None
    span = np.ptp(commands, axis=0)
    alive = np.isfinite(span) & (span > 0)
    return np.asarray(commands[:, alive] / span[alive]) if alive.any() else None


# --- one marker ----------------------------------------------------------------------------
def _constants(places: Array, u: Array | None, only_marked: bool) -> Iterator[NDArray[np.intp]]:
    """Yield the frames of each place of one marker (K, D) that stands for "not seen"."""
    seen = np.flatnonzero(np.isfinite(places).all(axis=1))
    if len(seen) < LEAST:
        return
    own = places[seen]
    marked = (own == own[:, :1]).all(axis=1) if own.shape[1] > 1 else np.zeros(len(own), bool)
    if only_marked and not marked.any():
        return
    distinct, which, count = np.unique(own, axis=0, return_inverse=True, return_counts=True)
    which = which.reshape(-1)
    if len(distinct) < 2:
        return
    candidates = list(dict.fromkeys(which[marked].tolist()))
    if not only_marked:
        often = [int(k) for k in np.argsort(-count, kind="stable")[:MOST] if count[k] > 1]
        candidates += [k for k in often if k not in candidates]
    for k in candidates:
        at = which == k
        others = ~at & ~marked
        if others.any() and _stands_for_lost(own, at, others, bool(marked[at][0]), None if u is None else u[seen]):
            yield seen[at]


def _stands_for_lost(own: Array, at: Mask, others: Mask, marked: bool, u: Array | None) -> bool:
    """Whether the place of frames `at` of a marker's places (n, D) is none, seen against those of `others`."""
    here, rest = own[at][0], own[others]
    several, often = np.unique(rest, axis=0, return_counts=True)
    if len(several) < MOVES:
        return marked and u is not None and at.sum() < others.sum() and not _rests(u, at, others)
    alone = _alone(here, several)
    jumps = _jumps(own, at, others)
    driven = bool(
        u is not None
        and at.sum() > 2
        and np.ptp(u[at], axis=0).max() > DRIVEN
        and (often == 1).sum() > DISTINCT * len(rest)
    )
    if not marked:
        return alone and (jumps or driven)
    return jumps or driven or (alone and not _rests(u, at, others))


def _alone(here: Array, places: Array) -> bool:
    """Whether a place (D,) is far from all others (n, D)."""
    away = float(np.linalg.norm(places - here, axis=1).min())
    some = places[np.unique(np.linspace(0, len(places) - 1, min(len(places), _SAMPLE)).astype(int))]
    apart = np.linalg.norm(some[:, None] - some[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    usual = float(np.quantile(apart.min(axis=1), 0.95))
    extent = float(np.linalg.norm(np.quantile(places, 0.95, axis=0) - np.quantile(places, 0.05, axis=0)))
    return away > ALONE * usual and away > (APART if places.shape[1] > 1 else 1.0) * extent


def _jumps(own: Array, at: Mask, others: Mask) -> bool:
    """Whether a marker (n, D) comes to the place `at` and leaves it only by steps longer than all its other steps."""
    step = np.linalg.norm(np.diff(own, axis=0), axis=1)
    usual = step[others[1:] & others[:-1]]
    into = (at[1:] & others[:-1]) | (at[:-1] & others[1:])
    if len(usual) < LEAST or not into.any():
        return False
    return bool(step[into].min() > JUMPS * usual.max())


def _rests(u: Array | None, at: Mask, others: Mask) -> bool:
    """Whether the frames `at` may be a robot at rest: all under one command, which no other frame shares."""
    if u is None:
        return False
    middle = np.median(u[at], axis=0)
    if np.abs(u[at] - middle).max() > AT_REST:
        return False
    return not bool((np.abs(u[others] - middle).max(axis=1) < NEAR).any())
