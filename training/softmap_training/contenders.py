"""Fit the models that `softmap evaluate` trains itself, for one or several seeds.

    on a simulated set    priors and baselines, taught by its training part
    on a recording        a decoder in the manner of DeepSoRo, taught by the clouds at the model's
                          calibrated commands;
                          residuals on top of the model, also on growing parts of the recording,
                          complete blocks of it

The seed draws the blocks of a part; each part contains the smaller ones. Pinned by
tests/training/test_evaluate.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from softmap_edge import _core
from softmap_edge.model.model import Model
from softmap_edge.model.training_range import training_extrapolation
from softmap_training import baselines, choices
from softmap_training.chamfer import thinned
from softmap_training.deepsoro import fit_deepsoro
from softmap_training.evaluate import Recording, Row, milliseconds, on_shapes, predicting, size_of
from softmap_training.prior import Surface, train_prior
from softmap_training.recordings import LEAST_FRAMES, Lesson
from softmap_training.residual import train_residual
from softmap_training.simulated import SimulatedSet

Progress = Callable[[str, float], None]

NO_CHANCE = ("linear", "xgboost", "table")  # no seed changes these
TITLES = {"modes": "residual, ours", "published": "residual, published"}


@dataclass(frozen=True)
class Plan:
    """The fit of contenders: seeds, epochs (None: default), and checkpoint folder."""

    seeds: tuple[int, ...] = (0,)
    epochs: int | None = None
    work: Path | None = None

    def of(self, recipe: choices.Recipe, seed: int) -> choices.Recipe:
        """Return a recipe with the planned epochs."""
        return recipe.with_(epochs=self.epochs, seed=seed)

    def folder(self, *name: object) -> Path | None:
        """Return the checkpoint folder of one training."""
        return None if self.work is None else self.work / "-".join(map(str, name))


def fitted_to_set(
    name: str, data: SimulatedSet, surface: Surface, plan: Plan, bar: Progress
) -> Row:
    """Fit a prior or a baseline to the training part of a set, and evaluate it on the test part.

    Raises:
        TrainingError: the set is too small, or a dependency is missing.
    """
    parts = data.split(choices.SPLIT_SEED)
    points = (
        data.shapes(np.arange(len(data.command))).reshape(len(data.command), -1).astype(np.float64)
    )
    u, rows = np.ascontiguousarray(data.command), []
    for seed in plan.seeds[:1] if name in NO_CHANCE else plan.seeds:
        say, folder = partial(bar, name), plan.folder(name, seed)
        if name in choices.PRIORS:
            recipe = plan.of(choices.prior_recipe(name), seed)
            trained = train_prior(
                u,
                points,
                (parts.train, parts.validation, parts.test),
                name,
                surface,
                recipe,
                folder,
                lambda share, _, say=say: say(share),
            )
            network = _core.Network(trained.content)
            predict, triangles = network.evaluate, surface.triangles
            took = {"seconds": trained.report["seconds"], "parameters": network.parameters}
        else:
            train = parts.train
            made = baselines.fit_baseline(
                name, u[train], points[train], seed, say, plan.epochs, folder
            )
            predict, triangles = (
                made.predict,
                surface.triangles if made.triangles is None else made.triangles,
            )
            took = {"seconds": made.seconds, "parameters": made.numbers}
        details = {"what": name, "seed": seed, **took}
        rows.append(on_shapes(name, predict, u[parts.test], points[parts.test], details, triangles))
    return Row.of_seeds(rows)


def decoder(lesson: Lesson, recording: Recording, plan: Plan, bar: Progress) -> Row:
    """Fit a decoder to the clouds of a lesson, and evaluate it."""
    base, rows = lesson.base, []
    clouds = [thinned(cloud, choices.SAMPLES) for cloud in lesson.clouds]
    # same held-out blocks as for a residual
    held, asked = lesson.parts[0][1], base.effective_commands(recording.run)
    for seed in plan.seeds:
        made = fit_deepsoro(
            lesson.commands,
            clouds,
            len(base.rest),
            seed,
            held,
            plan.epochs,
            plan.folder("recording", "deepsoro", seed),
            partial(bar, "DeepSoRo"),
        )
        details = {
            "what": "deepsoro",
            "seed": seed,
            "seconds": made.seconds,
            "parameters": made.numbers,
        }
        details |= {"milliseconds": milliseconds(made.predict, asked), "frames": len(lesson)}
        shapes = made.predict(asked).reshape(len(asked), -1, 3)
        rows.append(
            recording.evaluate_shapes("DeepSoRo", shapes, made.triangles, details, body=False)
        )
    return Row.of_seeds(rows)


def residuals(
    lesson: Lesson, recording: Recording, kind: choices.ResidualKind, plan: Plan, bar: Progress
) -> list[Row]:
    """Train and evaluate a residual on growing parts of a lesson, up to the complete one.

    Parts that are too small for a residual are skipped.
    """
    found = []
    for number, share in enumerate(choices.SHARES):
        rows = []
        for seed in plan.seeds:
            bar(TITLES[kind], number / len(choices.SHARES))
            some = lesson.share(share, seed)
            if len(some) < LEAST_FRAMES:
                break
            recipe = plan.of(choices.residual_recipe(kind), seed)
            folder = plan.folder("recording", "residual", kind, f"{share:g}", seed)
            model, report = train_residual(lesson.base, lesson.at(some), kind, recipe, folder)
            details = took(model) | {
                "what": "with residual",
                "kind": kind,
                "seed": seed,
                "seconds": report["seconds"],
                "share": share,
                "frames": len(some),
                "outside": training_extrapolation(model, recording.run),
            }
            rows.append(recording.evaluate(TITLES[kind], model, details))
        if rows:
            found.append(Row.of_seeds(rows))
    return found


def took(model: Model) -> dict[str, Any]:
    """Return the time of a model for one shape, and its number of parameters."""
    low, high = model.command_range.T
    u = np.random.default_rng(0).uniform(low, high, (16, model.channels))
    return {"milliseconds": milliseconds(predicting(model), u), "parameters": size_of(model)}
