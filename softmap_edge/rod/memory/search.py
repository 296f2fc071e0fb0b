"""Search for the memory of a robot together with its static map.

Level 1 (`families.py`) finds the families that lower the held-out loss. Level 2 (`laws.py`) fits
their members with the static map solved again. A law *reaches* if it fits as well as the best of
all, families included. Of the laws that reach, the one with the fewest numbers is chosen; the
others are its alternatives. Numbers for each channel count as one.

A law is open if its family, or a second law of it, explains much of the remaining loss. It is also
open if all laws leave much of the first loss. A bad map and a wrong law then look alike. An open
law would replace another cause in three cases, and is then only reported. It is weak; it explains
only part of its family's fall; or a family without laws is near. A law that is not confirmed
(`confirm.py`) is only reported as well.

The law joins the chain, its effective commands replace the commands, and the families are tried
again. A law that is not identified may stand in for two, so `pairs.py` tries two together.

Several runs: each run whose commands the others cover is also held out as a block. This separates
families with the same loop at one amplitude and speed. Limits: laws act in series with the map; a
rate alone has no law in the library. Pinned by tests/rod/test_learned_memory.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.model.learned_in import LearnedIn
from softmap_edge.rod.memory import confirm
from softmap_edge.rod.memory.evidence import SURE
from softmap_edge.rod.memory.families import (
    explains_more,
    falling_families,
    family_signals,
    shown_families,
    static_suffices,
)
from softmap_edge.rod.memory.laws import falling_effects, with_second
from softmap_edge.rod.memory.memory import Memory
from softmap_edge.rod.memory.pairs import steps_together
from softmap_edge.rod.memory.progress import Progress, SearchData
from softmap_edge.rod.memory.record import memory_of, not_confirmed, only_seen, unknown_law
from softmap_edge.rod.memory.step import FittedEffect, FittedFamily, Step, count_numbers
from softmap_edge.rod.reference_run import ReferenceFrames
from softmap_edge.rod.regression import standard_error
from softmap_edge.rod.signals import DRIFT
from softmap_edge.rod.static_map import StaticMap

Floats = NDArray[np.float64]

FRAMES = 1500  # frames of a search; neighbouring frames are redundant
# of the best family's fall: a law that does not reach must explain more
PART = 0.6
MOST_STEPS = 3
SHORT = 2  # nearest effects that are named if none reaches


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
    return _Search(SearchData.of(seen, static, seed), members, richer).run()


class _Search:
    """A search: its data, the forms of the map to try, and what it reports besides the steps."""

    def __init__(
        self, data: SearchData, members: Sequence[str] | None, richer: Sequence[StaticMap]
    ) -> None:
        self.data, self.members, self.richer = data, members, tuple(richer)
        self.notes: list[str] = []
        self.unknown: tuple[LearnedIn, ...] = ()

    def run(self) -> Memory:
        """Add steps until no family lowers the loss, or none of its laws may join."""
        steps: tuple[Step, ...] = ()
        while len(steps) < MOST_STEPS:
            progress = Progress.after(self.data, steps)
            shown = shown_families(progress)
            if static_suffices(progress, shown):
                # the next families are compared with this map
                self.data = self.data.with_map(replace(self.data.static, splined=True))
                continue
            falling = falling_families(progress, shown)
            good = falling_effects(progress, falling)
            if (form := self._better_map(progress, falling, good)) is not None:
                self.data, steps = self.data.with_map(form), ()
                continue
            added = self._added(progress, falling, good) if falling else ()
            if not added:
                break
            steps += added
        return memory_of(self.data, steps, self.unknown, self.notes)

    def _better_map(
        self, progress: Progress, falling: Sequence[FittedFamily], good: Sequence[FittedEffect]
    ) -> StaticMap | None:
        """Return a form of the map that lowers the loss of the best family or law, or None.

        As long as the memory is missing, its error hides that of the form of the map. A wrong law
        then fits best if it bends the map as well.
        """
        seen, acting = self.data.seen, progress.acting
        trials: list[tuple[Floats, Floats, Floats | None]] = [
            (acting, one.losses, family_signals(seen, one.family, progress.last))
            for one in falling[:1]
        ]
        trials += [(one.fitted.acting, one.losses, None) for one in good[:1]]
        for commands, losses, signals in trials:
            taken: StaticMap | None = None
            for form in self.richer:
                lower = form.losses(commands, signals)
                if float((losses - lower).sum()) > standard_error(losses - lower):
                    losses, taken = lower, form
            if taken is not None:
                self.richer = self.richer[self.richer.index(taken) + 1 :]
                return taken.tuned(commands)
        return None

    def _added(
        self, progress: Progress, falling: Sequence[FittedFamily], good: Sequence[FittedEffect]
    ) -> tuple[Step, ...]:
        """Return the step to add, two that only together explain the loss, or none."""
        best = falling[0]
        near = [one for one in falling if progress.near(one.losses, best.losses)]
        if not good:
            self._report(progress, near, forbidden=False)
            return ()
        step = _chosen(progress, near, good, best.losses)
        step = replace(step, more=step.more or explains_more(self.data, step))
        uncertain = step.certainty != "identified"
        room = self.members is None and len(progress.steps) + 2 <= MOST_STEPS
        if uncertain and room and (two := steps_together(progress, step, good)):
            return two
        forbidden = self.members is not None and step.family.name not in self.members
        fall = float((progress.losses - step.fitted.losses).sum())
        part = fall < PART * float((progress.losses - best.losses).sum())
        lawless = any(not one.family.members for one in near)
        stands_in = step.certainty == "open" and (part or step.weak or lawless)
        if forbidden or stands_in:
            self._report(progress, near, forbidden)
            return ()
        if why := confirm.unconfirmed(progress, step):
            self.notes.append(not_confirmed(progress, step, why))
            return ()
        return (step,)

    def _report(self, progress: Progress, near: Sequence[FittedFamily], forbidden: bool) -> None:
        """Report families that the run shows, but whose law does not join the chain."""
        drifts = any(one.family.name == DRIFT for one in near)  # possibly of the camera
        sure = self.data.evidence.falls(progress.losses, near[0].losses, SURE)
        if not forbidden and not drifts and sure:
            self.unknown = (unknown_law(progress, near),)
        else:
            self.notes.append(only_seen(progress, near, forbidden))


def _chosen(
    progress: Progress,
    near: Sequence[FittedFamily],
    good: Sequence[FittedEffect],
    represented: Floats,
) -> Step:
    """Choose among laws that lower the loss: equals of the best, fewest numbers first."""
    lowest = min(
        [*(one.losses for one in good), represented], key=lambda losses: float(losses.sum())
    )
    reach = [one for one in good if progress.near(one.losses, lowest)]
    best = min(reach or good, key=lambda one: (count_numbers(one.fitted) if reach else 0, one.loss))
    fitted, second, more = with_second(progress.data, best)
    others = reach or sorted(good, key=lambda one: one.loss)[: 1 + SHORT]
    alternatives = [one for one in others if one.name not in (best.name, second)]
    lawless = [one for one in near if not one.family.members and progress.near(one.losses, lowest)]
    return Step(
        best.family,
        tuple(filter(None, (best.name, second))),
        fitted,
        progress.losses,
        (*alternatives, *lawless),
        short=not reach,
        weak=not progress.data.evidence.falls(progress.losses, fitted.losses, SURE),
        more=more,
    )
