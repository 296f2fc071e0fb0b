"""A column of 0 and 1 with an unclear name is no coordinate, and a command only with a question."""

import math
import tomllib

import numpy as np
import pytest
from bench_rows import write

from softmap_edge.logs.flags import is_switch
from softmap_edge.logs.guess import guess_mapping

TIP = ["tip_x", "tip_y", "tip_z"]


def swing(k):
    return round(5 * math.sin(k / 6), 3)


def tip(k):
    return 10 + swing(k), 3.6 * math.cos(k / 6), 90 - abs(swing(k))


def on(k):
    return (k // 10) % 2


def proposed(folder, names, row):
    lines = [",".join(str(cell) for cell in (0.05 * k, *row(k))) for k in range(60)]
    guess = guess_mapping([write(folder / "log.csv", ",".join(["time", *names]), lines)])
    return guess, tomllib.loads(guess.text)["log"][0]


@pytest.mark.parametrize("name", ["ok", "s", "st1", "trigger", "b", "DI0", "x1", "contact", "u3"])
def test_a_flag_among_known_columns_is_left_out_with_a_question(tmp_path, name):
    names = ["cmd_1", "cmd_2", *TIP, name]
    guess, log = proposed(tmp_path, names, lambda k: (swing(k), -swing(k), *tip(k), on(k)))
    assert log["command"]["columns"] == ["cmd_1", "cmd_2"]
    assert log["markers"]["columns"] == [TIP] and "block" not in log
    assert any(name in line for line in guess.unknown)


@pytest.mark.parametrize(
    ("names", "row", "flags"),
    [
        (["cmd_1", "cmd_2", "cmd_3"], lambda k: (swing(k), -swing(k), on(k)), ["cmd_3"]),
        (["motor_on"], lambda k: (on(k),), ["motor_on"]),
        (["state_1", "state_2"], lambda k: (on(k), on(k + 4)), ["state_1", "state_2"]),
        (["u1", "enc_1"], lambda k: (swing(k), on(k)), ["enc_1"]),
    ],
)
def test_a_drive_of_0_and_1_is_proposed_with_a_question(tmp_path, names, row, flags):
    guess, _ = proposed(tmp_path, [*names, *TIP], lambda k: (*row(k), *tip(k)))
    asked = [line for line in guess.unknown if "holds flags: only 0 and 1" in line]
    assert len(asked) == 1 and all(flag in asked[0] for flag in flags)


def test_commands_that_vary_come_before_those_of_0_and_1(tmp_path):
    names = ["cmd_enable_1", "cmd_enable_2", "servo_1"]
    _, log = proposed(tmp_path, [*names, *TIP], lambda k: (on(k), on(k + 3), swing(k), *tip(k)))
    assert log["command"]["columns"] == ["servo_1"]


@pytest.mark.parametrize(
    ("names", "row", "kept"),
    [
        (["x", "y", "z"], lambda k: (*tip(k)[:2], on(k)), None),
        ([*TIP, "s_x", "s_y", "s_z"], lambda k: (*tip(k), on(k), on(k + 2), on(k + 5)), [TIP]),
        (
            ["x", "y", "pos_x", "pos_y"],
            lambda k: (on(k), on(k + 2), *tip(k)[:2]),
            [["pos_x", "pos_y"]],
        ),
        # a place in whole numbers
        (["x", "y", "z"], lambda k: (round(3 * swing(k)), k % 7, on(k)), [["x", "y", "z"]]),
    ],
)
def test_a_flag_is_no_coordinate(tmp_path, names, row, kept):
    guess, log = proposed(tmp_path, ["cmd_1", *names], lambda k: (swing(k), *row(k)))
    assert log.get("markers", {}).get("columns") == kept
    asked = any("a flag or a switch, for" in line for line in guess.unknown)
    assert asked is (kept != [names])


@pytest.mark.parametrize("form", ["m{}_{}", "{1}{0}", "marker_{}_{}_mm"])
@pytest.mark.parametrize("axis", [0, 2])
def test_a_coarse_coordinate_of_one_marker_among_others_is_kept(tmp_path, form, axis):
    names = [form.format(m, letter) for m in (1, 2, 3) for letter in "xyz"]

    def row(k):
        first = list(tip(k))
        first[axis] = on(k)
        return [swing(k), *first, *tip(k), *tip(k + 2)]

    guess, log = proposed(tmp_path, ["cmd_1", *names], row)
    assert log["markers"]["columns"] == [names[k : k + 3] for k in (0, 3, 6)]
    assert not any("a flag or a switch" in line for line in guess.unknown)


@pytest.mark.parametrize("name", ["temp", "load", "current"])
def test_a_flag_is_no_condition(tmp_path, name):
    guess, log = proposed(tmp_path, ["cmd_1", *TIP, name], lambda k: (swing(k), *tip(k), on(k)))
    assert not {"temperature", "load", "current"} & set(log)
    assert any("only 0 and 1, as a flag or a switch is" in line for line in guess.unknown)


@pytest.mark.parametrize(
    ("name", "key"),
    [("load_kg", "load"), ("load [N]", "load"), ("Payload (g)", "load"), ("temp_K", "temperature")],
)
def test_a_condition_of_0_and_1_with_a_unit_was_measured(tmp_path, name, key):
    guess, log = proposed(tmp_path, ["cmd_1", *TIP, name], lambda k: (swing(k), *tip(k), on(k)))
    assert log[key]["columns"] == [name]
    assert not any("a flag or a switch" in line for line in guess.unknown)


@pytest.mark.parametrize("form", ["cmd_{}_mm", "u{} [deg]", "motor_{}_rad"])
def test_commands_of_0_and_1_with_a_unit_need_no_question(tmp_path, form):
    names = [form.format(1), form.format(2)]
    guess, log = proposed(tmp_path, [*names, *TIP], lambda k: (on(k), on(k + 4), *tip(k)))
    assert log["command"]["columns"] == names
    assert not any("holds flags" in line for line in guess.unknown)


@pytest.mark.parametrize(
    ("values", "answer"),
    [([0, 1, 1, np.nan], True), ([0, 0], False), ([1.0], False), ([0, 1, 2], False), ([], False)],
)
def test_a_switch_is_0_and_1(values, answer):
    assert is_switch(np.array(values, float)) is answer
