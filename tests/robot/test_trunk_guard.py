"""A real robot's day through the guard: the 15 001 commands of the trunk, no unsafe tick, and what
was limited.
"""

import csv
from pathlib import Path

import numpy as np
import pytest

from softmap_edge import _core
from softmap_edge.robot.servo.loop_limits import loop_limits, servo_limits

DATA = Path(__file__).parents[3] / "shared/data/trunk/control_inputs_controlled_1.csv"
TICKS_PER_DEGREE, HOME, RATE, STRIDE = 4096 / 360.0, 2048, 100.0, 5
FAR = 12  # ticks, one degree: what counts as limited

pytestmark = pytest.mark.skipif(
    not DATA.is_file(), reason="the trunk's recording (../shared/data) is not here"
)


def recorded():
    """Return the trunk's commands (15001, 6) as ticks."""
    with DATA.open(encoding="utf-8") as file:
        rows = [[float(value) for value in row[1:]] for row in list(csv.reader(file))[1:]]
    return HOME + np.array(rows) * TICKS_PER_DEGREE


def decided(targets, limits, sensed):
    """Let the guard decide: connect, home, arm, engage, then a target a period; positions (T, S)
    are what is sensed.
    """
    asked = ["connect", "home", "arm", "engage"]
    periods = []
    for k in range(len(targets) + len(asked)):
        target = targets[max(0, k - len(asked))].tolist()
        torque = k > len(asked)
        health = (0, torque, False) if k <= len(asked) or k % 20 == 0 else None
        clock = (10 * k) % 32768
        one = [(int(p), clock, 0.0, 12.0, 30.0, health) for p in sensed[k]]
        request = asked[k] if k < len(asked) else None
        periods.append(
            (round(k * 1e9 / RATE) + 1, one, k >= len(asked) - 1, target, True, request, False)
        )
    return _core.replay(limits, periods)[len(asked) :]


def judged(slew, acceleration, window):
    """Return targets and goals (T, 6) of the full day under limits."""
    targets = recorded()
    low, high = targets.min() - HOME, targets.max() - HOME
    servo = servo_limits("XM540-W270", HOME, (window * low, window * high))
    servo |= {"slew": slew, "acceleration": acceleration, "following": 400.0}
    limits = loop_limits([servo] * 6, RATE, jump=(20_000.0, 40_000.0))
    blind = loop_limits([servo | {"following": 4096.0}] * 6, RATE, jump=(20_000.0, 40_000.0))
    still = np.full((len(targets) + 4, 6), HOME)
    goals = np.array([goal for *_, goal in decided(targets, blind, still)])
    # Servos that follow: what is sensed is where they were sent a period ago.
    sensed = np.concatenate([still[:5], goals])[: len(still)]
    reported = decided(targets, limits, sensed)
    assert all(state == "engaged" and torque for state, _, torque, _ in reported[1:]), {
        t[:2] for t in reported
    }
    assert (np.array([goal for *_, goal in reported]) == goals).all()
    return targets, goals, servo, limits


def unsafe(goals, servo):
    """Return how many goals lie outside the window or pass slew or acceleration, with a tick for
    rounding.
    """
    moves = np.diff(goals, axis=0, prepend=np.full((1, 6), HOME))
    # Over five periods to both sides, where rounding counts little.
    turns = goals[2 * STRIDE :] - 2 * goals[STRIDE:-STRIDE] + goals[: -2 * STRIDE]
    outside = (goals < servo["low"]) | (goals > servo["high"])
    fast = np.abs(moves) > servo["slew"] / RATE + 1
    hard = np.abs(turns) > servo["acceleration"] * (STRIDE / RATE) ** 2 + 2
    return int(outside.sum()), int(fast.sum()), int(hard.sum())


def test_the_day_passes_with_no_unsafe_tick_and_what_is_limited_is_counted(capsys):
    targets, goals, servo, limits = judged(slew=2000.0, acceleration=40_000.0, window=1.0)
    assert len(targets) == 15_000 and unsafe(goals, servo) == (0, 0, 0)
    clipped = np.clip(targets, servo["low"], servo["high"])
    late = np.abs(goals - clipped) > FAR
    with capsys.disabled():
        print(
            f"\nthe trunk's commands: {late.any(axis=1).sum()} of {len(goals)} periods limited by "
            "more than a degree",
            end=" ",
        )
        print(
            f"(servos {late.sum(axis=0).tolist()}), never more than "
            f"{np.abs(goals - clipped).max():.0f} ticks behind"
        )
    # After the ramp at engaging, goals are never far behind for long.
    assert np.abs(goals - clipped)[200:].max() < 400


def test_tighter_limits_are_kept_too_and_without_them_the_day_breaks_them():
    targets, goals, servo, _ = judged(slew=1500.0, acceleration=3000.0, window=0.7)
    assert unsafe(goals, servo) == (0, 0, 0)
    raw = np.rint(targets).astype(int)
    assert min(unsafe(raw, servo)) > 100, (
        "the commands themselves keep within the limits: the test proves nothing"
    )
