"""`softmap check` doubts a body that is smaller than the pull of its tendons; no other run."""

from dataclasses import replace

import numpy as np
import pytest

from softmap_edge import Run
from softmap_edge.checks.summary import summary

T = np.linspace(0.0, 30.0, 600)
U = np.column_stack([np.sin(0.8 * T), np.sin(1.1 * T)])
REST = np.array([[0, 0, 30.0], [0, 0, 60], [0, 0, 95]])


def run(stroke=10.0, places=3, scale=1.0, **more):
    """A robot of 95 mm whose tip moves by 40 mm to each side."""
    share = (REST[:, 2] / 95) ** 2
    seen = REST + 40 * share[:, None] * np.column_stack([U, 0 * T])[:, None]
    seen = seen + 0.05 * np.random.default_rng(0).normal(size=seen.shape)
    reported = {"t": T, "command": stroke * U, "t_seen": T, "markers": scale * seen[:, -places:]}
    return Run(**(reported | more))


def doubts(one):
    return [line for line in summary(one).warnings if "look like cm" in line]


@pytest.mark.parametrize("places", [1, 2, 3])
def test_centimetres_are_doubted(places):
    (found,) = doubts(run(places=places, scale=0.1))
    assert "less than the 20 mm" in found and "`unit` in the mapping" in found
    assert doubts(run(places=places)) == []


def test_hidden_points_and_other_units_show_no_size():
    one = run(scale=0.1)
    markers = np.array(one.markers)
    markers[::7, 1] = 9999.0
    visible = np.ones(markers.shape[:2], bool)
    visible[::7, 1] = False
    assert len(doubts(replace(one, markers=markers, visible=visible))) == 1
    assert doubts(replace(one, command_unit="deg")) == []
    assert doubts(run(scale=0.1, command=np.zeros((600, 0)))) == []
