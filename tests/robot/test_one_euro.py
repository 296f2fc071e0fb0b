"""The one-euro filter: its recursion, its limits, and clocks that do not run as they should."""

import math

import numpy as np
import pytest

from softmap_edge.errors import TeleopError
from softmap_edge.robot.teleop.one_euro import OneEuro


def filtered(t, x, one_euro=None):
    state, out = None, []
    for when, what in zip(t, x):
        state = (one_euro or OneEuro()).step(state, when, what)
        out.append(state.x)
    return np.array(out)


def by_the_paper(t, x, min_cutoff, beta):
    """Algorithm 1 and 2 of Casiez et al., scalar, written apart."""

    def alpha(dt, cutoff):
        tau = 1 / (2 * math.pi * cutoff)
        return 1 / (1 + tau / dt)

    previous, slope, out = x[0], 0.0, [x[0]]
    for k in range(1, len(x)):
        dt = t[k] - t[k - 1]
        a = alpha(dt, 1.0)
        slope = a * (x[k] - previous) / dt + (1 - a) * slope
        a = alpha(dt, min_cutoff + beta * abs(slope))
        previous = a * x[k] + (1 - a) * previous
        out.append(previous)
    return np.array(out)


def test_it_is_the_published_recursion():
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.005, 0.1, 300))  # irregular
    x = np.cumsum(rng.normal(size=(300, 2)), axis=0)
    wanted = np.column_stack([by_the_paper(t, x[:, k], 1.5, 5.0) for k in range(2)])
    np.testing.assert_allclose(filtered(t, x), wanted, rtol=1e-12, atol=1e-12)


def test_still_hands_are_stilled_and_moving_ones_do_not_lag():
    rng = np.random.default_rng(0)
    t = np.arange(600) / 30
    noise = 0.005 * rng.normal(size=(600, 1))
    out = filtered(t, noise)
    assert np.std(out[30:]) < 0.6 * np.std(noise[30:])
    # a filter that lets all through
    assert np.std(filtered(t, noise, OneEuro(1e9))[30:]) > 0.99 * np.std(noise[30:])
    ramp = 2.0 * t[:, None]  # two hand scales a second
    behind = (ramp - filtered(t, ramp))[60:] / 2.0  # s
    assert 0 < behind.max() < 1 / 30
    assert (ramp - filtered(t, ramp, OneEuro(beta=0.0)))[60:].max() / 2.0 > 0.08  # what beta is for


def test_gaps_and_clocks():
    one = OneEuro(gap=0.5)
    state = one.step(one.step(None, 10.0, [0.0, 1.0]), 10.03, [0.1, 1.0])
    assert one.step(state, 10.03, [5.0, 5.0]) is state  # the same time again
    assert one.step(state, 9.99, [5.0, 5.0]) is state  # a late sample
    for t in (10.54, 9.0, -1e9, 1e12):  # a gap, and a clock that was set
        anew = one.step(state, t, [5.0, 5.0])
        assert anew.t == t and anew.x.tolist() == [5.0, 5.0] and anew.speed.tolist() == [0.0, 0.0]
    assert 0 < one.step(state, 10.06, [5.0, 5.0]).x[0] < 5.0


def test_it_never_leaves_what_was_seen_nor_gives_nan():
    rng = np.random.default_rng(1)
    for _ in range(50):
        t = np.cumsum(10.0 ** rng.uniform(-9, -0.5, 100)) * rng.choice([1, 1e3])
        x = rng.choice([-1.0, 1.0, 1e-300, 1e100], (100, 1))
        out = filtered(t, x)
        assert np.isfinite(out).all() and (out >= -1.0).all() and (out <= 1e100).all()


@pytest.mark.parametrize(
    "bad", [(math.nan, [0.0]), (1.0, [math.nan]), (1.0, [math.inf]), (1.0, [0.0, 0.0])]
)
def test_bad_samples_are_refused(bad):
    one = OneEuro()
    state = one.step(None, 0.9, [0.0])
    with pytest.raises(TeleopError, match="one-euro filter"):
        one.step(state, *bad)


@pytest.mark.parametrize(
    "bad", [(0.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, 0.0), (math.nan, 1.0, 1.0)]
)
def test_bad_settings_are_refused(bad):
    with pytest.raises(TeleopError, match="min_cutoff > 0 Hz"):
        OneEuro(*bad)
