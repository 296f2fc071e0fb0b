"""Damaged logs of every format, and damaged mappings, give an error of ours: never a crash or
another exception.

Each format is one line of FORMATS; `damage.py` says how files are spoiled and used.
"""

import json

import pytest
from bench_rows import NAMES, rows, write
from damage import Format, assert_10000, assert_some, run_all, spoil_one_of, spoil_text_file
from recordings import (
    JOINT_STATE,
    places,
    robot_messages,
    write_c3d,
    write_mcap,
    write_motive,
    write_trc,
)
from spoiled_bytes import LOG, spoil_binary, spoil_counts

MAP = """schema = "softmap.mapping/1"
robot = "bench"
command_unit = "deg"
zero_time = true
[[log]]
file = "*.csv"
skip_rows = 0
time = { column = "t", unit = "s", offset_s = 0.5, repeated = "refuse" }
command = { columns = ["a"], unit = "rad", scale = [-1], offset = 0.1 }
present = { columns = ["b"], held = "unhold" }
markers = { columns = [["x", "y", "z"]], unit = "cm" }
[frame]
axes = ["x", "z", "-y"]
origin_mm = [1.0, 2.0, 3.0]
[commands]
rate_hz = 20
[seen]
rate_hz = 5
from_s = 0.6
[blocks]
count = 3
[constant]
gravity = [0.0, 0.0, 1.0]
load_g = { "*" = 5.0 }
"""


def logs_sample(folder):
    (folder / "log.csv").write_text(LOG)
    (folder / "map.toml").write_text(MAP)
    return folder


def named_sample(folder):
    """A log whose columns are called as a laboratory calls them."""
    (folder / "log.csv").write_text(LOG.replace("t,a,b,x,y,z", "time_s,u1,phi1,tip_x,tip_y,tip_z"))
    return folder


def trc_sample(folder):
    return write_trc(folder / "take.trc", *places(20))


def motive_sample(folder):
    t, points = places(20)
    return write_motive(folder / "take.csv", t, points / 1000)


def qtm_sample(folder):
    head = ["NO_OF_FRAMES\t20", "NO_OF_MARKERS\t1", "FREQUENCY\t20", "MARKER_NAMES\ttip"]
    return write(folder / "take.tsv", head, ["\t".join(line.split(",")[3:]) for line in rows(20)])


def nexus_sample(folder):
    head = ["Trajectories", "20", ",,robot:tip,,", "Frame,Sub Frame,X,Y,Z", ",,mm,mm,mm"]
    lines = [f"{k + 1},0," + ",".join(line.split(",")[3:]) for k, line in enumerate(rows(20))]
    return write(
        folder / "take.csv", head, lines, "", "Devices", "1000", "Frame,Sub Frame,F", ",,N", "1,0,2"
    )


def lvm_sample(folder):
    head = [
        "LabVIEW Measurement\t",
        "Separator\tTab",
        "Decimal_Separator\t,",
        "X_Columns\tNo",
        "***End_of_Header***\t",
    ]
    head += [
        "Delta_X\t0,05\t0,05",
        "***End_of_Header***\t\t",
        "\t".join(["X_Value", *NAMES[1:], "Comment"]),
    ]
    return write(
        folder / "log.lvm", head, ["\t" + line.split("\t", 1)[1] for line in rows(20, "\t", ",")]
    )


def typed_sample(folder):
    lines = [
        f"frame,{k},{k / 20},0,1," + ",".join(line.split(",")[3:]) + ",1,tip"
        for k, line in enumerate(rows(20))
    ]
    return write(folder / "old.csv", "comment,a", "righthanded", "info,version,1.1", lines)


def dated_sample(folder):
    """Lines above the names, dates, decimal commas."""
    times = [f"07.05.2031 23:59:{59.1 + k / 20:.2f}" for k in range(18)]
    lines = rows(18, ";", ",", time=lambda k: times[k])
    write(folder / "log.csv", "sep=;", "Versuch;3", ";".join(["Zeit", *NAMES[1:]]), lines)
    return folder


def json_sample(folder):
    """JSON Lines with commands, a nested place and a missing key."""
    lines = [
        {
            "t": k / 20,
            "cmd": [k % 3, -(k % 5)],
            "tip": {"x": 0.3 * k, "y": 7.5, "z": 90.0 - 0.1 * k},
        }
        for k in range(20)
    ]
    del lines[7]["tip"]
    path = folder / "log.jsonl"
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


def long_sample(folder):
    """One row for each of three markers of each frame."""
    return write(
        folder / "log.csv",
        "time_s,u1,marker,x,y,z",
        [
            f"{k / 20},{k % 7},{name},{0.1 * k * m:.2f},{5.0 * m},{30.0 * m}"
            for k in range(15)
            for m, name in enumerate(("base", "middle", "tip"))
        ],
    )


def likelihood_sample(folder):
    """Places in pixels with their likelihood, below three lines of names, as DeepLabCut writes."""
    parts = ("base", "tip")
    return write(
        folder / "log.csv",
        "scorer" + ",net" * 6,
        "bodyparts," + ",".join(f"{part},{part},{part}" for part in parts),
        "coords" + ",x,y,likelihood" * 2,
        [
            f"{k},{310 + k},{220.5},0.99,{300 + 3 * k},{80.25},{0.2 if k == 4 else 0.97}"
            for k in range(20)
        ],
    )


def c3d_sample(folder):
    return write_c3d(folder / "take.c3d", *places(20))


def mcap_sample(folder):
    return write_mcap(folder / "run.mcap", robot_messages(20), "zstd")


def bare_mcap_sample(folder):
    """Chunks that are not packed, so that the damage reaches the messages and their definitions."""
    return write_mcap(folder / "run.mcap", robot_messages(20), "none")


def message_sample(folder):
    """One message, without the recording around it: every byte of the damage is felt by the
    decoder.
    """
    from mcap_ros2._dynamic import serialize_dynamic
    from recordings import joint_state

    encode = serialize_dynamic(*JOINT_STATE)[JOINT_STATE[0]]
    (folder / "message.cdr").write_bytes(encode(joint_state(1.5, (1.0, 2.0))))
    return folder / "message.cdr"


# --- use -----------------------------------------------------------------------------------
def use_logs(folder):
    from softmap_edge.logs.importer import import_logs, read_mapping

    import_logs([folder / "log.csv"], read_mapping(folder / "map.toml"))


MARKERS = """schema = "softmap.mapping/1"
[[log]]
time = { column = "time" }
markers = { columns = ["base.x", "base.y", "base.z", "middle.x", "middle.y", "middle.z", "tip.x", "tip.y", "tip.z"] }
"""


TIP = ", ".join(f'"transforms[tip].transform.translation.{axis}"' for axis in "xyz")
TOPICS = f"""schema = "softmap.mapping/1"
command_unit = "rad"
[[log]]
topic = "/goal"
time = {{ column = "time" }}
command = {{ columns = ["position[left]"] }}
[[log]]
topic = "/tf"
time = {{ column = "log_time" }}
markers = {{ unit = "m", columns = [{TIP}] }}
"""


def use_markers(path):
    from softmap_edge.logs.importer import import_logs, read_mapping

    (path.parent / "map.toml").write_text(MARKERS)
    import_logs([path], read_mapping(path.parent / "map.toml"))


def use_mcap(path):
    from softmap_edge.logs.importer import import_logs, read_mapping
    from softmap_edge.logs.readers.mcap_file import topics

    topics(path)
    (path.parent / "map.toml").write_text(TOPICS)
    import_logs([path], read_mapping(path.parent / "map.toml"))


def use_guess(path):
    """Propose a mapping; what it proposes is text that can be read, whatever the trial import
    says.
    """
    from softmap_edge.logs.guess import guess_mapping
    from softmap_edge.logs.mapping import parse_mapping

    found = guess_mapping([path / "log.csv" if path.is_dir() else path])
    parse_mapping(found.text, path)


def use_message(path):
    from softmap_edge.errors import RunError
    from softmap_edge.logs.readers.cdr import CdrError, parse_definition, read_message

    try:
        read_message(JOINT_STATE[0], parse_definition(*JOINT_STATE), path.read_bytes())
    except CdrError as fault:
        raise RunError(str(fault)) from None


FORMATS = [
    Format("log", logs_sample, spoil_one_of("log.csv"), use_logs),
    Format("mapping", logs_sample, spoil_one_of("map.toml"), use_logs),
    Format("trc", trc_sample, spoil_text_file, use_markers),
    Format("motive", motive_sample, spoil_text_file, use_markers),
    Format("c3d", c3d_sample, spoil_binary, use_markers),
    Format("c3d counts", c3d_sample, spoil_counts, use_markers),
    Format("mcap", mcap_sample, spoil_binary, use_mcap),
    Format("mcap bare", bare_mcap_sample, spoil_binary, use_mcap),
    Format("mcap counts", bare_mcap_sample, spoil_counts, use_mcap),
    Format("guess", named_sample, spoil_one_of("log.csv"), use_guess),
    Format("guess of motive", motive_sample, spoil_text_file, use_guess),
    Format("guess of qtm", qtm_sample, spoil_text_file, use_guess),
    Format("guess of nexus", nexus_sample, spoil_text_file, use_guess),
    Format("guess of lvm", lvm_sample, spoil_text_file, use_guess),
    Format("guess of rows of types", typed_sample, spoil_text_file, use_guess),
    Format("guess of dates", dated_sample, spoil_one_of("log.csv"), use_guess),
    Format("guess of mcap", bare_mcap_sample, spoil_counts, use_guess),
    Format("guess of JSON Lines", json_sample, spoil_text_file, use_guess),
    Format("guess of a long table", long_sample, spoil_text_file, use_guess),
    Format("guess of likelihoods", likelihood_sample, spoil_text_file, use_guess),
    Format("message", message_sample, spoil_counts, use_message),
]


@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_damaged_logs(form, tmp_path):
    assert_some(__file__, form, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_500_damaged_logs(form, tmp_path):
    assert_some(__file__, form, tmp_path, 500)


@pytest.mark.prove
@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_10000_damaged_logs(form, tmp_path):
    assert_10000(__file__, form, tmp_path)


if __name__ == "__main__":
    run_all(FORMATS)
