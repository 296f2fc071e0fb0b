"""Fit effect parameters to a run by bounded Levenberg-Marquardt on whitened features.

All steps use batched rollouts.

    J(x) = |C^(-1/2) (seen - predicted(x))|² / inflation + |x|²

x are scaled parameters: (θ - null) / range, or ln(θ / start) / half the log range for a log scale.
The last term is a weak prior at the plausible range. Clipping and an active set enforce the bounds.
A Jacobian is one batched call: forward differences of 0.4 % of the range. Below that, backlash and
stops are not smooth. While steps reduce the objective as predicted, secants update it (Broyden
1965, doi:10.1090/S0025-5718-1965-0198670-6). A fit ends with a new one. Limit: blocked
cross-validation refits each fold by one Gauss-Newton step from the full fit. A step is at most half
a range. Pinned by tests/diagnosis/test_fit.py.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis.record import Forms, Record
from softmap_edge.errors import SoftmapError
from softmap_edge.noise.noise_model import Kernel, Noise, Whitener, command_kernel
from softmap_edge.run.folds import run_folds

Floats = NDArray[np.float64]

# of the frames: with more partly visible ones, all frames are predicted by features
HALF_SEEN = 0.25
STEP = 4e-3  # of a parameter's range
ITERATIONS = 20
DAMPING = 1e-3  # of a Gauss-Newton step, of the curvature
# factors tried with new slopes; the second group if none of the first is better
DAMPINGS = ((1.0,), (0.05, 20.0, 400.0), (8e3, 1.6e5))
SECANTS = 3  # least number of parameters for secant updates
# of the predicted fall: below it, or above twice of it, a step needs new slopes
LINEAR = 0.5


class Space:
    """Scaled coordinates x of the free parameters of a chain; all other parameters stay at `base`.

    A parameter that channels share is one coordinate, `backlash.gap`. An effect in `split` has one
    for each channel, `backlash.gap[0]`.
    """

    def __init__(
        self,
        record: Record,
        effects: Sequence[str],
        base: Mapping[str, float],
        free: Sequence[str] = (),
        split: Collection[str] = (),
    ) -> None:
        """Free the effects in `effects` on top of the model's own, or exactly those in `free`."""
        own = tuple(record.model.chain_names)
        layout = record.layout(own + tuple(e for e in effects if e not in own), split)
        self.split, self.full = tuple(split), layout.full
        self.names, self.labels, self.units = layout.names, layout.labels, layout.units
        null = layout.null
        start = layout.start
        low = layout.low
        high = layout.high
        limit = layout.limit
        searched = set(free or effects)
        identifiable = [label.split("@")[0] not in record.untold for label in self.labels]
        self.free = np.array(
            [
                i
                for i, s in enumerate(self.labels)
                if s.split(".")[0] in searched and identifiable[i]
            ],
            int,
        )
        self.base = layout.values(base, null)
        self.log, self.integer, self.instant = (
            a[self.free] for a in (layout.log, layout.integer, layout.instant)
        )
        # not so the prior's own parameters, which always count
        self.declared = layout.declared[self.free]
        self._zero = np.where(self.log, start[self.free], null[self.free])
        linear = np.maximum(np.abs(high - null), np.abs(low - null))[self.free]
        with np.errstate(divide="ignore", invalid="ignore"):
            octave = np.where(self.log, 0.5 * np.log(high[self.free] / low[self.free]), 1.0)
        self._scale = np.where(self.log, octave, np.maximum(linear, 1e-12))
        self.low, self.high = self.scaled(low[self.free]), self.scaled(limit[self.free])
        # end of the plausible range; fits may go up to `high`
        self.usual_high = self.scaled(high[self.free])
        self.start = self.scaled(start[self.free])
        self.null = null[self.free]

    def scaled(self, values: Floats) -> Floats:
        """Return x for parameter values (P,)."""
        safe = np.where(
            self.log, np.maximum(values, 1e-300) / np.maximum(np.abs(self._zero), 1e-300), 1.0
        )
        return np.asarray(np.where(self.log, np.log(safe), values - self._zero) / self._scale)

    def values(self, x: Floats) -> Floats:
        """Return the free parameters' values (..., P) in user units."""
        stretched = x * self._scale
        exponent = np.where(self.log, stretched, 0.0)
        return np.asarray(np.where(self.log, self._zero * np.exp(exponent), self._zero + stretched))

    def params(self, x: Floats) -> Floats:
        """Return complete parameter sets (B, N) for a batch x (B, P)."""
        return self.full(self._sets(x))

    def named(self, x: Floats) -> dict[str, float]:
        """Return all parameters at x (P,) by label."""
        return dict(zip(self.labels, map(float, self._sets(x[None])[0])))

    def _sets(self, x: Floats) -> Floats:
        """Return parameter sets (B, L), in the order of `labels`, of a batch x (B, P)."""
        sets = np.tile(self.base, (len(x), 1))
        sets[:, self.free] = self.values(x)
        return sets

    def sigma(self, x: Floats, deviation: Floats) -> Floats:
        """Return standard deviations (D,) in user units of scaled deviations (D,) at x."""
        return np.asarray(np.where(self.log, np.abs(self.values(x)), 1.0) * self._scale * deviation)

    def pinned(self, x: Floats) -> Space:
        """Return bounds that fix integer coordinates at x, because they have no slope."""
        if not self.integer.any():
            return self
        held = copy(self)
        held.low, held.high = (
            np.where(self.integer, x, self.low),
            np.where(self.integer, x, self.high),
        )
        return held

    @cached_property
    def free_labels(self) -> list[str]:
        """The labels of the free parameters."""
        return [self.labels[i] for i in self.free]

    def of(self, effects: Collection[str]) -> NDArray[np.bool_]:
        """Return a mask of the free parameters (P,) that belong to some effects."""
        return np.array([label.split(".")[0] in effects for label in self.free_labels], bool)


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted set of effects: `cost`, `chi2` without the prior, and cross-validation data.

    `cost` is the objective.

    Many sets are fitted and rarely used again, so predictions and slopes are computed on demand.
    """

    problem: Problem
    effects: tuple[str, ...]
    space: Space
    x: Floats
    cost: float
    chi2: float
    modes: Floats  # (K, M) residual in units of noise, model-form error not yet removed

    @cached_property
    def predicted(self) -> Floats:
        """The predicted features (K, F) mm."""
        return np.asarray(
            self.problem.record.predict(self.space.names, self.space.params(self.x[None]))[0]
        )

    @cached_property
    def slopes(self) -> Floats:
        """The slopes d modes / d x (P, K, M)."""
        return self.problem.slopes(self.space, self.x, self.modes)

    @property
    def params(self) -> dict[str, float]:
        """The fitted parameters by label, the model's own included."""
        return self.space.named(self.x)

    def on(self, other: Record) -> Floats:
        """Return the prediction of the fitted parameters on another record (K, F) mm."""
        layout = other.layout(self.space.names, self.space.split)
        return np.asarray(
            other.predict(self.space.names, layout.full(layout.values(self.params)[None]))[0]
        )


@dataclass(frozen=True)
class ProjectedFeatures:
    """Measured features as modes (K, M), and separately the frames with hidden features.

    These frames are `rows` (R,).
    """

    modes: Floats
    rows: NDArray[np.intp]
    few: Record | None


class Problem:
    """A record with noise and model-form error, for all fits and validations of a diagnosis."""

    def __init__(
        self, record: Record, noise: Noise, whitener: Whitener, base: dict[str, float] | None = None
    ) -> None:
        """Share `record`, `noise`, `whitener`; `base` are the model's parameters by label."""
        self.record, self.noise, self.whitener = record, noise, whitener
        self.base = record.own_values() if base is None else base
        self.gain = 1.0 / np.sqrt(noise.inflation)
        # a frame is weighted by the visible share of the body
        seen = np.isfinite(record.seen).mean(axis=1)
        self.numbers = float(seen.sum() * whitener.numbers) / noise.inflation
        self.folds = run_folds(record.t_seen, record.block)
        self._seen: tuple[Floats, ProjectedFeatures | None] | None = None
        self._spaces: dict[tuple[tuple[str, ...], ...], Space] = {}

    def modes(self, predicted: Floats) -> Floats:
        """Return the residual modes (..., K, M) of predictions (..., K, F)."""
        return np.asarray(self.whitener.modes(self.record.seen - predicted) * self.gain)

    def white(self, modes: Floats) -> Floats:
        """Return flattened whitened numbers (..., K*M) of modes."""
        shrunk = self.whitener.shrink(modes)
        return shrunk.reshape(*shrunk.shape[:-2], shrunk.shape[-2] * shrunk.shape[-1])

    def space(
        self, effects: Sequence[str], free: Sequence[str] = (), split: Collection[str] = ()
    ) -> Space:
        """Return the coordinates of a set of effects, cached.

        Effects in `split` have one parameter for each channel.
        """
        key = (tuple(effects), tuple(free), tuple(sorted(split)))
        if key not in self._spaces:
            self._spaces[key] = Space(self.record, effects, self.base, free, split)
        return self._spaces[key]

    @cached_property
    def unchanged(self) -> Floats:
        """Features (K, F) mm predicted by the unchanged model."""
        own = self.space(())
        return np.asarray(self.record.predict(own.names, own.params(np.zeros((1, 0))))[0])

    @cached_property
    def fold_kernels(self) -> list[tuple[Kernel, Kernel]]:
        """Kernels over the commands of the training and test frames of each fold."""
        command, spread, leaning = self.record.command, self.record.spread, self.record.leaning
        parts = [
            (command_kernel(command[i], spread, leaning[i]) for i in fold) for fold in self.folds
        ]
        return [(train, test) for train, test in parts]

    @cached_property
    def _weights(self) -> Floats:
        return np.ascontiguousarray(self.gain * self.whitener.project.T)

    @cached_property
    def _forms(self) -> Forms:
        """The direct prediction of modes, without features."""
        return self.record.forms(self._weights)

    def _projected(self) -> ProjectedFeatures | None:
        """Return the modes of measured features, recomputed if the features were replaced.

        None if many features are hidden.
        """
        seen = self.record.seen
        if self._seen is None or self._seen[0] is not seen:
            complete = np.asarray(np.isfinite(seen).all(axis=1))
            rows = np.union1d(self.record.begins, np.flatnonzero(~complete))
            projected = None
            if len(rows) <= HALF_SEEN * len(seen):
                few = None if complete.all() else self.record.some(rows)
                projected = ProjectedFeatures(
                    np.where(complete[:, None], seen, 0.0) @ self._weights, rows, few
                )
            self._seen = seen, projected
        return self._seen[1]

    def at(self, space: Space, x: Floats) -> Floats:
        """Return residual modes (B, K, M) at x (B, P)."""
        projected, params = self._projected(), space.params(x)
        if projected is None:
            return self.modes(self.record.predict(space.names, params))
        found = np.asarray(projected.modes - self._forms(space.names, params))
        if projected.few is not None:
            found[:, projected.rows] = (
                self.whitener.modes(projected.few.seen - projected.few.predict(space.names, params))
                * self.gain
            )
        return found

    def costs(self, modes: Floats, x: Floats) -> tuple[Floats, Floats]:
        """Return objective and chi² (B,) of modes (B, K, M) at x (B, P)."""
        chi2 = self.whitener.squares(modes)
        return chi2 + np.sum(x**2, axis=-1), chi2

    def slopes(self, space: Space, x: Floats, modes: Floats) -> Floats:
        """Return d modes / d x (P, K, M) at x (P,), one batched call."""
        if not len(x):
            return np.zeros((0, *modes.shape))
        step = np.where(x + STEP > space.high, -STEP, STEP)
        return np.asarray((self.at(space, x + np.diag(step)) - modes) / step[:, None, None])

    def fit(
        self,
        effects: Sequence[str],
        starts: Sequence[Floats],
        free: Sequence[str] = (),
        split: Collection[str] = (),
    ) -> Fit:
        """Fit a set of effects from each start (P,) in scaled coordinates and keep the best.

        The shared parameters of the effects in `split` are fitted for each channel.
        """
        space = self.space(effects, free, split)
        inside = [np.clip(start, space.low, space.high) for start in starts]
        fits = [self._descend(tuple(effects), space.pinned(x), x) for x in inside]
        return min(fits, key=lambda fit: fit.cost)

    def null(self) -> Fit:
        """Return the unchanged model as a fit without effects."""
        return self.fit((), [np.zeros(0)])

    def _descend(self, effects: tuple[str, ...], space: Space, x: Floats) -> Fit:
        modes = self.at(space, x[None])[0]
        if not np.all(np.isfinite(modes)):
            raise SoftmapError(
                "the model predicts numbers that are not finite with "
                f"{', '.join(effects) or 'no effect'}"
            )
        cost, chi2 = (float(a[0]) for a in self.costs(modes[None], x[None]))
        damping, slopes, fresh = DAMPING, self.slopes(space, x, modes), True
        for _ in range(ITERATIONS if len(x) else 0):
            jacobian, residual = self.white(slopes), self.white(modes)
            gradient, hessian = normal(x, jacobian, residual)
            for factors in DAMPINGS if fresh else DAMPINGS[:1]:
                tries = np.stack(
                    [normal_step(space, x, gradient, hessian, damping * f) for f in factors]
                )
                ahead = self.at(space, tries)
                costs, chis = self.costs(ahead, tries)
                best = int(np.argmin(costs))
                if costs[best] < cost:
                    break
            if not costs[best] < cost and fresh:
                break
            step, fall = tries[best] - x, cost - float(costs[best])
            promised = cost - float(
                np.sum((residual + step @ jacobian) ** 2) + np.sum(tries[best] ** 2)
            )
            small = fall < 0.05 + 1e-4 * cost and float(np.max(np.abs(step))) < 0.1
            if costs[best] < cost:
                missed = ahead[best] - modes - np.tensordot(step, slopes, 1)
                x, modes = tries[best], ahead[best]
                cost, chi2 = float(costs[best]), float(chis[best])
                damping = float(
                    np.clip(damping * (0.2 if factors[best] == 1.0 else factors[best]), 1e-6, 1e6)
                )
                if small and fresh:
                    break
            if (
                small
                or len(x) < SECANTS
                or not LINEAR < fall / max(promised, 1e-300) < 1.0 / LINEAR
            ):
                slopes, fresh = self.slopes(space, x, modes), True
            else:
                slopes, fresh = slopes + step[:, None, None] * (missed / (step @ step)), False
        found = Fit(self, effects, space, x, cost, chi2, modes)
        if fresh:
            found.__dict__["slopes"] = slopes  # known already
        return found

    def uncertainty(self, fit: Fit, dispersion: float) -> Floats:
        """Return the standard deviation (D,) of each free parameter, in user units.

        It includes the over-dispersion.
        """
        jacobian = self.white(fit.slopes)
        inverse = np.linalg.inv(jacobian @ jacobian.T / max(1.0, dispersion) + np.eye(len(fit.x)))
        return fit.space.sigma(fit.x, np.sqrt(np.diag(inverse)))

    def fold_predictions(self, fit: Fit) -> Floats:
        """Return predictions (folds, K, F) with parameters refitted to each fold's training."""
        if not len(fit.x):
            return np.tile(fit.predicted, (len(self.folds), 1, 1))
        points = []
        for (train, _), (kernel, _) in zip(self.folds, self.fold_kernels):
            jacobian = self.whitener.shrink(fit.slopes[:, train], kernel).reshape(len(fit.x), -1)
            # otherwise the prior alone moves it, in a fold that does not show it
            acts = np.sum(jacobian**2, axis=1) >= 1.0
            residual = self.whitener.shrink(fit.modes[train], kernel).ravel()
            step = newton_step(fit.space, fit.x, jacobian, residual, DAMPING) - fit.x
            step = np.where(acts, np.clip(step, -0.5, 0.5), 0.0)
            points.append(np.clip(fit.x + step, fit.space.low, fit.space.high))
        return self.record.predict(fit.space.names, fit.space.params(np.stack(points)))

    def held_out_mm(self, predictions: Floats) -> float:
        """Return the RMS error (mm) of each fold's prediction (folds, K, F).

        The error is over the test frames of the fold.
        """
        folds = zip(predictions, self.folds)
        squares = [
            self.record.squares(self.record.seen[test] - p[test]).ravel() for p, (_, test) in folds
        ]
        return float(np.sqrt(np.nanmean(np.concatenate(squares))))

    def fold_losses(self, predictions: Floats) -> Floats:
        """Return held-out losses (folds,) of each fold's own prediction on its test frames.

        Frames are independent, with noise and model-form error in their variance.
        """
        spread = np.sqrt(1.0 + self.whitener.form)
        modes = [
            self.whitener.modes(self.record.seen[i] - p[i])
            for p, (_, i) in zip(predictions, self.folds)
        ]
        return np.array([np.sum((one * self.gain / spread) ** 2) for one in modes])


def newton_step(
    space: Space, x: Floats, jacobian: Floats, residual: Floats, damping: float
) -> Floats:
    """Return x after a damped Gauss-Newton step in bounds; jacobian (P, n), residual (n,)."""
    return normal_step(space, x, *normal(x, jacobian, residual), damping)


def normal(x: Floats, jacobian: Floats, residual: Floats) -> tuple[Floats, Floats]:
    """Return gradient (P,) and Hessian (P, P) of half the objective at x, with the prior."""
    return np.asarray(jacobian @ residual + x), np.asarray(jacobian @ jacobian.T + np.eye(len(x)))


def normal_step(
    space: Space, x: Floats, gradient: Floats, hessian: Floats, damping: float
) -> Floats:
    """Return x after one damped step within the bounds.

    Gradient (P,) and Hessian (P, P) are those of half the objective.
    """
    low, high = space.low, space.high
    free = ~(((x <= low + 1e-9) & (gradient > 0)) | ((x >= high - 1e-9) & (gradient < 0)))
    ahead = x.copy()
    for _ in range(3):  # fix parameters that reach a bound, and solve again for the others
        if not free.any():
            break
        if free.all():
            inner, pull = hessian.copy(), gradient
        else:
            rows = hessian[free]
            inner, pull = rows[:, free], gradient[free] + rows[:, ~free] @ (ahead - x)[~free]
        inner.flat[:: len(inner) + 1] *= 1.0 + damping
        ahead[free] = x[free] - np.linalg.solve(inner, pull)
        outside = free & ((ahead < low) | (ahead > high))
        if not outside.any():
            break
        ahead = np.minimum(np.maximum(ahead, low), high)
        free &= ~outside
    return ahead
