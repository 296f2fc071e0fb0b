"""The key that is the emergency stop of `track`, `record` and `move`, typed at a terminal next to
an emulated robot.
"""

import os
import pty
import subprocess
import sys
import termios
import threading
from dataclasses import replace

import numpy as np
import pytest
from command import SOFTMAP
from rigs import torque
from typist import PATIENCE, typist

from softmap_edge import builtin_model, save_bundle
from softmap_edge.commands.robot import own_map
from softmap_edge.commands.servo.emulate import streaming
from softmap_edge.experiment.blocks import chosen, plan
from softmap_edge.robot.control.emergency_key import HELP, PRESSED
from softmap_edge.robot.control.recording import read_recording
from softmap_edge.robot.drive.command_file import write_commands
from softmap_edge.robot.emulated.finger import emulated_robot
from softmap_edge.robot.link.points import PointSender
from softmap_edge.run.protocol import Limits

AWAY = 120.0  # ticks from home: it is driven
CAMERA = 5991


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """Give an emulated bus and the folder with its rig, bundle and commands; its camera sends to
    CAMERA.
    """
    folder, model = tmp_path_factory.mktemp("robot"), builtin_model()
    model = replace(model, calibration=own_map(model))
    save_bundle(model, folder / "finger")
    write_commands(
        folder / "commands.csv", plan(chosen(["circle"]), Limits.even(2, 3.0)), model.robot
    )
    with (
        emulated_robot(model, model.calibration, rate=100.0) as (bus, rig, _, finger),
        PointSender("127.0.0.1", CAMERA) as sender,
        streaming(finger, [sender]),
    ):
        rig.write(folder / "rig.toml")
        yield bus, rig, folder


def driven(bus, rig):
    """Return whether a servo has torque and stands away from home."""
    angles = np.array([angle for angle, *_ in bus.state()[1]])
    return torque(bus) and np.abs(angles - [servo.home for servo in rig.servos]).max() > AWAY


ON = ["--rig", "rig.toml", "--bundle", "finger"]
DRIVES = {
    "track": ["track", "O", *ON, "--amplitude", "4", "--duration", "30", "--record", "track.mcap"],
    "record": [
        "record",
        "commands.csv",
        *ON,
        "--camera",
        f"udp://:{CAMERA}",
        "--out",
        "run.npz",
        "--record",
        "record.mcap",
    ],
    "move": ["servo", "move", "2,-1", *ON, "--hold", "--seconds", "100"],
    "jog by keys": ["servo", "move", "--rig", "rig.toml"],
    "jog by ticks": ["servo", "move", "--rig", "rig.toml", "--servo", "1", "--by", "290", "--hold"],
}


@pytest.mark.parametrize("verb", DRIVES)
def test_the_key_switches_torque_off_at_once(robot, verb):
    bus, rig, folder = robot
    with typist(folder, *DRIVES[verb]) as one:
        if verb == "record":  # a line is read from the same terminal
            one.until(lambda: "Press Enter when it is so" in one.said)
            one.types("e, not yet\n")
        one.until(lambda: "is the emergency stop" in one.said)
        if verb == "jog by keys":
            one.until(lambda: "connected" in one.said)
            holds = threading.Event()
            held = threading.Thread(
                target=lambda: [one.types("\x1b[C") for _ in iter(lambda: holds.wait(0.03), True)]
            )
            held.start()
        one.until(lambda: driven(bus, rig))
        if verb == "jog by keys":
            holds.set()
            held.join()
        one.types("e")
        one.until(lambda: not torque(bus))
        assert one.ends() == 2 and PRESSED in one.said
        assert termios.tcgetattr(one.theirs) == one.before, "the terminal is as it was"
    file = folder / f"{verb}.mcap"
    if file.exists():
        periods = read_recording(file).periods
        states = list(
            dict.fromkeys((one["state"], one["cause"]) for one in periods if one["emergency"])
        )
        assert states == [("fault", "emergency")], (
            "never slackened: off in the first period that knows"
        )
    if verb == "record":
        assert (
            not (folder / "run.npz").exists()
            or "what was recorded before is in run.npz" in one.said
        )


def test_without_a_terminal_nothing_is_reported_of_the_key(robot):
    bus, _, folder = robot
    words = ["servo", "move", "1,-1", *ON, "--hold", "--seconds", "0.5"]
    done = subprocess.run(
        [SOFTMAP, *words], cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    others = [line for line in done.stderr.splitlines() if "were lost; look at" not in line]
    assert done.returncode == 0 and not others, "answers are lost on a busy computer, no more"
    assert not torque(bus)


def test_another_key_does_nothing(robot):
    bus, _, folder = robot
    with typist(folder, "move", "1,-1", *ON, "--hold", "--seconds", "1") as one:
        one.until(lambda: HELP in one.said)
        one.types("x \x1b[15~q")
        assert one.ends() == 0
    assert not torque(bus)


def test_in_the_background_the_terminal_is_not_read():
    """A program that reads or sets its terminal from the background is stopped by the system."""
    code = """if True:
        import fcntl, os, sys, termios
        os.setsid()
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)
        from softmap_edge.robot.servo.terminal import terminal
        front = terminal()
        if os.fork() == 0:
            os.setpgid(0, 0)
            print(front, terminal(), flush=True)
            os._exit(0)
        os.wait()
    """
    ours, theirs = pty.openpty()
    done = subprocess.run(
        [sys.executable, "-c", code], stdin=theirs, capture_output=True, text=True, timeout=PATIENCE
    )
    os.close(ours)
    os.close(theirs)
    assert done.stdout == "0 None\n", done.stderr
