"""Screens candidates on top of a fit: one Gauss-Newton step from a few starts of each, before any is fitted in full.

On top of the model alone all are looked at. What each of them does there is kept, and on top of a fit it says which are
worth a look again. Effects on the command are followed by the slopes of the features over what acts; all else is
predicted where the fit's own parameters are, and follows these by its slopes. All this on FRAMES of the frames, evenly
spread; the best are then predicted on all of them.
Limit: an effect that shows only far from every start is not seen. Pinned by tests/test_screening.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from math import log
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis.fit import DAMPING, STEP, Fit, Problem, Space, normal, normal_step

Floats = NDArray[np.float64]

LOOKED = 2  # candidates that are looked at again on top of a fit, for each one that is predicted
PREDICTED = 2  # candidates that are predicted and not only looked at by slopes, for each one that is fitted
INSTANTS, MOST_STARTS = 8, 11  # places in time at which something may have happened; starts of one effect
STEPPED, STEPPED_ON = 3, 2  # starts of each from which a step is taken: those that come nearest; on top of a fit
SIGNED = 2  # starts of each whose signatures are kept
FRAMES = 120  # on which candidates are looked at by slopes
FAINTER = (0.05, 0.1, 0.2, 0.4)  # of the way from a start that is worse than nothing to the ends of its scale
NEAR = 0.25  # of the commands' range: farther, a screening step is predicted and not taken along the slopes


@dataclass(frozen=True, eq=False)
class Signature:
    """What an effect does to the model alone at a start (P,): whitened slopes, then the shift, as `rows` (P + 1, n)."""

    start: Floats
    rows: Floats

    @cached_property
    def gram(self) -> Floats:
        """Products (P + 1, P + 1) of the rows."""
        return np.asarray(self.rows @ self.rows.T)


@dataclass(frozen=True, eq=False)
class Glimpse:
    """A fit on the frames that are looked at: `modes` (K, M), `slopes` (P, K, M), whitened slopes (P, n), objective."""

    modes: Floats
    slopes: Floats
    white: Floats
    cost: float


class Screening:
    """What each candidate promises on top of each fit; kept, so that nothing is looked at twice."""

    def __init__(self, problem: Problem, registry: Sequence[Mapping[str, Any]]) -> None:
        """Screen on `problem` the effects of a `registry`."""
        self.problem = problem
        self.roles: dict[str, str] = {e["name"]: e["role"] for e in registry}
        self.families: dict[str, str] = {e["name"]: e["family"] for e in registry}
        self._glances: dict[tuple[frozenset[str], str], float] = {}
        self._points: dict[tuple[frozenset[str], str], list[Floats]] = {}
        self._slopes: dict[frozenset[str], tuple[Floats, Floats]] = {}
        self._signatures: dict[str, list[Signature]] = {}
        self._starts: dict[str, list[Floats]] = {}  # of effects whose own starts lead nowhere
        self._glimpses: dict[frozenset[str], Glimpse] = {}
        self._rows = problem.record.spread_rows(FRAMES)
        self.few = problem if len(self._rows) == len(problem.record) else problem.some(self._rows)

    def best(
        self, parent: Fit, effects: Sequence[str], count: int, least: float = 0.0
    ) -> list[tuple[float, str, list[Floats]]]:
        """Return the `count` most promising of `effects` on top of `parent`: (objective, effect, joint points).

        They are looked at by slopes; the objectives of the best PREDICTED times as many are then predicted. Parameters
        have their price. One that promises to win less than `least` need not be among them.
        """
        looked = LOOKED * PREDICTED * count
        known = parent.effects and all(effect in self._signatures for effect in effects)
        if known and (len(effects) > looked or least > 0.0):
            effects = self._promising(parent, effects, looked, least)
        glances = sorted((self._screened(parent, effect), effect) for effect in effects)
        found, counts = [], {}
        for _, effect in glances[: PREDICTED * count]:
            points = self._points[frozenset(parent.effects), effect]
            space = self.problem.space((*parent.effects, effect))
            counts[effect] = space.count
            first = np.stack(points[: 1 if parent.effects else 2])  # on top of a fit no second start is fitted
            costs = self.problem.costs(self.problem.at(space, first), first)[0]
            order = [*np.argsort(costs, kind="stable"), *range(len(first), len(points))]
            found.append((float(costs.min()), effect, [points[i] for i in order]))
        dispersion = max([1.0, min(cost for cost, *_ in found) / max(1.0, self.problem.numbers)]) if found else 1.0
        price = dispersion * log(max(3.0, self.problem.numbers))  # of a parameter, as in EBIC
        return sorted(found, key=lambda item: (item[0] + price * counts[item[1]], item[1]))[:count]

    def _screened(self, parent: Fit, effect: str) -> float:
        """Return the objective by slopes after one step of `effect` on top of `parent`; its points are kept."""
        key = (frozenset(parent.effects), effect)
        if key not in self._glances:
            found = self._step(parent, effect, self._starts.get(effect) or self.starts(effect))
            if not parent.effects and found[0] >= self._glimpse(parent).cost:  # worse than nothing: no start is near
                self._starts[effect] = self._fainter(parent, effect)
                found = min(found, self._step(parent, effect, self._starts[effect]), key=lambda step: step[0])
            self._glances[key], self._points[key] = found
        return self._glances[key]

    def _fainter(self, parent: Fit, effect: str) -> list[Floats]:
        """Return the two best points on the way from the start of an effect to either end of its log scales.

        A limit is absent at its high end and acts all at once below what is commanded: no slope leads there from afar.
        """
        space = self.few.space((effect,), free=(effect,))
        ends = [np.where(space.log & space.declared, end, space.start) for end in (space.low, space.usual_high)]
        points = np.stack([space.start + share * (end - space.start) for end in ends for share in FAINTER])
        modes = self._glance(parent, self.few.space((effect,)), effect, points)
        return list(points[np.argsort(self.few.costs(modes, points)[0], kind="stable")[:2]])

    def _step(self, parent: Fit, effect: str, starts: Sequence[Floats]) -> tuple[float, list[Floats]]:
        """Take one step of `effect` from each of `starts`; the joint points come best first."""
        problem = self.few
        space = problem.space((*parent.effects, effect))
        labels = space.free_labels
        new = [i for i, label in enumerate(labels) if label.split(".")[0] == effect]
        old = dict(zip(parent.space.free_labels, range(len(parent.x))))
        joint = []
        for start in starts:
            x = np.array([parent.x[old[label]] if label in old else 0.0 for label in labels])
            x[new] = start
            joint.append(np.clip(x, space.low, space.high))
        most = STEPPED_ON if parent.effects else STEPPED
        if len(joint) > most:
            costs = problem.costs(self._glance(parent, space, effect, np.stack(joint)), np.stack(joint))[0]
            joint = [joint[i] for i in np.argsort(costs, kind="stable")[:most]]
        batch, width = [], len(new) + 1
        for x in joint:
            batch.append(x)
            for i in new:
                moved = x.copy()
                moved[i] += -STEP if x[i] + STEP > space.high[i] else STEP
                batch.append(moved)
        modes = self._glance(parent, space, effect, np.stack(batch))
        modes = modes.reshape(len(joint), width, *modes.shape[1:])
        points = np.stack(batch).reshape(len(joint), width, -1)
        moved = np.array([points[:, 1 + j, i] - points[:, 0, i] for j, i in enumerate(new)])
        rates = (modes[:, 1:] - modes[:, :1]) / moved.T[..., None, None]
        own, here = problem.white(rates), problem.white(modes[:, 0])
        at = [labels.index(label) for label in old]
        ahead = []
        for x, slopes, residual in zip(joint, own, here):
            jacobian = np.empty((len(labels), len(residual)))
            jacobian[at], jacobian[new] = self._glimpse(parent).white, slopes
            ahead.append(normal_step(space.pinned(x), x, *normal(x, jacobian, residual), DAMPING))
        after = self._glance(parent, space, effect, np.stack(ahead))
        points = np.concatenate([np.stack(joint), np.stack(ahead)])
        costs = problem.costs(np.concatenate([modes[:, 0], after]), points)[0]
        order = np.argsort(costs, kind="stable")
        if not parent.effects:
            shifts = modes[:, :1] - self._glimpse(parent).modes
            nearest = dict.fromkeys(int(i) % len(joint) for i in order)
            self._signatures[effect] = [
                Signature(joint[i][new], self.few.white(np.concatenate([rates[i], shifts[i]])))
                for i in list(nearest)[:SIGNED]
            ]
        return float(costs[order[0]]), [points[i] for i in order]

    def _promising(self, parent: Fit, effects: Sequence[str], count: int, least: float) -> list[str]:
        """Return the `count` of `effects` that would win most on top of `parent`, were they there what they are alone.

        Loads and changes of the body of a family with one that is fitted, or with one of these, come along: what they
        do changes with what acts in the parent.
        """
        glimpse = self._glimpse(parent)
        rows = np.concatenate([glimpse.white, self.few.white(glimpse.modes[None])])
        gram = rows @ rows.T
        most = glimpse.cost * (1.0 - least / max(parent.cost, 1e-300)) if least > 0.0 else np.inf
        promises = []
        for effect in effects:
            space = self.few.space((*parent.effects, effect))
            labels = space.free_labels
            old = [labels.index(label) for label in parent.space.free_labels]
            new = [i for i in range(len(labels)) if i not in old]
            back = np.argsort([*old, *new])  # where each parameter stands among old ones first, new ones then
            for signature in self._signatures[effect]:
                across = rows @ signature.rows.T
                product, p = np.empty((len(back), len(back))), len(old)
                product[:p, :p], product[p:, p:] = gram[:-1, :-1], signature.gram[:-1, :-1]
                product[:p, p:], product[p:, :p] = across[:-1, :-1], across[:-1, :-1].T
                towards = np.r_[gram[:-1, -1] + across[:-1, -1], across[-1, :-1] + signature.gram[:-1, -1]]
                here = float(gram[-1, -1] + 2.0 * across[-1, -1] + signature.gram[-1, -1])
                x, slope = np.concatenate([parent.x, signature.start])[back], towards[back]
                curve = product[back[:, None], back]
                curve.flat[:: len(back) + 1] += 1.0
                ahead = normal_step(space.pinned(x), x, slope + x, curve, DAMPING)
                step = ahead - x
                there = here + 2.0 * float(step @ slope) + float(step @ (curve @ step) - step @ step)
                promises.append((min(here + float(x @ x), there + float(ahead @ ahead)), effect))
        best = list(dict.fromkeys(effect for cost, effect in sorted(promises) if cost <= most))[:count]
        beside = {self.families[effect] for effect in [*parent.effects, *best]}
        changed = [e for e in effects if self.roles[e] != "channel" and self.families[e] in beside]
        return list(dict.fromkeys([*best, *changed]))

    def _glimpse(self, parent: Fit) -> Glimpse:
        """Return a fit on the frames that are looked at."""
        key = frozenset(parent.effects)
        if key not in self._glimpses:
            modes, slopes = parent.modes, parent.slopes
            if self.few is not self.problem:
                modes, slopes = modes[self._rows], slopes[:, self._rows]
            cost = float(self.few.costs(modes[None], parent.x[None])[0][0])
            self._glimpses[key] = Glimpse(modes, slopes, self.few.white(slopes), cost)
        return self._glimpses[key]

    def _glance(self, parent: Fit, space: Space, effect: str, points: Floats) -> Floats:
        """Return residual modes (B, K, M) of joint points (B, P), linear in the parent's own parameters.

        For a channel effect by the slopes about what acts in the parent, unless it is moved too far.
        """
        problem, labels, glimpse = self.few, space.free_labels, self._glimpse(parent)
        channel = self.roles[effect] == "channel"
        if channel:
            acting, slopes = self._about(parent)
            shift = problem.record.acting(space.names, space.params(points)) - acting
            if np.abs(shift).max(initial=0.0) > NEAR * problem.record.spread.max(initial=0.0):
                return problem.at(space, points)
            modes = np.asarray(glimpse.modes + np.einsum("bkc,ckm->bkm", shift, slopes))
        else:
            old = [labels.index(label) for label in parent.space.free_labels]
            still = points.copy()
            still[:, old] = parent.x
            modes = problem.at(space, still)
        for label, x, slope in zip(parent.space.free_labels, parent.x, glimpse.slopes):
            if not (channel and self.roles[label.split(".")[0]] == "channel"):
                modes = modes + (points[:, labels.index(label)] - x)[:, None, None] * slope
        return modes

    def _about(self, parent: Fit) -> tuple[Floats, Floats]:
        """Return what acts in a fit (K, C), and the slopes (C, K, M) of the residual modes over it."""
        key = frozenset(parent.effects)
        if key not in self._slopes:
            record, params = self.few.record, parent.space.params(parent.x[None])[0]
            slopes = np.where(np.isfinite(record.seen), record.slopes(parent.space.names, params), np.nan)
            acting = record.acting(parent.space.names, params[None])[0]
            self._slopes[key] = acting, -self.few.gain * self.few.whitener.modes(slopes)
        return self._slopes[key]

    def starts(self, effect: str) -> list[Floats]:
        """Return scaled starting points of one effect alone: as declared, with other signs, on log scales, in time.

        Tendons that fall slack put a kink at home, where the slope on one side says nothing about the other. Every
        combination of whole numbers is a start of its own.
        """
        space = self.few.space((effect,), free=(effect,))
        if space.integer.any():
            return _whole_starts(space)
        points = [space.start.copy()]
        for i in np.flatnonzero(space.instant):
            low, high = space.values(space.low)[i], space.values(space.high)[i]
            for share in (np.arange(INSTANTS) + 0.5) / INSTANTS:
                values = space.values(space.start)
                values[i] = low + share * (high - low)
                points.append(space.scaled(values))
        for i in np.flatnonzero(space.log & space.declared & ~space.instant):
            for share in (0.15, 0.85):
                point = space.start.copy()
                point[i] = space.low[i] + share * (space.usual_high[i] - space.low[i])
                points.append(point)
        signed = (~space.log & (space.low < 0))[space.declared]
        if signed.all():
            every_other = np.where(np.arange(len(space.start)) % 2, -space.start, space.start)
            flipped = [-space.start, every_other, -every_other][: 3 if len(signed) > 1 else 1]
            points += [np.clip(point, space.low, space.high) for point in flipped]
        return points[:MOST_STARTS]


def _whole_starts(space: Space) -> list[Floats]:
    """Return every combination of the whole numbers of an effect, but that where all are at their null."""
    values = space.values(space.start)
    rows = [
        [float(k) for k in range(round(low), round(high) + 1)] if whole else [value]
        for value, whole, low, high in zip(values, space.integer, space.values(space.low), space.values(space.high))
    ]
    points = [space.scaled(np.array(point)) for point in product(*rows)]
    return [p for p in points if np.any(np.abs(p - space.scaled(space.null))[space.integer] > 1e-9)]
