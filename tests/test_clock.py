"""Clocks that roll over, are set, or stand still: what is reported, what is mended, and what a remedy costs."""

import re

import numpy as np
import pytest
from bench_rows import NAMES, STEP, rows, write

from softmap_edge.errors import RunError
from softmap_edge.logs.clock import spread
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping

MAP = """schema = "softmap.mapping/1"
[[log]]
time = { column = "time"%s }
command = { columns = ["cmd_1", "cmd_2"] }
markers = { columns = ["tip_x", "tip_y", "tip_z"], unit = "mm" }
"""
COUNT = 300


def log(folder, times):
    return write(folder / "log.csv", ",".join(NAMES), rows(len(times), time=lambda k: f"{times[k]:.10g}"))


def imported(path, keys=""):
    return import_logs([path], parse_mapping(MAP % keys, path))


def fault(path, keys=""):
    with pytest.raises(RunError) as found:
        imported(path, keys)
    assert "\n" not in str(found.value)
    return str(found.value)


def uneven(count=COUNT, usual=STEP, seed=0):
    """Times of rows that are not evenly apart."""
    return np.cumsum(np.random.default_rng(seed).uniform(0.4 * usual, 1.6 * usual, count))


# --- roll-overs ----------------------------------------------------------------------------
ROLLS = {
    "32 bits of us": (4294967296, 1e6, "2^32 us", ', unit = "us"'),
    "32 bits of ms": (4294967296, 1e3, "2^32 ms", ', unit = "ms"'),
    "16 bits of ms": (65536, 1e3, "2^16 ms", ', unit = "ms"'),
    "us written as s": (4294.967296, 1.0, "2^32 us", ""),
    "32 bits of ns": (4.294967296, 1.0, "2^32 ns", ""),
    "16 bits of a counter": (65536, 20.0, "2^16 counts", ", rate_hz = 20"),
    "8 bits of a counter": (256, 20.0, "2^8 counts", ", rate_hz = 20"),
    "seconds of the minute": (60, 1.0, "the full minute", ""),
    "a fraction of a second": (1e9, 1e9, "the full second", ', unit = "ns"'),
}


@pytest.mark.parametrize("kind", ROLLS)
def test_a_roll_over_is_named_and_counted_on(tmp_path, kind):
    period, scale, words, keys = ROLLS[kind]
    even = uneven() if "counter" not in kind else STEP * np.arange(COUNT)
    t = (period - 4 * scale + even * scale) % period if period > 8 * scale else (even * scale) % period
    path = log(tmp_path, np.rint(t) if scale > 1 else t)
    message = fault(path, keys)
    assert f"the clock rolls over at {words}" in message and 'jumps = "mend"' in message and "drop" not in message
    assert re.search(r"at row \d+ \(line \d+", message)
    done = imported(path, keys + ', jumps = "mend"')
    assert len(done.run.t) == COUNT and done.run.t - done.run.t[0] == pytest.approx(
        even - even[0], abs=1.1 / scale + 1e-4
    )
    assert any("rolls over" in note for note in done.notes) and not any("rolls" in doubt for doubt in done.doubts)


def test_a_proposal_counts_on_over_a_roll_over(tmp_path):
    even = uneven()
    path = log(tmp_path, np.rint((4294967296 - 4e6 + even * 1e6) % 4294967296))
    found = guess_mapping([path])
    assert 'unit = "us", jumps = "mend"' in found.text
    assert import_logs([path], parse_mapping(found.text, path)).run.t[-1] - even[-1] == pytest.approx(4290.967, abs=0.1)


# --- steps ---------------------------------------------------------------------------------
@pytest.mark.parametrize("size", [60.0, 0.7, 3600.0, 60.0 - STEP])
def test_a_clock_that_was_set_back_is_named_with_its_step_and_the_ways_out(tmp_path, size):
    even = 1000 + STEP * np.arange(COUNT)
    t = np.where(np.arange(COUNT) >= 133, even - size, even)
    path = log(tmp_path, t)
    message = fault(path)
    assert "row 133 (line 135" in message and f"set back by about {size:.6g} s" in message and "drop" not in message
    done = imported(path, ', jumps = "mend"')
    assert done.run.t == pytest.approx(even, abs=1e-6)
    assert any("the step was taken out" in doubt and f"{-size:.6g} s" in doubt for doubt in done.doubts)
    first, second = re.search(r"to_row = (\d+) and from_row = (\d+)", message).groups()
    for keys, count in ((f"to_row = {first}", 133), (f"from_row = {second}", COUNT - 133)):
        part = import_logs([path], parse_mapping((MAP % "").replace("[[log]]", f"[[log]]\n{keys}"), path))
        assert len(part.run.t) == count and any(f"{count} of 300 rows" in note for note in part.notes)


def test_a_clock_that_was_set_forward_is_a_look_at_and_a_pause_is_not(tmp_path):
    even = STEP * np.arange(COUNT)
    t = np.where(np.arange(COUNT) >= 133, even + 3600, even)
    done = imported(log(tmp_path, t))
    assert any("leaps by 3600.05 s at row 133" in doubt and "set forward" in doubt for doubt in done.doubts)
    assert imported(log(tmp_path, t), ', jumps = "mend"').run.t == pytest.approx(even)
    far = write(
        tmp_path / "log.csv",
        ",".join(NAMES),
        rows(133),
        rows(COUNT - 133, first=147, time=lambda k: f"{STEP * k + 3600}"),
    )  # the robot is elsewhere after a pause
    assert not any("leaps" in doubt for doubt in imported(far).doubts)


def test_two_steps_are_not_mended(tmp_path):
    t = 1000 + STEP * np.arange(COUNT)
    t[100:] -= 60
    t[200:] -= 60
    assert "set back" not in fault(log(tmp_path, t)) and "goes backwards" in fault(log(tmp_path, t), ', jumps = "mend"')


# --- dropping and spreading ----------------------------------------------------------------
def test_drop_is_offered_only_where_it_loses_few_rows(tmp_path):
    t = STEP * np.arange(COUNT)
    t[[50, 51]] = t[[51, 50]]  # two rows out of order
    path = log(tmp_path, t)
    assert "leave 1 of 300 rows out" in fault(path)
    done = imported(path, ', repeated = "drop"')
    assert len(done.run.t) == COUNT - 1 and not any("drop" in doubt for doubt in done.doubts)


def test_drop_that_loses_much_is_a_look_at(tmp_path):
    even = uneven()
    path = log(tmp_path, np.rint((4294967296 - 4e6 + even * 1e6) % 4294967296))
    done = imported(path, ', unit = "us", repeated = "drop"')
    lost = COUNT - len(done.run.t)
    assert lost > 150
    assert any(f"leaves out {lost} of 300 rows" in doubt and "rolls over at 2^32 us" in doubt for doubt in done.doubts)


def test_times_that_are_made_up_are_a_look_at_with_their_count(tmp_path):
    t = np.floor(STEP * (np.arange(COUNT) + 13))  # even seconds, the first one cut
    path = log(tmp_path, t)
    assert "drop" not in fault(path) and '"spread"' in fault(path)
    done = imported(path, ', repeated = "spread"')
    assert any("284 of 300 rows share a time" in doubt for doubt in done.doubts)
    assert np.diff(done.run.t) == pytest.approx(
        STEP
    )  # the seven rows of the first second are not spread over all of it


def test_spread_keeps_whole_groups():
    assert spread(np.array([0.0, 0.0, 1.0, 1.0, 2.0, 2.0])) == pytest.approx([0, 0.5, 1, 1.5, 2, 2.5])


def test_a_rate_that_is_assumed_is_a_look_at(tmp_path):
    path = log(tmp_path, np.arange(COUNT))
    found = guess_mapping([path])
    assert "rate_hz = 100, assumed = true" in found.text
    done = import_logs([path], parse_mapping(found.text, path))
    assert any("the times of 300 rows are 'time' at 100 Hz, a rate that is assumed" in doubt for doubt in done.doubts)
    assert imported(path, ", rate_hz = 100").doubts == ()
