"""rosbag2 recordings in MCAP become runs: joint states, poses and transforms by topic; a second
decoder agrees.
"""

import struct

import numpy as np
import pytest
from recordings import (
    JOINT_STATE,
    LABELS,
    POSES,
    TRANSFORMS,
    joint_state,
    places,
    robot_messages,
    write_mcap,
)

from softmap_edge.errors import RecordingWarning, RunError
from softmap_edge.logs.importer import import_logs, read_mapping
from softmap_edge.logs.readers.cdr import CdrError, Message, parse_definition, read_message
from softmap_edge.logs.readers.mcap_file import open_mcap, topics
from softmap_edge.logs.readers.messages import MessageRows

START = 1_700_000_000.0
MAP = """schema = "softmap.mapping/1"
command_unit = "rad"
zero_time = true
[[log]]
topic = "/goal"
time = { column = "time" }
command = { columns = ["position[left]", "position[right]"], unit = "rad" }
[[log]]
topic = "/joint_states"
time = { column = "time" }
present = { columns = ["position[left]", "position[right]"], unit = "rad" }
[[log]]
topic = "/tf"
time = { column = "log_time" }
markers = { unit = "m", columns = [COLUMNS] }
"""
TF = ", ".join(
    str([f"transforms[{label}].transform.translation.{axis}" for axis in "xyz"]).replace("'", '"')
    for label in LABELS
)


def recorded(folder, mapping=None, compression="zstd", messages=None):
    path = write_mcap(
        folder / "run.mcap", robot_messages() if messages is None else messages, compression
    )
    (folder / "map.toml").write_text(mapping or MAP.replace("COLUMNS", TF))
    return import_logs([path], read_mapping(folder / "map.toml"))


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_topics_of_one_recording_are_joined_by_time(tmp_path, compression):
    run = recorded(tmp_path, compression=compression).run
    t, points = places()
    assert run.t == pytest.approx(t, abs=1e-6)  # a float of seconds since 1970 resolves 0.2 µs
    goal = np.column_stack([np.sin(3 * t), np.cos(3 * t)])
    assert run.command == pytest.approx(goal, abs=1e-12)
    # on the line between two states
    assert np.abs(run.present - 0.9 * goal)[:59].max() < 0.9 * 9 * 0.01**2 / 2 + 1e-6
    assert run.markers[~run.visible].shape == (1, 3) and not run.visible[2, 2]
    assert run.markers[[0, 1, 3]] == pytest.approx(points[[0, 4, 12]], abs=1e-9)
    assert list(run.extra["marker_labels"]) == [
        f"transforms[{label}].transform.translation" for label in LABELS
    ]


def test_poses_have_numbers_where_they_have_no_names(tmp_path):
    columns = ", ".join(str([f"poses[{k}].position.{axis}" for axis in "xyz"]) for k in range(3))
    mapping = MAP.replace("/tf", "/poses").replace("COLUMNS", columns).replace("log_time", "time")
    run = recorded(tmp_path, mapping).run
    assert run.markers == pytest.approx(places()[1][::4], abs=1e-9) and run.visible is None


def test_topics_are_listed(tmp_path):
    path = write_mcap(tmp_path / "run.mcap", robot_messages())
    found = {topic.name: (topic.type, topic.count) for topic in topics(path)}
    assert found["/goal"] == ("sensor_msgs/msg/JointState", 60) and found["/tf"] == (
        "tf2_msgs/msg/TFMessage",
        15,
    )


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('topic = "/goal"', 'topic = "/gaol"', ["no message of topic /gaol", "/joint_states"]),
        ('topic = "/goal"\n', "", ["holds 4 topics", "/goal (sensor_msgs/msg/JointState)"]),
        ("position[left]", "position[up]", ["no column position[up]", "position[left]"]),
    ],
)
def test_what_a_mapping_gets_wrong(tmp_path, old, new, words):
    with pytest.raises(RunError) as fault:
        recorded(tmp_path, MAP.replace("COLUMNS", TF).replace(old, new, 1))
    assert all(word in str(fault.value) for word in words) and "\n" not in str(fault.value), str(
        fault.value
    )


def test_a_topic_of_a_csv_is_refused(tmp_path):
    (tmp_path / "log.csv").write_text("t,u\n0,1\n1,2\n")
    (tmp_path / "map.toml").write_text(
        'schema = "softmap.mapping/1"\n[[log]]\ntopic = "/a"\ntime = { column = "t" }\ncommand = '
        '{ columns = ["u"] }\n'
    )
    with pytest.raises(RunError, match="topic = '/a' is for MCAP files"):
        import_logs([tmp_path / "log.csv"], read_mapping(tmp_path / "map.toml"))


def test_a_recording_that_was_cut_off_is_read_as_far_as_it_goes(tmp_path):
    path = write_mcap(tmp_path / "whole.mcap", robot_messages(600), "none")
    cut = tmp_path / "run.mcap"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size // 3])
    (tmp_path / "map.toml").write_text(MAP.replace("COLUMNS", TF))
    with pytest.warns(RecordingWarning, match="run.mcap was cut short: it is read up to [12]"):
        done = import_logs([cut], read_mapping(tmp_path / "map.toml"))
    assert 50 < len(done.run.t) < 400 and len(done.damage) == 1, (
        "one sentence for three topics of one file"
    )


def chunk_of(folder, size, data, compression="zstd"):
    """A recording of one chunk that states `size` and holds `data`."""
    text = compression.encode()
    body = (
        struct.pack("<QQQI", 0, 0, size, 0)
        + struct.pack("<I", len(text))
        + text
        + struct.pack("<Q", len(data))
        + data
    )
    start = struct.pack("<BQII", 1, 8, 0, 0)  # a header without profile and library
    whole = b"\x89MCAP0\r\n" + start + struct.pack("<BQ", 6, len(body)) + body
    (folder / "run.mcap").write_bytes(whole)
    return folder / "run.mcap"


def test_a_chunk_that_unpacks_to_more_than_it_states_is_stopped(tmp_path):
    """1 GiB of zeros in 100 kB: unpacked only as far as the file says it goes, in little memory."""
    import tracemalloc

    import lz4.frame
    import zstandard

    zeros = bytes(2**24)
    packer = zstandard.ZstdCompressor().compressobj()
    bomb = b"".join(packer.compress(zeros) for _ in range(64)) + packer.flush()
    squeezer = lz4.frame.LZ4FrameCompressor()
    brick = (
        squeezer.begin() + b"".join(squeezer.compress(zeros) for _ in range(64)) + squeezer.flush()
    )
    for data, compression in ((bomb, "zstd"), (brick, "lz4")):
        path = chunk_of(tmp_path, 1000, data, compression)
        tracemalloc.start()
        with pytest.raises(RunError, match="a chunk holds 1001 bytes, but states 1000"):
            topics(path)
        assert tracemalloc.get_traced_memory()[1] < 64 * 2**20
        tracemalloc.stop()
    with pytest.raises(RunError, match="a chunk of 1099511627776 bytes"):
        topics(chunk_of(tmp_path, 2**40, bomb))


def test_joints_that_change_their_order_keep_their_columns(tmp_path):
    goals = [("/goal", JOINT_STATE, joint_state(1.0, (1, 2)), 1.0)]
    goals.append(("/goal", JOINT_STATE, joint_state(2.0, (4, 3), ("right", "left")), 2.0))
    columns = open_mcap(write_mcap(tmp_path / "run.mcap", goals), "/goal")
    rows = dict(zip(columns.names, columns.numbers.T))
    assert list(rows["position[left]"]) == [1, 3] and list(rows["position[right]"]) == [2, 4]


def test_stamps_that_were_never_set_are_replaced_by_the_time_of_logging(tmp_path):
    goals = [("/goal", JOINT_STATE, joint_state(0.0, (1, 2)), 5.0 + k) for k in range(3)]
    columns = open_mcap(write_mcap(tmp_path / "run.mcap", goals), None)
    assert list(columns.numbers[:, columns.names.index("time")]) == [5.0, 6.0, 7.0]


# --- messages ------------------------------------------------------------------------------
def flat(message, path=""):
    """The numbers of a message of the other decoder."""
    for name in message.__slots__:
        value = getattr(message, name)
        values = value if isinstance(value, list | tuple) or hasattr(value, "tolist") else [value]
        for k, item in enumerate(values):
            here = f"{path}{name}" + (f"[{k}]" if values is value else "")
            if hasattr(item, "__slots__"):
                yield from flat(item, f"{here}.")
            elif not isinstance(item, str):
                yield here, float(item)


def test_another_decoder_reads_the_same_numbers(tmp_path):
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    path = write_mcap(tmp_path / "run.mcap", robot_messages())
    for topic in ("/goal", "/poses", "/tf"):
        ours = open_mcap(path, topic).numbers
        ours = ours[:, 2:] if topic != "/tf" else ours[:, 1:-1]
        with path.open("rb") as file:
            decoded = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(
                topics=[topic]
            )
            theirs = [
                [v for n, v in flat(message) if "stamp" not in n] for _, _, _, message in decoded
            ]
        for row, other in zip(ours, theirs, strict=True):
            row = row[np.isfinite(row) & (row < 1e9)]
            assert list(row) == pytest.approx([x for x in other if x < 1e9])


MIXED = (
    "pkg/msg/Mixed",
    "uint8 KIND=3\nint16 a\nfloat64 b\nbool c\nfloat32[2] d\nstring<=5 e 'hi'\nuint8[] f\nint32[<=3] g\n"
    "pkg/Empty h\nint64 i\n" + "=" * 80 + "\nMSG: pkg/Empty\n",
)


@pytest.mark.parametrize("order", ["<", ">"])
def test_alignment_order_bounds_and_constants(order):
    types = parse_definition(*MIXED)
    e = struct.pack
    body = (
        e(order + "h", -2)
        + b"\0" * 6
        + e(order + "d", 1.5)
        + b"\1"
        + b"\0" * 3
        + e(order + "ff", 0.25, 4.0)
    )
    body += (
        e(order + "I", 3)
        + b"hi\0"
        + b"\0"
        + e(order + "I", 2)
        + b"\7\7"
        + b"\0" * 2
        + e(order + "Iii", 2, 5, -6)
    )
    body += b"\0" + b"\0" * ((-len(body) - 1) % 8) + e(order + "q", 7)
    content = bytes([0, int(order == "<"), 0, 0]) + body
    numbers = read_message(MIXED[0], types, content).numbers
    assert numbers == {
        "a": -2,
        "b": 1.5,
        "c": 1,
        "d[0]": 0.25,
        "d[1]": 4,
        "g[0]": 5,
        "g[1]": -6,
        "i": 7,
    }


BAR = "\n" + "=" * 80 + "\nMSG: "
NESTED = f"pkg/B[1000] b{BAR}pkg/B\npkg/C[1000] c{BAR}pkg/C\npkg/D[1000] d{BAR}pkg/D\n%s"


def test_structs_without_a_byte_are_read():
    types = parse_definition("pkg/msg/M", f"pkg/B[50] b\nfloat64 y{BAR}pkg/B\nfloat64[0] x")
    data = b"\0\1\0\0" + struct.pack("<d", 2.5) + bytes(50)
    assert read_message("pkg/msg/M", types, data).numbers == {"y": 2.5}


@pytest.mark.parametrize(
    ("definition", "data", "words"),
    [
        ("float64[] x", b"\0\1\0\0" + b"\xff\xff\xff\xff", "longer than its message"),
        ("string[] x", b"\0\1\0\0" + b"\xff\xff\xff\x7f", "longer than its message"),
        ("float64 x", b"\0\1\0\0\0\0", "ends early"),
        ("float64 x", b"\0\7\0\0" + b"\0" * 8, "expected plain CDR"),
        ("float64[1000000] x", b"\0\1\0\0" + b"\0" * 8, "longer than its message"),
        ("pkg/A x\n" + "=" * 80 + "\nMSG: pkg/A\npkg/A y", b"\0\1\0\0", "without end"),
        (
            "pkg/B[4000000000] x\n" + "=" * 80 + "\nMSG: pkg/B\n",
            b"\0\1\0\0\0",
            "longer than its message",
        ),
        ("pkg/Absent x", b"\0\1\0\0", "not defined"),
        ("float64 x; y", b"\0\1\0\0", "not defined|not a field|ends early"),
        (
            "\n".join(f"float64[1000] x{k}" for k in range(5)),
            b"\0\1\0\0" + b"\0" * 40_000,
            "more than 4096",
        ),
        (NESTED % "uint8[0] x", b"\0\1\0\0" + b"\0" * 1000, "more values than it has bytes"),
        (
            NESTED % "\n".join(f"float64[0] x{k}" for k in range(9)),
            b"\0\1\0\0" + b"\0" * 1000,
            "more values than",
        ),
        (f"float64[{'9' * 5000}] x", b"\0\1\0\0" + b"\0" * 8, "longer than any message"),
        ("wstring x", b"\0\1\0\0\0\0\0\0", "wstring"),
    ],
)
def test_hostile_messages_end_in_an_error(definition, data, words):
    with pytest.raises(CdrError, match=words):
        read_message("pkg/msg/M", parse_definition("pkg/msg/M", definition), data)


def test_every_definition_of_the_tests_is_read():
    for name, text in (JOINT_STATE, POSES, TRANSFORMS):
        assert name.replace("/msg/", "/") in parse_definition(name, text)


@pytest.mark.parametrize("field", ["time", "log_time"])
def test_a_field_called_as_a_column_of_time_keeps_its_own_column(tmp_path, field):
    rows = MessageRows(tmp_path / "log.mcap", "/t")
    for k in range(5):
        rows.add(Message({field: 7.0 * k, "pose.x": 3.0 * k}), 100.0 + 0.1 * k)
    columns = rows.columns()
    values = dict(zip(columns.names, columns.numbers.T))
    assert values["time"] == pytest.approx(100 + 0.1 * np.arange(5)) == values["log_time"]
    assert values[f"{field} (field)"] == pytest.approx(7.0 * np.arange(5))
    assert values["pose.x"] == pytest.approx(3.0 * np.arange(5))
    assert any(f"'{field}' of their own" in note for note in columns.notes)


def test_a_stamp_without_a_header_is_a_column_next_to_the_time(tmp_path):
    rows = MessageRows(tmp_path / "log.mcap", "/t")
    for k in range(3):
        rows.add(Message({"stamp": 5.0 + k, "time.sec": 1.0, "x": 2.0}), 100.0 + k)
    columns = rows.columns()
    assert columns.names == ["time", "stamp", "time.sec", "x", "log_time"]
    assert columns.numbers[:, 0] == pytest.approx([100.0, 101.0, 102.0])
