"""Motion while the commands stand: hum and fast bending are found with size, frequency and channel,
noise is not.
"""

import numpy as np
import pytest
from bending import at, record, shape, tour, visits, wander

from softmap_edge.noise.jitter import commanded_modes
from softmap_edge.noise.motion_at_rest import motion_at_rest
from softmap_edge.noise.noise_model import measure_noise
from softmap_edge.noise.repeats import settled_dwells
from softmap_edge.run.conditions import conditions


def run(seed, acting, white=0.1):
    """A tour with effective commands `acting(t_seen, command, rng)`; features, prediction,
    conditions.
    """
    rng = np.random.default_rng(seed)
    t, command, seen = visits(tour(rng, 5), rng)
    u = at(t, command, seen)
    truth, own = shape(acting(seen, u, rng)), shape(u)
    points = truth + white * rng.normal(size=truth.shape)
    state = conditions(record(t, command, seen), command)
    return points.reshape(len(seen), -1), own.reshape(len(seen), -1), state, truth - own


def found(seen, own, state):
    positions, modes = np.ones(8, bool), commanded_modes(seen, state.command)
    dwell = settled_dwells(state)
    return motion_at_rest(seen - own, seen, positions, state.time, state.command, dwell, modes)


def hum(channel, size, frequency):
    def acting(t, u, rng):
        out = u.copy()
        out[:, channel] += size * np.sin(2 * np.pi * frequency * t + 0.7)
        return out

    return acting


@pytest.mark.parametrize(
    ("channel", "size", "frequency"), [(0, 0.6, 0.13), (1, 0.3, 0.9), (0, 0.5, 3.7)]
)
def test_a_hum_is_found_with_size_frequency_and_channel(channel, size, frequency):
    seen, own, state, moved = run(1, hum(channel, size, frequency))
    motion = found(seen, own, state).found
    assert len(motion) == 1 and motion[0].frequency_hz == pytest.approx(frequency, abs=0.01)
    rest = settled_dwells(state) >= 0
    true = np.sqrt(np.mean(np.sum(moved[rest] ** 2, axis=2)))
    assert motion[0].rms_mm == pytest.approx(true, rel=0.25)  # its shape differs between poses
    assert np.argmax(motion[0].channels) == channel
    # of one slope for all poses
    assert motion[0].channels[channel] == pytest.approx(size / np.sqrt(2), rel=0.4)
    assert f"at {frequency:.2g} Hz, as channel {channel} would move it" in str(motion[0])


def test_fast_bending_is_found_and_is_no_noise():
    def bends(t, u, rng):
        return u + [0.4, 0.0] * rng.normal(size=(len(t), 1))

    seen, own, state, moved = run(2, bends)
    motion = found(seen, own, state)
    assert [m.frequency_hz for m in motion.found] == [None] and motion.irregular
    true = np.sqrt(np.mean(np.sum(moved**2, axis=2)))
    assert (
        motion.found[0].rms_mm == pytest.approx(true, rel=0.3)
        and np.argmax(motion.found[0].channels) == 0
    )
    noise = measure_noise(seen - own, seen, np.ones(8, bool), state.time, state)
    assert noise.moving == motion.found
    # 0.5 mm with the bending
    assert noise.rms_mm(np.ones(8, bool)) == pytest.approx(0.1 * np.sqrt(3), rel=0.1)


def test_a_hum_does_not_count_as_noise():
    seen, own, state, _ = run(4, hum(0, 0.6, 0.4))
    noise = measure_noise(seen - own, seen, np.ones(8, bool), state.time, state)
    assert noise.rms_mm(np.ones(8, bool)) == pytest.approx(0.1 * np.sqrt(3), rel=0.1)
    assert len(noise.moving) == 1


def play(t, u, rng):
    y = u.copy()
    for k in range(1, len(u)):
        y[k] = np.clip(y[k - 1], u[k] - 0.8, u[k] + 0.8)
    return y


def creep(t, u, rng):
    slow = np.zeros_like(u)
    for k in range(1, len(u)):
        slow[k] = slow[k - 1] + (u[k] - slow[k - 1]) * min(1.0, (t[k] - t[k - 1]) / 6.0)
    return 0.8 * u + 0.2 * slow


def slow_wander(t, u, rng):
    return u + [0.6, 0.0] * wander(t, 60.0, rng)


@pytest.mark.parametrize("acting", [lambda t, u, rng: u, play, creep, slow_wander])
def test_noise_and_memory_are_no_motion_at_rest(acting):
    counts = [len(found(*run(seed, acting)[:3]).found) for seed in range(12)]
    assert sum(counts) == 0, counts
