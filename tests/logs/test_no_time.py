"""A log without time: what depends on rates is not testable, and nothing is called latency."""

import numpy as np
import pytest

from softmap_edge import Run, diagnose, learn_model
from softmap_edge.checks.summary import sentences, summary

COUNT = 500


def moves(seed):
    phase, s = np.random.default_rng(seed).uniform(0, 6, 2), 0.05 * np.arange(COUNT)
    pairs = ((0.31, phase[0], 0.05), (0.23, phase[1], 0.04))
    return np.stack([8 * np.sin(6.283 * f * s + p) * (0.6 + 0.4 * np.sin(6.283 * g * s)) for f, p, g in pairs], axis=1)


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
    timed = {"latency", "lag", "rate_limit", "creep", "tendon_creep", "zero_drift", "clock_shift", "camera_drift"}
    assert not named & timed
    assert timed <= {one.name for one in found.not_testable if "no time" in one.why}
    assert any("the log has no time" in line for line in found.remarks)
    timely = diagnose(model, run(2, late=3, timeless=False))
    assert {effect.name for effect in timely.effects} & {"latency", "lag", "clock_shift"}


def test_check_says_what_a_log_without_time_cannot_identify():
    lines = sentences(summary(run(2)))
    assert any("no time recorded" in line for line in lines) and any("the log has no time" in line for line in lines)
    assert not any("no time" in line for line in sentences(summary(run(2, timeless=False))))
