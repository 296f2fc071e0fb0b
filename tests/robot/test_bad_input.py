"""Bad input: each row of the table in docs/reference/safety.md, with its message and the state that
the loop reports.
"""

import io
import json
import os
import re
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bad_inputs import TABLE
from driving import PICTURE, Session, hand
from ordinary_user import as_ordinary_user
from rigs import HOME, NUMBER, TICKS_PER_MM, angles, calibration, emulated_rig, torque

from softmap_edge import _core, builtin_model, save_bundle
from softmap_edge.cli import main
from softmap_edge.errors import ServoError
from softmap_edge.robot.control import loop_process as loop
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.servo.home_mark import set_mark
from softmap_edge.robot.servo.rig import RigServo
from softmap_edge.robot.teleop.frames import CameraFrames

PATIENCE = 10.0  # s, on a busy machine


def starts(rig, limits):
    """Start the loop on a rig that it must refuse; the line, and where the guard stands by its
    reports.
    """
    robot = Controller(rig, calibration(), limits)
    with pytest.raises(ServoError) as fault:
        robot.__enter__()
    return str(fault.value), [robot.report.get("state", "off")]


def wrong_port(bus, rig, limits):
    return starts(replace(rig, port="/dev/ttyNONE"), limits)


def busy_port(bus, rig, limits):
    os.chmod(bus.path, 0o666)
    first = _core.ServoBus(bus.path, rig.baud)
    line, states = starts(rig, limits)
    assert as_ordinary_user(lambda: program(rig, limits)) == line, (
        "nor does an ordinary user get it"
    )
    first.close()
    return line, states


def no_permission(bus, rig, limits):
    os.chmod(bus.path, 0o000)
    return as_ordinary_user(lambda: program(rig, limits)), ["off"]


def program(rig, limits):
    """Run the loop's own program here, as the user of this process; raises what it reports instead
    of a state.
    """
    calibrated = calibration()
    setup = dict(
        port=rig.port,
        baud=rig.baud,
        servos=rig.numbers,
        homes=[HOME, HOME],
        limits=limits,
        gpio=None,
    )
    setup |= dict(slope=calibrated.A.ravel().tolist(), b=[0.0, 0.0], home=[HOME, HOME])
    (orders, _), (said, reports) = os.pipe(), os.pipe()
    sys.stdin = io.StringIO(json.dumps(setup | dict(heartbeat=None)))
    sys.argv = ["loop", str(orders), str(reports)]
    assert loop.main() == 1
    report = json.loads(os.read(said, 10_000))
    assert "state" not in report
    raise ServoError(report["error"])


def wrong_baud(bus, rig, limits):
    return starts(replace(rig, baud=57_600), limits)


def wrong_model(bus, rig, limits):
    return starts(replace(rig, servos=(RigServo(1, "XM430-W210", HOME), rig.servos[1])), limits)


def torque_on(bus, rig, limits):
    ours = _core.ServoBus(bus.path, rig.baud)
    ours.write(2, 64, b"\x01")
    ours.close()
    found = starts(rig, limits)
    assert bus.state()[1][1][1], "it is left as it was found"
    ours = _core.ServoBus(bus.path, rig.baud)
    ours.write(2, 64, b"\x00")
    ours.close()
    return found


def missing_home(bus, rig, limits):
    return starts(replace(rig, servos=(replace(rig.servos[0], home=None), rig.servos[1])), limits)


def lost_before(bus, rig, limits):
    ours = _core.ServoBus(bus.path, rig.baud)
    set_mark(ours, 1, None)  # as power-up clears it
    ours.close()
    return starts(rig, limits)


def lost_while(bus, rig, limits):
    with Controller(rig, calibration(), limits) as robot:
        robot.engage([0.5, 0.0])
        bus.lose_turn(0)
        end = time.monotonic() + PATIENCE
        with pytest.raises(ServoError) as fault:
            while time.monotonic() < end:
                robot.target([0.5, 0.0])
                time.sleep(0.02)
        assert not torque(bus)
        return str(fault.value), [robot.state]


STARTS = {
    "wrong port": wrong_port,
    "busy port": busy_port,
    "no permission": no_permission,
    "wrong baud": wrong_baud,
    "wrong model": wrong_model,
    "torque already on": torque_on,
    "missing home": missing_home,
    "lost turns, before it starts": lost_before,
    "lost turns, while it drives": lost_while,
}


@pytest.mark.parametrize("name", STARTS)
def test_a_rig_that_is_not_as_it_must_be(name):
    line, states = TABLE[name]
    with emulated_rig() as (bus, rig, limits):
        assert NUMBER == 1200
        said, found = STARTS[name](bus, rig, limits)
        assert re.fullmatch(line, said), said
        assert found == states and not torque(bus)


@pytest.mark.parametrize("verb", ["track", "servo move", "teleop"])
def test_a_damaged_bundle(verb, tmp_path, monkeypatch, capsys):
    line, states = TABLE["damaged bundle"]
    monkeypatch.chdir(tmp_path)
    save_bundle(replace(builtin_model(), calibration=calibration()), "finger")
    data = bytearray(Path("finger/prior.npz").read_bytes())
    data[len(data) // 2] ^= 0xFF
    Path("finger/prior.npz").write_bytes(data)
    words = {
        "track": ["track", "O"],
        "servo move": ["servo", "move", "1,1", "--hold"],
        "teleop": ["teleop", "--page", "none"],
    }[verb]
    with emulated_rig() as (bus, rig, limits):
        rig.write("rig.toml")
        assert main([*words, "--rig", "rig.toml", "--bundle", "finger"]) == 2
        assert re.fullmatch(f"softmap {verb}: {line}\n", capsys.readouterr().err)
        assert states == ["off"] and not torque(bus)
        with Controller(rig, calibration(), limits) as robot:
            assert robot.state == "ready", "no loop has the port: another one can be started"


class Unplugged(Session):
    """Driven by the pictures of a camera whose device goes."""

    def cameras(self):
        self.there = True
        return CameraFrames(0, device=self)

    def read(self):
        time.sleep(1 / 60)
        return self.there, PICTURE

    def release(self):
        pass


def camera_gone(s):
    s.there = False


def hand_gone(s):
    s.finder.hands = []


def no_numbers(s):
    broken = hand()
    # what a `Hand` of one's own making refuses
    object.__setattr__(broken, "points", np.full((21, 2), np.nan))
    s.finder.hands = [broken]


DRIVEN = {
    "camera gone, driving by hand": camera_gone,
    "hand gone": hand_gone,
    "NaN landmarks": no_numbers,
}


@pytest.mark.parametrize("name", DRIVEN)
def test_what_goes_while_a_hand_drives(name):
    line, states = TABLE[name]
    with Unplugged(options={"stays": True}).running() as s:
        s.presses()
        s.finder.hands = [hand(aside=0.35 / 8)]
        s.until(lambda: angles(s.bus)[0] > HOME + TICKS_PER_MM)
        DRIVEN[name](s)
        s.until(lambda: s.robot.state == "ready" and not torque(s.bus))
        assert any(re.fullmatch(f".*; {line}", said) for said in s.lines), s.lines
        passed = [state for state in s.drive.account.states if state in ("hold", "safe_stop")]
        assert [*passed, s.robot.state] == states
        assert angles(s.bus)[0] < HOME + TICKS_PER_MM, "it slackened"


def test_each_row_of_the_table_is_driven():
    """Recording without a camera is driven by tests/robot/test_record_robot.py, which reads its
    row.
    """
    assert sorted(TABLE) == sorted([*STARTS, *DRIVEN, "damaged bundle", "camera gone, recording"])
