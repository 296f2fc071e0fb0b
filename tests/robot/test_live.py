"""`softmap compare --live`: a growing recording followed, a model's error while another process
drives and is seen.
"""

import json
import math
import signal
import threading
import time

import numpy as np
import pytest
from command import interruptible
from emulated_robot import emulated
from rigs import calibration, emulated_rig
from waiting import until

from softmap_edge import builtin_model, load_bundle
from softmap_edge.cli import main
from softmap_edge.comparison.comparison import aligned
from softmap_edge.comparison.live import KEPT, Live
from softmap_edge.errors import ComparisonError, RunError
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.control.follow import Following
from softmap_edge.robot.control.recording import read_recording
from softmap_edge.robot.link.frames import Frame, HostClock
from softmap_edge.robot.servo.loop_limits import loop_limits, servo_limits
from softmap_edge.robot.servo.rig import read_rig
from softmap_edge.run.run import Run


def with_map():
    """The built-in model and a map of its servos."""
    from dataclasses import replace

    return replace(builtin_model(), calibration=calibration())


def drive(rig, limits, made, file, seconds):
    """Swing to and fro while the loop records."""
    with Controller(rig, made, limits, record=file) as robot:
        robot.engage()
        begun = time.monotonic()
        while (t := time.monotonic() - begun) < seconds:
            robot.target([1.2 * np.sin(1.5 * t), 0.0])
            time.sleep(0.02)


def test_a_growing_recording_is_followed_to_its_last_period(tmp_path):
    file, periods = tmp_path / "loop.mcap", []
    with emulated_rig() as (_, rig, limits):
        thread = threading.Thread(target=drive, args=(rig, limits, calibration(), file, 1.5))
        thread.start()
        until(file.exists)
        loop, parts = Following(file), 0
        while thread.is_alive():
            new = loop.new()
            periods, parts = periods + new, parts + bool(new)
            time.sleep(0.05)
        thread.join()
        periods += loop.new()
    whole = read_recording(file)
    assert loop.ended and loop.setup == whole.setup and parts > 2
    assert periods == whole.periods


def test_any_cut_gives_what_is_complete_and_damage_is_reported(tmp_path):
    file = tmp_path / "loop.mcap"
    with emulated_rig() as (_, rig, limits):
        drive(rig, limits, calibration(), file, 0.3)
    whole, content = read_recording(file).periods, file.read_bytes()
    rng = np.random.default_rng(0)
    cut = tmp_path / "cut.mcap"
    for size in rng.integers(0, len(content), 60):
        cut.write_bytes(content[:size])
        loop = Following(cut)
        assert whole[: len(found := loop.new())] == found
        with cut.open("ab") as more:
            more.write(content[size:])
        assert found + loop.new() == whole and loop.ended
    for _ in range(300):
        damaged = bytearray(content)
        for place in rng.integers(0, len(content), 3):
            damaged[place] = rng.integers(256)
        cut.write_bytes(damaged)
        loop = Following(cut)
        try:
            assert all(isinstance(period, dict) for period in loop.new())
        except RunError as fault:
            assert "record again" in str(fault) or "no recording" in str(fault)
    begun = content[:8]
    for content, line in (
        (b"PK\x03\x04" * 9, "no recording of a control loop"),
        (begun + b"\xff" * 20, "damaged"),
    ):
        cut.write_bytes(content)
        with pytest.raises(RunError, match=line):
            Following(cut).new()
    with pytest.raises(RunError, match="No such file"):
        Following(tmp_path / "none.mcap")


def periods(t, u):
    """Periods of a loop whose servos stand at commands u (T, 2) at t (T,) s."""
    return [
        {"now": int(s * 1e9), "position": row.tolist()} for s, row in zip(t, calibration().ticks(u))
    ]


def test_the_error_is_that_of_the_frames_and_memory_is_right():
    model = with_map().with_effects(["backlash"], {"backlash.gap": 1.0})
    t = 500.0 + np.arange(0.0, 20.0, 0.01)
    u = np.stack([3 * np.sin(t), np.zeros_like(t)], axis=1)
    live, plain = Live(model), Live(with_map())
    stamps = np.arange(t[0] + 0.5, t[-1], 0.1)
    half = np.zeros(2)
    play = []
    for row in u:  # play of 1 mm, by hand
        half = np.clip(half if play else row, row - 0.5, row + 0.5)
        play.append(half)
    acting = np.stack([np.interp(stamps, t, column) for column in np.array(play).T], axis=1)
    points = np.asarray(model.prior.evaluate(acting)).reshape(len(stamps), -1, 3)
    frames = [
        Frame(s - 480.0, s, p + np.array([0.3 * (s > 515.0), 0, 0])) for s, p in zip(stamps, points)
    ]
    for k in range(0, len(t), 50):
        for one in (live, plain):
            one.drove(periods(t[k : k + 50], u[k : k + 50]))
            one.saw([frame for frame in frames if frame.arrived <= t[min(k + 49, len(t) - 1)]])
            now = one.compared()
        if 505.0 < t[k] < 514.0:
            assert live.compared().whole_mm < 0.02  # ticks are integers
    reported, missed = live.compared(), plain.compared()
    assert (
        reported.frames == missed.frames == pytest.approx(len(frames), abs=2)
        and now.frames == reported.frames
    )
    assert reported.now_mm == pytest.approx(0.3, abs=0.01) and reported.recent_mm == pytest.approx(
        0.3, abs=0.02
    )
    assert reported.whole_mm == pytest.approx(0.3 * math.sqrt(5 / 20), abs=0.02)
    assert missed.whole_mm > 0.8 > 4 * reported.whole_mm
    assert json.loads(json.dumps(reported.to_dict()))["schema"] == "softmap.live/1"


EFFECTS = {
    "memory": ["backlash", "creep", "latency"],
    "all stages": ["gain", "hysteresis", "slack", "gravity", "mount", "camera_drift"],
    "a clock that is ahead": ["lag", "clock_shift"],
    "none": [],
}
NUMBERS = {
    "backlash.gap": 1.0,
    "latency.delay": 0.12,
    "lag.tau": 0.1,
    "clock_shift.late": -0.3,
    "mount.shift_x": 1.0,
    "camera_drift.shift_x": 1.0,
}


@pytest.mark.parametrize("names", EFFECTS.values(), ids=EFFECTS)
def test_what_is_reported_while_it_runs_is_the_error_of_the_complete_run(names):
    model = with_map()
    names = [name for name in names if not model.missing_for(name)]
    chain = model.with_effects(names, {}).chain
    start = dict(zip(chain.labels, chain.start)) | {
        k: v for k, v in NUMBERS.items() if k in chain.labels
    }
    model = model.with_effects(names, start)
    t = np.arange(0.0, KEPT + 20.0, 0.02)
    u = np.stack([3 * np.sin(0.7 * t) * (t < 30) + (t >= 30), np.cos(0.4 * t)], axis=1)
    ticks = calibration().ticks(u)
    stamps = np.arange(0.5, t[-1] - 0.5, 0.25)
    noise = np.random.default_rng(0).normal(0, 0.3, (len(stamps), *model.rest.shape))
    points, whole = model.rest + noise, []
    run = Run(
        t=t, ticks=ticks, present_ticks=ticks, t_seen=stamps, vertices=points, robot=model.robot
    )
    predicted, seen, visible = aligned(model, run)
    whole = np.sqrt(np.sum((predicted - seen) ** 2) / visible.sum())
    live = Live(model)
    reported = periods(t, u)
    for begin, end in zip(range(0, len(t), 47), range(47, len(t) + 47, 47)):
        live.drove(reported[begin:end])
        live.saw(
            [
                Frame(s + 1000.0, s, p)
                for s, p in zip(stamps, points)
                if s <= t[min(end, len(t)) - 1]
            ]
        )
        live.compared()
    now = live.compared()
    assert now.frames == len(stamps) and now.left_out == 0
    assert now.whole_mm == pytest.approx(whole, rel=1e-6)  # ns of the recording's clock
    if "backlash" in names:  # memory that begins again at what is still kept would be another's
        late = Live(model)
        late.drove(reported[len(t) // 2 :])
        late.saw([Frame(s + 1000.0, s, p) for s, p in zip(stamps, points)])
        assert len(live._t) < len(t) and abs(late.compared().recent_mm - now.recent_mm) > 0.01


def test_a_clock_keeps_a_few_numbers_of_many_frames():
    rng = np.random.default_rng(2)
    taken = np.arange(0.0, 900.0, 1 / 30)
    arrived = taken + 0.01 + rng.exponential(0.01, taken.size)
    frames = [Frame(s * (1 + 50e-6) + 7.0, a, np.zeros((1, 3))) for s, a in zip(taken, arrived)]
    clock = HostClock(late=0.01)
    for k in range(0, len(frames), 1000):
        assert len(clock.add(frames[: k + 1000])) == len(frames[k : k + 1000])
    assert np.abs(clock.times(frames) - taken).max() < 1e-3
    assert len(clock._lower) < 100 and len(clock._parts) <= 91


def test_what_was_not_seen_counts_nothing_and_other_robots_are_reported():
    live = Live(with_map())
    t = np.arange(0.0, 2.0, 0.01)
    live.drove(periods(t, np.zeros((len(t), 2))))
    rest = builtin_model().rest
    live.saw([Frame(0.1 * k, 0.1 * k, np.full(rest.shape, np.nan)) for k in range(1, 10)])
    assert live.compared().frames == 0 and math.isnan(live.compared().whole_mm)
    assert live.compared().to_dict()["whole_mm"] is None
    live.drove([{"now": int(3e9), "position": [None, 2000]}])
    with pytest.raises(RunError, match="of 1 servos, the model takes 2"):
        live.drove([{"now": int(4e9), "position": [2000]}])
    with pytest.raises(RunError, match="damaged"):
        live.drove([{"now": None}])
    with pytest.raises(ComparisonError, match="holds no calibration"):
        Live(builtin_model())


def test_the_error_of_a_robot_in_another_process_is_reported_while_it_moves(tmp_path):
    """One process is the robot, one drives and records it, one compares; Ctrl-C ends it with a
    summary.
    """
    robot = tmp_path / "robot"
    robot.mkdir()
    file = tmp_path / "loop.mcap"
    with emulated(robot, "--hidden", "backlash", "--seed", "1") as (_, _, receiver):
        until(lambda: receiver.taken > 0)
        receiver.close()
        rig, made = read_rig(robot / "rig.toml"), load_bundle(robot / "bundle").calibration
        limits = loop_limits(
            [servo_limits(one.model, one.home, made.window) for one in rig.servos], 100.0
        )
        driver = threading.Thread(target=drive, args=(rig, limits, made, file, 8.0))
        on = [
            "--bundle",
            str(robot / "bundle"),
            "--camera",
            f"udp://:{receiver.port}",
            "--late",
            "0.02",
        ]
        with interruptible("compare", str(file), "--live", *on, "--json") as live:
            assert live.stdout.readline() == "up\n"
            driver.start()
            reported = ""
            # nothing was seen of it yet
            while '"whole_mm": null' in (line := live.stdout.readline()):
                reported += line
            reported += line + live.stdout.readline()
            assert driver.is_alive()
            live.send_signal(signal.SIGINT)
            rest, failed = live.communicate(timeout=60)
            driver.join()
    assert live.returncode == 0, failed
    lines = [json.loads(line) for line in (reported + rest).splitlines()]
    assert {line["schema"] for line in lines} == {"softmap.live/1"} and len(lines) >= 3
    last = lines[-1]
    assert last["whole"] and last["effects"] == [] and last["came"] >= last["frames"] > 30
    # its play, with 0.17 mm of noise
    assert last["whole_mm"] > 0.3 and last["worst_mm"] >= last["whole_mm"]


def test_what_cannot_be_followed_is_reported(tmp_path, capsys):
    run = str(tmp_path / "loop.mcap")
    for argv, line in (
        (["compare", run, "--live"], "--live needs eyes"),
        (["compare", "run.npz", "--live", "--camera", "udp://:9"], "give its .mcap file"),
        (["compare", "run.npz", "--camera", "udp://:9"], "go with --live"),
        (["compare", run, "--live", "--camera", "udp://:9"], "the bundle holds no calibration"),
    ):
        assert main(argv) == 2
        assert line in capsys.readouterr().err
