"""Train a prior on a simulated set, and replace the table of a bundle by it.

The network is the paper's, or ours.

    û = f_θ(u),   loss = mean over the set of |f_θ(ũ) − ỹ|², ỹ what the last, fixed layer makes the
                  outputs of

modes       ours: weights of the leading modes of the training shapes, all in one unit: the loss is
            the error in mm²
published   the paper's, each output by its own mean and spread; also without its dropout
laplacian, arap   the paper's layers to the shapes as `encodings.py` describes them, each number by
                  its own mean and
spread
linear      least squares, no training
table, gp, xgboost   regressors (`baselines.py`), as a table over the axes of the bundle: that is
                     what is evaluated
deepsoro    a decoder (`deepsoro.py`) as a bundle of its own points, which are no vertices
            (`decoder_model`)

Errors are reported on the test part of one frozen split, at commands outside the training part. The
rest of the bundle (fields, tendons, effects) does not change. A residual is dropped, because it was
learned on another prior. Units: mm. Pinned by tests/training/test_training.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from softmap_edge import _core
from softmap_edge.alignment.register import clamped
from softmap_edge.fem.simulator import tensor_grid
from softmap_edge.files.npz import Stored
from softmap_edge.geometry.sections import tip_of
from softmap_edge.model.model import Model
from softmap_edge.model.onnx import run_onnxruntime, table_from_onnxruntime
from softmap_edge.model.shapes import (
    BundleArrays,
    FieldArrays,
    Grid,
    ModeArrays,
    NetworkArrays,
    PriorArrays,
    TrainedOver,
)
from softmap_edge.model.structure import Structure
from softmap_edge.model.training_range import BEYOND, UNLIKE, span
from softmap_training import baselines, encodings
from softmap_training.choices import PRIOR_MODES, PRIOR_WIDTHS, PriorKind, Recipe, prior_recipe
from softmap_training.deepsoro import fit_deepsoro
from softmap_training.errors import TrainingError
from softmap_training.export import checked, to_onnx
from softmap_training.fit import Progress, Task, fit, seeded
from softmap_training.networks import Modes, mode_prior, published_prior

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

PUBLISHED_DROPOUT = 0.1
NODES = 41  # nodes of an axis, if the bundle has none
# shapes compared with the bundle's, and allowed excess over its model error
COMPARED, OWN = 64, 3.0
BIGGEST = 10.0  # times the robot's length from its base: invalid points


@dataclass(frozen=True, eq=False)
class Surface:
    """The template that encodings need: vertices at rest (N, 3) mm, triangles (F, 3), and `held`.

    `held` are the clamped vertices.
    """

    rest: Floats
    triangles: NDArray[np.int32]
    held: Indices

    @classmethod
    def of(cls, model: Model) -> Surface:
        """Return the template of a model."""
        return cls(model.rest, model.triangles, clamped(model))


@dataclass(frozen=True)
class Trained:
    """A trained network, its ONNX file, and its report."""

    network: nn.Sequential
    content: bytes
    report: dict[str, Any]

    def arrays(self, grid: Grid) -> NetworkArrays:
        """Return its data for a bundle, with a grid."""
        return NetworkArrays(self.content, grid)


@dataclass(frozen=True)
class Tabulated:
    """A regressor as the arrays of a table, and its report."""

    table: ModeArrays
    report: dict[str, Any]

    def arrays(self, _grid: Grid) -> ModeArrays:
        """Return its data for a bundle: its table with its own grid."""
        return self.table


def train_prior(
    commands: Floats,
    points: Floats,
    parts: tuple[Indices, Indices, Indices],
    kind: PriorKind = "modes",
    surface: Surface | None = None,
    recipe: Recipe | None = None,
    folder: Path | None = None,
    progress: Progress | None = None,
    device: str = "cpu",
    tensorboard: bool = False,
) -> Trained:
    """Train a network from commands (S, C) mm to points (S, 3N) mm.

    Args:
        commands, points: the simulated set.
        parts: indices of training, validation and test parts.
        kind: a kind of network from the list above.
        surface: the template for "laplacian" and "arap".
        recipe: replaces the recipe of `choices.py`.
        folder: folder of checkpoints and logs.
        progress: called with the completed share and a line.
        device: "cpu" or "cuda".
        tensorboard: whether to write events of TensorBoard.

    Raises:
        TrainingError: too few samples, or a checkpoint of another training.
    """
    train, validation, test = parts
    _enough(parts)
    recipe = recipe or prior_recipe(kind)
    seeded(recipe.seed)
    network, targets, fixed = _made(kind, commands, points, train, surface)
    u, target = (torch.as_tensor(array, dtype=torch.float32) for array in (commands, targets))
    rows = torch.as_tensor(train)

    def loss(net: nn.Sequential, some: Tensor) -> Tensor:
        chosen = rows.to(some.device)[some]
        return (
            (net[:-fixed](u.to(some.device)[chosen]) - target.to(some.device)[chosen])
            .square()
            .mean()
        )

    def validate(net: nn.Sequential) -> float:
        at = next(net.parameters()).device
        return vertex_error(
            net(u[torch.as_tensor(validation)].to(at)).cpu().numpy(), points[validation]
        )

    task = Task(network, len(train), loss, validate, [commands, points, train])
    log = [] if kind == "linear" else fit(task, recipe, folder, progress, device, tensorboard)
    content = to_onnx(network, commands.shape[1], {"kind": kind, "seed": str(recipe.seed)})
    apart = checked(network, content, commands[test][:256])
    core = _core.Network(content)
    report = {
        "kind": kind,
        "seed": recipe.seed,
        "epochs": len(log),
        "planned_epochs": len(log) if kind == "linear" else recipe.epochs,
        "seconds": sum(row["seconds"] for row in log),
        "parameters": core.parameters,
        "parity_mm": apart,
        **_evaluated(commands[train], core.evaluate(commands[test]), points[test]),
    }
    return Trained(network, content, report)


def fit_prior(
    base: Model,
    commands: Floats,
    points: Floats,
    parts: tuple[Indices, Indices, Indices],
    kind: str,
    seed: int = 0,
) -> Tabulated:
    """Fit a regressor from commands (S, C) mm to points (S, 3N) mm, and tabulate it.

    The nodes of the table are those of a model's axes.

    Raises:
        TrainingError: points that are not vertices, a set of another finger, or a missing
            dependency.
    """
    if kind == "deepsoro":
        raise TrainingError(
            "the points of 'deepsoro' are no vertices, so it joins no bundle; see `decoder_model`"
        )
    check_set(base, commands, points)
    _enough(parts)
    train, _, test = parts
    fitted = baselines.fit_baseline(
        cast(baselines.Name, kind), commands[train], points[train], seed
    )
    axes = [np.asarray(axis, np.float64) for axis in _grid(base).axes]
    axes = axes or [np.linspace(low, high, NODES) for low, high in base.command_range]
    mean, modes, weights = baselines.reduced(fitted.predict(tensor_grid(axes)))
    arrays = ModeArrays(
        Grid(tuple(axes)),
        mean.astype(np.float32),
        Stored(modes.astype(np.float32)),
        Stored(weights.astype(np.float32)),
    )
    found = arrays.compiled().evaluate(commands[test])
    report = {"kind": kind, "seed": seed, "seconds": fitted.seconds}
    report["parameters"] = sum(array.size for array in arrays.to_npz().values())
    return Tabulated(arrays, report | _evaluated(commands[train], found, points[test]))


def decoder_model(
    base: Model,
    commands: Floats,
    points: Floats,
    parts: tuple[Indices, Indices, Indices],
    epochs: int | None = None,
    seed: int = 0,
    folder: Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> tuple[Model, dict[str, Any]]:
    """Train a decoder on shapes (S, 3N) mm at commands (S, C) mm; return model and report.

    Its points are those of its own sheet; their rest positions are those at home. Its tip is the 5
    % of them that move most. It has no fields, effects or calibration of the base. It is evaluated
    by half the Chamfer distance.

    Args:
        base: the model of the finger.
        commands, points, parts: as for `train_prior`.
        epochs: replaces the default number.
        seed: seed of the initial weights.
        folder: folder of checkpoints.
        progress: called with the completed share.

    Raises:
        TrainingError: a set of another finger.
    """
    check_set(base, commands, points)
    _enough(parts)
    train, validation, test = parts
    shapes = points.reshape(len(points), -1, 3)
    some = np.sort(np.concatenate([train, validation]))
    held = np.searchsorted(some, validation)
    bodies = [np.ascontiguousarray(shape) for shape in shapes[some]]
    fitted = fit_deepsoro(
        commands[some], bodies, len(base.rest), seed, held, epochs, folder, progress
    )
    content = fitted.onnx or b""
    found = run_onnxruntime(content, commands)
    sheet = found.reshape(len(found), -1, 3)
    apart = np.array([_chamfer(sheet[k], shapes[k]) for k in test])
    rest = run_onnxruntime(content, np.zeros((1, base.channels))).reshape(-1, 3)
    report = {
        "kind": "deepsoro",
        "seed": seed,
        "seconds": fitted.seconds,
        "parameters": fitted.numbers,
        "samples": len(train),
        "command_range": span(commands[train]),
        "test_chamfer_mm": float(apart.mean()),
    }
    arrays, tabulated = table_from_onnxruntime(
        "prior.onnx", content, base.command_range, Grid(), "a decoder is no chain of layers"
    )
    half = float(np.sqrt(np.mean((apart / 2) ** 2)))
    triangles = np.zeros((0, 3), np.int32) if fitted.triangles is None else fitted.triangles
    bare = Model(
        structure=Structure(
            prior=arrays.compiled(),
            fields={},
            rest=rest,
            triangles=triangles,
            tip_indices=tip_of(sheet),
            gravity_reference=base.gravity_reference,
            command_range=base.command_range,
        ),
        kind="network",
        form_error=np.zeros((0, 3)),
        vertex_error_mm=half,
        robot=base.robot,
        command_unit=base.command_unit,
        input=base.input,
        made_from={"prior": report},
        arrays=BundleArrays(PriorArrays(NetworkArrays(content)), FieldArrays()),
    )
    form = np.full((len(bare.structure.positions), 3), half / np.sqrt(3.0))
    return replace(bare, form_error=form), report | {"table_off_mm": tabulated["table_off_mm"]}


def _chamfer(one: Floats, other: Floats) -> float:
    found = _core.chamfer(np.ascontiguousarray(one), np.ascontiguousarray(other))
    return float(found["there"] + found["back"])


def _evaluated(taught: Floats, found: Floats, points: Floats) -> dict[str, Any]:
    """Return the report of a prior: its training commands and its error on the test part."""
    return {
        "samples": len(taught),
        "command_range": span(taught),
        "test_vertex_mm": vertex_error(found, points),
        "test_rms_mm": rms(found - points),
    }


def _made(
    kind: PriorKind, commands: Floats, points: Floats, train: Indices, surface: Surface | None
) -> tuple[nn.Sequential, Floats, int]:
    """Return a network, its targets (S, m) before its last layers, and their count.

    The last layers are fixed.
    """
    if kind == "modes":
        network = mode_prior(commands[train], points[train], PRIOR_WIDTHS, PRIOR_MODES)
        last = network[-1]
        mean, modes = (b.numpy().astype(np.float64) for b in (last.mean, last.modes))
        return network, (points - mean) @ np.linalg.pinv(modes), 1
    if kind == "linear":
        rows = np.column_stack([commands, np.ones(len(commands))])
        found = np.linalg.lstsq(rows[train], points[train], rcond=None)[0]
        return nn.Sequential(Modes(found[-1], found[:-1])), points, 1
    if kind in ("laplacian", "arap"):
        if surface is None:
            raise TrainingError(
                f"'{kind}' needs the surface of shapes; give the model of the finger"
            )
        encode = encodings.laplacian if kind == "laplacian" else encodings.arap
        codes = encode(surface.rest, surface.triangles, surface.held, points)
        network = published_prior(commands[train], codes.codes[train], PUBLISHED_DROPOUT)
        network.append(Modes(codes.mean, codes.modes))
        return network, _normalised(network[-2], codes.codes), 2
    network = published_prior(
        commands[train], points[train], PUBLISHED_DROPOUT if kind == "published" else 0.0
    )
    return network, _normalised(network[-1], points), 1


def _normalised(last: Any, values: Floats) -> Floats:
    """Return the inputs of a last layer that scales to the spread of values (S, m)."""
    return np.asarray((values - last.shift.numpy()) / last.size.numpy())


def with_prior(
    base: Model, trained: Trained | Tabulated, commands: Floats, points: Floats
) -> Model:
    """Replace the prior of a bundle's model by a trained one.

    `commands` and `points` are the test part.

    The squared error of the trained prior is added to that of the model.

    Raises:
        TrainingError: the prior is of other commands or points than the model.
    """
    check_set(base, commands, points)
    stored = base.arrays
    if stored is None:
        raise TrainingError(f"the model of '{base.robot}' has no arrays; load it from a bundle")
    arrays = trained.arrays(_grid(base))
    core, kept = arrays.compiled(), stored.prior
    base = base.with_residual(None)
    # that of the table, not of an earlier trained prior
    own_error = TrainedOver(np.asarray(base.form_error, np.float64), base.vertex_error_mm)
    before = kept.before if isinstance(kept.before, TrainedOver) else own_error
    form, error = before.form_error, before.vertex_error_mm
    prior = PriorArrays(arrays, pull=kept.pull, before=before)
    missed = (core.evaluate(commands) - points).reshape(len(points), -1, 3)
    own = np.sqrt(np.mean(base.structure.feature_map(missed) ** 2, axis=0))
    taught = _taught(base, np.asarray(trained.report["command_range"]))
    return replace(
        base.with_structure(prior=core, command_range=taught),
        kind="network" if isinstance(core, _core.Network) else "table",
        arrays=BundleArrays(prior, stored.fields),
        form_error=np.hypot(form, own),
        vertex_error_mm=float(np.hypot(error, rms(missed.reshape(len(points), -1)))),
        made_from=dict(base.made_from) | {"prior": trained.report},
    )


def _grid(model: Model) -> Grid:
    """Return the grid of a model's prior; a grid without axes if there is none."""
    return (model.arrays.prior.grid if model.arrays is not None else None) or Grid()


def check_set(base: Model, commands: Floats, points: Floats) -> None:
    """Reject shapes (S, 3N) mm at commands (S, C) of another finger than the bundle's."""
    channels, size = commands.shape[1], points.shape[1]
    if size != base.rest.size or channels != base.channels or base.kind == "rod":
        raise TrainingError(
            f"the prior maps {channels} commands to {size // 3} points, the bundle of "
            f"'{base.robot}' ({base.kind}) {base.channels} to {len(base.rest)}; train it on a "
            "sweep of the same finger"
        )
    some = np.unique(np.linspace(0, len(points) - 1, COMPARED).astype(int))
    missed = (base.prior.evaluate(np.ascontiguousarray(commands[some])) - points[some]).reshape(
        len(some), -1, 3
    )
    off = float(np.median(np.linalg.norm(missed, axis=2).mean(axis=1)))
    length = float(np.linalg.norm(base.rest, axis=1).max())
    most = UNLIKE * length + OWN * base.vertex_error_mm
    if not off <= most:
        raise TrainingError(
            f"the shapes are {off:.3g} mm from those of '{base.robot}' at the same commands "
            f"(median of {len(some)}), up to {most:.2g} mm are its own: another finger or "
            "material; build the bundle of theirs (`softmap build`)"
        )
    largest = float(np.abs(points).max())
    if not largest < BIGGEST * length:
        raise TrainingError(
            f"a point of the set is {largest:.3g} mm from the base of a robot of {length:.3g} mm: "
            "it is damaged; make it again (`softmap model sweep`)"
        )
    if not np.ptp(points, axis=0).any():
        raise TrainingError(
            f"all {len(points)} shapes of the set are the same; sweep commands that move the finger"
        )


def _enough(parts: tuple[Indices, Indices, Indices]) -> None:
    if min(map(len, parts)) < 2:
        sizes = " and ".join(", ".join(str(len(part)) for part in parts).rsplit(", ", 1))
        raise TrainingError(f"parts of {sizes} samples; sweep more commands")


def _taught(base: Model, taught: Floats) -> Floats:
    """Return the command range (C, 2) of a bundle, limited to that of its prior.

    It is limited where the range of the training data is clearly narrower.
    """
    low, high = base.command_range.T
    slack = BEYOND * (high - low)
    return np.column_stack(
        [
            np.where(taught[:, 0] > low + slack, taught[:, 0], low),
            np.where(taught[:, 1] < high - slack, taught[:, 1], high),
        ]
    )


def vertex_error(found: Floats, points: Floats) -> float:
    """Return the mean distance in mm of points (S, 3N) from their targets."""
    return float(np.mean(np.linalg.norm((found - points).reshape(len(points), -1, 3), axis=2)))


def rms(missed: Floats) -> float:
    """Return the RMS distance in mm of (S, 3N)."""
    return float(np.sqrt(np.mean(np.sum(missed.reshape(len(missed), -1, 3) ** 2, axis=2))))
