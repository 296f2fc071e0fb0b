"""The slice *odd*: many smooth maps that are not affine, laws that follow their formula, traps with
a right answer.
"""

import numpy as np
import pytest

from benches.bank.case import case, seen
from benches.bank.law import Record
from benches.bank.laws_motion import Hum, SpeedyPlay, StickSlip, played
from benches.bank.laws_odd import UNKNOWN_LAWS, BendingNoise, TimelyGain, profile
from benches.bank.laws_static import CROSSED, FORMS, CrossTerm, SmoothMap, bent, rises
from benches.bank.laws_wear import Clutch, Torn, WarmCreep
from benches.bank.odd import TRAPS, curved_share, odd_case
from benches.bank.shop import ODD_FAMILY
from benches.bank.watch import rms, sections
from softmap_edge.run.protocol import standard_protocol

T = np.arange(0.0, 60.0, 0.02)
GRAVITY = np.where((T < 30.0)[:, None], [0.0, 0.0, 1.0], [0.6, 0.0, 0.8])


def wave():
    return np.stack(
        [11.0 * np.sin(1.8 * T) * T / T[-1], 11.0 * np.sin(1.3 * T + 1.0) * T / T[-1]], axis=1
    )


def record(u):
    return Record(T, u, 22.0 + 9.0 * T / T[-1], GRAVITY)


def test_there_are_at_least_forty_smooth_maps_and_each_is_another():
    rng, protocol = np.random.default_rng(0), standard_protocol(2)
    maps = [SmoothMap.of(number, rng, 2) for number in range(48)]
    assert len({(one.form, one.amount, one.cable) for one in maps}) >= 40 and len(FORMS) == 15
    moves = np.array([one.added(protocol.command[::50]).ravel() for one in maps])
    moves /= np.linalg.norm(moves, axis=1, keepdims=True)
    alike = np.abs(moves @ moves.T) - np.eye(48)
    assert np.median(alike) < 0.5 and np.mean(alike.max(axis=1) < 0.999) > 0.8


@pytest.mark.parametrize("form", FORMS)
def test_a_map_is_smooth_memoryless_zero_at_home_and_more_than_offset_and_gain(form):
    u = np.linspace(-12.0, 12.0, 4001)[:, None] * np.ones((1, 2))
    law = SmoothMap(form, (0.1, 0.05), 1.4, 0.7)
    line = Record(np.arange(4001.0), u, np.full(4001, 22.0))
    out = law.drive(line, u)
    assert np.abs(out[2000]).max() < 1e-9
    slope = np.gradient(out[:, 0], u[:, 0])
    assert np.abs(np.diff(slope)).max() < 0.02  # mm/mm from step to step of 6 µm
    shuffled = np.random.default_rng(0).permutation(4001)
    assert np.allclose(law.drive(line, u[shuffled]), out[shuffled])
    assert curved_share(law) > 0.1


@pytest.mark.parametrize("form", CROSSED)
def test_a_cross_term_needs_both_channels(form):
    u = wave()
    law, alone = CrossTerm(form, (0.2, 0.0), 1.0), u * [0.0, 1.0]
    out = law.drive(record(u), u)
    assert np.all(out[:, 1] == u[:, 1]) and np.abs(out - u).max() > 0.1
    if form not in ("other squared", "other cubed", "soft neighbour"):
        assert np.abs(law.drive(record(alone), alone) - alone).max() < 1e-9


def test_what_offsets_and_gains_can_do_is_not_bent():
    u = wave()
    assert bent(u, 1.2 * u + 0.5) < 1e-9
    assert bent(u, u + 0.1 * np.sign(u) * u**2) == pytest.approx(
        bent(u, u + 0.3 * np.sign(u) * u**2)
    )
    assert bent(u, u + 0.01 * u**2) > 0.5


@pytest.mark.parametrize("kind", UNKNOWN_LAWS, ids=lambda kind: kind.__name__)
def test_an_unknown_law_acts_and_does_nothing_without_strength(kind):
    law, u = kind.draw(np.random.default_rng(5), 2), wave()

    def moved(law):
        driven = law.drive(record(u), u)
        both = np.concatenate([driven, -driven], axis=1)
        return np.abs(law.pull(record(u), both) - np.concatenate([u, -u], axis=1)).max()

    assert moved(law.scaled(1e-9)) < 1e-6 < 0.05 < moved(law.scaled(3.0))
    assert ODD_FAMILY[law.NAME]


def test_laws_are_what_their_formulas_say():
    u = wave()
    plain = record(u)
    hum = Hum((0.0, 2.0), 0.5, 0.0).drive(plain, u) - u
    assert np.abs(hum[:, 0]).max() == 0.0 and hum[:, 1] == pytest.approx(
        2.0 * np.sin(np.pi * T), abs=1e-9
    )
    stuck = StickSlip((1.0, 1.0), 0.0).drive(plain, u)
    assert np.abs(stuck - u).max() <= 1.0 + 1e-9 and np.mean(np.diff(stuck[:, 0]) == 0.0) > 0.5
    slow = np.repeat(np.linspace(0.0, 10.0, len(T))[:, None], 2, axis=1)
    late = slow - SpeedyPlay(1.0, 0.1, 0.05).drive(record(slow), slow)
    assert late[-1] == pytest.approx([0.1 + 0.05 * 10.0 / T[-1]] * 2, rel=1e-2)
    assert played(slow, np.array([0.5, 0.0]))[-1] == pytest.approx([9.5, 10.0])
    cold = Record(T, u, np.full(len(T), 22.0), GRAVITY)
    assert (
        np.all(WarmCreep(0.4, 5.0).drive(cold, u) == u)
        and rms(WarmCreep(0.4, 5.0).drive(plain, u) - u) > 0.2
    )
    slipped = Clutch((4.0, 0.0)).drive(plain, u)
    assert np.abs(slipped[:, 0]).max() <= 8.0 + 1e-9 and np.all(slipped[:, 1] == u[:, 1])
    torn = Torn(0, 0.5, 12.0).pull(plain, np.concatenate([u, -u], axis=1))
    assert torn[T > 31.0, 0].max() <= 0.0 < torn[T < 29.0, 0].max()
    gain = TimelyGain(0.2, "step").drive(plain, u)
    assert np.all(gain[T < 30.0] == u[T < 30.0]) and gain[-1] == pytest.approx(1.2 * u[-1])
    for course in ("ramp", "step", "exponential"):
        assert profile(course, T)[0] == 0.0 and profile(course, T)[-1] > 0.98
    # it begins at the command
    assert np.all(BendingNoise((1.0, 1.0), 20.0, 3).drive(plain, u)[0] == u[0])


def test_traps_have_an_answer_and_a_temperature_goes_with_time_only_by_chance():
    heated = odd_case("development", "real", "trap", 1)
    assert heated.hidden == ("timely_gain",) and heated.answers[0].names == ()
    assert np.corrcoef(heated.room(T), T)[0, 1] == pytest.approx(1.0)
    still = odd_case("development", "real", "trap", 3)
    assert (
        still.hidden == ("still",)
        and "identified" not in still.answers[0].verdicts
        and still.moved_mm[0] > 5.0
    )
    assert len(TRAPS) == 10


def test_maps_bend_the_finger_by_what_offsets_and_gains_cannot_do():
    mine, protocol = odd_case("development", "maps", "unknown", 5), standard_protocol(2)
    plain = seen(mine.body, (), protocol, False, every=8, rough=True)
    moved = rms(
        sections(
            seen(mine.body, mine.laws, protocol, False, every=8, rough=True) - plain,
            mine.body.place,
        )
    )
    assert (
        moved == pytest.approx(mine.moved_mm[0], rel=0.25)
        and moved * curved_share(mine.laws[0]) > 0.35
    )
    assert mine.answers[0].families == ("static map",) and mine.answers[0].names == ()
    assert rises(mine.laws[0]) and not rises(SmoothMap("soft dead zone", (1.2, 0.1), 1.0, 0.0))
    assert SmoothMap("soft dead zone", (0.6, 0.1), 1.0, 0.0).scaled(2.0).amount[0] == pytest.approx(
        0.85, abs=0.06
    )


def test_cases_are_pure_and_pairs_hide_a_known_law_next_to_an_unknown_one():
    one, two = (odd_case("development", "real", "pair", 1) for _ in range(2))
    assert one.to_dict() == two.to_dict() and len(one.hidden) == 2
    assert sorted(bool(answer.names) for answer in one.answers) == [False, True]
    assert case("development", "A", "real", "single", 8).answers[0].names == ("backlash",)
    with pytest.raises(KeyError, match="no kind 'rivals'"):
        odd_case("development", "real", "rivals", 0)
