"""Numbers that channels share: one label for all of them until they are given or fitted
separately.
"""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
from effect_paths import T, circle, executed
from finger_runs import finger_run
from laws import BY_ROLE, EFFECTS, random_params

from softmap_edge import _core, builtin_model, refit
from softmap_edge.diagnosis.document import Diagnosis
from softmap_edge.diagnosis.findings import Finding, Number
from softmap_edge.diagnosis.fit import STEP, Problem
from softmap_edge.diagnosis.prepare import problem_of
from softmap_edge.diagnosis.records import record_of
from softmap_edge.errors import SoftmapError
from softmap_edge.model.bundle import load_bundle, save_bundle
from softmap_edge.model.chain_labels import named, valued
from softmap_edge.robot.motion.kinematics import Kinematics

SHARED = [
    name for name in BY_ROLE["channel"] if any(p["shared"] for p in EFFECTS[name]["parameters"])
]
GAPS = {"backlash.gap[0]": 1.4, "backlash.gap[1]": 0.8}
MODEL = builtin_model()


def moved(channels: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Times (T,) s and commands (T, C) mm with reversals of several sizes."""
    t = 0.02 * np.arange(900)
    phase = 0.4 * np.arange(channels)
    return t, 9.0 * np.sin(1.1 * t[:, None] + phase) * np.sin(0.23 * t[:, None] + 0.3)


@pytest.fixture(scope="module")
def problem() -> Problem:
    """A run of the built-in finger with two different plays, without noise except that of the
    camera.
    """
    run = finger_run(["backlash"], GAPS)
    return problem_of(record_of(MODEL, run), ["backlash", "friction", "hysteresis"])


# --- chains ---------------------------------------------------------------------------------------


def test_amounts_of_channels_are_shared():
    assert {
        "backlash",
        "friction",
        "dead_zone",
        "hysteresis",
        "creep",
        "latency",
        "lag",
        "saturation",
    } < set(SHARED)
    chain = _core.Chain(["backlash", "gain", "creep"], 2)
    gain, gap = ["gain.factor[0]", "gain.factor[1]"], ["backlash.gap[0]", "backlash.gap[1]"]
    strength = ["creep.strength[0]", "creep.strength[1]"]
    assert chain.labels == [*gain, *gap, *strength, "creep.tau", "creep.spread"]
    assert chain.tie.tolist() == [0, 1, 2, 2, 3, 3, 4, 5]
    groups = [*gain, *["backlash.gap"] * 2, *["creep.strength"] * 2, "creep.tau", "creep.spread"]
    assert chain.group_labels == groups
    one = _core.Chain(["backlash", "gain"], 1)
    assert (one.labels, one.group_labels) == (
        ["gain.factor[0]", "backlash.gap[0]"],
        ["gain.factor[0]", "backlash.gap"],
    )


@pytest.mark.parametrize("name", SHARED)
def test_each_channel_reads_its_own_number(name):
    """A chain of three channels with different numbers gives the same as three chains of one
    channel.
    """
    t, u = moved(3)
    chain, alone = _core.Chain([name], 3), _core.Chain([name], 1)
    params = random_params(chain, 5)
    by_label, out = dict(zip(chain.labels, params)), chain.rollout(params[None], u, t)[0]
    for c in range(3):
        own = valued(
            alone, {label.replace(f"[{c}", "[0"): v for label, v in by_label.items()}, alone.null
        )
        np.testing.assert_array_equal(
            alone.rollout(own[None], u[:, c : c + 1], t)[0, :, 0], out[:, c]
        )
    rolled = np.concatenate(
        [np.roll(np.flatnonzero(chain.tie == group), 1) for group in np.unique(chain.tie)]
    )
    turned = chain.rollout(params[rolled][None], u, t)[0]
    assert np.abs(turned - out).max() > 1e-3  # the order of the numbers matters


@pytest.mark.parametrize("name", SHARED)
def test_steps_and_parts_of_a_record_are_the_record(name):
    t, u = moved()
    chain = _core.Chain([name], 2)
    params = random_params(chain, 2)
    whole = chain.rollout(params[None], u, t)[0]
    first, state = chain.advance(params[None], u[:400], t[:400])
    rest, _ = chain.advance(params[None], u[400:], t[400:], state=state)
    np.testing.assert_array_equal(np.concatenate([first[0], rest[0]]), whole)
    state, stepped = chain.init(params, u[0]), []
    for k in range(60):
        acting, state = chain.step(params, state, u[k], t[k] - t[max(k - 1, 0)], t[k])
        stepped.append(acting)
    np.testing.assert_array_equal(stepped, whole[:60])


def test_a_set_may_give_a_shared_number_once():
    t, u = moved()
    chain = _core.Chain(["gain", "backlash", "creep"], 2)
    few = np.array([[1.1, 0.9, 0.7, 0.1, 8.0, 2.0], [1.0, 1.0, 0.2, 0.2, 4.0, 1.0]])
    full = few[:, chain.tie]
    np.testing.assert_array_equal(chain.rollout(few, u, t), chain.rollout(full, u, t))
    np.testing.assert_array_equal(chain.init(few[0], u[0]), chain.init(full[0], u[0]))
    with pytest.raises(ValueError, match="params"):
        chain.rollout(full[:, :7], u, t)


# --- models, bundles, documents -------------------------------------------------------------------


def test_labels_of_a_model_are_those_of_all_channels_while_these_agree():
    model = MODEL.with_effects(["backlash", "creep"], {"backlash.gap": 0.7, "creep.strength": 0.1})
    assert model.params == {
        "backlash.gap": 0.7,
        "creep.strength": 0.1,
        "creep.tau": 10.0,
        "creep.spread": 1.0,
    }
    assert MODEL.with_effects(["backlash"], [0.7]).params == {"backlash.gap": 0.7}
    assert MODEL.with_effects(["backlash"], [0.7, 0.5]).params == {
        "backlash.gap[0]": 0.7,
        "backlash.gap[1]": 0.5,
    }
    one = MODEL.with_effects(["backlash"], {"backlash.gap": 0.7, "backlash.gap[1]": 0.2})
    assert one.params == {"backlash.gap[0]": 0.7, "backlash.gap[1]": 0.2}
    assert MODEL.with_effects(["backlash"], one.params).params == one.params
    for wrong in ({"backlash.gap[2]": 1.0}, {"gain.factor": 1.0}):
        with pytest.raises(SoftmapError, match="no parameter"):
            MODEL.with_effects(["backlash", "gain"], wrong)
    with pytest.raises(SoftmapError, match=r"backlash\.gap\[1\] is -1 mm"):
        MODEL.with_effects(["backlash"], {"backlash.gap[0]": 1.0, "backlash.gap[1]": -1.0})


def test_the_cables_of_a_channel_have_a_number_each():
    chain = _core.Chain(["dead_zone", "tendon_creep"], 2)
    slack = [f"dead_zone.slack[{cable}]" for cable in ("0+", "0-", "1+", "1-")]
    assert chain.labels[:4] == slack and chain.group_labels[:4] == ["dead_zone.slack"] * 4
    assert chain.tie.tolist() == [0, 0, 0, 0, 1, 1, 1, 1, 2, 3]
    u = np.array([[2.0, 2.0], [-2.0, -2.0]])
    acting = _core.Chain(["dead_zone"], 2).rollout(
        np.array([[0.5, 1.5, 3.0, 0.0]]), u, np.arange(2.0)
    )[0]
    np.testing.assert_array_equal(acting, [[1.5, 0.0], [-0.5, -2.0]])
    # The label of a channel is for both of its cables, and one of a cable is more exact.
    given = {"dead_zone.slack": 0.4, "dead_zone.slack[0]": 0.7, "dead_zone.slack[0-]": 0.9}
    model = MODEL.with_effects(["dead_zone"], given)
    assert model.params == dict(zip(slack, (0.7, 0.9, 0.4, 0.4)))
    assert MODEL.with_effects(
        ["dead_zone"], {"dead_zone.slack[0]": 0.4, "dead_zone.slack[1]": 0.4}
    ).params == {"dead_zone.slack": 0.4}
    with pytest.raises(SoftmapError, match="no parameter 'dead_zone.slack\\[2\\+\\]'"):
        MODEL.with_effects(["dead_zone"], {"dead_zone.slack[2+]": 1.0})


@pytest.mark.parametrize("name", EFFECTS)
def test_parameters_are_read_back_as_they_are_written(name):
    for channels in (1, 2, 5):
        chain = _core.Chain([name], channels)
        for params in (chain.start, random_params(chain, channels)):
            np.testing.assert_array_equal(
                valued(chain, named(chain, params), np.full(len(params), np.nan)), params
            )


def test_a_bundle_keeps_the_numbers_of_each_channel(tmp_path):
    model = MODEL.with_effects(["backlash"], GAPS)
    read = load_bundle(save_bundle(model, tmp_path / "two"))
    assert read.params == GAPS
    run = finger_run(["backlash"], {"backlash.gap": 1.1})
    np.testing.assert_array_equal(read.predict(run), model.predict(run))
    assert (
        np.abs(read.predict(run) - MODEL.with_effects(["backlash"], [1.1]).predict(run)).max() > 0.1
    )


def test_a_bundle_with_one_number_is_read_and_written_back_the_same(tmp_path):
    """As bundles were written before numbers could differ."""
    folder = save_bundle(MODEL, tmp_path / "before")
    text = (
        json.dumps(
            {"chain": ["backlash"], "params": {"backlash.gap": 0.7}}, indent=1, sort_keys=True
        )
        + "\n"
    )
    (folder / "effects.json").write_text(text)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["sha256"]["effects.json"] = hashlib.sha256(text.encode()).hexdigest()
    (folder / "manifest.json").write_text(json.dumps(manifest))
    again = save_bundle(load_bundle(folder), tmp_path / "after")
    assert (again / "effects.json").read_text() == text


def diagnosis(params: dict[str, float]) -> Diagnosis:
    entry = Finding("backlash", {label: Number(value) for label, value in params.items()})
    return Diagnosis("identified", effects=(entry,))


def test_a_diagnosis_adds_one_number_or_one_for_each_channel():
    assert diagnosis({"backlash.gap": 0.9}).added(MODEL, ["backlash"]).params == {
        "backlash.gap": 0.9
    }
    apart = diagnosis(GAPS).added(MODEL, ["backlash"])
    assert apart.params == GAPS
    # An added effect replaces the one of the model, whichever label that has.
    assert diagnosis({"backlash.gap": 0.9}).added(apart, ["backlash"]).params == {
        "backlash.gap": 0.9
    }
    with pytest.raises(SoftmapError, match="no backlash.gap"):
        diagnosis({"backlash.gap[0]": 1.4}).added(MODEL, ["backlash"])
    with pytest.raises(SoftmapError, match=r"backlash\.gap\[1\] is 80"):
        diagnosis(GAPS | {"backlash.gap[1]": 80.0}).added(MODEL, ["backlash"])


def test_a_diagnosis_from_before_cables_had_numbers_is_still_added():
    numbers = {"dead_zone.slack[0]": Number(0.5), "dead_zone.slack[1]": Number(0.9)}
    added = Diagnosis("identified", effects=(Finding("dead_zone", numbers),)).added(
        MODEL, ["dead_zone"]
    )
    assert added.chain_params.tolist() == [0.5, 0.5, 0.9, 0.9]


# --- fits -----------------------------------------------------------------------------------------


def test_two_plays_are_fitted_apart_where_that_is_asked_for(problem):
    tied = problem.fit(("backlash",), [problem.space(("backlash",)).start])
    assert tied.space.free_labels == ["backlash.gap"] and list(tied.params) == ["backlash.gap"]
    assert 0.8 < tied.params["backlash.gap"] < 1.4 and problem.uncertainty(tied, 1.0).shape == (1,)
    space = problem.space(("backlash",), split=("backlash",))
    apart = problem.fit(("backlash",), [space.start], split=("backlash",))
    assert apart.space.free_labels == list(GAPS)
    assert apart.params == pytest.approx(GAPS, rel=0.02)
    assert tied.chi2 > 2.0 * apart.chi2  # one number cannot explain it
    sigma = problem.uncertainty(apart, 1.0)
    assert sigma.shape == (2,) and np.all((sigma > 0) & (sigma < 0.05))
    model = MODEL.with_effects(("backlash",), apart.params)
    np.testing.assert_allclose(
        model.features(problem.record.run).reshape(apart.predicted.shape), apart.predicted
    )
    np.testing.assert_allclose(apart.on(problem.record), apart.predicted)
    folds = problem.fold_predictions(apart)
    assert problem.held_out_mm(folds) < 0.7 * problem.held_out_mm(problem.fold_predictions(tied))


def test_the_slopes_of_what_is_tied_are_the_sum_of_those_of_its_channels(problem):
    tied, apart = (problem.space(("friction",), split=split) for split in ((), ("friction",)))
    assert tied.free_labels == ["friction.mu", "friction.preload"]
    assert apart.free_labels == [
        "friction.mu[0]",
        "friction.mu[1]",
        "friction.preload[0]",
        "friction.preload[1]",
    ]
    slopes = {}
    for space in (tied, apart):
        modes = problem.at(space, space.start[None])[0]
        slopes[space] = problem.slopes(space, space.start, modes)
    together = slopes[apart].reshape(2, 2, *slopes[apart].shape[1:]).sum(axis=1)
    scale = np.abs(together).max()
    # differences of a bent curve
    np.testing.assert_allclose(slopes[tied], together, atol=5.0 * STEP * scale)


def test_a_fit_goes_on_from_the_numbers_that_the_model_has(problem):
    """Channels that differ in the model stay separate without a request."""
    model = MODEL.with_effects(["backlash"], {"backlash.gap[0]": 1.0, "backlash.gap[1]": 0.6})
    better, report = refit(model, problem.record.run)
    assert better.params == pytest.approx(GAPS, rel=0.02)
    assert report.after_held_out_rms_mm < 0.7 * report.before_rms_mm
    one, _ = refit(MODEL.with_effects(["backlash"], {"backlash.gap": 1.0}), problem.record.run)
    assert one.params == pytest.approx(GAPS, rel=0.02)  # a number for each channel is far better
    own = problem_of(record_of(model, problem.record.run), [])
    assert own.null().params == model.params


def test_runs_that_are_fitted_together_share_the_numbers_of_each_channel():
    one = finger_run(["backlash"], GAPS)
    two = finger_run(["backlash"], GAPS, seed=3)
    shifted = replace(two, vertices=two.vertices + np.array([0.8, 0.0, 0.0]))
    both = problem_of(record_of(MODEL, [one, shifted]), ["backlash", "mount"])
    effects = ("backlash", "mount")
    space = both.space(effects, split=("backlash",))
    fit = both.fit(effects, [space.start], split=("backlash",))
    found = {label: fit.params[label] for label in GAPS}
    assert found == pytest.approx(GAPS, rel=0.03) and fit.params[
        "mount.shift_x@2"
    ] == pytest.approx(0.8, abs=0.05)


# --- control --------------------------------------------------------------------------------------


def test_a_plan_compensates_the_numbers_of_each_channel():
    names, params = (
        ["latency", "backlash"],
        GAPS | {"latency.delay[0]": 0.05, "latency.delay[1]": 0.25},
    )
    truth = MODEL.with_effects(names, params)
    delay, lag = Kinematics(truth).delays
    assert delay.tolist() == [0.05, 0.25] and lag.tolist() == [0.0, 0.0]
    targets = circle(MODEL)
    shared = MODEL.with_effects(names, {"backlash.gap": 1.1, "latency.delay": 0.15})
    ours, theirs = (
        Kinematics(known, axes="xy").plan(targets, T).commands for known in (truth, shared)
    )

    def error(commands):
        return np.linalg.norm((executed(truth, commands) - targets)[60:, :2], axis=1).max()

    assert error(ours) < 0.1 < 0.3 < error(theirs)
