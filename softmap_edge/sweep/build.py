"""Make a model from an imported sweep: commands and shapes of another simulator.

They may also come from motion capture.

A tensor grid of commands becomes a table, scattered commands become radial basis functions; loads
bend the sweep's own centreline (`bending.py`). The model error is measured by cross-validation:
without every other node of a table, or without neighbourhoods of rows of a scattered sweep. It
measures the interpolation of the sweep, not the match of its simulator with the robot.

A table with half the nodes has the error `e` at the omitted nodes. The error of the full table is
estimated as e/2^p. The order p follows from the errors of half and quarter grid, between 1 (kinks)
and 3 (smooth, rust/shape/cubic.rs), or is 1.5 if a quarter is too coarse.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import SweepError, brief
from softmap_edge.fem.build import FIELD_STEPS, Progress, from_sweep, leading, simulator_of
from softmap_edge.fem.simulator import Sweep, tensor_grid
from softmap_edge.files.atomic import Document
from softmap_edge.files.npz import Stored
from softmap_edge.geometry.centreline import Centreline, farthest, find_centreline
from softmap_edge.geometry.sections import tip_of
from softmap_edge.model.model import NOMINAL, Model
from softmap_edge.model.safety import derived
from softmap_edge.model.shapes import BundleArrays, FieldArrays, Grid, ModeArrays, PriorArrays
from softmap_edge.model.structure import Structure
from softmap_edge.sweep.bending import Stiffness, fields, weigh
from softmap_edge.sweep.scattered import fit_scattered
from softmap_edge.sweep.stiff_sections import stretch_fields
from softmap_edge.sweep.sweep_file import ShapeSweep, is_own_sweep, is_shape_sweep
from softmap_edge.version import __version__

Floats = NDArray[np.float64]
# held-out errors of coefficients (n, m), and remainder outside the modes (n, M)
Errors = list[tuple[Floats, Floats]]

MODES = 48  # most modes
HELD = 1e-4  # of the motion: allowed remainder outside the modes
MODE_ROWS = 1500  # most shapes for computing the modes
FIELD_MODES = 12
FIELD_NODES = 120  # commands of a scattered sweep at which loads are computed
FIELD_NUMBERS = 3_500_000  # commands × points: memory limit of the fields
KINK_ORDER = 1.5
WIDE = 0.25  # of half the range: gaps between scattered commands that are reported
PROGRESS: Progress = lambda what, share: None  # noqa: E731


def model_from_file(path: str | Path, progress: Progress | None = None) -> Model:
    """Return the model of a sweep file: of `softmap model sweep`, or an imported one.

    A sweep of `softmap model sweep` gives the model of its finger.

    Raises:
        SoftmapError: a field is missing or wrong; the message is one line.
    """
    file, report = Path(path), progress or PROGRESS
    if not file.is_file():
        raise SweepError(f"{file}: no such file; give a sweep (.npz) or a finger.toml")
    if is_shape_sweep(file) and is_own_sweep(file):
        return _as_from_its_finger(file, report)
    sweep = ShapeSweep.load_file(file)
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    try:
        return model_from_shapes(sweep, {"sweep": file.name, "sha256": digest}, report)
    except np.linalg.LinAlgError as fault:
        raise SweepError(
            f"{file.name}: its numbers make no model ({brief(fault)}); make the sweep again"
        ) from None


def _as_from_its_finger(path: Path, report: Progress) -> Model:
    sweep = Sweep.load(path)
    if not np.array_equal(sweep.gravity, sweep.finger.gravity) or np.any(sweep.tip_force):
        raise SweepError(
            f"{path.name}: made under gravity {sweep.gravity.tolist()} and a tip force of "
            f"{sweep.tip_force.tolist()} N, its finger hangs under {list(sweep.finger.gravity)} "
            "without; make it with `softmap model sweep finger.toml`"
        )
    return from_sweep(sweep.finger, simulator_of(sweep.finger), sweep, report)


def model_from_shapes(
    sweep: ShapeSweep, source: Document | None = None, progress: Progress = PROGRESS
) -> Model:
    """Return the model of a checked sweep; `source` joins `made_from`.

    Raises:
        SoftmapError: the points do not begin at the base, or the known load cannot be used.
    """
    progress("modes", 0.0)
    notes = list(sweep.notes)
    flat = sweep.vertices.reshape(len(sweep.vertices), -1)
    mean, modes = _modes(flat)
    values = (flat - mean.astype(float)) @ modes.astype(float).T
    if sweep.axes is None:
        fit = fit_scattered(sweep.command, values)
        prior = fit.of_modes(mean, modes)
        left, rows = fit.left_out, fit.tested
        how = {"kernel": f"r^{fit.power}", "smoothing": fit.smoothing, "nodes": len(fit.nodes)}
        notes += _gaps(fit.reach)
    else:
        coefficients = Stored(values.astype(np.float32))
        prior = ModeArrays(Grid(sweep.axes), mean, Stored(modes), coefficients)
        left, rows, order = _left_out_of_grid(sweep.axes, values)
        how = {"grid": [len(axis) for axis in sweep.axes], "order": order}
    shape = prior.compiled()
    rest = np.asarray(np.float32(_home(shape, sweep.command)), float)
    line = find_centreline(rest, sweep.base)
    _stands_on_its_base(line, sweep.vertices)
    model = Model(
        structure=Structure(
            prior=shape,
            fields={},
            rest=rest,
            triangles=sweep.triangles,
            tip_indices=tip_of(sweep.vertices[:: max(1, len(flat) // MODE_ROWS)]),
            gravity_reference=np.array([0.0, 0.0, 1.0]) if sweep.gravity is None else sweep.gravity,
            command_range=np.stack([sweep.command.min(axis=0), sweep.command.max(axis=0)], axis=1),
            body=line.body(),
        ),
        kind="table" if sweep.axes is not None else "scattered",
        form_error=np.zeros((1, 3)),
        vertex_error_mm=0.0,
        robot=sweep.robot,
        command_unit=sweep.command_unit,
    )
    progress("model-form error", 0.4)
    form_error, vertex_error = _error(model, prior, flat[rows], values[rows], left)
    progress("fields", 0.7)
    stiffness = _stiffness(sweep, line, shape, vertex_error)
    stored = _fields(sweep, line, shape, stiffness)
    progress("fields", 1.0)
    made_from = {
        "softmap-edge": __version__,
        **(source or {}),
        "commands": len(flat),
        "modes": len(modes),
        **how,
        "held_out": "interpolation of the sweep, by leaving out",
        "notes": notes,
        "gravity": "as given" if sweep.gravity is not None else "not given, taken as hanging",
        "length_mm": round(line.length, 4),
        "lean_deg": round(line.lean_deg, 3),
        "bow_mm": round(line.bow_mm, 4),
        "compliance": _described(stiffness),
    }
    return replace(
        model.with_structure(fields=stored.compiled(), stiffness_known=stiffness.known),
        form_error=form_error,
        vertex_error_mm=vertex_error,
        made_from=made_from,
        arrays=BundleArrays(PriorArrays(prior), stored),
        safety=derived(model),
    )


def _modes(flat: Floats) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the mean (M,) and modes (m, M) that represent shapes (S, M) to HELD."""
    some = flat[:: max(1, -(-len(flat) // MODE_ROWS))]
    mean = flat.mean(axis=0)
    basis = leading(some - mean, min(MODES, *some.shape))
    weights = (some - mean) @ basis.T
    left = np.sum((some - mean) ** 2) - np.cumsum(np.sum(weights**2, axis=0))
    enough = np.flatnonzero(left <= HELD**2 * np.sum((some - mean) ** 2))
    count = int(enough[0]) + 1 if len(enough) else len(basis)
    return mean.astype(np.float32), basis[:count].astype(np.float32)


def _gaps(reach: float) -> list[str]:
    if reach <= WIDE:
        return []
    return [
        f"the commands leave gaps: one between two of them lies {100 * reach:.0f} % of half the "
        "range from the nearest; the model is a guess there, and its stated error may be too "
        "small"
    ]


def _home(shape: _core.Shape, command: Floats) -> Floats:
    """Return the shape (N, 3) mm at the command closest to zero."""
    zero = np.clip(np.zeros(command.shape[1]), command.min(axis=0), command.max(axis=0))
    return np.asarray(shape.evaluate(zero[None])).reshape(-1, 3)


def _stands_on_its_base(line: Centreline, vertices: Floats) -> None:
    """Reject a sweep whose points near the base move more than those far from it.

    Its frame is then not the base frame.
    """
    moved = np.sqrt(np.mean(np.sum((vertices - vertices.mean(axis=0)) ** 2, axis=2), axis=0))
    low, high = np.quantile(line.along, [0.2, 0.8])
    near, far = float(moved[line.along <= low].mean()), float(moved[line.along >= high].mean())
    if near > far:
        raise SweepError(
            f"the points nearest to the base at {np.round(line.base, 3).tolist()} move by "
            f"{near:.3g} mm RMS, those farthest from it by {far:.3g} mm; the origin of the base "
            "frame belongs at the clamped end: move the points, or give `base`"
        )


def _left_out_of_grid(
    axes: tuple[Floats, ...], values: Floats
) -> tuple[Floats, NDArray[np.intp], float]:
    """Estimate the errors (n, m) of the full grid at nodes omitted from a coarser grid.

    The coarser grid has half as many nodes. Also return those nodes, and the order.
    """
    shape = [len(axis) for axis in axes]
    half, nodes = _coarser(axes, values, 2)
    order = KINK_ORDER
    if min(shape) >= 9:
        quarter, _ = _coarser(axes, values, 4)
        sizes = [max(float(np.sqrt(np.mean(np.sum(e**2, axis=1)))), 1e-12) for e in (quarter, half)]
        order = float(np.clip(np.log2(sizes[0] / sizes[1]), 1.0, 3.0))
    return half / 2.0**order, nodes, round(order, 2)


def _coarser(
    axes: tuple[Floats, ...], values: Floats, stride: int
) -> tuple[Floats, NDArray[np.intp]]:
    """Return the errors at the nodes omitted from a coarser grid, and those nodes.

    The coarser grid has every `stride`-th node, and the last.
    """
    kept = [np.unique(np.r_[np.arange(0, len(axis), stride), len(axis) - 1]) for axis in axes]
    grid = np.arange(len(values)).reshape([len(axis) for axis in axes])
    inside = grid[np.ix_(*kept)].ravel()
    outside = np.setdiff1d(grid.ravel(), inside)
    size = values.shape[1]
    coarse = _core.Table(
        [axis[k] for axis, k in zip(axes, kept)],
        np.ascontiguousarray(values[inside]),
        np.zeros(size),
        np.eye(size),
    )
    commands = tensor_grid(axes)[outside]
    return coarse.evaluate(np.ascontiguousarray(commands)) - values[outside], outside


def _error(
    model: Model, prior: ModeArrays, flat: Floats, values: Floats, left: Floats
) -> tuple[Floats, float]:
    """Return the RMS error (V, 3) mm of each feature, and of the vertices (mm).

    It is computed from errors `left` (n, m) of the weights.

    The part of the shapes `flat` (n, M) outside the modes is included.
    """
    modes, mean = prior.modes.values, prior.mean.astype(float)
    squares, vertex = np.zeros((len(model.structure.feature_map.weights), 3)), 0.0
    for k in range(0, len(flat), 64):
        rows = slice(k, k + 64)
        error = (left[rows] @ modes + mean + values[rows] @ modes - flat[rows]).reshape(
            len(flat[rows]), -1, 3
        )
        squares += np.sum(model.structure.feature_map(error) ** 2, axis=0)
        vertex += float(np.sum(error**2)) / error.shape[1]
    return np.sqrt(squares / len(flat)), float(np.sqrt(vertex / len(flat)))


def _stiffness(
    sweep: ShapeSweep, line: Centreline, shape: _core.Shape, own_error: float
) -> Stiffness:
    if sweep.load is None:
        return Stiffness.nominal(line)
    assert sweep.loaded_command is not None and sweep.loaded_vertices is not None
    assert sweep.gravity is not None and sweep.mass is not None
    unloaded = shape.evaluate(np.ascontiguousarray(sweep.loaded_command)).reshape(
        sweep.loaded_vertices.shape
    )
    force = sweep.load[:, None] * 1e-3 * _core.STANDARD_GRAVITY * sweep.gravity
    return weigh(line, unloaded, sweep.loaded_vertices, force, sweep.mass, own_error)


def _fields(
    sweep: ShapeSweep, line: Centreline, shape: _core.Shape, stiffness: Stiffness
) -> FieldArrays:
    """Return the load fields: on a coarser grid, or over some of the scattered commands."""
    points = sweep.vertices.shape[1]
    if sweep.axes is not None:
        steps = FIELD_STEPS
        while steps ** len(sweep.axes) * points > FIELD_NUMBERS and steps > 3:
            steps -= 1
        axes = [np.linspace(axis[0], axis[-1], min(steps, len(axis))) for axis in sweep.axes]
        commands = tensor_grid(axes)
    else:
        scaled = sweep.command / np.ptp(sweep.command, axis=0)
        commands = sweep.command[farthest(scaled, min(FIELD_NODES, FIELD_NUMBERS // points))]
    shapes = shape.evaluate(np.ascontiguousarray(commands)).reshape(len(commands), -1, 3)
    rest = np.asarray(_home(shape, sweep.command), float)
    both = fields(line, shapes, stiffness) | stretch_fields(line, shapes, rest, stiffness.lock)
    found = {name: field.reshape(len(commands), -1) for name, field in both.items()}
    basis = leading(np.concatenate(list(found.values())), min(FIELD_MODES, 3 * points))
    modes = Stored(basis.astype(np.float32))
    values = {name: field @ np.linalg.pinv(modes.values) for name, field in found.items()}
    if sweep.axes is not None:
        kept = {name: Stored(value.astype(np.float32)) for name, value in values.items()}
        return FieldArrays(Grid(tuple(axes)), modes, kept)
    together = fit_scattered(commands, np.concatenate(list(values.values()), axis=1))
    parts = np.split(together.coefficients, len(values), axis=1)
    # in double precision: weights of radial basis functions cancel
    return FieldArrays(together.over, modes, dict(zip(values, map(Stored, parts))))


def _described(stiffness: Stiffness) -> Document | str:
    if not stiffness.known:
        return NOMINAL
    return {
        "per_n_mm2": float(f"{stiffness.compliance:.6g}"),
        "lock": round(stiffness.lock, 4),
        "weight_n": round(stiffness.weight, 6),
        "known_load_moved_mm": round(stiffness.moved_mm, 4),
        "residual_mm": round(stiffness.residual_mm, 4),
    }
