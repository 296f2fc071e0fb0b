"""Everything about training that the paper does not say, chosen here.

None of these numbers is in the paper.

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
    """How a network is trained: Adam with a cosine down to `last` of the rate.

    The best epoch by validation is kept.

    `patience`: epochs without a better validation after which training ends · `decay`: of weights
    (decoupled) · `passes`: how often an epoch goes through all samples; after each epoch a
    checkpoint is written.
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
        """Return the recipe with what was asked for in place of the usual."""
        return replace(self, **{name: value for name, value in change.items() if value is not None})


# The prior as published, and the same without dropout.
PUBLISHED_PRIOR = Recipe(epochs=500, batch=336, rate=2e-3, patience=200)
# Ours: few numbers, many short epochs.
PRIOR = Recipe(epochs=2500, batch=128, rate=5e-3, last=1e-3)
PRIOR_WIDTHS, PRIOR_MODES = (96, 96, 96), 24

# The residual. Published: widths, dropout and weights from the released files.
PUBLISHED_RESIDUAL = Recipe(epochs=150, batch=8, rate=1e-3, patience=40)
RESIDUAL_WIDTHS, RESIDUAL_DROPOUT = (64, 256, 256, 64), 0.1  # released
LAMBDA_L2, LAMBDA_LAP = 0.1, 0.05  # released
# Ours: a few modes of what registration shows beyond the prior.
RESIDUAL = Recipe(epochs=100, batch=4096, rate=3e-3, last=1e-3, decay=1.0, passes=10)

# Its Chamfer over the vertices seen: weight in mm, of a squared distance; clouds of a batch, and
# points of a cloud.
LAMBDA_SEEN, SEEN_FRAMES, SEEN_SAMPLES = 0.1, 8, 500
RESIDUAL_MODES, OUR_RESIDUAL_WIDTHS = 6, (32, 32)
HELD_OUT = 4  # every so many of the eight blocks of a recording

SPLIT_SEED = 548  # of the frozen split of a simulated set, 80 / 10 / 10 (`simulated.py`)
SAMPLES = 2000  # points of a cloud that Chamfer looks at while it trains

# Baselines: the paper gives their names alone.
# its own common values
XGBOOST = {"n_estimators": 300, "max_depth": 6, "learning_rate": 0.1, "tree_method": "hist"}
# shapes, steps of the search and modes that lengths and noise are found on
GP_SOME, GP_STEPS, GP_MODES = 400, 40, 6
DEEPSORO_CODE, DEEPSORO_WIDTH = 64, 128
DEEPSORO = Recipe(epochs=60, batch=16, rate=1e-3)
# bodies that an epoch goes through at least: few clouds are shown again and again
DEEPSORO_DRAWN = 1000
# The error against the number of real samples: shares of the blocks of a recording that teach.
SHARES = (0.125, 0.25, 0.5, 1.0)


def prior_recipe(kind: PriorKind) -> Recipe:
    """Return how a prior is trained."""
    return PRIOR if kind == "modes" else PUBLISHED_PRIOR


def residual_recipe(kind: ResidualKind) -> Recipe:
    """Return how a residual is trained."""
    return RESIDUAL if kind == "modes" else PUBLISHED_RESIDUAL
