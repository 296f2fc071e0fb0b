"""Train a residual on a recording, on top of a frozen model: the paper's, or ours. Units: mm.

    points(u) = model(u) + Δ(u)

Published: a network 64-256-256-64 to all points, Chamfer to the clouds + λ_l2 · mean |Δᵢ|² + λ_lap
· mean over edges |Δᵢ − Δⱼ|². On clouds of two views it pulls the hidden side through the body and
moves clamped vertices. Ours is trained on the registered vertices, weighted by their visibility,
and on the Chamfer distance of the visible ones (which changes little). Δ is a few modes of their
difference from the model, none of which moves a clamped vertex; a small network of the command
gives the weights. Validation is on complete blocks of the recordings; ours leaves each out once,
then trains on all for the best average number of epochs. Friction depends on the direction of
approach: for a command reached from several sides, in several recordings, the residual learns the
mean. Pinned by tests/adaptation/test_residual_network.py.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from softmap_edge import _core
from softmap_edge.alignment.register import clamped
from softmap_edge.model.model import Model
from softmap_edge.model.shapes import NetworkArrays
from softmap_edge.model.training_range import span
from softmap_edge.run.folds import Folds
from softmap_edge.run.run import Run
from softmap_training import choices
from softmap_training.chamfer import chamfer, thinned
from softmap_training.choices import Recipe
from softmap_training.errors import TrainingError
from softmap_training.export import checked, to_onnx
from softmap_training.fit import Progress, Task, fit, seeded
from softmap_training.networks import published_residual, to_modes
from softmap_training.recordings import LEAST_FRAMES, Lesson

Floats = NDArray[np.float64]


def train_residual(
    model: Model,
    taught: Run | Sequence[Run] | Lesson,
    kind: choices.ResidualKind = "modes",
    recipe: Recipe | None = None,
    folder: Path | None = None,
    progress: Progress | None = None,
    device: str = "cpu",
    tensorboard: bool = False,
) -> tuple[Model, dict[str, Any]]:
    """Return a model with a trained residual, and a report.

    Args:
        model: stays unchanged, except that an earlier residual is removed.
        taught: one or several recordings with clouds (or vertices; the published kind needs clouds)
            and commands, or their lesson on this model.
        kind: "modes" (ours) or "published".
        recipe, folder, progress, device, tensorboard: as for `train_prior`.

    Raises:
        TrainingError: too few frames, no clouds for the published kind, or a checkpoint of another
            training.
    """
    lesson = taught if isinstance(taught, Lesson) else Lesson.of(model, taught)
    base = lesson.base
    if len(lesson) < LEAST_FRAMES:
        raise TrainingError(
            f"{len(lesson)} frames, at least {LEAST_FRAMES} are needed to learn a residual"
        )
    if kind == "published" and not lesson.of_clouds:
        raise TrainingError(
            "the published residual is supervised by clouds; some of the runs hold vertices"
        )
    recipe = recipe or choices.residual_recipe(kind)
    seeded(recipe.seed)
    parts, held_still = lesson.parts, clamped(base)
    ahead = time.perf_counter()
    every = np.arange(len(lesson))
    until = None
    train, held = parts[0]
    if kind == "modes":  # best average epochs on held-out blocks, then all frames
        curve = _left_out(
            lesson, parts, held_still, recipe, folder, _share(progress, 0.0, 0.8), device
        )
        train, held, until = every, every, 1 + int(np.argmin(curve))
    seeded(recipe.seed)
    network, task = (_ours if kind == "modes" else _published)(lesson, train, held, held_still)
    say = progress if until is None else _share(progress, 0.8, 1.0)
    log = fit(task, recipe, folder, say, device, tensorboard, until)
    after = _off(lesson, held, _evaluated(network, lesson)) if until is None else float(curve.min())
    seconds = time.perf_counter() - ahead
    content = to_onnx(
        network, base.channels, {"kind": f"residual, {kind}", "seed": str(recipe.seed)}
    )
    apart = checked(network, content, lesson.commands[:256])
    delta = _core.Network(content).evaluate(lesson.commands).reshape(lesson.points.shape)
    report = {
        "kind": kind,
        "seed": recipe.seed,
        "epochs": len(log),
        "planned_epochs": recipe.epochs,
        "seconds": seconds,
        "frames": len(lesson),
        "size_mm": float(np.sqrt(np.mean(np.sum(delta**2, axis=2)))),
        "clamp_moves_mm": float(np.linalg.norm(delta[:, held_still], axis=2).mean())
        if len(held_still)
        else 0.0,
        "held_out_before_mm": _off(lesson, held, np.zeros_like(delta)),
        "held_out_after_mm": after,
        "parity_mm": apart,
        "warnings": lesson.remarks,
        "command_range": span(lesson.commands),
    }
    found = base.with_residual(NetworkArrays(content))
    made = dict(base.made_from) | {"residual": {"run": lesson.runs, **report}}
    return replace(found, made_from=made), report


def _left_out(
    lesson: Lesson,
    parts: Folds,
    still: NDArray[np.int64],
    recipe: Recipe,
    folder: Path | None,
    progress: Progress | None,
    device: str,
) -> Floats:
    """Return the mean distance (mm) to visible held-out vertices for each epoch."""
    curves = []
    for number, (train, held) in enumerate(parts):
        seeded(recipe.seed)
        task = _ours(lesson, train, held, still)[1]
        say = _share(progress, number / len(parts), (number + 1) / len(parts))
        log = fit(task, recipe, folder and folder / f"part{number}", say, device)
        curves.append([row["validation_mm"] for row in log])
    return np.asarray(np.average(curves, axis=0, weights=[len(held) for _, held in parts]))


def _share(progress: Progress | None, begin: float, end: float) -> Progress | None:
    """Return a progress callback for a part of the work, scaled to its share."""
    if progress is None:
        return None
    return lambda share, line: progress(begin + (end - begin) * share, line)


def _evaluated(network: nn.Sequential, lesson: Lesson) -> Floats:
    """Return the contribution of a network to each frame's points (K, N, 3) mm."""
    with torch.no_grad():
        found = network(torch.as_tensor(lesson.commands, dtype=torch.float32))
    return np.asarray(found.numpy().reshape(lesson.points.shape), np.float64)


def _off(lesson: Lesson, some: NDArray[np.int64], delta: Floats) -> float:
    """Return the mean distance in mm to the visible vertices, on some frames."""
    distance = np.linalg.norm(lesson.vertices[some] - lesson.points[some] - delta[some], axis=2)
    seen = lesson.weight[some] > 0
    return float(distance[seen].mean())


def _ours(
    lesson: Lesson, train: NDArray[np.int64], held: NDArray[np.int64], still: NDArray[np.int64]
) -> tuple[nn.Sequential, Task]:
    missed = lesson.vertices - lesson.points
    missed[:, still] = 0.0
    flat = missed.reshape(len(missed), -1)
    mean = flat[train].mean(axis=0)
    _, size, modes = np.linalg.svd(flat[train] - mean, full_matrices=False)
    modes = modes[: choices.RESIDUAL_MODES]
    modes[:, np.all(flat == 0.0, axis=0)] = 0.0  # clamped vertices, exactly
    reach = float(size[0] / np.sqrt(len(train)))
    network = to_modes(lesson.commands[train], mean, reach * modes, choices.OUR_RESIDUAL_WIDTHS)
    u = torch.as_tensor(lesson.commands, dtype=torch.float32)
    y = torch.as_tensor(flat, dtype=torch.float32)
    w = torch.as_tensor(lesson.weight / lesson.weight[train].mean(), dtype=torch.float32)
    chosen = torch.as_tensor(train)
    clouds = [thinned(cloud, choices.SEEN_SAMPLES) for cloud in lesson.clouds]
    points = torch.as_tensor(lesson.points, dtype=torch.float32)

    def off(net: nn.Sequential, rows: Tensor) -> Tensor:
        return (net(u.to(rows.device)[rows]) - y.to(rows.device)[rows]).reshape(len(rows), -1, 3)

    def loss(net: nn.Sequential, some: Tensor) -> Tensor:
        rows = chosen.to(some.device)[some]
        apart = off(net, rows)
        from_registered = (w.to(some.device)[rows] * apart.square().sum(dim=2)).mean()
        shown = [
            n for n, k in enumerate(rows.tolist()) if len(clouds[k]) and lesson.weight[k].any()
        ]
        at = shown[: choices.SEEN_FRAMES]
        if not at:
            return from_registered
        some_rows, which = rows[at], rows[at].tolist()
        places = (
            points.to(rows.device)[some_rows]
            + apart[at]
            + y.to(rows.device)[some_rows].reshape(len(at), -1, 3)
        )
        seen = chamfer(places, [clouds[k] for k in which], [lesson.weight[k] > 0.0 for k in which])
        return from_registered + choices.LAMBDA_SEEN * seen.mean()

    def validate(net: nn.Sequential) -> float:
        rows = torch.as_tensor(held, device=next(net.parameters()).device)
        return float(off(net, rows).norm(dim=2)[w.to(rows.device)[rows] > 0].mean())

    return network, Task(
        network, len(train), loss, validate, [lesson.commands, flat, lesson.weight, *clouds, train]
    )


def _published(
    lesson: Lesson, train: NDArray[np.int64], held: NDArray[np.int64], still: NDArray[np.int64]
) -> tuple[nn.Sequential, Task]:
    size = lesson.points[0].size
    network = published_residual(
        lesson.commands[train], size, choices.RESIDUAL_WIDTHS, choices.RESIDUAL_DROPOUT
    )
    u = torch.as_tensor(lesson.commands, dtype=torch.float32)
    points = torch.as_tensor(lesson.points, dtype=torch.float32)
    chosen, edges = torch.as_tensor(train), torch.as_tensor(_edges(lesson.base.triangles))
    clouds = [thinned(cloud, choices.SAMPLES) for cloud in lesson.clouds]

    def corrected(net: nn.Sequential, rows: Tensor) -> tuple[Tensor, Tensor]:
        delta = net(u.to(rows.device)[rows]).reshape(len(rows), -1, 3)
        return delta, points.to(rows.device)[rows] + delta

    def loss(net: nn.Sequential, some: Tensor) -> Tensor:
        rows = chosen.to(some.device)[some]
        delta, places = corrected(net, rows)
        apart = delta[:, edges[:, 0]] - delta[:, edges[:, 1]]
        return (
            chamfer(places, [clouds[k] for k in rows.tolist()]).mean()
            + choices.LAMBDA_L2 * delta.square().sum(dim=2).mean()
            + choices.LAMBDA_LAP * apart.square().sum(dim=2).mean()
        )

    def validate(net: nn.Sequential) -> float:
        rows = torch.as_tensor(held, device=next(net.parameters()).device)
        return float(chamfer(corrected(net, rows)[1], [clouds[k] for k in held.tolist()]).mean())

    return network, Task(
        network, len(train), loss, validate, [lesson.commands, lesson.points, *clouds, train]
    )


def _edges(triangles: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the edges (E, 2) of triangles (T, 3), each once."""
    sides = np.sort(
        np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1
    )
    return np.unique(sides.astype(np.int64), axis=0)
