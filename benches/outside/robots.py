"""Data sets of robots with missing physics: a loaded trunk, slack tendons, a loaded beam.

The trunk carries 100 g; the robot with slack tendons has nine tendons.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from benches import beam as beam_bench
from benches import tdcr as tdcr_bench
from benches import trunk_load
from benches.outside.case import BLOCKS, Case, Floats, places, text
from softmap_edge import Model, Run
from softmap_edge.fem.build import build_model
from softmap_edge.fem.fit import FingerFit
from softmap_edge.rod.learn import learn, learned_model


def trunk(folder: Path) -> Case:
    """Return the case of the loaded trunk."""
    loaded = trunk_load.read(folder, trunk_load.LOADED)
    fit = loaded.at(loaded.t_seen < trunk_load.FITTED)
    held = loaded.at(loaded.t_seen >= trunk_load.LATER)

    @cache
    def model() -> Model:
        return trunk_load.reference(trunk_load.read(folder, trunk_load.FREE))[0]

    def law() -> dict[str, Floats]:
        return {"held": places(trunk_load.fit(model(), fit, ("payload", "offset")).predict(held))}

    return Case(
        name="Trunk, 100 g",
        about=text("trunk"),
        values=places,
        fit=fit,
        held={"held": held},
        model=model,
        law=law,
        law_name="dead load and offset, 7 numbers",
        unit="mm",
        expected="dead load first, then the offset",
        lags=(0, 4, 8, 16),
    )


def tdcr(folder: Path) -> Case:
    """Return the case of the nine-tendon arm."""
    fit, held = tdcr_bench.read(folder)
    robots = tdcr_bench.robots()

    def rod(name: str) -> Model:
        return learned_model(fit, learn(fit, robot=robots[name]))

    return Case(
        name="TDCR, nine tendons",
        about=text("tdcr"),
        values=places,
        fit=fit,
        held={"held": held},
        model=cache(lambda: rod("elastic rod, two-sided")),
        law=lambda: {"held": places(rod("elastic rod, cables").predict(held))},
        law_name="elastic rod with one-sided tendons",
        unit="mm",
        expected="slack, then an unresolved memory",
        lags=(0, 1, 2, 4),
    )


def beams(folder: Path) -> list[Case]:
    """Return the cases of the loaded beam, one for each load."""
    runs = beam_bench.read(folder)

    @cache
    def model() -> Model:
        return build_model(_fit().finger)

    @cache
    def _fit() -> FingerFit:
        return beam_bench.fitted(runs)

    return [_beam(grams, runs[name], model) for name, grams in beam_bench.LOADS_G.items() if grams]


def _beam(grams: float, run: Run, model: Callable[[], Model]) -> Case:
    def law() -> dict[str, Floats]:
        return {BLOCKS: places(model().predict(replace(run, load=np.asarray(float(grams)))))}

    return Case(
        name=f"Beam, {grams:g} g",
        about=text("beam", grams=f"{grams:g}"),
        values=places,
        fit=run,
        held={},
        model=model,
        law=law,
        law_name=f"the model with {grams:g} g declared",
        unit="mm",
        expected=f"ambiguous dead load, interval holds {grams:g} g",
        moving=False,
    )
