"""A body that moves by a small share of what its commands should move it hardly follows them;
dead zones, plays and dead channels do.
"""

import numpy as np
import pytest
from test_remembered import MODEL, idle, played, seen_by, sine, wandering

from softmap_edge.checks.leverage import hardly_follows
from softmap_edge.cli import main
from softmap_edge.comparison.comparison import still


def share(size):
    return lambda u, half: size * u


def dead(size):
    return lambda u, half: idle(u, size * half)


def play(size):
    return lambda u, half: np.stack(
        [played(u[:, [c]], size * half[c])[:, 0] for c in range(u.shape[1])], axis=1
    )


def late(u, half):
    return np.roll(u, 60, axis=0)


HARDLY = {f"{size:g} of the motion": share(size) for size in (0.02, 0.04, 0.1, 0.2)}
HARDLY |= {"with a little play": lambda u, half: 0.05 * play(0.2)(u, half)}
FOLLOWS = {f"{size:g} of the motion": share(size) for size in (0.4, 0.5, 1.0)}
FOLLOWS |= {f"a dead zone of {size:g}": dead(size) for size in (0.3, 0.5, 0.7, 0.9)}
FOLLOWS |= {f"a play of {size:g}": play(size) for size in (0.5, 1.0, 1.6, 1.9)}
FOLLOWS |= {"one dead channel": lambda u, half: u * [1.0, 0.0], "a delay": late}


def run_of(motion, acting, noise):
    t, u = motion()
    return seen_by(t, u, acting(u, 0.5 * np.ptp(u, axis=0)), noise)


def finding(run):
    seen = np.asarray(run.vertices, float)
    at = np.stack([np.interp(run.t_seen, run.t, column) for column in run.command.T], axis=1)
    visible = np.ones(seen.shape[:2], bool)
    return hardly_follows(at, seen, visible, np.asarray(MODEL.predict(run), float))


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.3])
@pytest.mark.parametrize("motion", [sine, wandering])
@pytest.mark.parametrize("name", HARDLY)
def test_a_small_share_of_the_motion_hardly_follows(name, motion, noise):
    assert "% of the motion for each command" in finding(run_of(motion, HARDLY[name], noise))


@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("motion", [sine, wandering])
@pytest.mark.parametrize("name", FOLLOWS)
def test_what_effects_can_explain_follows(name, motion, noise):
    assert finding(run_of(motion, FOLLOWS[name], noise)) is None


def test_a_body_that_stands_still_does_not_move():
    for noise in (0.0, 0.05, 0.3):
        text = still(MODEL, run_of(wandering, share(0.0), noise))
        assert text.startswith("the commands change, but the points do not move"), text


SAID = {
    "still": (share(0.0), "the commands change, but the points do not move"),
    "4 %": (share(0.04), "the robot hardly follows its commands: the commands should move"),
    "10 %": (share(0.1), "the robot hardly follows its commands: the commands should move"),
    "half": (share(0.5), ""),
    "a play": (play(1.0), ""),
}


@pytest.mark.parametrize("name", SAID)
def test_compare_reports_a_body_that_hardly_moves(name, tmp_path, capsys):
    acting, said = SAID[name]
    run_of(wandering, acting, 0.1).save(tmp_path / "run.npz")
    assert main(["compare", str(tmp_path / "run.npz"), "--json"]) == 0
    lines = capsys.readouterr().err.splitlines()
    found = [line for line in lines if "drive is engaged" in line]
    assert len(found) == bool(said) and all(f"softmap compare: {said}" in line for line in found)
