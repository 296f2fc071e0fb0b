"""A log without time: what depends on rates is not testable, and nothing is called latency."""

import re

import numpy as np
import pytest
from logs import fault, imported

from softmap_edge import Run, diagnose, learn_model
from softmap_edge.checks.summary import summary
from softmap_edge.checks.summary_text import sentences

COUNT = 500


def moves(seed):
    phase, s = np.random.default_rng(seed).uniform(0, 6, 2), 0.05 * np.arange(COUNT)
    pairs = ((0.31, phase[0], 0.05), (0.23, phase[1], 0.04))
    return np.stack(
        [8 * np.sin(6.283 * f * s + p) * (0.6 + 0.4 * np.sin(6.283 * g * s)) for f, p, g in pairs],
        axis=1,
    )


def run(seed, late=0, timeless=True):
    """Three markers of a body that bends, `late` rows after its commands."""
    u = moves(seed)
    acted = np.vstack([np.repeat(u[:1], late, axis=0), u[: COUNT - late]])
    places = []
    for z in (40.0, 80.0, 120.0):
        k = z / 120
        bend = 3 * k**2 * acted + 0.02 * k * acted[:, :1] * acted[:, ::-1]
        places.append(np.column_stack([bend, z - 0.05 * k * (acted**2).sum(axis=1)]))
    seen = np.stack(places, axis=1) + np.random.default_rng(seed + 9).normal(0, 0.1, (COUNT, 3, 3))
    t, block = 0.05 * np.arange(COUNT), np.arange(COUNT) * 5 // COUNT
    return Run(t=t, t_seen=t, command=u, markers=seen, block=block, timeless=timeless)


@pytest.fixture(scope="module")
def model():
    return learn_model(run(1))


def test_a_delay_in_rows_is_not_called_latency(model):
    found = diagnose(model, run(2, late=3))
    named = {effect.name for effect in found.effects}
    timed = {
        "latency",
        "lag",
        "rate_limit",
        "creep",
        "tendon_creep",
        "zero_drift",
        "clock_shift",
        "camera_drift",
    }
    assert not named & timed
    assert timed <= {one.name for one in found.not_testable if "no time" in one.why}
    assert any("the log has no time" in line for line in found.remarks)
    timely = diagnose(model, run(2, late=3, timeless=False))
    assert {effect.name for effect in timely.effects} & {"latency", "lag", "clock_shift"}


def test_check_says_what_a_log_without_time_cannot_identify():
    lines = sentences(summary(run(2)))
    assert any("no time recorded" in line for line in lines) and any(
        "the log has no time" in line for line in lines
    )
    assert not any("no time" in line for line in sentences(summary(run(2, timeless=False))))


LOG = """schema = "softmap.mapping/1"
[[log]]
time = "none"
command = { columns = ["a"] }
present = { columns = ["p"], held = "unhold" }
markers = { columns = [["x", "y", "z"], ["u", "v", "w"]], unit = "mm" }
"""


def rows(first):
    """A log of 300 rows whose encoder is read every third row; two markers change their names at
    row 100.
    """
    lines = [f"{first},a,p,x,y,z,u,v,w"]
    for k in range(300):
        one, two = [5 * np.sin(k / 20), 0.01 * k, 40.0], [9 * np.sin(k / 20), 0.02 * k, 90.0]
        held = 4 * np.sin((k - k % 3) / 20)
        cells = [0.04 * k, 4 * np.sin(k / 20), held, *(one + two if k < 100 else two + one)]
        lines.append(",".join(f"{x:.5f}" for x in cells))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("name", ["time", "Time [ms]", "t", "stamp", "millis"])
def test_an_unused_column_of_time_is_named_and_no_rate_is_claimed(tmp_path, name):
    found = imported(tmp_path, rows(name), LOG)
    assert found.run.timeless
    assert any(f"columns are called {name}" in doubt for doubt in found.doubts)
    said = " ".join([*found.notes, *found.doubts])
    assert "every 3 rows" in said and "change places at frame 100;" in said
    assert not re.search(r"\d (ms|s|Hz)\b", said)
    assert not any(
        "are called" in doubt for doubt in imported(tmp_path, rows("number"), LOG).doubts
    )


@pytest.mark.parametrize(
    "keys",
    [
        "[seen]\nrate_hz = 10",
        "[commands]\nrate_hz = 10",
        "[seen]\nfrom_s = 1.0",
        "[seen]\nto_s = 5",
        "[seen]\nfast_ppm = 80",
        "[seen]\nclock_step = [1, 0.2]",
        "[blocks]\nseconds = 5",
        "[constant]\nmarker_rest_s = [0, 1]",
    ],
)
def test_keys_in_seconds_are_refused_for_a_log_without_time(tmp_path, keys):
    table, key = keys.split("]\n")[0].lstrip("["), keys.split("\n")[1].split(" ")[0]
    assert f"{table}.{key} in a mapping with time" in fault(tmp_path, rows("n"), LOG + keys + "\n")
