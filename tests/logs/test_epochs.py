"""Integer counts of time are read from the epoch that gives a plausible date, or are UNKNOWN."""

import numpy as np
import pytest

from softmap_edge.logs.epochs import readings_of
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping

ROWS = 60
U = np.stack([8 * np.sin(0.05 * np.arange(ROWS)), 5 * np.sin(0.09 * np.arange(ROWS))], axis=1)


def log(folder, start, step, name="time"):
    lines = [f"{name},u1,u2,m_x,m_y,m_z"]
    for k, (a, b) in enumerate(U):
        lines.append(f"{start + k * step},{a:.4f},{b:.4f},{3 * a:.4f},{3 * b:.4f},{100 + a:.4f}")
    (folder / "log.csv").write_text("\n".join(lines) + "\n", "utf-8")
    return folder / "log.csv"


@pytest.mark.parametrize(
    ("start", "step", "unit", "says"),
    [
        (133_700_000_000_000_000, 500_000, "100ns", "since 1601"),
        (131_000_000_000_000_000, 500_000, "100ns", "since 1601"),
        (638_700_000_000_000_000, 500_000, "100ns", "since year 1"),
        (640_000_000_000_000_000, 100_000, "100ns", "since year 1"),
        (1_700_000_000_000_000_000, 50_000_000, "ns", "ns since 1970"),
        (1_700_000_000_000_000, 50_000, "us", "us since 1970"),
        (1_700_000_000_000, 50, "ms", "ms since 1970"),
        (1_700_000_000, 1, "s", "s since 1970"),
    ],
)
def test_counts_of_a_plausible_date_are_read_from_its_epoch(tmp_path, start, step, unit, says):
    path = log(tmp_path, start, step)
    found = guess_mapping([path])
    assert f'unit = "{unit}"' in found.text
    assert any(says in line for line in found.assumed if line.startswith("time of"))
    assert not any("is not a date" in line for line in found.unknown)
    run = import_logs([path], parse_mapping(found.text, path)).run
    seconds = {"100ns": 1e-7, "ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0}[unit]
    assert np.diff(run.t) == pytest.approx(step * seconds, rel=1e-3)


@pytest.mark.parametrize(
    ("start", "step"),
    [
        (300_000_000_000_000_000, 50_000_000),
        (9_000_000_000_000_000_000, 50_000_000),
        (8_000_000_000_000_000, 50_000),
    ],
)
def test_counts_without_a_plausible_date_are_unknown(tmp_path, start, step):
    found = guess_mapping([log(tmp_path, start, step)])
    assert any("is not a date from 1990 to 2100" in line for line in found.unknown)
    assert not any("since 1970" in line for line in found.assumed)


@pytest.mark.parametrize(("start", "step"), [(0, 50), (5_000_000_000_000, 50_000_000), (7, 1)])
def test_counts_since_the_start_stay_without_a_date(tmp_path, start, step):
    found = guess_mapping([log(tmp_path, start, step)])
    assert not any("is not a date" in line for line in found.unknown)
    assert not any("since" in line for line in found.assumed)


def test_a_date_of_1990_in_ns_is_not_read_for_ticks():
    known = 638.7e15 + 5e5 * np.arange(20)
    assert [one.unit for one in readings_of(known, 5e5)] == ["100ns"]
