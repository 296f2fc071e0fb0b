"""Runs with mistakes of their owners, diagnosed."""

import json
from functools import cache

import numpy as np

from softmap_edge import builtin_model
from softmap_edge.cli import main
from softmap_edge.run.protocol import standard_protocol
from softmap_edge.run.run import Run

CANDIDATES = "backlash,saturation,gain,payload,mount,servo_swap"


PLAY = {"backlash.gap": 2.0}


@cache
def recorded(play):
    """The fields of a run of the built-in finger by its own model, with camera noise, and with play
    if so.
    """
    p, model = standard_protocol(), builtin_model()
    seen = p.t_seen[:300]
    blank = Run(t=p.t, command=p.command, gravity=p.gravity, t_seen=seen)
    truth = model.with_effects(("backlash",), PLAY) if play else model
    rng = np.random.default_rng(0)
    vertices = truth.predict(blank) + 0.2 * rng.normal(size=(len(seen), len(model.rest), 3))
    return {
        "t": p.t,
        "command": p.command,
        "gravity": p.gravity,
        "t_seen": seen,
        "vertices": vertices,
    }


def scaled(name, factor):
    return lambda f: f | {name: f[name] * factor}


def written(tmp_path, change, play):
    """Write a changed run as `numpy.savez` does, which takes a hundredth of the time of packing."""
    path = tmp_path / "run.npz"
    np.savez(path, **{name: np.asarray(value) for name, value in change(recorded(play)).items()})
    return path


def diagnosed(path, capsys):
    code = main(["diagnose", str(path), "--effects", CANDIDATES, "--json"])
    out, said = capsys.readouterr()
    return code, json.loads(out) if out.startswith("{") else None, said
