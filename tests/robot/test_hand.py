"""The hand frame of the paper and the commands that are made of it."""

import numpy as np
import pytest
from hands import hand, turned

from softmap_edge.commands.teleop import _flips
from softmap_edge.errors import TeleopError
from softmap_edge.robot.teleop.hand import (
    FARTHEST,
    SMALLEST,
    Hand,
    HandMap,
    View,
    in_pixels,
    projection,
)

RANGE = [[-9.0, 9.0], [-6.0, 8.0]]


def by_the_paper(points):
    """Equations of the paper, as written, on points with y up."""
    forward = points[9] - points[0]
    s = np.sqrt(forward @ forward)
    f = forward / s
    r = np.array([f[1], -f[0]])
    d = points[8] - points[5]
    return np.array([d @ f / s, d @ r / s])


def test_the_formula_is_the_papers():
    rng = np.random.default_rng(0)
    for _ in range(200):
        points = rng.uniform(0, 720, (21, 2))
        wanted = by_the_paper(points * (1, -1))
        found = projection(Hand(points, "left"))
        if np.abs(wanted).max() <= FARTHEST:
            np.testing.assert_allclose(found, wanted, rtol=1e-12)
        else:
            assert found is None


def test_directions_mean_what_they_say():
    """Straight is 0.9, curled 0; a tip to the right of the picture of an upright hand is
    positive.
    """
    middle = hand().points[9] - hand().points[0]  # 20 px to the side: the frame leans by 11°
    assert middle[1] == -100
    straight, curled, right = (projection(h) for h in (hand(), hand(curl=0.9), hand(sideways=0.5)))
    assert straight[0] > 0.8 and abs(curled[0]) < 1e-9
    assert right[1] - straight[1] > 0.45


@pytest.mark.parametrize("degrees", [-170, -90, -30, 0, 45, 90, 180])
@pytest.mark.parametrize("scale", [0.4, 1.0, 3.0])
def test_place_turn_and_distance_change_nothing(degrees, scale):
    bent = hand(curl=0.3, sideways=0.2)
    moved = turned(bent, degrees, scale, (57.0, -33.0))
    np.testing.assert_allclose(projection(moved), projection(bent), atol=1e-12)


def test_normalised_landmarks_go_to_the_true_aspect_first():
    """Turned by 60° in a 16:9 picture: right in pixels, wrong by what the facts say when left
    normalised.
    """
    points = turned(hand(curl=0.2, sideways=0.3), 60).points
    normalised = np.column_stack([points / (1280, 720), np.zeros(21)])
    np.testing.assert_allclose(in_pixels(normalised, 1280, 720), points)
    raw = projection(Hand(normalised[:, :2] * 720, "right"))
    assert np.abs(raw - projection(Hand(points, "right"))).max() > 0.1


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-9, 1.0, SMALLEST - 0.01])
def test_a_hand_without_size_is_no_hand(size):
    points = hand().points.copy()
    points[9] = points[0] + (0.0, -size)
    with np.errstate(all="raise"):
        assert projection(Hand(points, "right")) is None
        assert View().projection(Hand(points, "right")) is None
    points[9] = points[0] + (0.0, -SMALLEST - 0.01)
    points[5:9] = points[0]
    assert projection(Hand(points, "right")) is not None


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e6])
@pytest.mark.parametrize("which", range(21))
def test_bad_landmarks_are_refused(bad, which):
    points = hand().points.copy()
    points[which, 1] = bad
    with pytest.raises(TeleopError, match="NaN or lie beyond"):
        Hand(points, "right")


def test_bad_hands_views_and_maps_are_refused():
    cases = [
        (lambda: Hand(np.zeros((20, 2)), "right"), r"shape \(20, 2\), expected \(21, 2\)"),
        (lambda: Hand(hand().points, "both"), "side 'both'"),
        (lambda: Hand(hand().points, "left", 1.5), "score 1.5"),
        (lambda: Hand(hand().points, "left", np.nan), "score nan"),
        (lambda: View("foot"), "choose any, left or right"),
        (lambda: HandMap([[-1, 1]] * 3), "a hand drives two commands"),
        (lambda: HandMap([[0, 1], [-1, 1]]), "LOW < 0 < HIGH"),
        (lambda: HandMap([[-1, np.nan], [-1, 1]]), "LOW < 0 < HIGH"),
        (lambda: HandMap(RANGE, reach=(0.0, 1.0)), "two numbers above 0"),
        (lambda: HandMap(RANGE, reach=(np.inf, 1.0)), "two numbers above 0"),
        (
            lambda: HandMap(RANGE).command([np.nan, 0.0], [0.9, 0.0]),
            "without a hand there is no command",
        ),
        (
            lambda: HandMap(RANGE).command([0.5, 0.0], [0.9, np.inf]),
            "without a hand there is no command",
        ),
        (
            lambda: HandMap(RANGE).command([0.5, 0.0, 0.1], [0.9, 0.0, 0.0]),
            "without a hand there is no command",
        ),
    ]
    for act, said in cases:
        with pytest.raises(TeleopError, match=said) as fault:
            act()
        assert "\n" not in str(fault.value)


def test_the_pose_of_engaging_is_rest_and_reach_is_the_end_of_the_range():
    drive = HandMap(RANGE, reach=(0.5, 0.8))
    neutral = projection(hand(curl=0.2, sideways=0.1))
    assert drive.command(neutral, neutral).tolist() == [0.0, 0.0]
    np.testing.assert_allclose(
        drive.command(neutral + [0.0, 0.5], neutral), [-9.0, 0.0], atol=1e-12
    )
    np.testing.assert_allclose(
        drive.command(neutral + [-0.8, -0.25], neutral), [4.5, -6.0], atol=1e-12
    )
    np.testing.assert_allclose(drive.command(neutral + [0.4, 0.0], neutral), [0.0, 4.0], atol=1e-12)
    both = HandMap(RANGE, reach=(0.5, 0.8), flip=(True, True))
    np.testing.assert_allclose(both.command(neutral + [0.8, 0.5], neutral), [9.0, -6.0], atol=1e-12)


def test_no_command_leaves_the_range():
    rng = np.random.default_rng(1)
    drive, (low, high) = HandMap(RANGE), np.array(RANGE).T
    for _ in range(2000):
        scale = 10.0 ** rng.uniform(-3, 300)
        u = drive.command(rng.normal(size=2) * scale, rng.normal(size=2))
        assert (low <= u).all() and (u <= high).all()


def test_the_driving_hand_and_mirrored_pictures():
    right, left = hand(side="right"), Hand(hand().points, "left", 0.6)
    assert View().driving([left, right]) is right and View().driving([]) is None
    assert View("left").driving([left, right]) is left
    assert View("left").driving([right]) is None
    assert View("left", mirrored=True).driving([left, right]) is right
    bent = hand(sideways=0.3)
    image = Hand((640.0, 0.0) + bent.points * (-1.0, 1.0), "left")
    np.testing.assert_allclose(
        View(mirrored=True).projection(image), View().projection(bent), atol=1e-12
    )
    assert View(mirrored=True).side(image) == View().side(bent) == "right"
    assert View().projection(None) is None


def test_as_it_ships_a_finger_leads_to_the_side_to_which_its_owner_points():
    """A camera sees its owner from in front: the owner's right is the picture's left."""
    straight, drive = hand(), HandMap(RANGE)
    points = straight.points.copy()
    points[8, 0] -= 0.2 * np.linalg.norm(points[9] - points[0])
    pointing = Hand(points, "right")
    u = drive.command(View().projection(pointing), View().projection(straight))
    assert u[0] > 1.0, u
    flipped = HandMap(RANGE, flip=_flips("x")).command(
        View().projection(pointing), View().projection(straight)
    )
    assert _flips("") == (False, False) and flipped[0] == pytest.approx(-u[0])
