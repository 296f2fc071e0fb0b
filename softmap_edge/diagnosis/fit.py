"""Fits parameters of effects to a run: bounded Levenberg-Marquardt on whitened features, all steps in batched rollouts.

    J(x) = |C^(-1/2) (seen - predicted(x))|² / inflation + |x|²

x are scaled parameters: (θ - null) / range, or ln(θ / start) / half the log range where it is searched on a log
scale; the last term is the weak prior at the plausible range. Bounds are kept by clipping and an active set.
A Jacobian is one batched call (forward differences, 0.4 % of the range: play and stops are not smooth below that); so
are the three damping factors tried at a step. Limit: blocked cross-validation refits each fold by one Gauss-Newton
step from the full fit, of at most half a range. Pinned by tests/test_fit.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis.conditions import Conditions, conditions
from softmap_edge.diagnosis.noise import Kernel, Noise, Whitener, command_kernel
from softmap_edge.errors import SoftmapError
from softmap_edge.folds import run_folds

if TYPE_CHECKING:
    from softmap_edge.run import Run

Floats = NDArray[np.float64]

STEP = 4e-3  # of the range of a parameter
ITERATIONS = 14
REACH_MM = 16.0  # of the finger whose commands the declared bounds in mm were chosen for
CHUNK = 12_000_000  # numbers of one batched prediction: 100 MB


class Record:
    """One run as a fit sees it: measured features, commands, and predictions for any chain of effects."""

    def __init__(self, model: Any, run: Run, library: Any = None) -> None:
        """Bind a model to a run; `library` has `Chain(names, channels)` and `effects()` (the compiled core)."""
        if library is None:
            from softmap_edge import _core as library
        self.model, self.run, self.whole, self.library = model, run, run, library
        seen = np.asarray(model.seen_features(run), float)
        some = np.isfinite(seen).any(axis=(1, 2))
        if not some.all():  # a frame in which nothing is seen holds nothing out, and its loss of 0 speaks for nobody
            self.run, seen = run.at(some), seen[some]
            run = self.run
        self.frames, self.features = seen.shape[0], seen.shape[1] * 3
        self.seen: Floats = seen.reshape(self.frames, self.features)
        self.t_seen: Floats = np.asarray(run.t_seen, float)
        self.u: Floats = np.asarray(model.commands(run), float)
        t = np.asarray(run.t, float)
        columns = [np.interp(self.t_seen, t, c) for c in self.u.T]
        self.command: Floats = np.stack(columns, axis=1) if columns else np.zeros((self.frames, 0))
        mapping = model.run_feature_map(run)
        self.positions: NDArray[np.bool_] = np.asarray(mapping.positions, bool)
        self.section: NDArray[np.int64] = np.asarray(mapping.section)
        self.form_error: Floats = np.asarray(model.run_form_error(run), float)

    @cached_property
    def state(self) -> Conditions:
        """What the commands were doing at each frame."""
        return conditions(self.run, self.u)

    @cached_property
    def spread(self) -> Floats:
        """Range (C,) of the run's commands."""
        return np.ptp(self.u, axis=0) if len(self.u) else np.zeros(self.u.shape[1])

    def predict(self, names: Sequence[str], params: Floats) -> Floats:
        """Return predicted features (B, K, F) mm for parameter sets (B, P)."""
        chunk = max(1, CHUNK // max(1, self.frames * self.features))
        parts = [
            self.model.predict_features(tuple(names), np.ascontiguousarray(params[i : i + chunk]), self.run)
            for i in range(0, len(params), chunk)
        ]
        return np.concatenate(parts).reshape(len(params), self.frames, self.features)

    def rms_mm(self, difference: Floats, frames: NDArray[Any] | None = None) -> float:
        """Return the RMS distance in mm over the places of feature differences (K, F)."""
        squares = self.squares(difference)
        return float(np.sqrt(np.nanmean(squares if frames is None else squares[frames])))

    def squares(self, difference: Floats) -> Floats:
        """Return squared distances (K, places) mm² of feature differences (K, F); NaN where unseen."""
        places = difference.reshape(len(difference), -1, 3)[:, self.positions]
        return np.asarray(np.sum(places**2, axis=2))

    @property
    def form_mm(self) -> float:
        """Return the model's own held-out error in mm RMS over the places."""
        return float(np.sqrt(np.mean(np.sum(self.form_error[self.positions] ** 2, axis=1))))

    def __len__(self) -> int:
        return int(self.frames)


def per_mm(record: Record, labels: Sequence[str], units: Sequence[str]) -> Floats:
    """Return by what (P,) to multiply declared starts and bounds: those in mm of command, where commands are not mm.

    They are declared for tendons that move by REACH_MM to each side. A drive in degrees, radians or ticks moves by
    another number, and its play may be that many times larger.
    """
    model = record.model
    factor, reach = np.ones(len(labels)), np.asarray(getattr(model, "command_range", np.zeros((0, 2))), float)
    if getattr(model, "command_unit", "mm") in ("mm", "N") or not len(reach):
        return factor
    half = float(np.median(0.5 * np.ptp(reach, axis=1)))
    in_commands = {e["name"] for e in record.library.effects() if e["role"] == "channel"}
    commanded = [unit == "mm" and label.split(".")[0] in in_commands for label, unit in zip(labels, units)]
    return np.where(commanded, half / REACH_MM, factor) if half > 0 else factor


class Space:
    """Scaled coordinates x of the free parameters of a chain; all other parameters stay at `base`."""

    def __init__(
        self, record: Record, effects: Sequence[str], base: dict[str, float], free: Sequence[str] = ()
    ) -> None:
        """Free the effects in `effects` on top of the model's own, or exactly those in `free`."""
        own = tuple(record.model.chain_names)
        self.names = own + tuple(e for e in effects if e not in own)
        chain = record.library.Chain(list(self.names), record.model.channels)
        self.labels: list[str] = list(chain.labels)
        self.units: list[str] = list(chain.units)
        null, start = np.asarray(chain.null, float), np.asarray(chain.start, float)
        low, high, log = np.asarray(chain.low, float), np.asarray(chain.high, float), np.asarray(chain.log, bool)
        factor = per_mm(record, self.labels, self.units)
        start, low, high = factor * start, factor * low, factor * high
        wanted = set(free or effects)
        self.free = np.array([i for i, label in enumerate(self.labels) if label.split(".")[0] in wanted], int)
        self.base = np.array([base.get(label, null[i]) for i, label in enumerate(self.labels)])
        self.log = log[self.free]
        self._zero = np.where(self.log, start[self.free], null[self.free])
        linear = np.maximum(np.abs(high - null), np.abs(low - null))[self.free]
        with np.errstate(divide="ignore", invalid="ignore"):
            octave = np.where(self.log, 0.5 * np.log(high[self.free] / low[self.free]), 1.0)
        self._scale = np.where(self.log, octave, np.maximum(linear, 1e-12))
        self.low, self.high = self.scaled(low[self.free]), self.scaled(high[self.free])
        self.start = self.scaled(start[self.free])
        self.null = null[self.free]

    def scaled(self, values: Floats) -> Floats:
        """Return x of parameter values (P,)."""
        safe = np.where(self.log, np.maximum(values, 1e-300) / np.maximum(np.abs(self._zero), 1e-300), 1.0)
        return np.asarray(np.where(self.log, np.log(safe), values - self._zero) / self._scale)

    def values(self, x: Floats) -> Floats:
        """Return the free parameters' values (..., P) in user units."""
        stretched = x * self._scale
        exponent = np.where(self.log, stretched, 0.0)
        return np.asarray(np.where(self.log, self._zero * np.exp(exponent), self._zero + stretched))

    def params(self, x: Floats) -> Floats:
        """Return full parameter sets (B, P_all) of a batch x (B, P)."""
        full = np.tile(self.base, (len(x), 1))
        full[:, self.free] = self.values(x)
        return full

    def sigma(self, x: Floats, deviation: Floats) -> Floats:
        """Return one standard deviation in user units of scaled deviations at x."""
        return np.asarray(np.where(self.log, np.abs(self.values(x)), 1.0) * self._scale * deviation)

    def free_labels(self) -> list[str]:
        """Return the labels of the free parameters."""
        return [self.labels[i] for i in self.free]


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted set of effects: objective `cost`, `chi2` without the prior, and what cross-validation needs."""

    effects: tuple[str, ...]
    space: Space
    x: Floats
    cost: float
    chi2: float
    predicted: Floats  # (K, F) mm
    modes: Floats  # (K, M) residual in units of noise, form error not yet removed
    slopes: Floats  # (P, K, M) d modes / d x

    @property
    def params(self) -> dict[str, float]:
        """The fitted parameters by label, the model's own included."""
        return dict(zip(self.space.labels, map(float, self.space.params(self.x[None])[0])))


class Problem:
    """A record with its noise and form error: what every fit and every cross-validation of a diagnosis shares."""

    def __init__(self, record: Record, noise: Noise, whitener: Whitener, base: dict[str, float] | None = None) -> None:
        """Share `record`, `noise` and `whitener`; `base` are the model's own parameters by label."""
        self.record, self.noise, self.whitener = record, noise, whitener
        chain = record.library.Chain(list(record.model.chain_names), record.model.channels)
        own = dict(zip(chain.labels, map(float, record.model.chain_params)))
        self.base = own if base is None else base
        self.gain = 1.0 / np.sqrt(noise.inflation)
        seen = np.isfinite(record.seen).any(axis=1)
        self.numbers = float(seen.sum() * len(whitener.form)) / noise.inflation
        self.folds = run_folds(record.t_seen, record.run.block)

    def modes(self, predicted: Floats) -> Floats:
        """Return the residual modes (..., K, M) of predictions (..., K, F)."""
        return np.asarray(self.whitener.modes(self.record.seen - predicted) * self.gain)

    def white(self, modes: Floats) -> Floats:
        """Return flattened whitened numbers (..., K*M) of modes."""
        shrunk = self.whitener.shrink(modes)
        return shrunk.reshape(*shrunk.shape[:-2], -1)

    def space(self, effects: Sequence[str], free: Sequence[str] = ()) -> Space:
        """Return the coordinates of a set of effects."""
        return Space(self.record, effects, self.base, free)

    @cached_property
    def fold_kernels(self) -> list[tuple[Kernel, Kernel]]:
        """Kernels over the commands of each fold's training and test frames."""
        command, spread = self.record.command, self.record.spread
        return [(command_kernel(command[a], spread), command_kernel(command[b], spread)) for a, b in self.folds]

    def at(self, space: Space, x: Floats) -> tuple[Floats, Floats]:
        """Return predictions (B, K, F) and residual modes (B, K, M) at x (B, P)."""
        predicted = self.record.predict(space.names, space.params(x))
        return predicted, self.modes(predicted)

    def costs(self, modes: Floats, x: Floats) -> tuple[Floats, Floats]:
        """Return objective and chi² (B,) of modes (B, K, M) at x (B, P)."""
        chi2 = np.sum(self.white(modes) ** 2, axis=-1)
        return chi2 + np.sum(x**2, axis=-1), chi2

    def slopes(self, space: Space, x: Floats, modes: Floats, which: Sequence[int] | None = None) -> Floats:
        """Return d modes / d x (P, K, M) at x (P,), one batched call; `which` restricts the parameters."""
        which = range(len(x)) if which is None else which
        step = np.where(x + STEP > space.high, -STEP, STEP)
        batch = np.tile(x, (len(which), 1))
        for row, i in enumerate(which):
            batch[row, i] += step[i]
        if not len(batch):
            return np.zeros((0, *modes.shape))
        return np.asarray((self.at(space, batch)[1] - modes) / step[list(which), None, None])

    def fit(self, effects: Sequence[str], starts: Sequence[Floats], free: Sequence[str] = ()) -> Fit:
        """Fit a set of effects from each start (P,) in scaled coordinates and keep the best."""
        space = self.space(effects, free)
        fits = [self._descend(tuple(effects), space, np.clip(s, space.low, space.high)) for s in starts]
        return min(fits, key=lambda fit: fit.cost)

    def null(self) -> Fit:
        """Return the model as it is, as a fit of nothing."""
        return self.fit((), [np.zeros(0)])

    def _descend(self, effects: tuple[str, ...], space: Space, x: Floats) -> Fit:
        predicted, modes = (a[0] for a in self.at(space, x[None]))
        if not np.all(np.isfinite(predicted)):
            raise SoftmapError(
                f"the model predicts numbers that are not finite with {', '.join(effects) or 'no effect'}"
            )
        cost, chi2 = (float(a[0]) for a in self.costs(modes[None], x[None]))
        damping, slopes = 1e-2, np.zeros((0, *modes.shape))
        for iteration in range(ITERATIONS):
            slopes = self.slopes(space, x, modes)
            if not len(x) or iteration == ITERATIONS - 1:
                break
            jacobian, residual = self.white(slopes), self.white(modes)
            for _ in range(3):
                tries = np.stack([newton_step(space, x, jacobian, residual, damping * f) for f in (0.05, 1.0, 20.0)])
                ahead, ahead_modes = self.at(space, tries)
                costs, chis = self.costs(ahead_modes, tries)
                best = int(np.argmin(costs))
                if costs[best] < cost:
                    break
                damping *= 400.0
            if not costs[best] < cost:
                break
            fall = cost - float(costs[best])
            damping = float(np.clip(damping * (0.05, 1.0, 20.0)[best], 1e-6, 1e6))
            moved = float(np.max(np.abs(tries[best] - x)))
            x, predicted, modes = tries[best], ahead[best], ahead_modes[best]
            cost, chi2 = float(costs[best]), float(chis[best])
            if fall < 0.05 + 1e-4 * cost and moved < 0.02:
                slopes = self.slopes(space, x, modes)
                break
        return Fit(effects, space, x, cost, chi2, predicted, modes, slopes)

    def uncertainty(self, fit: Fit, dispersion: float) -> Floats:
        """Return one standard deviation of each free parameter in user units, widened by the over-dispersion."""
        jacobian = self.white(fit.slopes)
        inverse = np.linalg.inv(jacobian @ jacobian.T / max(1.0, dispersion) + np.eye(len(fit.x)))
        return fit.space.sigma(fit.x, np.sqrt(np.diag(inverse)))

    def fold_predictions(self, fit: Fit) -> Floats:
        """Return predictions (folds, K, F) with the parameters refitted on each fold's training frames."""
        if not len(fit.x):
            return np.tile(fit.predicted, (len(self.folds), 1, 1))
        points = []
        for (train, _), (kernel, _) in zip(self.folds, self.fold_kernels):
            jacobian = self.whitener.shrink(fit.slopes[:, train], kernel).reshape(len(fit.x), -1)
            residual = self.whitener.shrink(fit.modes[train], kernel).ravel()
            step = newton_step(fit.space, fit.x, jacobian, residual, 1e-3) - fit.x
            points.append(np.clip(fit.x + np.clip(step, -0.5, 0.5), fit.space.low, fit.space.high))
        return self.record.predict(fit.space.names, fit.space.params(np.stack(points)))

    def fold_losses(self, predictions: Floats) -> tuple[Floats, Floats]:
        """Return held-out losses (folds,) of each fold's own prediction on its test frames: plain and whitened.

        Plain counts every frame for itself, with noise and form error in its variance; whitened forgives what the form
        error could be, so it sees memory best and static effects hardly.
        """
        plain, white = [], []
        spread = np.sqrt(1.0 + self.whitener.form)
        for prediction, (_, test), (_, kernel) in zip(predictions, self.folds, self.fold_kernels):
            modes = self.whitener.modes(self.record.seen[test] - prediction[test]) * self.gain
            plain.append(float(np.sum((modes / spread) ** 2)))
            white.append(float(np.sum(self.whitener.shrink(modes, kernel) ** 2)))
        return np.array(plain), np.array(white)


def newton_step(space: Space, x: Floats, jacobian: Floats, residual: Floats, damping: float) -> Floats:
    """Return x after one damped Gauss-Newton step within the bounds; jacobian (P, n), residual (n,)."""
    gradient = jacobian @ residual + x
    hessian = jacobian @ jacobian.T + np.eye(len(x))
    stuck = ((x <= space.low + 1e-9) & (gradient > 0)) | ((x >= space.high - 1e-9) & (gradient < 0))
    ahead = x.copy()
    free = np.flatnonzero(~stuck)
    for _ in range(3):  # parameters that hit a bound are fixed there and the others solved again
        if not len(free):
            break
        inner = hessian[np.ix_(free, free)]
        pull = gradient[free] + hessian[np.ix_(free, np.setdiff1d(np.arange(len(x)), free))] @ (
            np.delete(ahead - x, free)
        )
        ahead[free] = x[free] - np.linalg.solve(inner + damping * np.diag(np.diag(inner)), pull)
        outside = (ahead < space.low) | (ahead > space.high)
        ahead = np.clip(ahead, space.low, space.high)
        if not outside[free].any():
            break
        free = free[~outside[free]]
    return ahead
