"""A gesture lets go, or is required in addition to the key; it never replaces the key."""

import itertools
from typing import get_args

import numpy as np
import pytest
from hands import hand, turned

from softmap_edge.errors import TeleopError
from softmap_edge.robot.teleop.gesture import CLOSED, DWELL, GAP, OPEN, Deadman, Rule, openness

PALM, FIST, BETWEEN = hand(), hand(folded=0.95), hand(folded=0.5)
RULES = get_args(Rule)


def played(rule, steps, dt=1 / 30):
    deadman = Deadman(rule)
    return [deadman.held(key, seen, k * dt) for k, (key, seen) in enumerate(steps)]


def test_openness_is_that_of_the_fingers_that_do_not_drive():
    assert openness(PALM) > OPEN and openness(FIST) < CLOSED and CLOSED < openness(BETWEEN) < OPEN
    curled = hand(curl=0.9)
    assert openness(curled) == pytest.approx(openness(PALM))
    assert openness(turned(FIST, 70, 2.0)) == pytest.approx(openness(FIST))
    points = PALM.points.copy()
    points[9] = points[0]
    assert openness(type(PALM)(points, "right")) is None


@pytest.mark.parametrize("rule", RULES)
def test_without_the_key_nothing_is_ever_held(rule):
    rng = np.random.default_rng(0)
    shown = [None, PALM, FIST, BETWEEN]
    for _ in range(20):
        keys, seen = rng.random(100) < 0.5, rng.integers(4, size=100)
        held = played(rule, [(bool(key), shown[k]) for key, k in zip(keys, seen)])
        assert not np.any(np.array(held) & ~keys)
    assert not any(played(rule, itertools.product([False], shown * 30)))


def test_the_key_alone_asks_for_no_hand():
    assert played("key", [(True, None), (True, FIST), (False, PALM)]) == [True, True, False]


def test_a_fist_lets_go_at_once_until_the_key_is_pressed_again():
    steps = [
        (True, None),
        (True, PALM),
        (True, FIST),
        (True, PALM),
        (True, None),
        (False, PALM),
        (True, PALM),
    ]
    assert played("fist releases", steps) == [True, True, False, False, False, False, True]
    assert played("fist releases", [(True, PALM), (True, BETWEEN), (True, PALM)]) == [True] * 3
    assert (
        played("fist releases", [(True, FIST), (True, BETWEEN), (False, BETWEEN), (True, BETWEEN)])[
            -1
        ]
        is False
    )


@pytest.mark.parametrize(
    ("rule", "shown", "other"), [("open palm", PALM, FIST), ("fist", FIST, PALM)]
)
def test_an_asked_gesture_must_last_and_ends_at_once(rule, shown, other):
    wait = round(DWELL * 30)
    held = played(rule, [(True, shown)] * (wait + 3))
    assert held[: wait - 1] == [False] * (wait - 1) and held[-1]
    after = played(rule, [(True, shown)] * (wait + 3) + [(True, other), (True, shown)])
    assert after[-2:] == [False, False]
    assert played(rule, [(True, shown)] * (wait + 3) + [(True, None)])[-1] is False
    assert played(rule, [(True, shown)] * (wait + 3) + [(True, BETWEEN)])[-1] is True  # hysteresis
    # never shown, never taken for granted
    assert not any(played(rule, [(True, BETWEEN)] * (wait + 3)))


@pytest.mark.parametrize("jump", [GAP + 0.01, -0.01, -1e6])
def test_a_gap_or_a_clock_that_goes_back_asks_again(jump):
    deadman = Deadman("open palm")
    assert [deadman.held(True, PALM, k * 0.1) for k in range(4)][-1]
    assert not deadman.held(True, PALM, 0.3 + jump)
    assert deadman.held(True, PALM, 0.3 + jump + 0.25)


def test_a_flickering_finger_between_the_thresholds_changes_nothing():
    rng = np.random.default_rng(0)
    middle = 0.9 - (OPEN + CLOSED) / 2
    shaking = [(True, hand(folded=middle + rng.uniform(-0.1, 0.1))) for _ in range(100)]
    assert all(played("fist releases", [(True, PALM), *shaking]))


def test_no_such_rule():
    with pytest.raises(TeleopError, match="there are key, fist releases, open palm, fist"):
        Deadman("wave")
