"""Train a prior on a simulated set and put it into a bundle in place of the table: the paper's network, or ours.

    û = f_θ(u),   loss = mean over the set of |f_θ(ũ) − ỹ|², ỹ what the last, fixed layer makes the outputs of

Published: each output by its own mean and spread; ours: weights of the leading modes of the training shapes, all in one
unit, so that the loss is the error in mm². Errors are told on the test part of one frozen split, at commands that are
not in the training part. Everything else of the bundle (fields, tendons, effects) stays as it was. Units: mm.
Pinned by tests/test_training.py.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from softmap_edge import _core
from softmap_edge.model import Model
from softmap_training.choices import PRIOR, PRIOR_MODES, PRIOR_WIDTHS, PUBLISHED_PRIOR, Recipe
from softmap_training.errors import TrainingError
from softmap_training.export import checked, to_onnx
from softmap_training.fit import Progress, Task, fit, seeded
from softmap_training.networks import Modes, Scale, mode_prior, published_prior

Floats = NDArray[np.float64]
Kind = Literal["modes", "published", "published_without_dropout"]

PUBLISHED_DROPOUT = 0.1


@dataclass(frozen=True)
class Trained:
    """A trained network, its ONNX file, and what is told about it."""

    network: nn.Sequential
    content: bytes
    report: dict[str, Any]


def train_prior(
    commands: Floats,
    points: Floats,
    parts: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]],
    kind: Kind = "modes",
    recipe: Recipe | None = None,
    folder: Path | None = None,
    progress: Progress | None = None,
    device: str = "cpu",
    tensorboard: bool = False,
) -> Trained:
    """Train a network from commands (S, C) mm to points (S, 3N) mm.

    Args:
        commands, points: the simulated set.
        parts: indices of training, validation and test.
        kind: "modes" (ours), or "published" with its dropout of 0.1, or without.
        recipe: other numbers than those of `choices.py`.
        folder: where checkpoints and logs are kept.
        progress: told the share done and a line.
        device: "cpu" or "cuda".
        tensorboard: write its events too.

    Raises:
        TrainingError: too few samples, or a checkpoint of something else.
    """
    train, validation, test = parts
    if min(len(train), len(validation), len(test)) < 2:
        raise TrainingError(f"parts of {len(train)}, {len(validation)} and {len(test)} samples; sweep more commands")
    recipe = recipe or (PRIOR if kind == "modes" else PUBLISHED_PRIOR)
    seeded(recipe.seed)
    if kind == "modes":
        network = mode_prior(commands[train], points[train], PRIOR_WIDTHS, PRIOR_MODES)
    else:
        network = published_prior(commands[train], points[train], PUBLISHED_DROPOUT if kind == "published" else 0.0)
    u = torch.as_tensor(commands, dtype=torch.float32)
    wanted = torch.as_tensor(before(network[-1], points), dtype=torch.float32)
    rows = torch.as_tensor(train)

    def loss(net: nn.Sequential, some: Tensor) -> Tensor:
        chosen = rows.to(some.device)[some]
        return (net[:-1](u.to(some.device)[chosen]) - wanted.to(some.device)[chosen]).square().mean()

    def validate(net: nn.Sequential) -> float:
        at = next(net.parameters()).device
        return vertex_error(net(u[torch.as_tensor(validation)].to(at)).cpu().numpy(), points[validation])

    ahead = time.perf_counter()
    task = Task(network, len(train), loss, validate, [commands, points, train])
    log = fit(task, recipe, folder, progress, device, tensorboard)
    seconds = time.perf_counter() - ahead
    content = to_onnx(network, commands.shape[1], {"kind": kind, "seed": str(recipe.seed)})
    apart = checked(network, content, commands[test][:256])
    core = _core.Network(content)
    report = {
        "kind": kind,
        "seed": recipe.seed,
        "epochs": len(log),
        "seconds": seconds,
        "parameters": core.parameters,
        "samples": len(train),
        "test_vertex_mm": vertex_error(core.evaluate(commands[test]), points[test]),
        "test_rms_mm": rms(core.evaluate(commands[test]) - points[test]),
        "parity_mm": apart,
    }
    return Trained(network, content, report)


def before(last: nn.Module, points: Floats) -> Floats:
    """Return what a fixed last layer has to be given (S, m) for points (S, 3N) mm."""
    if isinstance(last, Modes):
        mean, modes = last.mean.numpy().astype(np.float64), last.modes.numpy().astype(np.float64)
        return np.asarray((points - mean) @ np.linalg.pinv(modes))
    assert isinstance(last, Scale)
    return np.asarray((points - last.shift.numpy()) / last.size.numpy())


def with_prior(base: Model, trained: Trained, commands: Floats, points: Floats) -> Model:
    """Return a bundle's model with a trained prior in place of its own; `commands` and `points` judge it (test part).

    Its own error grows by that of the network, in squares.

    Raises:
        TrainingError: the network is of other commands or points than the model.
    """
    core = _core.Network(trained.content)
    if core.size != base.rest.size or core.channels != base.channels or base.kind == "rod":
        raise TrainingError(
            f"the network maps {core.channels} commands to {core.size // 3} points, the bundle of '{base.robot}' "
            f"({base.kind}) {base.channels} to {len(base.rest)}; train it on a sweep of the same finger"
        )
    kept = {
        name: array
        for name, array in base.arrays["prior"].items()
        if name.startswith("axis") or name.removesuffix("_step") == "pull"
    }
    arrays = dict(base.arrays) | {"prior": kept | {"onnx": np.frombuffer(trained.content, np.uint8)}}
    missed = (core.evaluate(commands) - points).reshape(len(points), -1, 3)
    own = np.sqrt(np.mean(base.feature_map(missed) ** 2, axis=0))
    return replace(
        base,
        kind="network",
        prior=core,
        arrays=arrays,
        form_error=np.hypot(base.form_error, own),
        vertex_error_mm=float(np.hypot(base.vertex_error_mm, rms(missed.reshape(len(points), -1)))),
        made_from=dict(base.made_from) | {"prior": trained.report},
    )


def vertex_error(found: Floats, points: Floats) -> float:
    """Return the mean distance in mm of points (S, 3N) from where they should be."""
    return float(np.mean(np.linalg.norm((found - points).reshape(len(points), -1, 3), axis=2)))


def rms(missed: Floats) -> float:
    """Return the RMS distance in mm of (S, 3N)."""
    return float(np.sqrt(np.mean(np.sum(missed.reshape(len(missed), -1, 3) ** 2, axis=2))))
