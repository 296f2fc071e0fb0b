"""A servo that gets another id keeps its place in the rig; one as it is delivered is another
servo.
"""

import pytest
from other_program import leave
from rigs import BAUD, HOME, MODEL, NUMBER, emulated_rig

from softmap_edge import _core
from softmap_edge.cli import main
from softmap_edge.errors import ServoError
from softmap_edge.robot.commissioning import setup
from softmap_edge.robot.servo.bus import opened
from softmap_edge.robot.servo.examined import members, started
from softmap_edge.robot.servo.rig import Rig, RigServo, read_rig


def fresh(baud=BAUD, ids=(1, 2)):
    return _core.EmulatedBus([(id, NUMBER, baud, 500.0) for id in ids], [[]] * len(ids), seed=1)


def set_up(bus, file, *more, baud=BAUD):
    return main(
        ["servo", "setup", "--port", bus.path, "--baud", str(baud), "--rig", str(file), *more]
    )


def ids(file):
    return [servo.id for servo in read_rig(file).servos]


def test_the_entry_follows_the_servo_and_keeps_its_place(tmp_path, capsys):
    file, bus = tmp_path / "rig.toml", fresh()
    assert set_up(bus, file, "--id", "1") == set_up(bus, file, "--id", "2") == 0
    text = file.read_text().replace("id = 1\n", "id = 1  # the left one\nlow = -800\n")
    file.write_text(text)
    capsys.readouterr()
    assert set_up(bus, file, "--id", "1", "--new-id", "3") == 0
    assert ids(file) == [3, 2], "the order of the commands"
    assert (
        f"{file}: servo 1 is servo 3 now and keeps its place, command 1" in capsys.readouterr().out
    )
    assert "# the left one" in file.read_text() and read_rig(file).servos[0].low == -800
    assert sorted(read_rig(file).made["set_up"]) == ["servo_2", "servo_3"]
    assert main(["servo", "home", "--rig", str(file), "--yes"]) == 0, "what is named next leads on"
    assert set_up(bus, file, "--id", "3", "--new-id", "1") == 0 and ids(file) == [1, 2]
    bus.unplug()


@pytest.mark.parametrize("baud, more", [(57_600, ["--new-baud", str(BAUD)]), (BAUD, [])])
def test_a_servo_as_delivered_is_another_one(tmp_path, capsys, baud, more):
    file = tmp_path / "rig.toml"
    Rig("/dev/none", BAUD, (RigServo(1, MODEL, HOME),)).write(file)
    bus = fresh(baud, (1,))
    assert set_up(bus, file, "--new-id", "2", *more, baud=baud) == 0
    assert ids(file) == [1, 2] and read_rig(file).servos[0].home == HOME
    assert f"{file} keeps its servo 1: this one was not set up yet" in capsys.readouterr().out
    bus.unplug()


def test_a_new_servo_takes_the_place_of_one_that_is_gone(tmp_path):
    file = tmp_path / "rig.toml"
    Rig("/dev/none", BAUD, tuple(RigServo(id, MODEL, HOME, low=-5) for id in (1, 2, 3))).write(file)
    bus = fresh(57_600, (1,))
    assert set_up(bus, file, "--new-id", "2", "--new-baud", str(BAUD), baud=57_600) == 0
    assert ids(file) == [1, 2, 3] and [servo.home for servo in read_rig(file).servos] == [
        HOME,
        None,
        HOME,
    ]
    bus.unplug()


def test_an_id_that_the_rig_lists_for_another_servo_is_refused_before_anything_changes(
    tmp_path, capsys
):
    file, bus = tmp_path / "rig.toml", fresh()
    assert set_up(bus, file, "--id", "1") == set_up(bus, file, "--id", "2") == 0
    bus.damage(1, mute=True)
    before = file.read_text()
    assert set_up(bus, file, "--id", "1", "--new-id", "2") == 2
    assert (
        "give an id that it does not list" in capsys.readouterr().err and file.read_text() == before
    )
    assert [one.id for one in setup.scan(bus.path, BAUD)] == [1]
    assert set_up(bus, file, "--id", "1", "--new-id", "4") == 0 and ids(file) == [4, 2]
    bus.unplug()


def test_a_servo_that_obeys_the_old_id_too_is_found_before_both_are_renamed(capsys):
    with emulated_rig() as (bus, _, _):
        leave(bus.path, BAUD, 2, secondary_id=1)
        argv = ["servo", "setup", "--port", bus.path, "--baud", str(BAUD), "--id"]
        assert main([*argv, "1", "--new-id", "7"]) == 2
        line = capsys.readouterr().err
        assert (
            "servo 2 obeys id 1 too (its secondary id)" in line and f"{BAUD} --id 2` first" in line
        )
        assert [one.id for one in setup.scan(bus.path, BAUD)] == [1, 2]
        assert main([*argv, "2"]) == 0 and main([*argv, "1", "--new-id", "7"]) == 0
        assert [one.id for one in setup.scan(bus.path, BAUD)] == [2, 7]


@pytest.mark.parametrize("level", [0, 1])
@pytest.mark.parametrize("number", [1200, 1060, 1020])
def test_a_servo_that_answers_too_little_is_set_up(level, number):
    bus, said = _core.EmulatedBus([(1, number, 57_600, 500.0)], [[]]), []
    leave(bus.path, 57_600, status_return_level=level)
    (found,) = setup.scan(bus.path, 57_600)
    done = setup.set_up(found, 4, 1_000_000, said.append)
    assert said[0].endswith(": it becomes 2") and (("pings only" in said[0]) == (level == 0))
    with opened(done.port, done.baud) as port:
        assert setup.complaints(done, setup.registers(port, 4)) == []
    bus.unplug()


def test_limits_that_another_program_left_are_raised_and_reported():
    bus, said = fresh(57_600, (1,)), []
    leave(
        bus.path,
        57_600,
        current_limit=20,
        pwm_limit=100,
        velocity_limit=1,
        profile_velocity=4,
        goal_pwm=50,
    )
    (found,) = setup.scan(bus.path, 57_600)
    setup.set_up(found, tell=said.append)
    with opened(bus.path, 57_600) as port:
        now = setup.registers(port, 1)
    assert [now[name] for name in ("current_limit", "pwm_limit", "velocity_limit", "goal_pwm")] == [
        1750,
        885,
        445,
        885,
    ]
    assert (
        now["profile_velocity"] == 0 and len([line for line in said if "it becomes" in line]) >= 6
    )
    bus.unplug()


def test_a_servo_that_does_not_answer_is_not_set_up():
    bus = fresh(57_600, (1,))
    (found,) = setup.scan(bus.path, 57_600)
    bus.damage(0, mute=True)
    with pytest.raises(ServoError, match="servo 1: no answer; check power and wiring"):
        setup.set_up(found)
    bus.unplug()


def test_the_command_that_is_named_leads_out_whatever_the_rig_allows():
    """A rig that allows more than usual finds a limit too low that the usual cap would pass."""
    with emulated_rig() as (bus, rig, _):
        strong = Rig(
            rig.port, rig.baud, (RigServo(1, MODEL, HOME, current_mA=1500.0), rig.servos[1])
        )
        leave(bus.path, BAUD, current_limit=700)
        with pytest.raises(
            ServoError, match="its current limit .700 mA. is below the cap .1500 mA."
        ):
            started(rig.port, rig.baud, members(strong))
        assert main(["servo", "setup", "--port", bus.path, "--baud", str(BAUD), "--id", "1"]) == 0
        assert started(rig.port, rig.baud, members(strong)) == []
