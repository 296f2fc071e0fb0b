"""The bank's rod is right by itself (closed forms, order, energy, symmetry) and agrees with the
finite elements.
"""

from dataclasses import replace

import numpy as np
import pytest

from benches.bank.rod import Loads, assembled, energy_of, settle, straight
from benches.bank.rotations import turn
from benches.bank.section import GRAVITY, finger, uniform
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Simulator

HANGING = np.array([0.0, 0.0, 1.0])


def pulled(u, gravity=HANGING):
    u = np.atleast_2d(u)
    return Loads(
        np.concatenate([u, -u], axis=1), np.tile(gravity, (len(u), 1)), np.zeros((len(u), 3))
    )


def bent(count, refine=1):
    """A finger pushed out of balance, and loads of every kind."""
    rng, design = np.random.default_rng(0), finger(refine)
    x = straight(design, count).x + 0.3 * rng.normal(size=(count, len(design.place), 3))
    frame = turn(0.05 * rng.normal(size=x.shape))
    x[:, 0], frame[:, 0] = 0.0, np.eye(3)
    design = replace(design, rest=0.01 * rng.normal(size=design.rest.shape))
    loads = Loads(
        *(rng.normal(size=(count, k)) * s for k, s in ((4, 5.0), (3, 1.0), (3, 1.0))),
        plane=(np.array([0.6, 0.8, 0.0]), 13.0),
    )  # fmt: skip
    return design, loads, x, frame


def test_forces_are_the_slope_of_the_energy_and_the_tangent_is_theirs():
    design, loads, x, frame = bent(2)
    force, (below, diagonal, above), cables, pull = assembled(design, loads, x, frame)
    h = 1e-5

    def moved(way):
        new = frame.copy()
        new[:, 1:] = turn(way[..., 3:]) @ new[:, 1:]
        return x + np.pad(way[..., :3], ((0, 0), (1, 0), (0, 0))), new

    rng = np.random.default_rng(1)
    for _ in range(5):
        way = h * rng.normal(size=force.shape)
        ends = [moved(sign * way) for sign in (1, -1)]
        rise = (energy_of(design, loads, *ends[0]) - energy_of(design, loads, *ends[1])) / 2
        assert rise == pytest.approx(np.sum(force * way, axis=(1, 2)), rel=1e-5)
        change = (assembled(design, loads, *ends[0])[0] - assembled(design, loads, *ends[1])[0]) / 2
        reported = np.einsum("bnij,bnj->bni", diagonal, way)
        reported[:, 1:] += np.einsum("bnij,bnj->bni", below, way[:, :-1])
        reported[:, :-1] += np.einsum("bnij,bnj->bni", above, way[:, 1:])
        reported += np.einsum(
            "bnkc,bc->bnk",
            cables,
            (pull > 0) * design.cable * np.einsum("bnkc,bnk->bc", cables, way),
        )
        # The terms left out of the tangent are of the order of one element's turn, here 0.1.
        assert np.linalg.norm(change - reported) < 3e-3 * np.linalg.norm(reported)


def test_a_cantilever_follows_the_elastica_at_second_order():
    """Tip of an inextensible cantilever at P L²/EI = 1, 2, 5, 10 (Bisshopp and Drucker 1945;
    Mattiasson 1981).
    """
    across, along = (
        np.array([0.30172, 0.49346, 0.71379, 0.81061]),
        np.array([0.05643, 0.16064, 0.38763, 0.55500]),
    )
    errors = []
    for elements in (8, 16, 32):
        rod = uniform(100.0, 0.5, 3000.0, elements)
        p = np.array([1, 2, 5, 10]) * 3000.0 * np.pi * 0.5**4 / 4 / 100.0**2
        tip = settle(
            rod, Loads(np.zeros((4, 4)), np.zeros((4, 3)), p[:, None] * [1.0, 0.0, 0.0])
        ).x[:, -1]
        errors.append(
            np.abs(np.stack([tip[:, 0] / 100 - across, 1 - tip[:, 2] / 100 - along])).max()
        )
    assert errors[-1] < 2e-4  # stretch and shear add 7e-5
    assert errors[0] > 7 * errors[2]


def test_a_rod_that_bends_evenly_is_an_arc():
    rod = uniform(100.0, 5.0, 0.5, 20)
    rod = replace(rod, rest=np.tile([0.0, 0.012, 0.0], (20, 1)))
    turned = Loads(np.zeros((1, 4)), np.zeros((1, 3)), np.zeros((1, 3)))
    place = np.linspace(0.0, 100.0, 41)
    line = settle(rod, turned).points(rod, place, np.zeros((41, 2)))[0]
    want = np.stack([1 - np.cos(0.012 * place), 0 * place, np.sin(0.012 * place)], axis=1) / 0.012
    # 2e-4 of the length: (ℓκ)²/24 and the arc inside an element
    assert np.abs(line - want).max() < 0.02


def test_the_finger_settles_at_second_order_and_its_own_error_is_stated():
    u = np.array([[9.0, 0.0], [12.0, 12.0], [-4.0, 7.0]])
    place = np.linspace(5.0, 115.0, 12)
    shape = [
        settle(finger(r), pulled(u)).points(finger(r), place, np.zeros((12, 2))) for r in (1, 2, 4)
    ]
    coarse, fine = (np.linalg.norm(shape[k] - shape[2], axis=2).max() for k in (0, 1))
    assert coarse < 0.08 and fine < 0.35 * coarse


def test_what_the_cables_pull_is_what_the_rod_stores():
    design, steps = finger(1), 61
    u = np.linspace(0.0, 12.0, steps)[:, None] * [1.0, 0.3]
    loads = pulled(u)
    poses = settle(design, loads)
    energy = energy_of(design, loads, poses.x, poses.frame)
    work = np.sum((poses.tension[1:] + poses.tension[:-1]) / 2 * np.diff(loads.pull, axis=0))
    assert energy[-1] - energy[0] == pytest.approx(work, rel=2e-4)


def test_opposite_pulls_are_mirrored_and_a_slack_cable_is_none():
    design = finger(1)
    tip = settle(design, pulled(np.array([[7.0, 3.0], [-7.0, -3.0], [-3.0, 7.0]]))).x[:, -1]
    assert tip[1] == pytest.approx(tip[0] * [-1, -1, 1], abs=1e-5)
    assert tip[2] == pytest.approx([-tip[0, 1], tip[0, 0], tip[0, 2]], abs=1e-5)
    one, none = (
        pulled(np.array([[9.0, 0.0]])),
        replace(design, cable=design.cable * [1.0, 0.0, 0.0, 0.0]),
    )
    both = settle(replace(design, slack=np.array([0.0, 30.0, 30.0, 30.0])), one)
    assert both.tension[0, 1:] == pytest.approx(0.0) and both.x == pytest.approx(
        settle(none, one).x, abs=1e-5
    )


def test_a_weight_sags_as_a_beam_says_and_a_wall_stops_the_finger():
    rod = uniform(100.0, 8.0, 0.5, 20)
    p = 0.5 * GRAVITY
    tip = settle(rod, Loads(np.zeros((1, 4)), np.zeros((1, 3)), np.array([[p, 0.0, 0.0]]))).x[
        0, -1, 0
    ]
    bend, shear = p * 1e6 / (3 * 0.5 * np.pi * 8**4 / 4), p * 100 / (0.9 * 0.5 / 3 * np.pi * 8**2)
    assert tip == pytest.approx(bend + shear, rel=3e-3)
    free = settle(finger(1), pulled([[10.0, 0.0]]))
    stopped = settle(
        finger(1), replace(pulled([[10.0, 0.0]]), plane=(np.array([1.0, 0.0, 0.0]), 30.0))
    )
    assert free.x[0, -1, 0] > 40 and 20 < stopped.x[0, -1, 0] < 30


def test_it_bends_like_the_finite_elements_of_the_same_finger():
    """Fibres do not bulge and guides do not sink in: the rod is stiffer than the solid, and bends
    the same way.
    """
    u = np.array([[9.0, 0.0], [-6.0, 6.0], [0.0, -12.0]])
    solid = Simulator(Finger.builtin())
    rest = solid.template.vertices
    tip = rest[:, 2] > 100.0
    theirs = np.asarray(solid.path(u))[:, tip].mean(axis=1) - rest[tip].mean(axis=0)
    place, around = rest[tip][:, 2], rest[tip][:, :2]
    ours = settle(finger(1), pulled(u)).points(finger(1), place, around).mean(axis=1) - rest[
        tip
    ].mean(axis=0)
    cosine = (
        np.sum(ours * theirs, axis=1)
        / np.linalg.norm(ours, axis=1)
        / np.linalg.norm(theirs, axis=1)
    )
    assert np.all(cosine > 0.98)
    assert np.all(
        np.abs(np.linalg.norm(ours, axis=1) / np.linalg.norm(theirs, axis=1) - 1.0) < 0.25
    )


def test_a_pull_that_no_rod_holds_is_reported():
    with pytest.raises(ArithmeticError, match="do not settle"):
        settle(finger(1), pulled([[500.0, 0.0]]), straight(finger(1), 1), parts=100)
