"""The largest number of a type, and huge numbers that repeat, stand for a missing value; one huge
number is a fault.
"""

import numpy as np
import pytest
from bench_rows import NAMES, rows, write

from softmap_edge.errors import RunError
from softmap_edge.logs.fills import marked_missing, unread_ticks
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping


def log(folder, cells, columns=(-3, -2, -1), first=20):
    """A log in which some columns hold the given cells, from row `first` on."""
    lines = [line.split(",") for line in rows(60)]
    for k, cell in enumerate(cells):
        for column in columns:
            lines[first + k][column] = cell
    return write(folder / "log.csv", ",".join(NAMES), [",".join(line) for line in lines])


def read(path):
    found = guess_mapping([path])
    return import_logs([path], parse_mapping(found.text, path))


@pytest.mark.parametrize(
    "cell",
    ["3.4028e38", "3.402823e+38", "3.40282347E+38", "-3.4028235e38", "340282346638528859811704183484516925440.0",
     "1.7976931348623157e308", "1.79769e+308", "-1.7976931348623157e+308", "1e30", "9.96921e36", "-1e38"],
)  # fmt: skip
def test_a_number_that_stands_for_missing_is_not_seen(tmp_path, cell):
    done = read(log(tmp_path, [cell] * 6))
    assert done.run.t_seen.tolist() == pytest.approx(
        [0.05 * k for k in range(60) if not 20 <= k < 26]
    )
    assert np.abs(done.run.markers).max() < 1000
    assert any(
        "stand for missing values" in note and "in 6 of 60 rows" in note for note in done.notes
    )


@pytest.mark.parametrize("cell", ["3.4028235e38", "1.7976931348623157e308"])
def test_the_largest_number_of_a_type_may_be_there_once(tmp_path, cell):
    assert read(log(tmp_path, [cell])).run.frames == 59


@pytest.mark.parametrize(
    "cells",
    [["1e30"], ["2.5e25", "3.5e25", "1e30"], ["3.6e38"], ["5e25", "6e25", "7e25", "5e25", "5e25"]],
)
def test_other_huge_numbers_stay_an_error(tmp_path, cells):
    mapping = guess_mapping([log(tmp_path, [])]).text
    path = log(tmp_path, cells)
    with pytest.raises(RunError, match="line 22, .* is not a measurement"):
        import_logs([path], parse_mapping(mapping, path))


def test_commands_that_are_missing_are_left_out(tmp_path):
    done = read(log(tmp_path, ["3.4028e38"] * 4, columns=(1, 2)))
    assert len(done.run.t) == 56 and any("stand for missing values" in note for note in done.notes)


SENTINELS = ["-999", "9999", "9999.99", "65535", "-32768", "2147483647", "-2147483648", "1e9"]


def drive_lines(path):
    found = guess_mapping([path])
    return [line for line in (*found.assumed, *found.unknown) if "commands" in line]


@pytest.mark.parametrize("cell", SENTINELS)
def test_missing_commands_stay_out_of_the_guess_and_of_the_run(tmp_path, cell):
    plain = log(tmp_path, [])
    expected, run = drive_lines(plain), read(plain).run
    path = log(tmp_path, [cell] * 4, columns=(1, 2))
    assert drive_lines(path) == expected
    done = read(path)
    assert len(done.run.t) == len(run.t) - 4
    assert np.abs(done.run.command).max() <= np.abs(run.command).max()
    assert any("stand for missing values" in note and "in 4 of 60" in note for note in done.notes)


@pytest.mark.parametrize("cell", ["-999", "65535"])
def test_one_channel_may_miss_a_command(tmp_path, cell):
    path = log(tmp_path, [cell] * 3, columns=(2,))
    assert drive_lines(path) == drive_lines(log(tmp_path, []))


def test_a_number_that_the_drive_nearly_reaches_is_kept():
    column = np.array([0.0, 500.0, 999.0, -200.0])
    assert not marked_missing(column).any()
    assert not marked_missing(np.array([0.0, 0.0, 999.0, 999.0])).any()  # a step from home
    assert marked_missing(np.array([1.0, np.nan, 999.0, -999.0])).tolist() == [0, 0, 1, 1]


@pytest.mark.parametrize("filler", [0, -1])
def test_ticks_of_a_servo_that_did_not_answer_are_reported(tmp_path, filler):
    lines = [line.split(",") for line in rows(60)]
    for line in lines:
        line[1:3] = [str(round(2048 + 60 * float(x))) for x in line[1:3]]
    head = ",".join(NAMES)
    plain = write(tmp_path / "a.csv", head, [",".join(line) for line in lines])
    home = [line for line in guess_mapping([plain]).unknown if "home" in line]
    assert not read(plain).doubts
    for k in (10, 11, 40):
        lines[k][1:3] = [str(filler)] * 2
    path = write(tmp_path / "b.csv", head, [",".join(line) for line in lines])
    assert home and [line for line in guess_mapping([path]).unknown if "home" in line] == home
    doubts = [doubt for doubt in read(path).doubts if "did not answer" in doubt]
    assert len(doubts) == 2 and f"is exactly {filler} in 3 of 60 rows" in doubts[0]


def test_ticks_that_pass_zero_are_no_doubt():
    swing = np.round(500 * np.sin(np.arange(200) / 9))[:, None]
    swing[[0, 90, 91]] = 0
    assert not unread_ticks(swing).any()
