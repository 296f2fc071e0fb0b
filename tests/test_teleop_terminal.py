"""The terminal as an input, read at a pseudo-terminal; and what the guard does, in words."""

import os
import pty
from pathlib import Path

import pytest

from softmap_edge.teleop import words
from softmap_edge.teleop.terminal import STEP, Terminal


@pytest.fixture
def typed():
    """Give a terminal and what types into it."""
    ours, theirs = pty.openpty()
    with Terminal("knob", theirs) as terminal:
        yield terminal, lambda text: os.write(ours, text.encode())
    os.close(ours)
    os.close(theirs)


def test_space_and_arrows_hold_while_they_repeat(typed):
    terminal, write = typed
    assert not terminal.controls(0.0).held
    write(" ")
    assert terminal.controls(1.0).held and not terminal.controls(3.0).held
    write("\x1b[C\x1b[C\x1b[A")
    now = terminal.controls(4.0)
    assert now.held and now.knob == pytest.approx((2 * STEP, STEP))
    terminal.rest((0.99, 0.0))
    write("dd")
    assert terminal.controls(5.0).knob == (1.0, 0.0), "never beyond the range"


def test_esc_stops_and_unknown_keys_do_nothing(typed):
    terminal, write = typed
    write(" \x1b[15~\x1b[H7")
    assert terminal.controls(0.0).held and terminal.asked() is None
    write("\x1b")
    assert not terminal.controls(0.1).held and terminal.asked() == "stop"
    write("qe")
    terminal.controls(0.2)
    assert terminal.asked() == "emergency"


def test_every_state_and_cause_of_the_guard_has_its_words():
    said = {words.sentence({"state": state, "cause": "late", "servo": 1}) for state in words.STATES}
    assert len(said) == len(words.STATES)
    assert "Holding where it is; it slackens soon: servo 2 did not answer in time" in said
    assert words.sentence({"state": "engaged", "cause": "deadman"}) == "Driving"
    assert "was released" in words.sentence({"state": "fault", "cause": "loop", "rescued": "it was released"})
    assert words.level("fault") == "fault" and words.level("nothing") == "off"
    assert words.limits({"slowed": True, "outside": False}) == ["as fast as allowed"]
    guard = (Path(__file__).parents[1] / "rust/servo/guard/mod.rs").read_text()
    causes = guard.split("pub enum Cause {")[1].split("}")[0]
    named = [line.strip(" ,").lower() for line in causes.splitlines() if line.strip() and "///" not in line]
    assert set(named) <= set(words.CAUSES), "a cause of the guard without words"


def test_why_driving_ended_is_said_once_and_with_what_leads_on():
    tripped = {"state": "fault", "cause": "tripped", "servo": 0}
    assert words.lost(tripped, words.sentence(tripped)) == "let go of the key, then reset the fault"
    held = {"state": "hold", "cause": "deadman"}
    assert words.lost(held, "no hand") == "driving ended: no hand; let go of the key and press it anew"
    unproved = {"state": "connected", "cause": "tripped"}
    assert "prove home anew" in words.lost(unproved, words.sentence(tripped))
