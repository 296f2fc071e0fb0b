"""Laws whose numbers change within a run: the change is reported with its condition, constant laws
are left alone.
"""

from dataclasses import replace

import numpy as np
import pytest
from finger_runs import finger_run
from two_levels import played

from softmap_edge import Run, builtin_model, diagnose
from softmap_edge.run.protocol import standard_protocol

MODEL = builtin_model()


def warming(t):
    """°C: the room warms and cools twice, so that it is neither the time nor the drift of a
    warm-up.
    """
    return 22.0 + 6.0 * np.sin(4.0 * np.pi * (t - t[0]) / np.ptp(t))


def warm_run(acting) -> Run:
    """A run in that room; `acting(command, t, temperature)` is the command that acts."""
    t = standard_protocol(2).t
    run = finger_run(acting=lambda u: acting(u, t, warming(t)))
    return replace(run, temperature=warming(t))


def loosened(u, gaps):
    """Commands behind one play whose width (T,) changes."""
    out, y = np.empty_like(u), u[0].copy()
    for k, (row, gap) in enumerate(zip(u, gaps)):
        y = out[k] = np.clip(y, row - gap / 2, row + gap / 2)
    return out


def crept(u, t, share):
    """Commands with a share (T,) of what follows them in 20 s on top."""
    slow = u.copy()
    for k in range(1, len(u)):
        slow[k] = u[k] + (slow[k - 1] - u[k]) * np.exp(-(t[k] - t[k - 1]) / 20.0)
    return u + share[:, None] * slow


HIDDEN = {
    "play that opens with the temperature": (
        lambda u, t, c: loosened(u, 0.15 * (c - 15.0)),
        "temperature",
    ),
    "play that is lost with time": (lambda u, t, c: loosened(u, 2.0 * (1.0 - t / t[-1])), "time"),
}


@pytest.mark.parametrize(
    "name",
    [
        "play that opens with the temperature",
        pytest.param("play that is lost with time", marks=pytest.mark.long),
    ],
)
def test_a_law_that_changes_is_not_identified(name):
    acting, condition = HIDDEN[name]
    found = diagnose(MODEL, warm_run(acting))
    assert found.verdict == "partly_explained" and found.families[0].law == "unknown"
    assert f"change with the {condition}" in found.sentence
    assert any(set(block.settles) & {e.name for e in found.effects} for block in found.next)


CONSTANT = {
    "play": (lambda u, t, c: played(u, [1.2, 1.2]), "backlash"),
    "creep": (lambda u, t, c: crept(u, t, np.full(len(t), 0.1)), "creep"),
}


@pytest.mark.parametrize("name", CONSTANT)
def test_a_constant_law_is_identified_in_the_same_room(name):
    acting, effect = CONSTANT[name]
    found = diagnose(MODEL, warm_run(acting))
    assert {e.name for e in found.effects} == {effect} and found.families[0].law == "identified"
    assert "change with" not in found.sentence
