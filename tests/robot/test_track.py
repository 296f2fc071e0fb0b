"""Figures tracked on an emulated robot: with what it hides and without, through what was found,
with feedback.
"""

import argparse
import json
import os
import resource
import signal
import subprocess
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from command import SOFTMAP, interruptible
from rigs import calibration, torque
from waiting import until

from softmap_edge import Run, SoftmapError, _core, builtin_model, diagnose, save_bundle
from softmap_edge.cli import main
from softmap_edge.commands.experiment import record_arguments
from softmap_edge.commands.servo.emulate import emulate_arguments, streaming
from softmap_edge.commands.teleop import teleop_arguments
from softmap_edge.commands.track import track_arguments
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.control.recording import read_recording
from softmap_edge.robot.drive.response import fit_response, response_of
from softmap_edge.robot.drive.track import _Feedback, course, track
from softmap_edge.robot.emulated.finger import ANSWER, emulated_robot, hidden_laws
from softmap_edge.robot.link.frames import Frame
from softmap_edge.robot.link.points import PointReceiver, PointSender
from softmap_edge.robot.motion.kinematics import Kinematics
from softmap_edge.robot.servo.loop_limits import ACCELERATION, SLEW
from softmap_edge.run.protocol import standard_protocol

MAP = replace(calibration(), window=None)
LIMITS = {"slew": [SLEW] * 2, "acceleration": [ACCELERATION] * 2, "calibration": MAP}
HIDDEN = ["backlash", "creep"]
PATIENT = 30.0  # s


@pytest.fixture(scope="module")
def model():
    return builtin_model()


def test_the_answer_of_servos_is_found_from_goals_and_positions():
    t = np.arange(0.0, 4.0, 0.01)
    goal = 2000 + np.stack([140 * np.sin(6 * t), 140 * np.sin(8 * t + 1)], axis=1)
    chain = _core.Chain(["latency", "lag"], 2)
    position = chain.rollout(np.array([[0.123, 0.07]]), goal, t)[0] + 3.0
    position = np.round(position + np.random.default_rng(0).normal(0, 1, goal.shape))
    delay, lag = fit_response(t, goal, position)
    assert abs(delay - 0.123) < 0.004 and abs(lag - 0.07) < 0.006
    assert fit_response(t, 0 * goal, position) is None


def test_a_course_goes_from_rest_through_the_figure_within_the_limits(model):
    kinematics = Kinematics(model, axes="xy")
    made = course(kinematics, "H", amplitude=10.0, duration=5.0, rate=50.0, **LIMITS)
    plan, rest = made.plan, model.tip(np.zeros((1, 2)))[0]
    np.testing.assert_allclose(plan.targets[0], rest, atol=1e-6)
    figure = plan.targets[made.counts] - rest
    assert np.abs(figure[:, 1]).max() == pytest.approx(10.0, abs=0.05) and np.ptp(figure[:, 2]) == 0
    assert plan.unreachable.max() < 0.01 and plan.distance.max() < 0.01
    speed = np.abs(np.diff(MAP.ticks(plan.commands), axis=0)) * 50.0
    assert speed.max() < SLEW
    hasty = course(kinematics, "H", amplitude=10.0, duration=0.5, rate=50.0, **LIMITS)
    assert (
        hasty.quickest > 0.5
        and hasty.plan.t[-1] - hasty.plan.t[hasty.counts][0] >= hasty.quickest - 0.03
    )


def found(model, laws):
    """Return the model with what a diagnosis of a recording of that finger names."""
    p = standard_protocol(2)
    acting = p.command
    for law in laws:
        acting = law.command(p.t, acting)
    seen = np.stack([np.interp(p.t_seen, p.t, column) for column in acting.T], axis=1)
    points = np.asarray(model.prior.evaluate(seen)).reshape(len(seen), -1, 3)
    points = points + np.random.default_rng(0).normal(0, 0.1, points.shape)
    answer = diagnose(model, Run(t=p.t, command=p.command, t_seen=p.t_seen, vertices=points))
    assert {entry.name for entry in answer.effects} == set(HIDDEN)
    return answer.added(model, HIDDEN)


def tracked(model, laws, folder, name, observe=False):
    """Track an S on an emulated finger; returns the mean error, mm, and what was measured of the
    servos.
    """
    kinematics = Kinematics(model, axes="xy")
    made = course(kinematics, "S", amplitude=8.0, duration=12.0, rate=50.0, **LIMITS)
    record = folder / f"{name}.mcap"
    with (
        emulated_robot(model, MAP, laws, rate=100.0) as (_, rig, limits, finger),
        Controller(rig, MAP, limits, kinematics=kinematics, record=record) as robot,
    ):
        reported = track(robot, kinematics, made, finger.seen, observe=observe)
    assert len(reported.error) > 300
    assert read_recording(record).replay() == []
    return float(reported.error.mean()), reported.response


@pytest.mark.long
def test_through_the_found_effects_the_error_falls_and_with_feedback_further(model, tmp_path):
    laws = hidden_laws(HIDDEN, 2, 3, 0.6)
    known = found(model, laws)
    floor, response = tracked(model, [], tmp_path, "nothing hidden")
    np.testing.assert_allclose(response, ANSWER, atol=0.015)
    plain, _ = tracked(model, laws, tmp_path, "plain")
    through, _ = tracked(known, laws, tmp_path, "through")
    observed, _ = tracked(known, laws, tmp_path, "observed", observe=True)
    assert floor < 0.2 and plain > 1.5
    assert (plain - through) / (plain - floor) >= 0.6
    assert observed < through


def test_the_command_tracks_on_an_emulated_robot_and_draws(tmp_path, capsys):
    files = [str(tmp_path / name) for name in ("o.svg", "o.mcap")]
    options = ["--amplitude", "5", "--duration", "4", "--rate", "20", "--json"]
    assert main(["track", "O", "--sim", "--picture", files[0], "--record", files[1], *options]) == 0
    reported = json.loads(capsys.readouterr().out)
    assert (
        reported["schema"] == "softmap.track/1"
        and reported["waypoints"] == 81
        and reported["seen_mm"]["mean"] < 0.3
    )
    assert reported["hidden"] == [] and reported["effects"] == []
    assert (tmp_path / "o.svg").read_bytes().startswith(b"<?xml") and read_recording(
        files[1]
    ).periods
    assert (tmp_path / "o.svg").stat().st_size < 500_000


BLOCK = "next --standard --out next.csv"


@pytest.mark.parametrize(
    ("duration", "said"),
    [("2", ["frames are too few for a diagnosis, which needs 60 or more", f"next: softmap {BLOCK}"]),
     ("5", ["o.seen: written", "next: softmap diagnose o.mcap"])],
)  # fmt: skip
def test_the_last_line_is_a_command_that_can_succeed(duration, said, tmp_path, monkeypatch, capsys):
    """A record of too few frames leads to the block to record, not to a diagnosis that must
    fail.
    """
    monkeypatch.chdir(tmp_path)
    options = ["--amplitude", "5", "--duration", duration, "--rate", "20", "--record", "o.mcap"]
    assert main(["track", "O", "--sim", *options]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-2].endswith(said[0]) and lines[-1] == said[1]
    assert main(lines[-1].removeprefix("next: softmap ").split()) == 0


def test_a_plan_is_drawn_with_its_commands_and_a_workspace_from_its_rest(tmp_path, capsys):
    plan, reach = tmp_path / "plan.svg", tmp_path / "reach.svg"
    assert (
        main(["track", "O", "--plan", "--amplitude", "5", "--rate", "20", "--picture", str(plan)])
        == 0
    )
    assert "were asked for" not in capsys.readouterr().out
    assert (
        main(["track", "O", "--plan", "--amplitude", "5", "--rate", "20", "--duration", "0.2"]) == 0
    )
    assert "0.2 s were asked for: slew and acceleration" in capsys.readouterr().out
    assert "command, mm" in plan.read_text() and "edge of reach" not in plan.read_text()
    assert main(["track", "--workspace", "--reach", "60", "0", "60", "--picture", str(reach)]) == 0
    assert "edge of reach" in reach.read_text() and "tip off by" not in plan.read_text()
    assert max(file.stat().st_size for file in (plan, reach)) < 500_000


def test_compensating_effects_that_the_finger_lacks_prints_a_warning(model, tmp_path, capsys):
    bundle = save_bundle(model.with_effects(["backlash"], {"backlash.gap": 1.0}), tmp_path / "play")
    options = [
        "--bundle",
        str(bundle),
        "--sim",
        "--amplitude",
        "3",
        "--duration",
        "3",
        "--rate",
        "20",
    ]
    assert main(["track", "O", *options]) == 0
    assert (
        "no hidden effect, so compensating backlash makes tracking worse" in capsys.readouterr().out
    )


def test_the_command_plans_without_a_robot_and_says_what_is_out_of_reach(capsys):
    assert main(["track", "circle", "--plan", "--amplitude", "70"]) == 0
    said = capsys.readouterr().out
    assert "out of reach" in said and "no camera" not in said


@pytest.mark.parametrize("word", ["--hidden", "--hide"])
def test_what_a_finger_hides_is_named_by_one_word_in_every_command(word):
    for arguments, others in (
        (track_arguments, ["S", "--sim"]),
        (teleop_arguments, ["--sim"]),
        (emulate_arguments, []),
        (record_arguments, ["c.csv", "--out", "r.npz"]),
    ):
        parser = argparse.ArgumentParser()
        arguments(parser)
        reported = vars(parser.parse_args([*others, word, "backlash,creep"]))
        assert "backlash,creep" in reported["hide"]


@pytest.mark.parametrize(
    "options, said",
    [
        (["Q", "--plan"], "no figure 'Q'"),
        (["S", "--plan", "--axes", "x"], "a figure needs two"),
        (["S", "--plan", "--amplitude", "-3"], "an amplitude of -3"),
        (["S", "--plan", "--rate", "0"], "waypoints a second"),
        (["S", "--plan", "--observe"], "--observe needs eyes"),
        (["S", "--sim", "--hidden", "gravity"], "moves no tendon"),
        (["S", "--rig", "none.toml"], "no calibration"),
    ],
)
def test_what_cannot_be_tracked_is_refused(options, said, capsys):
    assert main(["track", *options]) != 0
    assert said in capsys.readouterr().err


def test_a_computer_that_takes_long_to_work_out_the_answer_of_the_servos_drives_on(
    model, tmp_path, monkeypatch
):
    """Nothing that is computed while torque is on keeps the program from sending."""

    def slowly(periods):
        time.sleep(3.0)
        return response_of(periods)

    monkeypatch.setattr("softmap_edge.robot.drive.track.response_of", slowly)
    kinematics = Kinematics(model, axes="xy")
    made = course(kinematics, "O", amplitude=3.0, duration=2.0, rate=20.0, **LIMITS)
    with (
        emulated_robot(model, MAP, rate=100.0) as (_, rig, limits, finger),
        Controller(rig, MAP, limits, kinematics=kinematics, record=tmp_path / "r.mcap") as robot,
    ):
        reported = track(robot, kinematics, made, finger.seen)
        held = [p for p in read_recording(tmp_path / "r.mcap").periods if p["state"] == "hold"]
    np.testing.assert_allclose(reported.response, ANSWER, atol=0.015)
    assert reported.t[-1] > made.plan.t[-1] - 0.1, "all of the figure was seen"
    assert len(held) < 100, "a busy machine may hold it for a moment"


def test_ctrl_c_says_that_torque_is_off_and_what_was_kept(tmp_path):
    record = tmp_path / "r.mcap"
    process = interruptible("track", "O", "--sim", "--record", str(record), "--duration", "60")
    until(
        lambda: process.poll() is not None or (record.exists() and record.stat().st_size > 50_000)
    )
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=PATIENT)[1]
    assert process.returncode == 130 and f"torque is off; {record} keeps what was driven" in said, (
        said
    )
    assert read_recording(record).replay() == []


def test_a_recording_that_breaks_off_measures_nothing(model, tmp_path, monkeypatch, capsys):
    """An unmeasured delay is not previewed as 0 s, and no figure is driven with it."""
    monkeypatch.chdir(tmp_path)
    argv = [SOFTMAP, "track", "circle", "--sim", "--duration", "6", "--record", "t.mcap"]

    def little():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))

    done = subprocess.run(argv, capture_output=True, text=True, preexec_fn=little)
    assert done.returncode == 2 and "the recording broke off" in done.stderr, done
    assert "previewed" not in done.stdout and "written" not in done.stdout


@pytest.mark.parametrize(
    "option", [["--record", "x.mcap"], ["--seed", "3"], ["--key", "f"], ["--late", "0.1"]]
)
def test_a_plan_that_drives_nothing_takes_no_option_of_what_is_driven(option, capsys):
    assert main(["track", "S", "--plan", *option]) == 2
    assert f"{option[0]} needs a robot, and --plan moves none" in capsys.readouterr().err


def test_a_figure_that_is_no_file_is_refused_at_once(tmp_path, capsys):
    os.mkfifo(tmp_path / "f.csv")
    assert main(["track", str(tmp_path / "f.csv"), "--plan"]) == 2
    assert "f.csv: no file" in capsys.readouterr().err
    assert main(["track", "S", "--plan", "--amplitude", "1e308"]) == 2
    assert "up to 10000" in capsys.readouterr().err
    assert main(["track", "--workspace", "--reach", "1e308", "0", "0"]) == 2
    assert "--reach [1e+308, 0.0, 0.0]" in capsys.readouterr().err


def test_feedback_without_a_camera_and_tracking_without_a_record_are_refused(model, tmp_path):
    kinematics = Kinematics(model, axes="xy")
    made = course(kinematics, "O", amplitude=5.0, duration=2.0, rate=20.0, **LIMITS)
    with (
        emulated_robot(model, MAP) as (_, rig, limits, finger),
        Controller(rig, MAP, limits) as robot,
        pytest.raises(SoftmapError, match="records"),
    ):
        track(robot, kinematics, made, finger.seen)


def test_feedback_fades_while_the_tip_is_not_seen(model):
    kinematics = Kinematics(model, axes="xy")
    plan = course(kinematics, "S", amplitude=8.0, duration=12.0, rate=50.0, **LIMITS).plan
    rest, tip, u = np.asarray(model.rest), model.tip(np.zeros((1, 2)))[0], np.zeros(2)

    def frame(t, off):
        target = np.array([np.interp(t, plan.t, column) for column in plan.targets.T])
        return Frame(t, t, rest + target - tip + off)

    seen, unseen = _Feedback(kinematics, plan, 0.24, 0.0), _Feedback(kinematics, plan, 0.24, 0.0)
    frames = [frame(t, [1.0, 0.0, 0.0]) for t in np.arange(0.0, 1.0, 1 / 30)]
    blank = [Frame(one.stamp, one.arrived, np.full(rest.shape, np.nan)) for one in frames]
    size = {}
    for t in np.arange(0.0, 6.0, 0.01):
        size[round(t, 2)] = np.linalg.norm(
            seen(u, t, 0.0, [one for one in frames if one.arrived <= t])
        )
        assert np.linalg.norm(unseen(u, t, 0.0, [one for one in blank if one.arrived <= t])) == 0.0
    assert size[1.0] > 0.1 and size[1.4] == pytest.approx(size[1.0], rel=1e-6)
    assert size[2.5] < 0.5 * size[1.0] and size[5.9] < 0.02 * size[1.0]


def test_a_camera_that_goes_and_comes_while_a_figure_is_tracked(model, tmp_path, capsys):
    """The figure is led to its end, torque is off, and what was not seen is reported."""
    save_bundle(replace(model, calibration=calibration()), tmp_path / "bundle")
    with PointReceiver("", 0) as free:
        port = free.port
    argv = [
        "track",
        "S",
        "--bundle",
        str(tmp_path / "bundle"),
        "--rig",
        str(tmp_path / "rig.toml"),
        "--observe",
    ]
    argv += ["--camera", f"udp://:{port}", "--duration", "12", "--amplitude", "3", "--json"]
    with (
        emulated_robot(model, calibration(), rate=100.0) as (bus, rig, _, finger),
        PointSender("127.0.0.1", port) as sender,
        streaming(finger, [sender]),
    ):
        rig.write(tmp_path / "rig.toml")
        timers = [
            threading.Timer(13.0, finger.blind, [True]),
            threading.Timer(17.0, finger.blind, [False]),
        ]
        for timer in timers:
            timer.start()
        assert main(argv) == 0
        assert not torque(bus)
    reported = json.loads(capsys.readouterr().out)
    assert 1.0 < reported["unseen_s"] < 10.0 and reported["seen_mm"]["n"] > 30
    assert reported["seen_mm"]["mean"] < 1.0
