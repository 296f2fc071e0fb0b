"""Jitter of the frame with a memory: its covariance and memory are recovered, effects of the drive
are not jitter.
"""

from itertools import product

import numpy as np
import pytest
from bending import at, record, shaken, shape, tour, visits, wander

from softmap_edge.noise.jitter import frame_jitter, rigid, white_variance
from softmap_edge.noise.noise_model import command_kernel, measure_noise, whitener
from softmap_edge.noise.repeats import dwell_scatter, settled_dwells
from softmap_edge.noise.shape_manifold import shapes
from softmap_edge.run.conditions import conditions

WHITE = 0.1  # mm a coordinate


def seen_by(seed, turn=0.0, shift=0.0, memory=8.0, acting=None, trend=0.0, rounds=6):
    """A tour seen by a camera whose frame jitters: features (K, F), prediction (K, F),
    conditions.
    """
    rng = np.random.default_rng(seed)
    t, command, seen = visits(tour(rng, rounds), rng)
    u = command if acting is None else acting(t, command)
    truth, own = shape(at(t, u, seen)), shape(at(t, command, seen))
    state = wander(seen, memory, rng, 6) + trend * ((seen - seen[0]) / np.ptp(seen))[:, None]
    points = shaken(
        truth, np.radians(turn) * state[:, :3], shift * state[:, 3:]
    ) + WHITE * rng.normal(size=truth.shape)
    flat = (len(seen), -1)
    return points.reshape(flat), own.reshape(flat), conditions(record(t, command, seen), command)


def found(seen, own, state):
    positions, dwell = np.ones(seen.shape[1] // 3, bool), settled_dwells(state)
    body = shapes(seen, state, dwell)
    white = white_variance(seen - own, seen, positions, body.tangents, dwell)
    return frame_jitter(body.remainder, seen, positions, state, dwell, body.tangents, white), white


def play(t, u, w=0.8):
    y = np.zeros_like(u)
    for k in range(1, len(u)):
        y[k] = np.clip(y[k - 1], u[k] - w, u[k] + w)
    return y


def wide_play(t, u):
    """Half of the range is lost."""
    return play(t, u, 4.0)


def creep(t, u):
    slow = np.zeros_like(u)
    for k in range(1, len(u)):
        slow[k] = slow[k - 1] + (u[k] - slow[k - 1]) * (t[k] - t[k - 1]) / 15.0
    return 0.8 * u + 0.2 * slow


def hysteresis(t, u):
    """A spring that yields by halves, next to the drive."""
    yielded = np.zeros_like(u)
    for k in range(1, len(u)):
        step = u[k] - u[k - 1]
        yielded[k] = yielded[k - 1] + step - 0.5 * np.abs(step) * yielded[k - 1]
    return u + 3.0 * yielded


def test_rigid_motion_is_what_small_turns_and_shifts_do():
    rng = np.random.default_rng(0)
    points = 30 * rng.normal(size=(5, 4, 3))
    turns, shifts = 1e-5 * rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    moved = (shaken(points, turns, shifts) - points).reshape(5, -1)
    columns = rigid(points.reshape(5, -1), np.ones(4, bool))
    np.testing.assert_allclose(
        np.einsum("kfi,ki->kf", columns, np.c_[turns, shifts]), moved, atol=1e-12
    )
    directions = rigid(points.reshape(5, -1), np.zeros(4, bool))
    assert not directions[:, :, 3:].any() and np.array_equal(
        directions[:, :, :3], columns[:, :, :3]
    )


@pytest.mark.parametrize("memory", [2.5, 10.0])
def test_size_and_memory_of_a_jitter_come_back(memory):
    sizes, memories = [], []
    for seed in range(6):
        jitter, white = found(*seen_by(seed, 0.25, 0.3, memory))
        sizes.append(np.diag(jitter.covariance))
        memories.append(jitter.memory_s)
        assert np.sqrt(white.mean()) == pytest.approx(WHITE, rel=0.1)
    turn, shift = np.sqrt(np.mean(sizes, axis=0)).reshape(2, 3)
    # 30 visits of 6 s, six runs: about 100 independent numbers an axis, 10 % in size
    assert np.degrees(turn) == pytest.approx(np.full(3, 0.25), rel=0.35)
    assert shift == pytest.approx(np.full(3, 0.3), rel=0.35)
    assert 0.5 * memory <= np.median(memories) <= 2.0 * memory


def test_no_jitter_is_none_nearly_always():
    hits = [found(*seen_by(seed))[0] for seed in range(20)]
    assert sum(h is not None for h in hits) <= 1


def noise_of(seen, own, state, markers):
    """Return the RMS noise in mm of some of the markers, and their memory in s."""
    kept = (3 * np.array(markers)[:, None] + np.arange(3)).ravel()
    positions, seen, own = np.ones(len(markers), bool), seen[:, kept], own[:, kept]
    noise = measure_noise(seen - own, seen, positions, state.time, state)
    return noise.rms_mm(positions), noise.memory_s


FEW = {"eight": range(8), "four": (1, 3, 5, 7), "three": (2, 5, 7)}


@pytest.mark.parametrize("markers", FEW)
@pytest.mark.parametrize("acting", [play, wide_play, creep, hysteresis])
def test_memory_of_the_drive_is_no_jitter(acting, markers):
    """Its errors are ten to a hundred times the noise."""
    for seed in range(3):
        seen, own, state = seen_by(seed, acting=acting)
        rms, _ = noise_of(seen, own, state, FEW[markers])
        assert rms == pytest.approx(np.sqrt(3) * WHITE, rel=0.1)


FIRST = ((None, "three"), (wide_play, "four"), (creep, "eight"))
EACH = [
    pair if pair in FIRST else pytest.param(*pair, marks=pytest.mark.long)
    for pair in product((None, wide_play, creep), FEW)
]


@pytest.mark.parametrize(("acting", "markers"), EACH)
def test_jitter_is_found_next_to_memory_of_the_drive(acting, markers):
    found_mm, true_mm = [], []
    for seed in range(6):
        seen, own, state = seen_by(seed, 0.25, 0.3, 8.0, acting)
        rms, memory = noise_of(seen, own, state, FEW[markers])
        assert memory >= 2.5
        found_mm.append(rms)
        alone, own, state = seen_by(seed, 0.25, 0.3, 8.0)
        kept = (alone - own).reshape(len(own), 8, 3)[:, list(FEW[markers])]
        true_mm.append(np.sqrt(np.mean(np.sum(kept**2, axis=2))))
    assert np.mean(found_mm) == pytest.approx(np.mean(true_mm), rel=0.25)


def test_a_trend_over_the_run_is_no_jitter():
    """The frame turns by 0.5° and shifts by 0.6 mm over the run, steadily: this drift is not
    removed as jitter.
    """
    for seed in range(3):
        rng = np.random.default_rng(seed)
        t, command, seen = visits(tour(rng), rng)
        line = ((seen - seen[0]) / np.ptp(seen))[:, None]
        own = shape(at(t, command, seen))
        points = shaken(own, np.radians(0.5) * line * [1, 0, 0], 0.6 * line * [0, 1, 0])
        points = (points + WHITE * rng.normal(size=own.shape)).reshape(len(seen), -1)
        jitter = found(
            points, own.reshape(len(seen), -1), conditions(record(t, command, seen), command)
        )[0]
        assert jitter is None or np.diag(jitter.covariance)[3:].max() < 0.1**2


def test_slow_jitter_goes_into_the_noise_and_its_frames_count_for_less():
    """Dwells alone show a sixth of it; whitened, the remainder of jitter and noise has the stated
    variance.
    """
    ratio, blind, counted = [], [], []
    for seed in range(8):
        seen, own, state = seen_by(seed, 0.2, 0.3, 10.0)
        positions = np.ones(8, bool)
        noise = measure_noise(seen - own, seen, positions, state.time, state)
        assert (
            noise.slow is not None
            and "frame jitter" in noise.source
            and 5.0 <= noise.memory_s <= 20.0
        )
        white = whitener(
            noise,
            np.zeros_like(noise.covariance),
            np.eye(24)[None],
            command_kernel(state.command, np.ptp(state.command, axis=0)),
        )
        ratio.append(np.sum(white.modes(seen - own) ** 2) / (white.numbers * len(seen)))
        counted.append(white.numbers / len(white.form))
        inside = dwell_scatter(seen - own, settled_dwells(state))
        plain = np.diag(inside.squares) / inside.degrees
        blind.append(np.mean((seen - own) ** 2) / np.mean(plain))
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.15)
    assert np.mean(blind) > 3.0
    assert np.mean(counted) < 0.9


def test_an_effect_along_the_jitter_is_found_where_it_is_larger():
    """A base that is 1.5 mm off, under jitter of 0.3 mm and 10 s memory: 5 standard deviations and
    more.
    """
    seen, own, state = seen_by(3, 0.2, 0.3, 10.0)
    positions = np.ones(8, bool)
    noise = measure_noise(seen - own, seen, positions, state.time, state)
    shift = np.tile([1.5, 0.0, 0.0], (len(seen), 8))
    white = whitener(
        noise,
        np.zeros_like(noise.covariance),
        shift[None],
        command_kernel(state.command, np.ptp(state.command, axis=0)),
    )
    signature, residual = white.modes(shift).ravel(), white.modes(seen + shift - own).ravel()
    size = float(signature @ signature)
    assert float(signature @ residual) / size == pytest.approx(1.0, abs=0.3)
    # more if frames counted as independent
    assert 5.0 < np.sqrt(size) < 0.3 * 1.5 / WHITE * np.sqrt(len(seen) * 8)


def test_markers_on_one_line_show_their_other_axes():
    """No turn about the line is seen: this must not make the others unknown, nor be large
    itself.
    """
    sizes, true = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        t, command, seen = visits(tour(rng), rng)
        own = np.linspace(20.0, 100.0, 6)[:, None] * [0.0, 0.0, 1.0] + np.zeros((len(seen), 1, 1))
        own = own + (shape(at(t, command, seen)) - shape(np.zeros((1, 2))))[:, 2:]
        state = wander(seen, 8.0, rng, 6)
        moved = shaken(own, np.radians(0.2) * state[:, :3], 0.3 * state[:, 3:])
        points = (moved + WHITE * rng.normal(size=own.shape)).reshape(len(seen), -1)
        jitter = found(
            points, own.reshape(len(seen), -1), conditions(record(t, command, seen), command)
        )[0]
        sizes.append(np.trace(jitter.of_features(points, np.ones(6, bool))) / 6)
        true.append(np.mean(np.sum((moved - own) ** 2, axis=2)))
    assert np.sqrt(np.mean(sizes)) == pytest.approx(np.sqrt(np.mean(true)), rel=0.3)
