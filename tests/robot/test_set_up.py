"""A servo that gets another id keeps its place in the rig; one as it is delivered is another
servo.
"""

import re
import shlex
from contextlib import contextmanager
from dataclasses import replace

import pytest
from other_program import leave
from rigs import BAUD, HOME, MODEL, NUMBER, emulated_rig

from softmap_edge import _core
from softmap_edge.cli import main
from softmap_edge.errors import ServoError
from softmap_edge.robot.commissioning import reboot, setup
from softmap_edge.robot.servo.bus import opened, write_registers
from softmap_edge.robot.servo.examined import members, started
from softmap_edge.robot.servo.home_mark import marked
from softmap_edge.robot.servo.known_state import hardware, ways_out
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


@pytest.mark.parametrize("left", [{"shutdown": 0}, {"temperature_limit": 99}, {"drive_mode": 1}])
def test_a_servo_of_the_rig_stays_that_servo_whatever_another_program_left(left, tmp_path):
    file, bus = tmp_path / "rig.toml", fresh()
    assert set_up(bus, file, "--id", "1") == set_up(bus, file, "--id", "2") == 0
    leave(bus.path, BAUD, **left)
    assert set_up(bus, file, "--id", "1", "--new-id", "3") == 0 and ids(file) == [3, 2]
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


def settings(bus, id=1, baud=BAUD):
    """Return the registers that a set-up may write."""
    with opened(bus.path, baud) as port:
        values = setup.registers(port, id)
    return {
        name: value
        for name, value in values.items()
        if not name.startswith("present") and name not in ("realtime_tick", "moving")
    }


SHUT_DOWN = [  # every error once, every model twice; the other pairs are long
    pytest.param(
        number, bits, marks=() if (place + k) % 3 == 0 else pytest.mark.long, id=f"{number}-{bits}"
    )
    for place, number in enumerate((1200, 1060, 1020))
    for k, bits in enumerate((0x01, 0x04, 0x08, 0x10, 0x20, 0x24))
]


@pytest.mark.parametrize(("number", "bits"), SHUT_DOWN)
def test_a_servo_that_shut_itself_down_is_left_as_it_is_until_it_is_restarted(number, bits, capsys):
    bus = _core.EmulatedBus([(1, number, 57_600, 500.0)], [[]])
    bus.fail(0, bits)
    before = settings(bus, baud=57_600)
    argv = ["servo", "setup", "--port", bus.path, "--baud", "57600", "--new-id", "7"]
    assert main([*argv, "--new-baud", str(BAUD)]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert f"servo 1 reports {hardware(bits)}, so that it is not set up; {ways_out(bits)}" in said
    assert settings(bus, baud=57_600) == before
    assert main(shlex.split(re.search(r"`softmap ([^`]+)`", said)[1])) == 0
    assert main([*argv, "--new-baud", str(BAUD)]) == 0
    assert [one.id for one in setup.scan(bus.path, BAUD)] == [7]
    bus.unplug()


@pytest.mark.parametrize(
    "bits, register, value, becomes",
    [
        (0x01, "min_voltage_limit", 60, "min voltage limit is 60 (6.0 V): it becomes 35"),
        (0x01, "max_voltage_limit", 40, "max voltage limit is 40 (4.0 V): it becomes 70"),
        (0x04, "temperature_limit", 20, "temperature limit is 20: it becomes 70"),
    ],
)
def test_an_error_that_a_wrong_limit_brought_about_leads_in_no_circle(
    bits, register, value, becomes, capsys, monkeypatch
):
    """A restart would not clear it, so a restart names the set-up, which corrects the limit."""
    with emulated_rig() as (bus, _, _):
        leave(bus.path, BAUD, drive_mode=1, **{register: value})
        bus.fail(0, bits)
        before = settings(bus)
        with monkeypatch.context() as stays:
            stays.setattr(reboot, "_rebooted", lambda bus, id: None)
            with pytest.raises(ServoError) as fault:
                reboot.restart(bus.path, BAUD, 1)
        assert f"still reports {hardware(bits)}: {becomes.partition(':')[0]}" in str(fault.value)
        named = shlex.split(re.search(r"`softmap ([^`]+)`", str(fault.value))[1])
        assert main(named) == 2
        said = " ".join(capsys.readouterr().err.split())
        assert f"servo 1 reports {hardware(bits)} ({becomes}), so that it is not set up" in said
        changed = {name for name, one in settings(bus).items() if one != before[name]}
        assert changed == {register}, "nothing else is written"
        assert main(shlex.split(re.search(r"`softmap ([^`]+)`", said)[1])) == 0
        assert main(named) == 0 and settings(bus)["drive_mode"] == 0


@pytest.mark.parametrize(
    "level, bits, written",
    [
        (0, 0x20, "it answered pings only (status return level 0): it becomes 2"),
        (1, 0x04, "status return level is 1: it becomes 2"),
        (2, 0x10, ""),
    ],
)
def test_a_set_up_that_fails_reports_what_it_wrote(level, bits, written, capsys):
    with emulated_rig() as (bus, _, _):
        leave(bus.path, BAUD, status_return_level=level)
        bus.fail(0, bits)
        assert main(["servo", "setup", "--port", bus.path, "--baud", str(BAUD), "--id", "1"]) == 2
        said = capsys.readouterr().err
        assert said.partition("softmap servo")[0].strip() == written
        assert f"servo 1 reports {hardware(bits)}, so that it is not set up" in said


@pytest.mark.parametrize("name, value", [("shutdown", 53), ("drive_mode", 1), ("id", 9)])
def test_a_register_that_a_servo_refuses_is_named(name, value):
    with emulated_rig() as (bus, _, _):
        leave(bus.path, BAUD, torque_enable=1)
        address, _, _ = _core.servo_registers()[name]
        said = f"servo 1, register {address}: .*torque is on"
        with opened(bus.path, BAUD) as port, pytest.raises(ServoError, match=said):
            write_registers(port, 1, address, bytes([value]))


@pytest.mark.parametrize("level", [0, 1])
@pytest.mark.parametrize("number", [1200, 1060, 1020])
def test_a_servo_that_answers_too_little_is_set_up(level, number):
    bus, said = _core.EmulatedBus([(1, number, 57_600, 500.0)], [[]]), []
    leave(bus.path, 57_600, status_return_level=level)
    (found,) = setup.scan(bus.path, 57_600)
    done = setup.set_up(found, 4, 1_000_000, said.append).servo
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


MEASURED = {"home": HOME, "current_mA": 321.0, "low": -700, "slew": 900.0}


@contextmanager
def measured_rig(tmp_path):
    """Give a rig with measured values, set up by the command, each servo marked as homed."""
    file = tmp_path / "rig.toml"
    with emulated_rig() as (bus, rig, _):
        for id in (1, 2):
            assert set_up(bus, file, "--id", str(id)) == 0
        known = read_rig(file)
        servos = tuple(RigServo(one.id, MODEL, **MEASURED) for one in known.servos)
        text = replace(known, servos=servos).to_toml()
        file.write_text(text.replace("[[servo]]", "[[servo]]  # mine", 1))
        yield bus, rig, file


def values(servo):
    return {name: getattr(servo, name) for name in MEASURED}


@pytest.mark.parametrize(
    "left, homed",
    [
        ({}, True),
        ({"return_delay_time": 100}, True),
        ({"secondary_id": 9}, True),
        ({"profile_velocity": 30}, True),
        ({"pwm_limit": 300}, True),
        ({"torque_enable": 1}, True),
        ({"position_p_gain": 20}, False),
    ],
)
def test_measured_values_stay_if_nothing_changes_what_they_mean(left, homed, tmp_path, capsys):
    """A servo keeps its turns too, unless its mode was chosen again to set its gains."""
    with measured_rig(tmp_path) as (bus, rig, file):
        before = file.read_bytes()
        if left:
            leave(bus.path, BAUD, **left)
        capsys.readouterr()
        assert set_up(bus, file, "--id", "1") == 0
        out = capsys.readouterr().out
        assert file.read_bytes() == before and "taken out" not in out
        home = f"keeps its home; its turns are counted again, so home the robot with `softmap servo home --rig {file}`"
        assert (home in out) != homed
        with opened(bus.path, BAUD) as port:
            assert marked(port, 1, HOME) == homed and marked(port, 2, HOME)
        assert main(["servo", "home", "--rig", str(file), "--yes"]) == 0
        assert [values(one) for one in read_rig(file).servos] == [MEASURED, MEASURED]


@pytest.mark.parametrize(
    "left, more, why",
    [
        ({"drive_mode": 1}, [], "drive mode"),
        ({"homing_offset": -77}, [], "homing offset"),
        ({"operating_mode": 3}, [], "operating mode"),
        ({"operating_mode": 4, "drive_mode": 9}, [], "operating mode and drive mode"),
        ({}, ["--new-id", "5"], "id"),
    ],
)
def test_measured_values_that_no_longer_fit_are_taken_out_and_measured_by_the_commands_named(
    left, more, why, tmp_path, capsys
):
    with measured_rig(tmp_path) as (bus, _, file):
        if left:
            leave(bus.path, BAUD, **left)
        capsys.readouterr()
        assert set_up(bus, file, "--id", "1", *more) == 0
        out = capsys.readouterr().out
        assert f"{file} held its home and measured current: taken out, because its {why}" in out
        named = re.findall(r"`softmap ([^`]+)`", out)
        assert [one.split()[1] for one in named] == ["home", "pull"]
        assert all(f"--rig {file}" in one for one in named)
        now = read_rig(file).servos
        assert values(now[0]) == MEASURED | {"home": None, "current_mA": None}
        assert values(now[1]) == MEASURED
        assert main([*shlex.split(named[0]), "--yes"]) == 0
        assert read_rig(file).servos[0].home is not None


def test_another_servo_in_the_place_of_one_that_is_gone_has_no_home(tmp_path, capsys):
    """It was set up for another rig, so that no register differs; only its id changes."""
    with measured_rig(tmp_path) as (bus, _, file):
        bus.rename(0, 9)
        assert set_up(bus, file, "--id", "9", "--new-id", "1") == 0
        assert "taken out, because its id changed" in capsys.readouterr().out
        assert read_rig(file).servos[0].home is None
