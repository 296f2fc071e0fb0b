"""Effects of the servo, apart from those of the tendon: what lies between command and encoder, where a run has both.

Each channel is a model of its own whose shape is the command itself, so the same search that looks for what the robot
lacks finds what the servo does: command → chain of command effects → encoder. A delay that is found here is the
servo's, and neither the tendon's nor the camera's. Units: those of the command, s. Limits: one channel is 1 number a
sample, and so at most THINNED samples, evenly thinned, are looked at; what acts behind the encoder is not seen.
Pinned by tests/diagnosis/test_servo.py.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.diagnosis.findings import ServoEffect, ServoError, ServoFinding
from softmap_edge.diagnosis.fit import Problem
from softmap_edge.diagnosis.fitted import parameters
from softmap_edge.diagnosis.record import Record
from softmap_edge.diagnosis.search import search
from softmap_edge.geometry.sections import FeatureMap
from softmap_edge.noise.noise_model import command_kernel, estimate_noise, form_covariance, whitener
from softmap_edge.run.run import Run

Floats = NDArray[np.float64]

THINNED = 1500
VISIBLE = 0.006  # of the range of the commands: the least RMS that counts, if the encoder's step is finer


@dataclass(frozen=True)
class Servo:
    """One servo as a model: what acts is what its encoder says. `step` is the encoder's resolution."""

    channel: int
    step: float
    robot: str = "servo"
    command_unit: str = "mm"
    command_range: Floats = field(default_factory=lambda: np.zeros((0, 2)))  # (1, 2)
    kind: str = "table"
    channels: int = 1
    chain_names: tuple[str, ...] = ()
    chain_params: Floats = field(default_factory=lambda: np.zeros(0))

    def commands(self, run: Run) -> Floats:
        """Return what was commanded (T, 1)."""
        return np.ascontiguousarray(run.commands("goal")[:, self.channel : self.channel + 1])

    def seen_features(self, run: Run) -> Floats:
        """Return what the encoder says (K, 1, 3) at the seen times; the number stands first."""
        told = np.interp(run.t_seen, run.t, run.commands("present")[:, self.channel])
        return np.stack([told, np.zeros_like(told), np.zeros_like(told)], axis=1)[:, None]

    def run_feature_map(self, run: Run) -> FeatureMap:
        """Return the map of one place."""
        return FeatureMap(np.eye(1), np.ones(1, bool), np.arange(1))

    def run_form_error(self, run: Run) -> Floats:
        """Return the resolution of the encoder, (1, 3)."""
        return np.array([[self.step, 0.0, 0.0]])

    def run_leaning(self, run: Run) -> Floats:
        """Return that no orientation matters, (K, 1)."""
        return np.ones((len(run.t_seen), 1))

    def acting(self, names: tuple[str, ...], params: Floats, run: Run) -> Floats:
        """Return what a chain of `names` makes of the command, (B, K, 1)."""
        chain = _core.Chain(list(names), 1)
        acts = chain.rollout(np.ascontiguousarray(params), self.commands(run), np.asarray(run.t, float))
        return np.stack([np.interp(run.t_seen, run.t, one[:, 0]) for one in acts])[..., None]

    def slopes(self, names: tuple[str, ...], params: Floats, step: Floats, run: Run) -> Floats:
        """Return the slopes (1, K, 1, 3) of what is seen over what acts."""
        return np.tile([1.0, 0.0, 0.0], (1, run.frames, 1, 1))

    def features_at(self, effective: Floats, run: Run) -> Floats:
        """Return the features (K, 1, 3) where the effective command is (K, 1)."""
        return np.concatenate([effective, np.zeros((len(effective), 2))], axis=1)[:, None]

    def slopes_at(self, effective: Floats, step: Floats, run: Run) -> Floats:
        """Return the slopes (1, K, 1, 3) of the encoder's features over the effective command."""
        return self.slopes((), effective, step, run)

    def predict_features(self, names: tuple[str, ...], params: Floats, run: Run) -> Floats:
        """Return features (B, K, 1, 3)."""
        acts = self.acting(names, params, run)
        return np.concatenate([acts, np.zeros((*acts.shape[:2], 2))], axis=2)[:, :, None]


def servos(run: Run, effects: list[str]) -> list[ServoFinding]:
    """Find the effects between command and encoder.

    Args:
        run: a run with commands (T, C) and encoder positions (T, C) in the same unit.
        effects: names of the candidates; those that act on the command before the encoder are tested.

    Returns:
        list: the effects between command and encoder of each channel that moves, with errors held out on blocks; empty
            where the run has no commands or no encoders.
    """
    if run.command is None or run.present is None or not len(run.t):
        return []
    # A user's own law may need all channels at once, which one servo is not.
    early = [e for e in _core.effects() if e["stage"] == "command" and not e["own"]]
    wanted = [e["name"] for e in early if e["role"] == "channel"]
    every = np.unique(np.linspace(0, len(run.t) - 1, min(len(run.t), THINNED)).astype(int))
    seen = replace(run, t_seen=np.asarray(run.t)[every], vertices=None, markers=None, points=None, start=None,
                   visible=None, sigma=None, block=None, marker_rest=None)  # fmt: skip
    return [
        found
        for channel in range(run.present.shape[1])
        if (found := _servo(seen, channel, [name for name in wanted if name in effects])) is not None
    ]


def _servo(run: Run, channel: int, candidates: list[str]) -> ServoFinding | None:
    told = np.abs(np.diff(run.commands("present")[:, channel]))
    moves = told[told > 1e-9]
    goal = run.commands("goal")[:, channel]
    span = float(np.ptp(goal))
    if not len(moves) or span < 1e-9:
        return None
    step = float(moves.min())
    reach = np.array([[goal.min(), goal.max()]])
    record = Record(Servo(channel, step, command_unit=run.command_unit, command_range=reach), run)
    base = record.predict((), np.zeros((1, 0)))[0]
    noise = estimate_noise(record.seen - base, record.t_seen, record.state.visit)
    form = form_covariance(record.form_error, record.positions, record.section)
    kernel = command_kernel(record.command, record.spread)
    signature = np.zeros((1, len(record), 3))
    signature[..., 0] = 1.0
    problem = Problem(record, noise, whitener(noise, form, signature, kernel))
    outcome = search(problem, candidates, visible=max(step, VISIBLE * span))
    fits = outcome.plain  # without families that have no law
    fit = fits.get(outcome.fit.effects, outcome.fit.space.split)
    sigma = problem.uncertainty(fit, fits.dispersion(fit)) if len(fit.x) else np.zeros(0)
    effects = tuple(ServoEffect(e, parameters(record, fit, sigma, (e,))) for e in fit.effects)
    error = ServoError(fits.held_out_mm(fits.null), fits.held_out_mm(fit))
    return ServoFinding(channel, run.command_unit, effects, error)
