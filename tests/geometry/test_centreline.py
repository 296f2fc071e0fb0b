"""The line through a body is found from points alone: straight in any orientation, bent, of three
points and of 5000.
"""

import numpy as np
import pytest
from robots import turned

from softmap_edge.errors import SoftmapError
from softmap_edge.geometry.centreline import find_centreline

TURN = turned(np.array([0.9, -1.4, 0.6]))
SHIFT = np.array([30.0, -12.0, 55.0])


def tube(count, bend=0.0, kind="ring", seed=0):
    """Places (N,) along and points (N, 3) mm of a tube of 100 mm, radius 10, bent by `bend` rad
    about y.
    """
    rng = np.random.default_rng(seed)
    if kind == "ring":
        around = max(4, int(np.sqrt(count)))
        s = np.repeat(np.linspace(0.0, 100.0, around), count // around)
        angle = np.tile(np.arange(count // around) * 2 * np.pi / (count // around), around)
        radius = np.full(len(s), 10.0)
    else:
        s, angle = rng.uniform(0.0, 100.0, count), rng.uniform(0.0, 2 * np.pi, count)
        radius = 10.0 * (np.ones(count) if kind == "surface" else np.sqrt(rng.uniform(size=count)))
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    if not bend:
        return s, np.stack([x, y, s], axis=1)
    r = 100.0 / bend
    return s, np.stack([r - (r - x) * np.cos(s / r), y, (r - x) * np.sin(s / r)], axis=1)


@pytest.mark.parametrize("kind", ["ring", "surface", "solid"])
@pytest.mark.parametrize("count", [150, 548, 5000])
@pytest.mark.parametrize("turn", [np.eye(3), TURN], ids=["upright", "turned"])
def test_a_straight_body_in_any_orientation(kind, count, turn):
    s, points = tube(count, kind=kind)
    line = find_centreline(points @ turn.T + SHIFT, SHIFT)
    # A solid cloud is not round to the last point: its best axis lies a fraction of a millimetre
    # off.
    np.testing.assert_allclose(line.along, s, atol=0.2)
    assert (
        line.lean_deg == pytest.approx(np.degrees(np.arccos(turn[2, 2])), abs=1.0)
        and line.bow_mm < 1.0
    )
    body = line.body()
    inside = np.abs(s * 9 / 100 - np.round(s * 9 / 100)) > 0.02
    assert body.count == 9 and body.angle is not None
    np.testing.assert_array_equal(body.section[inside], (s[inside] * 9 / 100).astype(int))


@pytest.mark.parametrize(("bend", "off"), [(0.5, 4.0), (1.0, 2.0), (2.5, 9.0)])
@pytest.mark.parametrize("kind", ["ring", "surface", "solid"])
def test_a_body_that_is_not_straight_at_rest(kind, bend, off):
    s, points = tube(548, bend, kind)
    line = find_centreline(points @ TURN.T, np.zeros(3))
    assert np.abs(line.along - s).max() < off and line.length == pytest.approx(100.0, rel=0.06)
    sagitta = 100.0 / bend * (1 - np.cos(bend / 2))
    assert line.bow_mm == pytest.approx(sagitta, rel=0.25)
    # Slices of z, as for a finger that stands upright, would be far off: the test is felt.
    assert np.abs(points @ TURN[2] - s).max() > 30.0


def test_stations_follow_the_body_whatever_shape_it_takes():
    s, rest = tube(548, kind="surface")
    line = find_centreline(rest, np.zeros(3))
    for bend in (0.3, 1.2, 2.0):
        bent = tube(548, bend, kind="surface")[1]
        r = 100.0 / bend
        true = np.stack(
            [r - r * np.cos(line.arc / r), 0 * line.arc, r * np.sin(line.arc / r)], axis=1
        )
        assert np.abs(line.stations(bent[None])[0] - true).max() < 0.05
        slices = [bent[(s >= low) & (s < low + 4)].mean(axis=0) for low in np.arange(0, 100, 4)]
        middle = np.stack(
            [np.interp(np.arange(2, 100, 4), line.arc, column) for column in true.T], axis=1
        )
        # means of slices wander with uneven points
        assert np.abs(np.array(slices) - middle).max() > 1.0


def test_few_points_are_the_line_itself_in_whatever_order():
    s = np.array([70.0, 30.0, 100.0])
    line = find_centreline(np.outer(s, TURN[:, 2]) + SHIFT, SHIFT)
    np.testing.assert_allclose(line.along, s)
    np.testing.assert_allclose(line.arc, [0, 30, 70, 100])
    assert line.body() is None and line.angle is None
    nodes = find_centreline(np.outer(np.linspace(0, 100, 101), TURN[:, 2]), np.zeros(3))
    assert nodes.angle is None and nodes.body().count == 9


def test_what_is_no_body_is_refused_in_one_line():
    points = tube(548)[1]
    for rest, base, says in (
        (points + [0, 0, 200], np.zeros(3), "do not begin at the base"),
        (np.zeros((9, 3)), np.zeros(3), "one place"),
        (np.array([[0, 0, 50.0], [0, 0, 50.0]]), np.zeros(3), "one place"),
    ):
        with pytest.raises(SoftmapError, match=says):
            find_centreline(rest, base)
