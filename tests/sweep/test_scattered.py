"""Scattered commands: the fit is exact where it should be, its smoothing follows the noise, its
error is what comes true.
"""

import numpy as np
import pytest

from benches import trunk_load
from benches.data import find
from softmap_edge import _core
from softmap_edge.sweep.build import model_from_file
from softmap_edge.sweep.scattered import fit_scattered, gap

RNG = np.random.default_rng


def family(fit, size):
    return _core.Scattered(
        fit.nodes, fit.scale, fit.power, fit.coefficients, np.zeros(size), np.eye(size)
    )


def wave(u):
    return np.stack(
        [30 * np.sin(u[:, 0] / 8) * np.cos(u[:, 1] / 10), np.abs(u[:, 0] - u[:, 1])], axis=1
    )


def rms(values):
    return np.sqrt(np.mean(np.square(values), axis=0))


@pytest.mark.parametrize("channels", [1, 2, 4, 9])
def test_linear_shapes_are_exact_inside_and_far_outside(channels):
    u = RNG(0).uniform(-9, 9, (60, channels)) + 40.0
    slope = RNG(1).normal(size=(channels, 3))
    shape = family(fit_scattered(u, u @ slope + 5.0), 3)
    far = RNG(2).uniform(-100, 200, (50, channels))
    np.testing.assert_allclose(shape.evaluate(far), far @ slope + 5.0, atol=1e-6)
    np.testing.assert_allclose(shape.jacobian(far), np.tile(slope.T, (50, 1, 1)), atol=1e-7)


def test_clean_rows_are_met_and_between_them_the_error_falls_fast():
    errors = []
    for rows in (50, 200, 800):
        u = RNG(3).uniform(-16, 16, (rows, 2))
        fit = fit_scattered(u, wave(u)[:, :1], most=800)
        new = RNG(4).uniform(-14, 14, (1000, 2))
        errors.append(rms(family(fit, 1).evaluate(new) - wave(new)[:, :1])[0])
        np.testing.assert_allclose(
            family(fit, 1).evaluate(u), wave(u)[:, :1], atol=0.1 * errors[-1] + 1e-4
        )
    # Spacing halves with four times the rows: between the orders of a scatter's wide and its narrow
    # places.
    assert errors[1] < errors[0] / 5 and errors[2] < errors[1] / 5


@pytest.mark.parametrize(("rows", "noise"), [(100, 0.0), (400, 0.0), (400, 0.3), (1500, 0.3)])
def test_the_stated_error_comes_true_and_is_not_far_too_large(rows, noise):
    rng = RNG(rows)
    u, new = rng.uniform(-16, 16, (rows, 2)), rng.uniform(-14, 14, (2000, 2))
    fit = fit_scattered(u, wave(u) + noise * rng.normal(size=(rows, 2)))
    stated = rms(fit.left_out)
    # what is left out is seen with its noise
    true = np.hypot(rms(family(fit, 2).evaluate(new) - wave(new)), noise)
    assert np.all(true < 1.5 * stated + 1e-3) and np.all(stated < 4.0 * true + 1e-3)
    if noise:
        assert (
            fit.smoothing > 1e-7 and rms(family(fit, 2).evaluate(new) - wave(new))[0] < 0.6 * noise
        )


def test_rows_along_a_path_do_not_vouch_for_one_another():
    """Neighbours in time make leaving one row out far too easy: in order the rows are left out by
    blocks.
    """
    t = np.linspace(0, 24, 1200)
    u = np.stack([14 * np.sin(t), 14 * np.sin(1.3 * t)], axis=1)
    new = RNG(1).uniform(-9, 9, (1000, 2))
    stated = rms(fit_scattered(u, wave(u)).left_out)
    fit = fit_scattered(u[RNG(2).permutation(1200)], wave(u[RNG(2).permutation(1200)]))
    true = rms(family(fit, 2).evaluate(new) - wave(new))
    assert np.all(stated > 0.5 * true) and np.all(stated > 3 * rms(fit.left_out))
    assert gap(u[:300] / 14) > 2 * gap(u / 14) > 2 * gap(RNG(0).uniform(-1, 1, (1200, 2)))


@pytest.mark.skipif(find("trunk") is None, reason="no logs of the trunk (make data)")
def test_a_recording_of_a_real_robot_states_the_error_that_comes_true(tmp_path):
    """Six motors, three bodies: the first 60 % of a recording as a sweep, its last 30 % for
    validation.
    """
    run = trunk_load.read(find("trunk"), trunk_load.FREE)
    u = np.stack([np.interp(run.t_seen, run.t, c) for c in run.commands().T], axis=1)
    share = (run.t_seen - run.t_seen[0]) / np.ptp(run.t_seen)
    first, last = np.flatnonzero(share < 0.6)[::3], share > 0.7
    np.savez(
        tmp_path / "sweep.npz", command=u[first], vertices=run.markers[first], command_unit="deg"
    )
    model = model_from_file(tmp_path / "sweep.npz")
    found = model.prior.evaluate(np.ascontiguousarray(u[last])).reshape(-1, 3, 3)
    error = float(np.sqrt(np.mean(np.sum((found - run.markers[last]) ** 2, axis=2))))
    # a constant is 39 mm off
    assert error < 6.5 and model.vertex_error_mm == pytest.approx(error, rel=0.2)


def test_the_batched_prediction_sees_the_same_shape():
    u = RNG(3).uniform(-10, 10, (80, 2))
    fit = fit_scattered(u, np.concatenate([wave(u), wave(u)[:, :1]], axis=1))
    shape = family(fit, 3)
    chain = _core.Chain(["gain"], 2)
    t = np.arange(5.0)
    at = RNG(6).uniform(-9, 9, (5, 2))
    fields = {"tip_force_z": shape}
    body = _core.Predictor(shape, fields, np.ones(1, bool), np.array([0.0, 0.0, 1.0]))
    for factor in (1.0, 1.2):
        seen = body.predict(
            chain, np.full((3, 2), factor), _core.Inputs(at, t, t, load=np.full(5, 10.0))
        )
        alone = shape.evaluate(factor * at) * (1.0 + 0.01 * 9.80665)
        np.testing.assert_allclose(seen, np.tile(alone[None, :, None], (3, 1, 1, 1)), rtol=1e-12)
    twice = shape.project(2 * np.eye(3), np.ones(3))
    np.testing.assert_allclose(twice.evaluate(at), 2 * shape.evaluate(at) + 1, rtol=1e-12)
