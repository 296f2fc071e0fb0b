"""Make a model from a finger: sweep, fields, compression to modes, and a measured form error.

The form error is measured, not assumed: commands off the grid, solved on another mesh with the modulus
10 % up and 10 % down, against the table; per feature and over the vertices.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge import __version__
from softmap_edge.bundle import cables_from, fields_from, table_from
from softmap_edge.features import SECTIONS
from softmap_edge.finger import Finger
from softmap_edge.model import Arrays, Model, tip_of
from softmap_edge.run import Run
from softmap_edge.simulator import Compliance, Simulator, Sweep

Floats = NDArray[np.float64]
Progress = Callable[[str, float], None]

MODES = 16  # 12 modes hold the shapes of a finger to 0.016 mm
FIELD_MODES = 12
FIELD_STEPS = 11  # a field is smooth: a grid of 11 a channel
FORM_COMMANDS = 24
FORM_SEED = 20
SIDEWAYS = 0.7  # g across the reference, a lean of 35 degrees: where the error under another gravity is measured


def build_model(finger: Finger, steps: int = 41, progress: Progress | None = None, modes: int = MODES) -> Model:
    """Simulate `finger` over its command range and return its table model.

    `steps` commands a channel (odd, at least 5) over `finger.command_range`. `progress` is called with (what, share).
    Raises NoEquilibriumError where the simulator finds none, SoftmapError for a bad argument.
    """
    report: Progress = progress or (lambda what, share: None)
    simulator = Simulator(finger)
    Simulator(finger.other_mesh())  # the form error needs it: what cannot be built is refused before the sweep
    axes = [np.linspace(low, high, steps) for low, high in finger.command_range]
    sweep = simulator.sweep(axes, progress=lambda share: report("sweep", share))
    return from_sweep(finger, simulator, sweep, report, modes)


def from_sweep(finger: Finger, simulator: Simulator, sweep: Sweep, report: Progress, modes: int = MODES) -> Model:
    """Compress a sweep of `finger` to a table model, add its fields and measure its form error."""
    rest, triangles = simulator.template.vertices, simulator.template.triangles
    prior = compress(sweep.vertices.reshape(len(sweep.command), -1), modes)
    prior |= {f"axis{c}": np.asarray(axis) for c, axis in enumerate(sweep.axes)}
    prior["pull"] = sweep.pull.astype(np.float32)
    field_axes = [np.linspace(axis[0], axis[-1], FIELD_STEPS) for axis in sweep.axes]
    grid = np.stack([g.ravel() for g in np.meshgrid(*field_axes, indexing="ij")], axis=1)
    report("fields", 0.0)
    fields = _field_arrays(simulator.fields(grid), field_axes)
    fields["stiffness"] = np.full(len(finger.tendons), finger.cable_stiffness_n_mm)
    report("fields", 1.0)
    model = Model(
        kind="table",
        prior=table_from(prior),
        fields=fields_from(fields),
        cables=cables_from(prior, fields),
        rest=np.asarray(np.float32(rest), float),
        triangles=np.asarray(triangles, np.int32),
        form_error=np.zeros((3 * SECTIONS, 3)),
        vertex_error_mm=0.0,
        tip_indices=tip_of(sweep.vertices),
        gravity_reference=np.asarray(finger.gravity, float),
        command_range=np.array([[axis[0], axis[-1]] for axis in sweep.axes], float),
        robot=finger.name,
        made_from={"softmap-edge": __version__, "finger": finger.name, "steps": len(sweep.axes[0]), "modes": modes},
        arrays={"prior": prior, "fields": fields},
    )
    report("form error", 0.0)
    error, vertex_error, grown = form_error(model, finger, simulator)
    report("form error", 1.0)
    return replace(model, form_error=error, vertex_error_mm=vertex_error, error_per_g_mm=grown)


def compress(values: Floats, modes: int) -> Arrays:
    """Return `mean` (M,), `modes` (m, M) and `coefficients` (S, m) of values (S, M), stored as float32."""
    mean = values.mean(axis=0)
    centred = values - mean
    basis = leading(centred, modes)
    return {
        "mean": mean.astype(np.float32),
        "modes": basis.astype(np.float32),
        "coefficients": (centred @ basis.T).astype(np.float32),
    }


def form_error(model: Model, finger: Finger, simulator: Simulator) -> tuple[Floats, float, float]:
    """Measure the model's own error at held-out commands: RMS (V, 3) mm of its features, RMS mm of its vertices, and by
    how much the latter grows for each g by which gravity differs from the reference.

    The truth has another mesh and a modulus 10 % lower and higher; the same template points are seen. The modulus
    matters under the weight of a leaning body, hardly under tendons whose shortening is given.
    """
    rng = np.random.default_rng(FORM_SEED)
    low, high = model.command_range.T
    commands = rng.uniform(low * 0.85, high * 0.85, (FORM_COMMANDS, model.channels))
    predicted = model.prior.evaluate(commands).reshape(FORM_COMMANDS, -1, 3)
    leaning = _leaning(model.gravity_reference)
    t = np.arange(FORM_COMMANDS, dtype=float)
    leaned = model.predict(Run(t=t, command=commands, gravity=leaning, t_seen=t))
    squares, vertex_squares, leaning_squares = [], [], []
    for factor in (0.9, 1.1):
        other = Simulator(finger.other_mesh().replace(young_mpa=finger.young_mpa * factor), template=simulator.template)
        error = other.path(commands) - predicted
        squares.append(model.feature_map(error) ** 2)
        vertex_squares.append((error**2).sum(axis=2))
        leaning_squares.append(((other.path(commands, gravity=leaning) - leaned) ** 2).sum(axis=2))
    upright, aslant = float(np.mean(vertex_squares)), float(np.mean(leaning_squares))
    grown = float(np.sqrt(max(aslant - upright, 0.0)) / np.linalg.norm(leaning - model.gravity_reference))
    return np.sqrt(np.mean(np.concatenate(squares), axis=0)), float(np.sqrt(upright)), grown


def _leaning(gravity: Floats) -> Floats:
    """Return the unit gravity (3,) of the finger turned so that `gravity` (3,) g gets SIDEWAYS across it."""
    across = np.eye(3)[int(np.argmin(np.abs(gravity)))]
    across = across - (across @ gravity) * gravity / max(gravity @ gravity, 1e-9)
    leaning = gravity + SIDEWAYS * across / np.linalg.norm(across)
    return np.asarray(leaning / np.linalg.norm(leaning))


def _field_arrays(compliance: Compliance, axes: list[Floats]) -> Arrays:
    """Compress all fields to modes that they share; `coefficients_NAME` on the grid of `axes`, and `stretch`."""
    fields = compliance.fields
    names = sorted(fields)
    flat = np.concatenate([fields[name].reshape(len(fields[name]), -1) for name in names])
    scale = np.concatenate([np.full(len(fields[n]), np.sqrt((fields[n] ** 2).mean()) + 1e-12) for n in names])
    basis = leading(flat / scale[:, None], FIELD_MODES)
    arrays: Arrays = {f"axis{c}": axis for c, axis in enumerate(axes)}
    arrays["modes"] = basis.astype(np.float16)
    stored = arrays["modes"].astype(float)
    for name in names:
        values = fields[name].reshape(len(fields[name]), -1)
        arrays[f"coefficients_{name}"] = np.linalg.lstsq(stored.T, values.T, rcond=None)[0].T.astype(np.float32)
    arrays["stretch"] = compliance.stretch.reshape(len(compliance.stretch), -1).astype(np.float32)
    return arrays


def leading(values: Floats, modes: int) -> Floats:
    """Return the `modes` leading right singular vectors (m, M) of values (S, M)."""
    if len(values) < values.shape[1]:
        _, vectors = np.linalg.eigh(values @ values.T)
        return np.ascontiguousarray(np.linalg.qr(values.T @ vectors[:, ::-1][:, :modes])[0].T)
    _, directions = np.linalg.eigh(values.T @ values)
    return np.ascontiguousarray(directions[:, ::-1][:, :modes].T)
