"""Level 2 of a diagnosis: identify the law of a family, measured against the family's fit.

The family's members are fitted on top of the effects found. Then follow pairs of members, and the
same law with a parameter for each channel. For static maps, generic laws follow, which are not
effects. A law *reaches* if it leaves no more than the best of all, including the representative.
One standard error, or the tolerance of its form, is allowed. If none reaches, the law is unknown.
If a generic law with as few parameters reaches, it is open. Pinned by
tests/diagnosis/test_two_levels.py.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis import decision as rule
from softmap_edge.diagnosis.families import (
    CURVES,
    Columns,
    Commands,
    Family,
    FeatureBody,
    seen_commands,
)
from softmap_edge.diagnosis.fit import Fit
from softmap_edge.diagnosis.fits import Fits
from softmap_edge.diagnosis.representatives import Representative, State, about_itself, linearised
from softmap_edge.run.folds import GAP

Floats = NDArray[np.float64]

WINDING = "eccentric_pulley"  # with five parameters it fits many smooth maps
PAIRED = 3  # members that are tried in pairs
MANY_LAWS = ("static", "time")  # kinds of families that smooth curves of many laws can explain
# sums of CURVES, which are not effects
GENERIC = ("u²", "u|u|", "u³", "u, u|u|", "u, u³", "u, u², u³")
GENERIC_RIDGE = 0.3


@dataclass(frozen=True, eq=False)
class Law:
    """A candidate for the law of a family.

    Holds its effects and fit (none for a generic law), held-out loss, free parameters.
    """

    name: str
    effects: tuple[str, ...]
    fit: Fit | None
    loss: Floats  # (folds,)
    numbers: int

    @property
    def left(self) -> float:
        """The held-out loss of all folds."""
        return float(self.loss.sum())

    @property
    def split(self) -> tuple[str, ...]:
        """Its effects with a parameter for each channel or cable."""
        return (
            () if self.fit is None else tuple(e for e in self.effects if e in self.fit.space.split)
        )

    @property
    def of_cables(self) -> bool:
        """Whether one of its effects has a parameter for each cable."""
        return self.fit is not None and any(_of_cables(self.fit, effect) for effect in self.split)


@dataclass(frozen=True, eq=False)
class Answer:
    """The result of level 2 for a family.

    `law` is the identified law or a candidate. It is a candidate if the law is `open` because
    generic laws fit as well. It is also a candidate if no law reaches, but one explains most of the
    family's fall. Without a law the representative stays. `equals` are members that reach with as
    few parameters.
    """

    family: Family
    representative: Representative
    before: Floats  # (folds,) held-out loss without the family
    law: Law | None
    equals: tuple[Law, ...]
    open: bool
    reaching: tuple[Law, ...]
    tried: tuple[Law, ...]

    @property
    def identified(self) -> bool:
        """Whether one law of the library is identified for the family."""
        return self.law is not None and not self.open and not self.rough

    @property
    def rough(self) -> bool:
        """Whether the law is only a candidate, so the representative explains more."""
        return self.law is not None and not any(self.law is law for law in self.reaching)

    @property
    def loss(self) -> Floats:
        """The held-out loss (folds,) of the family's law, else the least loss of the family."""
        if self.identified and self.law is not None:
            return self.law.loss
        return min((self.representative.loss, *(law.loss for law in self.reaching)), key=np.sum)

    @property
    def left(self) -> float:
        """The same of all folds."""
        return float(self.loss.sum())

    @property
    def least(self) -> Floats:
        """The least held-out loss (folds,) of the law and the representative."""
        return self.representative.loss if self.representative.left < self.left else self.loss

    @property
    def numbers(self) -> float:
        """The number of free parameters of the law or representative taken."""
        return self.representative.numbers if self.law is None else self.law.numbers


def answered(
    state: State, fits: Fits, rough: Representative, before: Floats, pairs: bool
) -> Answer:
    """Find a family's law; also try `pairs` of members if nothing else remains to explain."""
    representative = rough if rough.settled or not len(rough.theta) else linearised(state, rough)[0]
    asked = _Asked(state, fits, representative, before)
    laws = asked.generic() if representative.family.name == "static map" else []
    members = asked.members()
    laws += members
    if not asked.any_reaches(members):
        laws += asked.for_each_channel(members)
    if pairs and not asked.any_reaches(laws):
        laws += asked.pairs(laws)
    return asked.answer_of(laws)


def law_of(
    state: State, fits: Fits, effects: tuple[str, ...], before: Floats, split: Collection[str] = ()
) -> Law:
    """Fit effects on top of the effects found; return their loss on held-out folds.

    `before` is the loss (folds,) without them.

    Those in `split` have a parameter for each channel or cable.
    """
    body, fit = (
        state.body,
        fits.get((*state.fit.effects, *effects), (*state.fit.space.split, *split)),
    )
    level = body.level()
    names, ridges = state.blocks(level, fit)
    level.close(np.ascontiguousarray(fit.modes))
    loss = capped_at_events(np.asarray(level.losses(names, ridges)), before, fit, effects)
    each = {e: f"{e} for each {'cable' if _of_cables(fit, e) else 'channel'}" for e in split}
    name = " + ".join(each.get(e, e) for e in effects)
    return Law(name, effects, fit, loss, int(fit.space.of(effects).sum()))


def _of_cables(fit: Fit, effect: str) -> bool:
    """Whether an effect has a free parameter for each cable, `dead_zone.slack[0+]`."""
    labels = (label for label in fit.space.free_labels if label.split(".")[0] == effect)
    return any(label.endswith(("+]", "-]")) for label in labels)


def capped_at_events(loss: Floats, before: Floats, fit: Fit, effects: Sequence[str]) -> Floats:
    """Return a fit's held-out loss (folds,), at most `before` in folds of its events.

    These are the folds in which its `effects` occur.

    Other folds cannot show an event that occurs once, in this fold; there, a law has no effect.
    """
    record, loss = fit.problem.record, loss.copy()
    for instant in fit.space.values(fit.x)[fit.space.of(effects) & fit.space.instant]:
        for i, (_, test) in enumerate(fit.problem.folds):
            since = record.t_seen[test] - float(record.parts[0].run.t[0])
            if np.min(np.abs(since - instant)) <= 2.0 * GAP:
                loss[i] = min(loss[i], before[i])
    return loss


class _Asked:
    """A family whose law is searched about one state."""

    def __init__(
        self, state: State, fits: Fits, representative: Representative, before: Floats
    ) -> None:
        self.state = state
        self.fits = fits
        self.representative = representative
        self.before = before
        self.body: FeatureBody = state.body
        static = representative.family.kind == "static"
        self.form = rule.form_of(static, representative.moved_mm, self.body.ordinary_mm)

    def members(self) -> list[Law]:
        """Fit each member of the family on top of the effects found."""
        names = [
            n
            for n in (*self.representative.family.members, *self.body.own)
            if n in self.fits.candidates
        ]
        return [
            law_of(self.state, self.fits, (n,), self.before)
            for n in names
            if n not in self.state.fit.effects
        ]

    def for_each_channel(self, members: list[Law]) -> list[Law]:
        """Fit members with a parameter for each channel instead of a shared one."""
        laws = [
            law_of(self.state, self.fits, law.effects, self.before, law.effects) for law in members
        ]
        return [law for law, shared in zip(laws, members) if law.numbers > shared.numbers]

    def pairs(self, laws: list[Law]) -> list[Law]:
        """Fit pairs of the best members, in order.

        Laws with a parameter for each cable are excluded: with a second law, they fit any smooth
        map.
        """
        best: dict[tuple[str, ...], Law] = {}
        able = (law for law in laws if law.effects and not self._any_map(law) and not law.of_cables)
        for law in sorted(able, key=lambda law: law.left):
            best.setdefault(law.effects, law)
        found = []
        for a, b in combinations(list(best.values())[:PAIRED], 2):
            found.append(
                law_of(
                    self.state,
                    self.fits,
                    (*a.effects, *b.effects),
                    self.before,
                    (*a.split, *b.split),
                )
            )
        return found

    def generic(self) -> list[Law]:
        """Fit generic laws of a static map, with shared parameters and per channel."""
        laws = []
        for name in GENERIC:
            curves = [CURVES[curve] for curve in name.split(", ")]
            laws.append(self._generic(f"{name} on each channel", curves, False))
            if len(curves) == 1 and len(self.body.half) > 1:
                laws.append(self._generic(f"{name} on all channels", curves, True))
        return laws

    def _generic(
        self, name: str, curves: Sequence[Callable[[Floats], Floats]], shared: bool
    ) -> Law:
        """Fit u + Σ θ · curve(u), with the same θ for all channels or with one for each."""
        body, state = self.body, self.state
        channels = len(body.half)

        def moves(theta: Floats) -> tuple[Commands, Floats]:
            each = (
                np.repeat(theta[:, None], channels, axis=1)
                if shared
                else theta.reshape(channels, -1).T
            )
            out = [
                v
                + sum(
                    t * body.half * c((v - body.middle) / body.half) for t, c in zip(each, curves)
                )
                for v in state.commands
            ]
            return [np.ascontiguousarray(v) for v in out], np.zeros(())

        seen = np.concatenate([seen_commands(p, v) for p, v in zip(body.parts, state.commands)])
        x = (seen - body.middle) / body.half
        weight = np.stack(
            [h * curve(column) for column, h in zip(x.T, body.half) for curve in curves]
        )
        which = np.repeat(np.arange(channels), len(curves))

        def columns(slopes: Floats) -> Columns:
            if not shared:
                return Columns(slopes, which, weight, len(weight))
            together = np.sum(slopes * weight[:, :, None], axis=0)[None]
            return Columns(together, np.zeros(1, np.intp), np.ones((1, len(x))), 1)

        count = len(curves) if shared else len(weight)
        loss = about_itself(state, columns, np.zeros(count), GENERIC_RIDGE, moves)[1]
        return Law(name, (), None, loss, count)

    def any_reaches(self, laws: list[Law]) -> bool:
        """Whether one of the laws reaches the family's fit."""
        explained = float(self.before.sum()) - self.representative.left
        return any(
            rule.reaches(law.loss, self.representative.loss, explained, self.form) for law in laws
        )

    def answer_of(self, laws: list[Law]) -> Answer:
        """Choose the law from all that were tried."""
        best = min((self.representative.loss, *(law.loss for law in laws)), key=np.sum)
        explained = float(self.before.sum() - best.sum())
        able = sorted(
            (law for law in laws if rule.reaches(law.loss, best, explained, self.form)),
            key=_simplest,
        )
        named = [law for law in able if law.effects and not self._any_map(law)]
        generic = [law for law in able if law not in named]
        # With a parameter for each cable, a smooth law fits maps of any form.
        is_open = any(
            named[0].of_cables or law.numbers <= named[0].numbers for law in generic if named
        )
        is_open = is_open or bool(generic and not named)
        same = self._equal(named, 0.5 * self.form * explained)
        if not named and (candidate := self._main(laws, explained)) is not None:
            is_open, same = is_open or self.representative.family.kind in MANY_LAWS, [candidate]
        tried = tuple(sorted(laws, key=lambda law: law.left))
        return Answer(
            self.representative.family,
            self.representative,
            self.before,
            same[0] if same else None,
            tuple(same[1:]),
            is_open,
            tuple(able),
            tried,
        )

    def _main(self, laws: list[Law], explained: float) -> Law | None:
        """Return the member that explains most of the family; its form may be inexact.

        The model error of a rod is part of its noise. Shares of a memory are then too uncertain for
        a candidate.
        """
        if self.representative.family.kind not in MANY_LAWS and self.body.record.error_is_noise:
            return None
        members = sorted(
            (law for law in laws if law.effects and not self._any_map(law)),
            key=lambda law: law.left,
        )
        done = float(self.before.sum()) - members[0].left if members else 0.0
        if not done >= rule.STANDS_FOR * explained > 0.0:
            return None
        return min(
            (law for law in members if rule.near(law.loss, members[0].loss, self.before)),
            key=_simplest,
        )

    def _equal(self, candidates: list[Law], worth: float) -> list[Law]:
        """Return the simplest law, and its equals with as few parameters.

        They are ordered by loss, then by their place in the chain.
        """
        if not candidates:
            return []
        first, *others = candidates
        equals = [
            law
            for law in others
            if not set(first.effects) < set(law.effects)
            and law.numbers <= first.numbers
            and not rule.leaves_cause(law.loss, first.loss, self.body.problem.numbers)
            and law.left - first.left <= max(worth, rule.difference(law.loss, first.loss).error)
        ]

        def beaten(law: Law) -> bool:
            fall = rule.difference(law.loss, first.loss)
            return rule.seen_to_fall(fall) and fall.fall >= rule.FALL * law.left

        return sorted(
            [first, *equals], key=lambda law: (law.numbers, beaten(law), self._stage(law))
        )

    def _stage(self, law: Law) -> int:
        return max(self.fits.candidates.index(effect) for effect in law.effects)

    def _any_map(self, law: Law) -> bool:
        """Whether an eccentric pulley turns less than once, or is in a pair.

        Such a law fits any smooth map.
        """
        return WINDING in law.effects and (law.effects != (WINDING,) or not winds(law, self.body))


def winds(law: Law, body: FeatureBody) -> bool:
    """Whether a law's eccentric pulley makes a full turn, or its radius is known.

    The turn must be within the commands.
    """
    assert law.fit is not None
    turns = np.pi * law.fit.params[f"{WINDING}.radius"] <= float(np.median(body.half))
    return bool(turns) or body.record.spool is not None


def _simplest(law: Law) -> tuple[int, float]:
    return law.numbers, law.left
