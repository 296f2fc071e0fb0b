"""Output of `ros2 bag record` becomes a run: folders, split bags, .db3 with and without
definitions, packed files.
"""

import gzip
import re
import sqlite3
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
import zstandard
from containers import messages, write_db3, write_folder
from recordings import BAG_MAP as MAP
from recordings import BAG_START as START
from recordings import JOINT_STATE, joint_state, write_mcap

from softmap_edge.errors import RecordingWarning, RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs, read_mapping
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.logs.readers.cdr import parse_definition
from softmap_edge.logs.readers.message_types import _TYPES, known_definition
from softmap_edge.logs.readers.rosbag_folder import named_files
from softmap_edge.logs.readers.rosbag_sqlite import open_db3, topics_of_db3

DATA = Path(__file__).parents[1] / "data/containers"


def imported(paths, mapping=MAP):
    return import_logs(paths, parse_mapping(mapping, Path("map.toml")))


def refused(paths, mapping=MAP):
    with pytest.raises(RunError) as fault:
        imported(paths, mapping)
    assert "\n" not in str(fault.value) and len(str(fault.value)) < 1000
    return str(fault.value)


def same(one, other):
    assert np.array_equal(one.t, other.t) and np.array_equal(one.command, other.command)
    assert np.array_equal(one.markers, other.markers, equal_nan=True) and np.array_equal(
        one.t_seen, other.t_seen
    )


# --- the cases -----------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("names", "mapping"),
    [
        (["bag_0.mcap", "bag_1.mcap"], "map.toml"),
        (["bag_1.mcap", "bag_0.mcap"], "map.toml"),
        (["bag_0.mcap", "bag_1.mcap"], "map_two.toml"),
        (["good.mcap.zstd"], "map.toml"),
    ],
)
def test_a_recording_is_the_same_run_in_every_container(names, mapping):
    done = import_logs([DATA / name for name in names], read_mapping(DATA / mapping))
    complete = import_logs([DATA / "bagdir"], read_mapping(DATA / "map.toml"))
    # the last of 150 frames comes after the last command
    assert len(done.run.t) == 1056 and done.run.frames == 149
    same(done.run, complete.run)
    remarks = [
        note
        for note in done.notes
        if "parts read one after another: bag_0.mcap, bag_1.mcap" in note
    ]
    assert len(remarks) == (2 if len(names) == 2 else 0)
    made = "\n".join(done.run.extra["made_from"])
    assert all(name in made for name in names) and made.count("sha256") == len(names)


@pytest.mark.parametrize(
    "name", ["bag_mcap", "bag_db3", "bag_db3/bag_db3.db3", "bag_mcap/bag_mcap.mcap"]
)
def test_the_proposed_mapping_of_a_recording_imports_it(name):
    found = guess_mapping([DATA / name])
    run = imported([DATA / name], found.text).run
    # commands without stamps: by the log time, the last frame comes 3 ms after the last of them
    assert run.command.shape == (80, 2) and run.markers.shape == (79, 1, 3)
    # in rad, next to commands in mm: left out and named
    assert run.present is None and "joint_states" in found.text
    assert 'topic = "/tendon_cmd"' in found.text and "file =" not in found.text


def test_a_recording_without_messages_is_named_as_such():
    for paths in ([DATA / "run.db3"],):
        with pytest.raises(
            RunError, match=r"run.db3: holds no message \(topics: /cam \(geometry_msgs"
        ):
            guess_mapping(paths)
    said = refused([DATA / "run.db3"])
    assert "run.db3: holds no message of any topic" in said and "change `topic`" not in said


def test_messages_of_ros_1_are_named_with_the_command_that_converts_them():
    with pytest.raises(
        RunError,
        match="ROS 1 messages: convert the bag .* `rosbags-convert --src FILE.bag --dst FOLDER`",
    ):
        guess_mapping([DATA / "ros1.mcap"])


# --- folders -------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("form", "name"),
    [
        ("    - NAME", "bag_0.db3"),
        ("  - NAME", "bag_0.db3"),  # as PyYAML writes it
        ("    - 'NAME'", "bag_0.db3"),
        ('    - "NAME"', "bag_0.db3"),
        ("    - bag/NAME", "bag_0.db3"),  # before Foxy, from the folder above
        ("    - ../../elsewhere/NAME   # not from there", "bag_0.db3"),
        ('    - "NAME"   # quoted for its name', "my bag #1.db3"),
        ("    [NAME]", "bag_0.db3"),
    ],
)
def test_a_folder_is_read_by_its_metadata(tmp_path, form, name):
    folder = write_folder(tmp_path / "bag", [name], form)
    write_db3(folder / name, messages())
    if "[" in form:
        text = (folder / "metadata.yaml").read_text()
        (folder / "metadata.yaml").write_text(text.replace("paths:\n    [", "paths: ["))
    run = imported([folder]).run
    assert len(run.t) == 60 and run.markers.shape == (15, 1, 3)


def test_the_files_of_a_metadata_are_names_without_folders():
    text = (
        "a:\n  relative_file_paths:\n    - /etc/passwd\n    - ..\\x.db3\n\n    # a comment\n    - "
        "b's.mcap\n"
    )
    text += "  other:\n    - no\n"
    assert named_files(text) == ["passwd", "x.db3", "b's.mcap"]
    assert named_files("relative_file_paths: ['it''s.db3', \"b.db3\", c.db3]") == [
        "it's.db3",
        "b.db3",
        "c.db3",
    ]
    assert named_files("nothing: here") == []


def test_a_folder_of_several_files_packed_or_not(tmp_path):
    """Split by size and packed file by file: metadata.yaml names the files with or without the
    ending.
    """
    folder = write_folder(tmp_path / "bag", ["bag_0.db3", "bag_1.db3.zstd"])
    write_db3(folder / "bag_0.db3", messages(last=40))
    plain = write_db3(tmp_path / "bag_1.db3", messages(first=40))
    (folder / "bag_1.db3.zstd").write_bytes(zstandard.ZstdCompressor().compress(plain.read_bytes()))
    done = imported([folder])
    same(done.run, imported([write_db3(tmp_path / "complete.db3", messages())]).run)
    assert any(
        "2 parts read one after another: bag_0.db3, bag_1.db3" in note for note in done.notes
    )
    (folder / "bag_0.db3").unlink()
    (folder / "bag_0.db3.zstd").write_bytes(gzip.compress(b"no bag"))
    assert "bag_0.db3.zstd" in refused([folder])


def test_a_folder_without_metadata_is_read_and_reported(tmp_path):
    write_db3(tmp_path / "bag_0.db3", messages())
    done = imported([tmp_path])
    assert len(done.run.t) == 60 and any(
        "has no metadata.yaml: the recorder was interrupted" in n for n in done.notes
    )


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (
            lambda f: write_folder(f, ["bag_0.db3", "bag_1.db3"]),
            ["names 2 files, and bag_0.db3, bag_1.db3 is not there"],
        ),
        (lambda f: write_folder(f, ["bag.db3", "1" * 300]), ["names 2 files", "is not there"]),
        (lambda f: write_folder(f, ["ä" * 200 + ".db3"]), ["names 1 files", "is not there"]),
        (lambda f: write_folder(f, ['"a\\u0000b.db3"']), ["names 1 files", "is not there"]),
        (
            lambda f: write_folder(f, []),
            ["metadata.yaml names no files, and no recording is there"],
        ),
        (lambda f: f.mkdir(), ["a folder without a recording: it holds no files"]),
        (
            lambda f: (f.mkdir(), (f / "a.csv").write_text("t\n")),
            ["it holds a.csv; give the path of a log"],
        ),
        (
            lambda f: (f.mkdir(), write_folder(f / "bag", [])),
            ["it holds the recordings bag: give one of them"],
        ),
    ],
)
def test_a_folder_that_is_no_recording(tmp_path, made, words):
    made(tmp_path / "given")
    message = refused([tmp_path / "given"])
    assert all(word in message for word in words), message


# --- parts ---------------------------------------------------------------------------------
def test_parts_of_three_containers_with_a_topic_that_some_lack(tmp_path):
    """Poses in the first part only; the parts given in another order than recorded."""
    goals = [message for message in messages() if message[0] == "/goal"]
    first = write_mcap(tmp_path / "c.mcap", messages(last=30))
    taken = sum(message[0] == "/goal" for message in messages(last=30))
    second = write_db3(tmp_path / "b.db3", goals[taken : taken + 10])
    third = write_mcap(tmp_path / "a.mcap", goals[taken + 10 :])
    done = imported([third, second, first])
    assert done.run.command == pytest.approx(
        imported([write_mcap(tmp_path / "all.mcap", messages())]).run.command
    )
    assert any(
        "3 parts read one after another: c.mcap, b.db3, a.mcap" in note for note in done.notes
    )


def test_a_pause_between_parts_is_reported(tmp_path):
    late = [(topic, kind, message, seconds + 100) for topic, kind, message, seconds in messages()]
    late = [
        (topic, kind, joint_state(seconds, (1, 2)), seconds)
        for topic, kind, _, seconds in late
        if kind == JOINT_STATE
    ]
    done = imported(
        [write_mcap(tmp_path / "bag_0.mcap", messages()), write_mcap(tmp_path / "bag_1.mcap", late)]
    )
    assert any("the longest pause between two is 99.4 s" in note for note in done.notes)


def test_recordings_that_overlap_in_time_are_no_parts(tmp_path):
    one = write_mcap(tmp_path / "bag_0.mcap", messages(last=50))
    other = write_mcap(tmp_path / "bag_1.mcap", messages(first=20))
    message = refused([one, other])
    assert (
        "bag_0.mcap and bag_1.mcap overlap in time" in message
        and "not parts of one recording" in message
    )


def test_two_recordings_of_different_topics_need_no_file_in_the_mapping(tmp_path):
    one = write_mcap(tmp_path / "robot.mcap", [m for m in messages() if m[0] == "/goal"])
    other = write_db3(tmp_path / "camera.db3", [m for m in messages() if m[0] == "/poses"])
    same(imported([one, other]).run, imported([write_mcap(tmp_path / "all.mcap", messages())]).run)
    found = guess_mapping([one, other])
    assert 'file = "robot.mcap"' in found.text and 'file = "camera.db3"' in found.text
    assert len(imported([one, other], found.text).run.t) == 60


def test_the_proposal_for_parts_and_another_log_names_them_by_a_pattern(tmp_path):
    parts = [
        write_mcap(tmp_path / "bag_0.mcap", messages(last=40)),
        write_mcap(tmp_path / "bag_1.mcap", messages(first=40)),
    ]
    (tmp_path / "force[1].csv").write_text(
        "time,load\n" + "".join(f"{START + k / 50},{k % 7}\n" for k in range(60))
    )
    paths = [*parts, tmp_path / "force[1].csv"]
    found = guess_mapping(paths)
    assert 'file = "bag_*.mcap"' in found.text
    assert len(imported(paths, found.text).run.t) == 60


def test_csv_logs_with_equal_mappings_are_parts_of_one(tmp_path):
    head = "t,u,x,y,z\n"
    rows = [f"{k / 10},{k % 5},{k},{2 * k},3\n" for k in range(40)]
    (tmp_path / "a.csv").write_text(head + "".join(rows[20:]))
    (tmp_path / "b.csv").write_text(head + "".join(rows[:20]))
    log = 'time = { column = "t" }\ncommand = { columns = ["u"] }\nmarkers = { columns = [["x", "y", "z"]] }\n'
    mapping = 'schema = "softmap.mapping/1"\n' + "".join(
        f'[[log]]\nfile = "{name}"\n{log}' for name in ("a*", "b*")
    )
    done = imported([tmp_path / "a.csv", tmp_path / "b.csv"], mapping)
    assert done.run.t == pytest.approx(np.arange(40) / 10) and any(
        "b.csv, a.csv" in note for note in done.notes
    )
    (tmp_path / "b.csv").write_text(head + "".join(rows[:30]))
    assert "overlap in time (t ends at 2.9 s and begins at 2 s)" in refused(
        [tmp_path / "a.csv", tmp_path / "b.csv"], mapping
    )


# --- .db3 ----------------------------------------------------------------------------------
@pytest.mark.parametrize("options", [{}, {"definitions": True}, {"packed": True}])
def test_db3_gives_what_mcap_gives(tmp_path, options):
    same(
        imported([write_db3(tmp_path / "run.db3", messages(), **options)]).run,
        imported([write_mcap(tmp_path / "run.mcap", messages())]).run,
    )
    listed = {
        topic.name: (topic.type, topic.count) for topic in topics_of_db3(tmp_path / "run.db3")
    }
    assert listed["/goal"] == ("sensor_msgs/msg/JointState", 60)


OWN = ("my_msgs/msg/Tendons", "float64[2] pull\nint32 mode\n")


def test_own_types_need_their_definition(tmp_path):
    recorded = [("/pull", OWN, {"pull": [k, 2.0 * k], "mode": 1}, START + k) for k in range(5)]
    held = open_db3(write_db3(tmp_path / "with.db3", recorded, definitions=True), None)
    assert list(held.numbers[:, held.names.index("pull[1]")]) == [0, 2, 4, 6, 8]
    without = write_db3(tmp_path / "without.db3", recorded)
    with pytest.raises(
        RunError,
        match="its type my_msgs/msg/Tendons is not one of the common ones.*`ros2 bag convert`",
    ):
        open_db3(without, "/pull")
    assert not topics_of_db3(without)[0].readable
    with pytest.raises(
        RunError, match=r"/pull \(my_msgs/msg/Tendons\); convert the recording where ROS knows"
    ):
        guess_mapping([without])


def test_a_type_that_is_not_the_common_one_is_refused_by_what_is_left_over(tmp_path):
    name = "sensor_msgs/msg/Temperature"
    longer = (name, "float64 a\nfloat64 b\nfloat64 c\nfloat64 d\nfloat64 e\n")
    path = write_db3(tmp_path / "run.db3", [("/a", longer, dict.fromkeys("abcde", 0.0), START)])
    with pytest.raises(
        RunError,
        match="bytes of a message are left over; the file is damaged, or its .* is not the common",
    ):
        open_db3(path, None)


def test_every_common_definition_can_be_read_and_holds_its_types():
    assert len(_TYPES) > 60
    for name in _TYPES:
        types = parse_definition(
            name.replace("/", "/msg/"), known_definition(name.replace("/", "/msg/"))
        )
        assert types[name]
    assert known_definition("my_msgs/msg/Tendons") is None


def spoilt_db3(folder, script, recorded=True):
    path = write_db3(folder / "run.db3", messages() if recorded else [])
    with sqlite3.connect(path) as database:
        database.executescript(script)
    database.close()
    return path


ENDLESS = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) SELECT"


@pytest.mark.parametrize(
    ("script", "words"),
    [
        (
            f"DROP TABLE messages; CREATE VIEW messages AS {ENDLESS} x AS topic_id, x AS "
            "timestamp, x AS data FROM n;",
            "no table `messages`",
        ),
        (
            "DROP TABLE messages; CREATE VIRTUAL TABLE messages USING fts4(topic_id, timestamp, "
            "data);",
            "no table `messages`",
        ),
        (
            "DROP TABLE messages; CREATE TABLE messages(topic_id, timestamp, data AS "
            "(zeroblob(2000000000)));",
            "no table `messages`",
        ),
        ("DROP TABLE topics;", "no table `topics`"),
        ("UPDATE messages SET data = 'text';", "a message without time or bytes"),
        ("UPDATE messages SET timestamp = 'noon';", "a message without time or bytes"),
        ("UPDATE messages SET data = zeroblob(70000000) WHERE id = 3;", "damaged SQLite file"),
        ("UPDATE topics SET name = 3.5, type = zeroblob(3);", "a topic without a name or type"),
        ("UPDATE messages SET data = x'00010000ffffffff';", "the file is damaged"),
    ],
)
def test_a_database_made_to_harm_is_refused(tmp_path, script, words):
    started = time.monotonic()
    message = refused([spoilt_db3(tmp_path, script)])
    assert words in message and time.monotonic() - started < 10, message


def test_a_damaged_database_is_one_error_with_a_way_out(tmp_path):
    path = write_db3(tmp_path / "run.db3", messages())
    data = path.read_bytes()
    path.write_bytes(data[:4096] + bytes(4096) + data[8192:])
    assert "sqlite3 FILE .recover" in refused([path])
    path.write_bytes(data[: len(data) // 2])
    assert "is a damaged SQLite file" in refused([path])


def test_what_an_interrupted_recorder_left_is_read(tmp_path):
    """The last messages lie in the -wal file next to the recording, which is left as it was."""
    import shutil

    path = write_db3(tmp_path / "run.db3", messages(last=40))
    database = sqlite3.connect(path)
    database.execute("PRAGMA journal_mode = WAL")
    database.execute("ATTACH ? AS rest", (str(write_db3(tmp_path / "rest.db3", messages())),))
    database.execute("INSERT INTO main.messages SELECT * FROM rest.messages WHERE id > 40")
    database.commit()
    (tmp_path / "kept").mkdir()
    for name in ("run.db3", "run.db3-wal"):
        shutil.copy(tmp_path / name, tmp_path / "kept" / name)
    database.close()
    before = (tmp_path / "kept/run.db3-wal").read_bytes()
    done = imported([tmp_path / "kept/run.db3"])
    assert len(done.run.t) == 60 and any(
        "the recorder was interrupted" in note for note in done.notes
    )
    assert (tmp_path / "kept/run.db3-wal").read_bytes() == before


# --- packed files --------------------------------------------------------------------------
CSV = "t,u,x,y,z\n" + "".join(f"{k / 10},{k % 5},{k},{2 * k},3\n" for k in range(40))
CSV_MAP = """schema = "softmap.mapping/1"
[[log]]
time = { column = "t" }
command = { columns = ["u"] }
markers = { columns = [["x", "y", "z"]] }
"""
FRAMES = zstandard.ZstdCompressor(write_checksum=True).compress(CSV[:300].encode())
FRAMES += zstandard.ZstdCompressor(write_checksum=True).compress(CSV[300:].encode())


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("log.csv.gz", gzip.compress(CSV.encode())),
        ("log.csv.zst", FRAMES),
        ("log.csv", gzip.compress(CSV.encode())),
    ],
)
def test_a_packed_log_is_unpacked_whatever_its_name(tmp_path, name, data):
    (tmp_path / name).write_bytes(data)
    assert imported([tmp_path / name], CSV_MAP).run.t == pytest.approx(np.arange(40) / 10)


@pytest.mark.parametrize("name", ["log.csv.gz", "log.csv.zst"])
def test_damage_and_cuts_of_a_packed_log_are_found(tmp_path, name):
    """Both packings carry a checksum of the content."""
    sound = FRAMES if name.endswith("zst") else gzip.compress(CSV.encode())
    for data in (
        sound[:-10],
        sound[:-2] + bytes([sound[-2] ^ 1]) + sound[-1:],
        sound[:40] + b"\xff" * 20 + sound[60:],
    ):
        (tmp_path / name).write_bytes(data)
        message = refused([tmp_path / name], CSV_MAP)
        assert tempfile.gettempdir() + "/softmap-" not in message and name in message, message


def test_a_packed_file_that_grows_without_end_is_stopped(tmp_path, monkeypatch):
    from softmap_edge.logs.readers import packed

    monkeypatch.setattr(packed, "LIMIT", 2**22)
    zeros = bytes(2**24)
    for name, data in (
        ("a.csv.gz", gzip.compress(zeros)),
        ("b.csv.zst", zstandard.ZstdCompressor().compress(zeros)),
    ):
        (tmp_path / name).write_bytes(data)
        assert "holds more than 4194304 bytes when unpacked" in refused([tmp_path / name], CSV_MAP)
    (tmp_path / "c.gz").write_bytes(gzip.compress(gzip.compress(CSV.encode())))
    assert "is packed twice" in refused([tmp_path / "c.gz"], CSV_MAP)
    assert not list(Path(tempfile.gettempdir()).glob("softmap-*/a.csv"))


def test_a_fault_inside_a_packed_file_names_the_file_that_was_given(tmp_path):
    (tmp_path / "log.csv.gz").write_bytes(gzip.compress(CSV.replace("0.5,", "x,", 1).encode()))
    message = refused([tmp_path / "log.csv.gz"], CSV_MAP)
    assert re.search(r"log.csv.gz: line 7, column t: 'x' is not a number", message), message


def test_a_query_without_end_is_stopped(tmp_path):
    """The number of steps is bounded, however busy the computer is."""
    from softmap_edge.logs.readers.rosbag_sqlite import _harden

    database = sqlite3.connect(tmp_path / "a.db3")
    _harden(database, 10**6)
    with pytest.raises(sqlite3.OperationalError, match="interrupted"):
        database.execute(f"{ENDLESS} max(x) FROM n").fetchall()
    with pytest.raises(sqlite3.Error):
        database.execute("ATTACH 'other.db3' AS other")
    database.close()


def test_a_long_recording_is_within_the_steps(tmp_path):
    path = write_db3(tmp_path / "run.db3", messages())
    with sqlite3.connect(path) as database:
        for _ in range(12):
            database.execute(
                "INSERT INTO messages SELECT NULL, topic_id, timestamp + 600000000, data FROM "
                "messages"
            )
    database.close()
    listed = {topic.name: topic.count for topic in topics_of_db3(path)}
    assert listed == {"/goal": 60 * 4096, "/joint_states": 30 * 4096, "/poses": 15 * 4096}


def test_a_mapping_may_name_the_folder_or_the_file_in_it(tmp_path, monkeypatch):
    folder = write_folder(tmp_path / "bag", ["bag_0.db3"])
    write_db3(folder / "bag_0.db3", messages())
    complete = imported([folder]).run
    for name in ("bag", "bag_*", "bag_0.db3"):
        same(
            imported([folder], MAP.replace("[[log]]\n", f'[[log]]\nfile = "{name}"\n')).run,
            complete,
        )
    assert "log 'other*': no given file fits" in refused(
        [folder], MAP.replace("[[log]]", '[[log]]\nfile = "other*"')
    )
    monkeypatch.chdir(folder)
    done = imported([Path(".")])
    same(done.run, complete)
    assert (
        guess_mapping([Path(".")]).text.splitlines()[1].startswith("# ASSUMED  time of bag /goal")
    )


def test_damage_of_a_packed_recording_names_the_packed_file(tmp_path):
    path = tmp_path / "run.mcap"
    write_mcap(path, messages(), compression="none")
    packed = tmp_path / "run.mcap.zstd"
    packed.write_bytes(zstandard.ZstdCompressor().compress(path.read_bytes()[:-100]))  # cut short
    path.unlink()
    with pytest.warns(RecordingWarning) as warned:
        done = imported([packed])
    for text in (*done.damage, *(str(one.message) for one in warned)):
        assert str(packed) in text and tempfile.gettempdir() + "/softmap-" not in text
    assert done.damage
