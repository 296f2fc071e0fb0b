"""The limits in force: the rig's ceiling, the finger's safety, servo and calibration, each with
its origin.
"""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from rigs import BAUD, HOME, MODEL, angles, calibration, emulated_rig, torque
from waiting import hold_for

from softmap_edge import _core
from softmap_edge.cli import main
from softmap_edge.errors import BundleError, LimitError, ServoError
from softmap_edge.model.bundle import builtin_model, load_bundle, save_bundle
from softmap_edge.model.safety import TIMES, TURNS, read_safety
from softmap_edge.model.servo_calibration import Calibration
from softmap_edge.robot.commissioning.jog import Held, Jog
from softmap_edge.robot.commissioning.setup import registers
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.servo.bus import opened
from softmap_edge.robot.servo.home_mark import set_mark
from softmap_edge.robot.servo.limits import effective_limits
from softmap_edge.robot.servo.loop_limits import loop_limits, servo_limits
from softmap_edge.robot.servo.models import servo_model
from softmap_edge.robot.servo.rig import Rig, RigServo, read_rig
from softmap_edge.robot.servo.rig_ceiling import RANGES, Ceiling

FINGER = builtin_model()


def rig(ceiling=(), **servo):
    """Return a rig of two servos with homes."""
    return Rig(
        "/dev/none",
        BAUD,
        tuple(RigServo(id, MODEL, HOME, **servo) for id in (1, 2)),
        ceiling=Ceiling(ceiling),
    )


def turned(slope, b=(0.0, 0.0), window=None):
    """Return a calibration of the map `slope`."""
    return replace(calibration(), A=np.array(slope), b=np.array(b), window=window)


def limit(found, name, servo=0):
    """Return a limit in force: of a servo, or of the robot."""
    return next(one for one in (*found.servos[servo], *found.robot) if one.name == name)


def test_without_a_ceiling_softmaps_own_defaults_are_tightened_by_the_finger():
    found = effective_limits(rig(), FINGER, turned(np.eye(2) / 280.0))
    assert (limit(found, "low").value, limit(found, "high").value) == (-4480, 4480)
    assert limit(found, "high").by == "safety.toml" and "16 mm" in limit(found, "high").why
    assert (limit(found, "slew").value, limit(found, "slew").by) == (2000.0, "softmap"), (
        "8 mm/s would be 2240"
    )
    # 12.75 N on a horn of 4096 / 280 / 2π mm, of 0.52 N·m at 1470 mA, and 5 % of that.
    expected = 12.75 * 4096 / 280 / (2 * np.pi) * 1e-3 / 0.52 * 1470 + 0.05 * 1470
    assert limit(found, "current").value == pytest.approx(expected, abs=0.1) and expected < 200
    assert limit(found, "current").by == "safety.toml" and "12.75 N" in limit(found, "current").why
    assert found.table()["servos"][0]["high"] == HOME + 4480


def test_the_ceiling_stands_in_place_of_the_defaults_and_a_bundle_only_tightens_it():
    high = (
        ("slew", 6000.0),
        ("hold", 10.0),
        ("stale", 1.0),
        ("ramp", 0.0),
        ("band", 0.0),
        ("jump", (100.0, 9000.0)),
    )
    found = effective_limits(rig(high), FINGER, turned(np.eye(2) / 280.0))
    assert (
        limit(found, "slew").value == pytest.approx(8.0 * 280)
        and limit(found, "slew").by == "safety.toml"
    )
    assert (limit(found, "hold").value, limit(found, "hold").by) == (2.0, "safety.toml")
    assert limit(found, "stale").value == 0.25 and limit(found, "ramp").value == 1.0, (
        "the longer ramp is the stricter"
    )
    assert limit(found, "band").value == 0.02 and limit(found, "band").by == "safety.toml"
    assert (
        limit(found, "jump").value == (100.0, pytest.approx(32 * 280))
        and limit(found, "jump").by == "rig.toml"
    )
    low = (
        ("slew", 500.0),
        ("hold", 0.5),
        ("current_mA", 90.0),
        ("high", 1000.0),
        ("late", 0.1),
        ("turns", 1.0),
    )
    found = effective_limits(
        rig(low, current_mA=120.0, low=-300), FINGER, turned(np.eye(2) / 280.0)
    )
    for name, value in (*low, ("low", -300)):
        one = limit(found, name.removesuffix("_mA"))
        assert (one.value, one.by) == (value, "rig.toml"), name
    table = found.table()
    assert (
        table["servos"][1]["low"] == HOME - 300 and table["hold"] == 0.5 and table["turns"] == 1.0
    )


@pytest.mark.parametrize(
    "ceiling, ticks", [((), 720.0), ((("slew", 900.0),), 400.0), ((("following", 300.0),), 300.0)]
)
def test_a_servo_may_be_as_late_as_the_trunks_were_at_its_speed_unless_the_rig_says_otherwise(
    ceiling, ticks
):
    found = effective_limits(rig(ceiling), FINGER, turned(np.eye(2) / 280.0))
    assert limit(found, "following").value == ticks
    assert servo_limits(MODEL, HOME, (-9.0, 9.0))["following"] == 720.0


def test_whatever_a_finger_says_the_ceiling_holds():
    """Proof that the ceiling is one: the loosest file that is accepted moves no limit above it."""
    loose = replace(
        FINGER.safety,
        slew=640.0,
        acceleration=64_000.0,
        tension=25.0,
        stale=2.0,
        hold=60.0,
        slacken=60.0,
        ramp=0.0,
        band=0.0,
        turns=50.0,
        burst=50.0,
        jump=(32.0, 32.0),
    )
    strict = effective_limits(rig(), replace(FINGER, safety=None), turned(np.eye(2) / 280.0))
    found = effective_limits(rig(), replace(FINGER, safety=loose), turned(np.eye(2) / 280.0))
    own = loop_limits([servo_limits(MODEL, 0, (-4480, 4480))] * 2)
    for one in (*found.servos[0], *found.robot):
        usual = own[one.name] if one.name in own else own["servos"][0][one.name]
        if one.name in ("ramp", "band", "low"):
            assert one.value >= usual
        elif isinstance(one.value, tuple):
            assert all(value <= most + 1e-9 for value, most in zip(one.value, usual))
        else:
            assert one.value <= usual, one.name
    assert strict.derived and not found.derived


def test_all_servos_at_once_stay_inside_the_window_and_the_rates_of_the_finger():
    rng = np.random.default_rng(5)
    for _ in range(200):
        slope = np.diag(rng.uniform(0.5, 2.0, 2) * rng.choice([-1, 1], 2)) + rng.uniform(
            -0.4, 0.4, (2, 2)
        )
        b = rng.uniform(-3.0, 3.0, 2)
        map_ = turned(slope / 280.0, b)
        found = effective_limits(rig((("slew", 20_000.0), ("acceleration", 1e6))), FINGER, map_)
        ends = np.array([[limit(found, name, k).value for name in ("low", "high")] for k in (0, 1)])
        corners = np.array([[x, y] for x in ends[0] for y in ends[1]])
        commands = map_.commands(HOME + corners)
        assert np.abs(commands).max() <= 16.0 + 0.01, "half a tick of round-off"
        assert np.abs(commands).max() > 15.9, "and no window is smaller than it must be"
        for name, most in (("slew", 8.0), ("acceleration", 80.0)):
            rate = np.array([limit(found, name, k).value for k in (0, 1)])
            assert (np.abs(slope / 280.0) @ rate).max() <= most * (1 + 1e-9)
        reach = effective_limits(rig(), FINGER, map_).calibration.usable(FINGER.command_range)
        for u in np.array([[x, y] for x in reach[0] for y in reach[1]]):
            ticks = map_.ticks(u[None])[0] - HOME
            assert np.all(ticks >= ends[:, 0] - 1) and np.all(ticks <= ends[:, 1] + 1), (
                "a plan stays inside"
            )


def test_the_calibrations_window_and_the_turns_of_a_rig_count():
    narrow = turned(np.eye(2) / 280.0, window=(-500.0, 700.0))
    found = effective_limits(rig(), FINGER, narrow)
    assert (limit(found, "low").value, limit(found, "high").value) == (-500, 700)
    assert limit(found, "low").by == "the calibration" and found.calibration.window == (
        -500.0,
        700.0,
    )
    away = Rig(
        "/dev/none", BAUD, (RigServo(1, MODEL, HOME + 8192 + 10), RigServo(2, MODEL, HOME - 4096))
    )
    found = effective_limits(away, FINGER, narrow)
    np.testing.assert_array_equal(found.calibration.home, [HOME + 8192, HOME - 4096])
    assert found.table()["servos"][0]["high"] == HOME + 8192 + 700, (
        "where the calibration says, whatever home is"
    )
    astray = Rig("/dev/none", BAUD, (RigServo(1, MODEL, HOME + 1500), RigServo(2, MODEL, HOME)))
    with pytest.raises(
        ServoError, match=r"servo 1: home of the rig is 3500, .* 1500 ticks apart, .* are 269"
    ):
        effective_limits(astray, FINGER, turned(np.eye(2) / 280.0))


def test_what_cannot_be_driven_is_refused_with_its_reason():
    with pytest.raises(ServoError, match="holds no calibration"):
        effective_limits(rig(), FINGER)
    with pytest.raises(ServoError, match=r"at home \[17\.0, 0\.0\] mm act, outside the window"):
        effective_limits(rig(), FINGER, turned(np.eye(2) / 280.0, (17.0, 0.0)))
    one = Rig("/dev/none", BAUD, (RigServo(1, MODEL, HOME),))
    with pytest.raises(ServoError, match="the rig has 1 servos, the calibration 2"):
        effective_limits(one, FINGER, turned(np.eye(2) / 280.0))
    homeless = Rig("/dev/none", BAUD, (RigServo(1, MODEL, HOME), RigServo(2, MODEL)))
    with pytest.raises(ServoError, match="servo 2 has no home"):
        effective_limits(homeless, FINGER, turned(np.eye(2) / 280.0)).table()
    short = rig((("stale", 0.005),))
    with pytest.raises(ServoError, match=r"stale is 0\.005 s; allowed is .*\(rig\.toml says so\)"):
        effective_limits(short, FINGER, turned(np.eye(2) / 280.0)).table()


@pytest.mark.parametrize(
    "name", ["jog_travel", "jog_slew", "jog_current", "jump", "turns", "following", "hot"]
)
def test_a_limit_that_the_guard_refuses_is_named_as_in_the_table_with_who_set_it(name):
    beyond = (1.0, 2e6) if name == "jump" else 0.01 if name in ("following", "hot") else 5000.0
    found = effective_limits(
        rig(((name, beyond),)), replace(FINGER, safety=None), turned(np.eye(2) / 280.0)
    )
    if name in ("jump", "turns"):  # the finger's is stricter: put the rig's in its place
        robot = tuple(
            replace(one, value=beyond, by="rig.toml") if one.name == name else one
            for one in found.robot
        )
        found = replace(found, robot=robot)
    with pytest.raises(
        ServoError, match=rf"^(servo 1: )?{name}.* is .*; allowed is .* \(rig\.toml says so\)$"
    ):
        found.table()
    with pytest.raises(LimitError) as refused:
        one = servo_limits(MODEL, 0, (-500, 500))
        own = name in one
        loop_limits(
            [one, one | {name: beyond}] if own else [one], **({} if own else {name: beyond})
        )
    assert (refused.value.name, refused.value.servo) == (name, 1 if own else None)


def test_dead_band_and_reversals_are_limits_like_the_others():
    one = servo_limits(MODEL, 0, (-500, 500))
    assert loop_limits([one])["band"] == 0.02
    for changes, said in (
        ({"band": -1.0}, "band is -1; allowed is 0 to 100"),
        ({"turns": 0.0}, "turns is 0 1/s; allowed is 0.1 to 100 1/s"),
        ({"burst": float("nan")}, "burst is NaN"),
    ):
        with pytest.raises(ServoError, match=said):
            loop_limits([one], **changes)
        with pytest.raises(ServoError, match=said):  # the guard's own check, for any table
            _core.check_limits(loop_limits([one]) | changes)
    with emulated_rig() as (_, rig, limits), pytest.raises(ServoError, match="'band' is missing"):
        Controller(
            rig, calibration(), {name: value for name, value in limits.items() if name != "band"}
        )


def test_each_range_is_the_guard_s_own_for_every_reader(tmp_path):
    """The guard accepts every allowed value of a rig and of a bundle, and beyond it
    all three do.
    """
    table = loop_limits([servo_limits(MODEL, 0, (-500, 500))])
    rig().write(tmp_path / "rig.toml")
    for name, (_, high, unit) in _core.limit_ranges().items():
        own = name in table["servos"][0]
        beyond = int(high) + 1 if name in ("home", "low", "high") else 1.5 * high
        value = (3.5, beyond) if name == "voltage" else (1.0, beyond) if name == "jump" else beyond
        changed = {"servos": table["servos"] * 17} if name == "servos" else {name: value}
        changed |= {"hot": 80.0} if name == "warm" else {}
        changes = {"servos": [table["servos"][0] | changed]} if own else changed
        with pytest.raises(
            ServoError, match=rf"{name}.* is .*; allowed is .* to {high:.7g} ?{unit}"
        ):
            _core.check_limits(table | changes)
        if (key := "current_mA" if name == "current" else name) in RANGES:
            value = list(value) if isinstance(value, tuple) else value
            (tmp_path / "wide.toml").write_text(
                (tmp_path / "rig.toml").read_text() + f"[ceiling]\n{key} = {value}\n"
            )
            with pytest.raises(ServoError, match=rf"{key} = .*{re.escape(f'{high:g}')}"):
                read_rig(tmp_path / "wide.toml")
        if name in (*TIMES, *TURNS):
            said = f"{name} = {getattr(FINGER.safety, name)}"
            text = FINGER.safety.to_toml()
            assert said in text
            with pytest.raises(BundleError, match=rf"{name} = .*, expected .* to {high:g}"):
                read_safety(
                    text.replace(said, f"{name} = {beyond}"), FINGER.command_range, "mm", "here"
                )
            kept = read_safety(
                text.replace(said, f"{name} = {high}"), FINGER.command_range, "mm", "here"
            )
            assert getattr(kept, name) == high


def test_rig_toml_carries_its_ceiling(tmp_path):
    values = tuple(
        (name, (1.0, 2.0) if name == "jump" else low + 0.25 * (high - low))
        for name, (low, high) in RANGES.items()
    )
    whole = rig(values, current_mA=200.0, low=-900, high=800, slew=1500.0, acceleration=1e4)
    whole.write(tmp_path / "rig.toml")
    assert read_rig(tmp_path / "rig.toml") == whole
    text = (tmp_path / "rig.toml").read_text()
    for old, new, said in (
        ("[ceiling]", "[ceiling]\nfly = 1", "no key 'fly'"),
        ("jump = [1.0, 2.0]", "jump = [3.0, 2.0]", "0 ≤ warned ≤ refused"),
        ("slew = 5000.75", "slew = 90000.0", "slew = 90000.0, expected 1 to 20000"),
        ("low = -900", "low = 900", "low = 900, expected -1048575 to -1"),
    ):
        assert old in text, old
        (tmp_path / "bad.toml").write_text(text.replace(old, new))
        with pytest.raises(ServoError, match=said):
            read_rig(tmp_path / "bad.toml")


def test_the_command_prints_every_limit_and_who_set_it(tmp_path, capsys):
    calibrated = replace(FINGER, calibration=turned(np.eye(2) / 280.0))
    bundle = save_bundle(calibrated, tmp_path / "bundle")
    rig((("hold", 1.5),), slew=900.0).write(tmp_path / "rig.toml")
    argv = ["servo", "limits", "--rig", str(tmp_path / "rig.toml"), "--bundle", str(bundle)]
    assert main([*argv, "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)
    assert (
        next(iter(reported)) == "schema"
        and reported["schema"] == "softmap.limits/1"
        and reported["refused"] is None
    )
    table = effective_limits(read_rig(tmp_path / "rig.toml"), calibrated).table()
    listed = {one["name"]: one for one in (*reported["servos"][0]["limits"], *reported["robot"])}
    assert set(table["servos"][0]) - {"home"} | set(table) - {"servos", "period"} == set(listed), (
        "none is left out"
    )
    assert listed["slew"]["by"] == "rig.toml" and listed["hold"]["value"] == 1.5
    assert listed["current"]["unit"] == "mA" and listed["warm"]["by"] == "the servo's data"
    assert main(argv) == 0
    said = capsys.readouterr().out
    assert (
        "servo 1, XL330-M288, home 2000 ticks" in said
        and "emergency stops: none" in said
        and "0.25 MPa" in said
    )
    Rig("/dev/none", BAUD, (RigServo(1, MODEL), RigServo(2, MODEL))).write(tmp_path / "rig.toml")
    assert (
        main(argv) == 1 and "nothing is driven: servos 1, 2 have no home" in capsys.readouterr().out
    )


def test_a_servo_that_caps_no_current_gets_a_cap_of_its_pwm_by_the_same_limit():
    bus = _core.EmulatedBus([(id, 1060, BAUD, float(HOME)) for id in (1, 2)], [[], []])
    with opened(bus.path, BAUD) as ours:
        for id in (1, 2):
            ours.write(id, 11, b"\x04")
            ours.write(id, 9, b"\x00")
            set_mark(ours, id, HOME)
    ours = Rig(bus.path, BAUD, tuple(RigServo(id, "XL430-W250", HOME) for id in (1, 2)))
    finger = replace(FINGER, calibration=turned(np.eye(2) / 280.0))
    found = effective_limits(ours, finger)
    current = limit(found, "current").value
    share = current / 1400.0
    assert 0.01 < share < 0.35, "of its stall current"
    assert limit(found, "slew").value <= share * servo_model("XL430-W250")["fastest_ticks_per_s"]
    said = str(found)
    assert (
        f"  pwm           {round(100 * share, 1):g} %" in said and "  jog_pwm       10.7 %" in said
    )
    assert "  current " not in said and "  jog_current " not in said
    with Controller(ours, found.calibration, found.table()) as robot:
        robot.engage()
        hold_for(robot, [1.0, 0.0], 3.0)
        assert robot.state == "engaged" and robot.position[0] == pytest.approx(
            HOME + 280.0, abs=5.0
        )
    with opened(bus.path, BAUD) as back:
        assert registers(back, 1)["goal_pwm"] == int(885 * share)
    with Jog(ours) as jog:
        jog.by(0, 100, Held())
    with opened(bus.path, BAUD) as back:
        assert registers(back, 1)["goal_pwm"] == int(885 * 150.0 / 1400.0)
    bus.unplug()


def test_a_file_allows_no_tension_that_its_model_does_not(tmp_path):
    """Neither a limit that is left out nor a simulated one that was edited raises what pulls a
    tendon.
    """
    bundle = save_bundle(replace(FINGER, calibration=turned(np.eye(2) / 280.0)), tmp_path / "b")
    text = (bundle / "safety.toml").read_text()
    usual = limit(effective_limits(rig(), load_bundle(bundle)), "current").value
    silent = re.sub(r"\n\[tendon\]\ntension_n = .*\n", "\n", text)
    assert silent != text
    (bundle / "safety.toml").write_text(silent)
    assert limit(effective_limits(rig(), load_bundle(bundle)), "current").value == pytest.approx(
        usual, abs=0.5
    )
    edited = re.sub(r"(\[simulated\].*\n)tension_n = .*", r"\1tension_n = 300.0", text)
    edited = re.sub(r"(\[tendon\]\n)tension_n = .*", r"\1tension_n = 80.0", edited)
    (bundle / "safety.toml").write_text(edited)
    with pytest.raises(
        BundleError, match=r"tension_n = 80, allowed is up to 25\.\d* N, 3 times what the model"
    ):
        effective_limits(rig(), load_bundle(bundle))
    (bundle / "safety.toml").write_text(
        re.sub(r"(\[tendon\]\n)tension_n = .*", r"\1tension_n = 20.0", text)
    )
    assert (
        usual < limit(effective_limits(rig(), load_bundle(bundle)), "current").value < 1.7 * usual
    ), "as its user knows"


def test_a_ceiling_of_hot_alone_is_one_of_warm_too(tmp_path):
    calibrated = replace(FINGER, calibration=turned(np.eye(2) / 280.0))
    for values, warm, by in (
        ((("hot", 50.0),), 40.0, "rig.toml"),
        ((("hot", 79.0),), 55.0, "the servo's data"),
        ((("hot", 50.0), ("warm", 45.0)), 45.0, "rig.toml"),
    ):
        found = effective_limits(rig(values), calibrated)
        limits = {one.name: one for one in found.servos[0]}
        assert (limits["warm"].value, limits["warm"].by) == (warm, by)
        assert limits["hot"].value <= 65.0, "a servo's own data is never passed"
        found.table()
    rig((("hot", 50.0), ("warm", 60.0))).write(tmp_path / "rig.toml")
    with pytest.raises(ServoError, match="ceiling: warm = 60, expected at most hot = 50 °C"):
        read_rig(tmp_path / "rig.toml")


def test_the_loop_keeps_to_the_limits_of_the_finger():
    """Through the process: a window, a slew and a hold that only safety.toml asks for."""
    safety = replace(FINGER.safety, high=(0.8, 16.0), hold=0.3)
    finger = replace(FINGER, safety=safety, calibration=calibration())
    with emulated_rig() as (bus, rig, _):
        rig = replace(rig, ceiling=Ceiling((("current_mA", 500.0),)))
        found = effective_limits(
            rig, replace(finger, safety=replace(safety, tension=None)), rate=200.0
        )
        with Controller(rig, found.calibration, found.table()) as robot:
            assert robot.engage() == pytest.approx([0.0, 0.0])
            assert robot.target([2.0, 0.0]) == pytest.approx([0.8, 0.0], abs=0.01)
            hold_for(robot, [2.0, 0.0], 1.5)
            assert angles(bus)[0] - HOME == pytest.approx(0.8 * 280, abs=3.0), (
                "3.2 mm were allowed without"
            )
            robot.release()
        assert not torque(bus)


def test_a_calibration_is_turned_by_whole_turns_alone():
    map_ = calibration()
    assert map_.turned([HOME + 2000, HOME - 2000]) is map_
    assert isinstance(map_.turned([HOME + 4000, HOME]), Calibration)
    np.testing.assert_array_equal(
        map_.turned([HOME + 4000, HOME - 9000]).home, [HOME + 4096, HOME - 8192]
    )
