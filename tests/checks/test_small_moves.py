"""The remark on commands that hardly move names what may be the cause."""

from dataclasses import replace

import numpy as np
import pytest

from softmap_edge import builtin_model
from softmap_edge.checks.match import declaration_remarks
from softmap_edge.run.run import Run

MODEL = builtin_model()
T = np.arange(80) / 10
WAVES = {
    "sines": np.stack([np.sin(T), np.cos(1.3 * T)], axis=1),
    "stairs": np.repeat(np.random.default_rng(0).uniform(-1, 1, (8, 2)), 10, axis=0),
    "one channel": np.stack([np.sin(2 * T), 0 * T], axis=1),
}


def moved(waves, size):
    """A run whose commands move by `size` mm, and whose points follow the model."""
    run = Run(t=T, t_seen=T, command=size * waves, robot=MODEL.robot, gravity=[0.0, 0.0, 1.0])
    noise = 0.05 * np.random.default_rng(1).normal(size=(len(T), len(MODEL.rest), 3))
    return replace(run, vertices=MODEL.predict(run) + noise)


def remark(run):
    found = [one for one in declaration_remarks(MODEL, run) if "the commands move by" in one]
    return "; ".join(found)


@pytest.mark.parametrize("name", WAVES)
def test_small_moves_of_body_and_commands_are_no_matter_of_units(name):
    text = remark(moved(WAVES[name], 0.1))
    assert "unit" not in text and "record larger ones" in text and "mm RMS" in text


@pytest.mark.parametrize("name", WAVES)
@pytest.mark.parametrize("lacks", ["the file was cut", "message 17 is not JSON"])
def test_a_recording_that_breaks_off_is_no_matter_of_units(name, lacks):
    run = replace(moved(WAVES[name], 0.1), extra={"damage": np.array(lacks)})
    text = remark(run)
    assert "unit" not in text and "the part of the recording that could be read" in text
    blind = replace(run, vertices=None, t_seen=np.zeros(0))
    assert "unit" not in remark(blind)


@pytest.mark.parametrize("name", WAVES)
def test_large_moves_of_the_body_alone_are_a_matter_of_units(name):
    run = moved(WAVES[name], 6.0)
    metres = replace(run, command=run.command / 1000)
    assert "if they are not in mm, set their unit in the mapping" in remark(metres)
    assert remark(run) == ""
