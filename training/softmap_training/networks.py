"""Networks as sequential layers for ONNX: commands (n, C) mm to points (n, 3N) mm.

Published prior: 256-512-1024-512-256 with BatchNorm, ReLU and dropout, inputs and outputs
normalised elementwise. Ours: a few GELU layers to weights of the leading modes of the training
shapes, one scale for all outputs, so that the loss is the error in mm. Residuals: as published
(LayerNorm, GELU, dropout), or ours, with modes that do not move the clamp. All have the same
interface. Pinned by tests/training/test_training.py.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from softmap_edge.sweep.scattered import NARROW, half_range

Floats = NDArray[np.float64]

PUBLISHED_WIDTHS = (256, 512, 1024, 512, 256)
EPSILON = 1e-8  # least size of the published normalisation


class Scale(nn.Module):
    """x ↦ (x − shift)/size, or its inverse, with fixed numbers."""

    def __init__(self, shift: Floats, size: Floats, back: bool = False) -> None:
        super().__init__()
        self.back = back
        self.register_buffer("shift", torch.as_tensor(np.asarray(shift), dtype=torch.float32))
        self.register_buffer("size", torch.as_tensor(np.asarray(size), dtype=torch.float32))

    def forward(self, x: Tensor) -> Tensor:
        return x * self.size + self.shift if self.back else (x - self.shift) / self.size


class Modes(nn.Module):
    """Weights (n, m) to points (n, 3N): mean + weights · modes, with fixed numbers."""

    def __init__(self, mean: Floats, modes: Floats) -> None:
        super().__init__()
        self.register_buffer("mean", torch.as_tensor(np.asarray(mean), dtype=torch.float32))
        self.register_buffer("modes", torch.as_tensor(np.asarray(modes), dtype=torch.float32))

    def forward(self, x: Tensor) -> Tensor:
        return self.mean + x @ self.modes


def spread(commands: Floats) -> Floats:
    """Return the standard deviation of each command (S, C); 1 for a constant one.

    A constant command carries no information.
    """
    size = commands.std(axis=0)
    return np.where(size > NARROW, size + EPSILON, 1.0)


def published_prior(commands: Floats, points: Floats, dropout: float = 0.1) -> nn.Sequential:
    """Return the paper's prior, normalised by a set of commands (S, C) mm and points (S, 3N) mm."""
    layers: list[nn.Module] = [Scale(commands.mean(axis=0), spread(commands))]
    width = commands.shape[1]
    for wide in PUBLISHED_WIDTHS:
        layers += [nn.Linear(width, wide), nn.BatchNorm1d(wide), nn.ReLU(), nn.Dropout(dropout)]
        width = wide
    layers += [
        nn.Linear(width, points.shape[1]),
        Scale(points.mean(axis=0), points.std(axis=0) + EPSILON, back=True),
    ]
    return nn.Sequential(*layers)


def mode_prior(
    commands: Floats, points: Floats, widths: Sequence[int], count: int
) -> nn.Sequential:
    """Return our prior: GELU layers of `widths` to `count` modes of points (S, 3N) mm.

    Commands are (S, C) mm.
    """
    mean = points.mean(axis=0)
    _, size, modes = np.linalg.svd(points - mean, full_matrices=False)
    count = min(count, len(modes))
    reach = float(size[0] / np.sqrt(len(points)))  # mm, spread of all points along the first mode
    return to_modes(commands, mean, reach * modes[:count], widths)


def published_residual(
    commands: Floats, size: int, widths: Sequence[int], dropout: float
) -> nn.Sequential:
    """Return the residual network released by the authors of the paper.

    64-256-256-64, LayerNorm, GELU, dropout, to 3N numbers in mm.
    """
    layers: list[nn.Module] = [Scale(commands.mean(axis=0), spread(commands))]
    width = commands.shape[1]
    for wide in widths:
        layers += [nn.Linear(width, wide), nn.LayerNorm(wide), nn.GELU(), nn.Dropout(dropout)]
        width = wide
    last = nn.Linear(width, size)
    nn.init.zeros_(last.weight)  # the initial output is zero: it starts from the prior
    nn.init.zeros_(last.bias)
    return nn.Sequential(*layers, last)


def to_modes(commands: Floats, mean: Floats, modes: Floats, widths: Sequence[int]) -> nn.Sequential:
    """Return GELU layers of `widths` from commands (S, C) mm to weights of modes.

    The modes are `modes` (m, 3N) mm about `mean` (3N,).
    """
    half, middle = half_range(commands), 0.5 * (commands.max(axis=0) + commands.min(axis=0))
    layers: list[nn.Module] = [Scale(middle, half)]
    width = commands.shape[1]
    for wide in widths:
        layers += [nn.Linear(width, wide), nn.GELU()]
        width = wide
    return nn.Sequential(*layers, nn.Linear(width, len(modes)), Modes(mean, modes))
