"""The terminal as an input, read at a pseudo-terminal."""

import os
import pty

import pytest

from softmap_edge.robot.teleop.terminal import STEP, Terminal


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
