"""Every failure of the loop or of a servo is detected and reported, even if the
program only sleeps.
"""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from rigs import calibration, emulated_rig, torque
from waiting import hold_for, until

from softmap_edge.cli import main
from softmap_edge.errors import ServoError
from softmap_edge.robot.control.controller import Controller

PROGRAM = """
import os, sys, time
sys.path.insert(0, {tests!r})
from rigs import calibration, WINDOW, MODEL, HOME, BAUD
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.servo.loop_limits import loop_limits, servo_limits
from softmap_edge.robot.servo.rig import Rig, RigServo
rig = Rig({path!r}, BAUD, tuple(RigServo(id, MODEL, HOME) for id in (1, 2)))
with Controller(rig, calibration(), loop_limits([servo_limits(MODEL, HOME, WINDOW)] * 2, 200.0, hold={hold})) as robot:
    robot.engage()
"""


SUPPORT = Path(__file__).parents[1] / "support"


def program(bus, text, hold):
    """Return the command line of a user's program that has engaged the robot at `bus` and then does
    `text`.
    """
    return [
        sys.executable,
        "-c",
        PROGRAM.format(tests=str(SUPPORT), path=bus.path, hold=hold) + text,
    ]


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_program_that_sleeps_releases_the_servos_of_a_loop_that_dies_or_freezes(how):
    with emulated_rig() as (bus, rig, limits), Controller(rig, calibration(), limits) as robot:
        robot.engage()
        hold_for(robot, [1.0, -1.0], 0.4)
        os.kill(robot._process.pid, how)
        until(lambda: not torque(bus))
        assert (
            robot.state == "fault"
            and robot.report["cause"] == "loop"
            and not robot.report["torque"]
        )
        with pytest.raises(
            ServoError,
            match=r"in state fault \(the control loop died or froze\); start another Controller",
        ):
            robot.target([0.0, 0.0])


def test_a_program_that_was_frozen_itself_does_not_end_a_loop_that_is_well():
    """Its reports lie in the pipe: who wakes reads them before it says that there were none."""
    text = """
    import signal, subprocess
    for _ in range(6):
        end = time.monotonic() + 0.3
        while time.monotonic() < end:
            robot.target([1.0, -1.0])
            time.sleep(0.002)
        subprocess.Popen(["sh", "-c", f"sleep 0.9; kill -CONT {os.getpid()}"])
        os.kill(os.getpid(), signal.SIGSTOP)
    print(robot.state, robot.report.get("rescued"))
"""
    with emulated_rig() as (bus, _, _):
        argv = program(bus, text, hold=5.0)
        done = subprocess.run(argv, capture_output=True, text=True, timeout=60)
        assert done.returncode == 0 and done.stdout.split()[1] == "None", done


def test_a_rescue_says_which_servo_kept_its_torque():
    with emulated_rig(late=0.5, silent=1.0, stale=0.5) as (bus, rig, limits):
        said = pytest.raises(
            ServoError, match="servo 1 did not confirm that its torque is off; cut its supply"
        )
        with said, Controller(rig, calibration(), limits) as robot:
            robot.engage()
            hold_for(robot, [1.0, -1.0], 0.4)
            bus.damage(0, mute=True)
            robot._process.kill()
            until(lambda: "rescued" in robot.report)
            assert (
                "but servo 1 did not confirm" in robot.report["rescued"] and robot.report["torque"]
            )
        assert [one[1] for one in bus.state()[1]] == [True, False]


def test_a_servo_that_does_not_hear_at_the_end_is_named(tmp_path, capsys):
    with emulated_rig() as (bus, rig, limits):
        said = pytest.raises(
            ServoError, match="in state fault .*; servo 2 did not confirm that its torque is off"
        )
        with said, Controller(rig, calibration(), limits) as robot:
            robot.engage()
            hold_for(robot, [1.0, -1.0], 0.4)
            bus.damage(1, mute=True)
            hold_for(robot, [1.0, -1.0], 5.0)
        rig.write(tmp_path / "rig.toml")
        off = ["servo", "off", "--rig", str(tmp_path / "rig.toml")]
        assert main(off) == 1 and torque(bus)
        assert "servo 2 did not confirm" in capsys.readouterr().out
        bus.damage(1, mute=False)
        assert main(off) == 0 and not torque(bus)
        assert "off: servo 1, 2" in capsys.readouterr().out


def test_a_child_of_the_program_does_not_hold_the_port():
    text = """
    child = os.fork()
    if child == 0:
        time.sleep(60)
        os._exit(0)
    print(child, flush=True)
    while True:
        robot.target([1.0, -1.0])
        time.sleep(0.02)
"""
    with emulated_rig() as (bus, rig, limits):
        user = subprocess.Popen(program(bus, text, hold=0.4), stdout=subprocess.PIPE)
        try:
            child = int(user.stdout.readline())
            until(lambda: torque(bus))
            user.kill()
            user.wait()
            os.kill(child, 0)  # it lives
            until(lambda: not torque(bus))
            until(lambda: starts(rig, limits))
        finally:
            user.kill()
            user.wait()
            user.stdout.close()
            os.kill(child, signal.SIGKILL)


def starts(rig, limits):
    """Return whether a robot can be driven: its port is free."""
    try:
        with Controller(rig, calibration(), limits):
            return True
    except ServoError as fault:
        assert "in use" in str(fault)
        return False


def test_what_is_no_command_is_one_line_and_what_is_not_finite_will_not_be_done():
    with emulated_rig() as (_, rig, limits), Controller(rig, calibration(), limits) as robot:
        robot.engage([1.0, 0.0])
        for bad in (
            "ab",
            None,
            [1 + 1j, 0],
            [[1.0, 2.0]],
            [1.0, 2.0, 3.0],
            [1.0, "x"],
            [[1.0], 2.0],
        ):
            with pytest.raises(ServoError, match="expected shape .2,.: 2 real numbers"):
                robot.target(bad)
        assert robot.target([2.0, 1.0]) == pytest.approx([2.0, 1.0])
        for bad in ([np.nan, 0.0], [np.inf, 0.0]):
            assert robot.target(bad) == pytest.approx([2.0, 1.0])


def test_a_lost_answer_in_the_last_report_is_no_place():
    with emulated_rig() as (_, rig, limits), Controller(rig, calibration(), limits) as robot:
        time.sleep(0.1)
        at = robot.position
        robot._hear({"position": [None, 5]})
        assert robot.position == pytest.approx([at[0], 5]) and np.isfinite(robot.position).all()
