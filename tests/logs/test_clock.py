"""Clocks that roll over, are set, or stand still: what is reported, what is mended, and what a
remedy costs.
"""

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
    return write(
        folder / "log.csv", ",".join(NAMES), rows(len(times), time=lambda k: f"{times[k]:.10g}")
    )


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
    t = (
        (period - 4 * scale + even * scale) % period
        if period > 8 * scale
        else (even * scale) % period
    )
    path = log(tmp_path, np.rint(t) if scale > 1 else t)
    message = fault(path, keys)
    assert (
        f"the clock rolls over at {words}" in message
        and 'jumps = "mend"' in message
        and "drop" not in message
    )
    assert re.search(r"at row \d+ \(line \d+", message)
    done = imported(path, keys + ', jumps = "mend"')
    assert len(done.run.t) == COUNT and done.run.t - done.run.t[0] == pytest.approx(
        even - even[0], abs=1.1 / scale + 1e-4
    )
    assert any("rolls over" in note for note in done.notes) and not any(
        "rolls" in doubt for doubt in done.doubts
    )


def test_a_proposal_counts_on_over_a_roll_over(tmp_path):
    even = uneven()
    path = log(tmp_path, np.rint((4294967296 - 4e6 + even * 1e6) % 4294967296))
    found = guess_mapping([path])
    assert 'unit = "us", jumps = "mend"' in found.text
    assert import_logs([path], parse_mapping(found.text, path)).run.t[-1] - even[
        -1
    ] == pytest.approx(4290.967, abs=0.1)


# --- steps ---------------------------------------------------------------------------------
@pytest.mark.parametrize("size", [60.0, 0.7, 3600.0, 60.0 - STEP])
def test_a_clock_that_was_set_back_is_named_with_its_step_and_the_ways_out(tmp_path, size):
    even = 1000 + STEP * np.arange(COUNT)
    t = np.where(np.arange(COUNT) >= 133, even - size, even)
    path = log(tmp_path, t)
    message = fault(path)
    assert (
        "row 133 (line 135" in message
        and f"set back by about {size:.6g} s" in message
        and "drop" not in message
    )
    done = imported(path, ', jumps = "mend"')
    assert done.run.t == pytest.approx(even, abs=1e-6)
    assert any(
        "the step was taken out" in doubt and f"{-size:.6g} s" in doubt for doubt in done.doubts
    )
    first, second = re.search(r"to_row = (\d+) and from_row = (\d+)", message).groups()
    for keys, count in ((f"to_row = {first}", 133), (f"from_row = {second}", COUNT - 133)):
        part = import_logs(
            [path], parse_mapping((MAP % "").replace("[[log]]", f"[[log]]\n{keys}"), path)
        )
        assert len(part.run.t) == count and any(
            f"{count} of 300 rows" in note for note in part.notes
        )


def test_a_clock_that_was_set_forward_is_a_look_at_and_a_pause_is_not(tmp_path):
    even = STEP * np.arange(COUNT)
    t = np.where(np.arange(COUNT) >= 133, even + 3600, even)
    done = imported(log(tmp_path, t))
    assert any(
        "leaps by 3600.05 s at row 133" in doubt and "set forward" in doubt for doubt in done.doubts
    )
    assert imported(log(tmp_path, t), ', jumps = "mend"').run.t == pytest.approx(even)
    far = write(
        tmp_path / "log.csv",
        ",".join(NAMES),
        rows(133),
        rows(COUNT - 133, first=147, time=lambda k: f"{STEP * k + 3600}"),
    )  # the robot is at another pose after a pause
    assert not any("leaps" in doubt for doubt in imported(far).doubts)


def body(k, noise=0.05, speed=1.0, seed=0):
    """Two commands and three markers (K, 11) of a finger with noise; the lowest marker hardly
    moves.
    """
    a = np.c_[np.sin(0.09 * speed * k), np.cos(0.07 * speed * k)]
    places = [np.c_[60 * h**2 * a, 100 * h + 0 * k] for h in (0.1, 0.5, 1.0)]
    return np.c_[
        5 * a,
        np.concatenate(places, axis=1)
        + noise * np.random.default_rng(seed).normal(size=(len(k), 9)),
    ]


BODY = """schema = "softmap.mapping/1"
[[log]]
time = { column = "t"%s }
command = { columns = ["a", "b"] }
markers = { columns = [["x0", "y0", "z0"], ["x1", "y1", "z1"], ["x2", "y2", "z2"]], unit = "mm" }
"""


def of_body(folder, t, values, keys="", more=""):
    path = folder / "log.csv"
    lines = [",".join([f"{s:.3f}", *(f"{x:.4f}" for x in row)]) for s, row in zip(t, values)]
    path.write_text("\n".join(["t,a,b,x0,y0,z0,x1,y1,z1,x2,y2,z2", *lines]) + "\n")
    return import_logs(
        [path], parse_mapping((BODY % keys).replace("[[log]]", f"[[log]]\n{more}"), path)
    )


ROW = np.arange(COUNT)
EPOCH = 1774746000 + STEP * ROW
SET_FORWARD = {
    "noise": (EPOCH + 3600 * (ROW >= 150), body(ROW)),
    "much noise": (EPOCH + 3600 * (ROW >= 150), body(ROW, noise=1.0)),
    "slow": (EPOCH + 86400 * (ROW >= 97), body(ROW, speed=0.3)),
    "near the beginning": (EPOCH + 5.0 * (ROW >= 12), body(ROW, noise=0)),
    "twice": (EPOCH + 3600 * (ROW >= 80) + 60 * (ROW >= 200), body(ROW)),
    "a slow clock": (10 * EPOCH + 4e4 * (ROW >= 150), body(ROW, seed=3)),
}
STOOD = np.r_[np.arange(150), np.full(60, 149), 149 + np.arange(90)]
PAUSED = {
    "elsewhere": (EPOCH + 3600 * (ROW >= 150), body(ROW + 17 * (ROW >= 150))),
    "elsewhere with much noise": (
        EPOCH + 3600 * (ROW >= 150),
        body(ROW + 17 * (ROW >= 150), noise=1.0),
    ),
    "at rest": (EPOCH + 3600 * (ROW >= 180), body(STOOD)),
    "at rest without noise": (EPOCH + 3600 * (ROW >= 180), body(STOOD, noise=0)),
    "it never moves": (EPOCH + 3600 * (ROW >= 150), body(0 * ROW)),
    "a short gap": (EPOCH + 0.4 * (ROW >= 150), body(ROW)),
}


@pytest.mark.parametrize("name", list(SET_FORWARD))
def test_a_leap_after_which_the_values_go_on_is_a_clock_that_was_set(tmp_path, name):
    t, values = SET_FORWARD[name]
    leaps = [doubt for doubt in of_body(tmp_path, t, values).doubts if "leaps" in doubt]
    rows = np.flatnonzero(np.diff(t) > 100 * np.median(np.diff(t)) - 1e-6) + 1
    assert len(leaps) == len(rows) and all(
        f"at row {k} (line {k + 2})" in leap for k, leap in zip(rows, leaps)
    )
    done = of_body(tmp_path, t, values, ', jumps = "mend"')
    assert np.diff(done.run.t) == pytest.approx(np.median(np.diff(t)), abs=1e-3)
    assert sum("was set by" in doubt for doubt in done.doubts) == len(rows)


@pytest.mark.parametrize("name", list(PAUSED))
def test_a_pause_is_no_clock_that_was_set(tmp_path, name):
    t, values = PAUSED[name]
    done = of_body(tmp_path, t, values, ', jumps = "mend"')
    assert done.run.t[-1] - done.run.t[0] == pytest.approx(t[-1] - t[0])
    assert not any("leaps" in doubt for doubt in of_body(tmp_path, t, values).doubts)


SET_BACK = {
    "twice": (EPOCH - 3.2 * (ROW >= 150) - 2.1 * (ROW >= 225), (150, 225)),
    "three times": (
        EPOCH - 60 * (ROW >= 50) - 60 * (ROW >= 100) - 0.7 * (ROW >= 260),
        (50, 100, 260),
    ),
    "seven times": (EPOCH - 1.5 * (ROW // 40), tuple(range(40, COUNT, 40))),
    "back, and forward again": (
        EPOCH - 3600.0 * ((ROW >= 100) & (ROW < 200)) - 9 * (ROW >= 250),
        (100, 250),
    ),
}


@pytest.mark.parametrize("name", list(SET_BACK))
@pytest.mark.parametrize("rests", [False, True])
def test_a_clock_that_was_set_back_several_times_is_mended_step_by_step(tmp_path, name, rests):
    t, rows = SET_BACK[name]
    values = body(ROW) if not rests else body(np.clip(ROW, 0, 40), noise=0)
    with pytest.raises(RunError) as found:
        of_body(tmp_path, t, values)
    message = str(found.value)
    assert (
        f"set back {len(rows)} times" in message
        and f"goes backwards at row {rows[0]} (line {rows[0] + 2}" in message
    )
    assert (
        "order of time" not in message
        and f"to_row = {rows[0] - 1}; from_row = {rows[0]} with" in message
    )
    if not rests or "forward" not in name:
        done = of_body(tmp_path, t, values, ', jumps = "mend"')
        assert np.diff(done.run.t) == pytest.approx(STEP, abs=1e-3)


def test_row_numbers_are_those_of_the_log_whatever_was_cut_off(tmp_path):
    """The parts that a message proposes can be imported, all of them."""
    t, rows = SET_BACK["three times"]
    with pytest.raises(
        RunError, match=r"goes backwards at row 100 \(line 102.*to_row = 99; from_row = 100 with"
    ):
        of_body(tmp_path, t, body(ROW), more="from_row = 50")
    with pytest.raises(RunError, match=r"at row 260 \(line 262.*to_row = 259 and from_row = 260"):
        of_body(tmp_path, t, body(ROW), more="from_row = 100")
    for first, last in zip((0, *rows), (*rows, COUNT)):
        done = of_body(tmp_path, t, body(ROW), more=f"from_row = {first}\nto_row = {last - 1}")
        assert len(done.run.t) == last - first
    forward = EPOCH + 3600 * (ROW >= 150)
    done = of_body(tmp_path, forward, body(ROW), more="from_row = 60")
    assert any(
        "at row 150 (line 152)" in doubt and "to_row = 149" in doubt for doubt in done.doubts
    )


OUT_OF_ORDER = {
    "stamps of zero": np.where(np.isin(ROW, (100, 200)), 0.0, EPOCH),
    "late rows": EPOCH - 0.4 * np.isin(ROW, (70, 71, 150)),
    "blocks that changed places": np.r_[EPOCH[:100], EPOCH[150:200], EPOCH[100:150], EPOCH[200:]],
}


@pytest.mark.parametrize("name", list(OUT_OF_ORDER))
def test_rows_out_of_order_are_no_clock_that_was_set(tmp_path, name):
    t = OUT_OF_ORDER[name]
    values = body(ROW)[np.argsort(np.argsort(t))] if "blocks" in name else body(ROW)
    t = t if "blocks" not in name else np.r_[t, EPOCH[-1] + STEP * np.arange(1, 61) - 4]
    values = values if "blocks" not in name else np.r_[values, body(np.arange(60) + 7)]
    with pytest.raises(RunError) as found:
        of_body(tmp_path, t, values)
    assert "times" not in str(found.value).split("such rows")[1].split("leave")[0]


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
    assert any(
        f"leaves out {lost} of 300 rows" in doubt and "rolls over at 2^32 us" in doubt
        for doubt in done.doubts
    )


def test_times_that_are_made_up_are_a_look_at_with_their_count(tmp_path):
    t = np.floor(STEP * (np.arange(COUNT) + 13))  # even seconds, the first one cut
    path = log(tmp_path, t)
    assert "drop" not in fault(path) and '"spread"' in fault(path)
    done = imported(path, ', repeated = "spread"')
    assert any("284 of 300 rows share a time" in doubt for doubt in done.doubts)
    assert np.diff(done.run.t) == pytest.approx(
        STEP
    )  # the seven rows of the first second are not spread over all of it


def test_spread_keeps_complete_groups():
    assert spread(np.array([0.0, 0.0, 1.0, 1.0, 2.0, 2.0])) == pytest.approx(
        [0, 0.5, 1, 1.5, 2, 2.5]
    )


def test_a_rate_that_is_assumed_is_a_look_at(tmp_path):
    path = log(tmp_path, np.arange(COUNT))
    found = guess_mapping([path])
    assert "rate_hz = 100, assumed = true" in found.text
    done = import_logs([path], parse_mapping(found.text, path))
    assert any(
        "the times of 300 rows are 'time' at 100 Hz, a rate that is assumed" in doubt
        for doubt in done.doubts
    )
    assert imported(path, ", rate_hz = 100").doubts == ()
