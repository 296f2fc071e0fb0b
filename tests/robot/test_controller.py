"""The control loop in its own process, on emulated servos: it follows, and whatever dies, the
finger ends slack.
"""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from rigs import HOME, TICKS_PER_MM, WINDOW, angles, calibration, emulated_rig, set_up, torque
from waiting import hold_for, until

from softmap_edge import _core
from softmap_edge.cli import main
from softmap_edge.errors import ServoError
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.servo.loop_limits import loop_limits, servo_limits
from softmap_edge.robot.servo.rig import Rig, RigServo, read_rig


def test_follows_targets_and_ends_slack():
    with emulated_rig() as (bus, rig, limits):
        with Controller(rig, calibration(), limits) as robot:
            assert robot.state == "ready" and not torque(bus)
            assert robot.engage() == pytest.approx([0.0, 0.0])
            assert robot.state == "engaged" and torque(bus)
            assert robot.target([1.0, -1.0]) == pytest.approx([1.0, -1.0])
            assert robot.target([9.0, -1.0]) == pytest.approx([900 / TICKS_PER_MM, -1.0]), (
                "what will be done"
            )
            hold_for(robot, [1.0, -1.0], 1.2)
            assert angles(bus) == pytest.approx(
                HOME + TICKS_PER_MM * np.array([1.0, -1.0]), abs=2.0
            )
        assert not torque(bus)
        assert np.abs(angles(bus) - HOME).max() < 60.0
        assert robot.ended["ended"] == "alone" and robot.ended["lost"] == 0
        assert robot.ended["ticks"] > 200 and robot.ended["late_us"]["p50"] < 5000


def test_a_program_that_stops_calling_is_held_then_tension_is_released():
    with (
        emulated_rig(hold=0.4) as (bus, rig, limits),
        Controller(rig, calibration(), limits) as robot,
    ):
        robot.engage()
        hold_for(robot, [1.0, 0.0], 0.8)
        until(lambda: robot.state == "hold", 1.0)
        assert torque(bus)
        robot.target([1.0, 0.0])
        until(lambda: robot.state == "engaged", 0.5)
        until(lambda: robot.state == "safe_stop", 1.5)
        until(lambda: robot.state == "ready" and not torque(bus), 3.0)
        with pytest.raises(ServoError, match=r"in state ready .*call engage\(\) first"):
            robot.target([0.0, 0.0])


@pytest.mark.parametrize("old", [(0, 1), (1,)], ids=["both", "one"])
def test_servos_of_older_firmware_are_driven_as_well(old):
    with emulated_rig() as (bus, rig, limits):
        for servo in old:
            bus.flash(servo, _core.FAST_FIRMWARE - 1)
        with Controller(rig, calibration(), limits) as robot:
            robot.engage()
            reports = []
            for _ in range(5):
                hold_for(robot, [1.0, 1.0], 0.2)
                reports.append(robot.report["position"])
            assert robot.state == "engaged"
            # an answer may be lost on a busy computer
            assert any(None not in positions for positions in reports)
            np.testing.assert_allclose(angles(bus), HOME + TICKS_PER_MM, atol=5)


def test_who_sent_nothing_for_too_long_is_reported_so_and_who_let_go_that_he_did():
    with emulated_rig() as (_, rig, limits), Controller(rig, calibration(), limits) as robot:
        robot.engage()
        until(lambda: robot.state == "ready", 10.0)
        with pytest.raises(
            ServoError,
            match=r"in state ready \(this program sent no target for [2-9]\.\d s\); call e",
        ):
            robot.target([0.0, 0.0])
        robot.engage()
        robot.release()
        until(lambda: robot.state == "ready", 10.0)
        with pytest.raises(
            ServoError,
            match=r"in state ready \(the enable key was released\); call engage\(\) first",
        ):
            robot.target([0.0, 0.0])


def test_a_request_that_is_denied_says_why():
    with emulated_rig() as (_, rig, limits), Controller(rig, calibration(), limits) as robot:
        with pytest.raises(
            ServoError, match="'arm' is denied in state ready: not allowed in state ready"
        ):
            robot.request("arm")
        with pytest.raises(ServoError, match="no request 'fly'"):
            robot.request("fly")
        with pytest.raises(ServoError, match="shape"):
            robot.engage([1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    "name, breaks",
    [
        ("silent", lambda bus: bus.damage(1, mute=True)),
        ("silent", lambda bus: bus.faults(unpowered=True)),
        ("hardware", lambda bus: bus.fail(1, 0x20)),
        ("hot", lambda bus: bus.heat(0, 69.0)),
        ("voltage", lambda bus: bus.supply(0, 2.9)),
    ],
)
def test_a_fault_ends_without_torque(name, breaks):
    silent = pytest.raises(ServoError, match="did not confirm that (its|their) torque is off")
    with emulated_rig() as (bus, rig, limits):
        with (
            silent if name == "silent" else contextlib.nullcontext(),
            Controller(rig, calibration(), limits) as robot,
        ):
            robot.engage()
            hold_for(robot, [1.0, 1.0], 0.6)
            breaks(bus)
            for _ in range(200):
                if robot.state == "fault":
                    break
                with contextlib.suppress(ServoError):
                    robot.target([1.0, 1.0])
                time.sleep(0.02)
            assert robot.state == "fault" and robot.report["cause"] == name
            with pytest.raises(ServoError, match="in state fault"):
                robot.target([0.0, 0.0])
        bus.damage(1, mute=False)
        assert not bus.state()[1][0][1], "the servo that hears has no torque"


@pytest.mark.parametrize(
    "power",
    [pytest.param(False, id="a servo was mute"), pytest.param(True, id="the bus had no power")],
)
def test_a_running_loop_accepts_no_home_and_the_next_start_asks_for_confirmation(power):
    with emulated_rig() as (bus, rig, limits):
        with Controller(rig, calibration(), limits) as robot:
            robot.engage()
            hold_for(robot, [1.0, 1.0], 0.4)
            bus.faults(unpowered=True) if power else bus.damage(1, mute=True)
            until(lambda: robot.state == "fault", 5.0)
            bus.faults(unpowered=False) if power else bus.damage(1, mute=False)
            until(lambda: acknowledged(robot), 5.0)
            assert robot.state == "connected", "home is forgotten"
            with pytest.raises(
                ServoError, match="in state connected, and a running loop cannot home it"
            ):
                robot.request("home")
            assert robot.state == "connected" and not torque(bus)
            with pytest.raises(ServoError, match="'engage' is denied in state connected"):
                robot.request("engage")
        with pytest.raises(ServoError, match="not homed since power-up"):
            Controller(rig, calibration(), limits).__enter__()


@pytest.mark.parametrize("how", ["stuck", "jammed"])
def test_a_fault_after_which_home_must_be_confirmed_is_kept_over_a_restart(how):
    with emulated_rig() as (bus, rig, limits):
        limits["servos"] = [one | {"following": 300.0} for one in limits["servos"]]
        with (
            pytest.raises(ServoError, match="does not follow"),
            Controller(rig, calibration(), limits) as robot,
        ):
            robot.engage()
            hold_for(robot, [0.5, 0.0], 0.5)
            bus.damage(0, **{how: True})
            hold_for(robot, [3.0, 0.0], 10.0)
        bus.damage(0, **{how: False})
        until(
            lambda: abs(angles(bus) - HOME).max() < WINDOW[1]
        )  # it ran far behind its encoder, and its tendon pulls it back
        with pytest.raises(ServoError, match="servo 1: not homed since power-up"):
            Controller(rig, calibration(), limits).__enter__()
        set_up(bus.path)
        with Controller(rig, calibration(), limits) as robot:
            robot.emergency()
            assert robot.state == "fault"
        with Controller(rig, calibration(), limits) as robot:
            assert robot.state == "ready", "an emergency stop loses no home"


def acknowledged(robot):
    """Return whether the fault could be acknowledged; it cannot before every servo has reported
    that it has no torque.
    """
    with contextlib.suppress(ServoError):
        robot.request("acknowledge")
    return robot.state != "fault"


def test_an_unplugged_port_ends_the_loop_with_a_reason():
    unsure = pytest.raises(
        ServoError, match="servos 1, 2 did not confirm that their torque is off; cut their supply"
    )
    with (
        emulated_rig() as (bus, rig, limits),
        unsure,
        Controller(rig, calibration(), limits) as robot,
    ):
        robot.engage()
        bus.unplug()
        until(lambda: robot.state == "fault" and robot.ended, 5.0)
        assert robot.ended["ended"] == "port"


PROGRAM = """
import signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored by background tests
sys.path.insert(0, {tests!r})
from rigs import calibration, WINDOW, MODEL, HOME, BAUD
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.servo.loop_limits import loop_limits, servo_limits
from softmap_edge.robot.servo.rig import Rig, RigServo
rig = Rig({path!r}, BAUD, tuple(RigServo(id, MODEL, HOME) for id in (1, 2)))
limits = loop_limits([servo_limits(MODEL, HOME, WINDOW)] * 2, 200.0, hold=0.4)
with Controller(rig, calibration(), limits) as robot:
    robot.engage()
    print(robot._process.pid, flush=True)
    while True:
        robot.target([1.0, -1.0])
        time.sleep(0.02)
"""


@pytest.fixture
def program():
    """Start a user's program in a process of its own on an emulated bus; gives bus, process, and
    the loop's pid.
    """
    with emulated_rig() as (bus, _, _):
        text = PROGRAM.format(tests=str(Path(__file__).parents[1] / "support"), path=bus.path)
        user = subprocess.Popen(
            [sys.executable, "-c", text], stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        loop = int(user.stdout.readline())
        until(lambda: np.abs(angles(bus) - HOME).min() > 250, 5.0)
        try:
            yield bus, user, loop
        finally:
            user.kill()
            user.wait()
            user.stdout.close()
            user.stderr.close()


def alive(pid):
    """Return whether a process is there."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_kill_9_of_the_program_holds_then_releases_tension(program):
    bus, user, loop = program
    user.kill()
    user.wait()
    time.sleep(0.2)
    assert torque(bus), "held first"
    assert np.abs(angles(bus) - HOME).min() > 200
    took = until(lambda: not torque(bus), 4.0)
    assert took > 0.3 and np.abs(angles(bus) - HOME).max() < 80, "slackened before torque went off"
    until(lambda: not alive(loop), 3.0)


def test_an_interrupt_ends_the_program_in_order(program):
    bus, user, loop = program
    user.send_signal(signal.SIGINT)
    assert user.wait(10) != 0
    assert not torque(bus) and np.abs(angles(bus) - HOME).max() < 80
    assert b"KeyboardInterrupt" in user.stderr.read()
    until(lambda: not alive(loop), 3.0)


@pytest.mark.parametrize("ends", [signal.SIGTERM, signal.SIGINT])
def test_a_loop_asked_to_end_releases_tension(program, ends):
    bus, _, loop = program
    os.kill(loop, ends)
    until(lambda: not torque(bus), 4.0)
    assert np.abs(angles(bus) - HOME).max() < 80


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_loop_that_dies_or_freezes_is_released_from_here(program, how):
    bus, user, loop = program
    os.kill(loop, how)
    until(lambda: not torque(bus), 2.0)
    user.wait(10)
    assert (
        b"in state fault (the control loop died or froze); start another Controller"
        in user.stderr.read()
    )


def test_with_no_process_left_the_watchdogs_stop_and_hold_and_the_next_start_reports_it(program):
    bus, user, loop = program
    user.send_signal(signal.SIGSTOP)  # cannot rescue
    os.waitpid(user.pid, os.WUNTRACED)  # until each of its threads has stopped
    os.kill(loop, signal.SIGKILL)
    until(lambda: all(tripped for _, _, tripped, _ in bus.state()[1]), 1.0)
    at = angles(bus)
    time.sleep(0.3)
    assert torque(bus) and angles(bus) == pytest.approx(at, abs=1.0), "it stands where it was"
    user.kill()
    user.wait()
    rig = Rig(bus.path, 1_000_000, tuple(RigServo(id, "XL330-M288", HOME) for id in (1, 2)))
    limits = loop_limits([servo_limits("XL330-M288", HOME, (-900, 900))] * 2)
    with pytest.raises(
        ServoError, match="servo 1: its torque is on: another program drives it, or one died"
    ):
        Controller(rig, calibration(), limits).__enter__()
    assert main(["servo", "off", "--port", bus.path, "--baud", "1000000"]) == 0
    assert all(tripped for _, _, tripped, _ in bus.state()[1]), (
        "torque off alone clears no watchdog"
    )
    with Controller(rig, calibration(), limits) as robot:
        robot.engage()
        hold_for(robot, [0.5, 0.5], 1.0)
        assert robot.state == "engaged" and not any(tripped for _, _, tripped, _ in bus.state()[1])


def test_a_frozen_computer_leaves_the_servos_standing_and_releases_them_when_it_goes_on(program):
    bus, user, loop = program
    for pid in (user.pid, loop):
        os.kill(pid, signal.SIGSTOP)
    until(lambda: all(tripped for _, _, tripped, _ in bus.state()[1]), 1.0)
    at = angles(bus)
    time.sleep(0.8)  # longer than the program would wait for its loop
    assert torque(bus) and angles(bus) == pytest.approx(at, abs=1.0), "they hold where they were"
    for pid in (loop, user.pid):
        os.kill(pid, signal.SIGCONT)
    until(lambda: not torque(bus), 4.0)
    assert user.wait(10) != 0
    assert b"in state fault" in user.stderr.read()


def test_servos_that_differ_from_the_rig_are_refused():
    with emulated_rig() as (bus, rig, limits):
        ours = _core.ServoBus(bus.path, rig.baud)
        ours.write(2, 64, b"\x01")
        ours.close()
        with pytest.raises(ServoError, match="servo 2: its torque is on"):
            Controller(rig, calibration(), limits).__enter__()
        set_up(bus.path)
        ours = _core.ServoBus(bus.path, rig.baud)
        ours.write(1, 11, b"\x03")
        ours.close()
        with pytest.raises(
            ServoError,
            match=r"servo 1: operating mode is 3 \(position\), needed is 5; run `softmap servo setup --port",
        ):
            Controller(rig, calibration(), limits).__enter__()
        set_up(bus.path)
        other = Rig(rig.port, rig.baud, (RigServo(1, "XM430-W210", HOME), rig.servos[1]))
        with pytest.raises(
            ServoError, match=r"servo 1: it is XL330-M288 \(1200\), the rig lists XM430-W210"
        ):
            Controller(other, calibration(), limits).__enter__()
        absent = Rig(rig.port, rig.baud, (RigServo(7, "XL330-M288", HOME), rig.servos[1]))
        with pytest.raises(
            ServoError,
            match=(
                "servo 7: no answer, but id 1 answers, which the rig does not list; .*--id 1 "
                "--new-id 7"
            ),
        ):
            Controller(absent, calibration(), limits).__enter__()
        with pytest.raises(ServoError, match="no such port"):
            Controller(Rig("/dev/ttyNONE", rig.baud, rig.servos), calibration(), limits).__enter__()


def test_limits_that_make_no_sense_are_refused():
    one = servo_limits("XL330-M288", 0, (-500, 500))
    for changes, said in (
        ({"stale": 60.0}, "stale is 60 s; allowed is"),
        ({"late": float("nan")}, "late is NaN s"),
        ({"fly": 1.0}, "no limit 'fly'"),
    ):
        with pytest.raises(ServoError, match=said):
            loop_limits([one], **changes)
    with pytest.raises(ServoError, match="servo 1: slew is 90000 ticks/s"):
        loop_limits([one | {"slew": 90_000.0}])
    with pytest.raises(ServoError, match="a rate of 5 a second"):
        loop_limits([one], rate=5)
    with pytest.raises(ServoError, match="no servo 'XL1'"):
        servo_limits("XL1", 0, (-1, 1))


def test_a_rig_survives_its_file(tmp_path):
    rig = Rig(
        '/dev/tty "odd"', 1_000_000, (RigServo(3, "XL330-M288", -5), RigServo(4, "XM430-W210"))
    )
    rig.write(tmp_path / "rig.toml")
    assert read_rig(tmp_path / "rig.toml") == rig
    for text, said in (
        ("schema = 1", "expected text"),
        ('schema = "softmap.rig/1"\nbaud = 57600', "no port"),
        (
            'schema = "softmap.rig/1"\nport = "x"\n[[servo]]\nmodel = "XL330-M288"',
            "servo 1 has no id",
        ),
        (
            'schema = "softmap.rig/1"\nport = "x"\nbaud = 1000000\n[[servo]]\nid = 1\nmodel = "Y"',
            "no servo 'Y' is known",
        ),
        ('schema = "softmap.rig/1"\nport = "x"', "0 servos"),
        ("[", "no TOML"),
    ):
        (tmp_path / "bad.toml").write_text(text)
        with pytest.raises(ServoError, match=said):
            read_rig(tmp_path / "bad.toml")
    with pytest.raises(ServoError, match="make it with `softmap servo setup --rig"):
        read_rig(tmp_path / "none.toml")
    with pytest.raises(ServoError, match="stands twice"):
        Rig("x", 57_600, (RigServo(1, "XL330-M288"), RigServo(1, "XL330-M288")))
    with pytest.raises(ServoError, match="no rate of 4500000"):
        Rig("x", 4_500_000, (RigServo(1, "XL330-M288"),))
