"""Constants and comparisons for the decision between families and laws.

Families and laws are compared by their loss on held-out folds, fold by fold. A comment gives the
reason for each constant; `tests/diagnosis/test_decision.py` pins each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# of the explained loss: tolerated error in the form of a law (0.22 of its amplitude, squared)
FORM = 0.05
FORM_MOST = 0.15  # the same for a static law: it need not explain ordinary imperfections
# Relative fall of the held-out loss that counts. It applies to families that are fitted, accepted
# or linearised again. It also applies to a law that beats its equals, and to parameters that change
# with a condition.
FALL = 0.03
# of the loss above the noise: least fall of the first family and of later ones
FALL_FIRST, FALL_NEXT = 0.2, 0.3
FOLDS = 0.6  # share of the folds that show the family in which the loss must fall
FOLD_SHOWS = 0.1  # of the mean change per fold: a fold with less shows nothing
# share of folds that must agree for a difference within one standard error to count
AGREE = 0.85
ABOVE_NOISE = 1.3  # limit of the loss per whitened value; noise rarely exceeds it
VISIBLE_MM = 0.12  # least effect size, mm RMS of the centreline
ORDINARY = 0.04  # of the motion (RMS): upper limit of ordinary imperfections
# Least ratio to the rest. It applies to a static effect, against ordinary imperfections or the
# model error of a learned map. It also applies to a free static shape that is taken before other
# families. The same holds for a law that is searched after three families.
DOMINATES = 2.0
# standard errors of a learned map's model error that a new static effect must also exceed
SCATTER = 2.0
MIMIC = 0.9  # R² of a family's effect on the columns of others above which it adds nothing
# Unexplained share of the loss, or of the mean square. Above it, an unknown effect is reported. A
# few laws are then tried at once, not one family after the other. Also the share of a law's
# explained loss above which its parameters change.
LEFT = 0.1
# times model error or noise: unexplained error above which an unaccepted family counts
UNKNOWN_TIMES = 2.5
MISWIRED = 0.2  # of the motion: least model error for testing exchanged servos
# Least explained share. A law that explains less of its family is not a candidate. An effect of the
# same form that explains less of a member is not an alternative.
STANDS_FOR = 0.6
ODDS_BASE = 0.03  # odds against any named effect
# the same for each alternative, each parameter at its bound, and an unknown effect
ODDS_DOUBT = 0.5


@dataclass(frozen=True)
class Difference:
    """Fall of the held-out loss between two hypotheses: sum, standard error, share of folds.

    The share is that of the folds in which the loss falls.
    """

    fall: float
    error: float
    share: float


def difference(before: Floats, after: Floats) -> Difference:
    """Return the fall of the loss from `before` (folds,) to `after` (folds,)."""
    fall = before - after
    shows = FOLD_SHOWS * float(np.mean(np.abs(fall)))
    falls, rises = int(np.sum(fall > shows)), int(np.sum(fall < -shows))
    error = float(fall.std(ddof=1) * np.sqrt(len(fall))) if len(fall) > 1 else np.inf
    return Difference(float(fall.sum()), error, falls / max(1, falls + rises))


def seen_to_fall(fall: Difference) -> bool:
    """Whether a loss falls on held-out folds.

    It must fall by more than one standard error, or in every fold that shows anything.
    """
    return fall.share >= FOLDS and (fall.fall > fall.error or fall.share >= 1.0)


def in_one_fold(before: Floats, after: Floats) -> bool:
    """Whether a single fold contributes nearly all of a fall.

    That fold may hold commands that no other fold reaches.
    """
    fall = np.sort(before - after)
    return len(fall) > 1 and bool(fall[-2] <= FOLD_SHOWS * fall[-1])


def near(loss: Floats, best: Floats, null: Floats) -> bool:
    """Whether a hypothesis cannot be distinguished from the best one.

    The tolerance is a share of the loss `null` that the best explains.
    """
    behind = float(loss.sum() - best.sum())
    if behind <= FORM * float(null.sum() - best.sum()):
        return True
    agree = len(loss) >= 5 and float(np.mean(loss > best)) >= AGREE
    return behind <= difference(loss, best).error and not agree


def clears(loss: Floats, other: Floats, numbers: float) -> bool:
    """Whether a hypothesis leaves only noise, and clearly less than another.

    The noise level follows from the number of values.
    """
    return bool(loss.sum() <= ABOVE_NOISE * numbers) and seen_to_fall(difference(other, loss))


def leaves_cause(loss: Floats, best: Floats, numbers: float) -> bool:
    """Whether a hypothesis leaves more than noise while the best does not.

    The noise level follows from the number of values.
    """
    return bool(loss.sum() > ABOVE_NOISE * best.sum()) and clears(best, loss, numbers)


def reaches(loss: Floats, best: Floats, explained: float, form: float | None = None) -> bool:
    """Whether a law leaves no more than the best of its family.

    The difference may be one standard error, or the tolerance of its form.
    """
    form = FORM if form is None else form
    return float(loss.sum() - best.sum()) <= max(difference(loss, best).error, form * explained)


def form_of(static: bool, moved_mm: float, ordinary_mm: float) -> float:
    """Return the share of the explained loss that a law may miss.

    A static law need not explain ordinary imperfections.
    """
    return max(FORM, min(FORM_MOST, (ordinary_mm / max(moved_mm, 1e-9)) ** 2)) if static else FORM
