"""A busy computer is no broken robot: simulated servos wait for it, and what they do does not
depend on load.
"""

import contextlib
import json
import os
import pty
import re
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from command import SOFTMAP
from driving import MODEL, Fingers
from rigs import calibration

from softmap_edge.errors import ServoError
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.control.recording import read_recording
from softmap_edge.robot.drive.command_file import write_commands
from softmap_edge.robot.emulated.finger import emulated_robot
from softmap_edge.robot.motion.kinematics import Kinematics
from softmap_edge.robot.servo import clock
from softmap_edge.robot.servo.clock import BUSY
from softmap_edge.robot.teleop.busy import Busy
from softmap_edge.robot.teleop.drive import Drive
from softmap_edge.robot.teleop.hand_source import NullHandSource
from softmap_edge.robot.teleop.mapping import DirectMapping
from softmap_edge.run.protocol import Protocol

BROKEN = re.compile(
    r"servo \d|silent|unplugged|without power|home the robot|servo home|watchdog|FAULT|Fault,"
)
TRACK = [
    "track",
    "S",
    "--amplitude",
    "4",
    "--duration",
    "3",
    "--rate",
    "20",
    "--hide",
    "backlash",
    "--json",
]


@contextlib.contextmanager
def load(processes=4):
    """Keep the computer busy, as long as this process lives."""
    code = f"import os\nwhile os.getppid() == {os.getpid()}: sum(range(100_000))"
    spin = [subprocess.Popen([sys.executable, "-c", code]) for _ in range(processes)]
    try:
        yield
    finally:
        for one in spin:
            one.kill()
            one.wait()


@contextlib.contextmanager
def driven(time="stepped", record=None):
    """Give a simulated robot that is entered."""
    with (
        emulated_robot(MODEL, calibration(), rate=100.0, time=time) as (bus, rig, limits, finger),
        Controller(
            rig, calibration(), limits, kinematics=Kinematics(MODEL), record=record
        ) as robot,
    ):
        yield bus, robot, finger


def waved(folder, name, disturb=lambda robot, k: None):
    """Wave a simulated finger for 2 s; returns all that the loop recorded, what was seen, and the
    last report.
    """
    file = folder / f"{name}.mcap"
    with driven(record=file) as (_, robot, finger):
        robot.engage()
        for k in range(100):
            disturb(robot, k)
            robot.target([2.0 * np.sin(0.06 * k), 0.01 * k])
            robot.time.sleep(0.02)
        report, seen = robot.report, finger.seen()
    return read_recording(file).periods, seen, report


def test_the_same_program_gives_the_same_to_the_last_bit_however_it_is_held_up(tmp_path):
    def freeze(robot, k):
        if k in (10, 60):
            os.kill(robot._process.pid, signal.SIGSTOP)
            threading.Timer(0.5, os.kill, (robot._process.pid, signal.SIGCONT)).start()
        elif k in (30, 80):
            time.sleep(0.7)  # the program itself

    periods, seen, report = waved(tmp_path, "free")
    with load(2):
        again, saw, reported = waved(tmp_path, "held up", freeze)
    assert len(periods) > 200 and len(periods) == len(again)
    assert all(one == other for one, other in zip(periods, again)) and report == reported
    assert len(seen) > 50 and len(seen) == len(saw)
    for one, other in zip(seen, saw):
        assert (
            one.stamp == other.stamp
            and one.arrived == other.arrived
            and (one.points == other.points).all()
        )


def test_stepped_time_is_no_slower_than_it_must_be(tmp_path):
    begun = time.monotonic()
    with driven() as (_, robot, _):
        robot.engage()
        before, real = robot.time.now(), time.monotonic()
        for _ in range(400):
            robot.target([0.0, 0.0])
            robot.time.sleep(0.02)
        assert robot.time.now() == pytest.approx(before + 8.0, abs=1e-6)
        assert robot.state == "engaged"
    assert time.monotonic() - real < 8.0 or os.getloadavg()[0] > 2 or time.monotonic() - begun > 30


def test_a_program_that_stops_sending_releases_in_stepped_time_as_on_a_robot():
    with driven() as (_, robot, _):
        robot.engage()
        robot.time.sleep(1.0)
        assert robot.state == "hold" and robot.report["cause"] in ("stale", "deadman")
        with pytest.raises(ServoError, match="sent no target for 8.0 s"):
            robot.time.sleep(7.0)
            robot.target([0.0, 0.0])


def test_a_servo_that_is_broken_is_named_in_simulated_time_too():
    for pace in ("stepped", "paced"):
        with contextlib.suppress(ServoError), driven(pace) as (bus, robot, _):
            robot.engage()
            bus.damage(1, mute=True)
            with pytest.raises(ServoError, match="servo 2 is silent"):
                for _ in range(300):
                    robot.target([0.0, 0.0])
                    robot.time.sleep(0.02)


def test_a_loop_that_is_killed_is_reported_in_stepped_time():
    with (
        pytest.raises(ServoError, match="the control loop died or froze"),
        driven() as (_, robot, _),
    ):
        robot.engage()
        robot._process.kill()
        robot._process.wait()
        for _ in range(300):
            robot.target([0.0, 0.0])
            robot.time.sleep(0.02)


def test_a_loop_that_hangs_ends_with_one_clear_error(monkeypatch):
    monkeypatch.setattr(clock, "STUCK", 1.5)
    said = f"{BUSY}: the simulated robot did not move for 1.5 s; start again"
    with pytest.raises(ServoError, match=said), driven() as (_, robot, _):
        robot.engage()
        os.kill(robot._process.pid, signal.SIGSTOP)
        for _ in range(100):
            robot.target([0.0, 0.0])
            robot.time.sleep(0.02)


def test_a_person_who_drives_goes_on_after_the_computer_was_busy():
    """The loop stands, then the program: in either case the robot stands, says so, and goes on by
    itself.
    """
    fingers, lines, moments, hold = Fingers("knob"), [], [], []

    def show(moment):
        moments[:] = [moment]
        if hold:
            time.sleep(hold.pop())

    def until(what):
        begun = time.monotonic()
        while not what():
            assert time.monotonic() - begun < 30, lines
            time.sleep(0.01)

    with driven("paced") as (bus, robot, _), NullHandSource() as eyes:
        kinematics = Kinematics(MODEL)
        drive = Drive(
            robot,
            kinematics,
            DirectMapping(kinematics),
            eyes,
            [fingers],
            say=lines.append,
            show=show,
        )
        thread = threading.Thread(target=drive.run, daemon=True)
        thread.start()
        until(lambda: moments)
        fingers.held = True
        until(lambda: moments[0].report.get("state") == "engaged")
        os.kill(robot._process.pid, signal.SIGSTOP)
        time.sleep(1.5)
        os.kill(robot._process.pid, signal.SIGCONT)
        until(lambda: any(line.startswith(BUSY) for line in lines) and moments[0].busy == BUSY)
        hold.append(1.2)
        time.sleep(2.0)
        fingers.knob = (0.1, 0.0)
        until(lambda: abs(bus.state()[1][0][0] - calibration().home[0]) > 100)
        assert moments[0].clutch.stage == "driving"
        fingers.wish.ask("end")
        thread.join(20)
    account = drive.account
    assert account.busy_s > 2.0 and account.presses == 1 and not account.lost
    assert set(account.states) <= {"ready", "engaged", "safe_stop"}, account.states
    assert not [line for line in lines if BROKEN.search(line)], lines


class Clocked:
    """A clock that says how long the computer was too busy."""

    simulated, lost = True, 0.0

    def there(self, driving=True):
        return self.lost


def test_what_a_busy_computer_took_is_reported_now_and_then_and_excused():
    said, time_ = [], Clocked()
    busy = Busy(time_, said.append)
    for k in range(10):
        busy.round(0.01 * k)
    busy.round(1.09)  # one second later than it should be
    assert busy.age(0.05, 1.10) == pytest.approx(0.05) and busy.age(1.05, 1.10) == pytest.approx(
        0.01, abs=0.01
    )
    for k, lost in enumerate((0.1, 0.4, 0.9, 0.9, 2.0)):
        time_.lost = lost
        busy.round(2.0 + 2 * k)
        assert busy.line(2.5 + 2 * k) == ("" if k == 3 else BUSY) and not busy.line(3.5 + 2 * k)
    assert said == [
        f"{BUSY}: the simulated robot stood still for {s} s, and goes on" for s in ("0.4", "1.6")
    ]
    Clocked.simulated = False
    real = Busy(Clocked(), said.append)
    real.round(0.0)
    real.round(9.0)
    assert real.age(0.0, 9.0) == 9.0, "on real servos nothing is excused"
    Clocked.simulated = True


def session(argv):
    """Run a session at a terminal whose Space is held from its third second on; returns its
    document.

    It has named no broken servo.
    """
    here, there = pty.openpty()
    done = threading.Event()

    def hold():
        while not done.wait(0.03):
            os.write(here, b" ")

    process = subprocess.Popen(
        [SOFTMAP, *argv], stdin=there, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    holding = threading.Timer(3.0, hold)
    holding.start()
    try:
        out, err = process.communicate(timeout=400)
    finally:
        process.kill()
        done.set()
        holding.cancel()
        holding.join()
        os.close(here)
        os.close(there)
    assert process.returncode == 0 and not BROKEN.search(err), (argv, out, err)
    return json.loads(out)


@pytest.mark.prove  # busy processes starve the real-time tests of other workers
def test_a_session_on_a_busy_computer_gives_what_it_gives_on_a_free_one():
    free = session([*TRACK, "--sim"])
    with load():
        busy = session([*TRACK, "--sim"])
    assert busy == free and free["seen_mm"]["n"] > 60


@pytest.mark.prove  # busy processes starve the real-time tests of other workers
def test_a_run_that_is_recorded_on_a_busy_computer_is_the_same_run(tmp_path):
    t = np.arange(0.0, 2.0, 0.02)
    u = np.stack([1.5 * np.sin(2.0 * t), 0.5 * t], axis=1)
    looks = t[10:-10:8]
    made = Protocol(
        "short", t, u, np.tile([0.0, 0.0, 1.0], (len(t), 1)), looks, np.full(len(looks), "move")
    )
    write_commands(tmp_path / "short.csv", made, MODEL.robot)
    argv = [
        "record",
        str(tmp_path / "short.csv"),
        "--emulated",
        "--hide",
        "creep",
        "--json",
        "--out",
    ]
    free = session([*argv, str(tmp_path / "free.npz")])
    with load():
        busy = session([*argv, str(tmp_path / "busy.npz")])
    assert free["whole"] and free["frames"] == len(looks) and free["hash"] == busy["hash"]


@pytest.mark.prove
@pytest.mark.parametrize("k", range(12))
def test_twelve_sessions_in_a_row_on_a_busy_computer_break_no_servo(k):
    with load():
        if k % 3 == 2:
            printed = session(["teleop", "--sim", "--page", "none", "--seconds", "10", "--json"])
            assert "fault" not in printed["states_s"] and printed["presses"] >= 1
        else:
            assert session([*TRACK, "--sim"])["seen_mm"]["n"] > 60
