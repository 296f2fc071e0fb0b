"""Stiffer stretches of an imported sweep: its fields against the bank's Cosserat rod,
solved again.
"""

import numpy as np
import pytest

from benches.bank.rod import Loads, settle
from benches.bank.section import finger, uniform
from softmap_edge.geometry.centreline import find_centreline
from softmap_edge.sweep.stiff_sections import NAMES, stretch_fields

MIDDLES = np.arange(7) / 6
CHANGES = {
    "gradient": 0.5 * (MIDDLES - 0.5),
    "middle": np.where(np.abs(MIDDLES - 0.5) < 0.2, 0.4, 0.0),
}


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("made", ["even", "tapered"])
def test_fields_of_stretches_explain_most_of_what_a_rod_with_other_stiffness_does(made, change):
    design = uniform(110.0, 9.0, 0.25, 20, cable=20.0, aside=6.0) if made == "even" else finger(1)
    length = design.place[-1]
    place, angle = (
        np.repeat(np.linspace(2.0, length, 13), 12),
        np.tile(np.arange(12) * np.pi / 6, 13),
    )
    radius = np.interp(place, design.middle, design.radius)
    around = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    u = np.vstack([np.zeros((1, 2)), np.random.default_rng(0).uniform(-10.0, 10.0, (6, 2))])
    loads = Loads(
        np.concatenate([u, -u], axis=1), np.tile([0.0, 0.0, 1.0], (7, 1)), np.zeros((7, 3))
    )
    shapes = settle(design, loads).points(design, place, around)
    rest, bent = shapes[0], shapes[1:]
    line = find_centreline(rest, np.zeros(3))
    fields = stretch_fields(line, bent, rest, 1.0)
    amount, share = CHANGES[change], design.middle / length * 6
    hats = [
        np.where(np.abs(share - k) < 1, np.cos(0.5 * np.pi * (share - k)) ** 2, 0.0)
        for k in range(7)
    ]
    other = design.stiffer(np.exp(amount @ np.array(hats)))
    truth = (settle(other, loads).points(other, place, around) - shapes)[1:]
    said = sum(a * fields[name] for a, name in zip(amount, NAMES))
    left = np.sum((truth - said) ** 2) / np.sum(truth**2)
    assert np.sqrt(np.mean(np.sum(truth**2, axis=2))) > 0.3 and left < 0.3, f"{left:.2f} left"
    # A body that is stiffer everywhere bends as it did.
    assert np.abs(sum(fields.values())).max() < 1e-9
