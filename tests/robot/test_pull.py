"""The pull test finds the current at the stroke on emulated servos, and writes the ceiling; or says
why it does not.
"""

import json
import re
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from rigs import BAUD, HOME, MODEL, calibration, emulated_rig, torque

from softmap_edge.cli import main
from softmap_edge.commands.progress import Bar
from softmap_edge.errors import ServoError
from softmap_edge.model.bundle import builtin_model, save_bundle
from softmap_edge.robot.commissioning.jog import Held, Jog
from softmap_edge.robot.commissioning.pull import LEAST_READ, MARGIN, _stand, pull
from softmap_edge.robot.servo.limits import IDLE, effective_limits
from softmap_edge.robot.servo.rig import Rig, RigServo, read_rig
from softmap_edge.robot.servo.rig_ceiling import Ceiling

FINGER = replace(builtin_model(), calibration=calibration())
QUICK = Ceiling((("jog_slew", 800.0), ("low", -250.0), ("high", 300.0)))


@pytest.fixture
def folder(tmp_path):
    """Give an emulated bus, its rig's file and a bundle; its load is 0.4 mA a tick."""
    save_bundle(FINGER, tmp_path / "finger")
    with emulated_rig() as (bus, rig, _):
        replace(rig, ceiling=QUICK).write(tmp_path / "rig.toml")
        yield bus, tmp_path / "rig.toml", tmp_path / "finger"
        assert not torque(bus)


@pytest.fixture
def brief(monkeypatch):
    """Stand a shorter while at each end, where what was measured there is no matter."""
    monkeypatch.setattr("softmap_edge.robot.commissioning.pull.STANDS", 0.1)


def words(file, bundle, *more):
    return ["servo", "pull", "--rig", str(file), "--bundle", str(bundle), "--hold", *more]


def pulled(capsys, argv, before=lambda: None):
    """Run the command to its end and return what it prints; again if a busy machine held the bus
    up.
    """
    for _ in range(3):
        before()
        code, (out, err) = main(argv), capsys.readouterr()
        if code == 0 or "did not answer in time" not in err:
            break
    assert code == 0, err
    return out


def test_the_current_at_the_stroke_becomes_the_ceiling(folder, capsys):
    _, file, bundle = folder
    reported = json.loads(pulled(capsys, words(file, bundle, "--json")))
    assert next(iter(reported)) == "schema" and reported["schema"] == "softmap.pull/1"
    rig = read_rig(file)
    for servo, one in zip(rig.servos, reported["servos"], strict=True):
        low, high = one["legs"]
        assert (low["stroke_ticks"], high["stroke_ticks"]) == (-250, 300)
        assert low["mA"] == pytest.approx(100.0, abs=12.0) and high["mA"] == pytest.approx(
            120.0, abs=12.0
        )
        assert (
            servo.current_mA
            == one["current_mA"]
            == pytest.approx(MARGIN * high["mA"] + IDLE * 1470.0, abs=0.1)
        )
        assert "ticks/s" in rig.made["pulled"][f"servo_{servo.id}"]
    limits = {
        one.name: one for one in effective_limits(replace(rig, ceiling=Ceiling()), FINGER).servos[0]
    }
    assert limits["current"].value <= rig.servos[0].current_mA, "and it is in force"


def test_what_the_rig_allows_a_servo_binds_its_pull(folder, brief, capsys):
    _, file, bundle = folder
    rig = read_rig(file)
    replace(rig, servos=(replace(rig.servos[0], current_mA=30.0), rig.servos[1])).write(file)
    assert main(words(file, bundle, "--servo", "1")) == 2
    said = capsys.readouterr().err
    assert "under 30 mA" in said and "raise jog_current in [ceiling], or its current_mA" in said


def test_one_servo_keeps_what_was_found_of_the_other(folder, brief, capsys, monkeypatch):
    shown = []
    monkeypatch.setattr(Bar, "__call__", lambda bar, what, share: shown.append((what, share)))
    _, file, bundle = folder
    rig = read_rig(file)
    replace(rig, servos=(replace(rig.servos[0], current_mA=99.0), rig.servos[1])).write(file)
    assert "servo 2:" in pulled(capsys, words(file, bundle, "--servo", "2"), before=shown.clear)
    assert shown == [("servo 2, low end", 0.0), ("servo 2, high end", 0.4), ("servo 2, home", 0.8)]
    rig = read_rig(file)
    assert (
        rig.servos[0].current_mA == 99.0
        and rig.servos[1].current_mA > 150
        and list(rig.made["pulled"]) == ["servo_2"]
    )
    assert main(words(file, bundle, "--servo", "9")) == 2
    assert "the rig has no servo 9; it has 1, 2" in capsys.readouterr().err


@pytest.mark.parametrize(
    "change, said",
    [
        (lambda bus, file: bus.damage(0, torn=True), "pulls nothing there; look for a torn"),
        (lambda bus, file: bus.burden(0, 9.0), "look what holds it, or raise jog_current"),
        (lambda bus, file: bus.reset(0), "not homed since power-up|servo 1: no answer"),
        (lambda bus, file: bus.damage(0, jammed=True), "look what holds it"),
    ],
)
def test_pulls_that_identify_nothing_write_nothing(folder, brief, capsys, change, said):
    bus, file, bundle = folder
    change(bus, file)
    before = file.read_text()
    assert main(words(file, bundle, "--servo", "1")) == 2
    assert re.search(said, capsys.readouterr().err)
    assert file.read_text() == before


class LetsGo(Held):
    """A hand that stops at once."""

    stopped = True


def test_who_stops_it_gets_no_ceiling():
    with emulated_rig() as (bus, rig, _):
        with pytest.raises(ServoError, match="stopped before its end"):
            pull(effective_limits(replace(rig, ceiling=QUICK), FINGER), LetsGo())
        assert not torque(bus)


def test_a_servo_without_current_and_a_stroke_beyond_a_move_are_refused():
    rig = Rig("/dev/none", BAUD, tuple(RigServo(id, "XL430-W250", HOME) for id in (1, 2)))
    with pytest.raises(
        ServoError, match="servo 1, a XL430-W250, reports no current: its PWM is capped instead"
    ):
        pull(effective_limits(rig, FINGER), Held())
    short = Rig("/dev/none", BAUD, tuple(RigServo(id, MODEL, HOME) for id in (1, 2)),
                ceiling=Ceiling((("jog_travel", 500.0),)))  # fmt: skip
    with pytest.raises(ServoError, match=r"stroke of 900 ticks is beyond 1\.25 times the 500"):
        pull(effective_limits(short, FINGER), Held())


def test_a_servo_that_is_silent_of_its_current_is_reported(monkeypatch):
    monkeypatch.setattr(Jog, "current", np.full(2, np.nan))
    with emulated_rig() as (bus, rig, _):
        with pytest.raises(ServoError, match="servo 1 does not report its current"):
            pull(effective_limits(replace(rig, ceiling=QUICK), FINGER), Held())
        assert not torque(bus)


def test_no_terminal_and_no_hold_moves_nothing(folder, capsys):
    bus, file, bundle = folder
    assert main(words(file, bundle)[:-1]) == 2
    assert "no terminal whose keys" in capsys.readouterr().err and not torque(bus)


class Jogged:
    """A jog whose servo is on its way for `late` s, 100 ticks/s, then stands."""

    def __init__(self, late, says=True):
        self.rig, self.late, self.says = (
            Rig("/dev/none", BAUD, (RigServo(1, MODEL, HOME),)),
            late,
            says,
        )
        self.robot = SimpleNamespace(state="commissioning", report={})
        self.begun, self.current = time.monotonic(), np.array([30.0])

    def obey(self, hand):
        pass

    def keep(self):
        pass

    @property
    def position(self):
        way = 100.0 * min(time.monotonic() - self.begun, self.late)
        return np.array([HOME + way if self.says else np.nan])


def test_a_servo_that_is_on_its_way_yet_is_waited_for():
    stood = _stand(Jogged(0.8), 0, Held())
    assert all(away == pytest.approx(80.0, abs=3.0) and mA == 30.0 for away, mA in stood)


def test_one_that_never_stands_is_read_as_it_is(brief, monkeypatch):
    monkeypatch.setattr("softmap_edge.robot.commissioning.pull.PATIENCE", 0.5)
    jog = Jogged(60.0)
    assert len(_stand(jog, 0, Held())) >= LEAST_READ and time.monotonic() - jog.begun < 3.0


def test_time_goes_on_only_while_it_is_held(brief, monkeypatch):
    """A user who lets go for longer than the wait for a silence gets no message on the wiring."""
    monkeypatch.setattr("softmap_edge.robot.commissioning.pull.PATIENCE", 0.2)

    class Pauses(Held):
        def held(self):
            return time.monotonic() - jog.begun > 1.0

    jog = Jogged(0.0)
    assert len(_stand(jog, 0, Pauses())) >= LEAST_READ
    with pytest.raises(ServoError, match="servo 1 does not report its current"):
        _stand(Jogged(0.0, says=False), 0, Held())
