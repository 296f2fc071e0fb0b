"""Which columns of a log are places, decided by names, sizes and values; what is left out is named
with the reason.
"""

import numpy as np
import pytest
from logs import ROOT
from recordings import JOINT_STATE, robot_messages, write_mcap

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs, read_mapping

CASES = ROOT / "tests" / "data" / "values"
T = np.arange(40) * 0.05
TIP = np.c_[10 + 6 * np.sin(1.3 * T), 3.6 * np.cos(T), 90 - 0.75 * np.sin(1.3 * T)]
SMALL = np.c_[0.3 * np.sin(T), 0.04 + 0 * T, 0.3 * np.cos(T)]


def log(folder, head, *columns):
    """A log of time, two commands and more columns."""
    rows = np.c_[
        T,
        5 * np.sin(T),
        4 * np.cos(T),
        np.concatenate([np.reshape(c, (len(T), -1)) for c in columns], axis=1),
    ]
    lines = [
        ",".join(["time", "cmd_1", "cmd_2", *head]),
        *(",".join(f"{x:.6f}" for x in row) for row in rows),
    ]
    (folder / "log.csv").write_text("\n".join(lines) + "\n")
    return folder / "log.csv"


def xyz(name, form="{}_{}"):
    return [form.format(name, axis) for axis in "xyz"]


def imported(folder, found, path):
    (folder / "proposal.toml").write_text(found.text)
    return import_logs([path], read_mapping(folder / "proposal.toml"))


def named(found, *words):
    return [line for line in found.unknown if all(word in line for word in words)]


# --- triples that are no place -----------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "unit", "columns", "reason"),
    [
        ("force", "mm", "Fx, Fy, Fz", "a force"),
        ("rpy", "m", "rpy_x, rpy_y, rpy_z", "angles"),
        ("dotted", "mm", "angles.x, angles.y, angles.z", "angles"),
    ],
)
def test_the_cases(tmp_path, name, unit, columns, reason):
    found = guess_mapping([CASES / f"{name}.csv"])
    assert f'markers = {{ unit = "{unit}"' in found.text
    run = imported(tmp_path, found, CASES / f"{name}.csv").run
    assert run.marker_names == ["tip"] and 80 < run.markers[0, 0, 2] < 100
    assert named(found, columns, reason, "left out") and not named(found, "what these columns")


@pytest.mark.parametrize("form", ["{}_{}", "{}.{}", "{}{}", "{1}_{0}"])
@pytest.mark.parametrize(
    "name",
    [
        "rpy",
        "euler",
        "omega",
        "theta",
        "F",
        "M",
        "f",
        "moment",
        "gravity",
        "q",
        "eul",
        "angles",
        "ori",
        "R",
        "B",
    ]
    + ["strain", "tof", "torque", "tau", "imu_acc", "tip_velocity", "wrench.force", "foo"],
)
def test_no_name_makes_a_small_triple_a_place_or_turns_the_unit(tmp_path, name, form):
    for scale, unit in ((1.0, "mm"), (1e-3, "m")):
        path = log(tmp_path, [*xyz("tip"), *xyz(name, form)], TIP * scale, SMALL)
        found = guess_mapping([path])
        assert (
            f'markers = {{ unit = "{unit}"' in found.text
            and '["tip_x", "tip_y", "tip_z"]' in found.text
        )
        assert imported(tmp_path, found, path).run.markers.shape == (40, 1, 3)
        assert named(found, xyz(name, form)[0], "left out")


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        (SMALL * [1.0, 1.0, 2.0], "within ±π"),
        (np.tile([0.0, 0.0, 9.81], (40, 1)), "never change"),
        (9.81 * np.c_[np.sin(T), 0 * T, np.cos(T)], "length is 9.81 in all rows"),
        (1e5 * TIP, "of size"),
        (4e-2 * TIP / 90, "within ±π"),
        (np.c_[np.sin(T), 0 * T, np.cos(T)], "a direction"),
        (TIP + [5000.0, 0.0, 0.0], "away"),
    ],
)
def test_values_decide_where_a_name_says_nothing(tmp_path, values, reason):
    found = guess_mapping([log(tmp_path, [*xyz("tip"), *xyz("foo")], TIP, values)])
    assert (
        named(found, "foo_x, foo_y, foo_z", reason, "left out") and found.text.count('    ["') == 1
    )


def test_a_quaternion_is_named_once(tmp_path):
    turn = np.c_[0 * T, 0 * T, np.sin(T / 2), np.cos(T / 2)]
    found = guess_mapping(
        [log(tmp_path, [*xyz("tip"), *(f"q{axis}" for axis in "xyzw")], TIP, turn)]
    )
    assert named(found, "qx, qy, qz, qw", "a quaternion") and found.text.count('    ["') == 1


def test_markers_of_any_name_that_fit_stay(tmp_path):
    heights = [0.25, 0.5, 0.75, 1.0]
    for names in (
        ["m1", "m2", "m3", "m4"],
        ["base", "middle", "elbow", "tip"],
        ["a1", "b1", "c1", "d1"],
    ):
        head = [column for name in names for column in xyz(name)]
        path = log(tmp_path, head, *(TIP * h for h in heights))
        found = guess_mapping([path])
        run = imported(tmp_path, found, path).run
        base = run.extra.get("base_markers", np.zeros((40, 0, 3)))
        assert run.markers.shape[1] + base.shape[1] == 4 and not named(found, "left out")
    found = guess_mapping([log(tmp_path, [*xyz("tip"), *xyz("wobble")], TIP, TIP * 0.5)])
    assert found.text.count('    ["') == 2 and any(
        "by size alone" in line for line in found.assumed
    )


# --- names that are there twice, and names in brackets --------------------------------------------
def test_a_second_group_of_the_same_name_is_taken_by_number(tmp_path):
    found = guess_mapping([CASES / "same.csv"])
    assert "[2, 3, 4]" in found.text and "[5, 6, 7]" in found.text
    run = imported(tmp_path, found, CASES / "same.csv").run
    assert run.markers.shape == (40, 2, 3) and run.markers[0, :, 2] == pytest.approx(
        [45.3, 90.3], abs=0.5
    )


def test_other_names_that_are_there_twice(tmp_path):
    path = log(tmp_path, [*xyz("tip"), *xyz("tip"), *xyz("tip")], TIP * 0.4, TIP * 0.7, TIP)
    found = guess_mapping([path])
    assert (
        imported(tmp_path, found, path).run.markers.shape == (40, 3, 3)
        and "[9, 10, 11]" in found.text
    )
    path = log(tmp_path, ["note", *xyz("tip"), "note"], T**2, TIP, -T)
    found = guess_mapping([path])
    assert named(found, "note (column 3)", "note (column 7)", "left out")
    path = log(
        tmp_path, ["enc", "enc", *xyz("tip")], 5 * np.sin(T) + 0.01, 4 * np.cos(T) - 0.01, TIP
    )
    found = guess_mapping([path])
    assert (
        "present = { columns = [3, 4]" in found.text
        and imported(tmp_path, found, path).run.present is not None
    )


def test_names_with_parentheses(tmp_path):
    found = guess_mapping([CASES / "paren.csv"])
    assert (
        'columns = ["u_t(0)", "u_t(1)"]' in found.text
        and '"p_tip(1)", "p_tip(2)", "p_tip(3)"' in found.text
    )
    assert 'column = "Test time"' in found.text
    run = imported(tmp_path, found, CASES / "paren.csv").run
    assert run.marker_names == ["p_tip"] and run.channels == 2


@pytest.mark.parametrize(
    ("commands", "places"),
    [
        (["u(1)", "u(2)"], ["pos[0]", "pos[1]", "pos[2]"]),
        (["u{1}", "u{2}"], ["marker(1,1)", "marker(1,2)", "marker(1,3)"]),
        (["cmd(0)", "cmd(1)"], ["tip{1}", "tip{2}", "tip{3}"]),
        (["u[0]", "u[1]"], [f"p({k})" for k in range(1, 7)]),
    ],
)
def test_other_brackets(tmp_path, commands, places):
    count = len(places) // 3
    path = log(tmp_path, places, *(TIP * (k + 1) / count for k in range(count)))
    text = (
        path.read_text().replace("cmd_1", f'"{commands[0]}"').replace("cmd_2", f'"{commands[1]}"')
    )
    for place in places:
        text = text.replace(place, f'"{place}"', 1) if "," in place else text
    path.write_text(text)
    found = guess_mapping([path])
    run = imported(tmp_path, found, path).run
    assert run.channels == 2 and run.markers.shape == (40, count, 3)


def test_channels_in_brackets_are_no_place(tmp_path):
    for names in (
        ["u(1)", "u(2)", "u(3)"],
        ["q(1)", "q(2)", "q(3)"],
        ["joint_position[0]", "joint_position[1]"],
    ):
        values = [np.sin(T + k) for k in range(len(names))]
        path = log(tmp_path, names, *values)
        found = guess_mapping([path])
        assert "\nmarkers" not in found.text


# --- joint states ---------------------------------------------------------------------------------
def test_joint_states_are_rad_and_marked(tmp_path):
    found = guess_mapping([CASES / "joints.csv"])
    assert 'unit = "rad"' in found.text and 'command_unit = "rad"' in found.text
    assert named(found, "unit of the commands", "rad")


@pytest.mark.parametrize("size", [0.02, 0.1, 0.6, 3.0])
@pytest.mark.parametrize(
    "name", ["/joint_states/position[{}]", "JointState.position.{}", "joint_state_{}"]
)
def test_joint_states_of_any_size_and_name(tmp_path, size, name):
    path = log(
        tmp_path, [name.format("left"), name.format("right")], size * np.sin(T), size * np.cos(T)
    )
    text = path.read_text().replace("cmd_1", "a_1").replace("cmd_2", "a_2")
    path.write_text(text)
    found = guess_mapping([path])
    assert 'unit = "rad"' in found.text and named(found, "unit of the", "rad is only likely")


def test_joint_states_of_a_topic_of_another_name_alongside_commands_in_mm(tmp_path):
    messages = []
    for t in np.arange(0.0, 4.0, 0.02):
        stamp = {"sec": int(t), "nanosec": int(round(t % 1 * 1e9))}
        joint = {"header": {"stamp": stamp, "frame_id": ""}, "name": ["left", "right"]}
        joint |= {"position": [0.1 * np.sin(t), 0.1 * np.cos(t)], "velocity": [], "effort": []}
        messages.append(("/arm/feedback", JOINT_STATE, joint, float(t)))
    bag = write_mcap(tmp_path / "log.mcap", messages)
    path = log(tmp_path, [], np.zeros((40, 0)))
    found = guess_mapping([bag, path])
    assert 'unit = "mm"' in found.text and "present" not in found.text
    assert named(found, "radius of the spools", "encoders are in rad", "left out")
    alone = guess_mapping([bag])
    assert 'unit = "rad"' in alone.text and named(alone, "unit of the commands")


def test_nothing_that_looks_like_anything_is_one_error(tmp_path):
    path = log(tmp_path, [], np.zeros((40, 0)))
    path.write_text(path.read_text().replace("cmd_1", "a").replace("cmd_2", "b"))
    with pytest.raises(RunError, match="by its name"):
        guess_mapping([path])
    assert robot_messages
