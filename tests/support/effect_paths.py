"""A circle of commands, and what an effect makes of it."""

import numpy as np
import pytest

from softmap_edge import Run, builtin_model

T = np.arange(0.0, 12.0, 0.02)


@pytest.fixture(scope="module")
def model():
    return builtin_model()


def circle(model, radius=6.0, turns=2.0):
    """Return targets on a circle about the rest tip, at heights that the finger has there."""
    rest = model.tip(np.zeros((1, 2)))[0]
    angle = turns * 2 * np.pi * np.minimum(T / 10.0, 1.0)
    grow = np.minimum(T / 1.0, 1.0)
    return rest + radius * np.stack([grow * np.cos(angle), grow * np.sin(angle), 0 * T], axis=1)


def executed(model, commands):
    """Return where the tip (T, 3) goes in a full prediction of a run of these commands."""
    run = Run(t=T, command=commands, t_seen=T, vertices=np.tile(model.rest, (len(T), 1, 1)))
    return model.predict(run)[:, model.tip_indices].mean(axis=1)
