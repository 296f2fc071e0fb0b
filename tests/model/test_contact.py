"""Contact: the built-in finger against a wall, and its finite elements pushed as hard as it
takes.
"""

import numpy as np
import pytest

from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Simulator
from softmap_edge.model.bundle import builtin_model
from softmap_edge.run.run import Run

AXIS = np.array([1.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def model():
    return builtin_model()


def seen(model, commands, **params):
    t = np.arange(float(len(commands)))
    run = Run(t=t, command=np.array(commands), t_seen=t)
    contact = {f"contact.{name}": value for name, value in params.items()}
    return (model.with_effects(["contact"], contact) if params else model).predict(run)


def test_a_wall_stops_the_tip_as_a_force_does_that_holds_it_there(model):
    command, wall = [[9.0, 0.0]], 38.0
    tip = model.structure.arc_length >= 0.9 * model.structure.arc_length.max()
    radius = model.structure.contact[-1][-1]
    simulator = Simulator(Finger.builtin())

    def solved(newton):
        return simulator.path(command, load=tuple(-newton * AXIS))[0]

    def gap(points):
        return wall - points[tip].mean(axis=0) @ AXIS - radius

    low, high = 0.0, 0.3
    gaps = [gap(solved(low)), gap(solved(high))]
    assert gaps[0] < -1.5, "the wall must be in the way"
    for _ in range(4):  # secant
        newton = low - gaps[0] * (high - low) / (gaps[1] - gaps[0])
        low, gaps = high, [gaps[1], gap(solved(newton))]
        high = newton
        if abs(gaps[1]) < 0.02:
            break
    truth, free = solved(high), solved(0.0)
    said = seen(model, command, distance=wall, heading=0.0)[0]
    miss, size = (np.sqrt(np.mean(np.sum(d**2, axis=1))) for d in (said - truth, truth - free))
    assert abs(gap(said)) < 0.1
    assert size > 1.0 and miss < 0.2 * size, f"{miss:.2f} of {size:.2f} mm"


def test_a_wall_acts_on_one_side_only_and_not_before_it_is_reached(model):
    commands = [[u, 0.0] for u in (-10.0, 0.0, 3.0, 7.0, 10.0)]
    free = seen(model, commands)
    stopped = seen(model, commands, distance=38.0, heading=0.0)
    moved = np.linalg.norm(stopped - free, axis=2).max(axis=1)
    np.testing.assert_array_equal(moved[:3], 0.0)
    assert moved[3] < moved[4] and moved[4] > 2.0
    # As on the other side, turned by half a turn about the axis.
    others = [[-u, v] for u, v in commands]
    mirrored = seen(model, others, distance=38.0, heading=180.0) - seen(model, others)
    np.testing.assert_allclose(np.linalg.norm(mirrored, axis=2).max(axis=1), moved, atol=0.3)


def test_a_large_sphere_is_a_plane(model):
    commands = [[9.0, 3.0], [11.0, -2.0]]
    plane = seen(model, commands, distance=42.0, heading=10.0, tilt=5.0, height=90.0)
    sphere = seen(
        model, commands, distance=42.0, heading=10.0, tilt=5.0, height=90.0, curvature=1e-6
    )
    assert np.abs(plane - seen(model, commands)).max() > 1.0
    np.testing.assert_allclose(sphere, plane, atol=0.02)
