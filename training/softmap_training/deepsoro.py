"""A decoder in the manner of DeepSoRo: a code of the command folds a grid of points onto the body, twice.

    code = g(u),  p' = f₁(grid, code),  p = f₂(p', code)          (FoldingNet, Yang et al. 2018, arXiv:1712.07262)

Wang et al. 2020 (doi:10.1109/LRA.2020.2976320) take the code from a camera inside the robot; here it comes from the
command, as in the paper's comparison. Widths and training are ours (`choices.py`). Units: mm.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from softmap_training import choices
from softmap_training.chamfer import chamfer
from softmap_training.fit import Task, fit, seeded

Floats = NDArray[np.float64]


class Folding(nn.Module):
    """Commands (n, C) to points (n, N, 3) mm about `middle`, in units of `size` mm."""

    def __init__(self, commands: Floats, points: Floats) -> None:
        super().__init__()
        shapes = points.reshape(len(points), -1, 3)
        count, code, wide = shapes.shape[1], choices.DEEPSORO_CODE, choices.DEEPSORO_WIDTH
        side = int(np.ceil(np.sqrt(count)))
        across = np.linspace(-1.0, 1.0, side)
        grid = np.stack(np.meshgrid(across, across), axis=-1).reshape(-1, 2)[:count]
        fixed = {
            "middle_u": commands.mean(axis=0), "size_u": commands.std(axis=0) + 1e-8,
            "middle": shapes.mean(axis=(0, 1)), "size": np.array(shapes.std()), "grid": grid,
        }  # fmt: skip
        for name, value in fixed.items():
            self.register_buffer(name, torch.as_tensor(value, dtype=torch.float32))
        self.code = nn.Sequential(nn.Linear(commands.shape[1], wide), nn.ReLU(), nn.Linear(wide, code))
        self.first = nn.Sequential(
            nn.Linear(2 + code, wide), nn.ReLU(), nn.Linear(wide, wide), nn.ReLU(), nn.Linear(wide, 3)
        )
        self.second = nn.Sequential(
            nn.Linear(3 + code, wide), nn.ReLU(), nn.Linear(wide, wide), nn.ReLU(), nn.Linear(wide, 3)
        )

    def forward(self, u: Tensor) -> Tensor:
        code = self.code((u - self.middle_u) / self.size_u)
        each = code[:, None].expand(-1, len(self.grid), -1)
        folded = self.first(torch.cat([self.grid.expand(len(u), -1, -1), each], dim=2))
        return self.middle + self.size * self.second(torch.cat([folded, each], dim=2))


def fit_deepsoro(
    commands: Floats, points: Floats, seed: int, told: Callable[[float], None] | None = None,
    clouds: list[Floats] | None = None,
) -> tuple[Callable[[Floats], Floats], int]:  # fmt: skip
    """Return what predicts points (n, 3N) mm, and how many numbers were learned, from commands (S, C) mm and either
    points (S, 3N) mm or `clouds` (S) of (M, 3) mm.
    """
    seeded(seed)
    network = Folding(commands, points)
    targets = clouds or list(points.reshape(len(points), -1, 3))
    u = torch.as_tensor(commands, dtype=torch.float32)

    def loss(net: nn.Module, some: Tensor) -> Tensor:
        return chamfer(net(u[some.cpu()]), [targets[k] for k in some.tolist()]).mean()

    def validate(net: nn.Module) -> float:
        some = torch.arange(0, len(u), max(1, len(u) // 40))
        return float(loss(net, some))

    task = Task(network, len(commands), loss, validate)
    fit(task, choices.DEEPSORO.with_(seed=seed), None, (lambda share, _: told(share)) if told else None)

    def predict(v: Floats) -> Floats:
        with torch.no_grad():
            found = network(torch.as_tensor(v, dtype=torch.float32))
        return np.asarray(found.numpy().reshape(len(v), -1), np.float64)

    return predict, sum(p.numel() for p in network.parameters())
