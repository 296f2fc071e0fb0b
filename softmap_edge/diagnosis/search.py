"""Searches the sets of effects that explain a run: forward selection with a beam, swaps, acceptance.

Candidates are screened (`screening.py`); the best are fitted in full. A set counts only if each of its
members is accepted: EBIC falls, blocked cross-validation falls by 1 % and in 60 % of the folds that show the member
(CV_SHOWN of them at least), the member moves the centreline by more than 0.12 mm (or the noise of a section mean), and
it moves and carries more than the form of the strongest other member may be off. Differences of objectives are divided
by the over-dispersion (leftover chi²/n of the fit). Of sets that count, fewer effects that come nearer in mm stand for
more.
Known limit: sets are found by growing, dropping and swapping, not by trying all. Pinned by tests/test_diagnosis.py and
tests/test_evidence.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import comb, log

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis.fit import Fit, Problem, Space
from softmap_edge.diagnosis.screening import Screening

Floats = NDArray[np.float64]

BEAM, LARGEST, ROUNDS = 2, 4, 8
REFITS, REFITS_ON = 5, 3  # candidates that are fitted alone, and on top of a fit
STAGES = ("command", "transmission", "material", "shape", "sensing")
CV_FALL, CV_FOLDS = 0.01, 0.6  # least relative fall of the blocked loss, and the share of folds where it falls
CV_RISE, CV_SHOWN = 0.05, 2  # a fold whose loss hardly falls and rises by less does not show the member; how many must
VISIBLE_MM = 0.12  # least RMS displacement of the centreline
SHARE = 0.045  # least share of the explained misfit: forms off by a fifth leave so much, and that is nobody's effect
PROMISING = 0.03  # least share of the misfit that a larger set must win for the search to go on without a valid one
HOPEFUL = 0.5  # of what is promising, or of what a rival must carry: what is predicted to win less is not fitted
FORM_TOLERANCE, FIELD_TOLERANCE = 0.2, 0.3  # of what another member moves: no form is truer; linear fields of stiffness
APART, SECOND = 0.5, 2.0  # of a scale between two starts, and times what the first leaves, for a second to be tried
FLOATED = 0.9  # of what the nearest set of a size leaves: one that came by dropping a member is nearer, and goes first
SIMPLER = 0.9  # of the held-out error in mm: fewer effects that reach it stand for more that the objective likes better


class Search:
    """The sets of effects tried on one problem; fits and cross-validations are kept, so nothing is done twice."""

    def __init__(
        self,
        problem: Problem,
        candidates: Sequence[str],
        progress: Callable[[str], None] | None = None,
        visible: float = VISIBLE_MM,
    ) -> None:
        """Prepare the search over `candidates`; `progress` hears a line per stage.

        `visible` is the least RMS displacement that counts, mm (or the unit of what is seen).
        """
        self.problem, self.candidates = problem, list(candidates)
        self.progress = progress or (lambda _: None)
        self.null = problem.null()
        self._fits: dict[frozenset[str], Fit] = {frozenset(): self.null}
        self._cv: dict[frozenset[str], tuple[Floats, Floats, Floats]] = {}
        registry = problem.record.library.effects()
        self.screening = Screening(problem, registry)
        self.stages = {e["name"]: e["stage"] for e in registry}
        self.faults = {e["name"] for e in registry if e["kind"] == "fault"}
        self._shifts: dict[tuple[frozenset[str], str], Floats] = {}
        noise = problem.noise.rms_mm(problem.record.positions) / np.sqrt(3.0)  # of one component of a section mean
        self.visible_mm = max(visible, noise if problem.noise.replicates else 0.0)

    # --- fits -----------------------------------------------------------------------------------

    def get(self, effects: Sequence[str] | frozenset[str]) -> Fit:
        """Return the fit of a set, fitting it if it is new."""
        key = frozenset(effects)
        if key not in self._fits:
            parents = [key - {e} for e in sorted(key) if key - {e} in self._fits]
            parent = min((self._fits[p] for p in parents), key=lambda f: f.cost) if parents else None
            if parent is None:
                ordered = sorted(key, key=self.candidates.index)
                parent = self.get(ordered[:-1])
            added = next(iter(key - set(parent.effects)))
            self.grow(parent, added)
        return self._fits[key]

    def grow(self, parent: Fit, effect: str, points: list[Floats] | None = None) -> Fit:
        """Fit `parent` with `effect` added; alone, effects with a log scale get a second start."""
        key = frozenset((*parent.effects, effect))
        if key in self._fits:
            return self._fits[key]
        if points is None:
            points = self.screening.best(parent, [effect], 1)[0][2]
        starts = points[:1]
        space = self.problem.space((*parent.effects, effect))
        own = np.array([label.split(".")[0] == effect for label in space.free_labels])
        if not parent.effects and np.any(space.log & own & space.declared):
            starts += self._elsewhere(space, points)
        found = self.problem.fit((*parent.effects, effect), starts)
        self._fits[key] = found
        return found

    def _elsewhere(self, space: Space, points: list[Floats]) -> list[Floats]:
        """Return the next of `points` that lies in another place than the first and leaves little more, or nothing."""
        apart = [p for p in points[1:] if np.max(np.abs(p - points[0])) > APART][:1]
        tried = np.stack([points[0], *apart])
        first, *others = self.problem.costs(self.problem.at(space, tried), tried)[0]
        return [p for p, cost in zip(apart, others) if cost < SECOND * first]

    # --- criteria -------------------------------------------------------------------------------

    def dispersion(self, fit: Fit) -> float:
        """Return leftover chi² per number, at least 1."""
        return max(1.0, fit.chi2 / max(1.0, self.problem.numbers - len(fit.x)))

    def penalty(self, fit: Fit) -> float:
        """Return the EBIC penalty of a set: log n per parameter and the log of how many such sets there are."""
        n = max(3.0, self.problem.numbers)
        return fit.space.count * log(n) + 2.0 * log(comb(max(len(self.candidates), len(fit.effects)), len(fit.effects)))

    def score(self, fit: Fit, dispersion: float) -> float:
        """Return the EBIC of a set at a given over-dispersion."""
        return fit.cost / dispersion + self.penalty(fit)

    def cv(self, fit: Fit) -> tuple[Floats, Floats, Floats]:
        """Return held-out losses (folds,), plain and whitened, and the fold predictions (folds, K, F)."""
        key = frozenset(fit.effects)
        if key not in self._cv:
            predictions = self.problem.fold_predictions(fit)
            self._cv[key] = (*self.problem.fold_losses(predictions), predictions)
        return self._cv[key]

    def displacement(self, fit: Fit, effect: str) -> Floats:
        """Return the feature differences (K, F) mm that `effect` makes within a fit."""
        key = (frozenset(fit.effects), effect)
        if key in self._shifts:
            return self._shifts[key]
        params = {k: v for k, v in fit.params.items() if k.split(".")[0] != effect}
        space = self.problem.space([e for e in fit.effects if e != effect])
        without = np.array([[params[label] for label in space.labels]])
        self._shifts[key] = np.asarray(fit.predicted - self.problem.record.predict(space.names, without)[0])
        return self._shifts[key]

    def accepts(self, fit: Fit, member: str) -> bool:
        """Whether a member of a set counts, against the refitted set without it."""
        rest = self.get(frozenset(fit.effects) - {member})
        cv_fall, cv_folds = self._cv_fall(rest, fit)
        shift = self.displacement(fit, member)
        forms = [e for e in fit.effects if e != member and e not in self.faults]  # a swapped wire has no wrong form
        tolerated = [(self._tolerance(e), self.problem.record.rms_mm(self.displacement(fit, e))) for e in forms]
        wrong, strongest = max(tolerated, key=lambda pair: pair[0] * pair[1], default=(0.0, 0.0))
        return bool(
            (rest.cost - fit.cost) / self.dispersion(fit) > self.penalty(fit) - self.penalty(rest)
            and cv_fall >= CV_FALL
            and cv_folds >= CV_FOLDS
            and self.problem.record.rms_mm(shift) >= max(self._least_mm(shift), wrong * strongest)
            and self.share(fit, member) >= max(SHARE, wrong**2)
        )

    def _tolerance(self, effect: str) -> float:
        """Return by what share of what it moves the form of an effect may be off."""
        return FIELD_TOLERANCE if self.screening.families[effect] == "body stiffness" else FORM_TOLERANCE

    def _least_mm(self, shift: Floats) -> float:
        """Return how far a shift (K, F) mm must move the centreline; a static one further than the form error."""
        record, modes = self.problem.record, self.problem.whitener.modes(shift)
        static = np.sum(self.problem.whitener.shrink(modes) ** 2) < 0.5 * np.sum(modes**2)
        if record.model.kind == "rod" or not static:
            return self.visible_mm
        return max(self.visible_mm, record.form_mm)

    def _cv_fall(self, rest: Fit, fit: Fit) -> tuple[float, float]:
        """Return the relative fall of the held-out loss, and in which share of the folds that show the member it falls.

        Of the plain and the whitened loss the one that shows the member better: memory hides in the plain one behind
        static error, static effects hide in the whitened one behind what form error could be.
        """
        found = []
        for i in (0, 1):
            before, after = self.cv(rest)[i], self.cv(fit)[i]
            fall = float((before.sum() - after.sum()) / max(before.sum(), 1e-300))
            falls, rises = after < (1.0 - CV_FALL) * before, after >= (1.0 + CV_RISE) * before
            found.append((fall, float(falls.sum() / max(CV_SHOWN, falls.sum() + rises.sum()))))
        return max(found, key=lambda f: (f[0] >= CV_FALL and f[1] >= CV_FOLDS, f[0]))

    def share(self, fit: Fit, member: str) -> float:
        """Return which share of the explained misfit a member carries, on held-out blocks or on the objective.

        What faults of the measurement explain hides no physics: that is counted in what they leave.
        """
        rest = self.get(frozenset(fit.effects) - {member})
        base = self.null if member in self.faults else self._measured(fit)
        plain = [float(self.cv(f)[0].sum()) for f in (base, rest, fit)]
        held, whole = plain[1] - plain[2], plain[0] - plain[2]
        part, all_of_it = rest.cost - fit.cost, base.cost - fit.cost
        return max(share / total if total > 0.0 else 0.0 for share, total in ((held, whole), (part, all_of_it)))

    def _measured(self, fit: Fit) -> Fit:
        """Return the faults of a set without its physics."""
        return self.get(frozenset(fit.effects) & self.faults)

    def valid(self, fit: Fit) -> bool:
        """Whether every member of a set is accepted, and all of them together move the body as far as one must."""
        shift = fit.predicted - self.null.predicted
        together = not fit.effects or self.problem.record.rms_mm(shift) >= self._least_mm(shift)
        return together and all(self.accepts(fit, e) for e in fit.effects)

    # --- search ---------------------------------------------------------------------------------

    def run(self) -> Fit:
        """Search and return the largest set whose members are all accepted, or a smaller one that is nearer.

        Members are swapped where all else is built on them, after the first effect, and where the search would end.
        """
        chosen = self.null
        for _ in range(ROUNDS):
            grown = chosen if self._done(chosen) else self._grown(chosen)
            after = self._swapped(grown) if grown is chosen or len(grown.effects) == 1 else grown
            if after is chosen:
                break
            chosen = after
        return self._undominated(chosen)

    def _grown(self, chosen: Fit) -> Fit:
        """Return the next valid set above `chosen` that is better, or `chosen` if there is none."""
        beam, most = [chosen], min(LARGEST, len(self.candidates))
        for _ in range(ROUNDS):
            beam = [fit for fit in beam if len(fit.effects) < most]
            children = self._children(beam, REFITS if beam == [self.null] else REFITS_ON)
            if not children:
                break
            dispersion, size = self.dispersion(children[0]), len(children[0].effects)
            self.progress(f"{size} effect{'s' if size > 1 else ''}: best {' + '.join(children[0].effects)}")
            if self.score(children[0], dispersion) >= min(self.score(b, dispersion) for b in [chosen, *beam]):
                break
            children = self._floated(children)
            beam_before, beam = beam, children[: 1 if self.valid(children[0]) else BEAM]  # swaps bring its rivals in
            level = self.score(chosen, dispersion)
            good = next((c for c in beam if self.score(c, dispersion) < level and self.valid(c)), None)
            if good is not None:
                return good
            won = min(b.cost for b in [chosen, *beam_before]) - beam[0].cost
            if won < PROMISING * (self._measured(beam[0]).cost - beam[0].cost):
                break  # else a pair may need its third; what is not accepted is never reported
        return chosen

    def _undominated(self, fit: Fit) -> Fit:
        """Return the valid set of fewer effects that comes nearest on held-out blocks, if it comes nearer than `fit`.

        The objective forgives static misfit that form error could be, and counts a wrong form of memory frame by frame:
        two effects that leave twice as many mm can have the lower one. What is simpler and nearer is the better answer.
        """
        record, best = self.problem.record, SIMPLER * self.held_out_mm(fit)
        fewer = [other for other in self._fits.values() if 0 < len(other.effects) < len(fit.effects)]
        for other in fewer:
            if record.rms_mm(record.seen - other.predicted) < best and self.valid(other):
                mm = self.held_out_mm(other)
                fit, best = (other, mm) if mm < best else (fit, best)
        return fit

    def _floated(self, children: list[Fit]) -> list[Fit]:
        """Return `children` with the best of them rid of members that it does better without, if there are such.

        What came first may have stood for what came later: sets shrink while what is left is nearer than any tried set
        of its size (sequential floating selection: Pudil et al. 1994, doi:10.1016/0167-8655(94)90127-9).
        """
        fit = children[0]
        while len(fit.effects) > 1:
            known = {key: found.cost for key, found in self._fits.items() if len(key) == len(fit.effects) - 1}
            nearest = min(known.values(), default=np.inf)
            smaller = min((self.get(frozenset(fit.effects) - {e}) for e in fit.effects), key=lambda f: f.cost)
            if smaller.cost >= FLOATED * nearest:
                break
            fit = smaller
        return children if fit is children[0] else [fit, *children]

    def _done(self, fit: Fit) -> bool:
        """Whether a valid set leaves less than what a further member would have to win to be looked for.

        Of the plain loss, in which the form error stands in the variance, noise is what that leaves of it, and is not
        counted; the objective counts whole, for what moves on in a dwell is taken for noise.
        """
        base, share = self._measured(fit), float(np.mean(1.0 / (1.0 + self.problem.whitener.form)))
        before, after = (float(self.cv(f)[0].sum()) for f in (base, fit))
        pairs = [(base.cost, fit.cost, 0.0), (before, after, share * self.problem.numbers)]
        return all(left - noise < PROMISING * (first - left) for first, left, noise in pairs)

    def _children(self, beam: list[Fit], refits: int) -> list[Fit]:
        found: dict[frozenset[str], Fit] = {}
        for parent in beam:
            others = [effect for effect in self.candidates if effect not in parent.effects]
            least = HOPEFUL * PROMISING * (self._measured(parent).cost - parent.cost)
            for rank, (cost, effect, points) in enumerate(self.screening.best(parent, others, refits)):
                if rank and parent.cost - cost < least:
                    break
                child = self.grow(parent, effect, points)
                found[frozenset(child.effects)] = child
        dispersion = min((self.dispersion(f) for f in found.values()), default=1.0)
        return sorted(found.values(), key=lambda f: self.score(f, dispersion))

    def _swapped(self, fit: Fit) -> Fit:
        """Drop one member, add the best other, as long as the set gets better and stays valid."""
        for _ in range(2):
            best = fit
            for member in fit.effects:
                for other in self.alternatives(fit, member, 1, 1.0):
                    dispersion = self.dispersion(best)
                    if self.score(other, dispersion) < self.score(best, dispersion) - 2.0 and self.valid(other):
                        best = other
            if best is fit:
                return fit
            fit = best
        return fit

    def larger(self, fit: Fit) -> list[Fit]:
        """Return the sets with one effect more that were tried on the way."""
        mine, size = frozenset(fit.effects), len(fit.effects) + 1
        return [found for key, found in self._fits.items() if mine < key and len(key) == size]

    def alternatives(self, fit: Fit, member: str, count: int, share: float) -> list[Fit]:
        """Return the best `count` sets with `member` exchanged for another that may do this `share` of what it does."""
        rest = self.get(frozenset(fit.effects) - {member})
        others = [other for other in self.candidates if other not in fit.effects]
        least = HOPEFUL * share * (rest.cost - fit.cost)
        best = self.screening.best(rest, others, count, 0.5 * least)
        return [self.grow(rest, other, points) for cost, other, points in best if rest.cost - cost >= least]

    def held_out_mm(self, fit: Fit) -> float:
        """Return the RMS distance in mm over the places on blocks that trained nothing."""
        return self.problem.held_out_mm(self.cv(fit)[2])

    def weights(self, fit: Fit, temperature: float) -> dict[frozenset[str], float]:
        """Return how probable the sets are that were tried, none larger than `fit`: softmax of -½ΔJ/(φT)."""
        rivals = {key: f for key, f in self._fits.items() if len(key) <= len(fit.effects)}
        dispersion = self.dispersion(fit) * temperature
        scores = np.array([f.cost / dispersion + self.penalty(f) / temperature for f in rivals.values()])
        weight = np.exp(-0.5 * (scores - scores.min()))
        return dict(zip(rivals, map(float, weight / weight.sum())))
