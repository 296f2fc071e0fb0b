"""Inverse kinematics on the shipped finger: tip, solving, plans through effects, what cannot be."""

from pathlib import Path

import numpy as np
import pytest
from effect_paths import T, circle, executed

from softmap_edge import Run, SoftmapError, _core, builtin_model, forget_effect, load_effect
from softmap_edge.robot.motion.kinematics import REACHED, Kinematics

EXAMPLE = Path(__file__).parents[2] / "examples/off_centre_pulley.py"


@pytest.fixture(scope="module")
def model():
    return builtin_model()


def test_the_tip_is_the_middle_of_its_vertices_and_its_slopes_are_true(model):
    u = np.random.default_rng(0).uniform(-4.5, 4.5, (40, 2))
    points = np.asarray(model.prior.evaluate(u)).reshape(40, -1, 3)
    np.testing.assert_allclose(model.tip(u), points[:, model.tip_indices].mean(axis=1), atol=1e-9)
    step = 1e-4
    for c in range(2):
        side = step * np.eye(2)[c]
        slopes = (model.tip(u + side) - model.tip(u - side)) / (2 * step)
        np.testing.assert_allclose(model.tip_jacobian(u)[:, :, c], slopes, atol=1e-5)


def test_shape_effects_and_declared_loads_move_the_tip_and_its_slopes(model):
    heavy = model.with_effects(["gravity"], {"gravity.density": 1.4, "gravity.tilt_x": 20.0})
    u = np.random.default_rng(1).uniform(-4, 4, (20, 2))
    run = Run(
        t=np.arange(20.0),
        command=u,
        t_seen=np.arange(20.0),
        vertices=np.tile(model.rest, (20, 1, 1)),
    )
    expected = heavy.predict(run)[:, model.tip_indices].mean(axis=1)
    np.testing.assert_allclose(heavy.tip(u), expected, atol=1e-6)
    assert np.abs(heavy.tip(u) - model.tip(u)).max() > 0.2
    step = 1e-3
    for c in range(2):
        side = step * np.eye(2)[c]
        slopes = (heavy.tip(u + side) - heavy.tip(u - side)) / (2 * step)
        assert np.median(np.abs(heavy.tip_jacobian(u)[:, :, c] - slopes)) < 2e-3
    loaded = Kinematics(model, load=10.0, gravity=[1.0, 0.0, 0.0])
    assert (
        np.linalg.norm(
            np.asarray(loaded.tip.evaluate(np.zeros((1, 2)))) - model.tip(np.zeros((1, 2)))
        )
        > 1.0
    )


def test_targets_of_known_commands_are_found(model):
    u = np.random.default_rng(2).uniform(-4.5, 4.5, (60, 2))
    solved = Kinematics(model).solve(model.tip(u))
    assert solved.distance.max() <= REACHED and np.quantile(solved.distance, 0.95) < 1e-4
    np.testing.assert_allclose(solved.tip, model.tip(u), atol=REACHED)
    assert np.median(np.abs(solved.acting - u)) < 1e-5


def test_out_of_reach_is_reported_with_the_distance_to_the_nearest_point(model):
    kinematics = Kinematics(model)
    rest = model.tip(np.zeros((1, 2)))[0]
    far = rest + [200.0, 0.0, 0.0]
    solved = kinematics.solve([far, rest])
    axes = [np.linspace(*kinematics.acting_bounds[c], 201) for c in range(2)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    nearest = np.linalg.norm(model.tip(grid) - far, axis=1).min()
    assert 100 < solved.distance[0] <= nearest + 1e-6
    assert kinematics.reaches([far, rest]).tolist() == [False, True]


def test_the_papers_way_is_no_nearer_and_asks_many_times_as_often(model):
    kinematics = Kinematics(model, axes="xy")
    targets = circle(model)[100:200]
    ours, theirs = kinematics.solve(targets), kinematics.solve(targets, method="paper")
    assert ours.distance.max() < 1e-4 and theirs.distance.max() < 0.05
    assert (ours.distance <= theirs.distance + 1e-6).all()
    assert theirs.asked.sum() > 5 * ours.asked.sum()


EFFECTS = {"backlash.gap": 0.6, "creep.strength": 0.12, "creep.tau": 8.0, "gain.factor[0]": 0.93}


def test_a_plan_through_effects_leads_the_tip_where_one_without_does_not(model):
    truth = model.with_effects(["gain", "backlash", "creep"], EFFECTS)
    targets = circle(model)
    naive, plan = (Kinematics(known, axes="xy").plan(targets, T) for known in (model, truth))

    def error(commands):
        return np.linalg.norm((executed(truth, commands) - targets)[50:, :2], axis=1)

    assert error(naive.commands).mean() > 0.5
    assert error(plan.commands).max() < 0.02
    np.testing.assert_allclose(executed(truth, plan.commands)[1:], plan.tip[1:], atol=1e-6)
    assert plan.distance[50:].max() < 0.02 and plan.unreachable.max() < REACHED


def test_a_delay_and_a_lag_are_previewed(model):
    slow = model.with_effects(["latency", "lag"], {"latency.delay": 0.12, "lag.tau": 0.1})
    targets = circle(model)
    naive, plan = (Kinematics(known, axes="xy").plan(targets, T) for known in (model, slow))

    def error(commands):
        return np.linalg.norm((executed(slow, commands) - targets)[60:, :2], axis=1)

    assert error(naive.commands).mean() > 1.0
    assert error(plan.commands).mean() < 0.1
    assert plan.distance[60:].mean() < 0.1


@pytest.mark.parametrize(
    "names, params, least",
    [
        (["rate_limit"], {"rate_limit.speed": 2.0}, 1.0),
        (["lag", "backlash"], {"lag.tau": 0.3, "backlash.gap": 0.6}, 0.1),
    ],
)
def test_what_cannot_be_compensated_is_expected_of_the_plan(model, names, params, least):
    """A limited speed has no inverse, and a lag before a play is previewed as if the play came
    first.
    """
    slow = model.with_effects(names, params)
    targets = circle(model)
    kinematics = Kinematics(slow, axes="xy")
    assert kinematics.compensated == [name for name in names if name != "rate_limit"]
    plan = kinematics.plan(targets, T)
    # as if it had rested at the first command: forgotten after seconds
    found = executed(slow, plan.commands)
    off = np.linalg.norm((found - targets)[200:, :2], axis=1)
    np.testing.assert_allclose(plan.distance[200:], off, atol=1e-3)
    assert off.max() > least


def test_commands_stay_within_sweep_and_window(model):
    small = model.with_effects(["gain"], {"gain.factor[0]": 0.5, "gain.factor[1]": 1.0})
    kinematics = Kinematics(small, axes="xy")
    low, high = np.asarray(model.command_range).T
    np.testing.assert_allclose(kinematics.acting_bounds[0], [0.5 * low[0], 0.5 * high[0]])
    plan = kinematics.plan(circle(model, 40.0), T)
    assert (plan.commands >= low).all() and (plan.commands <= high).all()
    assert plan.unreachable.max() > 5.0


@pytest.mark.parametrize(
    "ask, said",
    [
        (lambda m: Kinematics(m, axes="xq"), "axes 'xq'"),
        (lambda m: Kinematics(m).solve([[1.0, 2.0]]), "expected (T, 3)"),
        (lambda m: Kinematics(m).solve([[1.0, np.nan, 2.0]]), "target 0"),
        (lambda m: Kinematics(m).solve([[1.0, 2.0, 3.0]], method="guess"), "no method 'guess'"),
        (lambda m: Kinematics(m).plan([[0, 0, 90.0]] * 2, [1.0, 1.0]), "let them rise"),
        (lambda m: Kinematics(m, load=np.nan), "load nan g"),
        (lambda m: Kinematics(m, load=1e9), "0 to 10000 g"),
        (lambda m: Kinematics(m, gravity=[0, 0, 0]), "a unit vector (3,)"),
        (lambda m: Kinematics(m).solve([[0, 0, 90.0]], start=[0.0] * 3), "a start of 3 numbers"),
    ],
)
def test_what_makes_no_sense_is_refused(model, ask, said):
    with pytest.raises(SoftmapError, match=said.replace("(", r"\(").replace(")", r"\)")):
        ask(model)


def test_a_users_own_effect_is_refused(model):
    effect = load_effect(EXAMPLE)
    chain = _core.Chain([effect.name], 2)
    try:
        with pytest.raises(SoftmapError, match="Python effect"):
            Kinematics(model.with_effects([effect.name], chain.start))
    finally:
        forget_effect(effect.name)
