"""The enable keys and the clutch: nothing goes on by itself, whatever comes back."""

import pytest

from softmap_edge.robot.servo.terminal import FIRST, REPEAT, RepeatedKey
from softmap_edge.robot.teleop.clutch import PATIENCE, Clutch
from softmap_edge.robot.teleop.keys import LAPSE, HeldKey, Wish


def reported(key, *said):
    for down, now in said:
        key.say(down, now)
    return key


def test_a_key_that_is_reported_of_is_held_until_it_is_let_go_or_silent():
    key = reported(HeldKey(), (False, 0.0), (True, 0.1))
    assert key.held(0.1) and key.held(0.1 + LAPSE)
    assert not key.held(0.1 + LAPSE + 0.001), "a heartbeat that is late lets go"
    assert not reported(key, (False, 0.2)).held(0.2)


def test_who_comes_with_the_key_down_or_back_from_a_silence_must_press_again():
    key = reported(HeldKey(), (True, 0.0), (True, 0.1))
    assert not key.held(0.1), "it was not pressed for us"
    reported(key, (False, 0.2), (True, 0.3))
    assert key.held(0.3)
    reported(key, (True, 0.3 + 2 * LAPSE), (True, 0.4 + 2 * LAPSE))
    assert not key.held(0.4 + 2 * LAPSE)
    reported(key, (False, 0.5 + 2 * LAPSE), (True, 0.6 + 2 * LAPSE))
    assert key.held(0.6 + 2 * LAPSE)


def test_a_key_that_only_repeats_is_held_while_it_does():
    key = RepeatedKey()
    assert not key.held(0.0)
    key.press(1.0)
    assert key.held(1.0 + 0.9 * FIRST) and not key.held(1.0 + 1.01 * FIRST)
    assert not key.repeats(1.0), "a tap is not known to be held"
    key.press(1.5)
    assert key.repeats(1.5)
    key.press(1.53)
    assert key.held(1.53 + 0.9 * REPEAT) and not key.held(1.53 + 1.1 * REPEAT)
    key.press(1.6)
    key.let_go()
    assert not key.held(1.6)


def test_of_several_wishes_the_gravest_stays_and_none_is_queued():
    wish = Wish()
    for one in ("acknowledge", "emergency", "stop"):
        wish.ask(one)
    assert wish.take() == "emergency" and wish.take() is None


def run(*steps):
    clutch = Clutch()
    for step in steps:
        clutch = clutch.step(*step)
    return clutch


def test_a_press_drives_and_letting_go_ends_it():
    assert run((0.0, "page", "")).stage == "driving"
    assert run((0.0, "page", ""), (0.1, "", "")).stage == "released"


@pytest.mark.parametrize("back", ["", "no hand"])
def test_what_goes_while_driving_asks_for_a_new_press(back):
    lost = run((0.0, "page", ""), (0.1, "page", "no hand"), (5.0, "page", back))
    assert lost.stage == "lost" and lost.why == "no hand"
    assert lost.step(5.1, "", "").step(5.2, "page", "").stage == "driving"


def test_a_press_waits_for_what_is_lacking_but_not_for_long():
    assert run((0.0, "page", "no hand"), (0.5, "page", "")).stage == "driving"
    late = run(
        (0.0, "page", "no hand"), (PATIENCE + 0.1, "page", "no hand"), (PATIENCE + 0.2, "page", "")
    )
    assert late.stage == "lost"


def test_another_who_takes_hold_must_press_again():
    other = run((0.0, "page", ""), (0.1, "terminal", ""))
    assert other.stage == "lost" and other.why == "terminal took hold while page held"
    assert other.step(0.2, "terminal", "").stage == "lost"
    assert Clutch().lose("stop").stage == "released", "who holds nothing has nothing to lose"
