"""A finger behind emulated servos: its laws as they stream, its camera, its faults."""

import subprocess
import time

import numpy as np
import pytest
from command import SOFTMAP
from emulated_robot import emulated, say
from rigs import HOME, calibration, emulated_rig
from waiting import hold_for, until

from softmap_edge import SoftmapError, _core, builtin_model, load_bundle
from softmap_edge.cli import main
from softmap_edge.robot.commissioning import setup
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.emulated.finger import FRAMES, EmulatedFinger, hidden_laws
from softmap_edge.robot.emulated.laws import LAWS, Law
from softmap_edge.robot.emulated.named_laws import NAMED
from softmap_edge.robot.emulated.streamed_laws import streamed
from softmap_edge.robot.emulated.tendon_load import NOMINAL, tendon_loads
from softmap_edge.robot.link.frames import on_host
from softmap_edge.robot.servo.bus import opened
from softmap_edge.robot.servo.loop_limits import loop_limits, servo_limits
from softmap_edge.robot.servo.rig import read_rig


@pytest.fixture(scope="module")
def model():
    return builtin_model()


@pytest.mark.parametrize(
    "name", [n for n, law in {**LAWS, **NAMED}.items() if law.command is not Law.command]
)
def test_a_stream_of_a_law_is_its_record(name):
    (law,) = hidden_laws([name], 2, 5)
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.002, 0.02, 800))
    u = np.stack([3 * np.sin(1.1 * t), 2 * np.sin(0.7 * t + 1)], axis=1)
    step = streamed([law])
    np.testing.assert_allclose([step(now, x) for now, x in zip(t, u)], law.command(t, u), atol=1e-9)


def test_what_moves_no_tendon_cannot_hide():
    for name in ("gravity", "mount", "nothing"):
        with pytest.raises(SoftmapError):
            hidden_laws([name], 2, 0)


def test_a_camera_sees_the_finger_that_packets_drive(model):
    laws = hidden_laws(["backlash"], 2, 1)
    with (
        emulated_rig() as (bus, rig, limits),
        EmulatedFinger(bus, model, calibration(), laws, seed=4) as finger,
        Controller(rig, calibration(), limits) as robot,
    ):
        robot.engage()
        hold_for(robot, [1.8, -1.2], 2.5)
        frames, (_, acting) = finger.seen(), finger.acting()
    stamps = np.array([frame.stamp for frame in frames])
    host = on_host(frames)
    assert np.ptp(stamps) * FRAMES * 0.8 < len(frames) <= np.ptp(stamps) * FRAMES * 1.1 + 2
    assert abs(stamps[0] - host[0]) > 1.0 and (np.diff(stamps) > 0).all()
    assert all(frame.arrived > when for frame, when in zip(frames, host - 1e-3))
    # Play: what acts ends short of what was asked, by half the play of each channel.
    half = np.array(laws[0].half_width_mm)
    np.testing.assert_allclose(acting[-1], [1.8 - half[0], -1.2 + half[1]], atol=0.02)
    tip = np.mean([frame.points[model.tip_indices].mean(axis=0) for frame in frames[-10:]], axis=0)
    assert np.linalg.norm(tip - model.tip(acting[-1:])[0]) < 0.03


def test_a_reversed_and_a_broken_tendon_show(model):
    with emulated_rig() as (bus, rig, limits), EmulatedFinger(bus, model, calibration()) as finger:
        bus.damage(0, reversed=True)
        bus.damage(1, torn=True)
        with Controller(rig, calibration(), limits) as robot:
            robot.engage()
            hold_for(robot, [1.5, 1.5], 2.0)
            _, acting = finger.acting()
    np.testing.assert_allclose(acting[-1], [-1.5, 0.0], atol=0.02)


def test_a_second_fault_leaves_the_first_and_mending_ends_both(model):
    with emulated_rig() as (bus, rig, limits), EmulatedFinger(bus, model, calibration()) as finger:

        def driven():
            with Controller(rig, calibration(), limits) as robot:
                robot.engage()
                hold_for(robot, [1.5, 1.5], 2.0)
                drawn = []

                def answered():
                    """A busy computer may miss an answer; the command is sent on meanwhile."""
                    robot.target([1.5, 1.5])
                    drawn[:] = robot.report["current_mA"]
                    return None not in drawn

                until(answered)
                return finger.acting()[1][-1], drawn

        bus.damage(0, torn=True)
        bus.damage(0, uncapped=True)
        bus.damage(1, reversed=True)
        bus.damage(1, uncapped=True)
        acting, drawn = driven()
        np.testing.assert_allclose(acting, [0.0, -1.5], atol=0.02)
        assert abs(drawn[0]) < 5.0 < abs(drawn[1]), "a torn tendon asks for nothing"
        for servo in (0, 1):
            bus.damage(servo, torn=False, reversed=False, uncapped=False)
        acting, drawn = driven()
        np.testing.assert_allclose(acting, [1.5, 1.5], atol=0.02)
        assert min(map(abs, drawn)) > 5.0


def test_tendons_ask_for_what_the_model_says(model):
    known = next(entry for entry in _core.servo_models() if entry["name"] == "XL330-M288")
    (first, second) = tendon_loads(model, calibration(), (-2800.0, 2800.0), known)
    ticks, drawn = np.array(first).T
    assert ticks[0] == HOME - 2800 and ticks[-1] == HOME + 2800
    assert np.all(np.diff(drawn) > -1.0) and abs(np.interp(HOME, ticks, drawn)) < 1.0
    np.testing.assert_allclose(drawn, -drawn[::-1], atol=1.0)
    # 10 mm of the first pair: its one tendon pulls with what the simulation says, on a spool of
    # 1/280 mm a tick.
    pull = model.arrays.prior.tensions().evaluate(np.array([[10.0, 0.0]]))[0]
    torque = max(pull) * 1e-3 * 4096 / (2 * np.pi * 280)
    assert drawn[-1] == pytest.approx(torque / 0.52 * 1470.0, rel=1e-3) and 20 < drawn[-1] < 60
    np.testing.assert_allclose(np.array(second), np.array(first), atol=1.0)
    # Tensions are the model's: without them a nominal stiffness stands in.
    (nominal, _) = tendon_loads(
        model.with_structure(cables=None), calibration(), (-2800.0, 2800.0), known
    )
    assert nominal[-1][1] == pytest.approx(NOMINAL * 10 * 4096 / (2 * np.pi * 280) * 1470.0 / 520.0)


def test_a_complete_robot_is_emulated_by_one_command(tmp_path, model):
    with emulated(tmp_path, "--hidden", "backlash", "--strength", "0.5", "--seed", "3") as (
        process,
        reported,
        camera,
    ):
        assert (
            reported["schema"] == "softmap.emulated/1"
            and reported["ready"]
            and reported["hidden"] == ["backlash"]
        )
        rig, made = read_rig(tmp_path / "rig.toml"), load_bundle(tmp_path / "bundle")
        assert (
            rig.port == reported["port"]
            and [servo.home for servo in rig.servos] == made.calibration.home.tolist()
        )
        for servo in rig.servos:
            with opened(rig.port, rig.baud) as bus:
                number, firmware = bus.ping(servo.id)
                values = setup.registers(bus, servo.id)
            assert (
                setup.complaints(
                    setup.ServoState(rig.port, rig.baud, servo.id, number, firmware), values
                )
                == []
            )
        until(lambda: camera.taken > 5)
        frames = camera.seen()
        assert frames[-1].points.shape == model.rest.shape
        assert (
            np.abs(
                np.mean([f.points for f in frames], axis=0)
                - np.reshape(model.prior.evaluate(np.zeros((1, 2))), (-1, 3))
            ).max()
            < 0.5
        )
        servos = [
            servo_limits(servo.model, servo.home, made.calibration.window) for servo in rig.servos
        ]
        with Controller(rig, made.calibration, loop_limits(servos, 100.0)) as robot:
            robot.engage()
            hold_for(robot, [3.0, 0.0], 2.5)
            tip = camera.seen()[-1].points[model.tip_indices].mean(axis=0)
            assert np.linalg.norm(tip - model.tip(np.array([[3.0, 0.0]]))[0]) < 5.0
            assert np.linalg.norm(tip - model.tip(np.zeros((1, 2)))[0]) > 5.0
            say(process, "reversed 0")
            hold_for(robot, [3.0, 0.0], 0.5)
            away = (
                camera.seen()[-1].points[model.tip_indices].mean(axis=0)
                - model.tip(np.zeros((1, 2)))[0]
            )
            assert away @ (tip - model.tip(np.zeros((1, 2)))[0]) < 0
        say(process, "blind 1")
        until(lambda: time.monotonic() - camera.seen()[-1].arrived > 0.5)
        say(process, "blind 0")
        until(lambda: time.monotonic() - camera.seen()[-1].arrived < 0.3)
        say(process, "blind 2")
        assert "no such fault" in process.stderr.readline()
        say(process, "reversed 7")
        assert "no servo 7; there are 0 to 1" in process.stderr.readline()


def test_exchanged_ids_are_exchanged(tmp_path):
    with emulated(tmp_path, "--fresh") as (process, reported, _):
        assert not reported["ready"] and read_rig(tmp_path / "rig.toml").servos[0].home is None
        with opened(reported["port"], reported["baud"]) as bus:
            assert setup.registers(bus, 1)["operating_mode"] == 3
            say(process, "heat 0 60")
            until(lambda: setup.registers(bus, 1)["present_temperature"] > 50)
            say(process, "swap 0 1")
            until(lambda: setup.registers(bus, 2)["present_temperature"] > 50)
            assert setup.registers(bus, 1)["present_temperature"] < 40


def test_what_an_emulated_robot_cannot_be_is_reported(capsys, tmp_path):
    for more, line in (
        (["--hidden", "gravity"], "moves no tendon"),
        (["--strength", "-1"], "more than 0 and up to 10"),
        (["--stream", "udp://x"], "is not an address"),
        (["--key", "k"], "give --stream"),
        (["--servos", "2", "--hidden", "backlash"], "--hide: it needs a finger"),
        (["--rig", str(tmp_path / "rig.txt")], "saved as .toml"),
        (["--baud", "12345"], "has no rate of 12345 baud"),
    ):
        assert main(["servo", "emulate", *more]) == 2
        assert line in capsys.readouterr().err


@pytest.mark.parametrize("servos", [[], ["--servos", "1"]])
def test_an_emulated_robot_whose_input_ends_says_why_it_is_gone(servos):
    argv = [SOFTMAP, "servo", "emulate", *servos]
    done = subprocess.run(
        argv, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0 and "standard input has ended" in done.stderr, done
