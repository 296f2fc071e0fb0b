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
all laws leave a good part of the first loss: a bad map and a wrong law look alike. A law that does
not reach, or that is at a bound, is only reported if it is weak, if it explains only part of its
family's fall, or if a family without laws is near: it would only replace another cause. The same
holds for a law whose numbers from some blocks do not lower the loss of the others, and for one that
fits nearly as well if it reads the run backward: a memory depends on the past alone, and such a law
only bends the static map. The law joins the chain, its effective commands replace the commands, and
the families are tried again. A law that is not identified may stand in for two, so two laws of
different families are fitted together as well, and join if they explain far more.

Several runs: each run whose commands the others cover is also held out as a block. This separates
families with the same loop at one amplitude and speed. Limits: laws act in series with the map; a
rate alone has no law in the library. Pinned by tests/rod/test_learned_memory.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from softmap_edge.model.learned_in import Alternative, LearnedIn
from softmap_edge.rod.evidence import FIRST, LATER, MOST_FOLDS, Evidence
from softmap_edge.rod.found_law import (
    Candidate,
    FoundLaw,
    Represented,
    count_numbers,
    in_place_of,
    twins,
)
from softmap_edge.rod.law import FittedLaw, LawFit, law
from softmap_edge.rod.reference_run import ReferenceFrames
from softmap_edge.rod.regression import Drive, Record, standard_error
from softmap_edge.rod.signals import DRIFT, Family, families
from softmap_edge.rod.static_map import StaticMap

Floats = NDArray[np.float64]

FRAMES = 1500  # frames of a search; neighbouring frames are redundant
FEW_CHANNELS = 3  # most channels for powers of signals; with more there are too few frames
POWERS = 3
# Shares of the loss above the noise: least explained by an identified or unknown law, most left to
# its family or to a second law of it; most left in total, as in a diagnosis (decision.py).
SURE, LEFT = 0.2, 0.1
# of the best family's fall: a law that does not reach must explain more, or it replaces another
PART = 0.6
# of a law's remainder above the noise: a second law of its family with less is model-form error
PAIR = 0.8
EACH = 0.05  # of the loss: least gain from a number per channel over a shared one
EACH_TRIED = 3  # best laws with shared numbers that are tried with a number per channel
MOST_LAWS = 3
SHORT = 2  # nearest effects that are named if none reaches
# of a law's fall: least part that is lost if it reads the run backward. True laws lose 0.44 or
# more, laws that stand in for the form of a static map 0.15.
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
        self.evidence = Evidence.of(seen, static)  # its noise hardly depends on the map
        self.notes: list[str] = []
        self.unknown: tuple[LearnedIn, ...] = ()

    def run(self) -> Memory:
        found: list[FoundLaw] = []
        acting = self.seen.drive.commanded
        while len(found) < MOST_LAWS:
            now, represented = self.static.losses(acting), self._represented(acting, found)
            if self._static_suffices(represented, now, found):
                # the next families are compared with this map
                self._take(replace(self.static, splined=True))
                continue
            falling = self._falling(represented, now, found)
            laws = self._laws(falling, now, found)
            if self._outgrown(falling, laws, acting, found):
                found, acting = [], self.seen.drive.commanded
                continue
            steps = self._steps(falling, laws, now, found) if falling else []
            if not steps:
                break
            found += steps
            acting = found[-1].fitted.acting
        noise = self.evidence.noise_mm
        if not found:
            return Memory(learned_in=self.unknown, noise_mm=noise, notes=tuple(self.notes))
        return self._memory(found, noise)

    # --- one family ------------------------------------------------------------------------------

    def _represented(self, acting: Floats, found: Sequence[FoundLaw]) -> list[Represented]:
        """Return the families that this log can show, lowest held-out loss first."""
        possible = [
            family
            for family in self.families
            if not (family.fast and self.seen.slow or family.timed and self.seen.timeless)
            and not (family.static and (self.static.splined or self.static.basis.intervals))
        ]
        every = (
            Represented(f, self.static.losses(acting, self._signals_alongside(f, found)))
            for f in possible
        )
        return sorted(every, key=lambda one: float(one.losses.sum()))

    def _static_suffices(
        self, represented: Sequence[Represented], now: Floats, found: Sequence[FoundLaw]
    ) -> bool:
        """Whether a map of another form fits as well as any memory."""
        best = represented[0].losses
        if not self.evidence.falls(now, best, LATER if found else FIRST):
            return False
        return any(
            one.family.static and self.evidence.near(one.losses, best, now) for one in represented
        )

    def _falling(
        self, represented: Sequence[Represented], now: Floats, found: Sequence[FoundLaw]
    ) -> list[Represented]:
        """Return the families that lower the loss; none if the best of all does not."""
        share = LATER if found else FIRST
        if not self.evidence.falls(now, represented[0].losses, share):
            return []
        return [
            one
            for one in represented
            if self.evidence.falls(now, one.losses, share) and not one.family.static
        ]

    def _laws(
        self, falling: Sequence[Represented], now: Floats, found: Sequence[FoundLaw]
    ) -> list[Candidate]:
        """Return the laws of these families that lower the loss as well, lowest first."""
        share = LATER if found else FIRST
        good = [
            one
            for one in self._candidates(falling, found)
            if self.evidence.falls(now, one.losses, share)
        ]
        return sorted(good, key=lambda one: float(one.losses.sum()))

    def _outgrown(
        self,
        falling: Sequence[Represented],
        laws: Sequence[Candidate],
        acting: Floats,
        found: Sequence[FoundLaw],
    ) -> bool:
        """Replace the static map if another form lowers the loss of the best family or law.

        As long as the memory is missing, its error hides that of the form of the map. A wrong law
        then fits best if it bends the map as well.
        """
        trials: list[tuple[Floats, Floats, Floats | None]] = [
            (acting, one.losses, self._signals_alongside(one.family, found)) for one in falling[:1]
        ]
        trials += [(one.law.acting, one.losses, None) for one in laws[:1]]
        for commands, losses, signals in trials:
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

    def _steps(
        self,
        falling: Sequence[Represented],
        good: Sequence[Candidate],
        now: Floats,
        found: Sequence[FoundLaw],
    ) -> list[FoundLaw]:
        """Return the law to add to the chain, or two that only together explain the loss."""
        best = falling[0]
        near = [one for one in falling if self.evidence.near(one.losses, best.losses, now)]
        if not good:
            self._only_seen(near, now, False)
            return []
        step = self._chosen(near, good, now, best.losses)
        step = replace(step, more=step.more or self._explains_more(step))
        if step.certainty != "identified" and (two := self._together(step, good, now, found)):
            return two
        elsewhere = self.members is not None and step.family.name not in self.members
        part = float((now - step.fitted.losses).sum()) < PART * float((now - best.losses).sum())
        lawless = any(not one.family.members for one in near)
        stands_in = step.certainty == "open" and (part or step.weak or lawless)
        if elsewhere or stands_in:
            self._only_seen(near, now, elsewhere)
            return []
        if why := self._unconfirmed(step, found, now):
            before, after = self.evidence.rms(now), self.evidence.rms(step.fitted.losses)
            self.notes.append(
                f"{' and '.join(step.names)} lowers the held-out error from {before:.2f} "
                f"to {after:.2f} mm RMS, but {why}; this is no proof of a "
                "memory, so the law is not in the model"
            )
            return []
        return [step]

    def _explains_more(self, one: FoundLaw) -> bool:
        """Whether the signals of a law's family, on top of it, lower the remainder clearly."""
        signals = self._signals_alongside(one.family, [one])
        left = one.fitted.losses
        return self.evidence.falls(left, self.static.losses(one.fitted.acting, signals), SURE)

    def _together(
        self,
        alone: FoundLaw,
        good: Sequence[Candidate],
        now: Floats,
        found: Sequence[FoundLaw],
    ) -> list[FoundLaw]:
        """Return two laws of different families if they explain far more than one law alone.

        One law after the other may fail: the first one found may stand in for both.
        """
        if self.members is not None or len(found) + 2 > MOST_LAWS:
            return []
        pairs = [
            (one, other, self._law([*one.law.law.names, other.name], found, one.law))
            for one, other in combinations(good, 2)
            if one.family.name != other.family.name
        ]
        if not pairs:
            return []
        pairs.sort(key=lambda pair: float(pair[2].losses.sum()))
        pairs = [
            (one, other, self._each_of(one, other, both) if i < EACH_TRIED else both)
            for i, (one, other, both) in enumerate(pairs)
        ]
        lowest = min((both.losses for *_, both in pairs), key=lambda losses: float(losses.sum()))
        reach = [pair for pair in pairs if self.evidence.near(pair[2].losses, lowest, now)]
        one, other, both = min(
            reach, key=lambda pair: (count_numbers(pair[2]), float(pair[2].losses.sum()))
        )
        if not self.evidence.falls(alone.fitted.losses, both.losses, LATER):
            return []
        first, second = (
            FoundLaw(
                mine.family,
                (mine.name,),
                fitted,
                before,
                tuple(in_place_of(mine, reach).values()),
                short=False,
                weak=not self.evidence.falls(before, both.losses, SURE),
            )
            for mine, fitted, before in ((one, one.law, now), (other, both, one.losses))
        )
        joint = replace(second, names=(one.name, other.name), before=now)
        confirmed = not self._unconfirmed(joint, found, now) and not self._unconfirmed(
            second, [*found, first], one.losses
        )
        return [first, second] if confirmed else []

    def _each_of(self, one: Candidate, other: Candidate, both: FittedLaw) -> FittedLaw:
        """Return a law of two effects with a number per channel of each, if that is evident."""
        for candidate in (one, other):
            both = self._each(Candidate(candidate.family, candidate.name, both.losses, both)).law
        return both

    def _unconfirmed(self, step: FoundLaw, found: Sequence[FoundLaw], now: Floats) -> str:
        """Return why the fall of the loss by new laws may be chance or a bad map, or ''."""
        refitted = self.fit.refitted_losses(step.fitted)
        if not self.evidence.falls(now, refitted, LATER if found else FIRST):
            return (
                f"with numbers from the other blocks only to {self.evidence.rms(refitted):.2f} mm"
            )
        backward = self._backward(step, found)
        lost, fall = backward - step.fitted.losses, float((now - step.fitted.losses).sum())
        if float(lost.sum()) < max(PAST * fall, standard_error(lost)):
            return f"with the run read backward to {self.evidence.rms(backward):.2f} mm as well"
        return ""

    def _backward(self, step: FoundLaw, found: Sequence[FoundLaw]) -> Floats:
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
        self, falling: Sequence[Represented], found: Sequence[FoundLaw]
    ) -> list[Candidate]:
        """Return the fitted laws of all families that fall, with the laws found before.

        The signals of one channel at a time may explain less than a law behind a map of many
        channels. So the members of all families that fall are fitted, not only those of the
        nearest.
        """
        there = [name for one in found for name in one.names]
        alike = [
            Candidate(one.family, member, fit.losses, fit)
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
        near: Sequence[Represented],
        good: Sequence[Candidate],
        now: Floats,
        represented: Floats,
    ) -> FoundLaw:
        """Choose among laws that lower the loss: equals of the best, fewest numbers first."""
        lowest = min(
            [*(one.losses for one in good), represented], key=lambda losses: float(losses.sum())
        )
        reach = [one for one in good if self.evidence.near(one.losses, lowest, now)]
        best = min(
            reach or good, key=lambda one: (one.numbers if reach else 0, float(one.losses.sum()))
        )
        fitted, second, more = self._paired(best)
        others = reach or sorted(good, key=lambda one: float(one.losses.sum()))[: 1 + SHORT]
        alternatives = [one for one in others if one.name not in (best.name, second)]
        lawless = [
            one
            for one in near
            if not one.family.members and self.evidence.near(one.losses, lowest, now)
        ]
        alternatives += [Candidate(one.family, "", one.losses) for one in lawless]
        weak = not self.evidence.falls(now, fitted.losses, SURE)
        names = tuple(filter(None, (best.name, second)))
        return FoundLaw(
            best.family,
            names,
            fitted,
            now,
            tuple(alternatives),
            short=not reach,
            weak=weak,
            more=more,
        )

    def _law(
        self, names: Sequence[str], found: Sequence[FoundLaw], start: FittedLaw | None = None
    ) -> FittedLaw:
        """Fit a chain from the numbers of `start`, or of the laws found before."""
        if not found and start is None:
            return self.fit.scanned(law(names, self.seen.drive), {})
        last = start or found[-1].fitted
        return self.fit.scanned(law(names, self.seen.drive, self._apart(last)), last.numbers)

    def _paired(self, one: Candidate) -> tuple[FittedLaw, str, bool]:
        """Return the law with a second member of its family if that explains the remainder.

        The pair must explain nearly all of the first law's remainder. The last value is whether a
        second member explains a good part of it, so the form of the law alone is not right.
        """
        fitted = one.law
        left = self.evidence.above(fitted.losses)
        best, second, more = fitted, "", False
        for member in one.family.members:
            if member in fitted.law.names:
                continue
            both = self.fit.scanned(
                law([*fitted.law.names, member], self.seen.drive, self._apart(fitted)),
                fitted.numbers,
            )
            fall = float((fitted.losses - both.losses).sum())
            more = more or self.evidence.falls(fitted.losses, both.losses, SURE)
            if (
                fall > PAIR * left
                and self.evidence.falls(fitted.losses, both.losses, LATER)
                and both.losses.sum() < best.losses.sum()
            ):
                best, second = both, member
        return best, second, more and not second

    @staticmethod
    def _apart(fitted: FittedLaw) -> list[str]:
        """Return the effects that have a number per channel in a law."""
        return sorted({label.split(".")[0] for label in fitted.law.labels if "[" in label})

    def _each(self, candidate: Candidate, asked: bool = True) -> Candidate:
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
            Candidate(candidate.family, name, better.losses, better)
            if enough and most
            else candidate
        )

    # --- evidence --------------------------------------------------------------------------------

    def _signals_alongside(self, family: Family, found: Sequence[FoundLaw]) -> Floats:
        """Return a family's columns (n, J): signals about effective commands, and powers."""
        parts = []
        middle, half = self.seen.drive.middle, self.seen.drive.half
        powers = POWERS if self.seen.drive.channels <= FEW_CHANNELS and not family.static else 1
        for record in self.seen.drive.records:
            u = record.u if not found else self._effective(record, found[-1].fitted)
            z = family.signals(record, u, middle, half)
            parts.append(np.concatenate([z**power for power in range(1, powers + 1)], axis=1))
        return np.concatenate(parts)

    # --- report -----------------------------------------------------------------------------------

    def _only_seen(self, near: Sequence[Represented], now: Floats, forbidden: bool) -> None:
        """Report families that the run shows, but whose law does not join the chain."""
        names = " or ".join(one.family.name for one in near)
        before, after = self.evidence.rms(now), self.evidence.rms(near[0].losses)
        drifts = any(one.family.name == DRIFT for one in near)  # possibly of the camera
        if not forbidden and not drifts and self.evidence.falls(now, near[0].losses, SURE):
            first, *others = (
                Alternative("", one.family.name, self.evidence.rms(one.losses)) for one in near
            )
            self.unknown = (
                LearnedIn("", first.family, "unknown", before, after, (), tuple(others)),
            )
            return
        why = (
            "is left to the diagnosis" if forbidden else "has no law in the library that reaches it"
        )
        self.notes.append(
            f"the run shows {names} besides the static map (held-out error {before:.2f} "
            f"to {after:.2f} mm RMS), which {why}: it is not in the model"
        )

    def _memory(self, found: Sequence[FoundLaw], noise: float) -> Memory:
        last = found[-1].fitted
        numbers = self.fit.fitted_numbers(last)
        unexplained, above = (
            self.evidence.above(losses) for losses in (last.losses, found[0].before)
        )
        records = []
        for one in (replace(one, rest=unexplained > LEFT * above) for one in found):
            others = tuple(
                Alternative(o.name, o.family.name, self.evidence.rms(o.losses))
                for o in one.alternatives
            )
            before, after = self.evidence.rms(one.before), self.evidence.rms(one.fitted.losses)
            for name in one.names:
                alike = tuple(Alternative(twin, one.family.name, after) for twin in twins(name))
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
                        (*others, *alike),
                    )
                )
        return Memory(
            last.law.names, last.params, (*records, *self.unknown), noise, tuple(self.notes)
        )


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
