"""What tells time in a log: seconds with their fraction, counters, nothing; and places among columns without names."""

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


def parts(unit, first="whole"):
    def written(k):
        whole, fraction = int(at(k)), round((at(k) - int(at(k))) * {"ns": 1e9, "us": 1e6, "ms": 1e3}[unit])
        return f"{whole},{fraction}" if first == "whole" else f"{fraction},{whole}"

    return written


@pytest.mark.parametrize(
    ("names", "unit", "first"),
    [
        ("stamp.sec,stamp.nanosec", "ns", "whole"),
        ("header.stamp.secs,header.stamp.nsecs", "ns", "whole"),
        ("tv_usec,tv_sec", "us", "fraction"),
        ("Seconds,Nanoseconds", "ns", "whole"),
        ("sec,nsec", "ns", "whole"),
        ("log_s,log_ms", "ms", "whole"),
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
    mapping = 'schema = "softmap.mapping/1"\n[[log]]\ntime = { %s }\ncommand = { columns = ["cmd_1"] }'
    run = import_logs([path], parse_mapping(mapping % 'columns = ["s", "n"]', path)).run
    assert run.t == pytest.approx([at(k) for k in range(40)], abs=1e-6)
    for keys, words in (
        ('columns = ["s"]', "expected two"),
        ('columns = ["s", "n"], column = "s"', "give one of them"),
        ('columns = ["s", "n"], units = ["s", "h"]', "expected two of s, ms"),
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
    path = write(tmp_path / "log.csv", ",".join(NAMES), rows(time=lambda k: repr(round(at(k) * scale, 4))))
    found = guess_mapping([path])
    assert f'unit = "{unit}"' in found.text
    run = import_logs([path], parse_mapping(found.text, path)).run
    assert run.t == pytest.approx([at(k) - START for k in range(40)], abs=1e-3)


# --- no time -------------------------------------------------------------------------------
def test_a_log_without_time_is_declared_so(tmp_path):
    path = write(tmp_path / "log.csv", ",".join(NAMES[1:]), [line.split(",", 1)[1] for line in rows()])
    found = guess_mapping([path])
    assert 'time = "none"' in found.text and any("nothing about rates" in line for line in found.unknown)
    done = import_logs([path], parse_mapping(found.text, path))
    assert done.run.timeless and done.run.frames == 40


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
    assert "[1, 2, 3]" in found.text and any("their values look like" in line for line in found.unknown)


def test_commands_without_names_are_no_place(tmp_path):
    """Time, three commands from home, and a tip: six columns, of which three are a place."""
    lines = [line.split(",") for line in rows(80)]
    three = [",".join([line[0], line[1], line[2], line[1], *line[3:]]) for line in lines]
    with pytest.raises(RunError, match="no column looks like a command or a marker"):
        guess_mapping([write(tmp_path / "log.csv", three)])


def test_a_quaternion_behind_three_columns_makes_them_a_place(tmp_path):
    poses = [f"{STEP * k},{k % 7},{k % 5},{x},0,0,0,1,0,0" for k, x in enumerate(np.linspace(0.1, 0.2, 60))]
    assert "[1, 2, 3]" in guess_mapping([write(tmp_path / "log.csv", poses)]).text
