"""Triples that were not seen on the robot are no markers: desired and computed places, and places
that never change.
"""

import numpy as np
import pytest

from softmap_edge.logs.goals import follows, is_computed, is_goal
from softmap_edge.logs.guess import guess_mapping

T = np.arange(200) * 0.05
TIP = np.c_[10 + 26 * np.sin(1.3 * T), 23.6 * np.cos(T), 90 - 5 * np.sin(1.3 * T) ** 2]
DRIVES = np.c_[2.5 * np.sin(1.3 * T), 6 * np.cos(T)]


def log(folder, head, *columns):
    """A log of time, u1, u2 and columns."""
    rows = np.c_[T, DRIVES, np.concatenate(columns, axis=1)]
    lines = [
        ",".join(["t", "u1", "u2", *head]),
        *(",".join(f"{x:.6f}" for x in row) for row in rows),
    ]
    (folder / "log.csv").write_text("\n".join(lines) + "\n")
    return folder / "log.csv"


def xyz(name):
    return (
        [name.format(axis) for axis in "xyz"]
        if "{" in name
        else [f"{name}_{axis}" for axis in "xyz"]
    )


def markers(found):
    """The first columns of the proposed markers."""
    text = found.text.split("markers = ")[1] if "markers = " in found.text else ""
    return [
        row.strip(' ["').split('"')[0]
        for row in text.split("] }")[0].splitlines()[1:]
        if row.strip().startswith("[")
    ]


def left(found, column):
    return next((said for said in found.unknown if f"what {column}," in said), "")


@pytest.mark.parametrize(
    "goal", ["des", "target", "goal_tip", "tip_cmd", "reference", "{}_des", "desired.{}"]
)
@pytest.mark.parametrize("real", ["meas", "tip", "actual", "pos"])
def test_a_desired_place_is_neither_a_marker_nor_a_command(tmp_path, goal, real):
    path = log(tmp_path, [*xyz(goal), *xyz(real)], TIP + [2.0, -3.0, 1.0], TIP)
    found = guess_mapping([path])
    assert markers(found) == [xyz(real)[0]]
    assert 'command = { columns = ["u1", "u2"], unit = "mm" }' in found.text
    assert "desired" in left(found, xyz(goal)[0])


@pytest.mark.parametrize(
    ("computed", "real"),
    [
        ("sim", "tip"),
        ("tip_est", "tip"),
        ("model", "meas"),
        ("pred_tip", "tip"),
        ("{}d", "{}"),
        ("ref", "real"),
        ("fk", "cam"),
    ],
)
def test_a_computed_place_is_no_second_marker(tmp_path, computed, real):
    lag = np.roll(TIP, 3, axis=0)
    lag[:3] = TIP[:3]
    found = guess_mapping([log(tmp_path, [*xyz(computed), *xyz(real)], lag, TIP)])
    assert markers(found) == [xyz(real)[0]] and "computed" in left(found, xyz(computed)[0])


def test_a_desired_place_in_metres_is_left_out(tmp_path):
    found = guess_mapping([log(tmp_path, [*xyz("target"), *xyz("tip")], TIP / 1000, TIP)])
    assert markers(found) == ["tip_x"] and '"u1", "u2"' in found.text and left(found, "target_x")


def test_steps_of_a_reference_are_followed(tmp_path):
    steps = np.repeat(TIP[::20], 20, axis=0)
    found = guess_mapping([log(tmp_path, [*xyz("target"), *xyz("tip")], steps, TIP)])
    assert left(found, "target_x") and '"u1", "u2"' in found.text


def test_goals_that_no_marker_follows_come_after_other_commands(tmp_path):
    away = TIP[::-1] * [1, -1, 0.2]
    found = guess_mapping([log(tmp_path, [*xyz("target"), *xyz("tip")], away, TIP)])
    assert 'command = { columns = ["u1", "u2"]' in found.text and "target_x (" in found.text


@pytest.mark.parametrize("name", ["sim", "est_tip", "filtered"])
def test_the_only_place_of_a_log_is_kept_by_any_name(tmp_path, name):
    assert markers(guess_mapping([log(tmp_path, xyz(name), TIP)])) == [xyz(name)[0]]


def test_neighbours_on_the_robot_are_all_kept(tmp_path):
    """Markers called C to K move together; D is no desired C."""
    heads = [name for label in "CDHK" for name in xyz(label)]
    path = log(tmp_path, heads, TIP * 0.4, TIP * 0.6, TIP * 0.8, TIP * 0.85)
    assert len(markers(guess_mapping([path]))) == 4


def test_drives_called_x_y_z_stay_commands(tmp_path):
    head = [*xyz("motor"), *xyz("tip")]
    path = log(tmp_path, head, np.c_[DRIVES, DRIVES[:, 0]], TIP)
    path.write_text(path.read_text().replace("t,u1,u2,", "t,a,b,", 1))
    assert 'command = { columns = ["motor_x", "motor_y", "motor_z"]' in guess_mapping([path]).text


# --- places that never change -----------------------------------------------------------------
@pytest.mark.parametrize(
    "name", ["camera", "sensor_pos", "object", "robot_frame_origin_point", "tag7"]
)
def test_a_place_that_never_changes_is_left_out_and_named(tmp_path, name):
    fixed = np.tile([100.0, 50.0, 700.0], (len(T), 1))
    for real in ("tip", "meas"):
        found = guess_mapping([log(tmp_path, [*xyz(real), *xyz(name)], TIP, fixed)])
        if "frame" not in name:
            assert markers(found) == [f"{real}_x"] and "never change" in left(found, f"{name}_x")


def test_a_marker_of_a_set_may_rest_and_so_may_the_clamp(tmp_path):
    still = np.tile([0.0, 0.0, 2.0], (len(T), 1))
    found = guess_mapping([log(tmp_path, [*xyz("m1"), *xyz("m2")], still, TIP)])
    assert markers(found) == ["m1_x", "m2_x"]
    found = guess_mapping([log(tmp_path, [*xyz("clamp"), *xyz("tip")], still, TIP)])
    assert markers(found) == ["tip_x"] and "base = {" in found.text
    found = guess_mapping([log(tmp_path, [*xyz("tip")], still)])
    assert markers(found) == ["tip_x"]  # a robot that rests


# --- the rules --------------------------------------------------------------------------------
def test_names():
    assert is_goal("des_ ") and is_goal("tipDesired") and is_goal("cmd_ ")
    assert not is_goal("motor_target_ ") and not is_goal("destination") and not is_goal("tip_ ")
    assert (
        is_computed("x_est", ["x"])
        and is_computed(" d", [" ", " d"])
        and not is_computed("D_ ", ["C_ ", "D_ "])
    )


def test_follows_needs_the_same_motion_nearby():
    assert follows(TIP + 5, TIP) and follows(TIP / 1000, TIP)
    assert not follows(TIP[::-1] * [1, -1, 1], TIP) and not follows(TIP + 500, TIP)
    assert not follows(TIP, np.tile(TIP[:1], (len(TIP), 1))) and not follows(TIP[:5], TIP[:5])
