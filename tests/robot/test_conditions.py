"""Sensor values that the guard refuses are faults of doctor and read too, with value, limit
and remedy.
"""

import re
import shlex
from dataclasses import replace

import pytest
from rigs import BAUD, HOME, WINDOW, calibration, emulated_rig

from softmap_edge import builtin_model, save_bundle
from softmap_edge.cli import main
from softmap_edge.errors import ServoError
from softmap_edge.robot import doctor
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.servo.conditions import jogs, outside, too_hot, undersupplied
from softmap_edge.robot.servo.rig_ceiling import Ceiling

HOT = "is too hot: {} °C, allowed is below 65 °C"
POWER = "has a supply voltage of {} V, allowed are 3.5 to 7 V"


@pytest.mark.parametrize(
    "breaks, said, remedy",
    [
        (
            lambda bus: bus.heat(0, 69.0),
            r"is too hot: 6\d °C, allowed is below 65 °C",
            "let it cool",
        ),
        (
            lambda bus: bus.supply(0, 2.9),
            "has a supply voltage of 2.9 V, allowed are 3.5 to 7 V",
            "power supply",
        ),
        (
            lambda bus: bus.supply(0, 8.1),
            "has a supply voltage of 8.1 V, allowed are 3.5 to 7 V",
            "power supply",
        ),
    ],
)
def test_what_keeps_the_guard_from_starting_is_a_fault_everywhere(
    breaks, said, remedy, tmp_path, capsys
):
    file = str(tmp_path / "rig.toml")
    with emulated_rig() as (bus, rig, limits):
        rig.write(file)
        assert main(["servo", "read", "--rig", file]) == 0
        breaks(bus)
        (line,) = [one for one in doctor.examine(rig=file).lines if one.name == "servo 1"]
        assert line.state == "fault" and re.search(said, line.found) and remedy in line.do
        for where in (["--rig", file], ["--port", bus.path, "--baud", str(BAUD), "--id", "1"]):
            capsys.readouterr()
            assert main(["servo", "read", *where]) == 1
            assert re.search(f"! it {said}; .*{remedy}", capsys.readouterr().out)
        with (
            pytest.raises(ServoError, match=f"servo 1 {said}.*{remedy}"),
            Controller(rig, calibration(), limits) as robot,
        ):
            for _ in range(200):
                robot.engage() if robot.state == "ready" else robot.target([0.0, 0.0])
                robot.time.sleep(0.02)
        assert main(["servo", "home", "--rig", file, "--yes"]) == 0, "it is homed all the same"


def test_connect_is_denied_with_servo_value_limit_and_remedy():
    with emulated_rig() as (bus, rig, limits):
        bus.heat(1, 69.0)
        for _ in range(3):  # on a busy computer the answer with the temperature may be lost
            with pytest.raises(ServoError, match=r"'connect' is denied .* too hot") as denied:
                Controller(rig, calibration(), limits).__enter__()
            if "°C" in str(denied.value):
                break
        assert re.search(r"servo 2 is too hot: 6\d °C, .* 65 °C; let it", str(denied.value))


def held(robot, seconds, target=(0.0, 0.0)):
    """Send a target as often as a program does, for some seconds; return the last state."""
    until = robot.time.now() + seconds
    while robot.time.now() < until:
        robot.target(list(target))
        robot.time.sleep(0.02)
    return robot.state


@pytest.mark.parametrize("volts", [2.9, 8.1])
def test_a_short_dip_of_the_supply_is_no_fault_and_a_long_one_is(volts):
    with (
        emulated_rig(grace=1.0) as (bus, rig, limits),
        Controller(rig, calibration(), limits) as robot,
    ):
        robot.engage()
        assert held(robot, 0.3) == "engaged"
        for _ in range(3):
            bus.supply(0, volts)
            assert held(robot, 0.3) == "engaged", "within the grace"
            bus.supply(0, 5.0)
            assert held(robot, 0.3) == "engaged", "each dip begins again"
        bus.supply(0, volts)
        with pytest.raises(ServoError, match="supply voltage"):
            held(robot, 3.0)
        assert robot.report["cause"] == "voltage"


def test_a_dip_before_the_start_has_its_grace_too():
    with (
        emulated_rig(grace=1.0) as (bus, rig, limits),
        Controller(rig, calibration(), limits) as robot,
    ):
        bus.supply(0, 2.9)
        robot.time.sleep(0.2)
        robot.engage()
        assert held(robot, 0.2) == "engaged"
        bus.supply(0, 5.0)
        assert held(robot, 1.5) == "engaged"


def test_a_ceiling_of_the_rig_is_the_limit(tmp_path):
    with emulated_rig() as (bus, rig, _):
        replace(rig, ceiling=Ceiling((("hot", 50.0),))).write(tmp_path / "rig.toml")
        bus.heat(0, 55.0)
        (line,) = [
            one for one in doctor.examine(rig=tmp_path / "rig.toml").lines if one.name == "servo 1"
        ]
        assert "allowed is below 50 °C" in line.found


def test_a_place_outside_the_window_is_a_fault_and_its_command_leads_back(tmp_path, capsys):
    file, finger = str(tmp_path / "rig.toml"), str(tmp_path / "finger")
    save_bundle(replace(builtin_model(), calibration=calibration()), finger)
    drive = [
        "servo",
        "move",
        "0.2,0.2",
        "--rig",
        file,
        "--bundle",
        finger,
        "--hold",
        "--seconds",
        "0.1",
    ]
    with emulated_rig(load=[]) as (bus, rig, _):
        rig.write(file)
        for _ in range(4):
            assert (
                main(["servo", "move", "--servo", "1", "--by", "280", "--rig", file, "--hold"]) == 0
            )
        capsys.readouterr()
        assert main(drive) == 2
        denied = capsys.readouterr().err
        assert re.search(
            r"servo 1 stands at 31\d\d ticks, outside its window of 1100 to 2900", denied
        )
        (line,) = [one for one in doctor.examine(file, finger).lines if one.name == "servo 1"]
        assert line.state == "fault" and "outside its window of 1100 to 2900" in line.found
        assert follow(line.do) == follow(denied, run=False)
        assert main(drive) == 0


def follow(said, run=True):
    """Run the jog that a message names as often as it says; return the command."""
    command, times = re.search(r"`softmap (servo move [^`]+)`(?:, (\d+) times)?", said).groups()
    for _ in range(int(times or 1) if run else 0):
        assert main([*shlex.split(command), "--hold"]) == 0
    return command


def test_limits_hold_at_their_edges():
    assert too_hot(64.9, 65.0) == "" and too_hot(65.0, 65.0) and too_hot(90, None) == ""
    assert undersupplied(3.5, (3.5, 7.0)) == "" == undersupplied(7.0, (3.5, 7.0)) and undersupplied(
        3.4, (3.5, 7.0)
    )
    low, high = HOME + WINDOW[0], HOME + WINDOW[1]
    assert outside(1, low, (low, high)) == "" == outside(1, high, (low, high)) and outside(
        1, high + 1, (low, high)
    )
    assert outside(1, 10.0, (0.0, 4.0)), "a window narrower than a jog"


@pytest.mark.parametrize(
    "ticks, most, command",
    [
        (-559, 300, "--by -280"),
        (40, 300, "--by +40"),
        (-301, 300, "--by -150"),
        (-100, 40, "--by -33"),
        (0.2, 300, "+1"),
    ],
)
def test_jogs_reach_their_goal_in_allowed_steps(ticks, most, command):
    said = jogs(3, ticks, most)
    step, times = (
        int(re.search(r"--by ([+-]\d+)", said)[1]),
        int((re.findall(r", (\d+) times", said) or [1])[0]),
    )
    assert command in said and abs(step) <= most and abs(step * times - ticks) <= times
