"""What stands beside a set of effects that was found: rivals that data do not rule out, and simpler or earlier equals.

A rival takes the place of one member and does most of what that does. Both are judged on blocks that trained nothing:
by the losses over folds, and in mm over the places. Pinned by tests/test_diagnosis.py and tests/test_evidence.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis.fit import Fit
from softmap_edge.diagnosis.search import STAGES, Search

Floats = NDArray[np.float64]

RIVALS = 5  # other candidates that are fitted in the place of a member
RIVAL_SE, RIVAL_SHARE = 2.0, 0.6  # standard errors within which a rival stands; least share of the rivalled fall
LEVEL = 0.01  # of the held-out error in mm: sets that differ by less are level
RIVAL_WORSE = 1.0  # a rival whose held-out error in mm is twice as large is none, whatever its folds say
EQUAL = 6.0  # difference of EBIC (odds of 20) below which two sets of the same size count as equally good
ALIKE = 1.02  # of the held-out error: effects of one form differ by less


def rivals_of(search: Search, fit: Fit) -> list[tuple[str, Fit, str]]:
    """Return (member, rival set, why) for sets within two standard errors in blocked cross-validation."""
    found: list[tuple[str, Fit, str]] = []
    for member in fit.effects:
        for other in search.alternatives(fit, member, RIVALS, RIVAL_SHARE):
            share, behind = stands_for(search, other, fit, member), _behind(search, other, fit)
            more = worse(search, other, fit)
            if more > RIVAL_WORSE or any(set(other.effects) == set(f.effects) for _, f, _ in found):
                continue
            level = search.problem.record.model.kind == "rod" and more < LEVEL
            if share >= RIVAL_SHARE and (behind <= RIVAL_SE or level):
                why = (
                    f"explains {100 * share:.0f} % of what {member} explains on held-out blocks, "
                    f"{max(behind, 0.0):.1f} standard errors behind, {100 * more:+.1f} % in mm RMS held out"
                )
                found.append((member, other, why))
    return found


def stands_for(search: Search, other: Fit, fit: Fit, member: str) -> float:
    """Return the share that another set does of what a member does for a fit, by the loss on held-out blocks."""
    rest = search.get(frozenset(fit.effects) - {member})
    without, mine, theirs = (float(search.cv(f)[0].sum()) for f in (rest, fit, other))
    return (without - theirs) / max(without - mine, 1e-300)


def worse(search: Search, other: Fit, fit: Fit) -> float:
    """Return by what share of its error in mm on held-out blocks another set errs more than a fit."""
    return search.held_out_mm(other) / max(search.held_out_mm(fit), 1e-9) - 1.0


def simplest(search: Search, fit: Fit) -> Fit:
    """Return the valid set with the fewest parameters within one standard error (or 1 % in mm) on held-out blocks.

    For models whose own error dominates: how many independent numbers there are is a guess, so EBIC likes
    parameters too much. Among equals the effect that acts earlier on the way to the camera is taken.
    """
    near = [fit]
    for _, other, _ in rivals_of(search, fit):
        if (
            (_behind(search, other, fit) <= 1.0 or worse(search, other, fit) < LEVEL)
            and other.space.count < fit.space.count
            and search.valid(other)
        ):
            near.append(other)
    best = min(near, key=lambda f: (f.space.count, search.score(f, search.dispersion(fit))))
    swaps = (f for member in best.effects for f in search.alternatives(best, member, RIVALS, RIVAL_SHARE))
    equals = [f for f in swaps if f.space.count == best.space.count and search.valid(f)]
    level = search.score(best, search.dispersion(best)) + EQUAL
    close = [f for f in [best, *equals] if search.score(f, search.dispersion(best)) <= level]
    return min(close, key=lambda f: sorted(search.candidates.index(e) for e in f.effects)[::-1])


def earliest(search: Search, fit: Fit, twins: Callable[[str], Sequence[str]]) -> Fit:
    """Return the set with members exchanged for `twins` that explain as much and act earlier on the way."""
    for member in fit.effects:
        for twin in twins(member):
            if twin in fit.effects or twin not in search.candidates:
                continue
            other = search.get(frozenset(fit.effects) - {member} | {twin})
            earlier = STAGES.index(search.stages[twin]) < STAGES.index(search.stages[member])
            if earlier and search.held_out_mm(other) <= ALIKE * search.held_out_mm(fit) and search.valid(other):
                fit = other
                break
    return fit


def _behind(search: Search, other: Fit, fit: Fit) -> float:
    """Return by how many standard errors another set is behind, by the plain or the whitened losses."""
    return max(_standard_errors(search.cv(other)[i], search.cv(fit)[i]) for i in (0, 1))


def _standard_errors(theirs: Floats, mine: Floats) -> float:
    """Return by how many standard errors the log losses of one set lie above those of another, over the folds."""
    ratio = np.log(np.maximum(theirs, 1e-300) / np.maximum(mine, 1e-300))
    return float(ratio.mean() / max(float(ratio.std(ddof=1)) / np.sqrt(len(ratio)), 1e-9))
