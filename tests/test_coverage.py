"""Commands that taught a model: leverage covers combinations of channels, a box per channel does not."""

from dataclasses import replace

import numpy as np
import pytest
from test_learned_memory import arc, recorded, wander

from softmap_edge import Run, learn_model, load_bundle, save_bundle
from softmap_edge.coverage import LARGER, Coverage
from softmap_edge.errors import BundleError, SoftmapError
from softmap_edge.outside import beyond


def diagonal(n=400, seed=0):
    """Two channels that always move together, but for 3 % of the range."""
    rng = np.random.default_rng(seed)
    along = rng.uniform(-10, 10, n)
    return np.stack([along, along + rng.uniform(-0.6, 0.6, n)], axis=1)


def test_leverage_is_that_of_the_hat_matrix():
    u = np.random.default_rng(1).uniform(-3, 7, (60, 2))
    q = (u - 0.5 * (u.min(0) + u.max(0))) / (0.5 * np.ptp(u, axis=0))
    x = np.column_stack([np.ones(60), q, q[:, 0] ** 2, q[:, 0] * q[:, 1], q[:, 1] ** 2])
    hat = np.diag(x @ np.linalg.inv(x.T @ x) @ x.T)
    coverage = Coverage.of(u)
    np.testing.assert_allclose(coverage.excess(u), hat / hat.max(), rtol=2e-3)  # ε is 1e-5 of the features
    assert not coverage.outside(u).any()


def test_a_single_channel_may_leave_its_range_by_a_tenth():
    coverage = Coverage.of(np.linspace(-10, 10, 200)[:, None])
    assert not coverage.outside(np.array([[10.5], [-10.5]])).any()
    assert coverage.outside(np.array([[12.0], [-12.0]])).all()


def test_a_combination_that_was_never_moved_is_outside_though_each_channel_is_within():
    coverage = Coverage.of(diagonal())
    assert not coverage.outside(diagonal(seed=1)).any()
    apart = np.array([[8.0, -8.0], [5.0, -2.0], [0.0, 4.0]])
    assert np.all(np.abs(apart) < 10.0) and coverage.outside(apart).all()
    assert (coverage.excess(apart) > 3 * LARGER).all()


def test_directions_that_never_moved_count_too():
    three = np.random.default_rng(2).uniform(-5, 5, (300, 2))
    tendons = np.column_stack([three, -three.sum(axis=1)])  # they add up to zero
    coverage = Coverage.of(tendons)
    assert not coverage.outside(tendons).any()
    assert coverage.outside(np.array([[3.0, 3.0, 3.0]])).all()


def run_of(u, t):
    return Run(t=t, command=u, t_seen=t[::3], markers=arc(u)[::3])


def test_a_run_that_leaves_them_is_warned_of_in_one_line():
    model, t = learn_model(recorded(seconds=60.0)), np.arange(0.0, 30.0, 0.02)
    assert beyond(model, run_of(wander(t + 3.0, 9.0), t)) == []
    (farther,) = beyond(model, run_of(wander(t, 15.0), t))
    assert "channel 0 goes from" in farther and "extrapolates" in farther and "leverage up to" in farther
    together = learn_model(run_of(np.repeat(wander(t)[:, :1], 2, axis=1) + 0.3 * wander(t + 9.0), t))
    reach = 0.6 * together.command_range[:, 1].min()
    apart = reach * np.stack([np.sin(t), -np.sin(t)], axis=1)
    (said,) = beyond(together, run_of(apart, t))
    assert "they were never moved together like this" in said and "goes from" not in said


def test_it_travels_with_the_bundle_and_is_read_as_a_strangers_file(tmp_path):
    model = learn_model(recorded(seconds=40.0))
    again = load_bundle(save_bundle(model, tmp_path / "finger"))
    u = wander(np.arange(0.0, 20.0, 0.1), 14.0)
    assert model.coverage is not None and again.coverage is not None
    np.testing.assert_array_equal(again.coverage.excess(u), model.coverage.excess(u))
    for name, wrong in {"root": np.eye(3), "half": np.zeros(2), "most": np.zeros(1)}.items():
        arrays = dict(model.arrays["prior"]) | {f"coverage_{name}": wrong}
        with pytest.raises(SoftmapError, match="coverage"):
            Coverage.from_arrays(arrays, 2)
        damaged = replace(model, arrays={**model.arrays, "prior": arrays})
        save_bundle(damaged, tmp_path / name)
        with pytest.raises(BundleError, match="coverage"):
            load_bundle(tmp_path / name)
