"""Places that repeat to the last digit: old pictures where noise or a beat shows it, else a finger
at rest.
"""

import numpy as np
import pytest
from lost_markers import BUT_ALSO, GOOD, SINES, STAIRS, K, T, body

from softmap_edge.logs.chance import is_improbable
from softmap_edge.logs.held import repeated_frames
from softmap_edge.logs.not_seen import not_seen

REST = np.clip(SINES, 0, None)
SLOWLY = np.c_[0.05 * np.arange(K), 0 * T]
RESTING = {
    "whole millimetres": (body(REST, digits=0), REST),
    "whole millimetres on stairs": (body(STAIRS, digits=0), STAIRS),
    "tenths": (body(REST, noise=0.01, digits=1), REST),
    "tenths on stairs": (body(STAIRS, noise=0.03, digits=1), STAIRS),
    "tenths without noise": (body(REST, noise=0, digits=1), REST),
    "a marker at the origin": (
        np.concatenate([np.zeros((K, 1, 3)), body(REST, noise=0.02, digits=1)], axis=1),
        REST,
    ),
    "a plane": (body(REST, noise=0.01, digits=1) * [1, 0, 1], REST),
    "all digits without noise": (body(REST, noise=0, digits=None), REST),
    "slowly": (body(SLOWLY, count=1, noise=0, digits=0), SLOWLY),
    "moving in whole millimetres": (body(SINES, digits=0), SINES),
}


@pytest.mark.parametrize("name", list(RESTING))
def test_repeats_of_a_resting_or_coarse_finger_stay(name):
    points, u = RESTING[name]
    held, still = repeated_frames(T, points)
    assert (points[1:] == points[:-1]).all(axis=(1, 2)).sum() > 1, (
        "nothing repeats: this tests nothing"
    )
    assert not held.any() and not still.any() and not not_seen(points, u).mask.any()


def test_digits_that_flicker_at_random_have_no_beat():
    """Millimetres without decimals, on stairs: places near a half flicker, and most rows repeat."""
    for seed in range(60):
        held, _ = repeated_frames(T, body(STAIRS, digits=0, seed=seed))
        assert not held.any(), seed


SLOW = {
    "every second row": (np.arange(K) // 2 * 2, 0.05, 3),
    "every third row without noise": (np.arange(K) // 3 * 3, 0.0, 3),
    "every second row, tenths": (np.arange(K) // 2 * 2, 0.05, 1),
    "30 pictures in 50 rows": (
        np.floor(np.floor(np.arange(K) * 0.6) / 0.6 + 0.999).astype(int),
        0.05,
        3,
    ),
    "here and there": (np.arange(K) - np.isin(np.arange(K) % 23, (7, 20)), 0.05, 3),
    "three in a row": (np.arange(K) - np.maximum(np.arange(K) % 40 - 36, 0), 0.05, 2),
}


@pytest.mark.parametrize("name", list(SLOW))
def test_old_pictures_are_left_out(name):
    rows, noise, digits = SLOW[name]
    points = body(SINES, noise=noise, digits=digits)[rows]
    held, _ = repeated_frames(T * 0.4, points)
    assert np.array_equal(held, np.r_[False, np.diff(rows) == 0])


@pytest.mark.parametrize(
    "u", [SINES, STAIRS, 0.2 * SINES, REST], ids=["moving", "stairs", "slowly", "resting"]
)
@pytest.mark.parametrize(("noise", "digits"), [(0.05, 3), (0.3, 2), (0.002, 5), (0.01, None)])
def test_every_stale_frame_of_one_marker_counts_where_noise_shows_it(u, noise, digits):
    points = body(u, noise=noise, digits=digits)
    stale = np.arange(21, K - 20, 20)
    points[stale, 1] = points[stale - 1, 1]
    points[200:204, 2] = points[199, 2]
    expected = np.zeros(points.shape[:2], bool)
    expected[stale, 1] = True
    expected[200:204, 2] = True
    assert np.array_equal(not_seen(points, u).mask, expected)
    assert np.array_equal(not_seen(points).mask, expected)


@pytest.mark.parametrize("name", [name for name in [*GOOD, *BUT_ALSO] if "full pulls" not in name])
def test_noise_is_distinguished_from_motion(name):
    points, _ = (GOOD | BUT_ALSO)[name]
    noisy = name in (
        "noise",
        "stairs",
        "no commands",
        "one marker",
        "a clamp marker at the origin",
        "a slow camera",
    )
    assert is_improbable(points.reshape(K, -1)) == noisy
