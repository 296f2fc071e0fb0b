"""A strong memory is no fault: plateaus are no hanging camera, a late sine no clock, a small stroke
no other unit.
"""

from dataclasses import replace

import numpy as np
import pytest

from softmap_edge import Run, builtin_model, diagnose
from softmap_edge.checks.remembered import memory_share
from softmap_edge.diagnosis.clean import clean_run
from softmap_edge.errors import RunError

MODEL = builtin_model()
GAPS = [0.5, 1.0, 1.5, 1.9]  # in half ranges


def played(u, gap):
    """A play, independent of the library: the command that reaches the body, (T, C)."""
    y = np.zeros_like(u)
    for k in range(1, len(u)):
        y[k] = np.clip(y[k - 1], u[k] - gap / 2, u[k] + gap / 2)
    return y


def idle(u, zone):
    """A dead zone, independent of the library: nothing moves within ±zone."""
    return np.sign(u) * np.maximum(np.abs(u) - zone, 0.0)


def sine(period=6.85, reach=10.0, seconds=60.0):
    t = np.arange(0.0, seconds, 0.02)
    grow = np.minimum(1.0, t / period)
    return t, reach * (grow * np.sin(2 * np.pi * t / period))[:, None] * [1.0, 0.6]


def wandering(seconds=90.0):
    t = np.arange(0.0, seconds, 0.02)
    rng = np.random.default_rng(4)
    waves = np.arange(1, 8) / 40.0
    u = np.stack(
        [
            np.sin(2 * np.pi * np.outer(t, waves) + rng.uniform(0, 6, 7)) @ rng.normal(size=7)
            for _ in "ab"
        ],
        1,
    )
    return t, 10.0 * u / np.abs(u).max(axis=0) * np.minimum(1.0, t / 3.0)[:, None]


def seen_by(t, command, acting, noise, every=0.15):
    """A run of the built-in finger with `acting` at the body; without noise, plateaus repeat bit
    for bit.
    """
    t_seen = np.arange(0.5, t[-1] - 0.2, every)
    rest = np.repeat(MODEL.rest[None], len(t_seen), axis=0)
    blank = Run(t=t, command=acting, t_seen=t_seen, vertices=rest, command_unit="mm")
    points = MODEL.predict(blank)
    points = np.round(points, 2) + noise * np.random.default_rng(0).normal(size=points.shape)
    return replace(blank, command=command, vertices=points)


@pytest.mark.parametrize("noise", [0.0, 0.2])
@pytest.mark.parametrize("motion", [sine, wandering])
@pytest.mark.parametrize("gap", GAPS)
def test_a_strong_play_is_no_fault(gap, motion, noise):
    t, u = motion()
    half = 0.5 * np.ptp(u, axis=0)
    run = seen_by(
        t, u, np.stack([played(u[:, [c]], gap * half[c])[:, 0] for c in (0, 1)], axis=1), noise
    )
    checked = clean_run(MODEL, run)
    assert checked.run.frames == run.frames and checked.doubts == ()
    assert not any("set aside" in text or "unit" in text for text in checked.remarks), (
        checked.remarks
    )


def test_a_play_of_one_gap_is_found_as_memory():
    t, u = sine()
    run = seen_by(t, u, played(u, 9.0), 0.1)
    seen = np.asarray(run.vertices)
    found = memory_share(MODEL, run, seen, np.ones(seen.shape[:2], bool))
    assert found.share > 0.9 and found.free > 0.9
    none = memory_share(
        MODEL, run, np.repeat(seen[:1], len(seen), 0), np.ones(seen.shape[:2], bool)
    )
    assert none.free < 0.05


def late(run, seconds):
    keep = run.t_seen + seconds < run.t[-1]
    return replace(run.at(keep), t_seen=run.t_seen[keep] + seconds)


def test_real_faults_are_still_refused():
    t, u = wandering()
    run = seen_by(t, u, u, 0.2)
    with pytest.raises(RunError, match="frames 8"):
        clean_run(MODEL, late(run, 8.0))
    with pytest.raises(RunError, match="opposite sign"):
        clean_run(MODEL, replace(run, command=-run.command))
    with pytest.raises(RunError, match="another unit"):
        clean_run(MODEL, replace(run, command=0.1 * run.command))


@pytest.mark.parametrize("noise", [0.0, 0.2])
@pytest.mark.parametrize("count", [2, 5])
def test_a_camera_that_hangs_is_still_found(count, noise):
    t, u = wandering()
    run = seen_by(t, u, u, noise)
    hung = replace(run, vertices=run.vertices[np.arange(run.frames) // count * count])
    assert any("the camera or its log hangs" in text for text in clean_run(MODEL, hung).remarks)


# --- a robot that does not follow -----------------------------------------------------------------


@pytest.mark.parametrize("motion", [sine, wandering])
def test_a_robot_that_stands_still_is_a_fault_of_the_measurement(motion):
    t, u = motion()
    found = diagnose(MODEL, seen_by(t, u, 0.0 * u, 0.25), effects=["backlash", "gain", "payload"])
    assert found.verdict == "measurement_fault" and found.effects == ()
    assert (
        "The robot does not follow its commands" in found.sentence
        and "drive is engaged" in found.sentence
    )


def test_a_dead_zone_of_the_full_range_is_a_robot_that_stands_still():
    """Noise and a drift of the camera move its points by more than a robot without a drive does."""
    t, u = wandering()
    run = seen_by(t, u, 0.0 * u, 0.25)
    drift = 1.2 * np.sin(0.05 * run.t_seen)[:, None, None]
    found = diagnose(
        MODEL, replace(run, vertices=run.vertices + drift), effects=["dead_zone", "gain"]
    )
    assert found.verdict == "measurement_fault" and found.effects == ()
    assert "The robot does not follow its commands" in found.sentence


def test_a_robot_with_a_play_of_nearly_all_its_range_still_follows():
    t, u = sine()
    half = 0.5 * np.ptp(u, axis=0)
    acting = np.stack([played(u[:, [c]], 1.9 * half[c])[:, 0] for c in (0, 1)], axis=1)
    found = diagnose(MODEL, seen_by(t, u, acting, 0.05), effects=["backlash", "gain"])
    assert "follow its commands" not in found.sentence
    assert "follows its commands" not in found.sentence


@pytest.mark.parametrize("share", [0.04, 0.1, 0.2])
def test_a_robot_that_moves_by_a_small_share_is_a_fault_of_the_measurement(share):
    t, u = wandering()
    run = seen_by(t, u, share * u, 0.1)
    found = diagnose(MODEL, run, effects=["dead_zone", "backlash", "gain"])
    assert found.verdict == "measurement_fault" and found.effects == ()
    assert "The robot hardly follows its commands" in found.sentence
    assert "drive is engaged" in found.sentence


@pytest.mark.parametrize("effect", ["dead_zone", "backlash"])
def test_a_dead_zone_or_play_of_half_the_range_is_still_identified(effect):
    t, u = wandering()
    half = float(0.5 * np.ptp(u, axis=0).min())
    acting = idle(u, 0.5 * half) if effect == "dead_zone" else played(u, half)
    found = diagnose(MODEL, seen_by(t, u, acting, 0.1), effects=["dead_zone", "backlash", "gain"])
    assert [one.name for one in found.effects] == [effect], found.sentence
