"""Paths timed within limits."""

import numpy as np
import pytest

from softmap_edge.robot.motion.figures import even, figure
from softmap_edge.robot.motion.timing import timed

SLEW, ACCELERATION = [2000.0, 1500.0], [20_000.0, 15_000.0]


def driven(ticks, duration, rate=1000.0):
    """Return times, ticks, and the largest share of slew and acceleration at a fine rate."""
    profile = timed(ticks, SLEW, ACCELERATION, duration)
    t = np.arange(0.0, profile.t[-1], 1.0 / rate)
    along = np.linspace(0.0, 1.0, len(ticks))
    q = np.stack([np.interp(profile.at(t), along, column) for column in ticks.T], axis=1)
    speed = np.abs(np.diff(q, axis=0)) * rate
    # Over windows of 20 ms: a polyline has corners between its points.
    slow = np.diff(q[::20], n=2, axis=0) * (rate / 20) ** 2
    return profile, (speed / SLEW).max(), (np.abs(slow) / ACCELERATION).max()


@pytest.mark.parametrize("name", ["S", "H", "O", "eight"])
def test_no_limit_is_passed_and_the_quickest_is_near_one_of_them(name):
    ticks = even(figure(name, 1500.0), 2000)
    profile, speed, push = driven(ticks, 0.0)
    assert speed <= 0.81 and push <= 1.0
    assert max(speed, push) > 0.35
    assert profile.t[-1] == profile.quickest


def test_a_longer_duration_is_kept_and_a_shorter_one_is_not_possible():
    ticks = even(figure("O", 1500.0), 1000)
    quickest = timed(ticks, SLEW, ACCELERATION, 0.0).quickest
    assert timed(ticks, SLEW, ACCELERATION, 3 * quickest).t[-1] == pytest.approx(3 * quickest)
    assert timed(ticks, SLEW, ACCELERATION, 0.5 * quickest).t[-1] == pytest.approx(quickest)


def test_corners_are_taken_slowly_and_a_path_that_stands_takes_no_time():
    ticks = even(np.array([(0.0, 0.0), (1000.0, 0.0), (1000.0, 1000.0)]), 401)
    profile = timed(ticks, SLEW, ACCELERATION, 0.0)
    pace = 1.0 / np.diff(profile.t)
    assert pace[200] < 0.15 * pace.max() and pace[0] < 0.15 * pace.max()
    assert timed(np.zeros((10, 2)), SLEW, ACCELERATION, 2.0).t[-1] == pytest.approx(2.0)
