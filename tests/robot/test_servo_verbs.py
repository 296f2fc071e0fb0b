"""Servos found, set up, read and released from the command line, on an emulated bus; a recording
decided again.
"""

import io
import json
import os
import re
import subprocess
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from command import SOFTMAP
from rigs import calibration, emulated_rig, torque

from softmap_edge import _core
from softmap_edge.cli import main
from softmap_edge.commands.robot import HOME
from softmap_edge.commands.servo import emulate as servo_emulate
from softmap_edge.errors import ServoError
from softmap_edge.robot.commissioning import setup
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.control.recording import read_recording
from softmap_edge.robot.servo.bus import opened, ports
from softmap_edge.robot.servo.rig import RigServo, read_rig
from softmap_edge.run.run import Run

XL330, XL430 = 1200, 1060


@pytest.fixture
def fresh():
    """Give a bus with one servo as it is delivered: id 1 at 57 600 baud, mode 3."""
    bus = _core.EmulatedBus([(1, XL330, 57_600, 500.0)], [[]], seed=1)
    yield bus
    bus.unplug()


def said(capsys, *argv):
    """Run a command with --json; its exit code and document."""
    code = main([*argv, "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_a_new_servo_is_found_at_its_rate_and_made_ready(fresh, capsys, tmp_path):
    code, document = said(capsys, "servo", "scan", "--port", fresh.path)
    assert code == 0 and document["servos"] == [
        dict(
            port=fresh.path, baud=57_600, id=1, model="XL330-M288", model_number=XL330, firmware=46
        )
    ]
    code, document = said(capsys, "servo", "read", "--port", fresh.path, "--baud", "57600")
    (one,) = document["servos"]
    assert code == 1 and one["registers"]["present_position"] == 500
    assert any("operating mode is 3 (position), needed is 5" in line for line in one["complaints"])
    rig = tmp_path / "rig.toml"
    argv = [
        "servo",
        "setup",
        "--port",
        fresh.path,
        "--baud",
        "57600",
        "--new-id",
        "2",
        "--new-baud",
        "1000000",
        "--rig",
        str(rig),
    ]
    code, document = said(capsys, *argv)
    assert (
        code == 0
        and document["servos"][0]["id"] == 2
        and document["servos"][0]["baud"] == 1_000_000
    )
    assert read_rig(rig).servos == (RigServo(2, "XL330-M288"),)
    code, document = said(
        capsys, "servo", "read", "--port", fresh.path, "--id", "2", "--baud", "1000000"
    )
    assert code == 0 and document["servos"][0]["complaints"] == []
    assert main(["servo", "read", "--port", fresh.path, "--baud", "1000000"]) == 0
    assert "  set up\n" in capsys.readouterr().out


def setting(bus, **changed):
    """Write registers of servo 1 as a user of before may have left them."""
    with opened(bus.path, 57_600) as port:
        for name, value in changed.items():
            address, size, _ = _core.servo_registers()[name]
            port.write(1, address, value.to_bytes(size, "little", signed=value < 0))


def mends(bus):
    """Return the command that sets servo 1 up."""
    return f"`softmap servo setup --port {bus.path} --baud 57600 --id 1`"


@pytest.mark.parametrize("firmware, runs_on", [(46, False), (42, False), (41, True), (38, True)])
@pytest.mark.parametrize("number, counts", [(XL330, 5), (XL430, 4)])
@pytest.mark.parametrize("mode", [3, 4, 5])
def test_a_homing_offset_is_mended_whatever_mode_and_firmware(
    number, counts, mode, firmware, runs_on
):
    """Mode 4 with an offset on firmware below 42 runs on when its watchdog trips: never driven, and
    reported.
    """
    bus = _core.EmulatedBus([(1, number, 57_600, 500.0)], [[]])
    setting(bus, operating_mode=mode, homing_offset=1000)
    (found,) = setup.scan(bus.path, 57_600)
    found, said = replace(found, firmware=firmware), []
    with opened(bus.path, 57_600) as port:
        complaints = setup.complaints(found, setup.registers(port, 1))
    wrong = [line for line in complaints if line.startswith("homing offset is 1000")]
    assert len(wrong) == 1 and wrong[0].endswith(f"needed is 0; run {mends(bus)}")
    assert (
        f"firmware {firmware} lets the motor run on when its watchdog trips in mode 4" in wrong[0]
    ) == runs_on
    done = setup.set_up(found, tell=said.append).servo
    with opened(bus.path, 57_600) as port:
        now = setup.registers(port, 1)
        assert setup.complaints(done, now) == []
    assert (now["operating_mode"], now["homing_offset"], now["present_position"]) == (
        counts,
        0,
        500,
    )
    mended = [line for line in said if line.startswith("homing offset is 1000")]
    assert (
        len(mended) == 1
        and mended[0].endswith("it becomes 0")
        and ("lets the motor run on" in mended[0]) == runs_on
    )
    assert any(line.startswith("operating mode is ") for line in said) == (mode != counts)
    again = []
    setup.set_up(found, tell=again.append)
    assert again == [], "what is well is not written"
    bus.unplug()


def test_firmware_without_a_watchdog_is_refused_and_nothing_is_written(fresh):
    (found,) = setup.scan(fresh.path, 57_600)
    with opened(fresh.path, 57_600) as port:
        before = setup.registers(port, 1)
    line = (
        "it is left as it is, its firmware 37 has no bus watchdog; update it to 45 with Dynamixel "
        "Wizard"
    )
    with pytest.raises(ServoError, match=line):
        setup.set_up(replace(found, firmware=37), 2, 1_000_000)
    with opened(fresh.path, 57_600) as port:
        after = setup.registers(port, 1)
    moving = (
        "realtime_tick",
        "present_position",
        "present_current",
        "present_temperature",
        "present_voltage",
    )
    assert {k: v for k, v in before.items() if k not in moving} == {
        k: v for k, v in after.items() if k not in moving
    }


def test_what_setup_mends_is_reported(fresh, capsys):
    setting(fresh, drive_mode=1, secondary_id=7, torque_enable=1)
    argv = ["servo", "setup", "--port", fresh.path, "--baud", "57600"]
    code, document = said(capsys, *argv)
    assert code == 0 and document["mended"] == [
        "its torque was on: it is off",
        "operating mode is 3 (position): it becomes 5",
        "return delay time is 250: it becomes 0",
        "drive mode is 1: it becomes 0",
        "secondary id is 7: it becomes 255",
    ]
    assert main(argv) == 0
    reported = capsys.readouterr().out.splitlines()
    assert len(reported) == 2, "the second time there is nothing to mend"
    assert reported[0].endswith(": set up") and reported[1] == (
        f"next: softmap servo setup --port {fresh.path} --baud 57600 --id 1 --rig rig.toml"
    )


def test_one_servo_at_a_time_is_set_up(capsys, tmp_path):
    with emulated_rig() as (bus, rig, _):
        assert main(["servo", "setup", "--port", bus.path, "--baud", "1000000"]) == 2
        assert (
            "2 servos answer (ids 1, 2); connect one at a time, or say which with --id"
            in capsys.readouterr().err
        )
        argv = ["servo", "setup", "--port", bus.path, "--baud", "1000000", "--id"]
        assert main([*argv, "1", "--new-id", "2"]) == 2
        assert "id 2 is taken by another servo" in capsys.readouterr().err
        file = str(tmp_path / "rig.toml")
        assert main([*argv, "1", "--rig", file]) == 0 and main([*argv, "2", "--rig", file]) == 0
        assert [servo.id for servo in read_rig(file).servos] == [1, 2] and read_rig(
            file
        ).port == rig.port
        assert main([*argv, "1", "--new-baud", "9600", "--rig", file]) == 2
        assert "the rig runs at 1000000 baud" in capsys.readouterr().err
        assert main([*argv, "9"]) == 2
        assert "no servo of id 9 answers" in capsys.readouterr().err


def test_a_servo_without_current_is_driven_in_extended_position():
    bus = _core.EmulatedBus([(1, XL430, 57_600, 0.0)], [[]])
    (found,) = setup.scan(bus.path, 57_600)
    done = setup.set_up(found).servo
    with opened(done.port, done.baud) as port:
        assert setup.registers(port, 1)["operating_mode"] == 4
    bus.unplug()


def test_torque_goes_off_however_it_was_left_on(capsys, tmp_path):
    with emulated_rig() as (bus, rig, _):
        ours = _core.ServoBus(bus.path, rig.baud)
        for id in (1, 2):
            ours.write(id, 64, b"\x01")
        ours.close()
        assert torque(bus)
        rig.write(tmp_path / "rig.toml")
        assert main(["servo", "off", "--rig", str(tmp_path / "rig.toml")]) == 0
        time.sleep(0.05)  # the bytes are on their way
        assert not torque(bus)
        assert "torque off was sent" in capsys.readouterr().out


def test_bad_ports_have_their_line(capsys, tmp_path):
    for argv, line in (
        (["servo", "scan", "--port", str(tmp_path / "none")], "no such port"),
        (
            ["servo", "off", "--rig", str(tmp_path / "rig.toml")],
            "make it with `softmap servo setup --rig",
        ),
        (["servo", "emulate", "--model", "XL1"], "no servo 'XL1' is known"),
        (["servo", "emulate", "--servos", "99"], "99 servos; allowed are 1 to 16"),
    ):
        assert main(argv) == 2
        assert line in capsys.readouterr().err


def test_ports_are_listed_once_by_their_lasting_name(tmp_path):
    (tmp_path / "serial/by-id").mkdir(parents=True)
    (tmp_path / "ttyUSB0").touch()
    (tmp_path / "ttyACM1").touch()
    (tmp_path / "serial/by-id/usb-FTDI").symlink_to(tmp_path / "ttyUSB0")
    assert ports(tmp_path) == [str(tmp_path / "serial/by-id/usb-FTDI"), str(tmp_path / "ttyACM1")]


def test_an_emulated_rig_takes_faults_from_standard_input(tmp_path):
    rig = tmp_path / "rig.toml"
    argv = [SOFTMAP, "servo", "emulate", "--rig", str(rig), "--json"]
    with subprocess.Popen(
        argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        port = json.loads(process.stdout.readline())["port"]
        assert read_rig(rig).port == port
        with opened(port, 1_000_000) as bus:
            assert bus.ping(2) == (XL330, 46)
            process.stdin.write("mute 1\nfly 3\nheat 0 abc\nheat 0 60\n")
            process.stdin.flush()
            assert "no such fault; faults, one a line" in process.stderr.readline()
            assert (
                "heat 0 abc: some of its values are not numbers of that kind"
                in process.stderr.readline()
            )
            begin = time.monotonic()
            while setup.registers(bus, 1)["present_temperature"] < 55:
                assert time.monotonic() - begin < 5.0
            assert bus.ping(2) is None
            process.stdin.write("mend 1\nburden 0 2\njammed 0\nlose_turn 0\nswap 0 1\n")
            process.stdin.flush()
            while (
                there := bus.ping(2) and setup.registers(bus, 2)["present_position"]
            ) != HOME - 4096:
                assert time.monotonic() - begin < 10.0, there
        _, _ = process.communicate()
        assert process.returncode == 0


def test_a_recording_is_decided_again_and_written_as_a_run(tmp_path, capsys):
    file, out = tmp_path / "drive.mcap", tmp_path / "drive.npz"
    with (
        emulated_rig() as (_, rig, limits),
        Controller(rig, calibration(), limits, record=file) as robot,
    ):
        robot.engage([0.5, 0.0])
    code, document = said(capsys, "replay", str(file), "--run", str(out))
    assert code == 0 and document["otherwise"] == [] and document["periods"] > 5
    assert Run.load(out).hash() == read_recording(file).run().hash()
    before = out.read_bytes()
    assert main(["servo", "replay", str(file), "--run", str(out)]) == 2
    assert (
        "a run stands there and would be lost; give another name or --force"
        in capsys.readouterr().err
    )
    assert (
        main(["servo", "replay", str(file), "--run", str(out), "--force"]) == 0
        and out.read_bytes() == before
    )
    capsys.readouterr()
    assert main(["servo", "replay", str(file)]) == 0
    assert "every one decided alike" in capsys.readouterr().out
    assert main(["servo", "replay", str(out)]) == 2
    assert "holds no periods of a control loop" in capsys.readouterr().err


def test_a_servo_of_another_rate_than_its_rig_is_left_as_it_is(tmp_path, capsys):
    rig = tmp_path / "rig.toml"
    with emulated_rig() as (bus, there, _):
        there.write(rig)
        before = rig.read_text()
        argv = [
            "servo",
            "setup",
            "--port",
            bus.path,
            "--baud",
            "1000000",
            "--id",
            "2",
            "--rig",
            str(rig),
        ]
        assert main([*argv, "--new-baud", "57600"]) == 2
        assert (
            "the rig runs at 1000000 baud, servo 2 at 57600; give --new-baud 1000000"
            in capsys.readouterr().err
        )
        assert [one.id for one in setup.scan(bus.path, 1_000_000)] == [
            1,
            2,
        ] and rig.read_text() == before


def test_a_rate_that_no_port_has_is_refused(fresh, capsys):
    for what in ("scan", "read", "setup", "off"):
        for baud in ("-1", "99999999999999999999"):
            assert main(["servo", what, "--port", fresh.path, "--baud", baud]) == 2
            assert f"--baud {baud}; 9600 to 4500000 is allowed" in capsys.readouterr().err
    assert main(["servo", "emulate", "--seed", "99999999999999999999999"]) == 2
    assert "--seed 99999999999999999999999; 0 to" in capsys.readouterr().err


def test_an_emulator_replaces_no_rig_but_its_own(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", io.StringIO())
    rig = tmp_path / "rig.toml"
    argv = ["servo", "emulate", "--servos", "1", "--rig", str(rig)]
    assert main(argv) == 0 and main(argv) == 0, "its own is replaced"
    assert read_rig(rig).made["emulated"] == {"by": "softmap servo emulate"}
    real = (
        'schema = "softmap.rig/1"\nport = "/dev/ttyUSB0"\n[[servo]]\nid = 1\nmodel = "XL330-M288"\n'
    )
    for text in (real, "no TOML"):
        rig.write_text(text)
        for more in ([], ["--fresh"]):
            assert (
                main([*(argv if not more else ["servo", "emulate", "--rig", str(rig)]), *more]) == 2
            )
            assert "a file that no emulator wrote stands there" in capsys.readouterr().err
        assert rig.read_text() == text
    assert main([*argv, "--force"]) == 0 and read_rig(rig).port != "/dev/ttyUSB0"


def test_an_emulator_replaces_a_bundle_only_where_it_is_asked_to(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", io.StringIO())
    argv = ["servo", "emulate", "--calibrated", str(tmp_path / "robot")]
    assert main(argv) == 0
    before = (tmp_path / "robot" / "manifest.json").stat().st_mtime_ns
    capsys.readouterr()
    assert main(argv) == 2
    assert (
        f"--calibrated {tmp_path / 'robot'}: a bundle stands there already"
        in capsys.readouterr().err
    )
    assert (tmp_path / "robot" / "manifest.json").stat().st_mtime_ns == before
    assert main([*argv, "--force"]) == 0
    assert (tmp_path / "robot" / "manifest.json").stat().st_mtime_ns > before


def test_a_rig_that_is_no_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "rig.toml")
    with pytest.raises(ServoError, match="rig.toml: not a regular file; give a rig.toml"):
        read_rig(tmp_path / "rig.toml")


def test_each_line_of_faults_on_the_page_is_understood():
    page = (Path(__file__).parents[2] / "docs/reference/safety.md").read_text(encoding="utf-8")
    rows = page.split("| what is typed | what breaks |")[1].split("\n\n")[0].splitlines()[2:]
    typed = [line for row in rows for line in re.findall(r"`([^`]+)`", row.split("|")[1])]
    named = {line.split()[0] for line in typed}
    known = set(
        re.findall(r"[a-z_]+", servo_emulate.FAULTS.split("faults, one a line: ")[1].split("(")[0])
    )
    assert named == known | {"blind"}, "all that there are"
    finger = SimpleNamespace(blind=lambda is_so: None)
    bus = _core.EmulatedBus([(id, XL330, 57_600, 500.0) for id in (1, 2)], [[], []], seed=1)
    for line in typed:
        if line != "unplug":
            servo_emulate._break(bus, finger, line.split())
    servo_emulate._break(bus, finger, ["unplug"])
