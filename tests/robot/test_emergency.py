"""The emergency stops, through the loop's own process on emulated servos: torque off at once,
latched, home known.
"""

import contextlib
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import replace

import pytest
from rigs import HOME, TICKS_PER_MM, angles, calibration, emulated_rig, torque
from waiting import hold_for, until

from softmap_edge.errors import LinkError, ServoError
from softmap_edge.robot.control import controller as controller_module
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.control.heartbeat import BEAT, Heart
from softmap_edge.robot.link.session import new_key, read_key
from softmap_edge.robot.servo.emergency import Beats, Emergency, Line
from softmap_edge.robot.servo.rig import read_rig

AT_HOME = 64  # ticks: so near the guard calls a servo home, a sixth of what it was sent
TIMEOUT = 0.3  # s between beats at most: generous, since tests share a computer


def free_port():
    """Return a free UDP port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@contextmanager
def beating(heart):
    """Let `heart` beat fifty times a second; gives a dictionary whose `pressed` it says."""
    said, done = {"pressed": False}, threading.Event()

    def live():
        while not done.wait(0.02):
            heart.beat(said["pressed"])

    thread = threading.Thread(target=live, daemon=True)
    thread.start()
    try:
        yield said
    finally:
        done.set()
        thread.join(2.0)


def acknowledged(robot):
    """Return whether the guard took an acknowledgement."""
    try:
        robot.request("acknowledge")
    except ServoError as denied:
        assert "a servo has torque" in str(denied)
        return False
    return True


def again(robot):
    """Acknowledge and go on, as the user who released the stop does; homing is not needed."""
    # servos are asked five times a second whether they have torque
    until(lambda: acknowledged(robot), 3.0)
    assert robot.state == "homed", "home is still known"
    robot.request("arm")
    robot.engage()
    assert robot.state == "engaged"


def assert_stopped(robot, bus):
    """Torque is off where the finger stood, the fault is latched and says why."""
    until(lambda: robot.state == "fault" and not torque(bus), 2.0)
    assert robot.report["cause"] == "emergency"
    with pytest.raises(ServoError, match="in state fault .*emergency"):
        robot.target([0.5, 0.0])


def test_a_program_presses_and_releases():
    with emulated_rig() as (bus, rig, limits), Controller(rig, calibration(), limits) as robot:
        robot.engage()
        hold_for(robot, [1.0, -1.0], 0.8)
        robot.emergency()
        assert robot.report["torque"] is False, "it returns once torque is off"
        assert_stopped(robot, bus)
        with pytest.raises(
            ServoError,
            match="'acknowledge' is denied in state fault: something is wrong: the emergency",
        ):
            robot.request("acknowledge")
        robot.release()  # any other order in between releases nothing
        time.sleep(0.1)
        assert robot.report["emergency"] and robot.state == "fault"
        robot.emergency(False)
        until(lambda: not robot.report["emergency"], 1.0)
        time.sleep(0.1)
        assert robot.state == "fault" and not torque(bus), "released is not acknowledged"
        again(robot)
        assert torque(bus)
        robot.emergency()
        robot.emergency(False)
        robot.request("acknowledge")  # it waits until the servos have reported no torque
        assert robot.state == "homed"


def test_it_stops_from_another_thread_while_targets_are_sent():
    with emulated_rig() as (bus, rig, limits), Controller(rig, calibration(), limits) as robot:
        robot.engage()
        pressing = threading.Timer(0.5, robot.emergency)
        pressing.start()
        with pytest.raises(ServoError, match="in state fault"):
            hold_for(robot, [1.0, 1.0], 10.0)
        pressing.join()
        assert_stopped(robot, bus)


def test_a_loop_that_does_not_hear_it_is_ended_and_the_servos_released(monkeypatch):
    with emulated_rig() as (bus, rig, limits), Controller(rig, calibration(), limits) as robot:
        robot.engage()
        monkeypatch.setattr(controller_module, "FROZEN", 5.0)  # no other check notices first
        robot._process.send_signal(19)  # SIGSTOP
        monkeypatch.setattr(controller_module, "FROZEN", 0.3)
        with pytest.raises(ServoError, match="died or froze; its servos were released"):
            robot.emergency()
        until(lambda: not torque(bus), 2.0)  # what was sent takes its time on the emulated wire


@pytest.fixture
def heart_rig(tmp_path):
    """Give a function that adds a heartbeat to a rig, and the heart of it."""
    key = new_key(tmp_path / "stop.key")
    port = free_port()
    udp = Beats(port, str(tmp_path / "stop.key"), TIMEOUT, "127.0.0.1")
    with Heart("127.0.0.1", port, key) as heart:
        yield lambda rig: replace(rig, emergency=Emergency(udp=udp)), heart


def test_a_heart_that_presses_or_stops_is_an_emergency(heart_rig):
    with_heart, heart = heart_rig
    with emulated_rig() as (bus, rig, limits):
        rig = with_heart(rig)
        with beating(heart) as said, Controller(rig, calibration(), limits) as robot:
            robot.engage()
            hold_for(robot, [1.0, -1.0], 0.8)
            assert robot.state == "engaged" and heart.heard
            said["pressed"] = True
            assert_stopped(robot, bus)
            said["pressed"] = False
            until(lambda: not robot.report["emergency"], 2.0)
            again(robot)
            hold_for(robot, [0.5, 0.5], 0.3)
            heart.beat, beat = (lambda pressed: None), heart.beat  # the wire is cut
            assert_stopped(robot, bus)
            with pytest.raises(ServoError, match="denied .* emergency"):
                robot.request("acknowledge")
            heart.beat = beat
            until(lambda: not robot.report["emergency"], 3.0)
            again(robot)


def test_a_heart_that_was_recorded_or_has_another_key_starts_nothing(
    heart_rig, tmp_path, monkeypatch
):
    with_heart, heart = heart_rig
    monkeypatch.setattr(controller_module, "STARTS", 1.0)
    with emulated_rig() as (bus, rig, limits):
        rig = with_heart(rig)
        with beating(heart), Controller(rig, calibration(), limits):
            pass
        recorded = []
        send = heart._socket.send
        heart._session, heart._socket = (
            heart._session,
            type(
                "Tap",
                (),
                {
                    "send": lambda self, bytes_: recorded.append(bytes_) or send(bytes_),
                    "recv": heart._socket.recv,
                    "close": heart._socket.close,
                },
            )(),
        )
        with beating(heart), Controller(rig, calibration(), limits):
            time.sleep(0.2)
        assert len(recorded) > 5 and {len(beat) for beat in recorded} == {BEAT}

        class Replayer:
            def beat(self, pressed):
                with contextlib.suppress(ConnectionRefusedError):  # no program listens yet
                    send(recorded[-1])

        said = r"the emergency stop is pressed or dead \(no heartbeat at UDP port \d+ for 0.3 s\)"
        with beating(Replayer()), pytest.raises(ServoError, match=said):
            Controller(rig, calibration(), limits).__enter__()
        assert not torque(bus)
        other = new_key(tmp_path / "other.key")
        with Heart("127.0.0.1", rig.emergency.udp.port, other) as stranger, beating(stranger):
            with pytest.raises(ServoError, match="softmap servo heartbeat"):
                Controller(rig, calibration(), limits).__enter__()
            assert not stranger.heard


def test_a_stop_that_cannot_be_had_starts_nothing_and_says_why(tmp_path):
    with emulated_rig() as (bus, rig, limits):
        for stop, said in (
            (
                Emergency(gpio=Line("/dev/gpiochip999", 17)),
                "line 17 of /dev/gpiochip999 cannot be had .*gpioinfo",
            ),
            (Emergency(gpio=Line("/dev/null", 3)), "line 3 of /dev/null cannot be had"),
            (
                Emergency(udp=Beats(free_port(), str(tmp_path / "none.key"))),
                "the key cannot be read",
            ),
        ):
            with pytest.raises(ServoError, match=said):
                Controller(replace(rig, emergency=stop), calibration(), limits).__enter__()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.bind(("127.0.0.1", 0))
            new_key(tmp_path / "stop.key")
            taken = Beats(other.getsockname()[1], str(tmp_path / "stop.key"), host="127.0.0.1")
            with pytest.raises(ServoError, match="cannot be listened for at 127.0.0.1"):
                Controller(
                    replace(rig, emergency=Emergency(udp=taken)), calibration(), limits
                ).__enter__()
        assert not torque(bus)


def test_the_key_of_a_heart_is_in_no_recording(heart_rig, tmp_path):
    with_heart, heart = heart_rig
    key = read_key(tmp_path / "stop.key")
    with emulated_rig() as (_, rig, limits), beating(heart):
        record = tmp_path / "run.mcap"
        with Controller(with_heart(rig), calibration(), limits, record=record):
            pass
        content = record.read_bytes()
        assert (
            b"softmap.setup" in content and key not in content and key.hex().encode() not in content
        )


def test_the_command_beats_and_its_end_is_an_emergency(heart_rig, tmp_path):
    with_heart, _ = heart_rig
    with emulated_rig() as (bus, rig, limits):
        rig = with_heart(rig)
        code = "import sys; from softmap_edge.cli import main; sys.exit(main(sys.argv[1:]))"
        where = f"127.0.0.1:{rig.emergency.udp.port}"
        argv = [
            sys.executable,
            "-c",
            code,
            "servo",
            "heartbeat",
            where,
            "--key",
            str(tmp_path / "stop.key"),
            "--json",
        ]
        with subprocess.Popen(argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as verb:
            try:
                with Controller(rig, calibration(), limits) as robot:
                    robot.engage()
                    hold_for(robot, [1.0, 0.0], 0.5)
                    verb.stdin.write(b"press\n")
                    verb.stdin.flush()
                    assert_stopped(robot, bus)
                    verb.stdin.write(b"release\n")
                    verb.stdin.flush()
                    until(lambda: not robot.report["emergency"], 3.0)
                    again(robot)
                    verb.stdin.write(b"end\n")
                    verb.stdin.flush()
                    assert_stopped(robot, bus)
                assert (
                    b'"schema": "softmap.heartbeat/1"' in verb.stdout.read() and verb.wait(5) == 0
                )
            finally:
                verb.kill()


def test_rig_toml_carries_its_stops(tmp_path):
    with emulated_rig() as (_, rig, _):
        stops = Emergency(
            Line("/dev/gpiochip4", 22, True),
            Beats(5006, str(tmp_path / "stop.key"), 0.1, "10.0.0.2"),
        )
        replace(rig, emergency=stops).write(tmp_path / "rig.toml")
        assert read_rig(tmp_path / "rig.toml").emergency == stops
        text = (tmp_path / "rig.toml").read_text()
        for old, new, said in (
            ("line = 22", "line = 9999", "line = 9999, expected 0 to 511"),
            ("line = 22, ", "", "no line"),
            ("timeout = 0.1", "timeout = 60.0", "timeout = 60.0, expected 0.02 to 2"),
            ("port = 5006, ", "", "no port or no key_file"),
            ("active_low = true", "active_low = 1", "expected true or false"),
            ("gpio = ", "button = ", "no key 'button'"),
        ):
            assert old in text
            (tmp_path / "bad.toml").write_text(text.replace(old, new))
            with pytest.raises(ServoError, match=said):
                read_rig(tmp_path / "bad.toml")
        (tmp_path / "bad.toml").write_text(text.replace(str(tmp_path / "stop.key"), "stop.key"))
        assert read_rig(tmp_path / "bad.toml").emergency == stops, "beside the file"


def test_what_a_heart_cannot_reach_is_refused():
    with pytest.raises(
        LinkError, match=r"ports are 1 to 65535; .* \[emergency\] of the robot's rig.toml"
    ):
        Heart("127.0.0.1", 0, b"k" * 32)
    with pytest.raises(LinkError, match="cannot be reached"):
        Heart("no such host", 5, b"k" * 32)
    with pytest.raises(LinkError, match="the key cannot be read"):
        read_key("/nowhere")
    with Heart("127.0.0.1", free_port(), b"k" * 32) as heart:
        for _ in range(5):
            heart.beat()
        assert not heart.heard


def test_torque_off_drives_nothing_home():
    """Horns that no tendon pulls stay where the stop met them; a session without a stop goes
    home.
    """
    with emulated_rig(load=[]) as (bus, rig, limits):
        with Controller(rig, calibration(), limits) as robot:

            def there():
                robot.target([1.5, 1.5])
                return abs(angles(bus) - HOME - 1.5 * TICKS_PER_MM).max() < 15

            robot.engage()
            until(there, 20.0)
            before = angles(bus)
            robot.emergency()
            until(lambda: not torque(bus), 2.0)
            time.sleep(1.0)  # at half the slew home would be 0.4 s away
            assert abs(angles(bus) - before).max() < 15
            robot.emergency(False)
            again(robot)
            until(there, 20.0)
        assert abs(angles(bus) - HOME).max() <= AT_HOME
