"""The slice *shop*: friction along the body is hysteretic in shape, and imperfections have their
stated size.
"""

from dataclasses import replace

import numpy as np
import pytest

from benches.bank.answers import FAMILY
from benches.bank.bodies import body_of
from benches.bank.body_rod import guessed, hanging, template
from benches.bank.case import seen
from benches.bank.friction_rod import along, dragged
from benches.bank.imperfect import Rubber, Winding
from benches.bank.law import Past, Record
from benches.bank.laws_shop import SHOP, CableDrums, GuideFriction, SheathFriction, WornGear
from benches.bank.rod import TOLERANCE, Loads, balance, guides, settle
from benches.bank.section import finger
from benches.bank.shop import imperfections, shop_case
from benches.bank.watch import LEVELS, looked, rms, sections
from softmap_edge.run.protocol import HANGING, standard_protocol

T = np.arange(0.0, 30.0, 0.02)


def to_and_fro():
    """One channel up to 10 mm and back to 5 mm, and up again from -10 mm: seen at 5 mm both
    ways.
    """
    u = np.interp(T, [0.0, 10.0, 15.0, 30.0], [0.0, 10.0, 5.0, 5.0])
    return np.stack([u, 0.0 * u], axis=1)


def past_of(u, taken):
    return Past(
        T, np.concatenate([u, -u], axis=1), np.tile(HANGING, (len(T), 1)), np.asarray(taken, float)
    )


def test_friction_gives_the_base_more_of_the_bend_while_loading_and_less_while_unloading():
    u = to_and_fro()
    share = along(np.full(4, 0.3), 0.01, 0.2, past_of(u, [5.0, 15.0]), guessed)
    loading, unloading = share[:, 0]  # of the cable that is pulled
    assert np.all(np.diff(loading) <= 0.0) and loading[-1] < 0.9 and unloading[-1] > 1.0 / 0.9
    assert share[0, 2, -1] > 1.0  # the opposite cable is paid out: it slides the other way
    loads, design = hanging(np.tile([5.0, 0.0], (2, 1))), finger(1)
    plain = settle(design, loads, guessed(loads.pull))
    found = dragged(design, replace(loads, tension=share), plain)
    base, tip = (
        np.linalg.norm(sections(found.points(design, *template()), template()[0])[:, k, :2], axis=1)
        for k in (2, -1)
    )
    # the tip leads
    assert tip[0] > 1.02 * tip[1] and (base / tip)[0] > 1.03 * (base / tip)[1], (base, tip)


def test_rods_with_friction_are_in_balance_and_without_it_they_are_those_without():
    u = np.random.default_rng(0).uniform(-9.0, 9.0, (8, 2))
    loads, design = hanging(u), finger(1)
    plain = settle(design, loads, guessed(loads.pull))
    even = dragged(
        design,
        replace(loads, tension=np.ones((8, 4, design.guide.shape[1] - 1))),
        guessed(loads.pull),
    )
    assert np.abs(even.x - plain.x).max() < 1e-4
    share = np.exp(-np.linspace(0.0, 0.4, design.guide.shape[1] - 1)) * np.ones((8, 4, 1))
    held = replace(loads, tension=share)
    found = dragged(design, held, plain)
    there = balance(design, held, found.x, found.frame)
    assert np.abs(there.slope[..., :3]).max() < TOLERANCE and np.abs(found.x - plain.x).max() > 0.2
    step = np.zeros_like(found.x)
    step[:, 1:] = np.random.default_rng(1).normal(size=step[:, 1:].shape) * 1e-6
    longer = [
        np.linalg.norm(np.diff(guides(design, x, found.frame), axis=2), axis=3)
        for x in (found.x + step, found.x)
    ]
    work = np.sum(share * (longer[0] - longer[1]), axis=2)  # of a small step: Σ T_j dℓ_j
    assert np.einsum("bnkc,bnk->bc", there.drawn[:, :, :3], step[:, 1:]) == pytest.approx(
        work, rel=1e-3, abs=1e-10
    )


def test_the_slides_of_the_finger_without_friction_are_near_those_with_it():
    protocol = standard_protocol(2)
    keep = protocol.t < 40.0
    u = protocol.command[keep]
    past = Past(
        protocol.t[keep],
        np.concatenate([u, -u], axis=1),
        protocol.gravity[keep],
        np.arange(1.0, 39.0, 1.0),
    )
    at = np.stack([np.interp(past.taken, past.t, column) for column in past.pull.T], axis=1)
    loads, design = Loads(at, np.tile(HANGING, (len(at), 1)), np.zeros((len(at), 3))), finger(1)
    plain = settle(design, loads, guessed(at))
    found = [
        dragged(
            design,
            replace(loads, tension=along(np.full(4, 0.1), 0.01, 0.3, past, guessed, passes)),
            plain,
        )
        for passes in (0, 1)
    ]
    moved, more = rms(found[0].x - plain.x), rms(found[1].x - found[0].x)
    assert moved > 0.15 and more < 0.4 * moved, (more, moved)


def test_laws_of_the_shop_are_what_their_formulas_say():
    ramp = np.tile(np.minimum(T, 10.0)[:, None], (1, 2))
    record = Record(T, ramp, np.full(len(T), 22.0))
    gear = WornGear((0.5, 0.0), 8.0, (0.0, 0.0)).drive(record, ramp)
    assert gear[450, 1] == ramp[450, 1] and 0.4 - 1e-9 <= ramp[450, 0] - gear[450, 0] <= 0.6 + 1e-9
    pull = np.concatenate([ramp, -ramp], axis=1)
    held = SheathFriction((0.1, 0.2, 0.1, 0.1), 2.0).pull(record, pull)
    # the limit grows with the pull
    slid = [1.0 - (2.0 / 11.0) ** ((1.0 - mu) / (2.0 * mu)) for mu in (0.1, 0.2)]
    assert pull[450, :2] - held[450, :2] == pytest.approx(
        [0.1 * 11 * slid[0], 0.2 * 11 * slid[1]], rel=1e-2
    )
    assert held[450, 2] - pull[450, 2] == pytest.approx(0.1 * 2.0, rel=1e-2)  # it is paid out
    drums = CableDrums((0.1, 0.0, 0.2, 0.0), 75.0).pull(record, pull)
    assert drums[450] - pull[450] == pytest.approx(
        [0.1 * 9.0, 0.0, -0.2 * 9.0, 0.0], rel=5e-3, abs=1e-9
    )
    wound = Winding((0.3, 0.0), (0.0, 0.0), (0.0, 0.5), 4.0, (0.5, 0.0, 0.0, 0.0)).drive(
        record, ramp
    )
    assert wound[0] == pytest.approx([0.0, 0.0]) and wound[450, 1] - 9.0 == pytest.approx(
        0.5 * 81 / 4
    )
    rubber = Rubber((0.1, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)).design(
        finger(1)
    )
    assert np.log(rubber.young / finger(1).young).max() == pytest.approx(0.1, rel=0.02)


@pytest.mark.parametrize("kind", SHOP, ids=lambda kind: kind.__name__)
def test_each_law_of_the_shop_has_a_family_and_grows_with_strength(kind):
    law = kind.draw(np.random.default_rng(3), 2)
    assert FAMILY[law.NAME] and law.scaled(2.0) != law
    assert law == kind.draw(np.random.default_rng(3), 2)


def test_imperfections_are_as_large_as_they_should_be_and_friction_moves_the_finger():
    body, protocol = body_of("shop"), standard_protocol(2)
    plain = seen(body, (), protocol, False, every=8)
    for wanted, seed in ((0.2, 0), (0.4, 1)):
        small = imperfections(body, wanted, np.random.default_rng(seed))
        moved = rms(sections(seen(body, small, protocol, False, every=8) - plain, body.place))
        assert moved == pytest.approx(wanted, rel=0.2) and len({type(law) for law in small}) == 8
    law = GuideFriction((0.4, 0.3, 0.4, 0.35), 0.01, 0.3)
    moved = sections(seen(body, (law,), protocol, False, every=8) - plain, body.place)
    assert rms(moved) > 0.3


def test_cases_of_the_shop_are_pure_and_move_the_finger_twice_its_background():
    one, two = (shop_case("development", "floor", "single", 0) for _ in range(2))
    assert one.to_dict() == two.to_dict() and one.hidden == ("backlash",)
    assert one.moved_mm[0] > 2.0 * one.background_mm() > 0.3
    assert 3.0 <= one.level.memory_s <= 10.0
    with pytest.raises(KeyError, match="no kind 'rivals'"):
        shop_case("development", "floor", "rivals", 0)


def test_the_frame_of_a_slow_camera_remembers_longer():
    t, points = np.arange(0.0, 240.0, 0.5), np.zeros((480, 4, 3))
    kept = []
    for memory in (1.0, 8.0):
        level = replace(
            LEVELS["easy"], shiver_mm=1.0, shiver_deg=0.0, point_mm=1e-6, memory_s=memory
        )
        x = looked(points, t, level, np.random.default_rng(2))[0][:, 0, 0]
        kept.append(np.corrcoef(x[:-4], x[4:])[0, 1])  # two seconds apart
    assert kept[0] < 0.4 < 0.6 < kept[1]
