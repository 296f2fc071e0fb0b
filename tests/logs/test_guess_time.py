"""The time of a log: seconds with their fraction, counters, nothing; and places among columns
without names.
"""

import math

import numpy as np
import pytest
from bench_rows import NAMES, STEP, rows, write

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping

START = 1_900_000_000.6


def at(k):
    return START + STEP * k + 0.004 * math.sin(3 * k)


def parts(unit, first="full"):
    def written(k):
        full, fraction = (
            int(at(k)),
            round((at(k) - int(at(k))) * {"ns": 1e9, "us": 1e6, "ms": 1e3}[unit]),
        )
        return f"{full},{fraction}" if first == "full" else f"{fraction},{full}"

    return written


@pytest.mark.parametrize(
    ("names", "unit", "first"),
    [
        ("stamp.sec,stamp.nanosec", "ns", "full"),
        ("header.stamp.secs,header.stamp.nsecs", "ns", "full"),
        ("tv_usec,tv_sec", "us", "fraction"),
        ("Seconds,Nanoseconds", "ns", "full"),
        ("sec,nsec", "ns", "full"),
        ("log_s,log_ms", "ms", "full"),
    ],
)
def test_seconds_and_their_fraction_are_one_time(tmp_path, names, unit, first):
    path = write(tmp_path / "log.csv", ",".join([names, *NAMES[1:]]), rows(time=parts(unit, first)))
    found = guess_mapping([path])
    assert "repeated" not in found.text and "spread" not in " ".join(found.said)
    run = import_logs([path], parse_mapping(found.text.replace("zero_time = true", ""), path)).run
    assert run.t == pytest.approx([at(k) for k in range(40)], abs=6e-4 if unit == "ms" else 1e-6)
    assert run.t[0] == pytest.approx(START, abs=1e-6)


def test_a_pair_is_found_by_its_values_where_names_say_nothing(tmp_path):
    path = write(tmp_path / "log.csv", ",".join(["a", "b", *NAMES[1:]]), rows(time=parts("us")))
    assert 'columns = ["a", "b"], units = ["s", "us"]' in guess_mapping([path]).text


def test_a_pair_in_a_mapping(tmp_path):
    path = write(tmp_path / "log.csv", ",".join(["s", "n", *NAMES[1:]]), rows(time=parts("ns")))
    mapping = (
        'schema = "softmap.mapping/1"\n[[log]]\ntime = { %s }\ncommand = { columns = ["cmd_1"] }'
    )
    run = import_logs([path], parse_mapping(mapping % 'columns = ["s", "n"]', path)).run
    assert run.t == pytest.approx([at(k) for k in range(40)], abs=1e-6)
    for keys, words in (
        ('columns = ["s"]', "expected two"),
        ('columns = ["s", "n"], column = "s"', "give one of them"),
        ('columns = ["s", "n"], units = ["s", "week"]', "expected two of s, ms"),
        ('columns = ["s", "n"], rate_hz = 3', "leave rate_hz out"),
        ('columns = ["s", "n"], unit = "s"', "give units"),
        ('column = "s", units = ["s", "ns"]', "units without columns"),
        ('column = "s", date_order = "ymd"', "expected one of dmy, mdy"),
        ('column = "s", jumps = "drop"', "expected one of refuse, mend"),
    ):
        with pytest.raises(RunError, match=words):
            parse_mapping(mapping % keys, path)


@pytest.mark.parametrize(("scale", "unit"), [(1, "s"), (1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_times_since_1970_have_their_unit_by_size(tmp_path, scale, unit):
    path = write(
        tmp_path / "log.csv", ",".join(NAMES), rows(time=lambda k: repr(round(at(k) * scale, 4)))
    )
    found = guess_mapping([path])
    assert f'unit = "{unit}"' in found.text
    run = import_logs([path], parse_mapping(found.text, path)).run
    assert run.t == pytest.approx([at(k) - START for k in range(40)], abs=1e-3)


# --- no time -------------------------------------------------------------------------------
def test_a_log_without_time_is_declared_so(tmp_path):
    path = write(
        tmp_path / "log.csv", ",".join(NAMES[1:]), [line.split(",", 1)[1] for line in rows()]
    )
    found = guess_mapping([path])
    assert 'time = "none"' in found.text and any(
        "nothing about rates" in line for line in found.unknown
    )
    done = import_logs([path], parse_mapping(found.text, path))
    assert done.run.timeless and done.run.frames == 40


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (lambda k: f"2031-127T10:15:{k:02d}", "'time' holds '2031-127T10:15:00'"),
        (lambda k: "2031-05-07", "'time' holds one date only"),
    ],
)
def test_a_column_of_time_that_is_not_read_is_named(tmp_path, text, words):
    path = write(tmp_path / "log.csv", ",".join(NAMES), rows(time=text))
    found = guess_mapping([path])
    assert any(words in line for line in found.assumed) and 'time = "none"' in found.text


def test_times_with_a_unit_in_each_cell_are_refused_with_the_way_out(tmp_path):
    path = write(tmp_path / "log.csv", ",".join(NAMES), rows(time=lambda k: f"{STEP * k}s"))
    with pytest.raises(
        RunError, match="columns time hold numbers with a unit, such as '0.0s'.*numbers only"
    ):
        guess_mapping([path])


def test_a_line_that_is_no_row_does_not_hide_the_time(tmp_path):
    path = write(tmp_path / "log.csv", ",".join(NAMES), rows(), "Average,1,2,3,4,5")
    found = guess_mapping([path])
    assert "skip_last_rows = 1" in found.text and "none" not in found.text
    assert import_logs([path], parse_mapping(found.text, path)).run.frames == 40


def test_the_finer_of_two_clocks_is_taken(tmp_path):
    lines = rows(time=lambda k: f"2031-05-07 10:15:{k // 20:02d},{50 * k}")
    found = guess_mapping(
        [write(tmp_path / "log.csv", ",".join(["date", "time_ms", *NAMES[1:]]), lines)]
    )
    assert 'column = "time_ms", unit = "ms"' in found.text


def test_days_of_a_spreadsheet(tmp_path):
    path = write(
        tmp_path / "log.csv",
        ",".join(NAMES),
        rows(time=lambda k: f"{48000.427 + STEP * k / 86400:.10f}"),
    )
    found = guess_mapping([path])
    assert 'unit = "d"' in found.text
    run = import_logs([path], parse_mapping(found.text, path)).run
    assert run.t == pytest.approx(STEP * np.arange(40), abs=1e-4)


def test_two_logs_without_time_are_joined_at_a_rate_that_is_assumed(tmp_path):
    commands = [",".join(line.split(",")[1:3]) for line in rows()]
    tips = [",".join(line.split(",")[3:]) for line in rows()]
    paths = [
        write(tmp_path / "a.csv", ",".join(NAMES[1:3]), commands),
        write(tmp_path / "b.csv", ",".join(NAMES[3:]), tips),
    ]
    found = guess_mapping(paths)
    assert found.text.count("assumed = true") == 2
    assert sum("a rate that is assumed" in line for line in found.said) == 2


# --- columns without names -----------------------------------------------------------------
def test_places_among_columns_without_names(tmp_path):
    tips = [f"{0.01 * k:.2f}," + ",".join(line.split(",")[3:]) for k, line in enumerate(rows(80))]
    found = guess_mapping([write(tmp_path / "log.csv", tips)])
    assert "[1, 2, 3]" in found.text and any(
        "their values look like" in line for line in found.unknown
    )


def test_commands_without_names_are_no_place(tmp_path):
    """Time, three commands from home, and a tip: six columns, of which three are a place."""
    lines = [line.split(",") for line in rows(80)]
    three = [",".join([line[0], line[1], line[2], line[1], *line[3:]]) for line in lines]
    with pytest.raises(RunError, match="no column looks like a command or a marker"):
        guess_mapping([write(tmp_path / "log.csv", three)])


def test_a_quaternion_behind_three_columns_makes_them_a_place(tmp_path):
    poses = [
        f"{STEP * k},{k % 7},{k % 5},{x},0,0,0,1,0,0"
        for k, x in enumerate(np.linspace(0.1, 0.2, 60))
    ]
    assert "[1, 2, 3]" in guess_mapping([write(tmp_path / "log.csv", poses)]).text
