"""Times written as seconds, a point and a count of ms, us or ns without leading zeros (`12.5` is
12 s and 5 us): recognised by the rows, and reported. Decimal fractions stay decimal.
"""

import numpy as np
import pytest
from bench_rows import NAMES, rows, write

from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.logs.table import open_log

HEAD = ",".join(NAMES)
UNITS = {"ms": 10**3, "us": 10**6, "ns": 10**9}
MAP = """schema = "softmap.mapping/1"
[[log]]
time = {{ column = "time"{} }}
command = {{ columns = ["cmd_1", "cmd_2"] }}
markers = {{ columns = [["tip_x", "tip_y", "tip_z"]] }}
"""


def ticks(unit, rate, start, count=400):
    """Counts of the unit with some jitter, from `start` s on."""
    jitter = np.random.default_rng(3).integers(0, max(UNITS[unit] // rate // 4, 1), count)
    return [
        int(start * UNITS[unit]) + k * (UNITS[unit] // rate) + int(j) for k, j in enumerate(jitter)
    ]


def counted(unit, point="."):
    return lambda tick: f"{tick // UNITS[unit]}{point}{tick % UNITS[unit]}"


@pytest.mark.parametrize("unit", list(UNITS))
@pytest.mark.parametrize(("rate", "start"), [(20, 12.0), (100, 1_700_000_000.93), (250, 0.0)])
def test_counts_are_read_as_counts(tmp_path, unit, rate, start):
    at = ticks(unit, rate, start)
    text = counted(unit)
    path = write(tmp_path / "log.csv", HEAD, rows(400, time=lambda k: text(at[k])))
    found = guess_mapping([path])
    assert any("seconds, with a count of their fractions" in line for line in found.assumed)
    assert "repeated" not in found.text and "jumps" not in found.text
    for mapping in (found.text, MAP.format(""), MAP.format(', unit = "s"')):
        done = import_logs([path], parse_mapping(mapping, path))
        assert np.diff(done.run.t) == pytest.approx(np.diff(at) / UNITS[unit], abs=1e-6)
        assert any(f".50 is read as 50 {unit}" in note for note in done.notes)


def test_a_decimal_comma(tmp_path):
    at, text = ticks("us", 50, 7.5), counted("us", ",")
    path = write(
        tmp_path / "log.csv",
        HEAD.replace(",", ";"),
        rows(400, cut=";", point=",", time=lambda k: text(at[k])),
    )
    run = import_logs([path], parse_mapping(guess_mapping([path]).text, path)).run
    assert np.diff(run.t) == pytest.approx(np.diff(at) / 1e6, abs=1e-9)


DECIMAL = {
    "as Python writes it": lambda k: str(round(12.9 + 0.0125 * k, 6)),
    "whole ms without zeros at the end": lambda k: f"{12 + 0.05 * k:.3f}".rstrip("0").rstrip("."),
    "six digits": lambda k: f"{1_700_000_000 + 0.01 * k:.6f}",
    "tenths": lambda k: f"{0.1 * k:.1f}",
    "whole seconds": lambda k: str(k),
    "a count without any point": lambda k: str(12_000_005 + 10_000 * k),
}


@pytest.mark.parametrize("make", list(DECIMAL))
def test_decimal_fractions_stay_decimal(tmp_path, make):
    path = write(tmp_path / "log.csv", HEAD, rows(400, time=DECIMAL[make]))
    columns = open_log(path)
    assert not columns.clocks
    assert columns.read([0]).numbers[:, 0].tolist() == [float(DECIMAL[make](k)) for k in range(400)]


@pytest.mark.parametrize(
    "values",
    [
        [4 - 0.125 * k for k in range(32)],  # 3.5, 3.25, 3.125: falls, as a place may
        [abs(8 - 0.25 * (k % 64)) for k in range(400)],
        [10 + 5 * np.sin(k / 9) for k in range(400)],
    ],
)
def test_places_are_no_times(tmp_path, values):
    lines = [f"{k},{x:.9g}" for k, x in enumerate(values)]
    assert not open_log(write(tmp_path / "log.csv", "t,x", lines)).clocks
