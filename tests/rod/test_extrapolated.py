"""Where most of a run is unlike what a map was learned from, its error names no effect; where not
it still does.
"""

import numpy as np
import pytest
from recorded_arms import arc, wander

from softmap_edge import Run, diagnose, learn_model


def robot(u, gain=1.0, seed=0):
    """An arm that bends with its two commands (mm), three markers, 0.1 mm of noise."""
    t = 0.25 * np.arange(len(u))
    points = arc(gain * u) + np.random.default_rng(seed).normal(0.0, 0.1, (len(u), 3, 3))
    return Run(t=t, command=u, t_seen=t, markers=points, robot="arm")


def alone(size, count=480):
    """Commands of one channel at a time."""
    u = size * wander(0.25 * np.arange(count), 1.0)[:, :2]
    u[: count // 2, 0] = 0.0
    u[count // 2 :, 1] = 0.0
    return u


def together(size, count=360, seed=1):
    """Commands of both channels at once, in the corners of their range."""
    rng = np.random.default_rng(seed)
    corners = (
        size * rng.choice([-1.0, 1.0], (count // 12, 2)) * rng.uniform(0.7, 1.0, (count // 12, 2))
    )
    return np.repeat(corners, 12, axis=0)


@pytest.mark.parametrize(("learned", "asked"), [(9.0, 9.0), (6.0, 6.0), (5.0, 9.0)])
def test_an_error_of_extrapolation_names_no_effect(learned, asked):
    model = learn_model(robot(alone(learned)), static=True)
    found = diagnose(
        model, robot(together(asked), seed=2), effects=["gain", "backlash", "creep", "offset"]
    )
    assert found.error.model > 5.0 * model.vertex_error_mm, "the model is wrong there"
    assert found.verdict == "cannot_tell" and not (
        found.effects or found.families or found.alternatives
    )
    assert (
        "unlike what 'arm' was learned from" in found.sentence
        and "names no effect" in found.sentence
    )


def test_an_effect_is_named_where_the_model_knows_the_commands():
    both = np.vstack(
        [
            together(9.0, 240, seed=3),
            alone(9.0, 240),
            9.0 * wander(0.25 * np.arange(480), 1.0)[:, :2],
        ]
    )
    model = learn_model(robot(both), static=True)
    found = diagnose(
        model,
        robot(together(9.0), gain=1.2, seed=2),
        effects=["gain", "backlash", "creep", "offset"],
    )
    assert [effect.name for effect in found.effects] == ["gain"]
