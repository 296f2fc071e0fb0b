"""Recordings as other programs leave them, made for the tests: .db3, folders, datasets, MATLAB
files.
"""

import json
import sqlite3

import numpy as np
from recordings import JOINT_STATE, POSES, robot_messages

ARRAYS = """schema = "softmap.mapping/1"
[[log]]
time = { column = "t" }
command = { columns = ["u[0]", "u[1]"] }
markers = { columns = [["tip[0]", "tip[1]", "tip[2]"]] }
"""
METADATA = """rosbag2_bagfile_information:
  version: 5
  storage_identifier: sqlite3
  relative_file_paths:
FILES
  duration:
    nanoseconds: 1000000000
  message_count: 240
"""
SCHEMA = """
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
    serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
    data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
"""
DEFINITIONS = """
CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
    encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
"""


def messages(frames=60, first=0, last=None):
    """Goals and poses of one robot, those from `first` to `last`."""
    chosen = [message for message in robot_messages(frames) if message[1] in (JOINT_STATE, POSES)]
    return chosen[first:last]


def write_db3(path, recorded, definitions=False, packed=False):
    """A recording of (topic, definition, message, s) as rosbag2's sqlite3 storage writes it."""
    from mcap_ros2._dynamic import serialize_dynamic

    database = sqlite3.connect(path)
    database.executescript(SCHEMA + (DEFINITIONS if definitions else ""))
    encoders, topics = {}, {}
    for topic, (kind, text), message, seconds in recorded:
        if kind not in encoders:
            encoders[kind] = serialize_dynamic(kind, text)[kind]
            if definitions:
                row = (kind, "ros2msg", text, "")
                database.execute("INSERT INTO message_definitions VALUES (NULL, ?, ?, ?, ?)", row)
        if topic not in topics:
            topics[topic] = len(topics) + 1
            database.execute(
                "INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", (topics[topic], topic, kind)
            )
        data = bytes(encoders[kind](message))
        if packed:
            import zstandard

            data = zstandard.ZstdCompressor().compress(data)
        ns = int(round(seconds * 1e9))
        database.execute("INSERT INTO messages VALUES (NULL, ?, ?, ?)", (topics[topic], ns, data))
    database.commit()
    database.close()
    return path


def write_folder(folder, names, form="    - NAME"):
    """The metadata.yaml of a folder of rosbag2."""
    folder.mkdir(exist_ok=True)
    listed = "\n".join(form.replace("NAME", name) for name in names)
    (folder / "metadata.yaml").write_text(METADATA.replace("FILES", listed))
    return folder


def arrays(rows=80):
    """Time, two commands and a tip: what the arrays of a log hold."""
    t = 0.05 * np.arange(rows)
    u = np.column_stack([5 * np.sin(t), 4 * np.cos(t)])
    tip = np.column_stack([10 + 3 * np.sin(t), 2 * np.cos(t), 90 - np.abs(np.sin(t))])
    return {"t": t, "u": u, "tip": tip}


def write_mat73(path, values, classes=None):
    """A MATLAB file of v7.3: HDF5 behind 512 bytes of text, arrays turned as MATLAB keeps them."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in values.items():
            entry = file.create_dataset(name.replace(".", "/"), data=np.atleast_2d(value).T)
            entry.attrs["MATLAB_class"] = np.bytes_((classes or {}).get(name, "double"))
    data = bytearray(path.read_bytes())
    text = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Fri Nov 27 12:00:00 2026 HDF5 schema 1.00 ."
    data[:128] = text.ljust(124) + b"\x00\x02IM"
    path.write_bytes(data)
    return path


JOINTS = ["shoulder_pan.pos", "gripper.pos"]


def write_dataset(folder, episodes=3, rows=40, fps=30, names=JOINTS):
    """A LeRobot dataset of v3: all episodes in one Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    (folder / "meta").mkdir(parents=True)
    (folder / "data/chunk-000").mkdir(parents=True)
    t = np.tile(np.arange(rows) / fps, episodes)
    which = np.repeat(np.arange(episodes), rows)
    state = np.column_stack([50 * np.sin(t + which), 40 * np.cos(t)])
    action = state + 1.0
    vectors = pa.list_(pa.float32(), len(names))
    table = pa.table(
        {
            "action": pa.array(action.astype(np.float32).tolist(), vectors),
            "observation.state": pa.array(state.astype(np.float32).tolist(), vectors),
            "timestamp": pa.array(t.astype(np.float32)),
            "frame_index": np.tile(np.arange(rows), episodes),
            "episode_index": which,
            "index": np.arange(rows * episodes),
            "task_index": np.zeros(rows * episodes, np.int64),
        }
    )
    pq.write_table(table, folder / "data/chunk-000/file-000.parquet", write_page_checksum=True)
    feature = {"dtype": "float32", "shape": [len(names)], "names": names}
    camera = {"dtype": "video", "shape": [480, 640, 3], "names": ["height", "width", "channels"]}
    info = {
        "codebase_version": "v3.0",
        "fps": fps,
        "total_episodes": episodes,
        "robot_type": "so101",
    }
    info["features"] = {
        "action": feature,
        "observation.state": feature,
        "observation.images.front": camera,
    }
    (folder / "meta/info.json").write_text(json.dumps(info))
    return folder
