"""Damaged MCAP logs: what fails a checksum is left out and reported, the rest is read; no number
changes silently.
"""

import json
import shutil
import struct
import time
import warnings
import zlib

import numpy as np
import pytest
from flips import flip_bits
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap_ros2._dynamic import serialize_dynamic
from mcap_ros2.writer import Writer
from recordings import BAG_MAP as MAP
from recordings import BAG_START as START
from recordings import JOINT_STATE, joint_state, robot_messages, write_mcap

from softmap_edge.cli import main
from softmap_edge.errors import RecordingWarning, RunError
from softmap_edge.files.mcap_records import CHUNK, MAGIC, MESSAGE, MESSAGE_INDEX, Walk, read_closing
from softmap_edge.logs.importer import import_logs, read_mapping
from softmap_edge.logs.readers.mcap_file import open_mcap, topics


def bag(folder, compression="zstd", frames=600, name="run.mcap"):
    """A recording of several chunks, and its mapping."""
    (folder / "map.toml").write_text(MAP)
    return write_mcap(folder / name, robot_messages(frames), compression)


def goals(path, count=300, **options):
    """A recording of `/goal` alone by another writer's options."""
    encode = serialize_dynamic(*JOINT_STATE)[JOINT_STATE[0]]
    with path.open("wb") as file:
        from mcap.writer import Writer as Plain

        writer = Plain(file, chunk_size=4000, compression=CompressionType.NONE, **options)
        writer.start()
        schema = writer.register_schema(JOINT_STATE[0], "ros2msg", JOINT_STATE[1].encode())
        channel = writer.register_channel("/goal", "cdr", schema)
        for k in range(count):
            at = int((START + 0.01 * k) * 1e9)
            writer.add_message(channel, at, encode(joint_state(START + 0.01 * k, (k, -k))), at)
        writer.finish()
    return path


def records(path, kind):
    with path.open("rb") as file:
        return [record for record in Walk(file, path.stat().st_size) if record.kind == kind]


def imported(path):
    return import_logs([path], read_mapping(path.parent / "map.toml"))


def left_of(path, match):
    """Import with a warning that fits; return the run."""
    with pytest.warns(RecordingWarning, match=match):
        return imported(path).run


def is_part_of(some, run):
    """Whether the commands of a run are rows of another, at their times."""
    rows = {(round(t, 6), *row) for t, row in zip(run.t, run.command)}
    return all((round(t, 6), *row) in rows for t, row in zip(some.t, some.command))


def turned(path, byte, bit=6):
    data = bytearray(path.read_bytes())
    data[byte] ^= 1 << bit
    path.write_bytes(data)
    return path


# --- chunks --------------------------------------------------------------------------------
@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_a_flipped_bit_in_a_chunk_leaves_it_out_and_reads_on(tmp_path, compression):
    path = bag(tmp_path, compression)
    good = imported(path).run
    chunks = records(path, CHUNK)
    assert len(chunks) > 4
    middle = chunks[len(chunks) // 2]
    turned(path, (middle.start + middle.end) // 2)
    run = left_of(
        path,
        rf"run.mcap is damaged: 1 of {len(chunks)} chunks is left out \(.*byte {middle.start}, .* s\)",
    )
    assert is_part_of(run, good) and 80 < len(good.t) - len(run.t) < 130
    assert run.t[-1] == good.t[-1], "what follows is read"


def test_each_command_prints_it_once_and_returns_1(tmp_path, capsys):
    path, out = bag(tmp_path), str(tmp_path / "out.npz")
    middle = records(path, CHUNK)[2]
    turned(path, middle.end - 20)
    words = ["import", str(path), "--map", str(tmp_path / "map.toml"), "--out", out]
    assert main(words) == 1
    said = capsys.readouterr()
    assert (
        said.err.count("\n") == 1
        and "is damaged: 1 of" in said.err
        and "200 of 1200 messages are missing" in said.err
    )
    assert main([*words, "--force", "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert len(document["damage"]) == 1 and "left out" in document["damage"][0]
    assert main(["import", str(path), "--guess"]) == 1
    assert capsys.readouterr().err.count("is damaged") == 1


@pytest.mark.parametrize("part", [0, 1, 4, 8, 9 + 16, 9 + 24, 9 + 28, 9 + 32, 9 + 36])
def test_damage_of_a_chunks_head_loses_that_chunk_at_most(tmp_path, part):
    """Its kind, length (three bytes), size, checksum, the name of its compression and the length of
    that.
    """
    path = bag(tmp_path)
    good = imported(path).run
    turned(path, records(path, CHUNK)[2].start + part, 1)
    run = left_of(path, "run.mcap is damaged: ")
    assert is_part_of(run, good) and len(good.t) - len(run.t) < 130 and run.t[-1] == good.t[-1]


def test_definitions_of_a_chunk_that_is_lost_come_from_the_summary(tmp_path):
    path = bag(tmp_path)
    good = imported(path).run
    turned(path, records(path, CHUNK)[0].end - 100)
    with pytest.warns(RecordingWarning, match="chunks is left out"):
        columns = open_mcap(path, "/goal")
    assert 0 < len(columns.numbers) < len(good.t) and columns.numbers[-1, 0] == pytest.approx(
        START + good.t[-1]
    )


def test_an_index_that_becomes_a_message_is_no_message(tmp_path):
    path = bag(tmp_path, "none")
    good = imported(path).run
    for index in records(path, MESSAGE_INDEX)[:3]:
        turned(path, index.start, 1)  # 7 → 5
    run = left_of(path, "3 messages of no known channel or chunk are left out")
    assert np.array_equal(run.command, good.command)


def test_a_file_whose_chunks_all_fail_is_refused(tmp_path):
    path = bag(tmp_path, frames=40)
    for chunk in records(path, CHUNK):
        turned(path, chunk.end - 30)
    with pytest.raises(
        RunError, match="1 of 1 chunks is left out .*; nothing of topic /goal is left"
    ):
        imported(path)
    with pytest.raises(RunError, match="nothing of it is left"):
        topics(path)


# --- ends ----------------------------------------------------------------------------------
@pytest.mark.parametrize("tail", [b"", bytes(65536), b"\xff" * 5000, bytes(range(256)) * 40])
@pytest.mark.parametrize("compression", ["zstd", "none"])
def test_a_cut_file_is_read_as_far_as_it_is_good_whatever_follows(tmp_path, tail, compression):
    path = bag(tmp_path, compression)
    good, data = imported(path).run, path.read_bytes()
    fourth = records(path, CHUNK)[3]
    path.write_bytes(data[: fourth.start + 200] + tail)
    run = left_of(
        path,
        rf"run.mcap was cut short: it is read up to 2\.\d\d s; .*\d+ of {path.stat().st_size} bytes cannot",
    )
    assert is_part_of(run, good) and 200 < len(run.t) < 300


BARE = {
    "no chunks": {"use_chunking": False},
    "no chunks, no checksums": {"use_chunking": False, "enable_crcs": False},
    "no chunks, a checksum of the data": {"use_chunking": False, "enable_data_crcs": True},
    "chunks without checksums": {"enable_crcs": False},
}


@pytest.mark.parametrize(
    "rest", ["zeros to the end", "cut in the zeros", "cut where the message ends"]
)
@pytest.mark.parametrize("make", list(BARE))
def test_a_message_that_runs_into_zeros_is_left_out(tmp_path, make, rest):
    """A disk that lost its last blocks; the messages before are right, and no number changes."""
    path = goals(tmp_path / "run.mcap", **BARE[make])
    good, data = open_mcap(path, "/goal").numbers, path.read_bytes()
    last = records(path, CHUNK if "chunks with" in make else MESSAGE)[-2]
    for back in (1, 5, 8, 13, 40, 90):
        zero = {
            "zeros to the end": len(data),
            "cut in the zeros": last.end + 7,
            "cut where the message ends": last.end,
        }
        path.write_bytes(data[: last.end - back] + bytes(zero[rest] - last.end + back))
        with pytest.warns(RecordingWarning, match="was cut short"):
            some = open_mcap(path, "/goal").numbers
        assert 0 < len(some) < 300 and np.array_equal(some, good[: len(some)])


def test_only_the_message_at_the_zeros_is_left_out(tmp_path):
    path = goals(tmp_path / "run.mcap", use_chunking=False)
    data, messages = path.read_bytes(), records(path, MESSAGE)
    path.write_bytes(data[: messages[200].start + 30] + bytes(4096))
    with pytest.warns(RecordingWarning):
        assert len(open_mcap(path, "/goal").numbers) == 200
    path.write_bytes(data[: messages[200].start + 30])
    with pytest.warns(RecordingWarning):
        assert len(open_mcap(path, "/goal").numbers) == 200


def test_damage_amid_a_cut_file_loses_that_chunk(tmp_path):
    path = bag(tmp_path)
    good, data, chunks = imported(path).run, path.read_bytes(), records(path, CHUNK)
    path.write_bytes(data[: chunks[4].start + 50])
    run = left_of(path, "was cut short")
    turned(path, chunks[1].end - 40)
    less = left_of(
        path,
        "was cut short: .*1 of 4 chunks is left out .*at least 200 of 799 messages are missing",
    )
    assert is_part_of(less, good) and less.t[-1] == run.t[-1] and len(less.t) < len(run.t)


@pytest.mark.parametrize("back", [3, 12, 20, 30, 60, 300])
def test_damage_of_the_end_is_reported_and_changes_nothing(tmp_path, back):
    """The last magic bytes, the footer and the summary."""
    path = bag(tmp_path)
    good = imported(path).run
    run = left_of(turned(path, path.stat().st_size - back), "run.mcap (is damaged|was cut short)")
    assert np.array_equal(run.command, good.command) and np.array_equal(run.markers, good.markers)


# --- what carries which checksums ------------------------------------------------------------
def test_a_file_without_checksums_is_read_and_reported_as_such(tmp_path):
    for options in (
        {"enable_crcs": False},
        {"enable_crcs": False, "use_chunking": False},
        {"use_chunking": False},
    ):
        held = open_mcap(goals(tmp_path / "bare.mcap", **options), "/goal")
        assert len(held.numbers) == 300
        assert held.notes == (
            "this file carries no checksums: numbers that were damaged would not be noticed",
        )
    for options in (
        {},
        {"enable_data_crcs": True},
        {"enable_data_crcs": True, "use_chunking": False},
    ):
        held = open_mcap(goals(tmp_path / "good.mcap", **options), "/goal")
        assert len(held.numbers) == 300 and held.notes == ()


def test_a_chunk_without_a_checksum_among_others_is_reported(tmp_path):
    path = bag(tmp_path)
    start = records(path, CHUNK)[1].start + 9 + 24
    data = bytearray(path.read_bytes())
    data[start : start + 4] = bytes(4)
    path.write_bytes(data)
    assert any("1 chunks carry no checksum" in note for note in imported(path).notes)


def test_chunks_without_checksums_are_left_out_where_the_data_fail_theirs(tmp_path):
    path = goals(tmp_path / "run.mcap", enable_crcs=False, enable_data_crcs=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(open_mcap(path, "/goal").numbers) == 300
    middle = records(path, CHUNK)[2]
    turned(path, middle.end - 20)
    with pytest.raises(
        RunError, match="the checksum of its data does not match.*nothing of topic /goal is left"
    ):
        open_mcap(path, "/goal")


def test_data_without_chunks_that_fail_their_checksum_are_refused(tmp_path):
    """Nothing shows which message is damaged."""
    path = goals(tmp_path / "run.mcap", use_chunking=False, enable_data_crcs=True)
    with path.open("rb") as file:
        assert read_closing(file, path.stat().st_size).data is True
    data = path.read_bytes()
    turned(path, data.index(struct.pack("<d", 77.0)) + 6, 3)
    with pytest.raises(
        RunError,
        match="the checksum of its data does not match, so any of its messages may be wrong",
    ):
        open_mcap(path, "/goal")


@pytest.mark.parametrize("kept", [True, False])
def test_statistics_without_counts_of_channels_are_no_fault(tmp_path, kept):
    path = goals(tmp_path / "run.mcap")
    data = bytearray(path.read_bytes())
    start = struct.unpack("<Q", data[-28:-20])[0]
    at, total = start, None
    while data[at] != 0x0B:
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    total = at + 9
    assert int.from_bytes(data[total : total + 8], "little") == 300
    data[total : total + 8] = struct.pack("<Q", 300 if kept else 301)
    data[total + 42 : total + 46] = bytes(4)  # no counts
    data[-12:-8] = struct.pack("<I", zlib.crc32(data[start:-12]))
    path.write_bytes(data)
    if kept:
        assert open_mcap(path, "/goal").notes == ()
        return
    with pytest.warns(RecordingWarning, match="1 of 301 messages are missing"):
        open_mcap(path, "/goal")


@pytest.mark.parametrize("first", [8, None])
def test_data_checksums_of_other_writers_are_known(tmp_path, first):
    """Some count from behind the magic bytes, or from behind the header."""
    path = goals(tmp_path / "run.mcap", enable_data_crcs=True)
    data = bytearray(path.read_bytes())
    first = first or len(MAGIC) + 9 + int.from_bytes(data[9:17], "little")
    with path.open("rb") as file:
        end = read_closing(file, len(data)).data_end
    data[end + 9 : end + 13] = struct.pack("<I", zlib.crc32(data[first:end]))
    path.write_bytes(data)
    assert open_mcap(path, "/goal").notes == ()


def test_good_files_of_other_writers_give_no_word(tmp_path):
    """An attachment that is a recording itself, metadata, private records: as another reader,
    without a warning.
    """
    path = tmp_path / "run.mcap"
    inside = bag(tmp_path, name="inside.mcap").read_bytes()
    with path.open("wb") as file:
        writer = Writer(file)
        schema = writer.register_msgdef(*JOINT_STATE)
        for k in range(50):
            writer.write_message(
                "/goal", schema, joint_state(START + k, (k, 1)), log_time=int((START + k) * 1e9)
            )
        writer._writer.add_attachment(0, 0, "inside.mcap", "application/mcap", inside)
        writer._writer.add_metadata("who", {"a": "b"})
        writer.finish()
    held = open_mcap(path, "/goal")
    assert len(held.numbers) == 50 and held.notes == ()
    with path.open("rb") as file:
        assert len(list(make_reader(file).iter_messages())) == 50


def test_records_of_a_private_kind_are_passed_over(tmp_path):
    path = bag(tmp_path)
    good, data, at = imported(path).run, path.read_bytes(), records(path, CHUNK)[1].start
    private = struct.pack("<BQ", 0x90, 7) + b"private"
    start, offsets = struct.unpack("<QQ", data[-28:-12])
    summary = data[start:-37] + struct.pack("<BQQQ", 2, 20, start + 16, offsets + 16)
    path.write_bytes(
        data[:at]
        + private
        + data[at:start]
        + summary
        + struct.pack("<I", zlib.crc32(summary))
        + MAGIC
    )
    done = imported(path)  # without a warning
    assert np.array_equal(done.run.command, good.command)
    assert "run.mcap: 1 records of an unknown kind were passed over" in done.notes


def test_files_made_to_take_long_do_not(tmp_path):
    """Bytes that all look like chunks, and records of unknown kinds."""
    head = MAGIC + struct.pack("<BQII", 1, 8, 0, 0)
    begun = time.monotonic()
    for body in (
        b"\x06" * 2**24,
        struct.pack("<BQ", 0x90, 2**20) * 2**20,
        (b"\x06" + bytes(40)) * 2**18,
    ):
        (tmp_path / "run.mcap").write_bytes(head + body)
        with pytest.raises(RunError, match="was cut short"):
            topics(tmp_path / "run.mcap")
    assert time.monotonic() - begun < 60.0


# --- flips ---------------------------------------------------------------------------------
@pytest.mark.parametrize("compression", ["zstd", "none"])
def test_no_flipped_bit_changes_a_number_silently(tmp_path, compression):
    kinds, silent = flip_bits(
        bag(tmp_path, compression, 300), lambda path: imported(path).run, 50, 1
    )
    assert not silent and sum(kinds.values()) == 50 and kinds["reported"] + kinds["refused"] > 10, (
        kinds,
        silent,
    )


@pytest.mark.prove
@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_none_of_2000_flipped_bits_changes_a_number_silently(tmp_path, compression):
    kinds, silent = flip_bits(
        bag(tmp_path, compression, 300), lambda path: imported(path).run, 2000, 2
    )
    assert not silent and sum(kinds.values()) == 2000, (kinds, silent)


def test_warnings_can_be_made_errors(tmp_path):
    path = bag(tmp_path)
    shutil.copy(path, tmp_path / "copy.mcap")
    turned(path, records(path, CHUNK)[1].end - 9)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RecordingWarning)
        imported(tmp_path / "copy.mcap")
        with pytest.raises(RecordingWarning, match="left out"):
            imported(path)
