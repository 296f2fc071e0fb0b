"""Compute the numbers of docs/learn/own_log.md beyond its first table.

They are the drive, withheld seconds, and the changes by the load.

`python -m benches.trunk` prints them after the table. Errors are mm, RMS over the three markers.
"Later" is the last 30 % of a run. Effects are fitted only to the first 60 % of the loaded one, and
the rod to none of the unloaded run's later moves.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from benches.data import ROOT
from softmap_edge import Diagnosis, Model, Run, diagnose, import_logs, learn_model, read_mapping
from softmap_edge.model.basis import Basis
from softmap_edge.model.chain_labels import grouped
from softmap_edge.model.polynomial_rod import PolynomialRodArrays
from softmap_edge.rod.learn import learn
from softmap_edge.rod.regression import Drive, Record, Regression, rms
from softmap_edge.run.folds import folds

COMMANDS = "control_inputs_controlled_1.csv"
FREE, LOADED = "observations_controlled_1.csv", "observations_controlled_1_100g.csv"
HOLD_OUT = (103.0, 151.0)  # s, withheld from the rod: the later part and the two seconds before it
FITTED, LATER = 90.0, 105.0  # s: effects are fitted before the first, validated after the second
BLOCKS, GAP_S = 5, 2.0
# Seconds of the unloaded run: withheld from the rod, diagnosed, and withheld from both.
HALVES = {
    "second half": ((73.0, 151.0), (75.0, 135.0), (137.0, 151.0)),
    "first half": ((-1.0, 77.0), (0.0, 60.0), (62.0, 75.0)),
}
# s, the alternative to a pure delay named on the page
OTHER_DRIVE = {"latency.delay": 0.175, "lag.tau": 0.05}
SETS: tuple[tuple[str, ...], ...] = (
    (),
    ("offset",),
    ("payload",),
    ("gain",),
    ("payload", "offset"),
    ("gain", "offset"),
)


def read(folder: Path, observations: str) -> Run:
    """Return one recording as a run, by the example's mapping."""
    return import_logs(
        [folder / COMMANDS, folder / observations], read_mapping(ROOT / "examples/trunk.toml")
    ).run


def reference(free: Run) -> tuple[Model, Model]:
    """Return the rod of the unloaded run, on encoders, without the later moves.

    Also return it with free tendons.
    """
    model = learn_model(free, hold_out=[HOLD_OUT])
    assert model.arrays is not None and isinstance(model.arrays.prior.shape, PolynomialRodArrays)
    slack = replace(model.arrays.prior.shape, lock=0.0)
    return model, model.with_structure(fields=slack.fields())


def error(model: Model, run: Run) -> float:
    """Return the RMS error in mm over the later frames; memory runs through the complete record."""
    off = (model.predict(run) - run.markers)[run.t_seen >= LATER]
    return float(np.sqrt((off**2).sum(axis=2).mean()))


def fit(model: Model, run: Run, effects: Sequence[str]) -> Model:
    """Return the model with `effects` fitted by least squares to frames before `FITTED`.

    The squares are unweighted.
    """
    early = run.at(run.t_seen < FITTED)
    now = model.with_effects((*model.chain_names, *effects), model.params)
    free = {
        label: some[0]
        for label, some in grouped(now.chain).items()
        if label.split(".")[0] in effects
    }
    if not free:
        return model
    first = [*free.values()]
    low, high, start = (
        np.asarray(getattr(now.chain, name), float)[first] for name in ("low", "high", "start")
    )
    start = np.clip(start, low + 1e-3 * (high - low), high - 1e-3 * (high - low))

    def at(x: np.ndarray) -> Model:
        values = dict(model.params) | dict(zip(free, map(float, x)))
        return model.with_effects(now.chain_names, values)

    def off(x: np.ndarray) -> np.ndarray:
        return (at(x).predict(early) - early.markers).ravel()

    return at(least_squares(off, start, bounds=(low, high), x_scale=high - low, diff_step=1e-4).x)


def load_table(
    model: Model, loaded: Run, sets: Sequence[tuple[str, ...]] = SETS
) -> Iterator[tuple[str, int, float]]:
    """Yield (effects, numbers fitted, later error in mm) for each set of effects."""
    for effects in sets:
        fitted = fit(model, loaded, effects)
        yield (
            " + ".join(effects) or "none",
            len(fitted.params) - len(model.params),
            error(fitted, loaded),
        )


def rods(free: Run) -> dict[str, float]:
    """Return the rod's error (mm) and drive (s), from commands and from encoders.

    Also return the error of the alternative drive.
    """
    found = {}
    for source in ("goal", "present"):
        rod = learn(free, source, BLOCKS, GAP_S)
        tip = float(np.sqrt((rod.residuals[:, -1] ** 2).sum(axis=1).mean()))
        found |= {
            f"{source}: rod, cross-validation, mm": rod.error_mm,
            f"{source}: at the tip, mm": tip,
        }
        numbers = [number for one in rod.learned_in for number in one.params]
        found |= {f"{source}: {number.label}, {number.unit}": number.value for number in numbers}
        if source == "goal":
            (frames,) = rod.frames
            seen = free.t_seen[frames]
            regression = Regression(
                np.asarray(free.markers)[frames], np.zeros(3), folds(seen, BLOCKS, GAP_S)
            )
            u = Drive(Record(free.commands("goal"), free.t, seen)).acting(
                ("latency", "lag"), OTHER_DRIVE
            )
            basis = Basis(rod.made_from["degree"], rod.made_from["pulled"])
            other = rms(regression.cross_validate(u, basis, rod.made_from["ridge"]))
            found["goal: delay 0.175 s and lag 0.05 s, error ratio"] = other / rod.error_mm
    return found


def diagnosed(model: Model, loaded: Run, reference: Run | None = None) -> Diagnosis:
    """Return the diagnosis of the loaded run's frames before `FITTED`.

    It is relative to a `reference` if one is given.
    """
    return diagnose(model, loaded.at(loaded.t_seen < FITTED), reference=reference)


def without_load(free: Run) -> Iterator[tuple[str, Diagnosis]]:
    """Yield the claims on each half of the unloaded run.

    The rod was learned from the other half.
    """
    for name, (kept_from_rod, seen, judge) in HALVES.items():
        model = learn_model(free, hold_out=[kept_from_rod])
        part, later = (
            free.at((free.t_seen >= low) & (free.t_seen < high)) for low, high in (seen, judge)
        )
        yield name, diagnose(model, part, held_out=later)


def report(folder: Path) -> Iterator[str]:
    """Yield the numbers of the page as lines."""
    free, loaded = read(folder, FREE), read(folder, LOADED)
    model, slack = reference(free)
    numbers = rods(free) | {"unloaded, seconds kept from the rod, mm": error(model, free)}
    for effects, count, later in load_table(model, loaded):
        numbers[f"100 g, {effects} ({count} numbers), later, mm"] = later
    for effects, _, later in load_table(slack, loaded, (("payload",), ("payload", "offset"))):
        numbers[f"100 g, tendons free, {effects}, later, mm"] = later
    found = {"": diagnosed(model, loaded), " with the unloaded run": diagnosed(model, loaded, free)}
    for how, one in found.items():
        numbers[f"100 g, as diagnosed{how}, later, mm"] = error(one.model, loaded)
    yield from (f"{name:<52} {value:8.3f}" for name, value in numbers.items())
    for one in found.values():
        yield from ["", *str(one).splitlines()]
    for name, half in without_load(free):
        yield from ["", f"no load, {name}:", *str(half).splitlines()]
