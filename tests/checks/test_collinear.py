"""Conditions that follow time or the commands are reported, those that return are not; tied
channels are found.
"""

import numpy as np
import pytest
from logs import ROOT

from softmap_edge import Run
from softmap_edge.checks.advice import missing_data
from softmap_edge.checks.collinear import collinear_conditions, tied_channels
from softmap_edge.checks.summary import summary
from softmap_edge.checks.summary_text import sentences
from softmap_edge.diagnosis.diagnose import diagnose
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs, read_mapping
from softmap_edge.rod.learn import learn, learned_model
from softmap_edge.run.protocol import standard_protocol

P = standard_protocol()
SPAN = P.t[-1]


def run(**change):
    rng = np.random.default_rng(0)
    markers = 40 * rng.normal(size=(6, 3)) + 0.1 * rng.normal(size=(P.frames, 6, 3))
    return Run(
        **({"t": P.t, "command": P.command, "t_seen": P.t_seen, "markers": markers} | change)
    )


def found(**change):
    return {(c.condition, c.with_) for c in collinear_conditions(run(**change))}


def warmed(share):
    """A first-order system that is heated for a share of the run, then cools, with a noisy
    thermometer.
    """
    t, tau = P.t / SPAN, 0.2
    hot = np.where(
        t < share, 1 - np.exp(-t / tau), (1 - np.exp(-share / tau)) * np.exp(-(t - share) / tau)
    )
    return 22.0 + 9.0 * hot + 0.05 * np.random.default_rng(1).normal(size=len(t))


CONFOUNDED = {
    "in proportion": 20.0 + 10.0 * P.t / SPAN,
    "at once": np.where(P.t > 150.0, 27.0, 22.0),
    "heated to the end": warmed(1.0),
    "faster and faster": 20.0 + 8.0 * (P.t / SPAN) ** 2,
}


@pytest.mark.parametrize("how", CONFOUNDED)
def test_temperature_that_only_rises_is_time(how):
    reported = collinear_conditions(run(temperature=CONFOUNDED[how]))
    assert [(c.condition, c.with_) for c in reported] == [("temperature", "time")] and reported[
        0
    ].r2 >= 0.95
    assert "temperature and time cannot be distinguished in this run" in str(reported[0])
    assert "warm up and cool down" in str(reported[0])


@pytest.mark.parametrize("share", [0.35, 0.5, 0.65])
def test_warming_up_and_cooling_down_is_not_time(share):
    assert found(temperature=warmed(share)) == set()


def test_temperature_that_wanders_or_stays_is_not_confounded():
    rng = np.random.default_rng(3)
    assert found(temperature=rng.uniform(15.0, 40.0, len(P.t))) == set()
    # a change too small to have an effect
    assert found(temperature=22.0 + 0.02 * np.sin(P.t)) == set()
    assert found(temperature=25.0 + 5.0 * np.sin(2 * np.pi * P.t / 70.0)) == set()


def test_a_condition_that_follows_the_commands_is_reported():
    heat = 20.0 + 0.05 * P.command[:, 0] ** 2
    reported = collinear_conditions(run(temperature=heat))
    assert [(c.condition, c.with_) for c in reported] == [("temperature", "commands")]
    assert "repeat the same moves at another temperature" in str(reported[0])


def test_load_voltage_and_orientation_are_tested_too():
    assert ("load", "time") in found(load=np.where(P.t > 100.0, 10.0, 0.0))
    there_and_back = np.where((P.t > 60.0) & (P.t < 180.0), 10.0, 0.0)
    assert ("load", "time") not in found(load=there_and_back)
    assert ("voltage", "time") in found(extra={"voltage": 12.4 - 0.8 * P.t / SPAN})
    assert ("orientation", "time") in found(gravity=P.gravity)
    back = standard_protocol(back=True)
    rng = np.random.default_rng(0)
    both = Run(t=back.t, command=back.command, t_seen=back.t_seen, gravity=back.gravity,
               markers=30.0 * rng.normal(size=(back.frames, 4, 3)))  # fmt: skip
    assert not collinear_conditions(both)


def test_check_reports_them():
    document = summary(run(temperature=CONFOUNDED["in proportion"]))
    assert [c.condition for c in document.collinear] == ["temperature"]
    assert any("warm up and cool down" in line for line in sentences(document))
    assert summary(run()).collinear == []


# --- channels -----------------------------------------------------------------------------------


def tendons(count, seed=0):
    """Groups of three tendons at 120° that add up to zero, as on an arm: (T, 3 count)."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 60.0, 0.05)
    angle = np.radians([0.0, 120.0, 240.0])
    parts = []
    for _ in range(count):
        x, y = (
            10 * np.sin(2 * np.pi * rng.uniform(0.05, 0.3) * t + rng.uniform(0, 6))
            for _ in range(2)
        )
        parts.append(x[:, None] * np.cos(angle) + y[:, None] * np.sin(angle))
    return np.concatenate(parts, axis=1)


def test_tendons_that_add_up_to_zero_are_tied():
    (reported,) = tied_channels(tendons(1).round(3))
    assert reported.channels == (0, 1, 2) and reported.moving == 2
    assert reported.weights == pytest.approx((1.0, 1.0, 1.0), abs=1e-3)
    assert str(reported) == "channels 0, 1, 2 add up to 0 (2 of 3 directions move)"
    assert "each alone" in reported.remedy


def test_pretension_shows_in_the_sum():
    assert "channels 0, 1, 2 add up to 6 (2 of 3" in str(tied_channels(tendons(1) + 2.0)[0])


def test_each_group_of_an_arm_is_found_in_ticks():
    reported = tied_channels(np.rint(40 * tendons(3)))
    assert [(g.channels, g.moving) for g in reported] == [
        ((0, 1, 2), 2),
        ((3, 4, 5), 2),
        ((6, 7, 8), 2),
    ]


def test_pairs_and_proportions():
    u = tendons(1)[:, :2]
    assert (
        str(tied_channels(np.c_[u, u[:, :1]])[0])
        == "channels 0, 2 move together (1 of 2 directions move)"
    )
    assert str(tied_channels(np.c_[u, -u[:, :1]])[0]).startswith("channels 0, 2 add up to 0")
    (reported,) = tied_channels(np.c_[u[:, :1], 2.5 * u[:, :1], u[:, 1:]])
    assert "in proportion, 1 to 2.5" in str(reported)
    (every,) = tied_channels(np.outer(u[:, 0], [1.0, 2.0, -1.0]))
    assert every.channels == (0, 1, 2) and every.moving == 1 and every.weights == ()


def test_free_channels_are_not_tied():
    assert tied_channels(P.command) == []
    assert tied_channels(np.random.default_rng(0).normal(size=(500, 6)).cumsum(axis=0)) == []
    assert tied_channels(np.c_[P.command[:, 0], np.zeros(len(P.t))]) == []
    loose = tendons(1)
    loose[:, 2] += 3.0 * np.sin(np.arange(len(loose)) / 50.0)
    assert tied_channels(loose) == []


def test_check_and_diagnose_say_what_is_tied():
    command = np.interp(P.t, np.arange(0.0, 60.0, 0.05) * SPAN / 60.0, tendons(1)[:, 0])
    other = np.interp(P.t, np.arange(0.0, 60.0, 0.05) * SPAN / 60.0, tendons(1)[:, 1])
    tied = run(command=np.stack([command, other, -command - other], axis=1))
    poor = [w for w in summary(tied).cannot_tell if w.about == "channels"]
    assert (
        len(poor) == 1 and "channels 0, 1, 2 add up to 0 (2 of 3 directions move)" in poor[0].text
    )
    assert any("channels 0, 1, 2 add up" in text for text in missing_data([tied], P.frames, True))


def about_channels(command):
    return [w.text for w in summary(run(command=command)).cannot_tell if w.about == "channels"]


def free(count, seed=5):
    """Channels (T, count) that move independently of one another."""
    rng = np.random.default_rng(seed)
    return np.stack(
        [8 * np.sin(2 * np.pi * rng.uniform(0.01, 0.2) * P.t + k) for k in range(count)], axis=1
    )


def test_a_log_of_three_tendons_that_add_up_to_zero(tmp_path):
    path = ROOT / "tests" / "data" / "values" / "three.csv"
    (tmp_path / "map.toml").write_text(guess_mapping([path]).text)
    one = import_logs([path], read_mapping(tmp_path / "map.toml")).run
    words = summary(one)
    assert not any(w.about == "channels" for w in words.can_tell)
    (poor,) = [w for w in words.cannot_tell if w.about == "channels"]
    assert "channels 0, 1, 2 add up to 0 (2 of 3 directions move)" in poor.text
    assert "each alone" in poor.remedy and "differences" in poor.remedy
    fit = learn(one, degree=1, static=True)
    assert any("2 of 3 directions" in note and "stays at 0 mm" in note for note in fit.notes)
    found = diagnose(learned_model(one, fit), one, effects=["gain", "backlash"])
    assert any("channels 0, 1, 2 add up to 0" in remark for remark in found.remarks)


def test_each_pair_is_named_alongside_a_group():
    u = free(3)
    reported = about_channels(np.c_[u[:, :2], -u[:, 0] - u[:, 1], u[:, 2], u[:, 2]])
    assert (
        len(reported) == 2
        and "channels 0, 1, 2 add up to 0" in reported[0]
        and "channel 3 vs. channel 4" in reported[1]
    )


def test_every_pair_that_moves_together_is_named():
    u = free(2)
    reported = about_channels(np.c_[u, 2.0 * u[:, :1], -u[:, 1:]])
    assert (
        len(reported) == 2
        and "channel 0 vs. channel 2" in reported[0]
        and "channel 1 vs. channel 3" in reported[1]
    )


def test_one_channel_that_is_the_mean_of_four():
    u = free(4)
    (reported,) = about_channels(np.c_[u, u.mean(axis=1)])
    assert "channels 0, 1, 2, 3, 4 are tied" in reported and "(4 of 5 directions move)" in reported
    assert about_channels(u) == []
