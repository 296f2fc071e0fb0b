"""Markers on the base bound its position and its motion, with correct standard deviations."""

import numpy as np
import pytest

from softmap_edge import Run
from softmap_edge.diagnosis.base_motion import base_motion

PLACE = np.array([[40.0, 0, 2], [-20, 35, 0], [-20, -35, 1], [0, 50, -3]])


def turned(points, turn_deg, shift_mm):
    """Rotation by the exponential of a cross product, independent of the library: about the axis, by its length."""
    angle = np.radians(np.linalg.norm(turn_deg))
    axis = np.asarray(turn_deg) / max(np.linalg.norm(turn_deg), 1e-12)
    cross = np.cross(np.eye(3), axis)
    matrix = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return points @ matrix.T + shift_mm


def run(turn=(0, 0, 0), shift=(0, 0, 0), noise=0.1, frames=200, seed=0, drift=0.0, place=PLACE):
    rng = np.random.default_rng(seed)
    t = np.arange(frames) * 0.1
    base = np.repeat(turned(place, turn, np.asarray(shift, float))[None], frames, axis=0)
    base = base + drift * (t / t[-1])[:, None, None] * np.array([1.0, 0, 0]) + noise * rng.normal(size=base.shape)
    markers = 50.0 * rng.normal(size=(frames, 3, 3))
    return Run(t=t, command=np.zeros((frames, 1)), t_seen=t, markers=markers, extra={"base_markers": base})


def test_a_misaligned_base_is_measured_against_another_run():
    found = base_motion(run((1.5, 0, -0.5), (0.8, 0, 2.0)), run(seed=1))
    assert np.array(found.turn_deg) == pytest.approx([1.5, 0, -0.5], abs=0.1)
    assert np.array(found.shift_mm) == pytest.approx([0.8, 0, 2.0], abs=0.1)
    assert found.moved_mm < 0.05 and found.turned_deg < 0.05
    assert found.allows([0.8, 0, 2.0], [1.5, 0, -0.5]) and not found.allows([0, 0, 0], [0, 0, 0])


def test_a_base_that_stands_excludes_a_turn():
    """Runs of one day: a mount turned by 1.8° contradicts base markers that show 0.0 ± 0.05°."""
    found = base_motion(run(seed=2), run(seed=3))
    assert found.allows([0, 0, 0], [0, 0, 0]) and not found.allows([0, 0, 0], [1.8, 0, 0])


def test_standard_deviations_are_those_of_repetition():
    scores = []
    for seed in range(60):
        one = base_motion(run(seed=2 * seed), run(seed=2 * seed + 1))
        scores.append(np.r_[one.shift_mm, one.turn_deg] / np.r_[one.shift_sigma_mm, one.turn_sigma_deg])
    # white noise: 200 frames count as 20, so the stated deviation is wide, never narrow
    assert 0.1 < np.std(scores) < 1.0


def test_drift_of_the_base_is_motion_and_noise_is_not():
    assert base_motion(run(drift=1.0)).moved_mm == pytest.approx(1.0 / np.sqrt(12), rel=0.15)
    assert base_motion(run()).moved_mm < 0.03


def test_what_does_not_show_a_turn_is_none():
    line = np.array([[0.0, 0, 0], [30, 0, 0], [60, 0.5, 0]])
    assert base_motion(run(place=line)) is None and base_motion(run(place=PLACE[:2])) is None
    assert base_motion(run(frames=5)) is None and base_motion(run(), run(place=PLACE[:3])) is None
    bare = Run(
        t=np.arange(10.0), command=np.zeros((10, 1)), t_seen=np.arange(10.0), markers=np.ones((10, 2, 3)) * [[0], [9.0]]
    )
    assert base_motion(bare) is None
