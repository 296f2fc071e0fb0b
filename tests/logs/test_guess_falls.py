"""A column that is time by its name and mostly by its values is proposed, with the key that reads
it and the doubt.
"""

import numpy as np
import pytest
from bench_rows import NAMES, STEP, rows, write

from softmap_edge.logs.clock import find_jump, increasing, longest_rise
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.logs.time_keys import Clock

COUNT = 300
EVEN = 1000 + STEP * np.arange(COUNT)


def proposed(folder, times, name="time"):
    path = write(
        folder / "log.csv",
        ",".join([name, *NAMES[1:]]),
        rows(len(times), time=lambda k: f"{times[k]:.13g}"),
    )
    found = guess_mapping([path])
    assert "no column holds time" not in found.text
    return found, path


def read(found, path):
    return import_logs([path], parse_mapping(found.text.replace("zero_time = true", ""), path))


def changed(at, values, times=EVEN):
    times = times.copy()
    times[at] = values
    return times


def set_back(*steps):
    """A clock that is set back by some s at some rows."""
    return EVEN - sum(np.where(np.arange(COUNT) >= row, size, 0.0) for row, size in steps)


STRAY = {
    "rows out of order": (changed([50, 51, 120, 121], EVEN[[51, 50, 121, 120]]), 2),
    "a row far too early": (changed([70], EVEN[60]), 1),
    "stamps of 0": (changed([90, 91, 200], 0.0), 3),
    "one stamp of 0": (changed([90], 0.0), 1),
    "stamps of -1": (changed([90, 250], -1.0), 2),
    "a stamp far too late": (changed([90], 4e9), 1),
    "stamps of the largest counter": (changed([90, 140], 4294967295.0), 2),
    "seconds since 1970": (changed([33, 90], 0.0, EVEN + 1.7747e9), 2),
}


@pytest.mark.parametrize("kind", STRAY)
def test_stray_times_are_left_out(tmp_path, kind):
    times, lost = STRAY[kind]
    found, path = proposed(tmp_path, times)
    assert 'column = "time", unit = "s", repeated = "drop" }' in found.text
    assert any(f"leaves out {lost} of {COUNT} rows" in said for said in found.unknown)
    done = read(found, path)
    assert len(done.run.t) == COUNT - lost and (np.diff(done.run.t) < 5 * STEP).all()
    assert any(
        f"{lost} rows whose time does not increase were dropped" in note for note in done.notes
    )


def test_few_falls_of_a_long_log_need_the_key_as_well(tmp_path):
    times = 1000 + STEP * np.arange(3000)
    times[1500] = 0.0
    found, path = proposed(tmp_path, times)
    assert 'repeated = "drop"' in found.text and len(read(found, path).run.t) == 2999


@pytest.mark.parametrize("size", [2.0, 60.0, 3600.0])
def test_a_clock_that_was_set_back_once_is_mended(tmp_path, size):
    found, path = proposed(tmp_path, set_back((140, size)))
    assert 'jumps = "mend"' in found.text and any(
        f"set back by {size - STEP:.6g} s at row 140" in s for s in found.unknown
    )
    assert read(found, path).run.t == pytest.approx(EVEN, abs=1e-6)


@pytest.mark.parametrize(
    "steps",
    [((140, 1.0), (200, 2.0)), ((90, 3.0), (150, 1.5), (240, 60.0)), ((100, 60.0), (200, 60.0))],
)
def test_a_clock_that_was_set_back_several_times_is_mended_with_a_doubt(tmp_path, steps):
    found, path = proposed(tmp_path, set_back(*steps))
    assert 'jumps = "mend"' in found.text and 'repeated = "drop"' not in found.text
    assert any(
        f"at row {steps[-1][0]}: jumps" in said and f"{len(steps)} steps" in said
        for said in found.unknown
    )
    done = read(found, path)
    assert done.run.t == pytest.approx(EVEN, abs=1e-6)
    assert sum("the clock was set by" in doubt for doubt in done.doubts) == len(steps)


def test_recordings_in_a_row_are_not_joined(tmp_path):
    times = np.r_[EVEN[:150], EVEN[:150]]
    found, _ = proposed(tmp_path, times)
    assert (
        'column = "time", unit = "s" }' in found.text
        and "mend" not in found.text.split("schema")[1]
    )
    assert any("to_row = 149 and from_row = 150" in said for said in found.unknown)


def test_several_recordings_in_a_row_are_not_mended(tmp_path):
    found, _ = proposed(tmp_path, np.r_[EVEN[:100], EVEN[:100], EVEN[:100]])
    assert "mend" not in found.text.split("schema")[1] and any(
        "starts again at row 100" in s for s in found.unknown
    )


# --- the unit --------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "unit"),
    [("millis", "ms"), ("ms", "ms"), ("elapsedMillis", "ms"), ("micros", "us"), ("timeMs", "ms"), ("t_usec", "us"),
     ("Milliseconds", "ms"), ("systemNanos", "ns")],
)  # fmt: skip
@pytest.mark.parametrize("rolls", [True, False])
def test_a_name_states_the_unit(tmp_path, name, unit, rolls):
    scale = {"ms": 1e3, "us": 1e6, "ns": 1e9}[unit]
    counts = np.rint((EVEN - 1000) * scale) + (
        2.0**32 - 4 * scale if unit != "ns" and rolls else 1.2e9
    )
    found, path = proposed(tmp_path, counts % 2.0**32 if rolls and unit != "ns" else counts, name)
    assert f'column = "{name}", unit = "{unit}"' in found.text
    run = read(found, path).run
    assert len(run.t) == COUNT and np.diff(run.t) == pytest.approx(STEP, abs=2 / scale)


def test_a_unit_is_a_name_of_time_in_any_column(tmp_path):
    lines = [",".join([*NAMES[1:], "millis"])]
    lines += [
        ",".join([*row.split(",")[1:], str(5000 + 50 * k)]) for k, row in enumerate(rows(COUNT))
    ]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    assert 'column = "millis", unit = "ms"' in guess_mapping([tmp_path / "log.csv"]).text


@pytest.mark.parametrize(("unit", "bits"), [("ms", 32), ("us", 32), ("ms", 16)])
def test_a_roll_over_shows_the_unit_where_the_name_does_not(tmp_path, unit, bits):
    scale = {"ms": 1e3, "us": 1e6}[unit]
    counts = np.rint((EVEN - 1000) * scale + 2.0**bits - 4 * scale) % 2.0**bits
    found, path = proposed(tmp_path, counts, "t")
    assert f'unit = "{unit}", jumps = "mend"' in found.text
    assert np.diff(read(found, path).run.t) == pytest.approx(STEP, abs=2 / scale)


# --- the rules --------------------------------------------------------------------------------
def test_one_stray_time_is_no_step():
    clock = Clock("t", 1.0)
    for value in (0.0, 4e9):
        assert find_jump(changed([90], value), clock) is None
    assert find_jump(set_back((90, 60.0)), clock).period_s is None


def test_the_longest_rise():
    t = np.array([1.0, 2.0, 90.0, 3.0, 4.0, 0.0, 5.0, 5.0])
    assert t[longest_rise(t)].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert increasing(t).sum() == 3  # too few remain: as far as time rises
    assert (
        increasing(changed([90], 4e9)).sum() == COUNT - 1 and longest_rise(np.zeros(0)).sum() == 0
    )
