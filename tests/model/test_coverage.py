"""Commands that taught a model: leverage covers combinations of channels, a box per channel does
not.
"""

from dataclasses import replace

import numpy as np
import pytest
from recorded_arms import arc, recorded, wander

from softmap_edge import Run, diagnose, learn_model, load_bundle, save_bundle
from softmap_edge.errors import BundleError, SoftmapError
from softmap_edge.model.basis import Basis
from softmap_edge.model.coverage import LARGER, Coverage
from softmap_edge.model.training_range import command_extrapolation


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
    # ε is 1e-5 of the features
    np.testing.assert_allclose(coverage.excess(u), hat / hat.max(), rtol=2e-3)
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
    assert command_extrapolation(model, run_of(wander(t + 3.0, 9.0), t)) == []
    (farther,) = command_extrapolation(model, run_of(wander(t, 15.0), t))
    assert (
        "channel 0 goes from" in farther
        and "extrapolates" in farther
        and "leverage up to" in farther
    )
    together = learn_model(
        run_of(np.repeat(wander(t)[:, :1], 2, axis=1) + 0.3 * wander(t + 9.0), t)
    )
    reach = 0.6 * together.command_range[:, 1].min()
    apart = reach * np.stack([np.sin(t), -np.sin(t)], axis=1)
    (said,) = command_extrapolation(together, run_of(apart, t))
    assert "they were never moved together like this" in said and "goes from" not in said


def test_it_travels_with_the_bundle_and_is_read_as_a_strangers_file(tmp_path):
    model = learn_model(recorded(seconds=40.0))
    again = load_bundle(save_bundle(model, tmp_path / "finger"))
    u = wander(np.arange(0.0, 20.0, 0.1), 14.0)
    assert model.coverage is not None and again.coverage is not None
    np.testing.assert_array_equal(again.coverage.excess(u), model.coverage.excess(u))
    for name, wrong in {
        "root": np.eye(3),
        "half": np.zeros(2),
        "most": np.zeros(1),
        "basis": np.array([9.0, 0]),
    }.items():
        arrays = model.arrays.prior.to_npz() | {f"coverage_{name}": wrong}
        with pytest.raises(SoftmapError, match="coverage"):
            Coverage.from_npz(arrays, 2)
        changed = {"basis": Basis(9)} if name == "basis" else {name: wrong}
        prior = replace(model.arrays.prior, coverage=replace(model.coverage, **changed))
        damaged = replace(model, arrays=replace(model.arrays, prior=prior))
        save_bundle(damaged, tmp_path / name)
        with pytest.raises(BundleError, match="coverage"):
            load_bundle(tmp_path / name)


def test_a_diagnosis_sets_frames_aside_that_the_model_can_only_guess():
    """A polynomial of the commands that taught it is far off where both bend far at once: no effect
    of the robot.
    """

    # a robot that no cubic follows: its second servo pulls less while the first one pulls far
    def kinked(u):
        return arc(
            np.stack(
                [u[:, 0], u[:, 1] * (1.0 - 1.5 * (np.maximum(u[:, 0] - 6.0, 0.0) / 4.0) ** 2)],
                axis=1,
            )
        )

    def seen(u, t, seed):
        markers = kinked(u)[::3]
        return Run(
            t=t,
            command=u,
            t_seen=t[::3],
            markers=markers + np.random.default_rng(seed).normal(0, 0.1, markers.shape),
        )

    t = np.arange(0.0, 60.0, 0.02)
    model = learn_model(seen(np.clip(wander(t), -6.0, 6.0), t, 0))
    inside, outside = np.clip(wander(t + 100.0), -6.0, 6.0), wander(t + 100.0, 10.0)
    some = seen(np.where((t % 20.0 < 15.0)[:, None], inside, outside), t, 1)
    found = diagnose(model, some)
    (said,) = [
        text for text in found.remarks if "unlike all that the model was learned from" in text
    ]
    assert "are set aside" in said and found.verdict in ("nothing", "cannot_tell")
    assert (
        found.error.model
        < 0.3
        < 1.0
        < np.sqrt(((model.predict(some) - some.markers) ** 2).sum(-1).mean())
    )
    most = diagnose(model, seen(wander(t + 100.0, 14.0), t, 1))  # nothing would be left
    assert not any("unlike all" in text for text in most.remarks)
