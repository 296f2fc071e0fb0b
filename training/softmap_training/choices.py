"""Training choices that the paper does not specify.

None of these values is in the paper.

The paper gives widths, BatchNorm, ReLU and dropout 0.1 of the prior, normalised inputs and targets,
mean squared error; LayerNorm, GELU and dropout of the residual, Chamfer + λ_l2 · mean |Δ|² + λ_lap
· mean over edges |Δᵢ − Δⱼ|². Its authors' released files add widths, dropout and both weights
of the residual.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

PriorKind = Literal[
    "modes", "published", "published_without_dropout", "laplacian", "arap", "linear"
]
ResidualKind = Literal["modes", "published"]
PRIORS: tuple[PriorKind, ...] = get_args(PriorKind)
RESIDUALS: tuple[ResidualKind, ...] = get_args(ResidualKind)


@dataclass(frozen=True)
class Recipe:
    """A training recipe: Adam with a cosine schedule down to `last` of the rate.

    The epoch with the best validation is kept.

    `patience`: epochs without a better validation before training ends · `decay`: weight decay
    (decoupled) · `passes`: passes over all samples per epoch; a checkpoint follows each epoch.
    """

    epochs: int
    batch: int
    rate: float
    last: float = 0.01
    decay: float = 0.0
    patience: int = 1_000_000
    seed: int = 0
    passes: int = 1

    def with_(self, **change: float | int | None) -> Recipe:
        """Return the recipe with the requested changes."""
        return replace(self, **{name: value for name, value in change.items() if value is not None})


# The prior as published, and the same without dropout.
PUBLISHED_PRIOR = Recipe(epochs=500, batch=336, rate=2e-3, patience=200)
# Ours: few parameters, many short epochs.
PRIOR = Recipe(epochs=2500, batch=128, rate=5e-3, last=1e-3)
PRIOR_WIDTHS, PRIOR_MODES = (96, 96, 96), 24

# The residual. Published: widths, dropout and weights from the released files.
PUBLISHED_RESIDUAL = Recipe(epochs=150, batch=8, rate=1e-3, patience=40)
RESIDUAL_WIDTHS, RESIDUAL_DROPOUT = (64, 256, 256, 64), 0.1  # released
LAMBDA_L2, LAMBDA_LAP = 0.1, 0.05  # released
# Ours: a few modes of the registered shapes minus the prior.
RESIDUAL = Recipe(epochs=100, batch=4096, rate=3e-3, last=1e-3, decay=1.0, passes=10)

# Its Chamfer term over visible vertices: weight in mm, of a squared distance; clouds per batch, and
# points per cloud.
LAMBDA_SEEN, SEEN_FRAMES, SEEN_SAMPLES = 0.1, 8, 500
RESIDUAL_MODES, OUR_RESIDUAL_WIDTHS = 6, (32, 32)
HELD_OUT = 4  # of the eight blocks of a recording: one in so many is held out

SPLIT_SEED = 548  # seed of the frozen split of a simulated set, 80 / 10 / 10 (`simulated.py`)
SAMPLES = 2000  # points per cloud for Chamfer during training

# Baselines: the paper gives only their names. common values of the library
XGBOOST = {"n_estimators": 300, "max_depth": 6, "learning_rate": 0.1, "tree_method": "hist"}
# shapes, search steps and modes for fitting lengths and noise
GP_SOME, GP_STEPS, GP_MODES = 400, 40, 6
DEEPSORO_CODE, DEEPSORO_WIDTH = 64, 128
DEEPSORO = Recipe(epochs=60, batch=16, rate=1e-3)
# least bodies per epoch: a few clouds are repeated
DEEPSORO_DRAWN = 1000
# The error against the number of real samples: shares of the training blocks of a recording.
SHARES = (0.125, 0.25, 0.5, 1.0)


def prior_recipe(kind: PriorKind) -> Recipe:
    """Return the recipe of a prior."""
    return PRIOR if kind == "modes" else PUBLISHED_PRIOR


def residual_recipe(kind: ResidualKind) -> Recipe:
    """Return the recipe of a residual."""
    return RESIDUAL if kind == "modes" else PUBLISHED_RESIDUAL
