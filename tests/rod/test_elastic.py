"""A robot whose tendons are known: its elastic rod is fitted from a run; numbers that
the run does not identify are named.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from learned_tendon_arm import learned_from_rough, seen_exactly
from tendon_arm import ARM, ROUGH, arm, moves, recorded

from softmap_edge import Robot, _core, compare, diagnose, learn_model, load_bundle
from softmap_edge import save_bundle as save
from softmap_edge.cli import main
from softmap_edge.errors import RobotError, RunError, SoftmapError
from softmap_edge.model.elastic_rod import ElasticRodArrays
from softmap_edge.rod.learn import learn
from softmap_edge.run.folds import folds

run = pytest.fixture(scope="module")(seen_exactly)
learned = pytest.fixture(scope="module")(learned_from_rough)


def test_a_rod_is_recovered_exactly_from_rough_numbers(learned):
    truth = arm()
    # The rest is where the descent stops (1e-7 of the sum of squares), far below any camera's
    # noise.
    assert learned.error_mm < 1e-3
    np.testing.assert_allclose(learned.rod.numbers, truth.start, atol=1e-3, rtol=1e-3)
    u = np.random.default_rng(1).uniform(-6, 6, (50, 6))
    assert (
        np.abs(
            learned.rod.compiled().evaluate(u) - truth.layout.compiled(truth.start).evaluate(u)
        ).max()
        < 1e-2
    )
    assert all(not number.note and not number.at_bound for number in learned.numbers)
    assert learned.made_from["starts_that_agree"] > 1 and learned.notes == ()


def test_without_freedom_the_same_rod_fails(run, learned):
    """The recovery is necessary: the rough numbers miss by far more."""
    rough = arm(**ROUGH)
    off = rough.layout.compiled(rough.start).evaluate(run.command) - run.markers.reshape(
        len(run.t), -1
    )
    assert np.sqrt((off**2).mean()) > 1000 * learned.error_mm


def test_unknown_angles_are_found_from_the_run(run):
    robot = arm(**ROUGH | {"angle_deg = [0, 120, 240, 60, 180, 300]": ""})
    assert not robot.angles_known
    found = learn(run, robot=robot)
    assert found.error_mm < 1e-3
    angle = found.rod.numbers[found.rod.layout.places()["angle"]]
    wanted = arm().start[found.rod.layout.places()["angle"]]
    np.testing.assert_allclose(np.cos(angle - wanted), 1.0, atol=1e-6)


def test_two_sided_tendons_have_the_linear_closed_form():
    robot = arm(**{"slack = 0.0": "slack = 1.0"})
    rod, places = robot.layout.compiled(robot.start), robot.layout.places()
    angle, radius, drawn, stiffness = (
        robot.start[places[k]] for k in ("angle", "radius", "pretension", "stiffness")
    )
    reach = np.zeros((6, 4))  # an outer tendon bends both segments
    for j, end in enumerate(robot.layout.ends):
        reach[j, : 2 * end + 2] = np.tile(
            radius[j] * np.array([np.cos(angle[j]), np.sin(angle[j])]), end + 1
        )
    u = np.random.default_rng(2).uniform(-6, 6, (20, 6))
    system = np.diag(np.repeat(stiffness, 2)) + reach.T @ reach
    bends, stretch = rod.state(u)
    np.testing.assert_allclose(
        bends, np.linalg.solve(system, reach.T @ (u + drawn).T).T, atol=1e-12
    )
    np.testing.assert_allclose(stretch, u + drawn - bends @ reach.T, atol=1e-12)


def test_cables_never_push_and_the_share_of_stiffness_lies_between():
    cable, rod, half = (arm(**{"slack = 0.0": f"slack = {s}"}) for s in (0.0, 1.0, 0.3))
    u = np.random.default_rng(3).uniform(-6, 6, (40, 6))
    bent = [r.layout.compiled(r.start).state(u)[0] for r in (cable, half, rod)]
    assert np.abs(bent[0] - bent[2]).max() > 0.1
    away = [np.linalg.norm(b - bent[0]) for b in bent]
    assert 0.0 < away[1] < away[2]
    paid_out = cable.layout.compiled(cable.start).state(np.full((1, 6), -9.0))
    np.testing.assert_allclose(paid_out[0], 0.0, atol=1e-15)
    np.testing.assert_allclose(paid_out[1], -8.5)


def test_the_ratio_of_stiffness_is_itself_a_number_that_can_be_fitted():
    truth = arm(**{"slack = 0.0": "slack = 0.3"})
    guess = arm(**{"[fit]": '[fit]\nslack = "fitted"'})
    found = learn(recorded(truth, rate=5.0), robot=guess)
    assert found.rod.numbers[0] == pytest.approx(0.3, abs=1e-3) and found.error_mm < 1e-2


def test_a_wrong_law_of_the_tendons_is_seen_in_the_held_out_error(run, learned):
    assert learn(run, robot=arm().with_slack(1.0)).error_mm > 1000 * learned.error_mm


def test_what_a_run_does_not_identify_is_named():
    """A pair of two-sided tendons on one segment shows r/(κ + 2r²) alone: neither radius nor
    stiffness.
    """
    text = """
schema = "softmap.robot/1"
[body]
segments = 1
length_mm = 100
stiffness_mm2 = 8
[tendons]
segment = [1, 1]
angle_deg = [0, 180]
radius_mm = 5
slack = 1
[fit]
radius = "shared"
stiffness = "each"
length = "shared"
"""
    found = learn(recorded(Robot.from_toml(text), rate=5.0, noise=0.3), robot=Robot.from_toml(text))
    notes = {number.label: number.note for number in found.numbers}
    assert "radius" in notes["stiffness[0]"] or "not told" in notes["stiffness[0]"]
    assert notes["radius"] and notes["length"] == ""
    assert any("stiffness[0]" in note and "radius" in note for note in found.notes)
    # the prediction does not suffer
    assert found.error_mm == pytest.approx(0.3 * np.sqrt(3), rel=0.1)
    cable = text.replace("slack = 1", "slack = 0")  # a cable's slack distinguishes them
    found = learn(
        recorded(Robot.from_toml(cable), rate=5.0, noise=0.3), robot=Robot.from_toml(cable)
    )
    assert all(number.note == "" for number in found.numbers) or found.numbers[0].sigma < 1.0


def test_long_runs_are_thinned_evenly():
    run = recorded(arm(), seconds=300.0)
    found = learn(run, robot=arm(**ROUGH))
    (frames,) = found.frames
    assert run.frames == 6000 and len(frames) == 2000 and set(np.diff(frames)) == {3}
    assert found.error_mm < 1e-3


def test_a_start_too_far_off_is_reported():
    far = arm(
        **ROUGH
        | {"angle_deg = [0, 120, 240, 60, 180, 300]": "angle_deg = [0, 240, 240, 60, 180, 300]"}
    )
    truth = arm(
        **{"angle_deg = [0, 120, 240, 60, 180, 300]": "angle_deg = [0, 110, 240, 60, 180, 300]"}
    )
    found = learn(recorded(truth, rate=5.0), robot=far)
    assert [number.label for number in found.numbers if number.at_bound] == ["angle[1]"]
    assert any("angle[1]" in note and "robot.toml" in note for note in found.notes)


def test_stated_uncertainty_holds_the_truth():
    truth = arm()
    found = learn(recorded(truth, rate=5.0, noise=0.5), robot=arm(**ROUGH))
    space = arm(**ROUGH).coordinates()
    for number, indices, kind in zip(found.numbers, space.moved, space.kinds):
        true = truth.start[indices[0]]
        true = np.rad2deg(true) if kind in ("angle", "tilt") else true
        # Thirteen numbers of one draw: four standard deviations.
        assert abs(number.value - true) < 4 * number.sigma, number
    assert found.error_mm == pytest.approx(0.5 * np.sqrt(3), rel=0.1)


@pytest.mark.long
def test_delay_and_lag_of_the_drive_are_found_where_the_log_is_fast_enough(run):
    def late(t, channels):
        fine = np.arange(-5.0, t[-1] + 0.1, 1e-3)
        u, lagged = moves(np.maximum(fine, 0.0), channels), np.zeros((len(fine), channels))
        lagged[0] = u[0]
        for i in range(1, len(fine)):
            lagged[i] = lagged[i - 1] + 1e-3 / 0.1 * (u[i] - lagged[i - 1])
        return np.stack([np.interp(t - 0.12, fine, lagged[:, c]) for c in range(channels)], axis=1)

    found = learn(recorded(arm(), drive=late, seconds=40.0), robot=arm(**ROUGH))
    # A slow drive shows its delay and lag mostly as their sum; the last steps of the search are
    # 0.02 s / 2⁴.
    assert sum(found.chain_params.values()) == pytest.approx(0.22, abs=0.02)
    assert found.error_mm < 0.3
    assert learn(run, robot=arm(**ROUGH)).chain_names == ()
    slow = recorded(arm(), drive=late, rate=2.0)
    assert learn(slow, robot=arm(**ROUGH)).chain_names == ()


def test_motors_that_move_several_tendons_and_commands_in_degrees():
    pairs = {
        "segment = [1, 1, 1, 2, 2, 2]": (
            "segment = [1, 1, 1, 1, 2, 2, 2, 2]\ncommand = [1, 1, 2, 2, 3, 3, 4, 4]\n"
            "pull = [0.2, -0.2, 0.2, -0.2, 0.2, -0.2, 0.2, -0.2]"
        ),
        "angle_deg = [0, 120, 240, 60, 180, 300]": (
            "angle_deg = [0, 180, 90, 270, 45, 225, 135, 315]"
        ),
    }
    truth = arm(**pairs)
    run = recorded(truth, drive=lambda t, c: 5 * moves(t, c), rate=5.0)
    run = replace(run, command=5 * run.command, command_unit="deg")
    rough = {k: v for k, v in ROUGH.items() if not k.startswith("angle")}
    model = learn_model(run, robot=arm(**{**pairs, **rough}))
    assert model.channels == 4 and model.command_unit == "deg" and model.vertex_error_mm < 1e-2


# --- folds, motion, errors ----------------------------------------------------------------------


def test_folds_by_label_deal_out_complete_labels():
    t = np.arange(0.0, 60.0, 0.5)
    labels = np.array([f"move {int(x // 5)}" for x in t])  # 12 labels
    parts = folds(t, 5, 1.0, labels)
    assert len(parts) == 10
    assert np.array_equal(np.sort(np.concatenate([test for _, test in parts])), np.arange(len(t)))
    for train, test in parts:
        assert not set(labels[test]) & set(labels[train])
        assert np.abs(t[train][:, None] - t[test]).min() > 1.0
    # far apart in time, so are kinds of moves
    assert set(labels[parts[0][1]]) == {"move 0", "move 10"}
    with pytest.raises(RunError, match="blocks"):
        folds(t, 5, 1.0, np.zeros(len(t)))


def test_a_run_that_hardly_moves_is_refused_with_numbers(run):
    with pytest.raises(RunError, match=r"each of the 6 commands .* at 3 mm"):
        learn(replace(run, command=np.full_like(run.command, 3.0)), robot=arm())
    still = run.markers[:1] + 0.001 * (run.markers - run.markers[:1])
    for robot in (arm(), None):
        with pytest.raises(RunError, match=r"hardly moves: its markers scatter by 0\.\d+ mm"):
            learn(replace(run, markers=still), robot=robot)


def test_commands_that_explain_nothing_are_warned_of(run, tmp_path, capsys):
    shuffled = np.random.default_rng(0).permutation(run.frames)
    noise = replace(run, markers=run.markers[shuffled])
    assert any("mean pose" in note for note in learn(noise, degree=1).notes)
    command = run.command.copy()
    command[:, 4] = 2.5
    replace(run, command=command).save(tmp_path / "run.npz")
    assert main(["learn", str(tmp_path / "run.npz"), "--out", str(tmp_path / "rod")]) == 0
    assert "command 5 stays at 2.5 mm" in capsys.readouterr().err


def test_a_run_of_another_robot_is_refused(run):
    with pytest.raises(RobotError, match="6 commands and 2 markers"):
        learn(replace(run, markers=run.markers[:, :2]), robot=arm())
    with pytest.raises(RobotError, match="numbers to fit"):
        learn(run.at(np.arange(run.frames) < 4), robot=arm())
    with pytest.raises(RunError, match="0 coordinates are left to fit 14 numbers"):
        learn(replace(run, block=np.arange(run.frames) % 2), robot=arm())
    known = arm(**{line: "" for line in ARM.split("[fit]\n")[1].splitlines()})
    with pytest.raises(RobotError, match="0 numbers to fit"):
        learn(run, robot=known)
    with pytest.raises(SoftmapError, match="robot.toml"):
        learn(run, robot=arm(), degree=2)


# --- a model like any other ---------------------------------------------------------------------


def test_one_newton_across_the_tip_moves_it_by_a_tenth_of_the_length(learned):
    fields = learned.rod.fields()
    assert set(fields) == {*_core.LOADS, "curve_x", "curve_y", *(f"stiff_{k}" for k in range(7))}
    moved = [
        np.linalg.norm(fields[f"tip_force_{a}"].evaluate(np.zeros((1, 6)))[0, -3:]) for a in "xy"
    ]
    assert np.mean(moved) == pytest.approx(12.0, rel=1e-6)


def test_a_bundle_is_a_rod_like_any_other(run, learned, tmp_path):
    model = load_bundle(save(learn_model(run, robot=arm(**ROUGH)), tmp_path / "arm"))
    assert model.kind == "rod" and model.form_error.shape == (3, 3) and model.channels == 6
    assert model.robot == "arm" and model.made_from["numbers"]
    assert compare(model, run).error["rms_mm"] < 1e-2
    arrays = learned.rod.to_npz()
    again = ElasticRodArrays.from_npz(arrays)
    np.testing.assert_array_equal(
        again.compiled().evaluate(run.command), learned.rod.compiled().evaluate(run.command)
    )
    for name in arrays:
        for wrong in (
            np.zeros((2, 2)),
            np.full(len(arrays[name]), np.inf),
            np.full(len(arrays[name]) + 1, -0.5),
        ):
            with pytest.raises(SoftmapError):
                spoiled = ElasticRodArrays.from_npz({**arrays, name: wrong})
                spoiled.fields()


def test_play_in_its_drives_is_named_and_added(run, learned, tmp_path, capsys):
    model = learn_model(run, robot=arm(**ROUGH))
    played = model.with_effects(("backlash",), {"backlash.gap": 2.0})
    fast = recorded(arm(), seconds=60.0)
    worn = replace(
        fast,
        markers=played.predict(fast)
        + 0.2 * np.random.default_rng(1).normal(size=fast.markers.shape),
    )
    worn.save(tmp_path / "worn.npz")
    save(model, tmp_path / "arm")
    found = diagnose(model, worn)
    assert "backlash" in [effect.name for effect in found.effects], found.sentence
    arguments = [
        "diagnose",
        str(tmp_path / "worn.npz"),
        "--bundle",
        str(tmp_path / "arm"),
        "--effects",
        "backlash,lag",
    ]
    assert main([*arguments, "--out", str(tmp_path / "d.json")]) == 0
    add = ["add", "backlash", "--from", str(tmp_path / "d.json"), "--bundle", str(tmp_path / "arm")]
    assert main([*add, "--out", str(tmp_path / "arm2")]) == 0
    before, after = (
        compare(load_bundle(tmp_path / name), worn).error["rms_mm"] for name in ("arm", "arm2")
    )
    assert after < 0.5 * before
    capsys.readouterr()


def test_a_bundle_is_replaced_only_by_force(run, tmp_path, capsys):
    (tmp_path / "robot.toml").write_text(ARM)
    run.save(tmp_path / "run.npz")
    verb = [
        "learn",
        str(tmp_path / "run.npz"),
        "--robot",
        str(tmp_path / "robot.toml"),
        "--out",
        str(tmp_path / "arm"),
    ]
    assert main([*verb, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert {"label", "value", "sigma", "unit", "at_bound", "note"} == set(document["numbers"][0])
    for again in (verb, ["build", "--out", str(tmp_path / "arm")]):
        assert main(again) == 2
        message = capsys.readouterr().err
        assert "--force" in message and message.count("\n") == 1
    bundle = ["--bundle", str(tmp_path / "arm"), "--out", str(tmp_path / "arm")]
    for again in (
        ["add", "lag", "--from", "none.json"],
        ["model", "remove", "lag"],
        ["model", "refit", str(tmp_path / "run.npz")],
    ):
        assert main([*again, *bundle]) == 2
        assert "--force" in capsys.readouterr().err
    assert main([*verb, "--force"]) == 0
