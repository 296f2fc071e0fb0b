"""A recording replays bit for bit, is a run, and is readable wherever it was cut."""

import contextlib
import io
import json
import re
import struct
import time

import numpy as np
import pytest
from mcap.exceptions import EndOfFile, McapError
from mcap.records import Message
from mcap.stream_reader import StreamReader
from rigs import HOME, TICKS_PER_MM, calibration, emulated_rig

from softmap_edge import _core
from softmap_edge.cli import main
from softmap_edge.errors import RunError, ServoError
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.control.recording import Recording, read_recording


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Record some seconds of driving with damaged answers and refused targets."""
    file = tmp_path_factory.mktemp("recording") / "drive.mcap"
    with (
        emulated_rig(200.0) as (bus, rig, limits),
        Controller(rig, calibration(), limits, record=file) as robot,
    ):
        robot.engage()
        bus.faults(damage=0.05, junk=0.1)
        begin = time.monotonic()
        while (t := time.monotonic() - begin) < 2.5:
            u = np.array([np.sin(3 * t), np.nan if 1.0 < t < 1.1 else np.cos(2 * t) - 1])
            robot._send(u, deadman=True)
            time.sleep(0.015)
    return file


def test_replays_bit_for_bit(recorded):
    recording = read_recording(recorded)
    assert len(recording.periods) > 400
    assert any(period["refused"] for period in recording.periods)
    assert any(None in period["position"] for period in recording.periods)
    assert recording.replay() == []
    moved = [
        period for period in recording.periods if period["torque"] and period["goal"][0] != HOME
    ]
    moved[10]["goal"][0] += 1
    assert len(recording.replay()) == 1, "a single tick is seen"


def test_faults_replay_bit_for_bit_and_under_the_same_limits(tmp_path):
    file = tmp_path / "faults.mcap"
    with (
        emulated_rig(200.0, hold=0.2) as (bus, rig, limits),
        Controller(rig, calibration(), limits, record=file) as robot,
    ):

        def drive(until, u):
            deadline = time.monotonic() + 10.0
            while robot.state not in until:
                assert time.monotonic() < deadline
                robot._send(np.array(u), deadman=True)
                time.sleep(0.01)

        robot.engage()
        for _ in range(30):
            robot._send(np.array([3.4, -3.4]), deadman=True)  # beyond the window
            time.sleep(0.01)
        bus.heat(0, 69.0)
        drive(("fault",), [3.4, -3.4])
        bus.heat(0, 25.0)
        deadline = time.monotonic() + 10.0
        while robot.state != "homed":
            assert time.monotonic() < deadline
            with contextlib.suppress(ServoError):
                robot.request("acknowledge")
        robot.request("arm")
        robot.engage()
        drive(("engaged",), [1.0, 1.0])
        bus.damage(1, mute=True)
        drive(("fault",), [1.0, 1.0])
        bus.damage(1, mute=False)
    recording = read_recording(file)
    seen = {(period["state"], period["cause"]) for period in recording.periods}
    assert {("safe_stop", "hot"), ("fault", "hot"), ("hold", "late"), ("fault", "silent")} <= seen
    assert recording.replay() == []
    # Under a narrower window the same targets are decided otherwise, and no goal leaves it.
    for one in recording.limits["servos"]:
        one["low"], one["high"] = HOME - 30, HOME + 30
    assert recording.replay() != []
    goals = [
        goal
        for _, _, torque, goal in _core.replay(recording.limits, recording._guard_inputs())
        if torque
    ]
    assert goals and np.abs(np.array(goals) - HOME).max() <= 30


def test_nothing_is_recorded_over(tmp_path):
    file = tmp_path / "old.mcap"
    file.write_text("kept")
    with (
        emulated_rig() as (_, rig, limits),
        pytest.raises(ServoError, match="old.mcap exists; give another name"),
    ):
        Controller(rig, calibration(), limits, record=file).__enter__()
    assert file.read_text() == "kept"


def test_is_a_run(recorded):
    run = read_recording(recorded).run()
    assert run.ticks.shape == run.present_ticks.shape and run.channels == 2
    assert np.ptp(run.ticks[:, 0]) > 1.5 * TICKS_PER_MM
    lag = np.abs(run.ticks - run.present_ticks).max()
    assert 5 < lag < 400
    assert (np.diff(run.t) > 0).all()


def stream(data):
    """Return the loop messages that the `mcap` package's stream reader finds."""
    found = []
    with contextlib.suppress(EndOfFile, McapError, struct.error):
        found.extend(
            record.data for record in StreamReader(data).records if isinstance(record, Message)
        )
    return found


def test_a_file_cut_anywhere_gives_every_complete_message(recorded, tmp_path):
    whole = recorded.read_bytes()
    everything = [message for _, _, message in _core.read_recording(str(recorded))]
    rng = np.random.default_rng(0)
    ends, at = [], 0
    for message in everything:
        at = whole.index(message, at) + len(message)
        ends.append(at)
    file = tmp_path / "cut.mcap"
    for cut in [*rng.integers(ends[0], len(whole), 60), *ends[:5], *(np.array(ends[:5]) - 1)]:
        file.write_bytes(whole[:cut])
        expected = everything[: int(np.searchsorted(ends, cut, side="right"))]
        assert [message for _, _, message in _core.read_recording(str(file))] == expected
        assert stream(io.BytesIO(whole[:cut])) == expected


def test_what_a_recording_lacks_is_reported(recorded, tmp_path, capsys):
    """A record whose kind, number or length a flipped byte changes is no period less that no one
    notices.
    """
    whole, file = recorded.read_bytes(), tmp_path / "less.mcap"
    assert read_recording(recorded).short is None
    messages = [message for _, _, message in _core.read_recording(str(recorded))]
    # kind, length; channel, number, two times
    record = [whole.index(message) - 31 for message in messages]
    quarter = record[len(record) // 4]
    for place in (0, 1, 9, 11):  # kind, length, channel, number
        bad = bytearray(whole)
        bad[quarter + place] ^= 0x40
        file.write_bytes(bad)
        short = read_recording(file).short
        assert short is not None, place
        assert main(["servo", "replay", str(file)]) == 1
        assert f"less.mcap is {short.removesuffix('; record again')}" in capsys.readouterr().err
    file.write_bytes(whole[:quarter] + whole[record[len(record) // 4 + 1] :])
    assert read_recording(file).short.startswith("damaged (after message")
    file.write_bytes(whole[:quarter])
    assert read_recording(file).short == "its loop did not close it: cut short"


def test_a_changed_byte_is_reported_whatever_it_changes(recorded, tmp_path, capsys):
    """The file holds a checksum of all that the loop wrote: a changed number is not replayed as if
    it were recorded.
    """
    whole, file = recorded.read_bytes(), tmp_path / "changed.mcap"
    messages = [message for _, _, message in _core.read_recording(str(recorded))]
    middle = messages[len(messages) // 2]
    start = whole.index(middle)
    counted = re.search(rb'"overruns":\d', middle)[0]  # a busy machine may have had some
    other = counted[:-1] + (b"8" if counted.endswith(b"7") else b"7")
    for old, new in ((counted, other), (b'"current_mA"', b'"current_mB"')):
        file.write_bytes(whole[:start] + middle.replace(old, new) + whole[start + len(middle) :])
        main(["servo", "replay", str(file)])
        reported = capsys.readouterr()
        assert "changed.mcap" in reported.err and "damaged" in reported.err, (old, reported)
    file.write_bytes(
        whole[:start]
        + middle.replace(b'"overruns":', b'"overruns";')
        + whole[start + len(middle) :]
    )
    assert main(["servo", "replay", str(file)]) == 1
    assert f"message {len(messages) // 2} is not JSON" in capsys.readouterr().err
    assert len(read_recording(file).periods) == len(messages) // 2 - 1


def test_periods_that_vanish_before_a_clean_end_are_reported(recorded, tmp_path, capsys):
    """The file ends with a checksum of all that was written."""
    whole, file = recorded.read_bytes(), tmp_path / "less.mcap"
    messages = [message for _, _, message in _core.read_recording(str(recorded))]
    *_, third, second, last = (whole.rindex(message) + len(message) for message in messages)
    for start, end in ((second, last), (third, last)):
        file.write_bytes(whole[:start] + whole[end:])
        assert main(["servo", "replay", str(file)]) == 1
        assert (
            "less.mcap is damaged: the checksum of its data does not match"
            in capsys.readouterr().err
        )


def test_damaged_recordings_end_with_a_line(recorded, tmp_path):
    file = tmp_path / "bad.mcap"
    whole = bytearray(recorded.read_bytes())
    rng = np.random.default_rng(1)
    for _ in range(60):
        bad = whole.copy()
        for place in rng.integers(0, len(bad), 20):
            bad[place] = rng.integers(256)
        file.write_bytes(bad)
        try:
            read_recording(file).replay()
        except RunError as fault:
            assert "bad.mcap" in str(fault)
    periods = [{"state": "engaged"}, {"now": "x"}, [], 3]
    for period in periods:
        broken = Recording(file, {"limits": {}}, [period])
        with pytest.raises(RunError, match="bad.mcap: period 0 is damaged"):
            broken.replay()
        with pytest.raises(RunError, match="bad.mcap: period 0 is damaged"):
            broken.run()
    for content, said in (
        (b"", "holds no periods"),
        (b"x" * 100, "holds no periods"),
        (bytes(whole[:60]), "holds no periods"),
    ):
        file.write_bytes(content)
        with pytest.raises(RunError, match=said):
            read_recording(file)
    with pytest.raises(RunError, match="none.mcap: no such file; give what a loop recorded"):
        read_recording(tmp_path / "none.mcap")


@pytest.mark.parametrize("goal", [[[1], 2], [1, [2, 3]], [1e300, 2], ["x", 2], [True, {}], [1]])
def test_goals_that_are_no_ticks_make_no_run(recorded, goal):
    recording = read_recording(recorded)
    first = next(k for k, period in enumerate(recording.periods) if period["torque"])
    recording.periods[first + 3]["goal"] = goal
    with pytest.raises(RunError, match="drive.mcap: (period .* is )?damaged"):
        recording.run()
    recording = read_recording(recorded)
    for period in recording.periods:
        period["position"] = [[1, 2], [3, 4]]
    with pytest.raises(RunError, match="drive.mcap: (period .* is )?damaged"):
        recording.run()


def test_the_setup_says_what_made_it(recorded):
    recording = read_recording(recorded)
    assert recording.setup["schema"] == "softmap.setup/1"
    assert pytest.approx(np.eye(2) / TICKS_PER_MM) == recording.calibration.A
    assert json.dumps(recording.setup)
