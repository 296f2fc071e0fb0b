"""Time level 1: normal equations of all families on eight folds, and by NumPy.

NumPy uses explicit columns.

The peer uses the fewest NumPy calls: explicit columns (n, K, M), whitened by `Whitener.shrink`, one
matrix product per set of frames. The core never forms the columns (rust/families/gram.rs).
tests/benches/test_benches.py checks that both give the same losses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benches.row import ratio, side_by_side
from softmap_edge import _core
from softmap_edge.noise.noise_model import Kernel, Whitener, command_kernel
from softmap_edge.run.folds import Folds, run_folds

Floats = NDArray[np.float64]

FRAMES, MODES, CHANNELS, FIELDS = 374, 20, 2, 30
FAMILIES = (
    "static map",
    "coupling",
    "memory",
    "delay",
    "rate",
    "creep",
    "softening",
    "time",
    "step",
)
PRODUCTS = 4  # rows that multiply each field
RIDGE = 10.0


@dataclass(frozen=True)
class Made:
    """Input of level 1: bases and weights by name, a residual, folds and their kernels."""

    columns: dict[str, tuple[Floats, NDArray[np.int64], Floats]]
    residual: Floats
    whitener: Whitener
    folds: Folds
    kernels: list[tuple[Kernel, Kernel]]

    @property
    def count(self) -> int:
        """Number of columns."""
        return sum(len(which) for _, which, _ in self.columns.values())

    def level(self) -> _core.Level:
        """Return the core's level with all columns, not yet closed."""
        kernel = self.whitener.kernel
        folds = [
            (*fold, train.basis, train.strength, test.basis, test.strength)
            for fold, (train, test) in zip(self.folds, self.kernels)
        ]
        level = _core.Level(self.whitener.form, (kernel.basis, kernel.strength), folds)
        for name, (base, which, weight) in self.columns.items():
            level.add(name, base, which, weight)
        return level

    def grams(self) -> list[tuple[Floats, Floats]]:
        """Return the Gram matrices (n + 1, n + 1) of each fold's training and test frames.

        The residual is last.
        """
        parts = [base[which] * weight[:, :, None] for base, which, weight in self.columns.values()]
        x = np.concatenate([*parts, self.residual[None]])

        def gram(frames: NDArray[np.intp], kernel: Kernel) -> Floats:
            white = self.whitener.shrink(x[:, frames], kernel).reshape(len(x), -1)
            return np.asarray(white @ white.T)

        gram(np.arange(x.shape[1]), self.whitener.kernel)
        pairs = zip(self.folds, self.kernels)
        return [
            (gram(train, before), gram(test, after)) for (train, test), (before, after) in pairs
        ]


def made(
    frames: int = FRAMES, modes: int = MODES, channels: int = CHANNELS, fields: int = FIELDS
) -> Made:
    """Return the columns of all families for slow moves, with random slopes and fields."""
    rng = np.random.default_rng(0)
    t = np.arange(2 * frames) * 0.5
    waves = 2 * np.pi * t[:, None, None] * rng.uniform(0.01, 0.05, (channels, 3))
    v = 8.0 * np.sin(waves + rng.uniform(0, 6, (channels, 3))).mean(axis=2)
    half, seen = 0.5 * np.ptp(v, axis=0), t[::2]
    series = _core.Series(v, t, 0.5 * (v.max(0) + v.min(0)), half)
    slopes, field = (
        rng.normal(size=(channels, frames, modes)),
        rng.normal(size=(fields, frames, modes)),
    )
    columns = {
        name: (slopes, *_core.Bank(name, channels).columns(series, seen)) for name in FAMILIES
    }
    rows = rng.normal(size=(fields * PRODUCTS, frames))
    columns["fields"] = (field, np.repeat(np.arange(fields), PRODUCTS), rows)
    command, folds = v[::2], run_folds(seen)
    kernels = [
        (command_kernel(command[a], half), command_kernel(command[b], half)) for a, b in folds
    ]
    whitener = Whitener(
        np.eye(modes), np.geomspace(30.0, 0.03, modes), command_kernel(command, half)
    )
    return Made(columns, rng.normal(size=(frames, modes)), whitener, folds, kernels)


def rows(made_of: Made | None = None) -> list[dict[str, object]]:
    """Return the time of all families' normal equations and solution, next to NumPy."""
    made_of = made_of or made()
    level, names = made_of.level(), list(made_of.columns)

    def grams() -> None:
        whole = level.fresh()
        for name, (base, which, weight) in made_of.columns.items():
            whole.add(name, base, which, weight)
        whole.close(made_of.residual)
        whole.losses(names, [RIDGE] * len(names))

    ours, theirs = side_by_side(grams, made_of.grams)
    frames, modes = made_of.residual.shape
    name = f"level 1, {made_of.count} columns, {frames} × {modes}, {len(made_of.folds)} folds"
    return [ratio(name, ours, theirs, "NumPy", "goal ≤ 200 ms on one core")]
