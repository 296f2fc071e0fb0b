"""Messages about servos whose remedy is a command: provoked at an emulated bus, followed as named,
and it works.

A case is a row of `CASES`. The runner repeats the failing command and follows the first command
that its message names, until it works: the names that it followed are those of the case, so that no
advice leads in a circle. A followed command may fail with a message of its own, which is followed
first.
"""

import os
import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from other_program import leave
from remedies import commands
from rigs import BAUD, HOME, NUMBER, angles, calibration, emulated_rig, torque

from softmap_edge import _core, builtin_model, save_bundle
from softmap_edge.cli import main
from softmap_edge.errors import ServoError
from softmap_edge.robot.doctor import host
from softmap_edge.robot.remedies import filled, parted
from softmap_edge.robot.servo import status_words as words
from softmap_edge.robot.servo.bus import heard, opened, write_registers
from softmap_edge.robot.servo.emergency import Beats, Emergency
from softmap_edge.robot.servo.home_mark import set_mark
from softmap_edge.robot.servo.rig import read_rig

MOST = 5  # commands that a message may need one after the other
NAMED = re.compile(r"`softmap ([^`]+)`(?:, (\d+) times)?")
AGAIN = "run the same command again"
READ, HOMED = (
    ("servo", "read", "--rig", "rig.toml"),
    ("servo", "home", "--rig", "rig.toml", "--yes"),
)
DRIVE = (
    "servo",
    "move",
    "0.2,0.2",
    "--rig",
    "rig.toml",
    "--bundle",
    "finger",
    "--hold",
    "--seconds",
    "0",
)
SETUP = ("servo", "setup", "--port", "PORT", "--baud", str(BAUD), "--id", "1", "--rig", "rig.toml")
DOCTOR = ("servo", "doctor", "--rig", "rig.toml")
CALIBRATED = ("--pulley-mm", "2.33", "--signs=+,+", "--ruler", "8192=29.3", "--out", "made")
MORE = {
    ("servo", "home"): ("--yes",),
    ("servo", "move"): ("--hold",),
    ("servo", "pull"): ("--hold",),
}


@dataclass(frozen=True)
class Case:
    """A fault of a rig, and the way out that its message names.

    Attributes:
        name: of the case.
        breaks: does it to an emulated bus.
        fails: arguments of the command that brings the message.
        follows: the start of each command that is followed, in order.
        by_hand: what a person does at the robot, once a command was followed.
        more: arguments that a command needs which only its user knows.
        works: arguments of the command that works afterwards, if it is not the one that failed.
        code: exit code of `fails`.
    """

    name: str
    breaks: Callable
    fails: Sequence[str]
    follows: Sequence[str]
    by_hand: Callable = lambda bus: None
    more: Sequence[str] = ()
    works: Sequence[str] = ()
    code: int = 2


def left(**registers: int) -> Callable:
    """Return what leaves registers of servo 1 as another program does."""
    return lambda bus: leave(bus.path, BAUD, **registers)


def changed(**values: object) -> Callable:
    """Return what changes the rig file: of all of it, or of each servo."""

    def change(bus: object) -> None:
        rig = read_rig("rig.toml")
        of_servo = {key: value for key, value in values.items() if key in ("home", "low", "high")}
        servos = tuple(replace(one, **of_servo) for one in rig.servos)
        replace(rig, servos=servos, **{k: v for k, v in values.items() if k not in of_servo}).write(
            "rig.toml"
        )

    return change


def limited_and_shut_down(bus: _core.EmulatedBus) -> None:
    """Leave a voltage limit that the supply does not meet, and the error that it brings about."""
    leave(bus.path, BAUD, min_voltage_limit=60)
    bus.fail(0, 0x01)


def at_another_rate(bus: _core.EmulatedBus) -> None:
    assert (
        main(
            [
                "servo",
                "setup",
                "--port",
                bus.path,
                "--baud",
                str(BAUD),
                "--id",
                "1",
                "--new-baud",
                "57600",
            ]
        )
        == 0
    )


def outside(bus: object) -> None:
    """Jog servo 1 out of its window; a busy computer may end some of the jogs."""
    argv = ["servo", "move", "--servo", "1", "--by", "280", "--rig", "rig.toml", "--hold"]
    for _ in range(2 * MOST):
        if angles(bus)[0] < HOME + 1000:
            main(argv)
    assert angles(bus)[0] > HOME + 1000


def plain_bundle(bus: object) -> None:
    save_bundle(builtin_model(), "plain")


def no_rig(bus: object) -> None:
    Path("rig.toml").unlink()


CASES = [
    Case("a register", left(drive_mode=1), READ, ["servo setup"], code=1),
    Case("a register, at a drive", left(homing_offset=7), DRIVE, ["servo setup", "servo home"]),
    Case("pings only", left(status_return_level=0), HOMED, ["servo setup"]),
    Case("memory that is restored", left(startup_configuration=1), HOMED, ["servo setup"]),
    Case("another rate", at_another_rate, READ, ["servo setup"], code=1),
    Case("another id", lambda bus: bus.rename(0, 9), READ, ["servo setup"], code=1),
    Case("torque that is on", left(torque_enable=1), READ, ["servo off"], code=1),
    Case(
        "a servo that shut down",
        lambda bus: bus.fail(0, 0x20),
        DRIVE,
        ["servo reboot", "servo home"],
    ),
    Case(
        "the doctor on it",
        lambda bus: bus.fail(1, 0x04),
        DOCTOR,
        ["servo reboot", "servo home"],
        code=1,
    ),
    Case(
        "a set-up of one that shut down",
        lambda bus: bus.fail(0, 0x10),
        SETUP,
        ["servo reboot"],
    ),
    Case(
        "a voltage limit that shuts it down",
        limited_and_shut_down,
        DRIVE,
        ["servo setup", "servo reboot", "servo home"],
    ),
    Case("no protection", left(shutdown=0), READ, ["servo setup"], code=1),
    Case("a temperature limit, at a drive", left(temperature_limit=99), DRIVE, ["servo setup"]),
    Case("power that was off", lambda bus: bus.reset(1), DRIVE, ["servo home"]),
    Case("the doctor on that", lambda bus: bus.reset(1), DOCTOR, ["servo home"], code=1),
    Case("no home", changed(home=None), DRIVE, ["servo home"]),
    Case(
        "no home, limits",
        changed(home=None),
        ("servo", "limits", *DRIVE[3:7]),
        ["servo home"],
        code=1,
    ),
    Case("a finger that is bent", changed(home=HOME - 500), HOMED, ["servo move", "servo move"]),
    Case("a place outside the window", outside, DRIVE, ["servo move"]),
    Case(
        "a servo that is gone",
        lambda bus: bus.damage(1, mute=True),
        READ,
        ["servo scan"],
        by_hand=lambda bus: bus.damage(1, mute=False),
        code=1,
    ),
    Case(
        "a servo that is held",
        lambda bus: bus.damage(0, stuck=True),
        ("servo", "move", "--servo", "1", "--by", "60", "--rig", "rig.toml", "--hold"),
        ["servo limits", "servo home", "servo move", "servo home"],
        by_hand=lambda bus: bus.damage(0, stuck=False),
        works=DRIVE,
        code=1,
    ),
    Case(
        "a bundle without a calibration",
        plain_bundle,
        (*DRIVE[:6], "plain", *DRIVE[7:]),
        ["servo calibrate"],
        more=CALIBRATED,
        works=(*DRIVE[:6], "made", *DRIVE[7:]),
    ),
    Case(
        "a command beyond the window",
        lambda bus: None,
        ("servo", "move", "9,0", *DRIVE[3:]),
        ["servo limits"],
        works=DRIVE,
        code=1,
    ),
    Case(
        "no rig",
        no_rig,
        READ,
        ["servo setup"],
        more=("--port", "PORT", "--baud", str(BAUD), "--id", "1"),
    ),
    Case(
        "no key",
        changed(emergency=Emergency(udp=Beats(5006, "stop.key"))),
        DOCTOR,
        ["servo heartbeat"],
        code=1,
    ),
]


@pytest.fixture
def robot(tmp_path, monkeypatch):
    """Give the bus of a sound rig, in the current folder: `rig.toml` and the bundle
    `finger`.
    """
    monkeypatch.chdir(tmp_path)
    for look in ("processor", "real_time", "ports", "latency", "teleoperation", "cameras"):
        monkeypatch.setattr(host, look, lambda *_: [])
    save_bundle(replace(builtin_model(), calibration=calibration()), "finger")
    with emulated_rig(load=[]) as (bus, rig, _):
        rig.write("rig.toml")
        yield bus


def said_by(argv, bus, capsys):
    """Return exit code and message of a command, on one line; it waits out a busy computer."""
    words = [{"N": "2", "PORT": bus.path, "DIR": "finger"}.get(word, word) for word in argv]
    for _ in range(MOST):
        capsys.readouterr()
        code = main(words)
        out, err = capsys.readouterr()
        said = " ".join((err + out).split())
        named = NAMED.search(said)
        looks = named is None or named[1].startswith("servo doctor")  # which mends nothing
        if not (code and looks and AGAIN in said):
            break
    return code, said


def followed(message, bus, more, capsys):
    """Run the first command that a message names, as often as it says; return its words, exit code
    and message.
    """
    message = message.partition(" fault ")[2] or message  # the doctor names what may be better, too
    found = NAMED.search(message)
    assert found, f"names no command: {message}"
    command, times = found.groups()
    words = shlex.split(command)
    assert "FILE" not in words, f"the file is known: {message}"
    known = next(
        (extra for start, extra in MORE.items() if tuple(words[: len(start)]) == start), ()
    )
    for _ in range(int(times or 1)):
        code, said = said_by((*words, *known, *more), bus, capsys)
        if code:
            break  # its message is followed next
    return " ".join(words), code, said


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_the_remedy_of_a_message_leads_out(case, robot, capsys):
    case.breaks(robot)
    done = []
    code, message = said_by(case.fails, robot, capsys)
    assert code == case.code, message
    while code and len(done) < MOST:
        words, code, message = followed(message, robot, case.more, capsys)
        done.append(next((one for one in case.follows if words.startswith(one)), words))
        case.by_hand(robot)
        if code == 0:
            code, message = said_by(case.works or case.fails, robot, capsys)
    assert (done, code) == (list(case.follows), 0), message
    assert not torque(robot)


def test_an_unmeasured_current_is_measured_by_the_command_named(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for look in ("processor", "real_time", "ports", "latency", "teleoperation", "cameras"):
        monkeypatch.setattr(host, look, lambda *_: [])
    save_bundle(replace(builtin_model(), calibration=calibration()), "finger")
    with emulated_rig() as (bus, rig, _):
        rig.write("rig.toml")
        changed(low=-150, high=150)(bus)
        argv = ["servo", "doctor", "--rig", "rig.toml", "--bundle", "finger"]
        code, message = said_by(argv, bus, capsys)
        assert code == 0 and "no current was measured for servo 1, 2" in message
        command = next(one for one, _ in NAMED.findall(message) if one.startswith("servo pull"))
        assert main([*shlex.split(command), "--hold"]) == 0
        assert "no current was measured" not in said_by(argv, bus, capsys)[1]


def test_each_step_from_new_servos_names_the_next(tmp_path, monkeypatch, capsys):
    """Set up without a rig: what comes next holds everything, and needs nothing that does not
    exist.
    """
    monkeypatch.chdir(tmp_path)
    bus = _core.EmulatedBus([(1, NUMBER, 57_600, 500.0)], [[]], seed=1)
    code, said = said_by(["servo", "setup", "--port", bus.path, "--baud", "57600"], bus, capsys)
    assert code == 0
    steps = []
    for _ in range(2):  # into the rig, then home
        steps.append(said.rpartition("next: softmap ")[2].strip())
        yes = ["--yes"] if "home" in steps[-1] else []
        code, said = said_by([*shlex.split(steps[-1]), *yes], bus, capsys)
        assert code == 0
    assert "setup" in steps[0] and steps[1] == "servo home --rig rig.toml"
    assert main(["servo", "read", "--rig", "rig.toml"]) == 0
    bus.unplug()


def loop_of(rig, limits):
    """Start the loop itself, without the checks before it: they have passed a moment ago."""
    orders, reports = os.pipe(), os.pipe()
    try:
        _core.control_loop(
            orders[0],
            reports[1],
            port=rig.port,
            baud=rig.baud,
            servos=rig.numbers,
            limits=limits,
            slope=np.eye(2).reshape(-1).tolist(),
            b=[0.0, 0.0],
            home=[float(HOME)] * 2,
        )
    finally:
        os.close(orders[1])
        os.close(reports[0])


def write_profile(rig, limits):
    with opened(rig.port, rig.baud) as bus:
        write_registers(bus, 1, 112, bytes(4))


def read_profile(rig, limits):
    with opened(rig.port, rig.baud) as bus:
        heard(bus, 1, 112, 4)


def mark_home(rig, limits):
    with opened(rig.port, rig.baud) as bus:
        set_mark(bus, 1, HOME)


@pytest.mark.parametrize("ask", [loop_of, write_profile, read_profile, mark_home])
def test_a_servo_that_falls_silent_between_two_requests_is_named_with_the_remedy(ask):
    """A busy computer delivers answers late, so that any of these requests may miss them."""
    with emulated_rig() as (bus, rig, limits):
        bus.damage(0, mute=True)
        with pytest.raises(ServoError) as fault:
            ask(rig, limits)
        found, remedy = parted(fault.value)
        assert found == "servo 1: no answer" and remedy.endswith(AGAIN)


def test_answers_that_come_late_name_the_doctor(robot, capsys):
    """The doctor looks at the computer and at the bus; it is sound, and the command works again."""
    for denied in (
        words.denied("trouble(late)", limits={"servos": []}),
        words.onward({"state": "fault", "cause": "late"}, terminal=True),
        words.onward({"state": "safe_stop", "cause": "late"}),
    ):
        (command, _) = NAMED.search(filled(denied, "rig.toml")).groups()
        assert main(shlex.split(command)) == 0


def test_every_command_for_servos_that_a_message_names_has_a_case():
    """A new remedy needs a row above; what is left out here is named as advice to look, not to
    mend.
    """
    messages = [
        one
        for one in commands()
        if one.file.startswith("softmap_edge/") and one.words[0] == "servo"
    ]
    named = {" ".join(one.words[:2]) for one in messages}
    covered = {start for case in CASES for start in case.follows} | {
        "servo pull",
        "servo read",
        "servo emulate",
    }
    covered |= {"servo doctor", "servo replay"}
    assert named - {"servo"} <= covered
