"""Identify the memory of a robot in its reference runs: first its family, then its law.

Level 1. The signals of each family (`signals.py`) are added to the static map as columns, with
powers up to three if there are few channels. A family counts if it lowers the held-out loss by more
than one paired standard error over the folds, in most folds, by a share of the loss and of the loss
above the noise, and visibly. If the best family fails, none is taken, because the next best would
only replace it. The B-splines of the command are the control. If they fit as well as the best
family, they join the map, and the families are compared with this map.

Level 2. The members of the families that fall are fitted with the static map solved again
(`law.py`), with one number for all channels and with a number per channel. A law *reaches* if it
fits as well as the best of all, representatives included. Of the laws that reach, the one with the
fewest numbers is chosen; the others are its alternatives. Numbers for each channel count as one. A
law is open if its family, or a second law of it, explains a good part of the remaining loss, or if
all laws leave a good part of the first loss: a bad map and a wrong law look alike. A law that does not reach, or
that is at a bound, is only reported if it is weak, if it explains only part of its family's fall,
or if a family without laws is near: it would only replace another cause. The same holds for a law
whose numbers from some blocks do not lower the loss of the others, and for one that fits nearly as
well if it reads the run backward: a memory depends on the past alone, and such a law only bends the
static map. The law joins the chain, its effective commands replace the commands, and the families
are tried again.

Several runs: each run whose commands the others cover is also held out as a block. This separates
families with the same loop at one amplitude and speed. Limits: laws act in series with the map; a
rate alone has no law in the library. Pinned by tests/rod/test_learned_memory.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.model.effect_info import registry
from softmap_edge.model.learned_in import Alternative, LearnedIn
from softmap_edge.model.learned_in import Law as Certainty
from softmap_edge.rod.law import FittedLaw, LawFit, law
from softmap_edge.rod.reference_run import ReferenceFrames
from softmap_edge.rod.regression import Drive, Record, standard_error
from softmap_edge.rod.signals import DRIFT, Family, families
from softmap_edge.rod.static_map import StaticMap

Floats = NDArray[np.float64]

FRAMES = 1500  # frames of a search; neighbouring frames are redundant
FEW_CHANNELS = 3  # most channels for powers of signals; with more there are too few frames
POWERS = 3
LEAST = 0.03  # least share of the loss that a family explains; less depends on the choice of folds
# the same of the loss above the noise; later families share the remainder
FIRST, LATER = 0.05, 0.3
MOST_FOLDS = 0.6  # share of the folds in which it must fall
FALL = 0.01  # of a fold's loss: least fall
# of the robot's length, RMS: camera limit (0.12 mm for a finger of 120)
VISIBLE = 1e-3
FORM = 0.025  # of the explained loss: closer laws differ only by model-form error
# share and least number of folds that decide if the mean difference does not
AGREE, FOLDS_THAT_AGREE = 0.85, 5
# Shares of the loss above the noise: least explained by an identified or unknown law, and most left
# in total, or to its family.
SURE = 0.2
# of the best family's fall: a law that does not reach must explain more, or it replaces another
PART = 0.6
# of a law's remainder above the noise: a second law of its family with less is model-form error
PAIR = 0.8
EACH = 0.05  # of the loss: least gain from a number per channel over a shared one
EACH_TRIED = 3  # best laws with shared numbers that are tried with a number per channel
MOST_LAWS = 3
SHORT = 2  # nearest effects that are named if none reaches
# of a law's fall: least part that is lost if it reads the run backward. True laws lose 0.44 or more,
# laws that stand in for the form of a static map 0.15.
PAST = 0.3


@dataclass(frozen=True, eq=False)
class Memory:
    """The result: chain and parameters by label, record of parts, noise in mm, remarks."""

    names: tuple[str, ...] = ()
    params: Mapping[str, float] = field(default_factory=dict)
    learned_in: tuple[LearnedIn, ...] = ()
    noise_mm: float | None = None
    notes: tuple[str, ...] = ()

    def acting(self, drive: Drive) -> Floats:
        """Return the effective commands (n, C) at the frame times."""
        return drive.acting(self.names, self.params)


@dataclass(frozen=True, eq=False)
class _Represented:
    """A family with the held-out loss (folds,) of its signals together with the map."""

    family: Family
    losses: Floats


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A candidate: an effect `name` as a family's law, or a family without one.

    It holds the held-out loss (folds,).
    """

    family: Family
    name: str
    losses: Floats
    fitted: FittedLaw | None = None

    @property
    def law(self) -> FittedLaw:
        """The fitted law of an effect."""
        assert self.fitted is not None
        return self.fitted

    @property
    def numbers(self) -> int:
        """The count of free numbers; those per channel, if evidence requires, count as one."""
        return 0 if self.fitted is None else _numbers(self.fitted)


@dataclass(frozen=True, eq=False)
class _Found:
    """Effects that were accepted together, the loss before them, and the alternatives.

    They are `short` if they do not reach the best of all, and `weak` if they explain a small part
    of the loss. Their family explains `more` if its signals, on top of them, lower the remainder
    clearly. They leave a `rest` if a good part of the first loss remains unexplained.
    """

    family: Family
    names: tuple[str, ...]
    fitted: FittedLaw
    before: Floats
    alternatives: tuple[_Candidate, ...]
    short: bool
    weak: bool
    more: bool = False
    rest: bool = False

    @property
    def certainty(self) -> Certainty:
        """Whether the law is identified.

        It must be strong, not at a bound, without an equal alternative, and leave little error.
        """
        if self.short or self.more or self.rest or self.fitted.bounded.any():
            return "open"
        alike = any(self._is_as_good(other) for other in self.alternatives)
        return "ambiguous" if alike or self.weak else "identified"

    def _is_as_good(self, other: _Candidate) -> bool:
        """Whether an alternative is of another family, has as few numbers, or fits better."""
        if other.family.name != self.family.name or other.numbers <= _numbers(self.fitted):
            return True
        fall = self.fitted.losses - other.losses
        return float(fall.sum()) > standard_error(fall) and float((fall > 0).mean()) >= MOST_FOLDS


def find_memory(
    seen: ReferenceFrames,
    static: StaticMap,
    seed: int,
    members: Sequence[str] | None = None,
    richer: Sequence[StaticMap] = (),
) -> Memory:
    """Find the memory of a robot together with its static map.

    Args:
        seen: the reference run.
        static: the static map of the same frames.
        seed: of the scans.
        members: the families whose laws may join the chain; None for all. Others are only reported.
        richer: other forms of the map, poorest first. One replaces `static` if it lowers the error
            of the best family or law.
    """
    return _Search(seen, static, seed, members, richer).run()


class _Search:
    def __init__(
        self,
        seen: ReferenceFrames,
        static: StaticMap,
        seed: int,
        members: Sequence[str] | None,
        richer: Sequence[StaticMap],
    ) -> None:
        self.seen, self.static, self.members, self.richer = seen, static, members, tuple(richer)
        self.fit, self.families = LawFit(seen.drive, static, seed, seen.unit), families()
        self.floor = self._noise() * len(static.targets) * static.targets.shape[1]
        # how often a frame is held out
        self.frames = sum(len(test) for _, test in static.parts) / len(static.targets)
        self.notes: list[str] = []
        self.unknown: tuple[LearnedIn, ...] = ()

    def run(self) -> Memory:
        found: list[_Found] = []
        acting = self.seen.drive.commanded
        while len(found) < MOST_LAWS:
            represented = self._represented(acting, found)
            found = self._with_more(represented, acting, found)
            if self._static_suffices(represented, acting, found):
                # the next families are compared with this map
                self._take(replace(self.static, splined=True))
                continue
            falling = self._falling(represented, acting, found)
            laws = self._laws(falling, acting, found)
            if self._outgrown(falling, laws, acting, found):
                found, acting = [], self.seen.drive.commanded
                continue
            step = self._step(falling, laws, acting, found) if falling else None
            if step is None:
                break
            found.append(step)
            acting = step.fitted.acting
        noise = float(np.sqrt(self.floor / self.static.targets.size))
        if not found:
            return Memory(learned_in=self.unknown, noise_mm=noise, notes=tuple(self.notes))
        return self._memory(found, noise)

    # --- one family ------------------------------------------------------------------------------

    def _represented(self, acting: Floats, found: Sequence[_Found]) -> list[_Represented]:
        """Return the families that this log can show, lowest held-out loss first."""
        possible = [
            family
            for family in self.families
            if not (family.fast and self.seen.slow or family.timed and self.seen.timeless)
            and not (family.static and (self.static.splined or self.static.basis.intervals))
        ]
        every = (
            _Represented(f, self.static.losses(acting, self._signals_alongside(f, found)))
            for f in possible
        )
        return sorted(every, key=lambda one: float(one.losses.sum()))

    def _static_suffices(
        self, represented: Sequence[_Represented], acting: Floats, found: Sequence[_Found]
    ) -> bool:
        """Whether a map of another form fits as well as any memory."""
        now, best = self.static.losses(acting), represented[0].losses
        if not self._falls(now, best, LATER if found else FIRST):
            return False
        return any(one.family.static and self._near(one.losses, best, now) for one in represented)

    def _with_more(
        self, represented: Sequence[_Represented], acting: Floats, found: Sequence[_Found]
    ) -> list[_Found]:
        """Return the result; mark its last law if its family explains much of the remainder."""
        if not found:
            return []
        now, last = self.static.losses(acting), found[-1]
        own = [one for one in represented if one.family.name == last.family.name]
        return [
            *found[:-1],
            replace(last, more=last.more or any(self._falls(now, one.losses, SURE) for one in own)),
        ]

    def _falling(
        self, represented: Sequence[_Represented], acting: Floats, found: Sequence[_Found]
    ) -> list[_Represented]:
        """Return the families that lower the loss; none if the best of all does not."""
        now, share = self.static.losses(acting), LATER if found else FIRST
        if not self._falls(now, represented[0].losses, share):
            return []
        return [
            one
            for one in represented
            if self._falls(now, one.losses, share) and not one.family.static
        ]

    def _laws(
        self, falling: Sequence[_Represented], acting: Floats, found: Sequence[_Found]
    ) -> list[_Candidate]:
        """Return the laws of these families that lower the loss as well, lowest first."""
        now, share = self.static.losses(acting), LATER if found else FIRST
        good = [
            one for one in self._candidates(falling, found) if self._falls(now, one.losses, share)
        ]
        return sorted(good, key=lambda one: float(one.losses.sum()))

    def _outgrown(
        self,
        falling: Sequence[_Represented],
        laws: Sequence[_Candidate],
        acting: Floats,
        found: Sequence[_Found],
    ) -> bool:
        """Replace the static map if another form lowers the loss of the best family or law.

        As long as the memory is missing, its error hides that of the form of the map. A wrong law
        then fits best if it bends the map as well.
        """
        beside: list[tuple[Floats, Floats, Floats | None]] = [
            (acting, one.losses, self._signals_alongside(one.family, found)) for one in falling[:1]
        ]
        beside += [(one.law.acting, one.losses, None) for one in laws[:1]]
        for commands, losses, signals in beside:
            taken: StaticMap | None = None
            for form in self.richer:
                lower = form.losses(commands, signals)
                if float((losses - lower).sum()) > standard_error(losses - lower):
                    losses, taken = lower, form
            if taken is not None:
                self.richer = self.richer[self.richer.index(taken) + 1 :]
                self._take(taken.tuned(commands))
                return True
        return False

    def _take(self, static: StaticMap) -> None:
        """Compare the next families and laws with another static map."""
        self.static = static
        self.fit = LawFit(self.fit.drive, static, self.fit.seed, self.fit.unit)

    def _step(
        self,
        falling: Sequence[_Represented],
        good: Sequence[_Candidate],
        acting: Floats,
        found: Sequence[_Found],
    ) -> _Found | None:
        """Return the law to add to the chain, or None."""
        now, best = self.static.losses(acting), falling[0]
        near = [one for one in falling if self._near(one.losses, best.losses, now)]
        if not good:
            self._only_seen(near, now, False)
            return None
        step = self._chosen(near, good, now, best.losses)
        elsewhere = self.members is not None and step.family.name not in self.members
        part = float((now - step.fitted.losses).sum()) < PART * float((now - best.losses).sum())
        lawless = any(not one.family.members for one in near)
        stands_in = step.certainty == "open" and (part or step.weak or lawless)
        if elsewhere or stands_in:
            self._only_seen(near, now, elsewhere)
            return None
        if why := self._unconfirmed(step, found, now):
            self.notes.append(
                f"{' and '.join(step.names)} lowers the held-out error from {self._rms(now):.2f} "
                f"to {self._rms(step.fitted.losses):.2f} mm RMS, but {why}; this is no proof of a "
                "memory, so the law is not in the model"
            )
            return None
        return step

    def _unconfirmed(self, step: _Found, found: Sequence[_Found], now: Floats) -> str:
        """Return why the fall of the loss by new laws may be chance or a bad map, or ''."""
        refitted = self.fit.refitted_losses(step.fitted)
        if not self._falls(now, refitted, LATER if found else FIRST):
            return f"with numbers from the other blocks only to {self._rms(refitted):.2f} mm"
        backward = self._backward(step, found)
        lost, fall = backward - step.fitted.losses, float((now - step.fitted.losses).sum())
        if float(lost.sum()) < max(PAST * fall, standard_error(lost)):
            return f"with the run read backward to {self._rms(backward):.2f} mm as well"
        return ""

    def _backward(self, step: _Found, found: Sequence[_Found]) -> Floats:
        """Return the held-out loss (folds,) of the new laws that read the run backward.

        A memory depends on the past alone. A law that fits as well on the future only bends the
        static map.
        """
        records = [
            replace(
                record,
                u=self._effective(record, found[-1].fitted) if found else record.u,
                backward=True,
            )
            for record in self.seen.drive.records
        ]
        there = [name for one in found for name in one.names]
        names = [name for name in step.names if name not in there]
        fit = LawFit(Drive(*records), self.static, self.fit.seed, self.fit.unit)
        scanned = fit.scanned(law(names, fit.drive), {})
        own = law(names, fit.drive, [n for n in self._apart(step.fitted) if n in names])
        starts = np.stack([own.at(scanned.numbers), own.at(step.fitted.numbers)])
        refined = fit.refined(own, starts)
        return min(scanned.losses, refined.losses, key=lambda losses: float(losses.sum()))

    @staticmethod
    def _effective(record: Record, fitted: FittedLaw) -> Floats:
        """Return the effective commands (T, C) of a run after the laws that were found."""
        return np.asarray(record.rolled(fitted.law.chain, fitted.law.params(fitted.x)[None])[0])

    def _candidates(
        self, falling: Sequence[_Represented], found: Sequence[_Found]
    ) -> list[_Candidate]:
        """Return the fitted laws of all families that fall, with the laws found before.

        The signals of one channel at a time may explain less than a law behind a map of many
        channels. So the members of all families that fall are fitted, not only those of the
        nearest.
        """
        there = [name for one in found for name in one.names]
        alike = [
            _Candidate(one.family, member, fit.losses, fit)
            for one in falling
            for member in one.family.members
            if member not in there
            for fit in [self._law([*there, member], found)]
        ]
        alike.sort(key=lambda one: float(one.losses.sum()))
        laws = [self._each(one) if i < EACH_TRIED else one for i, one in enumerate(alike)]
        best = min(laws, key=lambda one: float(one.losses.sum()), default=None)
        if best is None or not self._apart(best.law):
            return laws
        # Compare a law with a number per channel with others of the same kind.
        return [
            self._each(one, asked=False) if one.family.name == best.family.name else one
            for one in laws
        ]

    def _chosen(
        self,
        near: Sequence[_Represented],
        good: Sequence[_Candidate],
        now: Floats,
        represented: Floats,
    ) -> _Found:
        """Choose among laws that lower the loss: equals of the best, fewest numbers first."""
        lowest = min(
            [*(one.losses for one in good), represented], key=lambda losses: float(losses.sum())
        )
        reach = [one for one in good if self._near(one.losses, lowest, now)]
        best = min(
            reach or good, key=lambda one: (one.numbers if reach else 0, float(one.losses.sum()))
        )
        fitted, second, more = self._paired(best)
        others = reach or sorted(good, key=lambda one: float(one.losses.sum()))[: 1 + SHORT]
        alternatives = [one for one in others if one.name not in (best.name, second)]
        lawless = [
            one for one in near if not one.family.members and self._near(one.losses, lowest, now)
        ]
        alternatives += [_Candidate(one.family, "", one.losses) for one in lawless]
        weak = not self._falls(now, fitted.losses, SURE)
        names = tuple(filter(None, (best.name, second)))
        return _Found(
            best.family,
            names,
            fitted,
            now,
            tuple(alternatives),
            short=not reach,
            weak=weak,
            more=more,
        )

    def _law(self, names: Sequence[str], found: Sequence[_Found]) -> FittedLaw:
        if not found:
            return self.fit.scanned(law(names, self.seen.drive), {})
        last = found[-1].fitted
        return self.fit.scanned(law(names, self.seen.drive, self._apart(last)), last.numbers)

    def _paired(self, one: _Candidate) -> tuple[FittedLaw, str, bool]:
        """Return the law with a second member of its family if that explains the remainder.

        The pair must explain nearly all of the first law's remainder. The last value is whether a
        second member explains a good part of it, so the form of the law alone is not right.
        """
        fitted = one.law
        left = float(fitted.losses.sum()) - self.frames * self.floor
        best, second, more = fitted, "", False
        for member in one.family.members:
            if member in fitted.law.names:
                continue
            both = self.fit.scanned(
                law([*fitted.law.names, member], self.seen.drive, self._apart(fitted)),
                fitted.numbers,
            )
            fall = float((fitted.losses - both.losses).sum())
            more = more or self._falls(fitted.losses, both.losses, SURE)
            if (
                fall > PAIR * left
                and self._falls(fitted.losses, both.losses, LATER)
                and both.losses.sum() < best.losses.sum()
            ):
                best, second = both, member
        return best, second, more and not second

    @staticmethod
    def _apart(fitted: FittedLaw) -> list[str]:
        """Return the effects that have a number per channel in a law."""
        return sorted({label.split(".")[0] for label in fitted.law.labels if "[" in label})

    def _each(self, candidate: _Candidate, asked: bool = True) -> _Candidate:
        """Return a law with a number per channel of its newest effect, if the evidence requires it.

        Without `asked`, a lower loss is sufficient.
        """
        fitted, name = candidate.law, candidate.name
        other = law(fitted.law.names, self.seen.drive, [*self._apart(fitted), name])
        if len(other.labels) == len(fitted.law.labels):
            return candidate  # one channel, or an effect whose numbers belong to the robot
        start = other.at(fitted.numbers)
        starts = [start]
        for i, label in enumerate(other.labels):
            if label.startswith(f"{name}.") and "[" in label:
                starts.append(self.fit.scanned_along(other, starts[-1], i))
        better = self.fit.refined(other, np.stack([start, starts[-1]]))
        fall = fitted.losses - better.losses
        enough = fall.sum() > (
            max(standard_error(fall), EACH * float(fitted.losses.sum())) if asked else 0.0
        )
        most = not asked or (better.losses < fitted.losses).mean() >= MOST_FOLDS
        return (
            _Candidate(candidate.family, name, better.losses, better)
            if enough and most
            else candidate
        )

    # --- evidence --------------------------------------------------------------------------------

    def _signals_alongside(self, family: Family, found: Sequence[_Found]) -> Floats:
        """Return a family's columns (n, J): signals about effective commands, and powers."""
        parts = []
        middle, half = self.seen.drive.middle, self.seen.drive.half
        powers = POWERS if self.seen.drive.channels <= FEW_CHANNELS and not family.static else 1
        for record in self.seen.drive.records:
            u = record.u if not found else self._effective(record, found[-1].fitted)
            z = family.signals(record, u, middle, half)
            parts.append(np.concatenate([z**power for power in range(1, powers + 1)], axis=1))
        return np.concatenate(parts)

    def _falls(self, before: Floats, after: Floats, share: float) -> bool:
        """Whether a loss falls clearly, in most folds, by enough of it, and visibly."""
        fall, above = before - after, float(before.sum()) - self.frames * self.floor
        enough = max(LEAST * float(before.sum()), share * max(above, 0.0), standard_error(fall))
        markers = self.seen.markers.shape[1]
        moved = np.sqrt(
            max(float(fall.sum()), 0.0) / (self.frames * len(self.static.targets) * markers)
        )
        length = float(np.linalg.norm(self.seen.markers, axis=2).mean(axis=0).max())
        most = float((fall > FALL * before).mean()) >= MOST_FOLDS
        return float(fall.sum()) > enough and most and moved > VISIBLE * length

    @staticmethod
    def _near(one: Floats, best: Floats, before: Floats) -> bool:
        """Whether a held-out loss equals the best, within its error and form tolerance."""
        behind = one - best
        if behind.sum() <= FORM * float((before - best).sum()):
            return True
        decided = len(behind) >= FOLDS_THAT_AGREE and float((behind > 0).mean()) >= AGREE
        return float(behind.sum()) <= standard_error(behind) and not decided

    def _noise(self) -> float:
        """Return the variance of a target, mm², from its third differences between frames.

        It is the part that no map can explain.
        """
        residual = self.static.residual(self.seen.drive.commanded)
        if len(residual) < 8:
            return 0.0
        square = (np.diff(residual, n=3, axis=0) ** 2).mean(axis=1)
        # 1 + 9 + 9 + 1; corners at reversals are few, so the median
        return float(np.median(square)) / 20.0

    # --- report -----------------------------------------------------------------------------------

    def _rms(self, losses: Floats) -> float:
        return float(
            np.sqrt(
                losses.sum() / (self.frames * len(self.static.targets) * self.seen.markers.shape[1])
            )
        )

    def _only_seen(self, near: Sequence[_Represented], now: Floats, forbidden: bool) -> None:
        """Report families that the run shows, but whose law does not join the chain."""
        names, after = " or ".join(one.family.name for one in near), self._rms(near[0].losses)
        drifts = any(one.family.name == DRIFT for one in near)  # possibly of the camera
        if not forbidden and not drifts and self._falls(now, near[0].losses, SURE):
            first, *others = (
                Alternative("", one.family.name, self._rms(one.losses)) for one in near
            )
            self.unknown = (
                LearnedIn("", first.family, "unknown", self._rms(now), after, (), tuple(others)),
            )
            return
        why = (
            "is left to the diagnosis" if forbidden else "has no law in the library that reaches it"
        )
        self.notes.append(
            f"the run shows {names} besides the static map (held-out error {self._rms(now):.2f} "
            f"to {after:.2f} mm RMS), which {why}: it is not in the model"
        )

    def _memory(self, found: Sequence[_Found], noise: float) -> Memory:
        last = found[-1].fitted
        numbers = self.fit.fitted_numbers(last)
        unexplained, above = (
            float(losses.sum()) - self.frames * self.floor
            for losses in (last.losses, found[0].before)
        )
        records = []
        for one in (replace(one, rest=unexplained > SURE * above) for one in found):
            others = tuple(
                Alternative(o.name, o.family.name, self._rms(o.losses)) for o in one.alternatives
            )
            before, after = self._rms(one.before), self._rms(one.fitted.losses)
            for name in one.names:
                twins = tuple(Alternative(twin, one.family.name, after) for twin in _twins(name))
                params = tuple(
                    number for label, number in numbers.items() if label.startswith(f"{name}.")
                )
                records.append(
                    LearnedIn(
                        name,
                        one.family.name,
                        one.certainty,
                        before,
                        after,
                        params,
                        (*others, *twins),
                    )
                )
        return Memory(
            last.law.names, last.params, (*records, *self.unknown), noise, tuple(self.notes)
        )


def _numbers(fitted: FittedLaw) -> int:
    """Return how many numbers a law has; those for each channel count as one."""
    return len({label.partition("[")[0] for label in fitted.law.labels})


def _twins(name: str) -> list[str]:
    """Return the effects that no run can distinguish from the effect `name`."""
    return [info.name for info in registry().values() if info.alike.get(name) == "never"]


def refined_memory(memory: Memory, seen: ReferenceFrames, static: StaticMap, seed: int) -> Memory:
    """Refit the numbers of the memory with another map of the same targets."""
    if not memory.names:
        return memory
    each = sorted(
        {label.split(".")[0] for one in memory.learned_in for label in _labels(one) if "[" in label}
    )
    again, fit = law(memory.names, seen.drive, each), LawFit(seen.drive, static, seed, seen.unit)
    fitted = fit.refined(again, again.at(memory.params)[None])
    numbers = fit.fitted_numbers(fitted)
    records = tuple(
        replace(one, params=tuple(numbers[label] for label in _labels(one) if label in numbers))
        for one in memory.learned_in
    )
    return replace(memory, params=fitted.params, learned_in=records)


def _labels(record: LearnedIn) -> list[str]:
    return [number.label for number in record.params]
