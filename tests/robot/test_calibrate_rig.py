"""A first calibration from pulley, signs and ruler: its map, its honest deviations, and what it
refuses.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from rigs import BAUD, HOME, MODEL, angles, emulated_rig, torque
from typist import typist

from softmap_edge.cli import main
from softmap_edge.commands.servo import commission
from softmap_edge.errors import CalibrationError
from softmap_edge.model.bundle import builtin_model, load_bundle
from softmap_edge.robot.commissioning.first_calibration import (
    CALIPER,
    COUPLING,
    bends,
    pulley_calibration,
    radius,
)
from softmap_edge.robot.servo.limits import effective_limits
from softmap_edge.robot.servo.rig import Rig, RigServo

R = 2.33  # mm
TICK = 2.0 * np.pi * R / 4096.0  # mm
FINGER = builtin_model()


def rig(**changes):
    return replace(
        Rig("/dev/none", BAUD, tuple(RigServo(id, MODEL, HOME + id) for id in (1, 2))), **changes
    )


def words(tmp_path, *more):
    file = tmp_path / "rig.toml"
    if not file.exists():
        rig().write(file)
    return [
        "servo",
        "calibrate",
        "--rig",
        str(file),
        "--out",
        str(tmp_path / "finger"),
        "--pulley-mm",
        str(R),
        *more,
    ]


def test_pulley_and_signs_make_a_map_that_drives(tmp_path, capsys):
    assert main(words(tmp_path, "--signs=+,-", "--json")) == 0
    reported = json.loads(capsys.readouterr().out)
    assert next(iter(reported)) == "schema" and reported["schema"] == "softmap.calibration/1"
    found = load_bundle(tmp_path / "finger").calibration
    np.testing.assert_allclose(found.A, np.diag([TICK, -TICK]))
    np.testing.assert_allclose(found.b, 0.0)
    np.testing.assert_allclose(found.home, [HOME + 1, HOME + 2])
    np.testing.assert_allclose(
        found.sigma_A, TICK * np.array([[CALIPER, COUPLING], [COUPLING, CALIPER]])
    )
    assert (
        np.all(found.sigma_b > 0.4)
        and found.held_out["command"] > 1.0
        and found.held_out["shape_mm"] > 0.1
    )
    assert found.frames == 0 and "no run" in found.run
    assert found.window == pytest.approx((-16.0 / TICK, 16.0 / TICK), abs=1.0), (
        "the model's range, in ticks"
    )
    assert any("coupling" in line for line in reported["warnings"]) and any(
        "--ruler" in line for line in reported["warnings"]
    )
    assert (
        effective_limits(rig(), load_bundle(tmp_path / "finger")).table()["servos"][0]["high"]
        > HOME + 4000
    )


def test_a_ruler_refines_the_radius(tmp_path, capsys):
    long, short = (
        radius(2.5, (8192.0, 2.0 * 2.0 * np.pi * R)),
        radius(2.5, (512.0, 0.125 * 2.0 * np.pi * R + 0.5)),
    )
    assert abs(long.mm - R) < 0.01 < abs(2.5 - R) and long.sigma < 0.2 * radius(2.5).sigma
    assert long.sigma < short.sigma < radius(2.5).sigma, "a short reading tells less"
    assert main(words(tmp_path, "--signs=+,+", "--ruler", "8192=29.28")) == 0
    said = capsys.readouterr().out
    assert "radius 2.330 ±" in said and "--ruler TICKS" not in said
    with pytest.raises(
        CalibrationError, match=r"the ruler gives a radius of 2.33 .*\(radius, not diameter"
    ):
        radius(2 * R, (8192.0, 29.28))


@pytest.mark.parametrize(
    "more, said",
    [
        (["--signs=+"], "the rig has 2 servos, the model 2 commands, 1 signs are given"),
        (["--signs=+,x"], "give + or - for each servo"),
        (["--signs=+,+", "--ruler", "a=b"], "give TICKS=MM"),
        (["--signs=+,+", "--ruler", "nan=3"], "at least 2 mm of tendon"),
        (["--signs=+,+", "--ruler", "100=0.2"], "at least 2 mm of tendon"),
        (["--signs=+,+", "--pulley-mm", "0"], "a pulley of 0 mm; allowed are 0.5 to 100"),
        (["--signs=+,+", "--pulley-mm", "nan"], "a pulley of nan mm"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, capsys, more, said):
    assert main(words(tmp_path, *more)) == 2
    assert said in capsys.readouterr().err and not (tmp_path / "finger").exists()


def test_without_home_or_over_a_bundle_nothing_is_written(tmp_path, capsys):
    file = tmp_path / "rig.toml"
    rig(servos=(RigServo(1, MODEL, HOME), RigServo(2, MODEL))).write(file)
    assert main(words(tmp_path, "--signs=+,+")) == 2
    assert "servo 2 has no home" in capsys.readouterr().err
    rig().write(file)
    assert main(words(tmp_path, "--signs=+,+")) == 0 and main(words(tmp_path, "--signs=+,+")) == 2
    assert "--force to replace it" in capsys.readouterr().err
    assert main(words(tmp_path, "--signs=+,-", "--force")) == 0


def test_signs_are_jogged_and_asked_for(tmp_path, capsys, monkeypatch):
    asked, answers, moved = [], iter([True, False, True]), []
    with emulated_rig() as (bus, there, _):
        there.write(tmp_path / "rig.toml")

        def answer(question, _):
            asked.append(question)
            moved.append(not torque(bus))
            return next(answers)

        monkeypatch.setattr(commission, "confirm", answer)
        assert main(words(tmp_path, "--hold")) == 0
        assert all(moved), "torque is off while anybody thinks"
        np.testing.assert_allclose(angles(bus), HOME, atol=30)
    found = load_bundle(tmp_path / "finger").calibration
    assert list(np.sign(np.diag(found.A))) == [1, -1]
    assert "servo 1 bend the tip towards " + bends(FINGER, 0) in asked[0] and len(asked) == 3


def test_a_key_that_is_held_beyond_the_move_answers_no_question(tmp_path):
    """A user who holds a key notices late that the servo is back; an answer that is none is asked
    for again.
    """
    with emulated_rig() as (bus, there, _):
        there.write(tmp_path / "rig.toml")
        with typist(tmp_path, *words(tmp_path)) as user:

            def moves(servo):
                user.until(lambda: f"servo {servo} turns by" in user.said)
                user.holds("h", lambda: torque(bus), lambda: not torque(bus), late=1.5)

            def answers(question, text):
                user.until(lambda: user.said.count("[y/N]") >= question)
                user.types(text)

            moves(1)
            answers(1, "maybe\n")
            answers(2, "y\n")
            moves(2)
            answers(3, "n\n")
            answers(4, "y\n")
            assert user.ends() == 0, user.said
            assert user.said.count("[y/N]") == 4
    found = load_bundle(tmp_path / "finger").calibration
    assert list(np.sign(np.diag(found.A))) == [1, -1]


def test_a_servo_that_bends_neither_way_is_reported(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(commission, "confirm", lambda *_: False)
    with emulated_rig() as (bus, there, _):
        there.write(tmp_path / "rig.toml")
        assert main(words(tmp_path, "--hold")) == 2
        assert "pull command 1: look at its tendon" in capsys.readouterr().err and not torque(bus)
    assert not (tmp_path / "finger").exists()


def test_the_way_of_a_bend_is_the_models():
    u = np.zeros((2, 2))
    u[1, 0] = 4.0
    tip = FINGER.tip(u)
    way = bends(FINGER, 0)
    axis = "xyz".index(way[1])
    assert np.sign(tip[1, axis] - tip[0, axis]) == (1 if way[0] == "+" else -1)
    assert pulley_calibration(rig(), FINGER, radius(R), (1, 1)).condition == pytest.approx(1.0)
