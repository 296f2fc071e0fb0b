"""A decoder like DeepSoRo: a code of the command folds a grid of points, twice.

The grid is folded onto the body.

    code = g(u),  p' = f₁(grid, code),  p = f₂(p', code)  (FoldingNet, Yang et al. 2018,
                                                          arXiv:1712.07262)

Wang et al. 2020 (doi:10.1109/LRA.2020.2976320) take the code from a camera inside the robot; here
it comes from the command, as in the paper's comparison. The loss is the Chamfer distance to points
of the body: all vertices of a simulated shape, or the cloud of a recording. Its surface is the
folded grid. Widths and training are our choice (`choices.py`). Units: mm. Pinned by
tests/training/test_baselines.py.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from softmap_training import choices
from softmap_training.baselines import Fitted
from softmap_training.chamfer import chamfer
from softmap_training.export import Graph
from softmap_training.fit import Task, fit, seeded
from softmap_training.networks import spread

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


class Folding(nn.Module):
    """Commands (n, C) to points (n, N, 3) mm about `middle`, in units of `size` mm."""

    def __init__(self, commands: Floats, bodies: Sequence[Floats], count: int) -> None:
        super().__init__()
        every = np.concatenate(bodies)
        code, wide = choices.DEEPSORO_CODE, choices.DEEPSORO_WIDTH
        across = np.linspace(-1.0, 1.0, _side(count))
        grid = np.stack(np.meshgrid(across, across), axis=-1).reshape(-1, 2)[:count]
        fixed = {
            "middle_u": commands.mean(axis=0),
            "size_u": spread(commands),
            "middle": every.mean(axis=0),
            "size": np.array(every.std()),
            "grid": grid,
        }
        for name, value in fixed.items():
            self.register_buffer(name, torch.as_tensor(value, dtype=torch.float32))
        self.code = nn.Sequential(
            nn.Linear(commands.shape[1], wide), nn.ReLU(), nn.Linear(wide, code)
        )
        self.first = nn.Sequential(
            nn.Linear(2 + code, wide),
            nn.ReLU(),
            nn.Linear(wide, wide),
            nn.ReLU(),
            nn.Linear(wide, 3),
        )
        self.second = nn.Sequential(
            nn.Linear(3 + code, wide),
            nn.ReLU(),
            nn.Linear(wide, wide),
            nn.ReLU(),
            nn.Linear(wide, 3),
        )

    def forward(self, u: Tensor) -> Tensor:
        code = self.code((u - self.middle_u) / self.size_u)
        each = code[:, None].expand(-1, len(self.grid), -1)
        folded = self.first(torch.cat([self.grid.expand(len(u), -1, -1), each], dim=2))
        return self.middle + self.size * self.second(torch.cat([folded, each], dim=2))


def fit_deepsoro(
    commands: Floats,
    bodies: Sequence[Floats],
    count: int,
    seed: int = 0,
    held: Indices | None = None,
    epochs: int | None = None,
    folder: Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> Fitted:
    """Fit a decoder of `count` points to bodies, each (M, 3) mm, at commands (S, C) mm.

    Args:
        commands, bodies, count: as above.
        seed: seed of the initial weights and the order.
        held: bodies for validation, which select the best epoch; without them, the training bodies
            do.
        epochs: replaces the default number; an epoch has at least `choices.DEEPSORO_DRAWN` bodies.
        folder: folder of checkpoints and log.
        progress: called with the completed share.
    """
    seeded(seed)
    network = Folding(commands, bodies, count)
    u = torch.as_tensor(commands, dtype=torch.float32)
    tested = np.arange(0, len(u), max(1, len(u) // 40)) if held is None else held
    taught = np.arange(len(u)) if held is None else np.setdiff1d(np.arange(len(u)), held)

    def off(net: nn.Module, rows: Indices) -> Tensor:
        return chamfer(net(u[torch.as_tensor(rows)]), [bodies[k] for k in rows]).mean()

    def loss(net: nn.Module, some: Tensor) -> Tensor:
        return off(net, taught[some.cpu().numpy()])

    def validate(net: nn.Module) -> float:
        return float(off(net, tested))

    recipe = choices.DEEPSORO.with_(
        seed=seed, epochs=epochs, passes=math.ceil(choices.DEEPSORO_DRAWN / len(taught))
    )
    task = Task(network, len(taught), loss, validate, [commands, *bodies, taught])
    log = fit(task, recipe, folder, (lambda share, _: progress(share)) if progress else None)

    def predict(v: Floats) -> Floats:
        with torch.no_grad():
            found = network(torch.as_tensor(v, dtype=torch.float32))
        return np.asarray(found.numpy().reshape(len(v), -1), np.float64)

    numbers = sum(p.numel() for p in network.parameters())
    return Fitted(
        predict, sum(row["seconds"] for row in log), numbers, _cells(count), to_graph(network)
    )


def to_graph(network: Folding) -> bytes:
    """Return the ONNX file of a decoder: commands (n, C) → points (n, 3N) mm.

    A layer of (grid point, code) is the sum of a layer of the grid point and one of the code, so no
    concatenation is needed. It is not a chain of layers: the core cannot read it, but onnxruntime
    can (`softmap_edge.model.onnx`).
    """
    graph = Graph()
    graph.add("Sub", _numbers(network.middle_u))
    graph.add("Div", _numbers(network.size_u))
    into, _, out = network.code
    graph.linear(_numbers(into.weight), _numbers(into.bias))
    graph.add("Relu")
    graph.linear(_numbers(out.weight), _numbers(out.bias))
    code, place = graph.at, None
    for layers, width in ((network.first, 2), (network.second, 3)):
        first, second, last = (layer for layer in layers if isinstance(layer, nn.Linear))
        weights = _numbers(first.weight)
        graph.at = code
        graph.linear(weights[:, width:], _numbers(first.bias))
        graph.also("Unsqueeze", graph.integers([1]))  # (n, 1, W)
        if place is None:
            graph.add("Add", _numbers(network.grid) @ weights[:, :width].T)  # (n, N, W)
        else:
            of_code, graph.at = graph.at, place
            graph.add("MatMul", weights[:, :width].T)
            graph.also("Add", of_code)
        for layer in (second, last):
            graph.add("Relu")
            graph.add("MatMul", _numbers(layer.weight).T)
            graph.add("Add", _numbers(layer.bias))
        place = graph.at
    graph.add("Mul", _numbers(network.size)[None])
    graph.add("Add", _numbers(network.middle))
    graph.also("Reshape", graph.integers([-1, 3 * len(network.grid)]))
    metadata = {"kind": "deepsoro"}
    return graph.file(len(network.middle_u), metadata, 3 * len(network.grid))


def _numbers(tensor: Tensor) -> Floats:
    return np.asarray(tensor.detach().cpu().numpy(), np.float64)


def _side(count: int) -> int:
    return math.ceil(math.sqrt(count))


def _cells(count: int) -> NDArray[np.int32]:
    """Return the triangles (F, 3) among the first `count` points of the grid."""
    side = _side(count)
    at = np.arange(count).reshape(-1)
    corner = at[(at % side < side - 1) & (at + side + 1 < count)]
    halves = [(0, 1, side), (1, side + 1, side)]
    return np.concatenate([corner[:, None] + np.array(half) for half in halves]).astype(np.int32)
