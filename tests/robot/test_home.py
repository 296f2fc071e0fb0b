"""Home is confirmed after each power-up, and driving is refused until it is."""

import json
import re
import shlex

import pytest
from other_program import leave
from rigs import BAUD, HOME, MODEL, NUMBER, calibration, emulated_rig, set_up, torque

from softmap_edge import _core
from softmap_edge.cli import main
from softmap_edge.errors import ServoError
from softmap_edge.robot.commissioning.home import NEAR, prove
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.servo.bus import opened
from softmap_edge.robot.servo.home_mark import mark, marked
from softmap_edge.robot.servo.loop_limits import loop_limits, servo_limits
from softmap_edge.robot.servo.rig import Rig, RigServo, read_rig

FAR = 1800  # ticks at which the servos start; without power they know no more of their turns


@pytest.fixture
def wound(tmp_path):
    """Give a bus of two servos that are set up, and the file of a rig without homes."""
    bus = _core.EmulatedBus([(id, NUMBER, BAUD, float(FAR)) for id in (1, 2)], [[], []], seed=2)
    set_up(bus.path)
    file = tmp_path / "rig.toml"
    Rig(bus.path, BAUD, tuple(RigServo(id, MODEL) for id in (1, 2))).write(file)
    yield bus, file
    bus.unplug()


def home(file, *more):
    return main(["servo", "home", "--rig", str(file), "--yes", *more])


def drive(file):
    """Start and end a controller on the rig of `file`."""
    rig = read_rig(file)
    limits = loop_limits(
        [servo_limits(one.model, one.home or 0, (-900, 900)) for one in rig.servos], 100.0
    )
    with Controller(rig, calibration(), limits) as robot:
        assert robot.state == "ready"


def power_cycle(bus):
    """Take power and give it again, as a plug that is pulled does."""
    for servo in range(2):
        bus.reset(servo)


def answers(file):
    rig = read_rig(file)
    with opened(rig.port, rig.baud) as bus:
        for servo in rig.servos:
            while bus.ping(servo.id) is None:
                pass


def test_first_time_this_is_home_and_it_is_known_until_power_goes(wound, capsys):
    bus, file = wound
    with pytest.raises(
        ServoError, match="servo 1 has no home; home the robot with `softmap servo home"
    ):
        drive(file)
    assert home(file) == 0
    assert "servo 1: home at 1800 (set now)" in capsys.readouterr().out
    drive(file)
    rig = read_rig(file)
    assert [servo.home for servo in rig.servos] == [FAR, FAR]
    said = rig.made["homed"]
    assert (
        said["positions"] == [FAR, FAR]
        and said["firmware"] == [46, 46]
        and said["confirmed"] == "by --yes"
    )
    assert said["first"] == [1, 2] and said["when"].startswith("20")

    # Homes were found when the tendons had been wound up by three turns.
    Rig(rig.port, rig.baud, tuple(RigServo(id, MODEL, FAR + 3 * 4096) for id in (1, 2))).write(file)
    power_cycle(bus)
    answers(file)
    with pytest.raises(
        ServoError, match=r"servo 1: not homed since power-up \(turns are lost without power"
    ):
        drive(file)
    assert home(file, "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "softmap.home/1"
    assert [one["turns"] for one in document["servos"]] == [-3, -3]
    assert [one["away_ticks"] for one in document["servos"]] == [0, 0]
    assert [servo.home for servo in read_rig(file).servos] == [1800, 1800]
    drive(file)


def test_one_servo_that_restarts_is_enough(wound):
    bus, file = wound
    assert home(file) == 0
    bus.reset(1)
    answers(file)
    with pytest.raises(ServoError, match="servo 2: not homed since power-up"):
        drive(file)


def test_a_finger_that_is_not_straight_is_refused_and_nothing_is_marked(wound, capsys, tmp_path):
    bus, file = wound
    rig = read_rig(file)
    for away, code in ((NEAR, 0), (NEAR + 1, 2)):
        Rig(
            rig.port, rig.baud, tuple(RigServo(id, MODEL, FAR - away - 4096) for id in (1, 2))
        ).write(file)
        assert home(file) == code
        with opened(rig.port, rig.baud) as port:
            assert marked(port, 1, FAR - away) == (code == 0)
    said = capsys.readouterr().err
    assert (
        f"{NEAR + 1:+d} ticks from the stored home" in said
        and "--new" in said
        and "slipped" in said
    )
    assert home(file, "--new") == 0
    assert [servo.home for servo in read_rig(file).servos] == [FAR, FAR]


def test_a_turn_away_from_a_home_that_is_still_confirmed_is_refused(capsys, tmp_path):
    with emulated_rig() as (bus, rig, _):
        file = tmp_path / "rig.toml"
        moved = Rig(rig.port, rig.baud, tuple(RigServo(id, MODEL, HOME + 4096) for id in (1, 2)))
        ours = _core.ServoBus(bus.path, BAUD)
        for id in (1, 2):
            ours.write(id, 168, mark(id, HOME + 4096))
        ours.close()
        moved.write(file)
        assert home(file) == 2
        assert "stands -1 turns from its home, which is still known" in capsys.readouterr().err


def test_another_home_in_the_file_is_not_confirmed(wound):
    _, file = wound
    assert home(file) == 0
    text = file.read_text().replace(f"home = {FAR}", f"home = {FAR + 1}", 1)
    file.write_text(text)
    with pytest.raises(ServoError, match="another home in the rig"):
        drive(file)


def test_a_servo_that_restores_its_memory_confirms_nothing(wound):
    bus, file = wound
    assert home(file) == 0
    ours = _core.ServoBus(bus.path, BAUD)
    ours.write(1, 60, b"\x02")
    ours.close()
    with pytest.raises(ServoError, match="servo 1: startup configuration is 2, needed is 0; run"):
        drive(file)


@pytest.mark.parametrize("left", [{"drive_mode": 1}, {"homing_offset": 9}, {"operating_mode": 4}])
def test_a_set_up_takes_the_proof_away_only_if_it_changes_something(wound, left):
    bus, file = wound
    assert home(file) == 0
    argv = ["servo", "setup", "--port", bus.path, "--baud", str(BAUD), "--id", "1"]
    assert main(argv) == 0
    drive(file)
    leave(bus.path, BAUD, **left)
    assert main(argv) == 0
    with pytest.raises(
        ServoError, match="servo 1: not homed .* a set-up that changes it .* need homing again too"
    ):
        drive(file)


def test_a_finger_that_moves_is_not_at_home():
    falling = _core.EmulatedBus(
        [(1, NUMBER, BAUD, 200_000.0)], [[(0.0, 300.0), (400_000.0, 300.0)]], seed=1
    )
    set_up(falling.path, (1,))
    rig = Rig(falling.path, BAUD, (RigServo(1, MODEL),))
    with pytest.raises(ServoError, match="the finger moves: servo 1 turned by"):
        prove(rig, "nobody")
    falling.unplug()


def test_torque_goes_off_before_anybody_is_asked(wound, capsys, monkeypatch):
    bus, file = wound
    ours = _core.ServoBus(bus.path, BAUD)
    ours.write(1, 64, b"\x01")
    ours.close()
    assert torque(bus)
    assert main(["servo", "home", "--rig", str(file)]) == 2
    assert "no terminal to ask at; --yes says it instead" in capsys.readouterr().err
    assert not torque(bus)


@pytest.mark.parametrize(
    "change, said",
    [
        (lambda bus, rig: bus.damage(0, mute=True), "servo 1: no answer at"),
        (
            lambda bus, rig: bus.rename(0, 9),
            "servo 1: no answer, but id 9 answers, which the rig does not list",
        ),
        (lambda bus, rig: bus.fail(0, 0x04), "it reports overheating"),
        (lambda bus, rig: bus.faults(unpowered=True), "check power and wiring"),
    ],
)
def test_servos_that_are_not_well_are_not_homed(wound, capsys, change, said):
    bus, file = wound
    change(bus, file)
    assert home(file) == 2
    assert said in capsys.readouterr().err
    assert all(servo.home is None for servo in read_rig(file).servos)


def test_another_model_than_the_rig_says(wound, capsys):
    bus, file = wound
    Rig(bus.path, BAUD, (RigServo(1, "XM430-W210"),)).write(file)
    assert home(file) == 2
    assert (
        "servo 1: it is XL330-M288 (1200), the rig lists XM430-W210 (1030); correct the rig"
        in capsys.readouterr().err
    )


def test_a_mark_is_made_of_addresses_that_every_model_may_map():
    seen = {mark(id, home) for id in (1, 2) for home in range(-2000, 2000)}
    assert len(seen) == 8000, "another servo or another home is another mark"
    words = {one[k] | one[k + 1] << 8 for one in seen for k in range(0, 16, 2)}
    assert words == set(range(120, 136))


def test_all_servos_away_from_home_are_listed_with_jogs_that_lead_back(tmp_path, capsys):
    """After a fault the horns stand anywhere: one message, and its commands suffice."""
    file = str(tmp_path / "rig.toml")
    with emulated_rig(load=[]) as (bus, rig, _):
        Rig(
            rig.port,
            rig.baud,
            tuple(RigServo(id, MODEL, HOME - away) for id, away in ((1, 559), (2, -210))),
        ).write(file)
        assert home(file) == 2
        said = capsys.readouterr().err
        assert (
            "servo 1 stands at 2000, +559 ticks" in said
            and "servo 2 stands at 2000, -210 ticks" in said
        )
        assert (
            "--new is for another finger" in said
            and "calibrations made before no longer fit" in said
        )
        jogs = re.findall(r"`softmap (servo move [^`]+)`(?:, (\d+) times)?", said)
        assert [times for _, times in jogs] == ["2", ""] and file in jogs[0][0]
        for command, times in jogs:
            for _ in range(int(times or 1)):
                assert main([*shlex.split(command), "--hold"]) == 0
        assert home(file) == 0
        assert [servo.home for servo in read_rig(file).servos] == [HOME - 559, HOME + 210]
