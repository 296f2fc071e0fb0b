"""Hardware errors name the servo and the error in each line, and a servo that shut itself down is
restarted.
"""

import json
import re
import shlex

import pytest
from rigs import BAUD, calibration, emulated_rig, torque
from waiting import until

from softmap_edge.cli import main
from softmap_edge.errors import ServoError
from softmap_edge.robot import doctor
from softmap_edge.robot.commissioning import reboot
from softmap_edge.robot.commissioning.reboot import restart
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.servo import status_words as words
from softmap_edge.robot.servo.bus import opened
from softmap_edge.robot.servo.home_mark import marked
from softmap_edge.robot.servo.known_state import hardware, ways_out

ERRORS = {
    0x01: "input voltage",
    0x04: "overheating",
    0x08: "motor encoder",
    0x10: "electrical shock",
    0x20: "overload",
}
WAYS = {
    0x01: "check its supply voltage and cable",
    0x04: "let it cool down",
    0x08: "check its cable",
    0x10: "short circuit",
    0x20: "remove the load",
}


@pytest.mark.parametrize("bits", ERRORS)
def test_each_error_is_named_before_it_starts_and_restarted(bits, tmp_path, capsys):
    file = str(tmp_path / "rig.toml")
    with emulated_rig() as (bus, rig, limits):
        rig.write(file)
        bus.fail(1, bits)
        with pytest.raises(ServoError) as fault:
            Controller(rig, calibration(), limits).__enter__()
        line = str(fault.value)
        assert line.startswith(
            f"servo 2: it reports {ERRORS[bits]}; {ways_out(bits)}, then run `softmap servo reboot"
        )
        assert WAYS[bits] in line
        assert main(re.search(r"`softmap ([^`]+)`", line)[1].split()) == 0
        out = capsys.readouterr().out
        assert f"servo 2 was restarted: it reported {ERRORS[bits]} before, and no error now" in out
        assert "next: softmap servo home --rig FILE" in out
        with opened(rig.port, rig.baud) as port:
            assert marked(port, 1, rig.servos[0].home) and not marked(port, 2, rig.servos[1].home)
        with pytest.raises(ServoError, match="servo 2: not homed since power-up"):
            Controller(rig, calibration(), limits).__enter__()
        assert main(["servo", "home", "--rig", file, "--yes"]) == 0
        with Controller(rig, calibration(), limits) as robot:
            assert robot.state == "ready"


def test_an_error_while_it_drives_names_servo_error_and_the_way_on():
    with emulated_rig() as (bus, rig, limits):
        renamed = type(rig)(rig.port, rig.baud, rig.servos)
        with (
            pytest.raises(ServoError) as fault,
            Controller(renamed, calibration(), limits) as robot,
        ):
            robot.engage([0.2, 0.0])
            bus.fail(1, 0x24)
            until(lambda: robot.state == "fault")
            assert "servo 2 reports a hardware error: overheating, overload" in words.sentence(
                robot.report
            )
            with pytest.raises(
                ServoError, match="servo 2 reports a hardware error: overheating, overload"
            ):
                robot.target([0.2, 0.0])
            robot.request("acknowledge")
        assert "servo 2 reports a hardware error" in str(fault.value)
        assert "`softmap servo reboot --rig FILE --id 2`" in str(fault.value) and not torque(bus)


def test_what_is_denied_for_an_error_names_it():
    report = {"hardware": [0, 0x10], "ids": [7, 3], "state": "off"}
    said = words.denied("trouble(hardware)", report)
    assert (
        "servo 3 reports a hardware error: electrical shock" in said
        and "servo reboot --rig FILE --id 3" in said
    )
    assert words.denied("trouble(hardware)").endswith("a servo reports a hardware error")
    assert words.cause({"cause": "following", "servo": 0, "id": 7}).startswith(
        "servo 7 does not follow"
    )
    assert words.cause({"cause": "following", "servo": 0, "id": 0}).startswith(
        "servo 0 does not follow"
    )
    fault = {"state": "fault", "cause": "hardware", "hardware": [0x20, None], "ids": [7, 3]}
    assert words.where(fault) == "in state fault (servo 7 reports a hardware error: overload)"
    assert "servo reboot --rig FILE --id 7" in words.onward(fault) and "servo home" in words.onward(
        fault
    )
    assert "servo reboot --rig FILE --id 7" in words.lost(fault, "")
    assert hardware(0x42) == "error 0x42" and hardware(0x60) == "overload, error 0x40"


def test_nothing_is_restarted_while_a_loop_drives(tmp_path, capsys):
    file = str(tmp_path / "rig.toml")
    with emulated_rig() as (bus, rig, limits):
        rig.write(file)
        with Controller(rig, calibration(), limits) as robot:
            robot.engage([0.2, 0.0])
            assert main(["servo", "reboot", "--rig", file, "--id", "1"]) == 2
            assert "is in use by another program" in capsys.readouterr().err
            assert robot.state in ("engaged", "hold") and torque(bus), "a busy computer is late"


@pytest.mark.parametrize("bits", WAYS)
def test_a_cause_that_stays_is_named_with_its_remedy(bits, monkeypatch):
    with emulated_rig() as (bus, rig, _):
        bus.fail(0, bits)
        monkeypatch.setattr(reboot, "_rebooted", lambda bus, id: None)
        with pytest.raises(ServoError) as fault:
            restart(rig.port, rig.baud, 1)
        said = str(fault.value)
        assert said.startswith(f"servo 1 was restarted and still reports {ERRORS[bits]}; ")
        assert WAYS[bits] in said and "run the same command again" in said


def test_torque_goes_off_first(tmp_path, capsys):
    file = str(tmp_path / "rig.toml")
    with emulated_rig() as (bus, rig, _):
        rig.write(file)
        with opened(rig.port, rig.baud) as port:
            port.write(2, 64, b"\x01")
        assert torque(bus)
        assert main(["servo", "reboot", "--rig", file, "--id", "1", "--json"]) == 0
        document = json.loads(capsys.readouterr().out)
        assert document == {
            "schema": "softmap.restarted/1", "port": bus.path, "baud": BAUD, "id": 1, "reported": ""
        }  # fmt: skip
        assert not torque(bus)


@pytest.mark.parametrize(
    "argv, said",
    [
        (["--id", "9"], "the rig has no servo 9; it has 1, 2"),
        (["--id", "300"], "--id 300; allowed are 0 to 252"),
        (["--id", "-1"], "--id -1; allowed are 0 to 252"),
    ],
)
def test_what_is_no_servo_of_the_rig_is_refused(tmp_path, capsys, argv, said):
    with emulated_rig() as (_, rig, _):
        rig.write(tmp_path / "rig.toml")
        assert main(["servo", "reboot", "--rig", str(tmp_path / "rig.toml"), *argv]) == 2
        assert said in capsys.readouterr().err


def test_a_servo_that_is_not_there_is_not_restarted():
    with emulated_rig() as (bus, rig, _):
        bus.damage(0, mute=True)
        with pytest.raises(ServoError, match="servo 1: no answer"):
            restart(rig.port, rig.baud, 1)
        with pytest.raises(ServoError, match="servo 1: it answers at 1000000 baud, not at 57600"):
            bus.damage(0, mute=False)
            restart(rig.port, 57_600, 1)


def test_the_doctor_names_the_restart(tmp_path):
    with emulated_rig() as (bus, rig, _):
        rig.write(tmp_path / "rig.toml")
        bus.fail(0, 0x21)
        lines = [
            one for one in doctor.examine(rig=tmp_path / "rig.toml").lines if one.name == "servo 1"
        ]
        assert [one.found for one in lines] == ["it reports input voltage, overload"]
        assert "softmap servo reboot" in lines[0].do and "supply off and on" in lines[0].do


FEW = [
    pytest.param(bits, marks=pytest.mark.long) if k % 2 else bits for k, bits in enumerate(ERRORS)
]


@pytest.mark.parametrize("bits", FEW)
def test_every_command_that_reads_servos_names_servo_error_and_restart(bits, tmp_path, capsys):
    file = str(tmp_path / "rig.toml")
    with emulated_rig() as (bus, rig, _):
        rig.write(file)
        bus.fail(1, bits)
        at = ["--port", bus.path, "--baud", str(BAUD)]
        jog = ["--servo", "1", "--by", "50", "--hold"]
        for words, code in (
            (["scan", "--rig", file], 1),
            (["scan", *at], 1),
            (["read", "--rig", file], 1),
            (["read", *at], 1),
            (["doctor", "--rig", file], 1),
            (["move", "--rig", file, *jog], 2),
            (["home", "--rig", file, "--yes"], 2),
            (["setup", *at, "--id", "2"], 2),
        ):
            capsys.readouterr()
            assert main(["servo", *words]) == code, words
            said = " ".join(capsys.readouterr())
            assert re.search(f"(servo|id) 2.*reports {ERRORS[bits]}", said, re.S), (words, said)
            assert f"`softmap servo reboot --port {bus.path} --baud {BAUD} --id 2" in said, words
            assert "id 1`" not in said and "servo 1 reports" not in said
        assert main(["servo", "scan", *at, "--json"]) == 1
        (remark,) = json.loads(capsys.readouterr().out)["remarks"]
        assert remark.startswith(f"servo 2 reports {ERRORS[bits]}; {ways_out(bits)}, then")
        assert main(shlex.split(re.search(r"`softmap ([^`]+)`", remark)[1])) == 0
        capsys.readouterr()
        assert main(["servo", "scan", *at]) == 0 and "reports" not in capsys.readouterr().out


def test_errors_of_several_servos_are_named_each(capsys):
    with emulated_rig() as (bus, _, _):
        bus.fail(0, 0x24)
        bus.fail(1, 0x41)
        assert main(["servo", "scan", "--port", bus.path, "--baud", str(BAUD)]) == 1
        out = capsys.readouterr().out
        assert "! servo 1 reports overheating, overload; " in out
        assert "! servo 2 reports input voltage, error 0x40; " in out and "next:" not in out
