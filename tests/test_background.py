"""The level of ordinary imperfections: a known static misfit is recovered, memory and noise do not count."""

from dataclasses import replace

import numpy as np
import pytest

from softmap_edge import Run, builtin_model
from softmap_edge.diagnosis.background import background
from softmap_edge.diagnosis.prepare import noise_of
from softmap_edge.diagnosis.record import Record
from softmap_edge.protocol import standard_protocol


def blank(model, **change):
    p = standard_protocol()
    fields = {
        "t": p.t, "command": p.command, "gravity": p.gravity, "t_seen": p.t_seen, "block": p.block,
        "vertices": np.repeat(model.rest[None], p.frames, axis=0),
    }  # fmt: skip
    return Run(**(fields | change))


def level(model, moved, seed=0):
    """The estimated level for a finger moved by (K, N, 3) mm, and its true level over section middles."""
    run = blank(model)
    rng = np.random.default_rng(seed)
    clean = model.predict(run)
    record = Record(model, replace(run, vertices=clean + moved + 0.2 * rng.normal(size=clean.shape)))
    base = record.predict(model.chain_names, record.own()[None])[0]
    true = (Record(model, replace(run, vertices=clean + moved)).seen - base)[:, np.repeat(record.positions, 3)]
    return background(record, base, noise_of(record, record.seen - base)), float(
        np.sqrt(np.mean(np.sum(true.reshape(len(true), -1, 3) ** 2, axis=2)))
    )


@pytest.mark.parametrize("size", [0.15, 0.4])
def test_a_static_misfit_comes_back_with_its_error(size):
    """Not a polynomial: the displacement along the body by a tanh of one command and the orientation."""
    model, p = builtin_model(), standard_protocol()
    u = np.stack([np.interp(p.t_seen, p.t, c) for c in p.command.T], axis=1)
    lean = p.gravity[np.searchsorted(p.t, p.t_seen, side="right") - 1, 0]
    height = (model.rest[:, 2] / model.rest[:, 2].max()) ** 2
    aside = np.tanh(u[:, 0] / 5.0) + 0.5 * np.cos(u[:, 1] / 6.0) + lean
    moved = size * aside[:, None, None] * height[None, :, None] * np.array([0.6, 0.8, 0.0])
    found, true = level(model, moved)
    assert found.level_mm == pytest.approx(true, abs=max(3 * found.sigma_mm, 0.12 * true))
    assert found.sigma_mm < 0.2 * true


def test_nothing_static_is_no_level():
    model = builtin_model()
    for seed in range(3):
        found, _ = level(model, 0.0, seed)
        assert found.level_mm < 0.03


@pytest.mark.parametrize(("name", "params"), [("backlash", {"backlash.gap": 1.5}), ("lag", {"lag.tau": 0.15})])
def test_memory_is_hardly_static(name, params):
    """A loop has a middle: for a play that starts there, a part of the misfit depends on the command alone."""
    model = builtin_model()
    moved = model.with_effects((name,), params).predict(blank(model)) - model.predict(blank(model))
    found, true = level(model, moved)
    assert found.level_mm < 0.5 * true
