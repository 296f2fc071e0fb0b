"""Topics of one recording are used on one clock and in one frame, or the import says so."""

from collections import Counter

import numpy as np
import pytest
from containers import write_db3
from recordings import (
    BAG_MAP,
    JOINT_STATE,
    POSES,
    TRANSFORMS,
    joint_state,
    pose_array,
    transforms,
    write_mcap,
)

from softmap_edge.errors import RunError
from softmap_edge.logs.importer import import_logs, read_mapping
from softmap_edge.logs.readers.cdr import Message, frame_path
from softmap_edge.logs.readers.messages import MessageRows

START, LATE = 1_700_000_000.0, 0.04  # s: the first message, and from a stamp to its log time
NUMBERS = (
    "std_msgs/msg/Float64MultiArray",
    "std_msgs/MultiArrayLayout layout\nfloat64[] data\n"
    + "=" * 80
    + "\nMSG: std_msgs/MultiArrayLayout\nstd_msgs/MultiArrayDimension[] dim\nuint32 data_offset\n"
    + "=" * 80
    + "\nMSG: std_msgs/MultiArrayDimension\nstring label\nuint32 size\nuint32 stride\n",
)
WRITERS = {"db3": write_db3, "mcap": write_mcap}
NO_STAMP = BAG_MAP.replace("position[left]", "data[0]").replace("position[right]", "data[1]")
TF = BAG_MAP.replace("/poses", "/tf").replace(
    "poses[2].position", "transforms[tip].transform.translation"
)


def recording(change=lambda topic, k, message: message, goal="stamp", seen="/poses", late=LATE):
    """Return 80 goals at 50 Hz and as many places; `change` edits each message, None drops it."""
    messages = []
    for k in range(80):
        at = START + 0.02 * k
        row = np.array([[0, 0, 0.01], [0, 0, 0.05], [0.001 * k, 0, 0.1 - 1e-5 * k * k]])
        u = (np.sin(0.1 * k), np.cos(0.07 * k))
        layout = {"dim": [], "data_offset": 0}
        first = {
            "stamp": (JOINT_STATE, joint_state(at, u)),
            "zero": (JOINT_STATE, joint_state(0.0, u)),
            "none": (NUMBERS, {"layout": layout, "data": list(u)}),
        }[goal]
        second = (
            (POSES, pose_array(at, row)) if seen == "/poses" else (TRANSFORMS, transforms(at, row))
        )
        for topic, (kind, message), wait in (("/goal", first, 0.001), (seen, second, late)):
            edited = change(topic, k, message)
            if edited is not None:
                messages.append((topic, kind, edited, at + wait))
    return sorted(messages, key=lambda one: one[3])


def imported(folder, messages, mapping=BAG_MAP, kind="mcap"):
    path = WRITERS[kind](folder / f"log.{kind}", messages)
    (folder / "map.toml").write_text(mapping)
    return import_logs([path], read_mapping(folder / "map.toml"))


# --- one clock -----------------------------------------------------------------------------
@pytest.mark.parametrize("kind", ["db3", "mcap"])
@pytest.mark.parametrize(("goal", "mapping"), [("zero", BAG_MAP), ("none", NO_STAMP)])
def test_stamps_are_not_mixed_with_log_times_of_a_topic_without(tmp_path, kind, goal, mapping):
    done = imported(tmp_path, recording(goal=goal), mapping, kind)
    assert done.run.t_seen[0] - done.run.t[0] == pytest.approx(LATE - 0.001, abs=1e-5)
    note = next(n for n in done.notes if "stamps are another clock" in n)
    assert "topic /poses: time is the log time, as in /goal" in note and "0.04 s before" in note


def test_stamps_in_all_topics_are_the_time(tmp_path):
    done = imported(tmp_path, recording())
    assert done.run.t_seen[0] == done.run.t[0]
    assert "clock" not in " ".join([*done.notes, *done.doubts])


@pytest.mark.parametrize(("first", "second"), [("header.stamp", "time"), ("log_time", "time")])
def test_two_clocks_that_the_mapping_names_are_reported(tmp_path, first, second):
    """A mapping that names a clock keeps it; the other topic has no stamps, or its own."""
    mapping = BAG_MAP.replace('column = "time"', f'column = "{second}"')
    at = mapping.index("column = ", mapping.index('"/poses"'))
    mapping = mapping[:at] + mapping[at:].replace(f'"{second}"', f'"{first}"', 1)
    goal = "zero" if first == "header.stamp" else "stamp"
    done = imported(tmp_path, recording(goal=goal), mapping)
    assert any("t: two clocks: topic /" in doubt for doubt in done.doubts), done.doubts


@pytest.mark.parametrize("ahead", [-5.0, 1.5])
def test_stamps_of_computers_that_are_not_set_alike_are_reported(tmp_path, ahead):
    def shifted(topic, k, message):
        at = START + 0.02 * k + ahead * (topic == "/poses" and k > 0)
        stamp = {"sec": int(at), "nanosec": round(at % 1 * 1e9)}
        return message | {"header": message["header"] | {"stamp": stamp}}

    messages = recording(shifted)
    if ahead < 0:  # otherwise the frames lie outside the commands
        messages = [m for m in messages if m[0] == "/goal" or m[3] > START + 0.5]
    mapping = (
        BAG_MAP
        if ahead > 0
        else BAG_MAP.replace('"time" }\nmark', '"time", offset_s = 5.0 }\nmark')
    )
    done = imported(tmp_path, messages, mapping)
    assert any("not set alike: /" in doubt for doubt in done.doubts), done.doubts


def test_a_split_recording_whose_second_part_has_no_stamps_is_on_one_clock(tmp_path):
    def unset(topic, k, message):
        stamp = {"sec": 0, "nanosec": 0} if k >= 40 else message["header"]["stamp"]
        return message | {"header": message["header"] | {"stamp": stamp}}

    messages = recording(unset)
    for k, part in enumerate((messages[:80], messages[80:])):
        write_mcap(tmp_path / f"log_{k}.mcap", part)
    (tmp_path / "map.toml").write_text(BAG_MAP)
    files = [tmp_path / "log_0.mcap", tmp_path / "log_1.mcap"]
    done = import_logs(files, read_mapping(tmp_path / "map.toml"))
    assert np.diff(done.run.t) == pytest.approx(0.02, abs=1e-5)
    assert done.run.t_seen[0] - done.run.t[0] == pytest.approx(LATE - 0.001, abs=1e-5)


# --- one frame -----------------------------------------------------------------------------
def in_frame(message, name):
    return message | {"header": message["header"] | {"frame_id": name}}


def halves(topic, k, message):
    return in_frame(message, "camera1" if k < 50 else "/world")


def of_joint(topic, k, message):
    return in_frame(message, f"part{k % 3}") if topic == "/goal" else message


def of_children(topic, k, message):
    if topic != "/tf":
        return message
    frames = ("base", "base", "base", "camera1")
    given = [*message["transforms"], message["transforms"][-1]]
    return {"transforms": [in_frame(one, name) for one, name in zip(given, frames)]}


def of_parents(topic, k, message):
    """A chain: each link in the frame of the link before."""
    if topic != "/tf":
        return message
    frames = ("world", "base", "middle")
    return {"transforms": [in_frame(*one) for one in zip(message["transforms"], frames)]}


@pytest.mark.parametrize("kind", ["db3", "mcap"])
def test_a_frame_that_changes_is_asked_about_and_a_key_chooses(tmp_path, kind):
    with pytest.raises(RunError) as fault:
        imported(
            tmp_path, recording(lambda t, k, m: m if t == "/goal" else halves(t, k, m)), kind=kind
        )
    said = str(fault.value)
    assert "topic /poses: places in 2 frames" in said and "camera1 (50), world (30)" in said
    assert 'frame_id = "camera1"' in said
    for name, frames in (("camera1", 50), ("world", 30)):
        chosen = BAG_MAP.replace('"/poses"', f'"/poses"\nframe_id = "{name}"')
        (tmp_path / "map.toml").write_text(chosen)
        done = import_logs([tmp_path / f"log.{kind}"], read_mapping(tmp_path / "map.toml"))
        assert done.run.frames == frames
        assert any("were left out, as the mapping asks" in note for note in done.notes)


def test_links_of_a_chain_are_not_places_in_one_frame(tmp_path):
    cells = ", ".join(
        str([f"transforms[{one}].transform.translation.{axis}" for axis in "xyz"]).replace("'", '"')
        for one in ("middle", "tip")
    )
    mapping = TF[: TF.index('columns = [["transforms')] + f"columns = [{cells}] }}\n"
    with pytest.raises(RunError, match=r"places in 2 frames.*base \(80\), middle \(80\)"):
        imported(tmp_path, recording(of_parents, seen="/tf"), mapping)


def test_one_link_that_two_cameras_see_is_read_of_the_chosen_one(tmp_path):
    def both(topic, k, message):
        message = of_children(topic, k, message)
        if topic == "/tf" and k % 2:
            message["transforms"].reverse()
        return message

    with pytest.raises(RunError, match="places in 2 frames"):
        imported(tmp_path, recording(both, seen="/tf"), TF)
    chosen = TF.replace('"/tf"', '"/tf"\nframe_id = "base"')
    assert imported(tmp_path, recording(both, seen="/tf", late=0.001), chosen).run.frames == 80


def test_a_frame_without_messages_is_refused_with_those_that_are_there(tmp_path):
    mapping = BAG_MAP.replace('"/poses"', '"/poses"\nframe_id = "wrold"')
    with pytest.raises(
        RunError, match=r"none of 80 messages is in it; its frames are world \(80\)"
    ):
        imported(tmp_path, recording(), mapping)


def test_frames_of_joints_and_messages_that_name_none_do_not_stop_an_import(tmp_path):
    assert imported(tmp_path, recording(of_joint)).run.frames == 80
    unnamed = recording(lambda t, k, m: in_frame(m, "") if k < 9 else m)
    done = imported(tmp_path, unnamed)
    assert any("9 messages name no frame" in doubt for doubt in done.doubts)


def test_a_frame_of_a_table_is_refused(tmp_path):
    (tmp_path / "log.csv").write_text("t,u\n0,1\n1,2\n")
    (tmp_path / "map.toml").write_text(
        'schema = "softmap.mapping/1"\n[[log]]\nframe_id = "a"\ntime = { column = "t" }\n'
        'command = { columns = ["u"] }\n'
    )
    with pytest.raises(RunError, match="is for recordings of ROS"):
        import_logs([tmp_path / "log.csv"], read_mapping(tmp_path / "map.toml"))


def test_frames_without_end_are_refused(tmp_path):
    rows = MessageRows(tmp_path / "log.mcap", "/t", "world")
    with pytest.raises(RunError, match="names more than 65536 frames"):
        for k in range(100):
            rows.add(Message(others=Counter(f"{k}.{j}" for j in range(1024))), 0.0)
    rows = MessageRows(tmp_path / "log.mcap", "/t")
    with pytest.raises(RunError, match="names more than 65536 frames"):
        for k in range(100):
            rows.add(Message({"x": 1.0}, {f"e[{j}].": f"{k}" for j in range(1024)}), 0.0)


@pytest.mark.parametrize(
    ("column", "path"),
    [
        ("poses[1].pose.position.x", "poses[1]."),
        ("poses[2].pose.position.x", ""),
        ("transforms[a.b].transform.x", "transforms[a.b]."),
        ("transforms[a.c].transform.x", ""),
        ("time", ""),
    ],
)
def test_the_nearest_header_gives_the_frame(column, path):
    assert frame_path(column, {"": 1, "poses[1].": 1, "transforms[a.b].": 1}) == path


# --- lists of another length -----------------------------------------------------------------
def without(gone):
    def change(topic, k, message):
        if topic != "/poses" or not 20 < k < 40:
            return message
        return message | {"poses": [one for j, one in enumerate(message["poses"]) if j not in gone]}

    return change


@pytest.mark.parametrize(("gone", "mapped"), [([0], 0), ([1], 0), ([2], 1), ([0, 1], 0)])
def test_a_list_whose_length_changes_is_reported(tmp_path, gone, mapped):
    mapping = BAG_MAP.replace("poses[2]", f"poses[{mapped}]")
    done = imported(tmp_path, recording(without(gone)), mapping)
    said = next(doubt for doubt in done.doubts if "move up when one is missing" in doubt)
    assert f"3 (61), {3 - len(gone)} (19)" in said and f"poses[{mapped}].position.x" in said


@pytest.mark.parametrize("gone", [[], [0, 1, 2]])
def test_a_full_or_empty_list_raises_no_doubt(tmp_path, gone):
    done = imported(tmp_path, recording(without(gone)))
    assert not any("move up" in doubt for doubt in done.doubts)
