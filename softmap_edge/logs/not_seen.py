"""Find positions that stand for "not seen": constants that a tracker writes for a lost marker.

Many exporters write a lost marker as 0, 0, 0, as −1, −1, −1 or as 9999.99, or repeat its last
position (`held_places`). A real marker repeats a position only while the robot rests. A position of
a moving marker counts as not seen if it is

    marked    three equal numbers (0, 0, 0), or a repeat to the last digit,

and one of

    alone     it is far from every other position of the marker
    jumps     the marker jumps to and from it, farther than it ever moves between two frames
    driven    it is constant while a command crosses half of its range, and no other position
              repeats

A single coordinate may also stand for "not seen" (`one_coordinate`). A position that only repeats,
with three different numbers, needs `alone` and one of the others. A position that is alone at rest,
under one command near which the marker has no other, is not tested. A marker that never moves is
kept. Limits: a position that occurs once and is not three equal numbers; fewer than `LEAST` frames.
Pinned by tests/logs/test_not_seen.py.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.files.printable import listed
from softmap_edge.logs.held_places import Held, held_places
from softmap_edge.logs.one_coordinate import NAMES, Coordinate, lost_coordinates

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST = 5  # frames of a marker; fewer are not enough
MOVES = 3  # distinct positions of a moving marker
ALONE = 3.0  # times the usual distance between neighbouring positions of the marker
APART = 0.25  # of the extent of its other positions, likewise; of a number, its full extent
JUMPS = 2.0  # times the longest of its other steps
DRIVEN = 0.5  # of the range of a command: more than a play
DISTINCT = 0.9  # share of the other positions that occur once: a noisy sensor repeats none
# of the range of each command: equal commands, and nearly equal ones
AT_REST, NEAR = 0.05, 0.1
STEEP = 3.0  # marker extents per range of a command: no marker moves farther
MOST = 3  # repeated positions of one marker that are tested
MARKS = 10  # positions of three equal numbers that are tested
MANY = 64  # points of a frame: of more, such as vertices, only three equal numbers are tested
_SAMPLE = 300  # positions between which distances are computed
_LISTED = 5  # markers that are listed


@dataclass(frozen=True)
class Constant:
    """A position that stands for "not seen": `place` (D,) of marker `marker` in `frames` (n,)."""

    marker: int
    place: tuple[float, ...]
    frames: NDArray[np.intp]


@dataclass(frozen=True)
class Lost:
    """Which points (K, M) stand for "not seen", and the reason."""

    mask: Mask
    constants: tuple[Constant, ...] = ()
    held: tuple[Held, ...] = ()
    coordinates: tuple[Coordinate, ...] = ()

    def lines(self, labels: Sequence[str], remedy: str) -> list[str]:
        """Return sentences on positions that stand for "not seen", and one on held positions."""
        count = len(self.mask)
        lines = []
        for place in dict.fromkeys(one.place for one in self.constants):
            ones = [one for one in self.constants if one.place == place]
            frames = np.unique(np.concatenate([one.frames for one in ones]))
            where = (
                f"({', '.join(f'{x + 0.0:.10g}' for x in place)})"
                if len(place) > 1
                else f"{place[0]:.10g}"
            )
            named = _named([(labels[one.marker], len(one.frames)) for one in ones])
            lines.append(
                f"{len(frames)} of {count} frames at exactly {where} are taken as not seen: "
                f"{named}; {remedy}"
            )
        for number, axis in dict.fromkeys((one.number, one.axis) for one in self.coordinates):
            same = [one for one in self.coordinates if (one.number, one.axis) == (number, axis)]
            frames = np.unique(np.concatenate([one.frames for one in same]))
            named = _named([(labels[one.marker], len(one.frames)) for one in same])
            lines.append(
                f"{len(frames)} of {count} frames with {NAMES[axis]} at exactly "
                f"{number + 0.0:.10g} are taken as not seen: {named}; {remedy}"
            )
        if self.held:
            frames = np.unique(np.concatenate([one.frames for one in self.held]))
            each: dict[str, int] = {}
            for one in self.held:
                each[labels[one.marker]] = each.get(labels[one.marker], 0) + len(one.frames)
            lines.append(
                f"{len(frames)} of {count} frames repeat the last place of a marker to the last "
                "digit while the robot moves, and are taken as not seen: "
                f"{_named(list(each.items()))}; {remedy}"
            )
        return lines


def _named(counts: list[tuple[str, int]]) -> str:
    counts = sorted(counts, key=lambda pair: -pair[1])
    return listed((f"{name} {count}" for name, count in counts), _LISTED)


def not_seen(points: Array, commands: Array | None = None) -> Lost:
    """Find the points that stand for "not seen".

    Args:
        points: (K, M, D) positions as in the file, in order of time, NaN where nothing was seen;
            D = 1 for outputs.
        commands: (K, C) at these frames, in any unit; None if unknown.
    """
    shown = np.array(points, float)
    u = _normalised(commands, len(shown))
    found: list[Constant] = []
    many = shown.shape[1] > MANY
    for m in _ever_marked(shown) if many else range(shown.shape[1]):
        for frames in _constants(shown[:, m], u, many):
            found.append(Constant(m, tuple(float(x) for x in shown[frames[0], m]), frames))
            shown[frames, m] = np.nan
    coordinates = [] if many else lost_coordinates(shown, u)
    for coordinate in coordinates:
        shown[coordinate.frames, coordinate.marker] = np.nan
    held = [] if many else held_places(shown, u)
    for one in held:
        shown[one.frames, one.marker] = np.nan
    lost = np.isfinite(points).all(axis=2) & ~np.isfinite(shown).all(axis=2)
    return Lost(np.asarray(lost, np.bool_), tuple(found), tuple(held), tuple(coordinates))


def declared(points: Array, numbers: Sequence[float]) -> Lost:
    """Return the points (K, M, D) that a mapping declares as not seen.

    All coordinates of such a point equal one of the declared numbers.
    """
    mask, found = np.zeros(points.shape[:2], bool), []
    for number in numbers:
        at = np.asarray((points == number).all(axis=2))
        mask |= at
        place = (float(number),) * points.shape[2]
        found += [
            Constant(int(m), place, np.flatnonzero(at[:, m]))
            for m in np.flatnonzero(at.any(axis=0))
        ]
    return Lost(mask, tuple(found))


def _normalised(commands: Array | None, frames: int) -> Array | None:
    """Return commands (K, C) of moving channels, relative to their ranges; None without any."""
    if commands is None or commands.shape != (frames, commands.shape[-1]) or not len(commands):
        return None
    span = np.ptp(commands, axis=0)
    alive = np.isfinite(span) & (span > 0)
    return np.asarray(commands[:, alive] / span[alive]) if alive.any() else None


def _ever_marked(points: Array) -> list[int]:
    """Return which points (K, M, D) are ever at a position of three equal numbers."""
    if points.shape[2] < 2:
        return []
    equal = (points == points[..., :1]).all(axis=2)
    return [int(m) for m in np.flatnonzero(equal.any(axis=0))]


# --- one marker ----------------------------------------------------------------------------
def _constants(places: Array, u: Array | None, only_marked: bool) -> Iterator[NDArray[np.intp]]:
    """Yield the frames of each position of one marker (K, D) that stands for "not seen"."""
    seen = np.flatnonzero(np.isfinite(places).all(axis=1))
    if len(seen) < LEAST:
        return
    own, drive = places[seen], None if u is None else u[seen]
    distinct, which, count = _distinct(own)
    marked = _marked(distinct, count)
    if len(distinct) < 2 or (only_marked and not marked.any()):
        return
    candidates = np.flatnonzero(marked).tolist() + (
        [] if only_marked else _repeated(distinct, count)
    )
    lost = np.zeros(len(distinct), bool)
    for k in dict.fromkeys(candidates):
        rest = ~marked & ~lost
        rest[k] = False
        if rest.any() and _stands_for_lost(
            _Seen(own, distinct, which, count, drive), k, rest, bool(marked[k]), lost
        ):
            lost[k] = True
            yield seen[which == k]


def _distinct(own: Array) -> tuple[Array, NDArray[np.intp], NDArray[np.intp]]:
    """Return the sorted distinct positions of (n, D), each row's index, and their counts."""
    order = np.lexsort(own.T[::-1])
    new = np.r_[True, (own[order[1:]] != own[order[:-1]]).any(axis=1)]
    which = np.empty(len(own), np.intp)
    which[order] = np.cumsum(new) - 1
    return own[order[new]], which, np.bincount(which)


def _marked(distinct: Array, count: NDArray[np.intp]) -> Mask:
    """Return the few distinct positions (n, D) of three equal numbers, the commonest ones."""
    marked = (distinct == distinct[:, :1]).all(axis=1) & (distinct.shape[1] > 1)
    if marked.sum() > MARKS:
        rare = np.flatnonzero(marked)[np.argsort(-count[marked], kind="stable")[MARKS:]]
        marked[rare] = False
    return np.asarray(marked, np.bool_)


def _repeated(places: Array, count: NDArray[np.intp]) -> list[int]:
    """Return which positions (n, D) occur more than once.

    These are the ones farthest from the middle, and the most frequent ones.
    """
    several = np.flatnonzero(count > 1)
    away = np.linalg.norm(places[several] - np.median(places, axis=0), axis=1)
    far, often = (
        np.argsort(-away, kind="stable")[:MOST],
        np.argsort(-count[several], kind="stable")[:MOST],
    )
    return [int(k) for k in dict.fromkeys([*several[far], *several[often]])]


@dataclass(frozen=True)
class _Seen:
    """The positions (n, D) of a marker, and the commands.

    It also holds the distinct positions, their counts, and the index of each row among them.
    """

    own: Array
    distinct: Array
    which: NDArray[np.intp]
    count: NDArray[np.intp]
    drive: Array | None


def _stands_for_lost(seen: _Seen, k: int, rest: Mask, marked: bool, lost: Mask) -> bool:
    """Return whether distinct position `k` stands for "not seen".

    It is compared with the distinct positions `rest`; those in `lost` are excluded.
    """
    at, u = seen.which == k, seen.drive
    driven = u is not None and at.sum() > 2 and bool(np.ptp(u[at], axis=0).max() > DRIVEN)
    total = int(seen.count[rest].sum())
    if rest.sum() < MOVES:
        return marked and driven and int(seen.count[k]) < total
    alone = _alone(seen.distinct[k], seen.distinct[rest])
    if driven and (marked or alone) and (seen.count[rest] == 1).sum() > DISTINCT * total:
        return True
    if not (alone or marked):
        return False
    jumps = _jumps(seen.own, at, rest[seen.which])
    far = (alone or jumps) if marked else (alone and jumps)
    return far and not (u is not None and _rests(seen.own, u, at, ~at & ~lost[seen.which]))


def _alone(here: Array, places: Array) -> bool:
    """Return whether a position (D,) is far from all others (n, D)."""
    away = float(np.linalg.norm(places - here, axis=1).min())
    some = places[np.unique(np.linspace(0, len(places) - 1, min(len(places), _SAMPLE)).astype(int))]
    apart = np.linalg.norm(some[:, None] - some[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    usual = float(np.quantile(apart.min(axis=1), 0.95))
    extent = float(
        np.linalg.norm(np.quantile(places, 0.95, axis=0) - np.quantile(places, 0.05, axis=0))
    )
    return away > ALONE * usual and away > (APART if places.shape[1] > 1 else 1.0) * extent


def _jumps(own: Array, at: Mask, others: Mask) -> bool:
    """Return whether a marker (n, D) reaches and leaves `at` only by its longest steps."""
    step = np.linalg.norm(np.diff(own, axis=0), axis=1)
    usual = step[others[1:] & others[:-1]]
    into = (at[1:] & others[:-1]) | (at[:-1] & others[1:])
    if len(usual) < LEAST or not into.any():
        return False
    return bool(usual.max() > 0 and step[into].min() > JUMPS * usual.max())


def _rests(own: Array, u: Array, at: Mask, others: Mask) -> bool:
    """Return whether the robot may be at rest in the frames `at`.

    They have one command, near which no frame shows a distant position.
    """
    middle = np.median(u[at], axis=0)
    if np.abs(u[at] - middle).max() > AT_REST or not others.any():
        return False
    rest, off = own[others], np.abs(u[others] - middle).max(axis=1)
    extent = float(
        np.linalg.norm(np.quantile(rest, 0.95, axis=0) - np.quantile(rest, 0.05, axis=0))
    )
    away = np.linalg.norm(rest - own[at][0], axis=1)
    return not bool(((off < NEAR) & (away > (STEEP * off + AT_REST) * extent)).any())
