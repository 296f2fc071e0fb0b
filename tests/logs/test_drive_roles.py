"""Commands and encoders of `--guess` are columns that move; quaternions and constants are left out
and named.
"""

import numpy as np
import pytest
from recordings import (
    JOINT_STATE,
    POSES,
    TRANSFORMS,
    joint_state,
    places,
    pose_array,
    robot_messages,
    transforms,
    write_mcap,
)

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.guess_columns import drive_unit
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping

T = np.arange(60) * 0.05
TIP = np.c_[10 + 6 * np.sin(1.3 * T), 3.6 * np.cos(T), 90 - 0.75 * np.sin(1.3 * T)]
DRIVES = np.c_[2.5 * np.sin(T), 6 * np.cos(T)]


def log(folder, head, *columns):
    """A log of time and columns."""
    rows = np.c_[T, np.concatenate([np.reshape(c, (len(T), -1)) for c in columns], axis=1)]
    lines = [",".join(["time", *head]), *(",".join(f"{x:.6f}" for x in row) for row in rows)]
    (folder / "log.csv").write_text("\n".join(lines) + "\n")
    return folder / "log.csv"


def line(found, key):
    return next((text for text in found.text.splitlines() if text.startswith(f"{key} = ")), "")


def turning(rows):
    """Unit quaternions that turn about one axis."""
    angle = 0.5 * np.sin(np.arange(rows) / 7)
    return np.c_[0 * angle, np.sin(angle), 0 * angle, np.cos(angle)]


# --- recordings of ROS -----------------------------------------------------------------------
def bag(folder, topic, definition, make):
    """A recording of joint states of two joints, and markers of one topic."""
    t, points = places(60)
    messages = []
    for k, s in enumerate(t):
        stamp = 1.7e9 + s
        messages.append(
            ("/joint_states", JOINT_STATE, joint_state(stamp, DRIVES[k], ("a", "b")), stamp)
        )
        messages.append((topic, definition, make(stamp, points[k] / 1000), stamp + 1e-4))
    return write_mcap(folder / "bag.mcap", messages)


@pytest.mark.parametrize(
    ("topic", "definition", "make"),
    [
        ("/markers", POSES, pose_array),
        ("/poses", POSES, pose_array),
        ("/tf", TRANSFORMS, transforms),
    ],
)
def test_orientations_that_never_change_are_no_commands(tmp_path, topic, definition, make):
    found = guess_mapping([bag(tmp_path, topic, definition, make)])
    assert (
        line(found, "command")
        == 'command = { columns = ["position[a]", "position[b]"], unit = "rad" }'
    )
    assert line(found, "present") == ""
    kind = "orientation.w" if definition is POSES else "rotation.w"
    assert any("a quaternion" in said and kind in said for said in found.unknown)
    assert sum("a quaternion" in said for said in found.unknown) == 1  # one line for all


def test_static_transforms_do_not_hide_the_markers(tmp_path):
    t, points = places(60)
    fixed = np.array([[0.1, 0.0, 0.4], [0.0, 0.2, 0.1], [0.0, 0.0, 0.5], [1.0, 0.0, 0.0]])
    messages = []
    for k, s in enumerate(t):
        messages.append(
            (
                "/tf_static",
                TRANSFORMS,
                transforms(1.7e9 + s, fixed, ("cam", "table", "mount", "lab")),
                1.7e9 + s,
            )
        )
        messages.append(
            ("/markers", POSES, pose_array(1.7e9 + s, points[k] / 1000), 1.7e9 + s + 1e-4)
        )
    found = guess_mapping([write_mcap(tmp_path / "bag.mcap", messages)])
    assert "poses[0].position.x" in found.text and "transforms" not in found.text.split("schema")[1]


# --- quaternions and constants of text logs ---------------------------------------------------
@pytest.mark.parametrize(
    "head",
    [
        ["q0", "q1", "q2", "q3"],
        ["joint_rot_1", "joint_rot_2", "joint_rot_3", "joint_rot_4"],
        ["state_qw", "state_qx", "state_qy", "state_qz"],
    ],
)
def test_a_unit_quaternion_is_no_encoder(tmp_path, head):
    path = log(
        tmp_path, ["cmd_1", "cmd_2", *head, "tip_x", "tip_y", "tip_z"], DRIVES, turning(60), TIP
    )
    found = guess_mapping([path])
    assert line(found, "present") == "" and "cmd_1" in line(found, "command")
    assert any("a quaternion" in said and head[0] in said for said in found.unknown)


@pytest.mark.parametrize("names", ["joint_{}", "angle{}", "state_{}", "position[{}]"])
def test_constants_are_no_encoders_by_a_loose_name(tmp_path, names):
    head = [names.format(k) for k in range(3)]
    path = log(
        tmp_path,
        ["enc_1", "enc_2", *head, "tip_x", "tip_y", "tip_z"],
        DRIVES,
        np.tile([1.0, 2.0, 0.5], (60, 1)),
        TIP,
    )
    found = guess_mapping([path])
    assert "enc_1" in line(found, "command") and head[0] not in found.text.split("schema")[1]
    assert any("never change" in said and head[0] in said for said in found.unknown)


def test_named_commands_that_rest_are_kept_until_others_move(tmp_path):
    path = log(tmp_path, ["cmd_1", "cmd_2", "tip_x", "tip_y", "tip_z"], 0 * DRIVES + 3, TIP)
    assert "cmd_1" in line(guess_mapping([path]), "command")
    path = log(
        tmp_path,
        ["goal_1", "goal_2", "u1", "u2", "tip_x", "tip_y", "tip_z"],
        0 * DRIVES,
        DRIVES,
        TIP,
    )
    assert "u1" in line(guess_mapping([path]), "command")


# --- units -----------------------------------------------------------------------------------
@pytest.mark.parametrize("value", [0.0, 3.0, 0.1, 45.0, 5000.0, -12.5])
def test_a_constant_shows_no_unit(value):
    unit, why, sure = drive_unit(np.full((50, 2), value), None)
    assert (unit, sure) == ("mm", False) and "no unit" in why


def test_channels_that_rest_at_different_values_show_no_unit(tmp_path):
    assert drive_unit(np.tile([3.0, 1.0, 2.5], (50, 1)), None)[0] == "mm"
    assert drive_unit(np.c_[np.linspace(0, 3, 50), np.full(50, 1.0)], None)[0] == "rad"
    path = log(tmp_path, ["cmd_1", "cmd_2", "enc_1", "enc_2"], 0 * DRIVES + 1, 12 * DRIVES)
    found = guess_mapping([path])
    assert 'unit = "deg"' in line(found, "present") and 'unit = "deg"' in line(found, "command")


@pytest.mark.parametrize("names", [["left"], ["left", "right"], ["a", "b", "c"]])
def test_a_stamp_of_a_message_is_no_command_and_no_current(names, tmp_path):
    recorded = robot_messages(60)
    for _, kind, message, _ in recorded:
        if kind == JOINT_STATE:
            message["name"] = names
            message["position"] = [message["position"][k % 2] * (k + 1) for k in range(len(names))]
    found = guess_mapping([write_mcap(tmp_path / "log.mcap", recorded)])
    wanted = ", ".join(f'"position[{name}]"' for name in names)
    assert f"command = {{ columns = [{wanted}]" in found.text
    assert f"present = {{ columns = [{wanted}]" in found.text
    assert "current" not in found.text and not any("cannot be imported" in s for s in found.said)


@pytest.mark.parametrize("stem", ["cmd.{}", "cmd_{}", "u.{}", "{}.cmd", "motor.{}.goal"])
@pytest.mark.parametrize("names", [["a", "b"], ["left", "right"], ["x", "y"]])
def test_drives_whose_names_differ_in_a_letter_are_one_group(stem, names, tmp_path):
    columns = [stem.format(name) for name in names]
    lines = [
        f"{0.05 * k:.2f},{3 * np.sin(k / 5):.3f},{2 * np.cos(k / 4):.3f},"
        f"{9 * np.sin(k / 5):.3f},{6 * np.cos(k / 4):.3f},{90 + np.sin(k):.3f}"
        for k in range(60)
    ]
    (tmp_path / "log.csv").write_text(
        "\n".join([",".join(["t", *columns, "tip_x", "tip_y", "tip_z"]), *lines]) + "\n"
    )
    wanted = ", ".join(f'"{name}"' for name in columns)
    assert f"command = {{ columns = [{wanted}]" in guess_mapping([tmp_path / "log.csv"]).text


@pytest.mark.parametrize(
    ("header", "command", "present"),
    [
        ("t,reference_1,reference_2,measured_1,measured_2", "reference", "measured"),
        ("t,ref_1,ref_2,clamp_1,clamp_2,enc_1,enc_2", "ref", "enc"),
        ("t,motor_time,motor_1,motor_2,sample_1,sample_2", "motor", None),
        ("t,reaction_1,reaction_2,cmd_1,cmd_2,readback_1,readback_2", "cmd", "readback"),
        ("t,attempt,cable_1,cable_2,ramp_1,ramp_2,spread_1,spread_2", "cable", None),
    ],
)
def test_a_word_within_another_word_is_no_role(header, command, present, tmp_path):
    names = header.split(",")
    t = np.arange(60) / 20
    rows = [t] + [
        t if name == "motor_time" else (4 + 0.1 * k) * np.sin(t * (2 + 0.1 * k))
        for k, name in enumerate(names[1:])
    ]
    lines = [header] + [",".join(f"{x:.4f}" for x in row) for row in zip(*rows)]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    text = guess_mapping([tmp_path / "log.csv"]).text
    assert f'command = {{ columns = ["{command}_1", "{command}_2"]' in text
    assert ("present = {" in text) == (present is not None) and "current = {" not in text
    assert present is None or f'present = {{ columns = ["{present}_1", "{present}_2"]' in text
    assert "temperature = {" not in text


@pytest.mark.parametrize("name", ["current", "temperature", "present"])
def test_one_quantity_in_two_logs_is_refused(name, tmp_path):
    for file in ("a.csv", "b.csv"):
        rows = [
            f"{k / 10},{np.sin(k / 5):.4f},{100 + k},{k % 7},{k % 5},{50 + k % 3}"
            for k in range(60)
        ]
        (tmp_path / file).write_text("\n".join(["t,u,i,x,y,z", *rows]) + "\n")
    text = f"""schema = "softmap.mapping/1"
[[log]]
file = "a.csv"
time = {{ column = "t" }}
command = {{ columns = ["u"] }}
{name} = {{ columns = ["i"] }}
[[log]]
file = "b.csv"
time = {{ column = "t" }}
{name} = {{ columns = ["i"] }}
markers = {{ columns = [["x", "y", "z"]] }}
"""
    with pytest.raises(RunError, match=f"2 logs hold {name}; name the columns of one of them"):
        import_logs([tmp_path / "a.csv", tmp_path / "b.csv"], parse_mapping(text, "m.toml"))
