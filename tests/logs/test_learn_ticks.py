"""Servo ticks without a calibration: a learned model takes them, figures carry the unit, no advice
is a circle.
"""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from learned_ticks import CASE, arm
from tick_runs import HOME, MODEL, record, scattered

from softmap_edge import compare, diagnose, learn_model, save_bundle
from softmap_edge.calibration.calibration import calibrate
from softmap_edge.cli import main
from softmap_edge.errors import RunError
from softmap_edge.model.servo_calibration import converted
from softmap_edge.robot.motion.kinematics import Kinematics
from softmap_edge.run.rest_command import home_command


def log(run, head, *, separator=",", decimal=".", encoders=False):
    """The run as text with the columns `head`, a comma for the decimals if so."""
    rows = [
        run.t[:, None],
        run.ticks,
        *([run.ticks] if encoders else []),
        run.markers.reshape(run.frames, -1),
    ]
    lines = [
        separator.join(f"{x:.4f}" for x in row).replace(".", decimal) for row in np.hstack(rows)
    ]
    return "\n".join([separator.join(head), *lines])


POINTS = [f"m{k}_{axis}" for k in (1, 2, 3) for axis in "xyz"]
LOGS = {
    "case": lambda: CASE.read_text(),
    "encoders": lambda: log(
        arm(),
        ["t", "goal_1", "goal_2", "present_1", "present_2", *POINTS],
        separator=";",
        decimal=",",
        encoders=True,
    ),
    "one motor": lambda: log(arm(1), ["time_s", "motor", *POINTS]),
    "four motors": lambda: log(
        arm(4, home=512.0, size=400.0), ["stamp", *(f"servo{k}" for k in range(4)), *POINTS]
    ),
}


@pytest.mark.parametrize("make", LOGS.values(), ids=LOGS)
def test_a_proposed_mapping_of_ticks_leads_to_a_model_and_a_comparison(
    make, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    Path("log.csv").write_text(make())
    assert main(["import", "log.csv", "--guess", "--out", "m.toml"]) == 0
    assert 'command_unit = "ticks"' in Path("m.toml").read_text()
    assert main(["import", "log.csv", "--map", "m.toml", "--out", "r.npz"]) == 0
    assert main(["learn", "r.npz", "--static", "--out", "b", "--json"]) == 0
    document = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert document["command_unit"] == "ticks" and document["held_out_error_mm"] < 0.5
    assert main(["compare", "r.npz", "--bundle", "b"]) == 0
    reported = capsys.readouterr().out
    assert "ticks/s" in reported and not re.search(r"[\d.]+ mm/s", reported)
    assert main(["check", "r.npz"]) == 0 and "ticks" in capsys.readouterr().out


@pytest.mark.parametrize("kinds", [("ticks", "ticks"), ("held", "ticks"), ("ticks", "held")])
def test_ticks_are_ticks_in_whichever_field_they_are(kinds):
    """Learned from one and compared with the other, alone and several together."""
    one, two = (arm(seed=k, held=kind == "held") for k, kind in enumerate(kinds))
    model = learn_model(
        [one, replace(arm(seed=7), t=one.t)] if kinds[0] == "ticks" else one, static=True
    )
    assert model.command_unit == "ticks" and model.channels == 2
    found = compare(model, two)
    assert found.error["rms_mm"] < 0.3
    np.testing.assert_array_equal(model.commands(one), model.commands(two))


def test_a_diagnosis_of_a_model_in_ticks_names_its_numbers_in_ticks():
    model = learn_model(arm(), static=True)
    off = arm(seed=3, seconds=50.0)
    moved = replace(off, ticks=np.rint(off.ticks + [120, 0]).astype(int))
    found = diagnose(model, moved, effects=["offset", "gain"])
    assert "ticks" in str(found) and not re.search(r"offset\.\S+ *-?[\d.]+ ± [\d.]+ mm", str(found))
    assert [effect.name for effect in found.effects] == ["offset"]
    (value,) = [p for label, p in found.effects[0].params.items() if label.endswith("[0]")]
    assert value.unit == "ticks" and value.value == pytest.approx(-120, abs=15)


def test_inverse_kinematics_answers_in_ticks(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    arm().save("r.npz")
    assert main(["learn", "r.npz", "--static", "--out", "b"]) == 0
    model = learn_model(arm(), static=True)
    kinematics = Kinematics(model)
    np.testing.assert_allclose(kinematics.home, 0.0)
    target = model.prior.evaluate(np.array([[252.0, -248.0]]))[0, -3:]
    solved = kinematics.solve(target[None])
    assert solved.distance[0] < 1e-3
    np.testing.assert_allclose(solved.acting[0], [252.0, -248.0], atol=1.0)
    capsys.readouterr()
    reach = [f"{x:.3f}" for x in target]
    assert main(["track", "--workspace", "--bundle", "b", "--reach", *reach]) == 0
    assert re.search(
        r"within reach, where \(25[12]\.\d\d, -24[78]\.\d\d\) ticks acts", capsys.readouterr().out
    )
    assert main(["track", "--workspace", "--bundle", "b", "--json"]) == 0
    assert "commands_ticks" in json.loads(capsys.readouterr().out)
    assert main(["track", "O", "--plan", "--bundle", "b", "--amplitude", "4"]) == 0
    assert main(["model", "predict", "100", "--bundle", "b"]) == 2
    assert "takes 2 finite commands in ticks" in capsys.readouterr().err
    assert main(["model", "predict", "100,-50", "--bundle", "b"]) == 0


@pytest.mark.long
def test_an_emulated_robot_is_driven_in_ticks(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    save_bundle(learn_model(arm(), static=True), "b")
    off = {}
    for hidden in ("", "backlash"):
        drive = ["track", "O", "--sim", "--bundle", "b", "--amplitude", "4", "--json"]
        assert main([*drive, *(["--hide", hidden] if hidden else [])]) == 0
        off[hidden] = json.loads(capsys.readouterr().out)["seen_mm"]["mean"]
    # 1.2 mm of play at a spool of 280 ticks/mm bend it by 3 mm
    assert off[""] < 0.3 < 3.0 < off["backlash"] < 6.0
    assert (
        main(
            [
                "next",
                "--protocol",
                "validation",
                "--minutes",
                "1",
                "--bundle",
                "b",
                "--out",
                "n.csv",
            ]
        )
        == 0
    )
    assert main(["record", "n.csv", "--emulated", "--bundle", "b", "--out", "r.npz"]) == 0
    assert main(["compare", "r.npz", "--bundle", "b"]) == 0


def in_degrees():
    """A model of an arm whose commands are angles that are not counted from home."""
    run = arm()
    return learn_model(
        replace(run, ticks=None, command=run.ticks / 10.0, command_unit="deg"), static=True
    )


def test_a_range_far_from_home_is_reported_and_its_middle_is_the_pose_at_rest():
    notes = learn_model(arm(), static=True).made_from["notes"]
    assert any("taken to be 2048, 2048, the middle" in note and "offset" in note for note in notes)
    assert any(
        "far from 0" in note and "offset" in note for note in in_degrees().made_from["notes"]
    )
    centred = arm(home=0.0)
    model = learn_model(centred, static=True)
    assert not any("offset" in note for note in model.made_from["notes"])
    away = learn_model(arm(), static=True)
    # the middle of the range, not ticks of 0
    np.testing.assert_allclose(away.rest, model.rest, atol=1.5)
    for reach, home in (
        ([[-5, 9]], [0.0]), ([[2, 20]], [2.0]), ([[-20, -1]], [-1.0]), ([[1200, 3000], [-4, 4]], [2100.0, 0.0]),
        ([[7, 7]], [7.0]), ([[-3100, -1200]], [-2150.0]),
    ):  # fmt: skip
        np.testing.assert_array_equal(home_command(reach), home)


def test_a_calibration_takes_commands_in_ticks_as_it_takes_ticks():
    run = record(scattered(1), 1)
    held = replace(run, ticks=None, command=run.ticks.astype(float), command_unit="ticks")
    one, two = (calibrate(MODEL, each, home=HOME) for each in (run, held))
    np.testing.assert_array_equal(one.calibration.A, two.calibration.A)
    assert two.calibration.run == held.hash() == two.model.made_from["calibration"]
    np.testing.assert_array_equal(
        converted(two.model, held).command, converted(one.model, run).command
    )


@pytest.mark.parametrize("in_ticks", [True, False])
def test_a_run_in_another_unit_than_the_model_is_refused_with_a_way_out(in_ticks):
    lengths = replace(arm(), ticks=None, command=(arm().ticks - 2048) / 100.0)
    model = learn_model(arm() if in_ticks else lengths, static=True)
    with pytest.raises(RunError, match="softmap learn"):
        compare(model, lengths if in_ticks else arm())
    with pytest.raises(RunError, match="softmap learn"):
        compare(model, lengths if in_ticks else arm(held=True))
