"""Representatives of families: fitted freely, linearised about themselves, ranked.

A representative is the columns of a family (`families.py`) with coefficients. They are from a ridge
regression on the whitened residual. Cross-validation gives the ridge strength and the fall of the
held-out loss. Known limit: a representative is linear about the state; it is linearised again until
its loss stops falling. Pinned by tests/diagnosis/test_two_levels.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from softmap_edge import _core
from softmap_edge.diagnosis import decision as rule
from softmap_edge.diagnosis.families import Columns, Commands, Family, FeatureBody, Floats
from softmap_edge.diagnosis.fit import Fit

BACKGROUND_RIDGE = 10.0  # ridge of families that explain ordinary imperfections
FARTHEST = 3.0  # command limit of a representative, half ranges from the middle
RIDGES = (0.3, 10.0, 300.0, 1e4)  # ridge strengths for cross-validation
LINEARISED = 6  # most linearisations of a representative about itself
HALVED = 3  # most halvings, while the loss is higher with it than without


@dataclass(frozen=True, eq=False)
class Representative:
    """A freely fitted family: coefficients, ridge, held-out loss, displacement."""

    family: Family
    theta: Floats  # (n,)
    ridge: float
    loss: Floats  # (folds,)
    numbers: float  # effective degrees of freedom
    columns: Columns
    moved_mm: float  # RMS over the places
    settled: bool = False  # whether it is linearised about itself

    @property
    def left(self) -> float:
        """The held-out loss of all folds."""
        return float(self.loss.sum())


class State:
    """A step of the search: a joint fit, representatives alongside, and their predictions."""

    def __init__(
        self,
        body: FeatureBody,
        fit: Fit,
        representatives: Sequence[Representative] = (),
        background: Sequence[Family] = (),
    ) -> None:
        """Set the state.

        Args:
            body: the problem at level 1.
            fit: the joint fit of the laws found.
            representatives: representatives of the families without a law.
            background: families that explain ordinary imperfections, which are not named. If the
                static map was learned from data with memory, they include its families, because the
                memory has distorted the map.
        """
        self.body, self.fit, self.representatives = body, fit, tuple(representatives)
        self.background = tuple(dict.fromkeys((*background, *body.learned)))
        start = body.effective(fit)
        commands, shift = start, np.zeros_like(body.record.seen)
        for one in self.representatives:
            commands, more = applied(body, one, commands)
            shift = shift + more
        self.commands = commands
        if self.representatives:
            shift = shift + body.features(commands) - body.features(start)
        self.shift = shift  # (K, F) mm, of the representatives

    def without_background(self) -> State:
        """Return the state without families of ordinary imperfections.

        If there are none, return this state.
        """
        alone = set(self.background) <= set(self.body.learned)
        return self if alone else State(self.body, self.fit, self.representatives)

    @property
    def predicted(self) -> Floats:
        """The predicted features (K, F) mm."""
        return self.fit.predicted + self.shift

    @cached_property
    def slopes(self) -> Floats:
        """The slopes (C, K, F) over the effective commands."""
        return self.body.slopes(self.commands)

    @property
    def residual(self) -> Floats:
        """The measurement minus the prediction, (K, F) mm."""
        return np.asarray(self.body.record.seen - self.predicted)

    def blocks(self, level: _core.Level, fit: Fit | None = None) -> tuple[list[str], list[float]]:
        """Add the effects found, or another `fit`, to normal equations.

        Return names and ridges of the blocks.
        """
        names, ridges = [], []
        if self.body.add_fit(level, "fit", self.fit if fit is None else fit):
            names, ridges = ["fit"], [1.0]
        for one in self.representatives:
            columns = self.body.columns(one.family, self.commands, self.slopes)
            if columns is not None:
                self.body.add(level, f"*{one.family.name}", columns)
                names, ridges = [*names, f"*{one.family.name}"], [*ridges, one.ridge]
        for family, columns in self._background.items():
            self.body.add(level, f"~{family.name}", columns)
            names, ridges = [*names, f"~{family.name}"], [*ridges, BACKGROUND_RIDGE]
        return names, ridges

    @cached_property
    def _background(self) -> dict[Family, Columns]:
        """The columns of the families that explain ordinary imperfections."""
        found = {f: self.body.columns(f, self.commands, self.slopes) for f in self.background}
        return {family: columns for family, columns in found.items() if columns is not None}

    @cached_property
    def ordinary(self) -> Floats:
        """The part of the residual that ordinary imperfections explain, (K, F) mm."""
        out = np.zeros_like(self.body.record.seen)
        if self._background:
            level = self.body.level()
            names, ridges = self.blocks(level)
            level.close(np.ascontiguousarray(self.body.modes(self.residual)))
            theta = level.theta(names, ridges)
            for columns, own in zip(self._background.values(), theta[-len(self._background) :]):
                out += columns.shift(np.asarray(own))
        return out


def applied(body: FeatureBody, one: Representative, commands: Commands) -> tuple[Commands, Floats]:
    """Return effective commands after a representative, and its addition to features (K, F) mm."""
    bank = _core.Bank(one.family.name, len(body.half))
    acting = np.ascontiguousarray(one.theta[: one.columns.commanded])
    if len(acting):
        most = FARTHEST * body.half
        moved = [bank.applied(series, acting) for series in body.series(commands)]
        commands = [
            np.ascontiguousarray(np.clip(v, body.middle - most, body.middle + most)) for v in moved
        ]
    return commands, one.columns.shift(one.theta, one.columns.commanded)


def linearised(state: State, rough: Representative) -> tuple[Representative, Floats]:
    """Return a representative fitted about itself, and its effect on the features (K, F) mm."""
    body, columns = state.body, rough.columns

    def moves(theta: Floats) -> tuple[Commands, Floats]:
        return applied(body, replace(rough, theta=theta), state.commands)

    theta, loss, shift = about_itself(state, columns.with_slopes, rough.theta, rough.ridge, moves)
    mm = body.record.rms_mm(np.where(np.isfinite(body.record.seen), shift, np.nan))
    return replace(rough, theta=theta, loss=loss, moved_mm=mm, settled=True), shift


def about_itself(
    state: State,
    columns: Callable[[Floats], Columns],
    theta: Floats,
    ridge: float,
    moves: Callable[[Floats], tuple[Commands, Floats]],
) -> tuple[Floats, Floats, Floats]:
    """Fit columns on top of the effects found, linearised about their own fit.

    Args:
        state: the effects found and their representatives.
        columns: returns the columns for slopes (C, K, F) of the features over the commands.
        theta: coefficients (n,) to start from.
        ridge: strength of the ridge.
        moves: applies coefficients exactly; returns effective commands and an added shift (K, F)
            mm.

    Returns:
        tuple: coefficients (n,), held-out loss (folds,), and the resulting features (K, F) mm.
    """
    body = state.body
    before = body.features(state.commands)

    def shift(theta: Floats) -> tuple[Commands, Floats]:
        there, more = moves(theta)
        return there, np.asarray(
            more if there is state.commands else body.features(there) - before + more
        )

    best, start = (theta, np.full(1, np.inf)), float(np.sum(body.modes(state.residual) ** 2))
    for _ in range(LINEARISED):
        there, moved = shift(theta)
        for _ in range(HALVED):
            if np.sum(body.modes(state.residual - moved) ** 2) <= start:
                break
            # too far: linearisation overestimates a large effect
            theta = 0.5 * theta
            there, moved = shift(theta)
        about = columns(state.slopes if there is state.commands else body.slopes(there))
        level = body.level()
        body.add(level, "about itself", about)
        names, ridges = state.blocks(level)
        level.close(np.ascontiguousarray(body.modes(state.residual - moved + about.shift(theta))))
        every, strengths = [*names, "about itself"], [*ridges, ridge]
        theta, loss = (
            np.asarray(level.theta(every, strengths)[-1]),
            np.asarray(level.losses(every, strengths)),
        )
        settled = loss.sum() > (1.0 - rule.FALL) * best[1].sum()
        best = (theta, loss) if loss.sum() < best[1].sum() else best
        if settled:
            break
    return *best, shift(best[0])[1]


@dataclass(frozen=True, eq=False)
class Ranking:
    """Level 1 about a state: the loss before it, and each family's fit.

    The loss includes the families of the effects found.
    """

    level: _core.Level
    names: list[str]  # ridges of the blocks found, and of the families included
    ridges: list[float]
    found: Floats  # (folds,) held-out loss of the effects found
    before: Floats  # (folds,) the same with the families of the effects found as nuisances
    rows: list[Representative]  # least loss first
    static: Floats  # (K, F) mm, joint contribution of all static families


def ranked(
    state: State, every: Sequence[Family], taken: Sequence[Family], within: float = 0.0
) -> Ranking:
    """Fit each family about a state, together with the families of found laws.

    The form of a found law may be inexact. Only families that explain at least `within` of the best
    one's fall on training frames are cross-validated.
    """
    body, level = state.body, state.body.level()
    names, ridges = state.blocks(level)
    known = {f"*{one.family.name}" for one in state.representatives}
    columns = {
        f: c for f in every if (c := body.columns(f, state.commands, state.slopes)) is not None
    }
    for family, own in columns.items():
        body.add(level, family.name, own)
    level.close(np.ascontiguousarray(body.modes(state.residual)))
    found = before = np.asarray(level.losses(names, ridges))
    for family in taken:
        if family in columns and f"*{family.name}" not in known:
            if _training_gain(level, names, ridges, family.name, before) < rule.FALL * before.sum():
                continue
            loss, ridge = best_ridge(level, names, ridges, family.name)
            if loss.sum() < before.sum():
                before, names, ridges = loss, [*names, family.name], [*ridges, ridge]
    rows, gained = [], 0.0
    gains = {
        f: _training_gain(level, names, ridges, f.name, before) for f in columns if f not in taken
    }
    for family in sorted(gains, key=lambda f: -gains[f]) if within else gains:
        own, loss, ridge = columns[family], before, RIDGES[-1]
        if gains[family] >= max(rule.FALL * before.sum(), within * gained):
            loss, ridge = best_ridge(level, names, ridges, family.name)
            gained = max(gained, float(before.sum() - loss.sum()))
        theta = level.theta([*names, family.name], [*ridges, ridge])[-1]
        numbers = level.freedom([*names, family.name], [*ridges, ridge], family.name)
        shift = np.where(np.isfinite(body.record.seen), own.shift(theta), np.nan)
        rows.append(
            Representative(family, theta, ridge, loss, numbers, own, body.record.rms_mm(shift))
        )
    rows.sort(key=lambda row: row.left)
    return Ranking(
        level, names, ridges, found, before, rows, _static(body, level, names, ridges, rows)
    )


def _static(
    body: FeatureBody,
    level: _core.Level,
    names: list[str],
    ridges: list[float],
    rows: Sequence[Representative],
) -> Floats:
    """Return the joint contribution of all static families, (K, F) mm."""
    static = [row for row in rows if row.family.kind == "static"]
    out = np.zeros_like(body.record.seen)
    if static:
        blocks = [*names, *(row.family.name for row in static)]
        theta = level.theta(blocks, [*ridges, *(row.ridge for row in static)])
        for row, own in zip(static, theta[len(names) :]):
            out += row.columns.shift(np.asarray(own))
    return out


def _training_gain(
    level: _core.Level, names: list[str], ridges: list[float], name: str, before: Floats
) -> float:
    """Return the fall of the training loss by one more block.

    The held-out loss seldom falls by more.
    """
    most = max(float(before.sum()), level.training_loss(names, ridges))
    return most - level.training_loss([*names, name], [*ridges, RIDGES[0]])


def best_ridge(
    level: _core.Level, names: list[str], ridges: list[float], name: str
) -> tuple[Floats, float]:
    """Return the least held-out loss (folds,) with one more block, and its ridge strength.

    The loss has one minimum over the strength, so the search descends from the second strength.
    """

    def tried(k: int) -> tuple[Floats, float]:
        return np.asarray(level.losses([*names, name], [*ridges, RIDGES[k]])), RIDGES[k]

    k, best = 1, tried(1)
    while k + 1 < len(RIDGES) and (stronger := tried(k + 1))[0].sum() < best[0].sum():
        k, best = k + 1, stronger
    if k == 1 and (weaker := tried(0))[0].sum() < best[0].sum():
        best = weaker
    return best
