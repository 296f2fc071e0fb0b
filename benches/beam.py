"""Print every number of docs/learn/beam.md.

A passive silicone beam under its weight, 52 g and 101 g.

The modulus is fitted to one gravity run alone; the other runs are predicted by the finite elements
with it. `drop` is the mean of the three tip markers along gravity (mm), `rotation` that of the
plate that carries them (degrees), both relative to the beam held straight by hand. The verdicts are
`softmap diagnose` with the table of the fitted beam; the hanging load is not declared. `Ring` is
the free oscillation after the release: its frequency, and the corresponding weight at the tip,

    m = k/ω² − k₀/ω₀²      k stiffness (N/m) of the tip along its way about the pose with the
                           weight, ω = 2π f

index 0: without the weight.

`python -m benches.beam` (seconds); `make data` downloads the recordings.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benches.data import ROOT, find_or_say
from softmap_edge import (
    Diagnosis,
    Finger,
    Run,
    Simulator,
    build_model,
    diagnose,
    import_logs,
    read_mapping,
)
from softmap_edge.fem.fit import FingerFit, fit_finger
from softmap_edge.geometry.rigid import kabsch, rotation_vector
from softmap_edge.geometry.sections import attach

Floats = NDArray[np.float64]

LOADS_G = {"gravity_V2_a": 0.0, "gravity_V2_b": 0.0, "load52_V2_a": 52.0, "load101_V2_a": 101.0}
FITTED = "gravity_V2_a"
NEWTON_PER_G = 9.80665e-3
PROBE_G = 2.0  # to both sides, for the stiffness of the tip
# after the release: three intervals, whose spread is the uncertainty
RINGS_FROM_S = (0.2, 0.4, 0.6)


@dataclass(frozen=True)
class Row:
    """One recording and its prediction: drop mm, rotation degrees."""

    run: str
    load_g: float
    drop: float
    drop_predicted: float
    rotation: float
    rotation_predicted: float

    @property
    def off(self) -> float:
        """The relative error of the predicted drop."""
        return self.drop_predicted / self.drop - 1.0


@dataclass(frozen=True)
class Ring:
    """The oscillation of a recording: frequency Hz, tip stiffness N/m, weight g, with sigma.

    Stiffness and weight follow from the frequency.

    `alike_hz` is the frequency of a uniformly softer or heavier beam with the same drop.
    """

    run: str
    frequency_hz: float
    stiffness: float
    grams: float
    sigma_g: float
    alike_hz: float


def read(folder: Path, whole: bool = False) -> dict[str, Run]:
    """Return the runs by the example's mapping, or all their frames, with the oscillation."""
    mapping = read_mapping(ROOT / "examples/beam.toml")
    if whole:
        mapping = replace(mapping, from_s=None, seen_rate_hz=None)
    return {name: import_logs([folder / f"beam_{name}.c3d"], mapping).run for name in LOADS_G}


def fitted(runs: dict[str, Run]) -> FingerFit:
    """Return the beam with the modulus from its own weight."""
    return fit_finger(Finger.load(ROOT / "examples/beam_finger.toml"), runs[FITTED])


def rows(beam: Finger, runs: dict[str, Run]) -> list[Row]:
    """Compare every recording with the prediction of the finite elements."""
    solid, found = Simulator(beam), []
    for name, run in runs.items():
        rest = np.asarray(run.marker_rest)
        down = np.array(beam.gravity)
        shape = solid.path(np.zeros((1, 0)), load=LOADS_G[name] * NEWTON_PER_G * down)[0]
        predicted = attach(rest, solid.template.vertices) @ shape
        seen = np.nanmean(np.asarray(run.markers), axis=0)
        drops = [float(((points - rest) @ down).mean()) for points in (seen, predicted)]
        turns = [turn(rest, points) for points in (seen, predicted)]
        found.append(Row(name, LOADS_G[name], *drops, *turns))
    return found


def frequency(run: Run, down: Floats) -> tuple[float, float]:
    """Return frequency and standard deviation (Hz) of the decay after the release.

    The decay is superposed on a slow creep.
    """
    drop = ((np.asarray(run.markers) - np.asarray(run.marker_rest)) @ down).mean(axis=1)
    t = run.t_seen - run.t_seen[int(np.argmax(drop > 0.5 * drop[-1]))]
    found = []
    for start in RINGS_FROM_S:
        late = t > start

        def left(x: Floats, t: Floats = t[late] - start, drop: Floats = drop[late]) -> Floats:
            rings = np.exp(-t / x[1]) * np.array(
                [np.cos(2 * np.pi * x[0] * t), np.sin(2 * np.pi * x[0] * t)]
            )
            columns = np.stack([np.ones_like(t), np.log1p(t), *rings], axis=1)
            return np.asarray(drop - columns @ np.linalg.lstsq(columns, drop, rcond=None)[0])

        fits = [
            least_squares(left, [f, 0.4], bounds=([0.5, 0.05], [20.0, 5.0]))
            for f in np.arange(2.0, 12.0, 0.5)
        ]
        found.append(float(min(fits, key=lambda fit: fit.cost).x[0]))
    return float(np.mean(found)), float(np.std(found, ddof=1))


def rings(fit: FingerFit, runs: dict[str, Run], whole: dict[str, Run]) -> list[Ring]:
    """Return the oscillation result of each recording, with the modulus of the beam.

    The modulus comes from the beam's own weight.
    """
    solid, down, found = Simulator(fit.finger), np.array(fit.finger.gravity), []
    softer = fit.numbers["young_mpa"].sigma / fit.finger.young_mpa
    none: tuple[float, float, float] | None = None  # m, Hz and drop without a load
    for name, run in runs.items():
        rest = np.asarray(run.marker_rest)
        carry = attach(rest, solid.template.vertices)
        loads = [(LOADS_G[name] + more) * NEWTON_PER_G * down for more in (-PROBE_G, PROBE_G)]
        low, high = (
            (carry @ solid.path(np.zeros((1, 0)), load=load)[0]).mean(axis=0) for load in loads
        )
        # mm; a low beam also swings sideways, together with the weight
        way = high - low
        stiffness = 2.0 * PROBE_G * NEWTON_PER_G * float(way @ down) / float(way @ way) * 1000.0
        hertz, spread = frequency(whole[name], down)
        drop = float(((np.nanmean(np.asarray(run.markers), axis=0) - rest) @ down).mean())
        moving = 1000.0 * stiffness / (2 * np.pi * hertz) ** 2  # g
        none = none or (moving, hertz, drop)
        grams = moving - none[0]
        sigma = float(np.hypot(grams * softer, 2.0 * moving * spread / hertz))
        found.append(
            Ring(name, hertz, stiffness, grams, sigma, none[1] * float(np.sqrt(none[2] / drop)))
        )
    return found


def turn(rest: Floats, points: Floats) -> float:
    """Return the rotation of points (M, 3) mm, degrees."""
    return float(
        np.degrees(
            np.linalg.norm(rotation_vector(kabsch(rest, points, np.ones(len(rest))).rotation))
        )
    )


def verdicts(beam: Finger, runs: dict[str, Run]) -> dict[str, Diagnosis]:
    """Return the diagnosis of the loaded runs without their declared load."""
    model = build_model(beam)
    return {name: diagnose(model, runs[name]) for name, load in LOADS_G.items() if load}


def main(argv: Sequence[str] | None = None) -> int:
    """Print the fit, the predictions and the verdicts."""
    parser = argparse.ArgumentParser(prog="python -m benches.beam", description=main.__doc__)
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    args = parser.parse_args(argv)
    folder = find_or_say("beam")
    if folder is None:
        return 1
    runs = read(folder)
    fit = fitted(runs)
    table, said = rows(fit.finger, runs), verdicts(fit.finger, runs)
    rung = rings(fit, runs, read(folder, whole=True))
    if args.json:
        document: dict[str, Any] = {"schema": "softmap.bench-beam/1", "fit": fit.to_dict()}
        document["rows"] = [vars(row) | {"off": row.off} for row in table]
        document["rings"] = [vars(ring) for ring in rung]
        document["diagnoses"] = {name: found.to_dict() for name, found in said.items()}
        print(json.dumps(document, indent=1))
        return 0
    print(fit, end="\n\n")
    for row in table:
        print(
            f"{row.run:<14} {row.load_g:5.0f} g   drop {row.drop:5.2f}, predicted "
            f"{row.drop_predicted:5.2f} mm ({row.off:+.1%})   rotation {row.rotation:4.1f}, "
            f"predicted {row.rotation_predicted:4.1f} deg"
        )
    for ring in rung:
        print(
            f"{ring.run:<14} rings at {ring.frequency_hz:.2f} Hz (softer or heavier all along: "
            f"{ring.alike_hz:.2f}), tip {ring.stiffness:.1f} N/m: {ring.grams:.1f} ± "
            f"{ring.sigma_g:.1f} g at the tip"
        )
    for name, found in said.items():
        print(f"\n{name}: {found}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
