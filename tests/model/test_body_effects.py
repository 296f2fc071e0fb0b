"""A softer body, and cables that rub along it: effects of the shape that need a load or a
memory.
"""

from dataclasses import replace

import numpy as np
import pytest
from finger_runs import finger_run
from laws import slot

from softmap_edge import _core, builtin_model
from softmap_edge.diagnosis.evidence import detectability, unseen
from softmap_edge.diagnosis.fit import Problem
from softmap_edge.diagnosis.prepare import problem_of
from softmap_edge.diagnosis.records import record_of
from softmap_edge.model.bundle import load_bundle, save_bundle
from softmap_edge.model.parameter_layout import ranges_of
from softmap_edge.robot.motion.kinematics import Kinematics
from softmap_edge.run.run import Run

MODEL = builtin_model()
RUBBING = {"body_friction.amount": 0.8, "body_friction.width": 1.3}


def rms(moved):
    return float(np.sqrt(np.mean(np.sum(np.square(moved), axis=-1))))


def moves(load=0.0, gravity=(0.0, 0.0, 1.0)) -> Run:
    """Commands that load and unload both channels, seen between their samples."""
    t = 0.05 * np.arange(600)
    u = np.stack([11.0 * np.sin(0.5 * t), 7.0 * np.sin(0.31 * t + 0.4)], axis=1)
    seen = t[5:-5:7] + 0.017
    return Run(t=t, command=u, t_seen=seen, gravity=np.array(gravity), load=np.full(len(t), load))


# --- stiffness ------------------------------------------------------------------------------------


def test_a_soft_body_shows_under_a_load_and_hardly_without():
    soft = MODEL.with_effects(["stiffness"], {"stiffness.amount": np.log(0.7)})
    hanging, loaded = moves(), moves(load=25.0, gravity=(1.0, 0.0, 0.0))
    still, moved = (rms(soft.predict(run) - MODEL.predict(run)) for run in (hanging, loaded))
    assert still < 0.25 and moved > 1.0


def loaded_run(names, params, load, gravity) -> Run:
    run = replace(finger_run(), gravity=np.array(gravity), load=np.full(len(finger_run().t), load))
    true = MODEL.with_effects(names, params)
    points = true.predict(run)
    return replace(run, vertices=points + 0.25 * np.random.default_rng(3).normal(size=points.shape))


def test_stiffness_is_recovered_under_a_load_and_not_testable_without():
    truth = {"stiffness.amount": -0.35}
    heavy = loaded_run(("stiffness",), truth, 20.0, (0.8, 0.0, 0.6))
    problem = problem_of(record_of(MODEL, heavy), ["stiffness", "gain"])
    fit = problem.fit(("stiffness",), [problem.space(("stiffness",)).start])
    assert fit.params["stiffness.amount"] == pytest.approx(-0.35, rel=0.05)
    moved, white = detectability(problem, "stiffness")
    assert unseen(moved, float(np.linalg.norm(white))) is None
    hanging = loaded_run((), {}, 0.0, (0.0, 0.0, 1.0))
    moved, white = detectability(
        problem_of(record_of(MODEL, hanging), ["stiffness", "gain"]), "stiffness"
    )
    assert "moves the centreline by only 0.0" in str(unseen(moved, float(np.linalg.norm(white))))


# --- friction along the body ----------------------------------------------------------------------


def loading(run: Run, width: float) -> np.ndarray:
    """The load of the body by the relays of all channels (K,) at the seen times, read linearly as
    commands are.
    """
    relay = np.stack([(u - slot(u, width)) / width for u in run.command.T], axis=1)
    z, u = (
        np.stack([np.interp(run.t_seen, run.t, c) for c in a.T], axis=1)
        for a in (relay, run.command)
    )
    return np.sum(z * u, axis=1) / np.linalg.norm(u, axis=1)


def test_body_friction_is_a_stiffness_gradient_that_changes_with_the_direction():
    run = moves()
    found = MODEL.with_effects(["body_friction"], RUBBING).predict(run)
    share = loading(run, RUBBING["body_friction.width"])
    assert share.max() > 0.9 and share.min() < -0.9
    for k in range(0, run.frames, 9):
        gradient = {"stiffness_gradient.gradient": RUBBING["body_friction.amount"] * share[k]}
        wanted = MODEL.with_effects(["stiffness_gradient"], gradient).predict(run)[k]
        np.testing.assert_allclose(found[k], wanted, atol=1e-9)
    assert rms(found - MODEL.predict(run)) > 0.3


def test_no_lag_of_the_command_does_what_body_friction_does():
    problem = friction_problem()
    left = {}
    for name in ("body_friction", "backlash", "lag", "hysteresis"):
        space = problem.space((name,))
        left[name] = problem.held_out_mm(
            problem.fold_predictions(problem.fit((name,), [space.start]))
        )
    null = problem.held_out_mm(problem.fold_predictions(problem.null()))
    assert left["body_friction"] < 0.6 * null
    assert min(left["backlash"], left["lag"], left["hysteresis"]) > 1.3 * left["body_friction"]


def friction_problem() -> Problem:
    run = finger_run(["body_friction"], RUBBING, noise=0.1)
    return problem_of(record_of(MODEL, run), ["body_friction", "backlash", "lag", "hysteresis"])


def test_body_friction_is_recovered_also_behind_a_play():
    problem = friction_problem()
    fit = problem.fit(("body_friction",), [problem.space(("body_friction",)).start])
    assert fit.params == pytest.approx(RUBBING, rel=0.05)
    both = finger_run(["backlash", "body_friction"], RUBBING | {"backlash.gap": 1.0}, noise=0.1)
    problem = problem_of(record_of(MODEL, both), ["backlash", "body_friction"])
    effects = ("backlash", "body_friction")
    fit = problem.fit(effects, [problem.space(effects).start])
    assert fit.params == pytest.approx(RUBBING | {"backlash.gap": 1.0}, rel=0.08)


def test_batches_slopes_and_what_acts_know_the_memory():
    run, names = moves(), ("gain", "body_friction", "payload")
    sets = np.array(
        [[1.0, 1.0, 0.5, 1.3, 0.0], [1.1, 0.9, 0.5, 1.3, 5.0], [1.1, 0.9, 0.9, 2.0, 5.0]]
    )
    together = MODEL.predict_features(names, sets, run)
    for one, found in zip(sets, together):
        np.testing.assert_array_equal(MODEL.predict_features(names, one[None], run)[0], found)
    acts = MODEL.acting(names, sets, run)
    assert acts.shape == (3, run.frames, 2)
    np.testing.assert_array_equal(acts, MODEL.acting(("gain",), sets[:, :2], run))
    # Slopes over the effective commands leave the memory unchanged: they are those of the
    # equivalent gradient.
    share, k = loading(run, 1.3), 40
    steps = np.array([0.05, 0.05])
    slopes = MODEL.slopes(("body_friction",), sets[0, 2:4], steps, run)[:, k]
    moved = []
    for c in range(2):
        for side in (1.0, -1.0):
            at = replace(run, command=run.command + side * np.eye(2)[c] * steps[c])
            z = [np.interp(run.t_seen[k], run.t, (u - slot(u, 1.3)) / 1.3) for u in run.command.T]
            u = [np.interp(run.t_seen[k], run.t, column) for column in at.command.T]
            gradient = 0.5 * float(np.dot(z, u)) / float(np.linalg.norm(u))
            moved.append(
                MODEL.predict_features(("stiffness_gradient",), np.array([[gradient]]), at)[0, k]
            )
    wanted = np.array([(moved[0] - moved[1]) / 0.1, (moved[2] - moved[3]) / 0.1])
    np.testing.assert_allclose(slopes, wanted, atol=1e-7)
    assert abs(share[k]) > 0.1


def test_bundles_keep_it_and_plans_say_that_they_do_not_compensate_it(tmp_path):
    model = MODEL.with_effects(["backlash", "body_friction"], RUBBING | {"backlash.gap": 0.5})
    read = load_bundle(save_bundle(model, tmp_path / "rubs"))
    run = moves()
    assert read.params == model.params
    np.testing.assert_array_equal(read.predict(run), model.predict(run))
    assert Kinematics(read).compensated == ["backlash"]
    bare = MODEL.with_effects(["backlash"], {"backlash.gap": 0.5})
    np.testing.assert_array_equal(
        read.tip(np.array([[5.0, 2.0]])), bare.tip(np.array([[5.0, 2.0]]))
    )


# --- ranges ---------------------------------------------------------------------------------------


def test_a_fit_goes_beyond_what_is_plausible_as_far_as_the_robot_reaches():
    """A play of 6 mm of commands of ±16 mm, and 170 g at the tip: beyond the plausible 4 mm and 150
    g.
    """
    run = finger_run(["backlash"], {"backlash.gap": 6.0})
    problem = problem_of(record_of(MODEL, run), ["backlash"])
    space = problem.space(("backlash",))
    assert [*space.values(space.usual_high), *space.values(space.high)] == pytest.approx(
        [4.0, 32.0]
    )
    fit = problem.fit(("backlash",), [space.start])
    assert fit.params["backlash.gap"] == pytest.approx(6.0, rel=0.02)
    payload = problem.space(("payload",))
    most = payload.values(payload.high)[0]
    assert 150.0 < most == pytest.approx(MODEL.weight_per_length)
    home = np.zeros((1, 2))
    moved = [
        MODEL.fields[f"tip_force_{a}"].evaluate(home).reshape(-1, 3)[MODEL.tip_indices].mean(0)
        for a in "xy"
    ]
    length = max(np.linalg.norm(one) for one in moved) * most * 9.80665e-3
    assert length == pytest.approx(np.ptp(MODEL.structure.arc_length))


@pytest.mark.parametrize(
    "half, unit", [(16.0, "mm"), (4.0, "mm"), (4.0, "N"), (90.0, "deg"), (1.2, "rad")]
)
def test_ranges_are_a_share_of_the_commands_in_every_unit(half, unit):
    model = replace(
        MODEL.with_structure(command_range=np.array([[-half, half]] * 2)), command_unit=unit
    )
    chain = _core.Chain(["backlash", "lag", "payload"], 2)
    ranges = ranges_of(model, chain)
    found = dict(zip(chain.group_labels, zip(ranges.start, ranges.low, ranges.high, ranges.limit)))
    assert found["backlash.gap"] == pytest.approx(
        (0.4 * half / 16, 0.04 * half / 16, 4.0 * half / 16, 2.0 * half)
    )
    assert found["lag.tau"] == pytest.approx((0.12, 0.02, 3.0, 3.0))
    assert found["payload.mass"] == pytest.approx((10.0, 0.0, 150.0, MODEL.weight_per_length))
