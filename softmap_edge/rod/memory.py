"""The memory that was in a robot while it was learned: which family first, by which law second.

Level 1: the signals of each family (`signals.py`) stand beside the static map as columns, with powers up to three where
there are few channels; a family is taken if it lowers the held-out loss by more than a paired standard error over the
folds, in most folds, by a share of the loss and of what stands above the noise, and visibly. If the best family fails,
none is taken: the next best would only stand in for it. Level 2: the effects that are members of the families that fall,
each with the static map solved again (`law.py`). A law *reaches* if it does as well as the best of
all, representatives included; the fewest numbers win; the rest are its alternatives. Then one number per channel is tried.
The law joins the chain, v takes the place of the command, and the families are asked again.

Several runs: each run whose commands lie within those of the others is also held out whole, which judges between
families that draw the same loop at one amplitude and speed. The B-spline of the command is the control: where it does as
well as a family, nothing is remembered. Limits: laws act in series with the map; rates alone have no law in the library.
Pinned by tests/test_learned_memory.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.folds import Folds, run_folds
from softmap_edge.learned_in import Alternative, LearnedIn
from softmap_edge.learned_in import Law as Kind
from softmap_edge.rod.law import FittedLaw, LawFit, law
from softmap_edge.rod.reference_run import Seen
from softmap_edge.rod.regression import Drive
from softmap_edge.rod.signals import Family, families
from softmap_edge.rod.static_map import StaticMap

Floats = NDArray[np.float64]

FRAMES = 1500  # of a search; neighbouring frames say the same
FEW_CHANNELS = 3  # up to here signals get powers, which more channels have too few frames for
POWERS = 3
LEAST = 0.03  # of the loss that a family must explain: less is lost in how the folds were cut
FIRST, LATER = 0.05, 0.3  # the same of what stands above the noise; later ones divide what the first left
MOST_FOLDS = 0.6  # share of the folds in which it must
FALL = 0.01  # of its loss by which a fold falls
VISIBLE = 1e-3  # of the robot's length, RMS: less is below what a camera shows (0.12 mm of a finger of 120)
FORM = 0.025  # of the explained loss: laws closer than this differ in form, not in truth
AGREE, FOLDS_THAT_AGREE = 0.85, 5  # share of at least so many folds that decides between two though their mean does not
PAIR = 0.8  # of what a law leaves above the noise: a second law of its family that explains less is form error
EACH = 0.05  # of the loss that a number per channel must explain more than one for all
MOST_LAWS = 3
WITHIN = 0.1  # of the range by which a run held out whole may leave the others


@dataclass(frozen=True, eq=False)
class Memory:
    """What was found: the chain and its parameters by label, a record of each part, the noise in mm, remarks."""

    names: tuple[str, ...] = ()
    params: Mapping[str, float] = field(default_factory=dict)
    learned_in: tuple[LearnedIn, ...] = ()
    noise_mm: float | None = None
    notes: tuple[str, ...] = ()

    def acting(self, drive: Drive) -> Floats:
        """Return what acts (n, C) at the seen times."""
        return drive.acting(self.names, self.params)


@dataclass(frozen=True, eq=False)
class _Represented:
    """A family with the held-out loss (folds,) that its signals beside the map reach."""

    family: Family
    losses: Floats


@dataclass(frozen=True, eq=False)
class _Found:
    """A law that was taken, with what it was taken for and what came near it."""

    family: Family
    names: tuple[str, ...]
    fitted: FittedLaw
    before: Floats
    rivals: tuple[tuple[str, str, Floats], ...]
    open: bool


def find_memory(seen: Seen, static: StaticMap, seed: int, members: Sequence[str] | None = None) -> Memory:
    """Find the memory of a robot beside its static map.

    Args:
        seen: what was seen. static: of the same frames. seed: of the scans.
        members: the families whose laws may join the chain; None for all. Others are only reported.
    """
    return _Search(seen, static, seed, members).run()


def search_folds(seen: Seen) -> Folds:
    """Return the folds of a search: blocks of time, and runs that the commands of the others cover."""
    parts = run_folds(seen.t, seen.labels)
    commands, number = seen.drive.commanded, seen.number
    for k in range(len(seen.runs)) if len(seen.runs) > 1 else ():
        inside, others = commands[number == k], commands[number != k]
        low, high = others.min(axis=0), others.max(axis=0)
        slack = WITHIN * (high - low)
        if np.all((inside >= low - slack) & (inside <= high + slack)):
            parts.append((np.flatnonzero(number != k), np.flatnonzero(number == k)))
    return parts


class _Search:
    def __init__(self, seen: Seen, static: StaticMap, seed: int, members: Sequence[str] | None) -> None:
        self.seen, self.static, self.members = seen, static, members
        self.fit, self.families = LawFit(seen.drive, static, seed, seen.unit), families()
        self.floor = self._noise() * len(static.targets) * static.targets.shape[1]
        self.frames = sum(len(test) for _, test in static.parts) / len(static.targets)  # times each frame is judged
        self.notes: list[str] = []

    def run(self) -> Memory:
        found: list[_Found] = []
        acting = self.seen.drive.commanded
        while len(found) < MOST_LAWS:
            represented = self._represented(acting, found)
            if self._static_suffices(represented, acting, found):
                self.static = replace(self.static, splined=True)  # the next families are judged beside this map
                self.fit = LawFit(self.fit.drive, self.static, self.fit.seed, self.fit.unit)
                continue
            step = self._step(represented, acting, found)
            if step is None:
                break
            found.append(step)
            acting = step.fitted.acting
        noise = float(np.sqrt(self.floor / self.static.targets.size))
        if not found:
            return Memory(noise_mm=noise, notes=tuple(self.notes))
        return self._memory(found, noise)

    # --- one family ------------------------------------------------------------------------------

    def _represented(self, acting: Floats, found: Sequence[_Found]) -> list[_Represented]:
        """Return the families that this log can show, the one with the lowest held-out loss first."""
        possible = [
            family
            for family in self.families
            if not (family.fast and self.seen.slow or family.timed and self.seen.timeless)
            and not (family.static and self.static.splined)
        ]
        every = (_Represented(f, self.static.losses(acting, self._beside(f, found))) for f in possible)
        return sorted(every, key=lambda one: float(one.losses.sum()))

    def _static_suffices(self, represented: Sequence[_Represented], acting: Floats, found: Sequence[_Found]) -> bool:
        """Whether a map of another form does as well as any memory."""
        now, best = self.static.losses(acting), represented[0].losses
        if not self._falls(now, best, LATER if found else FIRST):
            return False
        return any(one.family.static and self._near(one.losses, best, now) for one in represented)

    def _step(self, represented: Sequence[_Represented], acting: Floats, found: Sequence[_Found]) -> _Found | None:
        """Return the law that is to join those found, or None."""
        now, best = self.static.losses(acting), represented[0]
        if not self._falls(now, best.losses, LATER if found else FIRST):
            return None
        share = LATER if found else FIRST
        falling = [one for one in represented if self._falls(now, one.losses, share) and not one.family.static]
        near = [one for one in falling if self._near(one.losses, best.losses, now)]
        chosen = [name for f in found for name in f.names]
        fits = {
            (one.family.name, member): self._law([*chosen, member], found)
            for one in falling  # signals of one channel at a time may fall short of a law that a map of many explains
            for member in one.family.members
            if member not in chosen
        }
        good = {key: fit for key, fit in fits.items() if self._falls(now, fit.losses, share)}
        if not good:
            self._only_seen(near, now, False)
            return None
        step = self._chosen(near, good, now, best)
        if self.members is not None and step.family.name not in self.members:
            self._only_seen(near, now, True)
            return None
        return step

    def _chosen(
        self,
        near: Sequence[_Represented],
        good: Mapping[tuple[str, str], FittedLaw],
        now: Floats,
        best: _Represented,
    ) -> _Found:
        """Choose among laws that lower the loss: those that reach, the fewest numbers first."""
        lowest = min([*(fit.losses for fit in good.values()), best.losses], key=lambda losses: float(losses.sum()))
        reach = {key: fit for key, fit in good.items() if self._near(fit.losses, lowest, now)}
        order = sorted(
            (reach or good).items(), key=lambda item: (len(item[1].x) if reach else 0, float(item[1].losses.sum()))
        )
        (family, name), fitted = order[0]
        fitted, second = self._paired(family, name, fitted)
        fitted = self._each(name, fitted)
        rivals = [(member, of, fit.losses) for (of, member), fit in reach.items() if member not in (name, second)]
        if not reach:
            rivals += [(member, of, fit.losses) for (of, member), fit in good.items() if member not in (name, second)][:2]
        lawless = [one for one in near if not one.family.members and self._near(one.losses, lowest, now)]
        rivals += [("", one.family.name, one.losses) for one in lawless]
        return _Found(
            next(one for one in self.families if one.name == family),
            tuple(filter(None, (name, second))),
            fitted,
            now,
            tuple(rivals),
            open=not reach or bool(fitted.bounded.any()),
        )

    def _law(self, names: Sequence[str], found: Sequence[_Found]) -> FittedLaw:
        if not found:
            return self.fit.scanned(law(names, self.seen.drive), {})
        last = found[-1].fitted
        return self.fit.scanned(law(names, self.seen.drive, self._apart(last)), last.numbers)

    def _paired(self, family: str, name: str, fitted: FittedLaw) -> tuple[FittedLaw, str]:
        """Return the law with a second member of its family where the two explain nearly all that the one leaves."""
        left = float(fitted.losses.sum()) - self.frames * self.floor
        best, second = fitted, ""
        for member in next(f.members for f in self.families if f.name == family):
            if member in fitted.law.names:
                continue
            both = self.fit.scanned(law([*fitted.law.names, member], self.seen.drive, self._apart(fitted)), fitted.numbers)
            fall = float((fitted.losses - both.losses).sum())
            if fall > PAIR * left and self._falls(fitted.losses, both.losses, LATER) and both.losses.sum() < best.losses.sum():
                best, second = both, member
        return best, second

    @staticmethod
    def _apart(fitted: FittedLaw) -> list[str]:
        """Return the effects that have a number per channel in a law."""
        return sorted({label.split(".")[0] for label in fitted.law.labels if "[" in label})

    def _each(self, name: str, fitted: FittedLaw) -> FittedLaw:
        """Return the law with a number per channel for the effect `name` where the evidence asks for it."""
        one = fitted.law
        other = law(one.names, self.seen.drive, [*self._apart(fitted), name])
        if len(other.labels) == len(one.labels):
            return fitted  # one channel, or an effect whose numbers are the robot's
        start = other.at(fitted.numbers)
        starts = [start]
        for i, label in enumerate(other.labels):
            if label.startswith(f"{name}.") and "[" in label:
                starts.append(self.fit.scanned_along(other, starts[-1], i))
        better = self.fit.refined(other, np.stack(starts[-2:]))
        fall = fitted.losses - better.losses
        asked = fall.sum() > max(_deviation(fall), EACH * float(fitted.losses.sum()))
        return better if asked and (better.losses < fitted.losses).mean() >= MOST_FOLDS else fitted

    # --- evidence --------------------------------------------------------------------------------

    def _beside(self, family: Family, found: Sequence[_Found]) -> Floats:
        """Return the columns (n, J) of a family: its signals about what acts, and their powers."""
        parts = []
        middle, half = self.seen.drive.middle, self.seen.drive.half
        powers = POWERS if self.seen.drive.channels <= FEW_CHANNELS and not family.static else 1
        for record in self.seen.drive.records:
            u = record.u
            if found:
                one = found[-1].fitted
                u = one.law.chain.rollout(one.law.params(one.x)[None], record.u, record.t)[0]
            z = family.signals(record, u, middle, half)
            parts.append(np.concatenate([z**power for power in range(1, powers + 1)], axis=1))
        return np.concatenate(parts)

    def _falls(self, before: Floats, after: Floats, share: float) -> bool:
        """Whether a loss falls clearly, in most folds, by enough of it, and visibly."""
        fall, above = before - after, float(before.sum()) - self.frames * self.floor
        enough = max(LEAST * float(before.sum()), share * max(above, 0.0), _deviation(fall))
        markers = self.seen.markers.shape[1]
        moved = np.sqrt(max(float(fall.sum()), 0.0) / (self.frames * len(self.static.targets) * markers))
        length = float(np.linalg.norm(self.seen.markers, axis=2).mean(axis=0).max())
        most = float((fall > FALL * before).mean()) >= MOST_FOLDS
        return float(fall.sum()) > enough and most and moved > VISIBLE * length

    @staticmethod
    def _near(one: Floats, best: Floats, before: Floats) -> bool:
        """Whether a held-out loss cannot be told from the best one, form error forgiven."""
        behind = one - best
        if behind.sum() <= FORM * float((before - best).sum()):
            return True
        decided = len(behind) >= FOLDS_THAT_AGREE and float((behind > 0).mean()) >= AGREE
        return float(behind.sum()) <= _deviation(behind) and not decided

    def _noise(self) -> float:
        """Return the variance of a target, mm², from its third differences between frames: what no map can explain."""
        residual = self.static.residual(self.seen.drive.commanded)
        if len(residual) < 8:
            return 0.0
        square = (np.diff(residual, n=3, axis=0) ** 2).mean(axis=1)
        return float(np.median(square)) / 20.0  # 1 + 9 + 9 + 1; corners at reversals are few, so the median

    # --- what is told ----------------------------------------------------------------------------

    def _rms(self, losses: Floats) -> float:
        return float(np.sqrt(losses.sum() / (self.frames * len(self.static.targets) * self.seen.markers.shape[1])))

    def _only_seen(self, near: Sequence[_Represented], now: Floats, forbidden: bool) -> None:
        names, after = " or ".join(one.family.name for one in near), self._rms(near[0].losses)
        why = "is left to the diagnosis" if forbidden else "has no law in the library that reaches it"
        self.notes.append(
            f"the run shows {names} beside the static map (held-out error {self._rms(now):.2f} to {after:.2f} "
            f"mm RMS), which {why}: it is not in the model"
        )

    def _memory(self, found: Sequence[_Found], noise: float) -> Memory:
        last = found[-1].fitted
        numbers = self.fit.told(last)
        records = []
        for one in found:
            rivals = tuple(Alternative(name, family, self._rms(losses)) for name, family, losses in one.rivals)
            kind: Kind = "open" if one.open else "ambiguous" if rivals else "identified"
            before, after = self._rms(one.before), self._rms(one.fitted.losses)
            for name in one.names:
                twins = tuple(Alternative(twin, one.family.name, after) for twin in _twins(name))
                params = tuple(number for label, number in numbers.items() if label.startswith(f"{name}."))
                records.append(LearnedIn(name, one.family.name, kind, before, after, params, (*rivals, *twins)))
        return Memory(last.law.names, last.params, tuple(records), noise, tuple(self.notes))


def _twins(name: str) -> list[str]:
    """Return the effects that no run distinguishes from the effect `name`."""
    return [effect["name"] for effect in _core.effects() if effect["alike"].get(name) == "never"]


def _deviation(differences: Floats) -> float:
    """Return one standard error of the sum of paired differences over folds."""
    return float(differences.std(ddof=1) * np.sqrt(len(differences)))


def refined_memory(memory: Memory, seen: Seen, static: StaticMap, seed: int) -> Memory:
    """Return the memory with its numbers fitted again beside another map of the same targets."""
    if not memory.names:
        return memory
    each = sorted({label.split(".")[0] for one in memory.learned_in for label in _labels(one) if "[" in label})
    again, fit = law(memory.names, seen.drive, each), LawFit(seen.drive, static, seed, seen.unit)
    fitted = fit.refined(again, again.at(memory.params)[None])
    numbers = fit.told(fitted)
    records = tuple(
        replace(one, params=tuple(numbers[label] for label in _labels(one) if label in numbers))
        for one in memory.learned_in
    )
    return replace(memory, params=fitted.params, learned_in=records)


def _labels(record: LearnedIn) -> list[str]:
    return [number.label for number in record.params]
