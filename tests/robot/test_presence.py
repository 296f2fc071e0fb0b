"""Servos that answer and that do not: another rate, another id, an id that two share, pings only;
each is named.
"""

import json
import re
import shlex
from dataclasses import replace

import pytest
from other_program import leave
from rigs import BAUD, NUMBER, calibration, emulated_rig

from softmap_edge import _core, builtin_model, save_bundle
from softmap_edge.cli import main
from softmap_edge.errors import NoAnswer, ServoError
from softmap_edge.robot import doctor
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.servo import presence
from softmap_edge.robot.servo.bus import heard, opened
from softmap_edge.robot.servo.examined import examined, members, refusal, started
from softmap_edge.robot.servo.limits import effective_limits
from softmap_edge.robot.servo.presence import listened, why_silent
from softmap_edge.robot.servo.rig import read_rig


def run(line, **given):
    """Run the first command that a line names; FILE and N as given."""
    argv = shlex.split(re.search(r"`softmap ([^`]+)`", line)[1])
    return main([given.get(word, word) for word in argv])


def two(delays=(250, 250), ids=(1, 1), baud=57_600):
    """Return a bus of servos as they are delivered, with these return delays (2 µs each)."""
    bus = _core.EmulatedBus([(id, NUMBER, baud, 500.0) for id in (1, 2)], [[], []], seed=1)
    for id, delay in zip((1, 2), delays):
        leave(bus.path, baud, id, return_delay_time=delay)
    for k, id in enumerate(ids):
        bus.rename(k, id)
    return bus


SAID = "something answers at 57600 baud and cannot be read: two servos share an id"


@pytest.mark.parametrize(
    "second", [250, *(pytest.param(other, marks=pytest.mark.long) for other in (251, 100))]
)
def test_answers_that_lie_over_one_another_are_named(capsys, second):
    bus = two((250, second))
    where = ["--port", bus.path, "--baud", "57600"]
    assert main(["servo", "scan", *where]) == 1
    reported = capsys.readouterr().out
    assert SAID in reported and "connect one servo at a time" in reported
    for argv in (
        ["servo", "read", *where],
        ["servo", "setup", *where, "--id", "1", "--new-id", "2"],
    ):
        assert main(argv) == 2
        assert SAID in capsys.readouterr().err
    assert [servo[0] for servo in bus.state()[1]] == [500.0, 500.0]
    bus.unplug()


def test_an_id_that_is_answered_twice_is_named_by_scan_setup_and_start(capsys, tmp_path):
    """A servo as delivered answers 0.5 ms later than one that was set up: both are read."""
    with emulated_rig() as (bus, rig, limits):
        leave(bus.path, BAUD, 2, return_delay_time=250)
        rig.write(tmp_path / "rig.toml")
        bus.rename(1, 1)
        where = ["--port", bus.path, "--baud", str(BAUD)]
        said = "two servos share id 1: it is answered twice; connect one servo at a time"
        assert main(["servo", "scan", *where]) == 1
        assert said in capsys.readouterr().out
        for argv in (
            ["servo", "setup", *where, "--id", "1", "--new-id", "5"],
            ["servo", "setup", *where],
        ):
            assert main(argv) == 2
            line = capsys.readouterr().err
            assert said in line and "or say which with --id" not in line
        with pytest.raises(ServoError, match=said):
            Controller(rig, calibration(), limits).__enter__()
        found = [
            line.found
            for line in doctor.examine(rig=tmp_path / "rig.toml").lines
            if line.name == "servo 1"
        ]
        assert any("two servos share id 1" in one for one in found)
        bus.rename(1, 2)
        assert main(["servo", "setup", *where, "--id", "2"]) == 0, "one at a time it goes on"
        assert not any("share" in one for one in listened(bus.path, BAUD).remarks)


def test_another_servo_next_to_two_that_share_an_id_is_still_found():
    bus = _core.EmulatedBus([(id, NUMBER, BAUD, 0.0) for id in (1, 2, 3)], [[]] * 3, seed=1)
    bus.rename(1, 1)
    heard_there = listened(bus.path, BAUD)
    assert [one.id for one in heard_there.found] == [3] and "cannot be read" in heard_there.remarks[
        0
    ]
    bus.unplug()


@pytest.mark.parametrize("fault", [{"junk": 0.3}, {"damage": 0.1}, {"drop": 0.3}, {"slow": 0.0005}])
def test_a_disturbed_bus_is_no_second_servo(fault):
    with emulated_rig() as (bus, rig, _):
        bus.faults(**fault)
        for _ in range(2):
            assert not [one for one in listened(bus.path, BAUD).remarks if "share" in one]
        assert refusal(examined(rig.port, rig.baud, members(rig))) == ""


def test_a_servo_that_answers_pings_only_is_named_and_set_up(tmp_path, capsys):
    file = str(tmp_path / "rig.toml")
    with emulated_rig() as (bus, rig, limits):
        rig.write(file)
        leave(bus.path, BAUD, status_return_level=0)
        said = "servo 1 answers pings only: its status return level is 0; run `softmap servo setup"
        where = ["--port", bus.path, "--baud", str(BAUD)]
        with pytest.raises(ServoError, match=said):
            Controller(rig, calibration(), limits).__enter__()
        for argv in (
            ["servo", "home", "--rig", file, "--yes"],
            ["servo", "move", "--rig", file, "--servo", "1", "--by", "50", "--hold"],
        ):
            assert main(argv) == 2
            assert said in capsys.readouterr().err
        for argv in (["servo", "scan", *where], ["servo", "read", *where, "--id", "1"]):
            assert main(argv) == 1
            assert said in capsys.readouterr().out
        (line,) = [one for one in doctor.examine(rig=file).lines if one.name == "servo 1"]
        assert line.found.startswith("answers pings only")
        assert run(line.do) == 0
        assert (
            "it answered pings only (status return level 0): it becomes 2"
            in capsys.readouterr().out
        )
        assert started(rig.port, rig.baud, members(rig)) == []


def test_silence_of_a_servo_names_it_wherever_a_register_is_asked():
    with emulated_rig() as (bus, rig, _), opened(rig.port, rig.baud) as port:
        bus.damage(1, mute=True)
        with pytest.raises(NoAnswer, match="servo 2: no answer; check power and wiring"):
            heard(port, 2, 64, 1)


@pytest.mark.parametrize("baud", [57_600, 115_200, 2_000_000])
def test_a_wrong_rate_is_named_with_the_command_that_mends_it(baud, tmp_path, capsys):
    file = str(tmp_path / "rig.toml")
    servos = [(1, NUMBER, baud, 500.0)]
    bus = _core.EmulatedBus(servos, [[]], seed=1)
    with emulated_rig() as (_, rig, _):
        pass
    rig = type(rig)(bus.path, BAUD, rig.servos[:1])
    rig.write(file)
    line = refusal(examined(rig.port, rig.baud, members(rig)))
    assert line.startswith(
        f"servo 1: it answers at {baud} baud, not at {BAUD}; run `softmap servo setup"
    )
    assert main(["servo", "read", "--port", bus.path, "--baud", str(BAUD), "--id", "1"]) == 2
    assert (
        f"no servo of id 1 answers: it answers at {baud} baud, not at {BAUD}"
        in capsys.readouterr().err
    )
    assert main(["servo", "scan", "--port", bus.path, "--baud", str(BAUD)]) == 1
    assert "without --baud every rate is tried" in capsys.readouterr().out
    (fault,) = [one for one in doctor.examine(rig=file).lines if one.name == "servo 1"]
    assert run(fault.do) == 0
    assert refusal(examined(rig.port, rig.baud, members(rig))) == ""
    bus.unplug()


def test_an_id_that_changed_is_named_with_the_command_that_mends_it(tmp_path):
    file = str(tmp_path / "rig.toml")
    with emulated_rig() as (bus, rig, _):
        rig.write(file)
        bus.rename(0, 9)
        line = refusal(examined(rig.port, rig.baud, members(rig)))
        assert line.startswith(
            "servo 1: no answer, but id 9 answers, which the rig does not list; if it got another "
            "id"
        )
        assert run(line, FILE=file) == 0
        assert [servo.id for servo in read_rig(file).servos] == [1, 2]
        assert refusal(examined(rig.port, rig.baud, members(read_rig(file)))) == ""


def test_what_is_gone_is_gone():
    with emulated_rig() as (bus, rig, _):
        bus.damage(0, mute=True)
        said = (
            "no answer at .*; check power and wiring, `softmap servo scan --port .*` lists who "
            "answers"
        )
        assert re.fullmatch(said, why_silent(rig.port, rig.baud, 1, [1, 2]))
        bus.damage(0, mute=False)
        assert why_silent(rig.port, rig.baud, 1, [1, 2]).startswith("it answered late")


@pytest.mark.parametrize("baud", [57_600, 115_200, 2_000_000])
def test_a_wrong_option_for_the_rate_is_named_alone(baud, tmp_path, capsys):
    """The servos answer at the rate of the rig, so neither they nor the rig need to change."""
    file = str(tmp_path / "rig.toml")
    with emulated_rig() as (_, rig, _):
        rig.write(file)
        at = ["--rig", file, "--baud", str(baud)]
        why = f"it answers at {BAUD} baud, as the rig says, not at --baud {baud}; run the same"
        assert main(["servo", "scan", *at]) == 1
        printed = capsys.readouterr().out
        assert all(f"servo {id}: {why} command without --baud" in printed for id in (1, 2))
        assert "late" not in printed
        assert main(["servo", "read", *at, "--id", "1"]) == 2
        assert f"no servo of id 1 answers: {why}" in capsys.readouterr().err


def test_scan_and_read_look_for_the_servos_of_a_rig(tmp_path, capsys):
    file = str(tmp_path / "rig.toml")
    with emulated_rig() as (bus, rig, _):
        rig.write(file)
        assert (
            main(["servo", "scan", "--rig", file]) == 0
            and main(["servo", "read", "--rig", file]) == 0
        )
        bus.rename(0, 9)
        capsys.readouterr()
        for what in ("scan", "read"):
            assert main(["servo", what, "--rig", file]) == 1
            reported = capsys.readouterr().out
            assert (
                "! servo 1: no answer, but id 9 answers, which the rig does not list; if it got "
                "another id" in reported
            )
        assert main(["servo", "read", "--port", bus.path, "--baud", str(BAUD), "--id", "1"]) == 2
        assert "but id 2, 9 answers; check which id it has" in capsys.readouterr().err
        assert main(["servo", "scan", "--rig", file, "--json"]) == 1
        assert "id 9 answers" in json.loads(capsys.readouterr().out)["remarks"][0]


def test_the_doctor_holds_a_current_limit_against_the_limits_in_force(tmp_path):
    """A limit below the usual cap and above that of the finger protects, and is no fault."""
    model = replace(builtin_model(), calibration=calibration())
    save_bundle(model, tmp_path / "finger")
    with emulated_rig() as (bus, rig, _):
        rig.write(tmp_path / "rig.toml")
        cap = int(effective_limits(rig, model).table()["servos"][0]["current"])
        for limit, states in ((cap + 50, ["ok"]), (cap - 50, ["fault"])):
            leave(bus.path, BAUD, current_limit=limit)
            lines = doctor.examine(tmp_path / "rig.toml", tmp_path / "finger").lines
            assert [line.state for line in lines if line.name == "servo 1"] == states, limit


@pytest.mark.parametrize(
    "ask",
    [
        lambda rig, file: examined(rig.port, rig.baud, members(rig)),
        lambda rig, file: doctor.examine(rig=file),
        lambda rig, file: main(["servo", "home", "--rig", file, "--yes"]),
        lambda rig, file: main(["servo", "read", "--rig", file]),
        lambda rig, file: main(["servo", "reboot", "--rig", file, "--id", "1"]),
    ],
)
def test_why_a_servo_answers_no_reads_is_found_once(ask, tmp_path, monkeypatch, capsys):
    """The diagnosis takes seconds: each further read repeats ten times."""
    count, real = [], presence._silent_reads
    monkeypatch.setattr(
        presence, "_silent_reads", lambda bus, id: count.append(id) or real(bus, id)
    )
    with emulated_rig() as (bus, rig, _):
        rig.write(tmp_path / "rig.toml")
        leave(bus.path, BAUD, status_return_level=0)
        ask(rig, str(tmp_path / "rig.toml"))
        assert count.count(1) == 1
