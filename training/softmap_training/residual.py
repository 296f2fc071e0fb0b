"""Train a residual on a recording, on top of a frozen model: the paper's, or ours. Units: mm.

    points(u) = model(u) + Δ(u)

Published: a network 64-256-256-64 to all points, Chamfer to the clouds + λ_l2 · mean |Δᵢ|² + λ_lap · mean over edges
|Δᵢ − Δⱼ|². On clouds of two views it pulls the unseen side through the body and moves what a clamp holds. Ours is
taught by the registered vertices, each by how well it was seen, and by the Chamfer distance of those that were seen
(which changes little); a base that stands off the frame of the clouds is taken out before, as one
rigid pose (`alignment/clouds.py`), so that it is no shape: Δ is a few modes of what they show beyond the model,
none of which moves a clamped vertex, weighted by a small network of the command. Validation is on whole blocks of the
recordings; ours leaves each out once, then learns from all for as long as was best on average. Friction remembers where
a command was reached from: a command that is reached from several sides, in several recordings, teaches their mean.
Pinned by tests/test_residual_network.py.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from softmap_edge import _core
from softmap_edge.alignment.clouds import base_stood_off, in_base
from softmap_edge.folds import run_folds
from softmap_edge.model import Model
from softmap_edge.outside import span
from softmap_edge.registration.clouds import clouds_of
from softmap_edge.registration.register import Registered, clamped, register
from softmap_edge.run import Run, known
from softmap_training import choices
from softmap_training.chamfer import chamfer
from softmap_training.choices import Recipe
from softmap_training.errors import TrainingError
from softmap_training.export import checked, to_onnx
from softmap_training.fit import Progress, Task, fit, seeded
from softmap_training.networks import published_residual, to_modes
from softmap_training.recordings import joined

Floats = NDArray[np.float64]
LEAST_FRAMES = 12
Parts = list[tuple[NDArray[np.int64], NDArray[np.int64]]]  # frames that teach, frames that are held out


@dataclass(frozen=True)
class Frames:
    """What a residual is taught by: acting commands (K, C), the model's points (K, N, 3), clouds, and registration."""

    commands: Floats
    points: Floats
    clouds: list[Floats]
    registered: Registered | None
    vertices: Floats
    weight: Floats  # (K, N), 1/mm²

    def __len__(self) -> int:
        return len(self.commands)


def frames_of(model: Model, run: Run, registered: Registered | None = None) -> Frames:
    """Return what a run teaches on top of a model without its residual.

    Args:
        model: with the effects that it has; an earlier residual is left out.
        run: of clouds, or of vertices.
        registered: of the clouds, where that was done before.

    Raises:
        TrainingError: fewer than LEAST_FRAMES frames, or markers.
    """
    base = model.with_residual(None)
    if run.frames < LEAST_FRAMES:
        raise TrainingError(f"{run.frames} frames, at least {LEAST_FRAMES} are needed to learn a residual; record more")
    if run.markers is not None:
        raise TrainingError("markers do not show the surface; a residual network is learned from clouds or vertices")
    commands = np.ascontiguousarray(base.acting(base.chain_names, base.chain_params[None], run)[0])
    points = np.asarray(base.predict(run))
    if run.points is None:
        seen = known(run, run.seen_points)
        sigma = np.ones(seen.shape) if run.sigma is None else np.broadcast_to(run.sigma, seen.shape)
        vertices = np.where(seen[..., None], run.seen_points, points)
        return Frames(commands, points, [], None, vertices, seen / sigma**2)
    found = registered or register(base, run)
    of = found.run(run)
    assert of.sigma is not None
    return Frames(commands, points, clouds_of(run), found, found.vertices, found.visible / of.sigma**2)


def train_residual(
    model: Model,
    run: Run | Sequence[Run],
    kind: choices.ResidualKind = "modes",
    recipe: Recipe | None = None,
    folder: Path | None = None,
    progress: Progress | None = None,
    device: str = "cpu",
    registered: Registered | None = None,
    tensorboard: bool = False,
) -> tuple[Model, dict[str, Any]]:
    """Return a model with a trained residual, and a report.

    Args:
        model: stays as it is, an earlier residual aside.
        run: the recording, or several, of clouds (or vertices; the published one needs clouds), with commands.
        kind: "modes" (ours) or "published".
        recipe, folder, progress, device, tensorboard: as for `train_prior`.
        registered: of the clouds, where that was done before; the base is then taken to stand where the frame says.

    Raises:
        TrainingError: too few frames, no clouds for the published one, or a checkpoint of something else.
    """
    runs = list(run) if isinstance(run, Sequence) else [run]
    whole, base = joined(runs), model.with_residual(None)
    stood = None
    if kind == "modes" and registered is None:
        whole, stood = in_base(whole, base)
    frames = frames_of(model, whole, registered)
    if kind == "published" and not frames.clouds:
        raise TrainingError("the published residual is supervised by clouds; this run holds vertices")
    recipe = recipe or (choices.RESIDUAL if kind == "modes" else choices.PUBLISHED_RESIDUAL)
    seeded(recipe.seed)
    parts, held_still = _parts(whole), clamped(base)
    ahead = time.perf_counter()
    every = np.arange(len(frames))
    until = None
    train, held = parts[0]
    if kind == "modes":  # as long as was best on average for what was left out, then on all frames
        curve = _left_out(base, frames, parts, held_still, recipe, folder, _share(progress, 0.0, 0.8), device)
        train, held, until = every, every, 1 + int(np.argmin(curve))
    seeded(recipe.seed)
    network, task = (_ours if kind == "modes" else _published)(base, frames, train, held, held_still)
    say = progress if until is None else _share(progress, 0.8, 1.0)
    log = fit(task, recipe, folder, say, device, tensorboard, until)
    after = _off(frames, held, _evaluated(network, frames)) if until is None else float(curve.min())
    seconds = time.perf_counter() - ahead
    content = to_onnx(network, base.channels, {"kind": f"residual, {kind}", "seed": str(recipe.seed)})
    apart = checked(network, content, frames.commands[:256])
    delta = _core.Network(content).evaluate(frames.commands).reshape(frames.points.shape)
    report = {
        "kind": kind,
        "seed": recipe.seed,
        "epochs": len(log),
        "planned_epochs": recipe.epochs,
        "seconds": seconds,
        "frames": len(frames),
        "size_mm": float(np.sqrt(np.mean(np.sum(delta**2, axis=2)))),
        "clamp_moves_mm": float(np.linalg.norm(delta[:, held_still], axis=2).mean()) if len(held_still) else 0.0,
        "held_out_before_mm": _off(frames, held, np.zeros_like(delta)),
        "held_out_after_mm": after,
        "parity_mm": apart,
        "base_stood_off": None if stood is None else base_stood_off(stood.pose),
        "command_range": span(frames.commands),
    }
    found = base.with_residual({"onnx": np.frombuffer(content, np.uint8)})
    made = dict(base.made_from) | {"residual": {"run": [one.hash() for one in runs], **report}}
    return replace(found, made_from=made), report


def _left_out(
    base: Model, frames: Frames, parts: Parts, still: NDArray[np.int64], recipe: Recipe, folder: Path | None,
    progress: Progress | None, device: str,
) -> Floats:  # fmt: skip
    """Return, for each epoch, the mean distance in mm from the vertices seen in the part that was left out."""
    curves, patient = [], replace(recipe, patience=recipe.epochs)
    for number, (train, held) in enumerate(parts):
        seeded(recipe.seed)
        task = _ours(base, frames, train, held, still)[1]
        say = _share(progress, number / len(parts), (number + 1) / len(parts))
        log = fit(task, patient, folder and folder / f"part{number}", say, device)
        curves.append([row["validation_mm"] for row in log])
    return np.asarray(np.average(curves, axis=0, weights=[len(held) for _, held in parts]))


def _share(progress: Progress | None, begin: float, end: float) -> Progress | None:
    """Return what hears of a part of the work as of its share of all of it."""
    if progress is None:
        return None
    return lambda share, line: progress(begin + (end - begin) * share, line)


def _parts(run: Run) -> Parts:
    """Return the frames that teach and those that are held out, HELD_OUT times: every so many blocks of the run."""
    blocks, found = run_folds(run.t_seen), []
    for number in range(min(choices.HELD_OUT, len(blocks))):
        train = np.arange(run.frames)
        for kept, _ in blocks[number :: choices.HELD_OUT]:
            train = np.intersect1d(train, kept)
        found.append((train, np.concatenate([test for _, test in blocks[number :: choices.HELD_OUT]])))
    return found


def _evaluated(network: nn.Sequential, frames: Frames) -> Floats:
    """Return what a network adds to each frame's points (K, N, 3) mm."""
    with torch.no_grad():
        found = network(torch.as_tensor(frames.commands, dtype=torch.float32))
    return np.asarray(found.numpy().reshape(frames.points.shape), np.float64)


def _off(frames: Frames, some: NDArray[np.int64], delta: Floats) -> float:
    """Return the mean distance in mm from the vertices that were seen, on some frames."""
    distance = np.linalg.norm(frames.vertices[some] - frames.points[some] - delta[some], axis=2)
    seen = frames.weight[some] > 0
    return float(distance[seen].mean())


def _ours(
    base: Model, frames: Frames, train: NDArray[np.int64], held: NDArray[np.int64], still: NDArray[np.int64]
) -> tuple[nn.Sequential, Task]:
    missed = frames.vertices - frames.points
    missed[:, still] = 0.0
    flat = missed.reshape(len(missed), -1)
    mean = flat[train].mean(axis=0)
    _, size, modes = np.linalg.svd(flat[train] - mean, full_matrices=False)
    modes = modes[: choices.RESIDUAL_MODES]
    modes[:, np.all(flat == 0.0, axis=0)] = 0.0  # what a clamp holds, exactly
    reach = float(size[0] / np.sqrt(len(train)))
    network = to_modes(frames.commands[train], mean, reach * modes, choices.OUR_RESIDUAL_WIDTHS)
    u = torch.as_tensor(frames.commands, dtype=torch.float32)
    y = torch.as_tensor(flat, dtype=torch.float32)
    w = torch.as_tensor(frames.weight / frames.weight[train].mean(), dtype=torch.float32)
    chosen = torch.as_tensor(train)
    clouds = [_thinned(cloud, choices.SEEN_SAMPLES) for cloud in frames.clouds]
    points = torch.as_tensor(frames.points, dtype=torch.float32)

    def off(net: nn.Sequential, rows: Tensor) -> Tensor:
        return (net(u.to(rows.device)[rows]) - y.to(rows.device)[rows]).reshape(len(rows), -1, 3)

    def loss(net: nn.Sequential, some: Tensor) -> Tensor:
        rows = chosen.to(some.device)[some]
        apart = off(net, rows)
        from_registered = (w.to(some.device)[rows] * apart.square().sum(dim=2)).mean()
        at = [n for n, k in enumerate(rows.tolist()) if clouds and frames.weight[k].any()][: choices.SEEN_FRAMES]
        if not at:
            return from_registered
        some_rows, which = rows[at], rows[at].tolist()
        places = points.to(rows.device)[some_rows] + apart[at] + y.to(rows.device)[some_rows].reshape(len(at), -1, 3)
        seen = chamfer(places, [clouds[k] for k in which], [frames.weight[k] > 0.0 for k in which])
        return from_registered + choices.LAMBDA_SEEN * seen.mean()

    def validate(net: nn.Sequential) -> float:
        rows = torch.as_tensor(held, device=next(net.parameters()).device)
        return float(off(net, rows).norm(dim=2)[w.to(rows.device)[rows] > 0].mean())

    return network, Task(network, len(train), loss, validate, [frames.commands, flat, frames.weight, *clouds, train])


def _published(
    base: Model, frames: Frames, train: NDArray[np.int64], held: NDArray[np.int64], still: NDArray[np.int64]
) -> tuple[nn.Sequential, Task]:
    size = frames.points[0].size
    network = published_residual(frames.commands[train], size, choices.RESIDUAL_WIDTHS, choices.RESIDUAL_DROPOUT)
    u = torch.as_tensor(frames.commands, dtype=torch.float32)
    points = torch.as_tensor(frames.points, dtype=torch.float32)
    chosen, edges = torch.as_tensor(train), torch.as_tensor(_edges(base.triangles))
    clouds = [_thinned(cloud, choices.SAMPLES) for cloud in frames.clouds]

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

    return network, Task(network, len(train), loss, validate, [frames.commands, frames.points, *clouds, train])


def _thinned(cloud: Floats, most: int) -> Floats:
    """Return about `most` points of a cloud at most, evenly spread over its rows."""
    return np.ascontiguousarray(cloud[:: max(1, len(cloud) // most)])


def _edges(triangles: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the edges (E, 2) of triangles (T, 3), each once."""
    sides = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    return np.unique(sides.astype(np.int64), axis=0)
