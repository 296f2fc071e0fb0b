"""Effects of the servos, separate from those of the tendons.

They act between command and encoder, if a run has both.

Each channel is a separate model whose shape is the command: command → chain of command effects →
encoder. So the search for missing effects also finds those of the servo. A delay found here belongs
to the servo, not to the tendon or the camera. Units: those of the command, s. Limits: a channel has
one value per sample; at most THINNED samples, evenly spread, are used. Effects after the encoder
are not visible. Pinned by tests/diagnosis/test_servo.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.diagnosis.findings import ServoEffect, ServoError, ServoFinding
from softmap_edge.diagnosis.fit import Problem
from softmap_edge.diagnosis.fitted import parameters
from softmap_edge.diagnosis.record import Record
from softmap_edge.diagnosis.search import search
from softmap_edge.model.effect_info import registry
from softmap_edge.model.model import Model
from softmap_edge.model.structure import Structure
from softmap_edge.noise.noise_model import command_kernel, estimate_noise, form_covariance, whitener
from softmap_edge.run.run import Run

Floats = NDArray[np.float64]

THINNED = 1500
# of the command range: least RMS that counts, if the encoder's step is finer
VISIBLE = 0.006


def servo_model(step: float, command_range: Floats, unit: str = "mm") -> Model:
    """Return a servo as a model: a marker whose x is the encoder's reading.

    The marker equals the effective command.

    Args:
        step: resolution of the encoder, in the unit of the command.
        command_range: (1, 2), lowest and highest command.
        unit: that of the command.
    """
    axis = np.ascontiguousarray(command_range[0], float)
    structure = Structure(
        prior=_core.Table([axis], axis[:, None], np.zeros(3), np.eye(1, 3)),
        fields={},
        rest=np.zeros((1, 3)),
        triangles=np.zeros((0, 3), np.int32),
        tip_indices=np.zeros(1, np.int64),
        gravity_reference=np.array([0.0, 0.0, 1.0]),
        command_range=np.asarray(command_range, float),
    )
    return Model(
        "table", structure, np.array([[step, 0.0, 0.0]]), step, robot="servo", command_unit=unit
    )


def encoder_run(run: Run, channel: int, t_seen: Floats) -> Run:
    """Return a servo's commands (T, 1) as a run with its encoder as the x of a marker.

    The encoder is sampled at `t_seen` (K,).
    """
    markers = np.zeros((len(t_seen), 1, 3))
    markers[:, 0, 0] = np.interp(t_seen, run.t, run.commands("present")[:, channel])
    goal = np.ascontiguousarray(run.commands("goal")[:, channel : channel + 1])
    return Run(t=run.t, command=goal, t_seen=t_seen, markers=markers, command_unit=run.command_unit)


def servos(run: Run, effects: list[str]) -> list[ServoFinding]:
    """Find the effects between command and encoder.

    Args:
        run: a run with commands (T, C) and encoder positions (T, C) in the same unit.
        effects: names of the candidates; those on the command before the encoder are tested.

    Returns:
        list: the effects between command and encoder of each moving channel, with errors held out
            on blocks; empty if the run has no commands or no encoders.
    """
    if run.command is None or run.present is None or not len(run.t):
        return []
    # A user-defined law may need all channels at once; a servo has one.
    early = [e for e in registry().values() if e.stage == "command" and not e.own]
    requested = [e.name for e in early if e.on_commands]
    every = np.unique(np.linspace(0, len(run.t) - 1, min(len(run.t), THINNED)).astype(int))
    t_seen = np.asarray(run.t, float)[every]
    return [
        found
        for channel in range(run.present.shape[1])
        if (found := _servo(run, channel, t_seen, [name for name in requested if name in effects]))
        is not None
    ]


def _servo(run: Run, channel: int, t_seen: Floats, candidates: list[str]) -> ServoFinding | None:
    steps = np.abs(np.diff(run.commands("present")[:, channel]))
    moves = steps[steps > 1e-9]
    goal = run.commands("goal")[:, channel]
    span = float(np.ptp(goal))
    if not len(moves) or span < 1e-9:
        return None
    step = float(moves.min())
    reach = np.array([[goal.min(), goal.max()]])
    record = Record(servo_model(step, reach, run.command_unit), encoder_run(run, channel, t_seen))
    base = record.predict((), np.zeros((1, 0)))[0]
    noise = estimate_noise(record.seen - base, record.t_seen, record.state.visit)
    form = form_covariance(record.form_error, record.positions, record.section)
    kernel = command_kernel(record.command, record.spread)
    signature = np.zeros((1, len(record), 3))
    signature[..., 0] = 1.0
    problem = Problem(record, noise, whitener(noise, form, signature, kernel))
    outcome = search(problem, candidates, visible=max(step, VISIBLE * span))
    fits = outcome.plain  # without families lacking a law
    fit = fits.get(outcome.fit.effects, outcome.fit.space.split)
    sigma = problem.uncertainty(fit, fits.dispersion(fit)) if len(fit.x) else np.zeros(0)
    effects = tuple(ServoEffect(e, parameters(record, fit, sigma, (e,))) for e in fit.effects)
    error = ServoError(fits.held_out_mm(fits.null), fits.held_out_mm(fit))
    return ServoFinding(channel, run.command_unit, effects, error)
