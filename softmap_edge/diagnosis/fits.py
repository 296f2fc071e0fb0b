"""Fits of sets of effects on one problem, cached.

Each has parameters, cross-validation, and the contribution of each member.

A set is fitted from the best of a few starts of its newest member. The other members start at their
values in a smaller set. Units: mm. Pinned by tests/diagnosis/test_fits.py.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis.fit import STEP, Fit, Problem, Space

Floats = NDArray[np.float64]
# effects, and those with a parameter for each channel
Key = tuple[frozenset[str], frozenset[str]]

INSTANTS = 16  # candidate times of an event
DESCENTS = 2  # starts of a member that are fitted to convergence
APART = 0.5  # of a scale: nearer starts count as one
SLOPES_BYTES = 20e6  # memory of all fits of a problem; a run of a few hundred frames needs less
# of a logarithmic scale: further starts of an effect
GRID = (0.15, 0.35, 0.65, 0.85)


class Fits:
    """The sets of effects fitted on one problem."""

    def __init__(self, problem: Problem, candidates: Sequence[str]) -> None:
        self.problem, self.candidates = problem, list(candidates)
        self.null = problem.null()
        self._fits: dict[Key, Fit] = {(frozenset(), frozenset()): self.null}
        self._losses: dict[Key, tuple[Floats, Floats]] = {}
        self._shifts: dict[tuple[Key, str], Floats] = {}

    def get(self, effects: Collection[str], split: Collection[str] = ()) -> Fit:
        """Return the fit of a set of effects.

        Those in `split` have a parameter for each channel instead of one.
        """
        key = frozenset(effects), frozenset(split) & frozenset(effects)
        if key not in self._fits:
            self._fits[key] = self._split(key) if key[1] else self._grown(key[0])
            self._forget()
        return self._fits[key]

    def _forget(self) -> None:
        """Drop the slopes of the oldest fits if all slopes need too much memory.

        A fit recomputes them on demand.
        """
        held = [fit for fit in reversed(self._fits.values()) if "slopes" in fit.__dict__]
        size = np.cumsum([fit.slopes.nbytes for fit in held])
        for fit, total in zip(held, size):
            if total > SLOPES_BYTES:
                del fit.__dict__["slopes"]

    def without(self, fit: Fit, effect: str) -> Fit:
        """Return the fit of the same set without one effect."""
        return self.get([e for e in fit.effects if e != effect], fit.space.split)

    def _split(self, key: Key) -> Fit:
        """Fit a set with parameters for each channel, from the best shared parameters."""
        effects, split = key
        shared = self.get(effects, split - {max(split)})
        space = self.problem.space(shared.effects, split=split)
        return self.problem.fit(shared.effects, [carried(shared, space)], split=split)

    def _grown(self, key: frozenset[str]) -> Fit:
        """Fit a set from the nearest smaller fitted set, else from that without its last member."""
        none: frozenset[str] = frozenset()
        known = [
            self._fits[key - {e}, none] for e in sorted(key) if (key - {e}, none) in self._fits
        ]
        ordered = sorted(key, key=self.candidates.index)
        parent = min(known, key=lambda f: f.cost) if known else self.get(ordered[:-1])
        added = next(iter(key - set(parent.effects)))
        space = self.problem.space((*parent.effects, added))
        points = np.stack(
            [_joined(space, parent, added, start) for start in starts(self.problem, added)]
        )
        points = _with_signs(self.problem, space, points, added)
        costs = self.problem.costs(self.problem.at(space, points), points)[0]
        order = [int(i) for i in np.argsort(costs, kind="stable")]
        followed = [points[order[0]]]
        for i in order[1:]:
            if len(followed) < DESCENTS and all(
                np.max(np.abs(points[i] - p)) > APART for p in followed
            ):
                followed.append(points[i])
        return self.problem.fit((*parent.effects, added), followed)

    def dispersion(self, fit: Fit) -> float:
        """Return the remaining chi² per value, at least 1."""
        return max(1.0, fit.chi2 / max(1.0, self.problem.numbers - len(fit.x)))

    def losses(self, fit: Fit) -> tuple[Floats, Floats]:
        """Return held-out losses (folds,) and the fold predictions (folds, K, F)."""
        key = _key(fit)
        if key not in self._losses:
            predictions = self.problem.fold_predictions(fit)
            self._losses[key] = self.problem.fold_losses(predictions), predictions
        return self._losses[key]

    def held_out_mm(self, fit: Fit) -> float:
        """Return the RMS error in mm over the places on held-out blocks."""
        return self.problem.held_out_mm(self.losses(fit)[1])

    def displacement(self, fit: Fit, effect: str) -> Floats:
        """Return the contribution (K, F) mm of `effect` within a fit."""
        key = _key(fit), effect
        if key not in self._shifts:
            kept = [e for e in fit.effects if e != effect]
            split = frozenset(fit.space.split) - {effect}
            space, params = self.problem.space(kept, split=split), fit.params
            without = np.array([[params[label] for label in space.labels]])
            self._shifts[key] = np.asarray(
                fit.predicted - self.problem.record.predict(space.names, space.full(without))[0]
            )
        return self._shifts[key]

    def share(self, fit: Fit, member: str) -> float:
        """Return a member's share of the explained misfit, on held-out blocks or the objective."""
        rest = self.without(fit, member)
        plain = [float(self.losses(f)[0].sum()) for f in (self.null, rest, fit)]
        pairs = (
            (plain[1] - plain[2], plain[0] - plain[2]),
            (rest.cost - fit.cost, self.null.cost - fit.cost),
        )
        return max(part / total if total > 0.0 else 0.0 for part, total in pairs)


def carried(fit: Fit, space: Space) -> Floats:
    """Return a fit's coordinates (P,) in a space with a parameter for each channel.

    The fit has one parameter for all channels.
    """
    known = dict(zip(fit.space.free_labels, fit.x))
    return np.array(
        [
            known[label] if label in known else known[label.split("[")[0]]
            for label in space.free_labels
        ]
    )


def _key(fit: Fit) -> Key:
    return frozenset(fit.effects), frozenset(fit.space.split)


def starts(problem: Problem, effect: str) -> list[Floats]:
    """Return scaled starts (D,) of an effect: declared, other signs, along log scales and time.

    Every combination of integers is a separate start. Slack tendons have a kink at home, where the
    slope on one side does not determine the other.
    """
    space = problem.space((effect,), free=(effect,))
    if space.integer.any():
        return _integer_points(space)
    points = [space.start.copy()]
    for i in np.flatnonzero(space.instant):
        low, high = space.values(space.low)[i], space.values(space.high)[i]
        for share in (np.arange(INSTANTS) + 0.5) / INSTANTS:
            values = space.values(space.start)
            values[i] = low + share * (high - low)
            points.append(space.scaled(values))
    for i in np.flatnonzero(space.log & space.declared & ~space.instant):
        for share in GRID:
            point = space.start.copy()
            point[i] = space.low[i] + share * (space.high[i] - space.low[i])
            points.append(point)
    signed = (~space.log & (space.low < 0))[space.declared]
    if signed.all():
        every_other = np.where(np.arange(len(space.start)) % 2, -space.start, space.start)
        flipped = [-space.start, every_other, -every_other][: 3 if len(signed) > 1 else 1]
        points += [np.clip(point, space.low, space.high) for point in flipped]
    return points


def _with_signs(problem: Problem, space: Space, points: Floats, effect: str) -> Floats:
    """Return starts (S, P) of an effect with signed parameters from one linear step.

    Starts are compared for the location of an effect (a radius, a time, a section). With a wrong
    sign, the right location would look worst.
    """
    own = space.of((effect,))
    places = own & (space.log | space.instant)
    signed = np.flatnonzero(own & ~space.log & ~space.instant & ~space.integer & (space.low < 0))
    if not places.any() or not len(signed):
        return points
    found = points.copy()
    for point in found:
        modes = problem.at(space, point[None])[0]
        step = np.where(point + STEP > space.high, -STEP, STEP)[signed]
        moved = np.tile(point, (len(signed), 1))
        moved[np.arange(len(signed)), signed] += step
        slopes = problem.white((problem.at(space, moved) - modes) / step[:, None, None])
        curvature = slopes @ slopes.T + np.eye(len(signed))
        point[signed] -= np.linalg.solve(curvature, slopes @ problem.white(modes) + point[signed])
    return np.asarray(np.clip(found, space.low, space.high))


def _joined(space: Space, parent: Fit, effect: str, start: Floats) -> Floats:
    """Return joint coordinates (P,): those of the parent, and `start` for `effect`."""
    x = np.zeros(len(space.free_labels))
    old = dict(zip(parent.space.free_labels, parent.x))
    for i, label in enumerate(space.free_labels):
        x[i] = old.get(label, 0.0)
    x[space.of((effect,))] = start
    return np.clip(x, space.low, space.high)


def _integer_points(space: Space) -> list[Floats]:
    """Return all combinations of an effect's integers, except the one with all at null."""
    values = space.values(space.start)
    rows = [
        [float(k) for k in range(round(low), round(high) + 1)] if is_integer else [value]
        for value, is_integer, low, high in zip(
            values, space.integer, space.values(space.low), space.values(space.high)
        )
    ]
    points = [space.scaled(np.array(point)) for point in product(*rows)]
    return [p for p in points if np.any(np.abs(p - space.scaled(space.null))[space.integer] > 1e-9)]
