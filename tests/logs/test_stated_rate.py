"""The rate that the lines above a table state is proposed; what only looks like one is not."""

import numpy as np
import pytest
from bench_rows import NAMES, rows, write

from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.logs.readers.stated_rate import stated_rate

STATED = {
    "Sample rate: 200 Hz": 200.0,
    "Capture Frame Rate,120.000000": 120.0,
    "# fs = 50": 50.0,
    "fps;30": 30.0,
    "FREQUENCY\t250": 250.0,
    "Rate (Hz)\t100": 100.0,
    "Sampling frequency [kHz]: 0,5 kHz": 500.0,
    "Sampling interval: 5 ms": 200.0,
    "Delta_X\t0.005000\t0.005000": 200.0,
    "dt = 0.02": 50.0,
    "Frames per second: 59.94": 59.94,
}
OTHERS = [
    "Baud rate: 115200",
    "Heart rate: 72",
    "Slew rate,3000",
    "Rate limited",
    "Operator: Fs",
    "date: 2031-05-07 10:15",
    "Sample rate: 0 Hz",
    "Notes: 200 Hz hum",
    "Sample rate: 100 Hz, Export rate: 50 Hz",
    "generate 200",
]


@pytest.mark.parametrize("line", STATED)
def test_a_rate_is_read(line):
    assert stated_rate(["Some bench", line, "made by hand"]) == pytest.approx(STATED[line])


@pytest.mark.parametrize("line", OTHERS)
def test_what_is_no_rate_is_none(line):
    assert stated_rate([line]) is None


@pytest.mark.parametrize("line", ["Sample rate: 20 Hz", "Delta_X\t0.05", "# fs = 20"])
@pytest.mark.parametrize("counter", ["frame", None])
def test_a_stated_rate_is_proposed_and_not_assumed(tmp_path, line, counter):
    named = [*([counter] if counter else []), *NAMES[1:]]
    body = [
        ",".join([*([str(k + 7)] if counter else []), *row.split(",")[1:]])
        for k, row in enumerate(rows(60))
    ]
    path = write(tmp_path / "log.csv", "Bench 3", line, ",".join(named), body)
    found = guess_mapping([path])
    assert "rate_hz = 20 }" in found.text and "assumed = true" not in found.text
    assert any("state 20 Hz" in said for said in found.assumed)
    assert not any("how fast" in said for said in found.unknown)
    done = import_logs([path], parse_mapping(found.text, path))
    assert np.diff(done.run.t) == pytest.approx(0.05) and not done.run.timeless


def test_a_column_of_time_counts_more_than_a_stated_rate(tmp_path):
    path = write(tmp_path / "log.csv", "Sample rate: 1000 Hz", ",".join(NAMES), rows(60))
    assert 'time = { column = "time"' in guess_mapping([path]).text
