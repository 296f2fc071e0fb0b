"""A figure as it is planned: where it lies, how large, when, within which bounds, and the ticks of
its commands.
"""

from dataclasses import replace

import numpy as np
import pytest
from rigs import calibration

from softmap_edge import builtin_model
from softmap_edge.robot.drive.track import course
from softmap_edge.robot.motion.figures import even, figure
from softmap_edge.robot.motion.kinematics import Kinematics
from softmap_edge.robot.servo.loop_limits import ACCELERATION, SLEW

MODEL = builtin_model()
REST = MODEL.tip(np.zeros((1, 2)))[0]
MAP = replace(calibration(), window=None)
LIMITS = {"slew": [SLEW] * 2, "acceleration": [ACCELERATION] * 2}
CORNER = "x,y\n0,0\n10,0\n10,4\n"


def planned(name, *, axes="xy", amplitude=8.0, duration=10.0, rate=50.0, known=MAP):
    """Plan a figure with a calibration of the model's own."""
    kinematics = Kinematics(replace(MODEL, calibration=known), axes=axes)
    return course(
        kinematics,
        name,
        amplitude=amplitude,
        duration=duration,
        rate=rate,
        calibration=known,
        **LIMITS,
    )


def drawn(made):
    """Return the waypoints of the figure itself about the tip at rest (T, 3) mm."""
    return made.plan.targets[made.counts] - REST


@pytest.mark.parametrize("name", ["S", "H", "O", "E", "circle", "eight", "corner.csv"])
def test_a_figure_lies_about_the_tip_at_rest_as_large_as_asked_and_the_tip_follows_it(
    name, tmp_path
):
    (tmp_path / "corner.csv").write_text(CORNER)
    name = str(tmp_path / name) if "." in name else name
    made = planned(name, amplitude=7.0)
    points = drawn(made)
    low, high = points.min(axis=0), points.max(axis=0)
    # waypoints stand 0.2 mm apart, corners between them
    np.testing.assert_allclose(low + high, 0.0, atol=0.1)
    assert (high - low).max() / 2 == pytest.approx(7.0, abs=0.05) and np.ptp(points[:, 2]) < 1e-9
    line = even(figure(name, 7.0), 3000)
    apart = np.linalg.norm(points[:, None, :2] - line, axis=2)
    assert apart.min(axis=1).max() < 0.05 and apart.min(axis=0).max() < 0.3  # on it, and all of it
    np.testing.assert_allclose(made.plan.targets[0], REST, atol=1e-9)
    assert made.plan.distance.max() < 0.01 and made.plan.unreachable.max() < 0.01


def test_duration_and_rate_are_those_that_are_asked():
    for duration, rate in ((10.0, 20.0), (14.0, 50.0)):
        made = planned("O", duration=duration, rate=rate)
        np.testing.assert_allclose(np.diff(made.plan.t), 1.0 / rate, atol=1e-9)
        assert made.counts.sum() == duration * rate + 1
    assert planned("O", amplitude=16.0, duration=20.0, rate=20.0).counts.sum() == 401


def test_only_the_active_axes_count():
    """A tip that bends aside sinks: about a rest at full height that is out of reach, unless z does
    not count.
    """
    plane, whole = planned("circle", axes="xy"), planned("circle", axes="xyz")
    sunk = np.abs(plane.plan.tip[:, 2] - plane.plan.targets[:, 2]).max()
    assert sunk > 0.2 and plane.plan.distance.max() < 0.01
    assert whole.plan.unreachable.max() > 0.1 * sunk and whole.plan.distance.max() > 0.1 * sunk
    upright = planned("circle", axes="xz", amplitude=3.0)
    assert np.ptp(drawn(upright)[:, 1]) == 0.0 and np.ptp(drawn(upright)[:, 2]) == pytest.approx(
        6.0, abs=0.1
    )
    turned = planned("E", axes="yx")
    np.testing.assert_allclose(drawn(turned)[-1, [1, 0]], drawn(planned("E"))[-1, :2], atol=1e-9)


@pytest.mark.parametrize(
    "window, most", [((-400.0, 900.0), 400.0), ((-5000.0, 6000.0), 4480.0), (None, 4480.0)]
)
def test_commands_stay_within_the_sweep_and_the_tick_window_at_once(window, most):
    """The first window is the narrower bound, with the others the sweep of 16 mm is; all of it is
    used, and no more.
    """
    known = replace(MAP, window=window)
    made = planned("circle", amplitude=60.0, duration=20.0, known=known)
    away = np.abs(known.ticks(made.plan.commands) - known.home)
    assert 280.0 * np.abs(MODEL.command_range).max() == 4480.0
    np.testing.assert_allclose(away.max(axis=0), most, atol=1.0)
    assert made.plan.unreachable.max() > 5.0  # the nearest points are taken


@pytest.mark.parametrize("name", ["S", "H", "O", "E", "circle", "eight"])
def test_slew_and_acceleration_hold_where_less_time_is_asked_than_there_is(name):
    """At 14 mm the way leads through slack tendons, where 1.5 mm of command lie between two
    waypoints.
    """
    made = planned(name, amplitude=14.0, duration=0.2, rate=100.0)
    ticks = made.plan.commands / np.diag(MAP.A)
    assert np.abs(np.diff(ticks, axis=0)).max() * 100.0 < SLEW
    # over 20 ms, as in test_timing.py
    assert np.abs(np.diff(ticks[::2], n=2, axis=0)).max() * 50.0**2 < ACCELERATION
    assert made.quickest > 0.2 and made.counts.sum() >= 100.0 * made.quickest
    assert (
        made.plan.unreachable.max() < 0.01
        and np.median(made.plan.distance) < 0.01
        and made.plan.distance.max() < 1.0
    )
    # Evenly in the time that was asked, both would be passed many times over.
    points = even(figure(name, 14.0), 21)
    hasty = Kinematics(MODEL, axes="xy").solve(
        REST + np.pad(points, ((0, 0), (0, 1)))
    ).acting / np.diag(MAP.A)
    assert np.abs(np.diff(hasty, axis=0)).max() * 100.0 > 5 * SLEW


def test_ticks_are_home_and_the_rounded_inverse_of_the_map():
    """Servos that are coupled and a map with an offset: every one of both is seen in the sum."""
    slope, shift, home = (
        np.array([[1 / 280.0, 2e-4], [-3e-4, -1 / 250.0]]),
        np.array([0.4, -0.3]),
        np.array([900.0, 3100.0]),
    )
    known = replace(MAP, A=slope, b=shift, home=home)
    made = planned("H", known=known)
    sent = known.ticks(made.plan.commands)
    det = slope[0, 0] * slope[1, 1] - slope[0, 1] * slope[1, 0]
    for u, ticks in zip(made.plan.commands, sent):
        x, y = u - shift
        wanted = [
            (slope[1, 1] * x - slope[0, 1] * y) / det,
            (slope[0, 0] * y - slope[1, 0] * x) / det,
        ]
        assert ticks.tolist() == [h + np.round(w) for h, w in zip(home, wanted)]
    # The result is the command to half a tick of each servo; cut instead of rounded it would
    # be a complete one.
    back = np.abs(known.commands(sent) - made.plan.commands)
    assert (back <= np.abs(slope).sum(axis=1) / 2 + 1e-9).all()
