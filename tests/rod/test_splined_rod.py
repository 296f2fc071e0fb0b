"""A robot whose map has kinks that no polynomial follows: its map is learned as smooth splines.

The truth is written down here, apart from the code that is tested.
"""

from dataclasses import replace

import numpy as np
import pytest
from pulled_finger import finger
from rod_commands import commands
from scipy.interpolate import BSpline

from softmap_edge import Run, _core, learn_model, load_bundle, save_bundle
from softmap_edge.errors import SoftmapError
from softmap_edge.model.basis import Basis
from softmap_edge.model.polynomial_rod import PolynomialRodArrays
from softmap_edge.rod.learn import learn, learned_model
from softmap_edge.rod.regression import _ridge


def slack(u):
    """Cables that are loose by different lengths, and a drive that stops before its end."""
    loose = np.sign(u) * np.maximum(np.abs(u) - [2.0, 3.0], 0.0)
    return finger(np.minimum(loose, [4.0, 4.5]))


def recorded(seed=0, start=0.0, seconds=90.0, noise=0.1, shape=slack):
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, 0.02)
    u = commands(t + start)
    markers = shape(u)[::3]
    return Run(t=t, command=u, t_seen=t[::3], markers=markers + rng.normal(0, noise, markers.shape))


def off(model, run, shape=slack):
    return float(np.sqrt(((model.predict(run) - shape(run.commands())[::3]) ** 2).sum(-1).mean()))


def test_kinks_are_followed_by_splines_better_than_by_any_polynomial():
    run, other = recorded(), recorded(1, start=300.0)
    found = learn(run)
    assert found.made_from["intervals"] and "cubic splines of 8 intervals" in str(found)
    error = off(learned_model(run, found), other)
    assert error < 0.3 and min(off(learn_model(run, degree=d), other) for d in (2, 3)) > 1.7 * error
    assert error < 2.0 * found.error_mm  # what the blocks say holds for another run


def test_a_smooth_robot_keeps_its_polynomial():
    def smooth(u):
        bend = 0.05 * u * (1.0 - 0.0005 * u**2)
        return np.stack([np.column_stack([60.0 * bend, np.full(len(u), 80.0)])], axis=1)

    assert not learn(recorded(shape=smooth)).made_from["intervals"]


def test_splines_go_with_the_bundle_and_wrong_ones_are_refused(tmp_path):
    run = recorded()
    found = learn(run, static=True)
    model = learned_model(run, found)
    save_bundle(model, tmp_path / "finger")
    assert np.array_equal(load_bundle(tmp_path / "finger").predict(run), model.predict(run))
    arrays = found.rod.to_npz()
    assert (
        PolynomialRodArrays.from_npz(
            {k: v for k, v in arrays.items() if k != "intervals"}
        ).intervals
        == 0
    )
    for wrong in (-1.0, 2.5, 1e9, np.nan):
        with pytest.raises(SoftmapError, match="intervals, expected 0 to 64"):
            PolynomialRodArrays.from_npz(arrays | {"intervals": np.array([wrong])})
    with pytest.raises(SoftmapError, match="rows"):
        replace(found.rod, intervals=7).compiled()
    with pytest.raises(SoftmapError, match="not both"):
        replace(found.rod, pulled=True).compiled()


def test_the_core_s_splines_are_the_field_s():
    x = np.linspace(-1.0, 1.0, 201)[:, None]
    knots = -1.0 + 2.0 / 5.0 * np.arange(-3, 9)
    other = BSpline.design_matrix(x[:-1, 0], knots, 3).toarray()
    assert np.allclose(_core.tensor_splines(x, 5)[:-1], other, atol=1e-12)
    two = _core.tensor_splines(np.array([[0.3, -0.8]]), 5)[0].reshape(8, 8)
    first, second = (_core.tensor_splines(np.array([[q]]), 5)[0] for q in (0.3, -0.8))
    assert np.allclose(two, np.outer(first, second), atol=1e-12)
    with pytest.raises(SoftmapError, match="5000 terms"):
        _core.tensor_splines(np.zeros((1, 4)), 8)


def test_a_ridge_on_the_terms_is_a_penalty_on_second_differences():
    """The same fit as with explicit B-splines and differences of their coefficients along both
    commands.
    """
    rng, basis, ridge = np.random.default_rng(0), Basis(3, intervals=4), 0.3
    q = rng.uniform(-1.0, 1.0, (200, 2))
    y = np.sin(3.0 * q[:, :1]) * q[:, 1:] + 0.1 * rng.normal(size=(200, 1))
    own = _ridge(basis.terms(q), y, ridge * basis.penalty(2), [])[-1]
    weights = basis.in_core(own, 2)
    splines = _core.tensor_splines(q, 4)
    second = np.diff(np.eye(7), 2, axis=0)
    rough = np.kron(second.T @ second, np.eye(7)) + np.kron(np.eye(7), second.T @ second)
    system = splines.T @ splines + 200 * ridge * 1e-3 * rough
    explicit = splines @ np.linalg.solve(system, splines.T @ y)
    # lines have a small ridge too
    assert np.allclose(splines @ weights[1:] + weights[0], explicit, atol=5e-3)
    assert np.ptp(own) > 0 and basis.count(2) == 48  # the constant is the intercept


def test_frames_that_other_blocks_do_not_cover_are_not_tested():
    """One excursion beyond all other commands says nothing of the accuracy within them."""
    run = recorded()
    far = np.where((run.t > 40.0) & (run.t < 41.0), 1.0, 0.0)[:, None] * [5.0, -6.0]
    moved = run.commands() + far
    excursion = replace(run, command=moved, markers=slack(moved)[::3])
    found = learn(excursion, static=True)
    tested = np.isfinite(found.residuals[:, 0, 0])
    away = (excursion.t_seen[found.frames[0]] > 40.0) & (excursion.t_seen[found.frames[0]] < 41.0)
    assert not tested[away].all() and tested[~away].mean() > 0.9
    assert np.isfinite(found.error_mm) and found.error_mm < 2.0 * learn(run, static=True).error_mm
