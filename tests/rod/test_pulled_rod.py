"""A robot whose commands pull one cable or the other: its map has a kink at home, which a
polynomial cannot follow.

The truth is written down here, apart from the code that is tested.
"""

from dataclasses import replace

import numpy as np
import pytest
from pulled_finger import finger
from rod_commands import commands

from softmap_edge import Run, load_bundle, save_bundle
from softmap_edge.model.polynomial_rod import PolynomialRodArrays
from softmap_edge.rod.learn import learn, learned_model


def recorded(seed=0, start=0.0, seconds=60.0, noise=0.1, shape=finger):
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, 0.02)
    u = commands(t + start)
    markers = shape(u)[::3]
    return Run(t=t, command=u, t_seen=t[::3], markers=markers + rng.normal(0, noise, markers.shape))


def test_a_finger_whose_cables_fall_slack_is_learned_by_the_pulls():
    run, other = recorded(), recorded(1, start=300.0)
    found = learn(run)
    assert (
        found.made_from["pulled"]
        and found.rod.pulled
        and "in the pulls of the cables" in str(found)
    )
    model = learned_model(run, found)
    error = np.sqrt(((model.predict(other) - finger(other.commands())[::3]) ** 2).sum(-1).mean())
    plain = learned_model(run, replace(found, rod=without_pulls(run)))
    missed = np.sqrt(((plain.predict(other) - finger(other.commands())[::3]) ** 2).sum(-1).mean())
    assert error < 0.15 and missed > 4 * error


def without_pulls(run):
    """The cubic rod of the same run, learned from commands that never pass zero: the same numbers,
    moved by 20 mm.
    """
    moved = replace(run, command=run.commands() + 20.0)
    rod = learn(moved, static=True, degree=3).rod
    assert not rod.pulled
    return replace(rod, centre=rod.centre - 20.0)


def test_a_polynomial_that_follows_the_robot_is_kept():
    angles = (
        np.array(
            [[0, 0, 0, 0], [5, 1, 3, 0], [0, 4, 1, 5], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]
        )
        / 10.0
    )
    lengths = np.zeros((15, 2))
    lengths[0] = 100.0, 80.0
    smooth = PolynomialRodArrays(
        np.zeros(3), np.zeros(2), np.full(2, 10.0), 2, angles, lengths, 1e-6
    )
    run = recorded(
        shape=lambda u: smooth.compiled().evaluate(np.ascontiguousarray(u)).reshape(len(u), 2, 3)
    )
    assert not learn(run).made_from["pulled"]


def test_pulls_go_with_the_bundle_and_older_bundles_have_none(tmp_path):
    run = recorded()
    model = learned_model(run, learn(run))
    save_bundle(model, tmp_path / "finger")
    again = load_bundle(tmp_path / "finger")
    assert np.array_equal(again.predict(run), model.predict(run))
    arrays = {
        k: v
        for k, v in learn(replace(run, command=run.commands() + 20.0)).rod.to_npz().items()
        if k != "pulled"
    }
    assert not PolynomialRodArrays.from_npz(arrays).pulled


@pytest.mark.parametrize("u", [(0.0, 0.0), (0.0, 3.0), (-4.0, 0.0)])
def test_slopes_at_a_kink_lie_between_those_of_both_sides(u):
    run = recorded()
    rod = learn(run).rod.compiled()
    at = rod.jacobian(np.array([u]))[0]
    sides = [
        rod.jacobian(np.array([u]) + side)[0]
        for side in ([1e-7, 0], [-1e-7, 0], [0, 1e-7], [0, -1e-7])
    ]
    low, high = np.min(sides, axis=0), np.max(sides, axis=0)
    assert np.all(at >= low - 1e-4) and np.all(at <= high + 1e-4)
