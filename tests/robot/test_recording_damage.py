"""Recordings of the loop that are damaged, cut or broken off: no number changes silently, nothing
is lost quietly.
"""

import contextlib
import re
import resource
import signal
import time

import numpy as np
import pytest
from flips import flip_bits
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rigs import calibration, emulated_rig

from softmap_edge.cli import main
from softmap_edge.errors import RecordingBroken, RecordingWarning, RunError, ServoError
from softmap_edge.files.mcap_records import read_closing
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.control.recording import read_recording
from softmap_edge.robot.control.recording_end import broken_recording, system_words
from softmap_edge.robot.drive.observations import seen_file
from softmap_edge.robot.drive.recorded import open_run, run_of
from softmap_edge.run.run import Run

ROOM = 60_000  # bytes of a file, where there is little room


def drive(robot, seconds):
    robot.engage()
    begun = time.monotonic()
    while (t := time.monotonic() - begun) < seconds:
        robot.target(np.array([np.sin(3 * t), np.cos(2 * t) - 1]))
        time.sleep(0.015)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    file = tmp_path_factory.mktemp("recording") / "drive.mcap"
    with (
        emulated_rig(200.0) as (_, rig, limits),
        Controller(rig, calibration(), limits, record=file) as robot,
    ):
        drive(robot, 0.6)
    return file


@pytest.fixture
def copied(recorded, tmp_path):
    (tmp_path / "drive.mcap").write_bytes(recorded.read_bytes())
    return tmp_path / "drive.mcap"


def changed(file, old, new, share=0.5):
    """Change one byte of the first place of `old` after a share of the file."""
    data = file.read_bytes()
    at = data.index(old, int(share * len(data)))
    file.write_bytes(data[:at] + new + data[at + len(old) :])


# --- damage ----------------------------------------------------------------------------------
def test_a_sound_recording_gives_no_word(recorded):
    reported = read_recording(recorded)
    assert reported.short is None and reported.incomplete is None and not reported.doubtful
    with recorded.open("rb") as stream:
        closing = read_closing(stream, recorded.stat().st_size)
    assert closing.data is True and closing.summary is True, (
        "its own recordings always carry checksums"
    )
    assert sum(closing.counts.values()) == len(reported.periods) + 1


def test_no_flipped_bit_changes_a_number_silently(copied):
    kinds, silent = flip_bits(copied, open_run, 50, 1)
    assert not silent and kinds["same"] == 0 and sum(kinds.values()) == 50, (kinds, silent)


@pytest.mark.prove
def test_none_of_2000_flipped_bits_changes_a_number_silently(copied):
    kinds, silent = flip_bits(copied, open_run, 2000, 2)
    assert not silent and sum(kinds.values()) == 2000, (kinds, silent)


def test_a_number_that_changed_somewhere_is_refused_but_for_replay(copied, tmp_path, capsys):
    """The remedy that the line names leads out."""
    changed(copied, b'"overruns":', b'"Overruns":')  # a key that no run needs
    line = "drive.mcap is damaged: the checksum of its data does not match, so any of its "
    for words, code in (
        ("show", 2),
        ("compare", 2),
        ("diagnose", 2),
        ("model predict", 2),
        ("check", 1),
    ):
        assert main([*words.split(), str(copied)]) == code, words
        said = capsys.readouterr().err
        assert said.count("\n") == 1 and line in said, said
    assert main(["check", str(copied), "--json"]) == 1
    assert '"sound": false' in capsys.readouterr().out
    out = tmp_path / "RUN.npz"
    assert f"softmap servo replay {copied} --run RUN.npz" in said
    assert main(["servo", "replay", str(copied), "--run", str(out)]) == 1
    assert line in capsys.readouterr().err and len(Run.load(out).t) > 50


def test_what_is_damaged_at_one_place_is_read_up_to_there_and_reported(copied, capsys):
    count = len(read_recording(copied).periods)
    changed(copied, b'"overruns":', b'"overruns";')
    line = re.compile(
        r"drive.mcap is damaged \(message \d+ is not JSON: .*\); it is read up to \d\.\d\d s; \d+ of "
        rf"{count + 1} messages missing"
    )
    for words in (["show"], ["check"], ["model", "predict"], ["servo", "replay"]):
        assert main([*words, str(copied)]) == 1, words
        said = capsys.readouterr()
        assert len(line.findall(said.err)) == 1, said
        assert said.out
    with pytest.warns(RecordingWarning, match=line):
        assert count / 3 < len(open_run(copied).t) < 2 * count / 3


@pytest.mark.parametrize("tail", [b"", bytes(70_000), b"\xff" * 300])
def test_a_cut_recording_is_reported_by_each_command(copied, tail, capsys):
    data = copied.read_bytes()
    copied.write_bytes(data[: len(data) // 2] + tail)
    for words in (["show"], ["check"], ["model", "predict"], ["servo", "replay"]):
        assert main([*words, str(copied)]) == 1, words
        said = capsys.readouterr()
        assert re.search(
            r"drive.mcap was cut short: its loop did not close it.*; it is read up to 0\.\d\d s",
            said.err,
        )
        assert said.err.count("cut short") == 1 and said.out
    assert main(["check", str(copied)]) == 1
    assert f"damaged   {copied}" in capsys.readouterr().out


@pytest.mark.parametrize("left", [0.5, 0.7, 0.9])
def test_a_damaged_recording_without_its_seen_file_says_that_it_is_missing(copied, left):
    copied.write_bytes(copied.read_bytes()[: int(left * copied.stat().st_size)])
    seen_file(copied).unlink(missing_ok=True)
    with pytest.warns(
        RecordingWarning, match=rf"cut short.*its file {seen_file(copied).name} is missing"
    ):
        assert open_run(copied).frames == 0


@pytest.mark.parametrize(
    "protocol", [["--standard"], ["--block", "circle"], ["--protocol", "grid"]]
)
def test_next_reports_damage_of_its_runs_without_a_diagnosis_too(copied, protocol, capsys):
    copied.write_bytes(copied.read_bytes()[: copied.stat().st_size // 2])
    assert main(["next", *protocol, "--run", str(copied)]) == 1
    assert "cut short" in capsys.readouterr().err


def test_damage_of_the_end_alone_loses_nothing(copied):
    sound, _ = run_of(read_recording(copied))
    for back in (4, 20, 33, 60):
        data = bytearray(copied.read_bytes())
        data[-back] ^= 1
        bad = copied.with_name("bad.mcap")
        bad.write_bytes(data)
        with pytest.warns(RecordingWarning, match="bad.mcap (is damaged|was cut short)"):
            assert np.array_equal(open_run(bad).ticks, sound.ticks)


def rewritten(source, path, **options):
    """Write the messages of a recording again, as another tool does."""
    with source.open("rb") as old, path.open("wb") as new:
        writer = Writer(new, **options)
        writer.start()
        schema = writer.register_schema("softmap", "jsonschema", b"{}")
        channels = {
            topic: writer.register_channel(topic, "json", schema) for topic in ("/setup", "/loop")
        }
        for _, channel, message in make_reader(old).iter_messages(log_time_order=False):
            topic = channel.topic
            writer.add_message(
                channels[topic],
                message.log_time,
                message.data,
                message.publish_time,
                message.sequence,
            )
        writer.finish()
    return path


def test_a_recording_that_was_rewritten_in_chunks_is_checked_too(recorded, tmp_path):
    path = rewritten(
        recorded, tmp_path / "chunks.mcap", compression=CompressionType.NONE, chunk_size=20_000
    )
    assert np.array_equal(open_run(path).ticks, open_run(recorded).ticks)
    _, silent = flip_bits(path, open_run, 40, 3)
    assert not silent


def test_a_recording_without_checksums_is_reported_as_such(recorded, tmp_path):
    path = rewritten(recorded, tmp_path / "bare.mcap", use_chunking=False, enable_crcs=False)
    with pytest.warns(RecordingWarning, match="bare.mcap carries no checksum of its data"):
        open_run(path)


def test_what_is_no_recording_of_a_loop_is_sent_to_import(tmp_path):
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.finish()
    with pytest.raises(RunError, match="make a run of another MCAP file by `softmap import`"):
        open_run(path)


# --- recordings that break off -----------------------------------------------------------------
@contextlib.contextmanager
def little_room():
    """Give processes that begin meanwhile no room for large files."""
    low, high = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, high))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (low, high))
        signal.signal(signal.SIGXFSZ, before)


@contextlib.contextmanager
def full(file):
    """Give a robot whose recording finds the disk full after some tenths of a second."""
    with emulated_rig(200.0) as (_, rig, limits):
        robot = Controller(rig, calibration(), limits, record=file)
        with little_room():
            robot.__enter__()
        yield robot


FULL = r"^file too large: \S+/drive.mcap, recorded up to \d+\.\d s; the recording broke off, and what it has is kept$"


def test_a_full_disk_is_an_error_when_the_block_is_left(tmp_path):
    file = tmp_path / "drive.mcap"
    with full(file) as robot:
        drive(robot, 1.5)  # it goes on
        assert robot.state == "engaged" and re.match(FULL, robot.unrecorded)
        with pytest.raises(RecordingBroken, match=FULL):
            robot.__exit__(None, None, None)
        assert robot.state == "off" or not robot.report.get("torque")
    seconds = float(re.search(r"up to (\S+) s", robot.unrecorded)[1])
    reported = read_recording(file)
    assert (reported.periods[-1]["now"] - reported.periods[0]["now"]) * 1e-9 == pytest.approx(
        seconds, abs=0.06
    )
    assert reported.short is not None


@pytest.mark.parametrize("own", [ValueError("mine"), KeyboardInterrupt(), ServoError("mine")])
def test_a_full_disk_is_reported_with_an_error_of_the_program(tmp_path, own):
    with full(tmp_path / "drive.mcap") as robot:
        drive(robot, 1.0)
        try:
            robot.__exit__(type(own), own, None)
        except ServoError as fault:
            assert isinstance(own, ServoError) and str(fault).startswith("mine; file too large: ")
        else:
            assert any(note.startswith("file too large: ") for note in own.__notes__)


def test_close_says_it_as_well(tmp_path):
    with full(tmp_path / "drive.mcap") as robot:
        drive(robot, 1.0)
        with pytest.raises(RecordingBroken, match=FULL):
            robot.close()


def test_a_recording_that_is_removed_meanwhile_is_reported(tmp_path):
    file = tmp_path / "drive.mcap"
    with (
        emulated_rig(200.0) as (_, rig, limits),
        pytest.raises(RecordingBroken, match="drive.mcap: the recording is gone"),
        Controller(rig, calibration(), limits, record=file) as robot,
    ):
        drive(robot, 0.3)
        file.unlink()


def test_periods_that_the_disk_was_too_slow_for_are_reported(recorded):
    assert (
        broken_recording(recorded, None, 12, True)
        == f"{recorded}: 12 periods are missing; the disk was too slow for them"
    )
    assert broken_recording(recorded, None, 0, True) is None


def test_words_of_the_system_are_those_of_other_messages():
    assert system_words("No space left on device (os error 28)") == "no space left on device"
    assert system_words("Disk quota exceeded (os error 122)") == "disk quota exceeded"
