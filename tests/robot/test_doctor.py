"""The doctor says of each thing whether it is well and what to do, on computers and benches that
are not.
"""

import json
import os
import resource
from dataclasses import replace

import pytest
from ordinary_user import as_ordinary_user
from rigs import HOME, MODEL, calibration, emulated_rig, torque

from softmap_edge import _core, builtin_model, load_bundle, save_bundle
from softmap_edge.cli import main
from softmap_edge.commands.robot import announce_edited_limits
from softmap_edge.robot import doctor
from softmap_edge.robot.doctor import FAULT, OK, WARNING, host
from softmap_edge.robot.link.session import new_key
from softmap_edge.robot.servo import emergency
from softmap_edge.robot.servo.bus import opened
from softmap_edge.robot.servo.home_mark import set_mark
from softmap_edge.robot.servo.limits import effective_limits
from softmap_edge.robot.servo.rig import Rig, RigServo


def named(lines, name):
    """Return the one line of a name."""
    (found,) = [line for line in lines if line.name == name]
    return found


@pytest.fixture
def any_computer(monkeypatch):
    """Leave out the lines on this computer, so that only what is given counts."""
    for look in ("processor", "real_time", "ports", "latency", "teleoperation", "cameras"):
        monkeypatch.setattr(host, look, lambda *_: [])
    monkeypatch.setattr(host, "EXTRAS", {})


def test_a_rig_that_is_well(tmp_path, capsys, any_computer):
    with emulated_rig() as (bus, rig, _):
        rig.write(tmp_path / "rig.toml")
        before = bus.state()[1]
        lines = doctor.examine(rig=tmp_path / "rig.toml").lines
        assert named(lines, "rig").state == OK and named(lines, "servo 1").state == OK
        assert named(lines, "home of servo 2").found == "confirmed since power-up, at 2000"
        assert (
            named(lines, "ceiling").state == WARNING
            and "softmap servo pull" in named(lines, "ceiling").do
        )
        assert bus.state()[1] == before, "nothing moved, no torque"
        reported = ["servo", "doctor", "--rig", str(tmp_path / "rig.toml"), "--json"]
        assert main(reported) == 0, "a warning is no fault"
        document = json.loads(capsys.readouterr().out)
        assert document["schema"] == "softmap.doctor/1" and document["well"] is True
        assert {"name", "state", "found", "do"} == set(document["lines"][0])
        assert [line["name"] for line in document["lines"] if line["state"] != OK] == ["ceiling"]
        bus.damage(1, mute=True)
        assert main(reported) == 1
        document = json.loads(capsys.readouterr().out)
        unwell = {line["name"]: line for line in document["lines"] if line["state"] == FAULT}
        assert document["well"] is False and set(unwell) == {"servo 2"} and unwell["servo 2"]["do"]


@pytest.mark.parametrize(
    "breaks, name, found, do",
    [
        (lambda bus: bus.damage(0, mute=True), "servo 1", "no answer", "check power"),
        (
            lambda bus: bus.reset(1),
            "home of servo 2",
            "not homed since power-up",
            "softmap servo home",
        ),
        (lambda bus: bus.fail(1, 0x20), "servo 2", "it reports overload", "softmap servo reboot"),
        (
            lambda bus: bus.rename(0, 9),
            "servo 1",
            "no answer, but id 9 answers",
            "--id 9 --new-id 1",
        ),
        (lambda bus: bus.unplug(), "bus", "no such port", "softmap servo scan"),
    ],
)
def test_a_rig_that_is_not(tmp_path, breaks, name, found, do):
    with emulated_rig() as (bus, rig, _):
        rig.write(tmp_path / "rig.toml")
        breaks(bus)
        examined = doctor.examine(rig=tmp_path / "rig.toml")
        for _ in range(3):  # a servo that was reset answers a moment later
            lines = [line for line in examined.lines if line.name == name and found in line.found]
            if lines:
                break
            examined = doctor.examine(rig=tmp_path / "rig.toml")
        (line,) = lines
        assert line.state == FAULT and do in line.do and not examined.well


ON = "its torque is on: another program drives it, or one died"


def test_torque_that_is_on_is_reported_and_left_on(tmp_path):
    with emulated_rig() as (bus, rig, _):
        ours = _core.ServoBus(bus.path, rig.baud)
        ours.write(1, 64, b"\x01")
        ours.close()
        rig.write(tmp_path / "rig.toml")
        line = named(doctor.examine(rig=tmp_path / "rig.toml").lines, "servo 1")
        assert line == doctor.Line(
            "servo 1", FAULT, ON, f"`softmap servo off --rig {tmp_path}/rig.toml` releases it"
        )
        assert torque(bus)


def test_a_busy_port_another_model_and_damaged_files(tmp_path):
    with emulated_rig() as (bus, rig, _):
        file = tmp_path / "rig.toml"
        rig.write(file)
        ours = _core.ServoBus(bus.path, rig.baud)
        line = named(doctor.examine(rig=file).lines, "bus")
        assert "is in use by another program" in line.found and line.do == "close it first"
        ours.close()
        Rig(rig.port, rig.baud, (RigServo(1, "XM430-W210", 5),)).write(file)
        assert (
            "is XL330-M288 (1200), the rig lists XM430-W210"
            in named(doctor.examine(rig=file).lines, "servo 1").found
        )
    file.write_text("[")
    assert named(doctor.examine(rig=file).lines, "rig").state == FAULT
    line = named(doctor.examine(rig=tmp_path / "none.toml").lines, "rig")
    assert line.do == f"make it with `softmap servo setup --rig {tmp_path}/none.toml`"
    assert named(doctor.examine(bundle=tmp_path).lines, "bundle").state == FAULT


def test_a_bundle_without_calibration(tmp_path):
    save_bundle(builtin_model(), tmp_path / "b")
    lines = doctor.examine(bundle=tmp_path / "b").lines
    assert named(lines, "bundle").state == OK and named(lines, "safety.toml") == doctor.Line(
        "safety.toml", OK, "there"
    )
    assert (
        named(lines, "calibration").state == FAULT
        and "softmap model calibrate" in named(lines, "calibration").do
    )


def test_an_emergency_stop_that_cannot_be_asked_is_a_fault(tmp_path):
    with emulated_rig() as (_, rig, _):
        for chip, key, faults in (
            (
                "/dev/gpiochip9x",
                tmp_path / "none.key",
                ["none.key: the key cannot be read", "gpiochip9x: no such file"],
            ),
            (str(tmp_path / "plain"), tmp_path / "stop.key", ["plain: no gpio chip"]),
            (None, tmp_path / "stop.key", []),
        ):
            (tmp_path / "plain").touch()
            if key.name == "stop.key" and not key.exists():
                new_key(key)
            line = None if chip is None else emergency.Line(chip, 3)
            replace(
                rig, emergency=emergency.Emergency(line, emergency.Beats(5006, str(key)))
            ).write(tmp_path / "r.toml")
            found = [
                one
                for one in doctor.examine(tmp_path / "r.toml").lines
                if one.name == "emergency stop"
            ]
            wrong = [one for one in found if one.state == "fault"]
            assert len(wrong) == len(faults) and all(one.do for one in wrong), found
            for one, said in zip(wrong, faults):
                assert said in one.found.lower()
            assert (
                faults or [one.state for one in found] == [OK] and "UDP port 5006" in found[0].found
            )
        rig.write(tmp_path / "r.toml")
        assert not [
            one for one in doctor.examine(tmp_path / "r.toml").lines if one.name == "emergency stop"
        ]


def test_an_edited_safety_toml_is_reported(tmp_path, capsys):
    folder = save_bundle(replace(builtin_model(), calibration=calibration()), tmp_path / "b")
    lines = doctor.examine(bundle=folder).lines
    assert named(lines, "safety.toml").state == OK
    text = (folder / "safety.toml").read_text()
    (folder / "safety.toml").write_text(text.replace("slew = 8.0", "slew = 7.0"))
    line = named(doctor.examine(bundle=folder).lines, "safety.toml")
    assert (
        line.state == "warning" and line.found == "edited since the bundle was written" and line.do
    )
    announce_edited_limits(load_bundle(folder))
    said = capsys.readouterr().err
    assert (
        said
        == "safety.toml of the bundle was edited since that was written; `softmap servo limits` prints it\n"
    )


def test_what_combined_drives_is_no_fault(tmp_path):
    """A calibration without a window and a bundle without safety.toml: limits are derived, the
    doctor says so.
    """
    plain = replace(calibration(), window=None)
    save_bundle(replace(builtin_model(), calibration=plain, safety=None), tmp_path / "b")
    with emulated_rig() as (_, rig, _):
        rig.write(tmp_path / "rig.toml")
        effective_limits(rig, load_bundle(tmp_path / "b")).table()
        lines = doctor.examine(rig=tmp_path / "rig.toml", bundle=tmp_path / "b").lines
        assert [
            named(lines, name).state for name in ("bundle", "calibration", "safety.toml", "limits")
        ] == [OK] * 4
        assert "derived from the model each time" in named(lines, "safety.toml").found
        assert "derived from the model" in named(lines, "limits").found
        # A rig whose home is half a turn from the calibration's, and one of three servos:
        # combined() refuses them.
        moved = replace(rig, servos=tuple(replace(servo, home=HOME + 2048) for servo in rig.servos))
        more = replace(rig, servos=(*rig.servos, RigServo(3, MODEL)))
        for other, found in (
            (moved, "home of the rig is 4048"),
            (more, "the rig has 3 servos, the calibration 2"),
        ):
            other.write(tmp_path / "rig.toml")
            line = named(
                doctor.examine(rig=tmp_path / "rig.toml", bundle=tmp_path / "b").lines, "limits"
            )
            assert line.state == FAULT and found in line.found and line.do


def test_a_board_without_its_instructions(tmp_path):
    (tmp_path / "cpuinfo").write_text("processor: 0\nflags\t\t: fpu sse2\n")
    (line,) = host.processor("x86_64", tmp_path)
    assert line.state == WARNING and "without avx2, fma" in line.found
    (tmp_path / "cpuinfo").write_text("flags\t\t: fpu avx2 fma\n")
    assert [line.state for line in host.processor("x86_64", tmp_path)] == [OK]
    (tmp_path / "cpuinfo").write_text("Features\t: fp asimd crc32\n")
    assert [line.state for line in host.processor("aarch64", tmp_path)] == [OK]
    (line,) = host.processor("riscv64", tmp_path)
    assert line.state == WARNING and "supported are x86_64 and aarch64" in line.do
    (line,) = host.processor("x86_64", tmp_path / "none")
    assert line.state == WARNING


def test_a_slow_adapter_says_how_to_set_it(tmp_path):
    for name, text in (("ttyUSB0", "16\n"), ("ttyUSB1", "1\n"), ("ttyUSB2", "what")):
        folder = tmp_path / "bus/usb-serial/devices" / name
        folder.mkdir(parents=True)
        (folder / "latency_timer").write_text(text)
    slow, quick, odd = host.latency(tmp_path)
    assert slow.state == WARNING and slow.found.startswith("16 ms")
    assert slow.do.startswith(
        f"run echo 1 | sudo tee {tmp_path}/bus/usb-serial/devices/ttyUSB0/latency_timer"
    )
    assert quick.state == OK and odd.state == WARNING


def test_no_ports_and_no_cameras(tmp_path):
    assert [line.state for line in host.ports(tmp_path)] == [WARNING]
    assert [line.state for line in host.cameras(None, tmp_path)] == [WARNING]
    assert [line.state for line in host.cameras("0", tmp_path)] == [FAULT]
    (tmp_path / "video0").touch()
    assert [line.state for line in host.cameras(None, tmp_path)] == [OK]


def test_cameras_are_listed_with_the_names_that_stay(tmp_path):
    for number in (0, 2, 10):
        (tmp_path / f"video{number}").touch()
    links = tmp_path / "v4l/by-id"
    links.mkdir(parents=True)
    (links / "usb-Brio-video-index0").symlink_to("../../video10")
    bare, _, named = host.cameras(None, tmp_path)
    assert (bare.name, bare.found) == (f"{tmp_path}/video0", "may be opened")
    assert named.name == f"{tmp_path}/video10"
    assert named.found == f"may be opened; its lasting name is {links}/usb-Brio-video-index0"


def rights(folder):
    """Return the lines on ports, cameras and real-time rights for a user who has no more than he
    needs.
    """
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
    lines = [*host.ports(folder), *host.cameras(None, folder), *host.real_time()]
    return "\n".join(
        "|".join((line.state, line.name.split("/")[-1], line.found, line.do)) for line in lines
    )


@pytest.mark.skipif(
    os.geteuid() != 0, reason="a child becomes an ordinary user; an ordinary user is one already"
)
def test_an_ordinary_user_is_reported_what_rights_are_missing(tmp_path):
    with emulated_rig() as (bus, _, _):
        os.chmod(bus.path, 0o600)
        tmp_path.chmod(0o755)
        for name in ("ttyUSB0", "video0"):
            (tmp_path / name).touch()
            (tmp_path / name).chmod(0o660)
        for folder in tmp_path.parents:  # pytest's own folders are closed to others
            if folder.stat().st_uid == os.geteuid() and folder.name.startswith(
                ("pytest-", "popen-")
            ):
                folder.chmod(0o755)
        lines = as_ordinary_user(lambda: rights(tmp_path)).splitlines()
        opened = as_ordinary_user(lambda: _core.ServoBus(bus.path, 1_000_000))
    said = {line.split("|")[1]: line for line in lines}
    assert said["ttyUSB0"].startswith("fault") and "no permission for this user" in said["ttyUSB0"]
    assert "sudo usermod -aG root" in said["ttyUSB0"] and "log in again" in said["ttyUSB0"]
    assert said["video0"].startswith("warning")
    assert (
        said["real-time priority"].startswith("warning")
        and "- rtprio 50" in said["real-time priority"]
    )
    assert (
        said["locked memory"].startswith("warning")
        and "- memlock unlimited" in said["locked memory"]
    )
    assert "no permission; add yourself to the group that owns it (dialout)" in opened


def test_a_right_that_is_there_is_well(tmp_path):
    (tmp_path / "self").mkdir()
    (tmp_path / "self/status").write_text("Name: x\nCapEff:\t0000000000804000\n")
    assert [(line.state, line.found) for line in host.real_time(tmp_path)] == [
        (OK, "CAP_SYS_NICE"), (OK, "CAP_IPC_LOCK"),
    ]  # fmt: skip
    (tmp_path / "self/status").write_text("Name: x\nCapEff:\t0\n")
    limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    expected = OK if limit < 0 or limit >= 50 else WARNING
    assert next(iter(host.real_time(tmp_path))).state == expected


def test_a_look_that_fails_is_a_line(monkeypatch):
    def versions():
        raise ZeroDivisionError("by chance")
        yield

    monkeypatch.setattr(host, "versions", versions)
    found = doctor.examine()
    assert found.lines[0].state == FAULT and "ZeroDivisionError: by chance" in found.lines[0].found
    assert not found.well and main(["servo", "doctor"]) == 1


def test_as_text(capsys, any_computer):
    assert main(["servo", "doctor"]) == 0
    said = capsys.readouterr().out
    assert "ok       python: 3." in said and said.endswith(
        f"{2 + len(host.NEEDED)} ok, 0 warnings, 0 faults\n"
    )


def test_the_port_of_the_rig_is_among_the_serial_ports(tmp_path):
    """A port that no pattern lists (a pseudo-terminal, a udev name) is there all the same."""
    with emulated_rig() as (bus, rig, _):
        file = tmp_path / "rig.toml"
        rig.write(file)
        assert named(host.ports(tmp_path), "serial port").state == WARNING
        assert [line.state for line in host.ports(tmp_path, file)] == [OK]
        assert named(host.ports(tmp_path, file), bus.path).state == OK
        (tmp_path / "ttyUSB0").symlink_to(bus.path)
        assert len(list(host.ports(tmp_path, file))) == 1, "one device under two names"
        Rig(str(tmp_path / "gone"), rig.baud, rig.servos).write(file)
        line = named(host.ports(tmp_path, file), str(tmp_path / "gone"))
        assert line.state == FAULT and f"correct port in {file}" in line.do
        file.write_text("[")
        assert named(host.ports(tmp_path / "none", file), "serial port").state == WARNING


def test_a_home_is_reported_once_with_a_complete_remedy(tmp_path):
    with emulated_rig() as (bus, rig, _):
        rig.write(tmp_path / "rig.toml")
        bus.reset(1)
        line = named(doctor.examine(rig=tmp_path / "rig.toml").lines, "home of servo 2")
        assert (
            line.found.startswith("not homed")
            and line.found.count("(") == line.found.count(")") == 1
        )
        assert line.do == (
            "let the finger hang straight and home the robot with `softmap servo home --rig "
            f"{tmp_path}/rig.toml`"
        )
        Rig(rig.port, rig.baud, tuple(replace(one, home=HOME - 400) for one in rig.servos)).write(
            tmp_path / "rig.toml"
        )
        with opened(rig.port, rig.baud) as port:
            set_mark(port, 1, HOME - 400)
        line = named(doctor.examine(rig=tmp_path / "rig.toml").lines, "home of servo 1")
        assert line.state == OK and "it stands +400 ticks from there" in line.found
