"""Another program that has the port open without a lock is named by whatever opens the port, but
torque goes off.
"""

import subprocess
import sys
import time

import pytest
from other_program import holding, talking
from rigs import BAUD, calibration, emulated_rig, torque

from softmap_edge import _core
from softmap_edge.cli import main
from softmap_edge.errors import ServoError
from softmap_edge.robot import doctor
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.control.recording import read_recording
from softmap_edge.robot.servo.bus import opened
from softmap_edge.robot.servo.holders import holders


def test_a_program_that_takes_no_lock_is_named_by_all_that_open_the_port(tmp_path, capsys):
    file = str(tmp_path / "rig.toml")
    with emulated_rig() as (bus, rig, limits):
        rig.write(file)
        with holding(bus.path) as other:
            (one,) = holders(bus.path)
            assert one.pid == other.pid and one.name.startswith("python")
            said = (
                f"{bus.path} is in use by another program ({one.name}, pid {other.pid}); close it "
                "first"
            )
            with pytest.raises(ServoError) as fault:
                Controller(rig, calibration(), limits).__enter__()
            assert str(fault.value) == said
            where = ["--port", bus.path, "--baud", str(BAUD)]
            for argv in (
                ["servo", "scan", *where],
                ["servo", "read", *where],
                ["servo", "setup", *where, "--id", "1"],
                ["servo", "reboot", *where, "--id", "1"],
                ["servo", "home", "--rig", file, "--yes"],
                ["servo", "move", "--rig", file, "--servo", "1", "--by", "50", "--hold"],
            ):
                assert main(argv) == 2, argv
                assert said in capsys.readouterr().err
            lines = [line for line in doctor.examine(rig=file).lines if line.name == "bus"]
            assert (
                lines[0].found == said.removesuffix("; close it first")
                and lines[0].do == "close it first"
            )
            assert main(["servo", "off", "--rig", file]) == 0, "torque goes off whoever is there"
        with Controller(rig, calibration(), limits) as robot:
            assert robot.state == "ready", "once it is closed"


def test_a_program_that_opens_by_another_name_is_found_and_others_are_not(tmp_path):
    with emulated_rig() as (bus, _, _):
        link = tmp_path / "usb-adapter"
        link.symlink_to(bus.path)
        assert holders(bus.path) == [], "the program that emulates is none, nor is this one"
        with holding(str(link)) as other:
            assert (
                [one.pid for one in holders(bus.path)]
                == [one.pid for one in holders(str(link))]
                == [other.pid]
            )
        with emulated_rig() as (second, _, _), holding(second.path):
            assert holders(bus.path) == [], "another terminal is another port"
        (tmp_path / "plain").touch()
        with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as reads:
            assert holders(str(tmp_path / "plain")) == holders(str(tmp_path / "none")) == []
            reads.communicate(b"\n")


def test_a_name_is_shown_without_what_a_terminal_obeys(tmp_path):
    with emulated_rig() as (bus, _, _):
        proc = tmp_path / "4242"
        (proc / "fd").mkdir(parents=True)
        (proc / "fd" / "3").symlink_to(bus.path)
        (proc / "comm").write_bytes(b"\x1b[31mred\x07\xff\n")
        (tmp_path / "17").mkdir()  # one that may not be looked at
        (one,) = holders(bus.path, tmp_path)
        assert one.pid == 4242 and "\x1b" not in str(one) and "red" in one.name
        (proc / "comm").unlink()
        assert holders(bus.path, tmp_path)[0].name == "unnamed"
        assert holders(bus.path, tmp_path / "none") == []


def test_answers_that_nothing_asked_for_are_counted_and_recorded(tmp_path):
    file, reported = tmp_path / "drive.mcap", []
    goal = _core.servo_registers()["led"][0]
    with emulated_rig() as (bus, rig, limits):
        with Controller(rig, calibration(), limits, record=file, tell=reported.append) as robot:
            robot.engage([0.2, 0.0])
            with talking(bus.path, goal, b"\x00"):
                for _ in range(40):
                    robot.target([0.2, 0.0])
                    time.sleep(0.02)
            counts = robot.bus
        assert counts["unasked"] > 5 and counts["asked"] > 50, counts
        assert any("answers came that this program did not ask for" in line for line in reported), (
            reported
        )
        last = read_recording(file).bus
        assert last["unasked"] >= counts["unasked"] and last["lost"] >= counts["lost"]


def test_alone_on_the_bus_nothing_is_reported(tmp_path):
    file, reported = tmp_path / "drive.mcap", []
    with (
        emulated_rig() as (bus, rig, limits),
        Controller(rig, calibration(), limits, record=file, tell=reported.append) as robot,
    ):
        robot.engage([0.2, 0.0])
        for _ in range(20):
            robot.target([0.2, 0.0])
            time.sleep(0.02)
    assert not torque(bus) and not [line for line in reported if "did not ask" in line]
    assert read_recording(file).bus["unasked"] == 0


def test_a_late_answer_is_none_that_nothing_asked_for():
    with emulated_rig() as (bus, rig, _):
        bus.faults(slow=0.15)
        with opened(rig.port, rig.baud) as port:
            assert port.ping(1) is None
            bus.faults()
            time.sleep(0.3)
            assert port.ping(1) is not None
            counts = port.counts()
        assert counts["late"] > 0 and counts["unasked"] == 0, counts
