"""The floor of models without memory: half a loop, whatever map is fitted; for noise alone it is
the noise.
"""

from dataclasses import fields, replace

import numpy as np
import pytest
from bending import at, record, shape

from softmap_edge.noise.memoryless import repeats_of
from softmap_edge.run.conditions import conditions


def sines(play, noise, seed=0, channels=2, gravity=None):
    """Sines of growing size on one channel, the other at rest: every command is repeated in both
    directions.
    """
    t = np.arange(0.0, 120.0, 0.02)
    u = np.zeros((len(t), channels))
    u[:, 0] = (4.0 + 6.0 * t / 120.0) * np.sin(2 * np.pi * t / 8.0)
    y = u.copy()
    for k in range(1, len(u)):
        y[k] = np.clip(y[k - 1], u[k] - play / 2, u[k] + play / 2)
    seen = np.arange(1.0, 119.0, 0.15)
    rng = np.random.default_rng(seed)
    points = shape(at(t, y, seen)[:, :2]) + noise * rng.normal(size=(len(seen), 8, 3))
    state = conditions(record(t, u, seen, gravity=gravity), u)
    return points.reshape(len(seen), -1), state


def best_static(values, command, degree=15):
    """The error of the best polynomial of the first command, fitted to the same frames: RMS mm."""
    x = command[:, 0] / np.abs(command[:, 0]).max()
    basis = np.polynomial.legendre.legvander(x, degree)
    left = values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
    return float(np.sqrt(np.mean(np.sum(left.reshape(len(left), -1, 3) ** 2, axis=2))))


@pytest.mark.parametrize("play", [0.8, 2.5])
def test_no_static_map_goes_below_the_floor_and_a_rich_one_reaches_it(play):
    values, state = sines(play, 0.1)
    found = repeats_of(values, state)
    reached = best_static(values, state.command)
    assert found.mm == pytest.approx(reached, rel=0.12)
    assert found.mm > 3 * 0.1 * np.sqrt(3)
    assert (
        found.poses > 20 and found.passages > 2 * found.poses - 1 and len(found.rows) <= len(values)
    )


def test_without_memory_the_floor_is_the_noise():
    for seed in range(3):
        values, state = sines(0.0, 0.2, seed)
        assert repeats_of(values, state).mm == pytest.approx(0.2 * np.sqrt(3), rel=0.12)


def test_points_that_are_hidden_do_not_count():
    values, state = sines(1.5, 0.1)
    whole = repeats_of(values, state).mm
    values[np.random.default_rng(1).random(len(values)) < 0.3, :3] = np.nan
    assert repeats_of(values, state).mm == pytest.approx(whole, rel=0.05)


def test_another_orientation_is_another_pose():
    t = np.arange(0.0, 120.0, 0.02)
    gravity = np.where((t < 60.0)[:, None], [0.0, 0.0, 1.0], [0.6, 0.0, 0.8])
    values, state = sines(0.0, 0.1, gravity=gravity)
    values = values + 3.0 * state.gravity[:, :1]  # a function of the orientation is no memory
    assert repeats_of(values, state).mm < 0.3


def test_commands_that_never_meet_again_show_nothing():
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 60.0, 0.02)
    u = np.cumsum(rng.normal(size=(len(t), 6)), axis=0)
    seen = np.arange(1.0, 59.0, 0.2)
    state = conditions(record(t, u, seen), u)
    assert repeats_of(rng.normal(size=(len(seen), 9)), state) is None


@pytest.mark.parametrize("play", [0.8, 2.5])
def test_no_static_map_undercuts_the_lowest_error_on_the_frames_of_repeated_poses(play):
    """Few passages of a pose scatter less about their own mean than further visits would."""
    values, state = sines(play, 0.1)
    few = np.arange(len(values)) < 0.45 * len(values)
    for frames in (np.flatnonzero(few), np.arange(len(values))):
        part = replace(
            state,
            **{
                field.name: value[frames]
                for field in fields(state)
                if isinstance(value := getattr(state, field.name), np.ndarray)
                and len(value) == len(values)
            },
        )
        found = repeats_of(values[frames], part)
        x = part.command[:, 0] / np.abs(part.command[:, 0]).max()
        basis = np.polynomial.legendre.legvander(x, 15)
        left = (
            values[frames]
            - basis @ np.linalg.lstsq(basis[found.rows], values[frames][found.rows], rcond=None)[0]
        )[found.rows]
        reached = float(np.sqrt(np.mean(np.sum(left.reshape(len(left), -1, 3) ** 2, axis=2))))
        assert 0.8 * reached < found.lowest_mm < 1.005 * reached
        assert found.lowest_mm < found.mm
