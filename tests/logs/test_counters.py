"""A counter of frames or rows holds whole numbers; fractions are refused, and never proposed."""

import numpy as np
import pytest
from logs import fault, imported

from softmap_edge.logs.guess import guess_mapping

COUNTED = """schema = "softmap.mapping/1"
[[log]]
time = { column = "%s", rate_hz = 50.0 }
command = { columns = ["u1", "u2"] }
markers = { columns = [["tip_x", "tip_y", "tip_z"]] }
"""


def log(counts, name="frame", delimiter=","):
    rng = np.random.default_rng(3)
    tip = np.cumsum(rng.normal(size=(len(counts), 3)), axis=0) + [0, 0, 90]
    rows = np.column_stack([rng.uniform(-9, 9, (len(counts), 2)), tip])
    head = delimiter.join([name, "u1", "u2", "tip_x", "tip_y", "tip_z"])
    lines = [
        delimiter.join([count, *(f"{x:.6g}" for x in row)]) for count, row in zip(counts, rows)
    ]
    return "\n".join([head, *lines]) + "\n"


def counts(rows=60, **changed):
    texts = [str(k) for k in range(rows)]
    for row, text in changed.items():
        texts[int(row[1:])] = text
    return texts


@pytest.mark.parametrize("name", ["frame", "Frame#", "sample", "idx"])
def test_a_fraction_in_a_counter_is_refused_once(tmp_path, name):
    reported = fault(tmp_path, log(counts(r7="6.5", r30="29.25"), name), COUNTED % name)
    assert f"'{name}' is 6.5" in reported and "line 9" in reported, reported
    assert "1 more of 60 no whole numbers" in reported and "rate_hz" in reported


def test_time_in_a_counter_is_refused_with_the_way_out(tmp_path):
    seconds = [f"{0.02 * k:.2f}" for k in range(60)]
    assert "give `unit` in place of `rate_hz`" in fault(tmp_path, log(seconds, "t"), COUNTED % "t")


@pytest.mark.parametrize(
    "given",
    [
        counts(),
        [f"{k}.0" for k in range(60)],
        [f"{k:.3e}" for k in range(60)],
        [str(2**31 + 3 * k) for k in range(60)],
    ],
)
def test_whole_numbers_in_any_writing_count(tmp_path, given):
    run = imported(tmp_path, log(given), COUNTED % "frame").run
    step = float(given[1]) - float(given[0])
    assert np.diff(run.t) == pytest.approx(np.full(59, step / 50.0))


def test_an_empty_count_is_no_fraction(tmp_path):
    lines = log(counts()).splitlines()
    lines[20] = ",,,,,"
    assert len(imported(tmp_path, "\n".join(lines), COUNTED % "frame").run.t) == 59


@pytest.mark.parametrize(
    ("given", "name"),
    [
        (counts(r9="8.5"), "frame"),
        (counts(r9="8.5"), "index"),
        ([f"{k / 2:g}" for k in range(60)], "frame"),
    ],
)
def test_a_broken_counter_is_not_proposed_as_time(tmp_path, given, name):
    (tmp_path / "log.csv").write_text(log(given, name), encoding="utf-8")
    text = guess_mapping([tmp_path / "log.csv"]).text
    assert f'column = "{name}"' not in text and "which is not the number of a row" in text


def test_seconds_in_a_column_called_as_a_counter_are_proposed(tmp_path):
    seconds = [f"{0.02 * k:.2f}" for k in range(60)]
    (tmp_path / "log.csv").write_text(log(seconds, "index"), encoding="utf-8")
    assert 'time = { column = "index", unit = "s" }' in guess_mapping([tmp_path / "log.csv"]).text
