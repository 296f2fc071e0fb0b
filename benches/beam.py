"""Print every number of docs/beam.md: a silicone beam that nothing commands, under its weight, 52 g and 101 g.

The modulus is fitted to one gravity run alone; the other runs are predicted by the finite elements with it. `drop` is
the mean of the three tip markers along gravity (mm), `rotation` that of the plate that carries them (degrees), both
from where a hand held the beam straight. The verdicts are `softmap diagnose` with the table of the fitted beam, which
is not told that anything hangs there. `python -m benches.beam` (seconds); `make data` brings the recordings.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benches.data import ROOT, find_or_say
from softmap_edge import Diagnosis, Finger, Run, Simulator, build_model, diagnose, import_logs, read_mapping
from softmap_edge.alignment.rigid import kabsch, rotation_vector
from softmap_edge.features import attach
from softmap_edge.solid.fit import FingerFit, fit_finger

Floats = NDArray[np.float64]

LOADS_G = {"gravity_V2_a": 0.0, "gravity_V2_b": 0.0, "load52_V2_a": 52.0, "load101_V2_a": 101.0}
FITTED = "gravity_V2_a"
NEWTON_PER_G = 9.80665e-3


@dataclass(frozen=True)
class Row:
    """One recording beside its prediction: drop mm, rotation degrees."""

    run: str
    load_g: float
    drop: float
    drop_predicted: float
    rotation: float
    rotation_predicted: float

    @property
    def off(self) -> float:
        """By which share the predicted drop is off."""
        return self.drop_predicted / self.drop - 1.0


def read(folder: Path) -> dict[str, Run]:
    """Return the runs by the example's mapping."""
    mapping = read_mapping(ROOT / "examples/beam.toml")
    return {name: import_logs([folder / f"beam_{name}.c3d"], mapping).run for name in LOADS_G}


def fitted(runs: dict[str, Run]) -> FingerFit:
    """Return the beam with the modulus that its own weight shows."""
    return fit_finger(Finger.load(ROOT / "examples/beam_finger.toml"), runs[FITTED])


def rows(beam: Finger, runs: dict[str, Run]) -> list[Row]:
    """Return every recording beside what the finite elements predict."""
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


def turn(rest: Floats, points: Floats) -> float:
    """Return by how many degrees points (M, 3) mm turned."""
    return float(np.degrees(np.linalg.norm(rotation_vector(kabsch(rest, points, np.ones(len(rest))).rotation))))


def verdicts(beam: Finger, runs: dict[str, Run]) -> dict[str, Diagnosis]:
    """Return what a diagnosis says of the loaded runs, which do not declare their load."""
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
    if args.json:
        document: dict[str, Any] = {"schema": "softmap.bench-beam/1", "fit": fit.to_dict()}
        document["rows"] = [vars(row) | {"off": row.off} for row in table]
        document["diagnoses"] = {name: found.to_dict() for name, found in said.items()}
        print(json.dumps(document, indent=1))
        return 0
    print(fit, end="\n\n")
    for row in table:
        print(
            f"{row.run:<14} {row.load_g:5.0f} g   drop {row.drop:5.2f}, predicted {row.drop_predicted:5.2f} mm "
            f"({row.off:+.1%})   rotation {row.rotation:4.1f}, predicted {row.rotation_predicted:4.1f} deg"
        )
    for name, found in said.items():
        print(f"\n{name}: {found}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
