"""The hand of a press drives until the key is released: no other hand in its place, however fast
the own one moves.
"""

import time

import numpy as np
import pytest
from driving import Session
from driving import hand as shown
from hands import hand, turned
from rigs import HOME, angles, torque

from softmap_edge.robot.link.session import new_key, read_key
from softmap_edge.robot.teleop.hand import Hand, View
from softmap_edge.robot.teleop.hand_source import RemoteHandSource
from softmap_edge.robot.teleop.landmarks import Message, Receiver, Sender
from softmap_edge.robot.teleop.own_hand import ANOTHER, SIDES, OwnHand

RATE = 30.0  # pictures a second
PX = 1000.0  # px a metre: a hand of 100 px from wrist to middle knuckle is 0.1 m


def at(place, side="right", scale=1.0, degrees=0.0, **pose):
    """A hand at another place (px), larger, turned."""
    return turned(hand(side=side, **pose), degrees, scale, place)


def followed(hands, rate=RATE):
    """Return of each picture (a hand, a list of them, or None) whether it showed the hand of the
    first.
    """
    own = OwnHand()
    own.begin(hands[0], 0.0)
    seen = []
    for k, one in enumerate(hands[1:], 1):
        several = one if isinstance(one, list) else [] if one is None else [one]
        seen.append(own.among(several, k / rate) is not None)
    return seen, own


def swung(speed, seconds=3.0, rate=RATE, amplitude=0.25):
    """A hand that is waved, at most `speed` m/s, over 2 · `amplitude` m."""
    t = np.arange(0.0, seconds, 1.0 / rate)
    way = amplitude * PX * np.sin(speed / amplitude * t)
    return [at((x, 0.3 * x), curl=0.4 * np.sin(3 * now) ** 2) for x, now in zip(way, t)]


@pytest.mark.parametrize("rate", (15.0, 30.0, 60.0))
@pytest.mark.parametrize("speed", (0.3, 1.0, 2.5))
def test_a_hand_that_is_waved_stays_the_same(speed, rate):
    assert all(followed(swung(speed, rate=rate), rate)[0])


def test_a_fast_flick_a_hasty_turn_and_a_push_to_the_camera_stay_the_same():
    flick = [at((x, 0)) for x in np.cumsum([0, 20, 80, 150, 190, 150, 80, 20])]  # 5.7 m/s
    turn = [at((0, 0), degrees=d) for d in (0, 30, 75, 120, 150, 130, 90, 30, -30)]  # 24 rad/s
    push = [at((0, 0), scale=s) for s in (1.0, 1.15, 1.4, 1.7, 2.0, 1.7, 1.3, 1.0, 0.8, 0.65)]
    for pictures in (flick, turn, push):
        assert all(followed(pictures)[0])


def test_a_palm_that_leans_to_the_camera_stays_the_same():
    upright = hand()
    lean = []
    # of its length, as the camera sees it
    for share in (1.0, 0.8, 0.5, 0.25, 0.15, 0.3, 0.6, 0.85, 1.0):
        points = upright.points.copy()
        points[:, 1] = 400 + share * (points[:, 1] - 400)
        lean.append(Hand(points, "right"))
    assert all(followed(lean)[0])


def test_missed_pictures_and_noise_end_nothing():
    rng = np.random.default_rng(1)
    waved = swung(2.5)
    noisy = [Hand(one.points + rng.normal(0, 3, one.points.shape), one.side) for one in waved]
    missed = [one if k == 0 or k % 5 else None for k, one in enumerate(noisy)]
    seen, own = followed(missed)
    assert all(got == (one is not None) for got, one in zip(seen, missed[1:])) and not own.other


def test_a_side_that_is_mistaken_for_a_picture_or_two_ends_nothing():
    sides = "rrrlrrrrllrrrrrlrlrrrr"
    pictures = [at((3 * k, 0), "left" if side == "l" else "right") for k, side in enumerate(sides)]
    assert all(followed(pictures)[0])


def test_a_side_that_stays_changed_is_another_hand():
    seen, own = followed([at((0, 0))] * 5 + [at((20, 0), "left")] * 6)
    assert seen[4:] == [True] * SIDES + [False] * (6 - SIDES) and own.other


OTHERS = {
    "far away and smaller": at((-390, -200), "left", 0.6),
    "of the same side, far away": at((250, 0)),
    "of the same side and place, twice as large": at((0, 0), scale=2.0),
    "of the same place, half as large": at((0, 60), scale=0.5),
    "upside down in the same place": at((0, -100), degrees=180.0),
    "from the side": at((60, 0), "left", degrees=100.0),
}


@pytest.mark.parametrize("name", OTHERS)
def test_another_hand_from_one_picture_to_the_next_is_no_hand(name):
    other = OTHERS[name]
    seen, own = followed([at((0, 0))] * 5 + [other] * 3)
    assert seen == [True] * 4 + [False] * 3 and own.other
    back = own.among([at((5, 0))], 8 / RATE)
    assert back is not None and not own.other, "the own hand is still there: it goes on"


def test_hands_that_change_in_every_second_picture_drive_by_the_own_one_alone():
    other = at((-390, -200), "left")
    seen, _ = followed([at((k, 0)) if k % 2 == 0 else other for k in range(40)])
    assert seen == [k % 2 == 0 for k in range(1, 40)]


def test_of_two_hands_in_a_picture_the_own_one_drives_also_when_they_cross():
    way = np.linspace(0, 400, 40)
    pictures = [at((0, 0))]
    for x in way[1:]:
        own, other = at((x, 0)), at((400 - x, 10), "left")
        surer = Hand(other.points, other.side, 1.0)
        pictures.append([surer, Hand(own.points, own.side, 0.6)])
    follow = OwnHand()
    follow.begin(pictures[0], 0.0)
    for k, both in enumerate(pictures[1:], 1):
        assert follow.among(both, k / RATE) is both[1]


def test_a_hand_that_leaves_and_another_that_enters_after_a_moment():
    gone = [at((0, 0))] * 3 + [None] * 3
    for other in (at((600, 0)), at((30, 0), scale=2.6), at((500, 50), "left")):
        seen, own = followed([*gone, other, other])
        assert not any(seen[2:]) and own.other


def test_landmarks_that_are_no_numbers_are_no_hand_and_not_another():
    broken = hand()
    object.__setattr__(broken, "points", np.full((21, 2), np.nan))
    seen, own = followed([hand(), broken, [broken, hand()], broken])
    assert seen == [False, True, False] and not own.other


def test_no_press_follows_whichever_is_surest():
    one, two = Hand(hand().points, "right", 0.4), Hand(hand().points, "left", 0.9)
    assert OwnHand().among([one, two], 1.0) is two and OwnHand().among([], 1.0) is None


def moved(seen, shift, scale=1.0, side="left"):
    """Another hand than that of `driving.hand`."""
    return Hand(300 + scale * (seen.points - 300) + shift, side)


@pytest.mark.parametrize("side", ("left", "right"))
def test_another_hand_before_the_camera_holds_and_asks_for_a_new_press(side):
    with Session().running() as s:
        s.presses()
        s.finder.hands = [moved(shown(aside=0.35, forward=0.3), (-390, -200), 0.6, side)]
        s.stays_lost(ANOTHER)
        assert np.abs(angles(s.bus) - HOME).max() < 60, "it was not led by the other hand"
        assert s.drive.account.lost == {ANOTHER: 1} and not torque(s.bus)
        s.lets_go()
        time.sleep(0.3)
        s.presses()  # whose hand it is now
        s.finder.hands = [
            moved(shown(aside=0.35 + 0.35 / 16, forward=0.3), (-390, -200), 0.6, side)
        ]
        s.stands([1.0, 0.0])


def test_the_own_hand_goes_on_while_another_shows_in_every_second_picture():
    with Session().running() as s:
        s.presses()
        own, other = shown(aside=0.35 / 16), moved(shown(aside=-0.3, forward=0.3), (-390, -200))
        number = 0

        def see(picture, t):
            nonlocal number
            number += 1
            return [own if number % 2 else other]

        s.finder.see = see
        s.stands([1.0, 0.0])
        time.sleep(0.5)
        assert s.moment.clutch.stage == "driving" and np.abs(s.moment.led - [1.0, 0.0]).max() < 0.2


@pytest.fixture
def link(tmp_path):
    """Give a sender of landmarks and a function that makes eyes which hear it."""
    path = tmp_path / "teleop.key"
    new_key(path)
    key = read_key(path)
    with (
        Receiver("127.0.0.1", 0, key) as receiver,
        Sender("127.0.0.1", receiver.port, key) as sender,
    ):
        yield sender, lambda view: RemoteHandSource(receiver, view)


@pytest.mark.parametrize("which", ("any", "right"))
def test_another_hand_over_udp_is_no_hand_either(link, which):
    """The output of the eyes is the input of `Drive`: all hands that may drive, and of them the own
    one.
    """
    sender, eyes_of = link
    own, other = shown(), moved(shown(aside=0.3), (-390, -200), 0.6)
    follow, kept = OwnHand(), []
    with eyes_of(View(which)) as eyes:
        begun, number = time.monotonic(), -1
        while len(kept) < 30 and time.monotonic() - begun < 20:
            sender.send(Message(own if len(kept) < 10 else other, True))
            eyes.wait(number, 0.05)
            sight = eyes.newest()
            if sight is None or sight.number == number:
                continue
            number = sight.number
            if not kept and sight.hand is not None:
                follow.begin(sight.hand, sight.t)
            kept.append(follow.among(sight.hands, sight.t) is not None)
    assert all(kept[:10]) and not any(kept[11:])
    assert follow.other == (which == "any"), "of the left hand alone `--hand right` sees nothing"
