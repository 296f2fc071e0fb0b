"""A finger behind emulated servos: its laws as they stream, its camera, its faults."""

import time

import numpy as np
import pytest
from rigs import bench, calibration

from softmap_edge import SoftmapError, builtin_model
from softmap_edge.camera.frames import on_host
from softmap_edge.servo.controller import Controller
from softmap_edge.servo.finger import FRAMES, EmulatedFinger, hidden_laws
from softmap_edge.truth_laws import LAWS, Law
from softmap_edge.truth_named import NAMED
from softmap_edge.truth_stream import streamed


@pytest.fixture(scope="module")
def model():
    return builtin_model()


@pytest.mark.parametrize("name", [n for n, law in {**LAWS, **NAMED}.items() if law.command is not Law.command])
def test_a_stream_of_a_law_is_its_record(name):
    (law,) = hidden_laws([name], 2, 5)
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.002, 0.02, 800))
    u = np.stack([3 * np.sin(1.1 * t), 2 * np.sin(0.7 * t + 1)], axis=1)
    step = streamed([law])
    np.testing.assert_allclose([step(now, x) for now, x in zip(t, u)], law.command(t, u), atol=1e-9)


def test_what_moves_no_tendon_cannot_hide():
    for name in ("gravity", "mount", "nothing"):
        with pytest.raises(SoftmapError):
            hidden_laws([name], 2, 0)


def moved(robot, u, seconds):
    """Send a command for some seconds."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        robot.target(u)
        time.sleep(0.02)


def test_a_camera_sees_the_finger_that_packets_drive(model):
    laws = hidden_laws(["backlash"], 2, 1)
    with (
        bench() as (bus, rig, limits),
        EmulatedFinger(bus, model, calibration(), laws, seed=4) as finger,
        Controller(rig, calibration(), limits) as robot,
    ):
        robot.engage()
        moved(robot, [1.8, -1.2], 2.5)
        frames, (_, acting) = finger.seen(), finger.acting()
    stamps = np.array([frame.stamp for frame in frames])
    host = on_host(frames)
    assert np.ptp(stamps) * FRAMES * 0.8 < len(frames) <= np.ptp(stamps) * FRAMES * 1.1 + 2
    assert abs(stamps[0] - host[0]) > 1.0 and (np.diff(stamps) > 0).all()
    assert all(frame.arrived > when for frame, when in zip(frames, host - 1e-3))
    # Play: what acts ends short of what was asked, by half the play of each channel.
    half = np.array(laws[0].half_width_mm)
    np.testing.assert_allclose(acting[-1], [1.8 - half[0], -1.2 + half[1]], atol=0.02)
    tip = np.mean([frame.points[model.tip_indices].mean(axis=0) for frame in frames[-10:]], axis=0)
    assert np.linalg.norm(tip - model.tip(acting[-1:])[0]) < 0.03


def test_a_reversed_and_a_broken_tendon_show(model):
    with bench() as (bus, rig, limits), EmulatedFinger(bus, model, calibration()) as finger:
        finger.tendon(0, -1.0)
        finger.tendon(1, 0.0)
        with Controller(rig, calibration(), limits) as robot:
            robot.engage()
            moved(robot, [1.5, 1.5], 2.0)
            _, acting = finger.acting()
    np.testing.assert_allclose(acting[-1], [-1.5, 0.0], atol=0.02)
