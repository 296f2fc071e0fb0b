"""A command file played on servos and watched by a camera: its pace, when it settles, its
diagnosis.
"""

import io
import json
import re
import signal
import subprocess
import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from bad_inputs import TABLE
from command import SOFTMAP, interruptible
from emulated_robot import emulated
from rigs import calibration, torque
from waiting import until

from softmap_edge import Run, SoftmapError, builtin_model, compare, diagnose, load_bundle
from softmap_edge.cli import main
from softmap_edge.experiment.blocks import BLOCKS, chosen, plan
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.control.recording import read_recording
from softmap_edge.robot.drive.command_file import write_commands
from softmap_edge.robot.drive.observations import SEEN
from softmap_edge.robot.drive.pace import (
    ANSWER,
    BEHIND,
    SHARE,
    SPAN,
    STILL,
    pace,
    servos_still,
    view_still,
)
from softmap_edge.robot.drive.player import Player, merged
from softmap_edge.robot.emulated.finger import emulated_robot
from softmap_edge.robot.link.frames import Frame
from softmap_edge.robot.servo.loop_limits import servo_limits
from softmap_edge.run.protocol import Limits, Protocol

MODEL = builtin_model()
SERVOS = [servo_limits("XL330-M288", 2000, (-900.0, 900.0))] * 2
WATCHDOG = 0.08  # s: without a word for 0.1 s a servo stops by itself, and looks are 0.01 s apart
TRIALS = 3
TELLING = ["small loops at two offsets", "triangles of growing size", "diagonals"]


def short(load=False):
    """Go to 2 mm, rest, go back; perhaps a weight is hung meanwhile."""
    t = np.arange(0.0, 3.0, 0.02)
    u = np.clip(np.stack([t - 0.5, 0 * t], axis=1) * 4, 0, 1.5)
    u[t > 2.0, 0] = 0.0
    looks = t[(t > 0.9) & (t < 2.0)][::12]
    return Protocol(
        "short", t, u, np.tile([0.0, 0.0, 1.0], (len(t), 1)), looks, np.full(len(looks), "rest"),
        load=np.where(t > 2.2, 10.0, 0.0) if load else None,
    )  # fmt: skip


def test_a_file_is_slowed_to_what_servos_can_do():
    made = plan(chosen(["circle", "fast and slow triangles"]), Limits.even(2, 3.0))
    paced = pace(made, calibration(), SERVOS)
    speed = np.abs(np.diff(calibration().ticks(made.command), axis=0)) / np.diff(paced.t)[:, None]
    most = min(SHARE * SERVOS[0]["slew"], BEHIND * SERVOS[0]["following"] / ANSWER)
    assert speed.max() <= most + 1e-6 and np.all(np.diff(paced.t) >= np.diff(made.t) - 1e-9)
    asked = np.abs(np.diff(calibration().ticks(made.command), axis=0)) / np.diff(made.t)[:, None]
    assert asked.max() > most
    assert len(paced.looks) == made.frames and np.all(np.diff(paced.looks) > 0)
    np.testing.assert_allclose(paced.command(paced.t[100]), made.command[100])


def test_rests_and_stops_are_where_the_file_has_them():
    paced = pace(short(load=True), calibration(), SERVOS)
    u = paced.made.command
    for k in np.flatnonzero(paced.rests):
        assert (u[k : k + 20] == u[k]).all() and (k == 0 or (u[k - 1] != u[k]).any())
    assert paced.rests.sum() == 3
    (row,) = paced.stops
    assert paced.made.t[row] == pytest.approx(2.22) and "10 g hang at the tip" in paced.stops[row]
    # A note that says it is the stop: no second one where the weight counts.
    noted = plan([BLOCKS["a known 10 g"]], Limits.even(2, 2.0))
    assert list(pace(noted, calibration(), SERVOS).stops.values()) == ["hang 10 g at the tip"]


def test_what_servos_cannot_do_is_reported_before_anything_moves():
    made = short()
    with pytest.raises(
        SoftmapError,
        match=r"row \d+: command 15 mm is tick 6200 of servo 0, its window is 1100 to 2900",
    ):
        pace(replace(made, command=10 * made.command), calibration(), SERVOS)
    with pytest.raises(SoftmapError, match="1 commands in mm, the robot takes 2"):
        pace(replace(made, command=made.command[:, :1]), calibration(), SERVOS)


def test_only_what_stands_still_is_settled():
    t = np.arange(0.0, 1.0, 0.05)
    assert servos_still([(s, [2000.0 + s, 1990.0]) for s in t], 0.95)
    assert not servos_still([(s, [2000.0 + 30 * s, 1990.0]) for s in t], 0.95)
    assert not servos_still([(s, [2000.0, 1990.0]) for s in t if s > 0.8], 0.95)
    rng = np.random.default_rng(0)

    def frames(speed, noise):
        base = MODEL.rest
        taken = np.arange(0.0, 1.0, 1 / 30)
        return [
            Frame(s, s, base + [speed * s, 0, 0] + noise * rng.normal(size=base.shape))
            for s in taken
        ]

    assert view_still(frames(0.0, 0.1), 0.0, 1.0) and view_still(frames(0.0, 0.5), 0.0, 1.0)
    assert not view_still(frames(4 * STILL / SPAN, 0.1), 0.0, 1.0)
    assert not view_still(frames(0.0, 0.1), 0.95, 1.0)
    assert not view_still([replace_points(frame) for frame in frames(0.0, 0.1)], 0.0, 1.0)


def replace_points(frame):
    return Frame(frame.stamp, frame.arrived, np.full(frame.points.shape, np.nan))


def stood(file):
    """Return for how long (s) the line to the servos stood before a fault ended a recording; 0 for
    any other cause.

    Loop and emulated servos run before all ordinary threads, but a worker of the kernel's, an
    ordinary one, carries the bytes of a pseudo-terminal between them: where the computer is busy it
    comes late, and for so long no servo is heard at all. A fault of one servo, or another finding
    of the guard, is no such fault.
    """
    periods = read_recording(file).periods
    end = next((k for k, period in enumerate(periods) if period["state"] == "fault"), None)
    if end is None or periods[end]["cause"] not in ("silent", "tripped"):
        return 0.0
    heard = [period["now"] for period in periods[:end] if set(period["position"]) != {None}]
    last = [now for now in heard if periods[end]["now"] - now < 2e9] + [periods[end]["now"]]
    return max(np.diff(last), default=0) * 1e-9


def halted(file):
    """Return the longest time (s) for which a complete recording heard no servo at all."""
    heard = [
        period["now"]
        for period in read_recording(file).periods
        if set(period["position"]) != {None}
    ]
    return max(np.diff(heard), default=0) * 1e-9


def excused(file):
    """Return whether the computer, not the robot, ended a recording: its line stood as long as a
    watchdog waits.
    """
    return stood(file) > WATCHDOG


def played(folder, made, ask, act=lambda finger: None, tell=lambda finger, share: None):
    """Play a protocol on an emulated finger; gives the player, its pace, the recording's path and
    what ended it.

    It is played again only where the recording shows that the computer stood still.
    """
    for trial in range(TRIALS):
        found = played_once(folder / f"loop{trial}.mcap", made, ask, act, tell)
        if not (found[-1] and "state fault" in found[-1]):
            return found
        assert excused(found[2]), found[-1]
    pytest.fail(f"the computer stood still in each of {TRIALS} recordings")


def played_once(file, made, ask, act, tell):
    """Play it once."""
    ended = None
    with (
        emulated_robot(MODEL, replace(calibration(), window=None), rate=100.0) as (
            bus,
            rig,
            limits,
            finger,
        ),
        Controller(rig, calibration(), limits, record=file) as robot,
    ):
        act(finger)
        paced = pace(made, calibration(), limits["servos"])
        player = Player(
            robot,
            paced,
            finger.seen,
            ask=lambda what: ask(what, bus, robot, finger),
            tell=lambda share: tell(finger, share),
        )
        try:
            player.play()
        except SoftmapError as fault:
            ended = str(fault)
    return player, paced, file, ended


def test_a_condition_is_changed_while_torque_is_off(tmp_path):
    said = []

    def ask(what, bus, robot, finger):
        said.append((what, torque(bus), robot.state))

    player, paced, file, ended = played(tmp_path, short(load=True), ask)
    assert ended is None
    assert [what.split(":")[0] for what, _, _ in said[-2:]] == ["it begins so", "from here on"]
    assert said[-2][1:] == said[-1][1:] == (False, "ready")
    run = merged(file, MODEL, paced, player.played)
    assert player.played.whole and run.frames == short().frames and set(run.block) == {"rest"}
    assert (
        run.load[0] == 0.0
        and run.load[-1] == 10.0
        and run.vertices is not None
        and run.visible.all()
    )
    # Frames of a rest show the robot where it rests: it was waited for.
    assert np.ptp(run.vertices.mean(axis=1), axis=0).max() < 0.2
    there = np.array([np.interp(run.t_seen, run.t, run.present_ticks[:, 0])])
    np.testing.assert_allclose(there, 2000 + 280 * 1.5, atol=4)


def test_a_camera_that_is_gone_ends_it_and_what_was_seen_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr("softmap_edge.robot.drive.player.LOST", 1.5)
    made = short()
    made = Protocol(
        made.name, made.t * 1.5, made.command, made.gravity, made.t_seen * 1.5, made.block
    )

    # by then frames were taken, and half a second later it still is away from home
    def tell(finger, share):
        finger.blind(share > 0.5)

    player, paced, file, ended = played(tmp_path, made, lambda *said: None, tell=tell)
    line, states = TABLE["camera gone, recording"]
    assert re.fullmatch(line, ended), ended
    passed = [one["state"] for one in read_recording(file).periods]
    assert [*dict.fromkeys(reversed(passed))][1::-1] == states
    assert not player.played.whole and player.played.taken
    run = merged(file, MODEL, paced, player.played)
    assert run.frames == len(player.played.taken)
    assert not read_recording(file).periods[-1]["torque"]


def test_no_camera_no_move(tmp_path, monkeypatch):
    monkeypatch.setattr("softmap_edge.robot.drive.player.LOST", 1.0)
    asked = []
    *_, ended = played(tmp_path, short(), lambda *said: asked.append(said), act=blinded)
    assert "no frame came within 1 s" in ended and not asked


def blinded(finger):
    finger.blind(True)
    finger._frames.clear()
    time.sleep(0.1)
    finger._frames.clear()


@pytest.fixture(scope="module")
def commands(tmp_path_factory):
    file = tmp_path_factory.mktemp("commands") / "commands.csv"
    write_commands(file, plan(chosen(TELLING), Limits.even(2, 5.0)), MODEL.robot)
    return file


def recorded(folder, robot):
    """Record by the command; again, on another robot, only where the recording shows that the
    computer stood still.
    """
    for trial in range(TRIALS):
        out, loop = folder / f"run{trial}.npz", folder / f"loop{trial}.mcap"
        more = ["--out", str(out), "--record", str(loop), "--json"]
        with robot(trial) as argv:
            done = subprocess.run(
                [SOFTMAP, "record", *argv, *more], capture_output=True, text=True, timeout=300
            )
        if done.returncode == 0:
            reported = json.loads(done.stdout)
            assert (
                reported["schema"] == "softmap.record/1"
                and reported["whole"]
                and reported["frames"] >= reported["wanted"] - 1
            )
            return Run.load(out)
        assert "state fault" in done.stderr and excused(loop), done.stderr
    pytest.fail(f"the computer stood still in each of {TRIALS} recordings")


def test_only_a_line_that_stood_excuses_a_recording(tmp_path, monkeypatch):
    """One silent servo, a blocked finger, a line that stood for a moment: none of them is played
    again.
    """

    def ends(cause, heard, seconds=0.15):
        rows = [dict(now=0, state="engaged", cause="none", position=[1, 2])]
        rows += [
            dict(now=int(1e9 * k * seconds / 9), state="hold", cause="late", position=heard)
            for k in range(1, 9)
        ]
        rows += [dict(now=int(1e9 * seconds), state="fault", cause=cause, position=heard)]
        monkeypatch.setitem(
            globals(), "read_recording", lambda file: type("Told", (), dict(periods=rows))
        )
        return excused(tmp_path)

    assert ends("silent", [None, None]) and ends("tripped", [None, None])
    assert (
        not ends("silent", [1, None])
        and not ends("following", [None, None])
        and not ends("lost", [None, None])
    )
    assert not ends("tripped", [None, None], seconds=0.05)


def test_nothing_hidden_is_diagnosed_as_nothing(tmp_path, commands):
    @contextmanager
    def robot(trial):
        yield [
            str(commands),
            "--emulated",
            "--calibrated",
            str(tmp_path / f"b{trial}"),
            "--seed",
            "1",
        ]

    run = recorded(tmp_path, robot)
    model = load_bundle(next(tmp_path.glob("b*")))
    assert run.ticks is not None and run.present_ticks is not None and run.current is not None
    assert {label.split("[")[0] for label in run.block} > {"home"}
    error = compare(model, run).error["rms_mm"]
    assert error < 0.25  # 0.17 mm is the camera's noise of 0.1 mm in each coordinate
    assert diagnose(model, run).verdict == "nothing"


@pytest.mark.long
def test_hidden_play_is_diagnosed_as_backlash_through_bus_and_camera(tmp_path, commands):
    """Another process is the robot: its bus is a terminal, its camera sends datagrams."""

    @contextmanager
    def robot(trial):
        there = folder / f"robot{trial}"
        there.mkdir()
        with emulated(there, "--hidden", "backlash", "--seed", "1") as (_, reported, receiver):
            until(lambda: receiver.taken > 0)
            receiver.close()  # its port is for the one who records
            on = ["--bundle", reported["bundle"], "--rig", reported["rig"]]
            yield [
                str(commands),
                *on,
                "--camera",
                f"udp://:{receiver.port}",
                "--late",
                "0.02",
                "--yes",
            ]

    # again only where the computer stood still meanwhile: then the finger did, too
    for trial in range(TRIALS):
        folder = tmp_path / f"{trial}"
        folder.mkdir()
        run = recorded(folder, robot)
        model = load_bundle(next(folder.glob("robot*")) / "bundle")
        answer = diagnose(model, run)
        if answer.verdict == "identified" or max(map(halted, folder.glob("*.mcap"))) < WATCHDOG:
            break
    assert [effect.name for effect in answer.effects] == [
        "backlash"
    ] and answer.verdict == "identified"
    assert (
        compare(model, run).error["rms_mm"]
        > 4 * compare(answer.added(model, ["backlash"]), run).error["rms_mm"]
    )


def lines_with_frames(seen):
    """Return the complete lines of a file of frames that hold a frame of the run."""
    complete = seen.read_text(encoding="utf-8").split("\n")[:-1]
    return [line for line in complete if json.loads(line).get("taken")]


def test_interrupted_is_kept(tmp_path, commands):
    out = tmp_path / "run.npz"
    more = ["--emulated", "--out", str(out), "--record", str(tmp_path / "loop.mcap")]
    with interruptible("record", str(commands), *more) as process:
        seen = out.with_suffix(SEEN)
        until(lambda: seen.exists() and len(lines_with_frames(seen)) > 3, 60.0)
        process.send_signal(signal.SIGINT)
        reported, failed = process.communicate(timeout=60)
    assert process.returncode == 130, failed
    assert "it was cut short" in reported, failed
    run = Run.load(out)
    assert 0 < run.frames < 73 and len(read_recording(tmp_path / "loop.mcap").periods) >= len(run.t)


@pytest.mark.parametrize(
    "more, line",
    [
        (["--rig", "rig.toml"], "--rig needs eyes"),
        (["--emulated", "--camera", "udp://:9"], "--emulated has a camera of its own"),
        (["--emulated", "--virtual"], "--virtual goes with --sim"),
        (["--rig", "rig.toml", "--camera", "udp://:9", "--hide", "backlash"], "can hide something"),
        (["--rig", "rig.toml", "--camera", "udp://:9", "--calibrated", "b"], "knows its true map"),
        (["--emulated", "--late", "9"], "0 to 2 s is allowed"),
        (["--rig", "rig.toml", "--camera", "udp://:9"], "the bundle holds no calibration"),
        (["--emulated", "--hide", "gravity"], "moves no tendon"),
    ],
)
def test_what_does_not_go_together_is_reported(tmp_path, commands, capsys, monkeypatch, more, line):
    monkeypatch.chdir(tmp_path)
    assert main(["record", str(commands), "--out", "run.npz", *more]) == 2
    assert line in capsys.readouterr().err and not (tmp_path / "run.npz").exists()


def test_no_user_to_ask_is_reported(tmp_path, commands, monkeypatch, capsys):
    from softmap_edge.commands.record_robot import _ask

    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    with pytest.raises(SoftmapError, match="no terminal to confirm that it is done"):
        _ask(
            type("Args", (), dict(yes=False, emulated=False, json=True)),
            "hang 10 g at the tip",
            None,
        )
