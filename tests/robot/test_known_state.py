"""Each start, homing and the doctor check the set-up of the servos, and the command
named mends it.
"""

import json
import re
import shlex
import subprocess
import sys
import time

import pytest
from other_program import leave
from rigs import BAUD, HOME, MODEL, calibration, emulated_rig, torque

from softmap_edge import _core
from softmap_edge.cli import main
from softmap_edge.errors import ServoError
from softmap_edge.robot import doctor
from softmap_edge.robot.commissioning import setup
from softmap_edge.robot.commissioning.jog import Jog
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.servo.bus import opened
from softmap_edge.robot.servo.examined import examined, members, members_of, refusal, started
from softmap_edge.robot.servo.known_state import (
    GAINS,
    SET_UP,
    differing,
    gains_of,
    needs,
    remarks_on_gains,
)
from softmap_edge.robot.servo.models import manual_gains, numbered, servo_model
from softmap_edge.robot.servo.rig import Rig, RigServo, read_rig

LEFT = {
    "drive_mode": (9, "drive mode is 9, needed is 0"),
    "secondary_id": (2, "secondary id is 2, needed is 255"),
    "status_return_level": (1, "status return level is 1, needed is 2"),
    "current_limit": (20, "its current limit (20 mA) is below the cap (612 mA)"),
    "pwm_limit": (300, "pwm limit is 300, needed is 885"),
    "velocity_limit": (30, "velocity limit is 30, needed is at least 128"),
    "startup_configuration": (1, "startup configuration is 1, needed is 0"),
    "homing_offset": (-77, "homing offset is -77, needed is 0"),
    "return_delay_time": (100, "return delay time is 100, needed is 0"),
    "operating_mode": (3, "operating mode is 3 (position), needed is 5"),
    "temperature_limit": (100, "temperature limit is 100, needed is 65 to 70"),
    "max_voltage_limit": (50, "max voltage limit is 50 (5.0 V), needed is 70"),
    "min_voltage_limit": (60, "min voltage limit is 60 (6.0 V), needed is 35"),
    "shutdown": (
        0,
        "shutdown is 0 (no error shuts it down), needed is 53 (input voltage, overheating, "
        "electrical shock, overload)",
    ),
}


def remedy(line):
    """Return the arguments of the first command that a line names."""
    return shlex.split(re.search(r"`softmap ([^`]+)`", line)[1])


@pytest.mark.parametrize("register", LEFT)
def test_what_another_program_left_is_refused_and_the_command_named_mends_it(register):
    value, said = LEFT[register]
    with emulated_rig() as (bus, rig, _):
        leave(bus.path, BAUD, **{register: value})
        with pytest.raises(ServoError) as fault:
            started(rig.port, rig.baud, members(rig))
        line = str(fault.value)
        assert line.startswith(
            f"servo 1: {said}; run `softmap servo setup --port {bus.path} --baud {BAUD} --id 1`"
        )
        assert main(remedy(line)) == 0
        assert started(rig.port, rig.baud, members(rig)) == []
        assert refusal(examined(rig.port, rig.baud, members(rig))) == ""


def test_all_that_differs_is_listed_with_one_command():
    with emulated_rig() as (bus, rig, _):
        leave(bus.path, BAUD, drive_mode=1, secondary_id=9)
        leave(bus.path, BAUD, 2, homing_offset=5)
        with pytest.raises(ServoError) as fault:
            started(rig.port, rig.baud, members(rig))
        one, two = (
            f"run `softmap servo setup --port {bus.path} --baud {BAUD} --id {id}`" for id in (1, 2)
        )
        assert str(fault.value) == (
            f"servo 1: drive mode is 1, needed is 0, secondary id is 9, needed is 255; {one}; "
            f"servo 2: homing offset is 5, needed is 0; {two}"
        )


def test_a_reversed_drive_mode_is_seen_by_all_that_drive(tmp_path, capsys):
    file = str(tmp_path / "rig.toml")
    with emulated_rig() as (bus, rig, limits):
        rig.write(file)
        leave(bus.path, BAUD, drive_mode=9)
        said = "servo 1: drive mode is 9, needed is 0; run `softmap servo setup"
        for start in (
            lambda: Controller(rig, calibration(), limits).__enter__(),
            lambda: Jog(rig).__enter__(),
        ):
            with pytest.raises(ServoError, match=re.escape(said)):
                start()
        for argv in (
            ["servo", "home", "--rig", file, "--yes"],
            ["servo", "move", "--rig", file, "--servo", "1", "--by", "50", "--hold"],
        ):
            assert main(argv) == 2
            assert said in capsys.readouterr().err
        lines = [line for line in doctor.examine(rig=file).lines if line.name == "servo 1"]
        assert [line.found for line in lines] == [
            "drive mode is 9, needed is 0"
        ] and "servo setup" in lines[0].do
        assert main(["servo", "read", "--port", bus.path, "--baud", str(BAUD), "--id", "1"]) == 1
        assert "! drive mode is 9, needed is 0; run" in capsys.readouterr().out
        assert not torque(bus)


PASSES = {
    "profile_velocity": 5,
    "profile_acceleration": 3,
    "position_p_gain": 50,
    "position_d_gain": 9,
    "goal_pwm": 100,
    "bus_watchdog": 100,
}


@pytest.mark.parametrize("register", PASSES)
def test_what_passes_with_the_power_is_written_again_by_a_start(register):
    with emulated_rig() as (bus, rig, _):
        assert main(["servo", "setup", "--port", bus.path, "--baud", str(BAUD), "--id", "1"]) == 0
        kept = {SET_UP: {"servo_1": setup.gains(setup.ServoState(bus.path, BAUD, 1, 1200, 46))}}
        known = Rig(rig.port, rig.baud, rig.servos, made=kept)
        with opened(bus.path, BAUD) as port:
            before = setup.registers(port, 1)
        leave(bus.path, BAUD, **{register: PASSES[register]})
        name = register.replace("_", " ")
        assert started(rig.port, rig.baud, members(known)) == [
            f"servo 1: {name} was {PASSES[register]}, left by another program: it is "
            f"{before[register]} now"
        ]
        with opened(bus.path, BAUD) as port:
            assert setup.registers(port, 1)[register] == before[register]
        assert started(rig.port, rig.baud, members(known)) == []


def test_a_start_says_what_it_wrote_again():
    with emulated_rig() as (bus, rig, limits):
        leave(bus.path, BAUD, 2, profile_velocity=7)
        reported = []
        with Controller(rig, calibration(), limits, tell=reported.append) as robot:
            line = "servo 2: profile velocity was 7, left by another program: it is 0 now"
            assert robot.mended == [line] and reported == [line]


@pytest.mark.parametrize(
    "values",
    [
        {"current_limit": 700},
        {"velocity_limit": 500},
        {"secondary_id": 253},
        {"position_p_gain": 900},
        {"shutdown": 63},
        {"temperature_limit": 66},
    ],
)
def test_what_binds_nothing_is_left_as_its_user_chose_it(values):
    """A current limit above the cap protects; gains that no rig knows are the user's own."""
    with emulated_rig() as (bus, rig, _):
        leave(bus.path, BAUD, **values)
        assert started(rig.port, rig.baud, members(rig)) == []
        with opened(bus.path, BAUD) as port:
            now = setup.registers(port, 1)
        assert {name: now[name] for name in values} == values


def test_limits_are_held_against_what_is_in_force():
    with emulated_rig() as (bus, rig, limits):
        leave(bus.path, BAUD, current_limit=300)
        found = members_of(rig.numbers, limits, [])
        assert "(300 mA) is below the cap (612 mA)" in refusal(examined(rig.port, rig.baud, found))
        tight = limits | {"servos": [one | {"current": 157.0} for one in limits["servos"]]}
        assert refusal(examined(rig.port, rig.baud, members_of(rig.numbers, tight, []))) == ""
        capped = Rig(
            rig.port, rig.baud, (RigServo(1, MODEL, HOME, current_mA=250.0), rig.servos[1])
        )
        assert refusal(examined(rig.port, rig.baud, members(capped))) == ""


def test_each_model_as_delivered_lacks_only_what_setting_up_gives():
    for model in _core.servo_models():
        found = numbered(model["number"])
        bus = _core.EmulatedBus([(1, model["number"], 57_600, 500.0)], [[]])
        with opened(bus.path, 57_600) as port:
            lacks = {need.register for need in differing(found, setup.registers(port, 1))}
        bus.unplug()
        assert lacks == {"operating_mode", "return_delay_time"}, model["name"]
        names = [need.register for need in needs(found)]
        assert ("current_limit" in names) == (found["current_limit_mA"] is not None)


def test_the_rig_keeps_the_gains_of_a_servo_that_was_set_up(tmp_path, capsys):
    file = tmp_path / "rig.toml"
    with emulated_rig() as (bus, _, _):
        argv = [
            "servo",
            "setup",
            "--port",
            bus.path,
            "--baud",
            str(BAUD),
            "--rig",
            str(file),
            "--id",
        ]
        leave(bus.path, BAUD, position_p_gain=1)
        assert main([*argv, "1"]) == 0 and main([*argv, "2"]) == 0
        assert "position p gain is 1: it becomes 400" in capsys.readouterr().out
        rig = read_rig(file)
        assert gains_of(rig.made, 1) == gains_of(rig.made, 2) == (400, 0, 0, 0, 0)
        assert len(GAINS) == 5
        leave(bus.path, BAUD, position_p_gain=20)
        assert started(rig.port, rig.baud, members(rig))[0].startswith(
            "servo 1: position p gain was 20"
        )


@pytest.mark.parametrize(
    "kept", [[1, 2], [1, 2, 3, 4, "5"], [1, 2, 3, 4, -5], "no list", [10**9] * 5, [True] * 5]
)
def test_gains_that_a_rig_cannot_hold_count_for_nothing(kept):
    assert gains_of({SET_UP: {"servo_1": kept}}, 1) == ()
    assert servo_model(MODEL)["pwm_limit"] == 885


def test_the_process_of_a_loop_starts_without_numpy():
    """A start that reads more of the servos is not to take longer than before."""
    look = "import sys, softmap_edge.robot.control.loop_process; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", look], check=False).returncode == 0


DIFFERENT = {
    "position_p_gain": (50, "position p gain is 50, the manual's initial value is 400"),
    "position_i_gain": (7, "position i gain is 7, the manual's initial value is 0"),
    "position_d_gain": (9, "position d gain is 9, the manual's initial value is 0"),
    "feedforward_1st_gain": (3, "feedforward 1st gain is 3, the manual's initial value is 0"),
    "profile_velocity": (5, "profile velocity is 5, needed is 0; each start writes it again"),
    "profile_acceleration": (5, "profile acceleration is 5, needed is 0; each start writes it"),
    "goal_pwm": (100, "goal pwm is 100, needed is 885; each start writes it again"),
    "bus_watchdog": (9, "bus watchdog is 9, needed is 0; each start writes it again"),
}


FEW = [
    pytest.param(name, marks=pytest.mark.long) if k % 3 else name
    for k, name in enumerate(DIFFERENT)
]


@pytest.mark.parametrize("register", FEW)
def test_read_names_what_differs_without_a_rig_and_the_command_mends_it(register, capsys):
    value, said = DIFFERENT[register]
    with emulated_rig() as (bus, _, _):
        argv = ["servo", "read", "--port", bus.path, "--baud", str(BAUD), "--id", "1"]
        assert main(argv) == 0 and "set up" in capsys.readouterr().out
        leave(bus.path, BAUD, **{register: value})
        gain = "gain" in register
        assert main(argv) == (0 if gain else 1), "gains may be the user's own"
        (line,) = [one for one in capsys.readouterr().out.splitlines() if said in one]
        assert line.startswith("  note: " if gain else "  ! ")
        assert main([*argv, "--json"]) == (0 if gain else 1)
        (one,) = json.loads(capsys.readouterr().out)["servos"]
        assert [said in text for text in one["notes" if gain else "complaints"]] == [True]
        assert main(remedy(line)) == 0
        capsys.readouterr()
        assert main(argv) == 0 and said not in capsys.readouterr().out


def test_the_gains_of_the_rig_count_and_not_those_of_the_factory(tmp_path, capsys):
    file = str(tmp_path / "rig.toml")
    with emulated_rig() as (bus, rig, _):
        leave(bus.path, BAUD, position_p_gain=900)
        rig.write(file)
        lines = [one for one in doctor.examine(rig=file).lines if one.name == "servo 1"]
        assert [one.state for one in lines] == ["warning"] and "servo setup" in lines[0].do
        own = {SET_UP: {"servo_1": [900, 0, 0, 0, 0]}}
        Rig(rig.port, rig.baud, rig.servos, made=own).write(file)
        assert main(["servo", "read", "--rig", file]) == 0
        assert "note:" not in capsys.readouterr().out
        lines = [one for one in doctor.examine(rig=file).lines if one.name == "servo 1"]
        assert [one.state for one in lines] == ["ok"]


@pytest.mark.long
def test_no_model_as_delivered_has_gains_to_remark_on():
    for model in _core.servo_models():
        bus = _core.EmulatedBus([(1, model["number"], 57_600, 500.0)], [[]])
        (found,) = setup.scan(bus.path, 57_600)
        with opened(bus.path, 57_600) as port:
            assert remarks_on_gains(found, setup.registers(port, 1)) == [], model["name"]
        leave(bus.path, 57_600, position_i_gain=4)
        with opened(bus.path, 57_600) as port:
            assert len(remarks_on_gains(found, setup.registers(port, 1))) == 1, model["name"]
        bus.unplug()


def test_set_up_writes_no_gains_of_another_model():
    """The servo sets its own; those of the table, one set a model, serve for comparison only."""
    models = _core.servo_models()
    assert len({model["position_gains"] for model in models}) >= 5
    for model in models:
        bus = _core.EmulatedBus([(1, model["number"], 57_600, 500.0)], [[]])
        leave(bus.path, 57_600, position_p_gain=1, position_i_gain=2, position_d_gain=3)
        (found,) = setup.scan(bus.path, 57_600)
        with opened(bus.path, 57_600) as port:
            (p, i, d) = remarks_on_gains(found, setup.registers(port, 1))
        for line, gain in zip((p, i, d), model["position_gains"]):
            assert f"the manual's initial value is {gain}; " in line, model["name"]
        setup.set_up(found)
        assert tuple(setup.gains(found)) == manual_gains(found.model), model["name"]
        bus.unplug()


LOOSE = {"temperature_limit": 100, "max_voltage_limit": 300, "min_voltage_limit": 20, "shutdown": 1}
TIGHT = {"temperature_limit": 30, "max_voltage_limit": 61, "min_voltage_limit": 139}


@pytest.mark.parametrize("number", [1190, 1060, 1210, 1120])
@pytest.mark.parametrize("values", [LOOSE, TIGHT], ids=["loose", "tight"])
def test_the_limits_by_which_a_servo_protects_itself_are_those_of_its_model(number, values):
    model = numbered(number)
    bus = _core.EmulatedBus([(1, number, 57_600, 500.0)], [[]])
    leave(bus.path, 57_600, **values)
    (found,) = setup.scan(bus.path, 57_600)
    with opened(bus.path, 57_600) as port:
        left = {need.register for need in differing(model, setup.registers(port, 1))}
    assert left >= set(values)
    setup.set_up(found)
    with opened(bus.path, 57_600) as port:
        now = setup.registers(port, 1)
    low, high = model["voltage_V"]
    assert [now[name] for name in LOOSE] == [
        model["temperature_limit_C"],
        round(10 * high),
        round(10 * low),
        model["shutdown"],
    ]
    bus.unplug()


def test_a_temperature_limit_below_that_of_the_guard_is_refused():
    """The guard of a cooler rig stops before the servo does; that of another one would not."""
    with emulated_rig() as (bus, rig, limits):
        leave(bus.path, BAUD, temperature_limit=60)
        found = members_of(rig.numbers, limits, [])
        assert "temperature limit is 60, needed is 65 to 70" in refusal(
            examined(rig.port, rig.baud, found)
        )
        for hot in (45.0, 59.5, 60.0):
            cool = limits | {"servos": [one | {"hot": hot} for one in limits["servos"]]}
            cooler = members_of(rig.numbers, cool, [])
            assert refusal(examined(rig.port, rig.baud, cooler)) == ""


def test_a_watchdog_that_tripped_blocks_no_start():
    """It refuses goals, so that it is cleared before the goal PWM is written again."""
    with emulated_rig() as (bus, rig, _):
        leave(bus.path, BAUD, goal_pwm=100, bus_watchdog=1, torque_enable=1)
        time.sleep(0.1)
        leave(bus.path, BAUD, torque_enable=0)
        assert started(rig.port, rig.baud, members(rig)) == [
            "servo 1: bus watchdog was 255, left by another program: it is 0 now",
            "servo 1: goal pwm was 100, left by another program: it is 885 now",
        ]
        assert started(rig.port, rig.baud, members(rig)) == []
