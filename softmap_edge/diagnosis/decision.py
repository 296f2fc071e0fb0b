"""All constants of the decision between families and laws, and comparisons by them.

A family or a law is compared by its loss on held-out folds, fold by fold. Each constant has its
reason in a comment; `tests/diagnosis/test_decision.py` pins each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# of the explained loss: what the form of a law may be off (0.22 of its amplitude, squared)
FORM = 0.05
FORM_MOST = 0.15  # the same for a static law, which need not explain ordinary imperfections
# Relative fall of the held-out loss that counts: for a family to be fitted, accepted or linearised
# once more, for a law to beat its equals, and for numbers that change with a condition.
FALL = 0.03
# of the loss above the noise: least fall of the first family and of later ones
FALL_FIRST, FALL_NEXT = 0.2, 0.3
FOLDS = 0.6  # share of the folds in which the loss must fall, of those that show the family
FOLD_SHOWS = 0.1  # of the mean change of a fold's loss: a fold that changes by less shows nothing
# share of the folds that must agree before a difference within one standard error counts
AGREE = 0.85
ABOVE_NOISE = 1.3  # limit of the loss per whitened number: noise alone rarely exceeds it
VISIBLE_MM = 0.12  # least effect size, mm RMS of the centreline
ORDINARY = 0.04  # of the motion (RMS): upper limit of ordinary imperfections
# Times as much as the rest: a static effect beyond ordinary imperfections, or against the model
# error of a learned map; a free static shape that is taken before other families; a law that is
# still asked for after three families.
DOMINATES = 2.0
# standard errors of a learned map's model error, which a new static effect must exceed too
SCATTER = 2.0
MIMIC = 0.9  # R² of a family's effect on the columns of others, from which it adds nothing to them
# Unexplained share of the loss, or of the mean square: above it an unknown effect is reported, and
# a few laws at once are tried in place of one family after the other. Also the share of what a law
# explains from which its numbers change.
LEFT = 0.1
# times model error or noise: unexplained error at which a family counts that was not accepted
UNKNOWN_TIMES = 2.5
MISWIRED = 0.2  # of the motion: servos are exchanged only where the model is off by so much
# Share that must be explained: of what its family does, by a law that is only a candidate; of what
# a member does, by an effect of the same form that is its alternative.
STANDS_FOR = 0.6
ODDS_BASE = 0.03  # odds against every name
# the same for each alternative, for a number at its bound, and for an unknown effect alongside
ODDS_DOUBT = 0.5


@dataclass(frozen=True)
class Difference:
    """How far the held-out loss falls between two hypotheses: sum, standard error, folds.

    The last is the share of the folds in which it falls.
    """

    fall: float
    error: float
    share: float


def difference(before: Floats, after: Floats) -> Difference:
    """Return how far the loss falls from `before` (folds,) to `after` (folds,)."""
    fall = before - after
    shows = FOLD_SHOWS * float(np.mean(np.abs(fall)))
    falls, rises = int(np.sum(fall > shows)), int(np.sum(fall < -shows))
    error = float(fall.std(ddof=1) * np.sqrt(len(fall))) if len(fall) > 1 else np.inf
    return Difference(float(fall.sum()), error, falls / max(1, falls + rises))


def seen_to_fall(fall: Difference) -> bool:
    """Whether a loss falls on held-out folds.

    It does so beyond one standard error, or in every fold that shows anything.
    """
    return fall.share >= FOLDS and (fall.fall > fall.error or fall.share >= 1.0)


def in_one_fold(before: Floats, after: Floats) -> bool:
    """Whether a single fold shows nearly all of a fall.

    It may hold commands that no other fold reaches.
    """
    fall = np.sort(before - after)
    return len(fall) > 1 and bool(fall[-2] <= FOLD_SHOWS * fall[-1])


def near(loss: Floats, best: Floats, null: Floats) -> bool:
    """Whether a hypothesis cannot be distinguished from the best one.

    This depends on what the best explains of `null`.
    """
    behind = float(loss.sum() - best.sum())
    if behind <= FORM * float(null.sum() - best.sum()):
        return True
    agree = len(loss) >= 5 and float(np.mean(loss > best)) >= AGREE
    return behind <= difference(loss, best).error and not agree


def clears(loss: Floats, other: Floats, numbers: float) -> bool:
    """Whether a hypothesis leaves only noise, and is seen to leave less than another.

    The noise is that of so many numbers.
    """
    return bool(loss.sum() <= ABOVE_NOISE * numbers) and seen_to_fall(difference(other, loss))


def leaves_cause(loss: Floats, best: Floats, numbers: float) -> bool:
    """Whether a hypothesis leaves more than noise where the best does not.

    The noise is that of so many numbers.
    """
    return bool(loss.sum() > ABOVE_NOISE * best.sum()) and clears(best, loss, numbers)


def reaches(loss: Floats, best: Floats, explained: float, form: float | None = None) -> bool:
    """Whether a law leaves no more than the best of its family.

    Up to one standard error, or the tolerance of its form.
    """
    form = FORM if form is None else form
    return float(loss.sum() - best.sum()) <= max(difference(loss, best).error, form * explained)


def form_of(static: bool, moved_mm: float, ordinary_mm: float) -> float:
    """Return the share of the explained loss that a law may miss.

    A static law need not explain imperfections.
    """
    return max(FORM, min(FORM_MOST, (ordinary_mm / max(moved_mm, 1e-9)) ** 2)) if static else FORM
