"""A memory that was always in the robot: `learn` names it, with numbers and alternatives, or omits
it on request.

The truth is simulated apart from the effect library, or was recorded by others
(`../shared/data/memory`).
"""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from logs import published
from recorded_arms import (
    arc,
    growing_play,
    one_pole,
    play,
    recorded,
    segmented,
    wander,
    with_slack_tendons,
)

from softmap_edge import Run, learn_model, load_bundle, save_bundle
from softmap_edge.cli import main
from softmap_edge.model.basis import Basis
from softmap_edge.rod.covered_folds import search_folds
from softmap_edge.rod.learn import learn, learned_model
from softmap_edge.rod.memory import confirm
from softmap_edge.rod.memory.step import FittedEffect, Step
from softmap_edge.rod.reference_run import observe
from softmap_edge.rod.regression import Drive, Record
from softmap_edge.rod.signals import Family, families
from softmap_edge.rod.static_map import StaticMap

DEGREE_MM = np.pi * 100.0 / 180.0  # of the 100 mm circle of the ViO-Com files


# --- a finger of two servos, apart from the library -----------------------------------------------


@pytest.fixture(scope="module")
def loose():
    return recorded((1.4, 1.4))


@pytest.fixture(scope="module")
def found(loose):
    return learn(loose)


def test_play_that_was_always_there_is_named_with_its_numbers(found):
    (one,) = found.learned_in
    assert (one.name, one.family, one.law) == ("backlash", "memory", "identified")
    assert found.chain_names == ("backlash",)
    # which needs three numbers for the same share
    assert {other.name for other in one.alternatives} <= {"hysteresis"}
    (gap,) = one.params
    assert gap.value == pytest.approx(1.4, rel=0.03) and abs(gap.value - 1.4) < 4 * gap.sigma
    assert gap.unit == "mm" and not gap.at_bound
    assert one.after_mm < 0.3 * one.before_mm and found.error_mm < 0.3


def test_without_looking_for_memory_the_same_map_fails(loose, found):
    static = learn(loose, static=True)
    assert (
        static.chain_names == ()
        and static.learned_in == ()
        and static.error_mm > 3 * found.error_mm
    )


@pytest.mark.parametrize("seed", range(4))
def test_a_robot_without_memory_gets_nothing_into_its_chain(seed):
    tight = learn(recorded(seed=seed, noise=0.3))
    assert tight.chain_names == () and tight.learned_in == () and tight.notes == ()


def test_a_static_law_that_no_polynomial_holds_is_no_memory():
    """A dead zone of 4 mm: the map is wrong everywhere, but no memory is found."""
    t = np.arange(0.0, 90.0, 0.02)
    u = wander(t)
    markers = arc(np.sign(u) * np.maximum(np.abs(u) - 2.0, 0.0))[::3]
    markers = markers + np.random.default_rng(3).normal(0, 0.1, markers.shape)
    assert learn(Run(t=t, command=u, t_seen=t[::3], markers=markers)).chain_names == ()


@pytest.mark.long
@pytest.mark.parametrize(("seed", "frames"), [(38, 300), (4, 300), (19, 300), (9, 500)])
def test_a_short_log_of_an_arm_without_memory_gets_nothing_into_its_chain(
    seed, frames, monkeypatch
):
    """Some law among many fits the error of a bad map, also on blocks that were left out."""
    run = segmented(seed, 3, frames)
    assert learn(run).chain_names == ()
    monkeypatch.setattr(confirm, "unconfirmed", lambda *_: "")
    assert learn(run).chain_names != ()


@pytest.mark.long
def test_play_behind_such_a_map_is_named():
    (one,) = learn(segmented(4, 3, 500, gap=4.0)).learned_in
    assert one.name == "backlash" and one.params[0].value == pytest.approx(4.0, rel=0.15)


@pytest.mark.parametrize(
    ("law", "seed", "seconds", "name"),
    [
        (lambda u: play(u, (4.5, 5.85)), 1, 45.0, "backlash"),
        pytest.param(lambda u: play(u, (4.5, 5.85)), 1, 60.0, "backlash", marks=pytest.mark.long),
        (lambda u: one_pole(u, 0.45), 2, 30.0, "lag"),
    ],
)
def test_the_form_of_the_map_is_chosen_with_the_memory_in_place(law, seed, seconds, name):
    """Slack tendons need a rich map, which only shows once the large memory is explained.

    With a map chosen before, other laws fitted as well, or a second one joined.
    """
    first = learn(with_slack_tendons(law, seed, seconds)).learned_in[0]
    assert (first.name, first.law) == (name, "identified")


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_two_laws_are_found_together_where_one_stands_in_for_both(seed):
    """Friction in the sheath and a late camera: backlash alone fits better than either."""

    def late_and_rough(u):
        rough = growing_play(u, 0.12, 2.0)
        return np.concatenate([np.repeat(rough[:1], 6, axis=0), rough[:-6]])

    found = learn(with_slack_tendons(late_and_rough, seed, 80.0, slack=1.5)).learned_in
    assert {one.name for one in found} == {"friction", "latency"}
    late = next(number for one in found for number in one.params if "delay" in number.label)
    assert late.value == pytest.approx(0.12, rel=0.2)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
def test_a_play_that_grows_with_the_command_is_no_identified_backlash(seed):
    found = learn(with_slack_tendons(lambda u: growing_play(u, 0.2, 2.0), seed, 80.0, slack=3.5))
    assert {one.family for one in found.learned_in} == {"memory"}
    assert all(one.law == "open" for one in found.learned_in)


def test_a_law_that_reads_the_run_backward_follows_the_future():
    """Play of a run read backward is that of the reversed commands, at the same times."""
    t = np.arange(0.0, 30.0, 0.02)
    u, numbers = wander(t), {"backlash.gap": 1.4}
    backward = Drive(Record(u, t, t, backward=True)).acting(["backlash"], numbers)
    reversed_ = Drive(Record(np.ascontiguousarray(u[::-1]), t, t)).acting(["backlash"], numbers)
    np.testing.assert_allclose(backward, reversed_[::-1], atol=1e-9)
    # on both ways through, it lies on the other side of the gap
    forward = Drive(Record(u, t, t)).acting(["backlash"], numbers)
    assert np.abs(forward - backward).max() == pytest.approx(1.4, rel=0.01)


def test_a_frame_that_drifts_is_reported_and_no_effect_stands_in_for_it():
    run = recorded(noise=0.02)
    wandered = np.cumsum(
        np.random.default_rng(8).normal(0.0, 0.02, (len(run.t_seen), 1, 3)), axis=0
    )
    drifting = learn(replace(run, markers=run.markers + wandered))
    assert drifting.chain_names == () and drifting.learned_in == ()
    assert any(
        "the run shows" in note and "time" in note and "not in the model" in note
        for note in drifting.notes
    )


@pytest.mark.parametrize("gaps", [(1.4, 0.8)])
def test_unequal_play_of_a_robot_from_its_csv_gets_a_number_for_each_servo(gaps, tmp_path, capsys):
    """From the logs of a motion capture whose frame is turned and shifted, of a robot with play in
    both servos.
    """
    run = recorded(gaps, seconds=120.0, seed=5)
    # the arm lies along the capture's x
    turn = np.array([[0.0, 0.8, 0.6], [0.0, -0.6, 0.8], [1.0, 0.0, 0.0]])
    assert np.linalg.det(turn) == pytest.approx(1.0)
    markers = run.markers @ turn + [820.0, -340.0, 1210.0]
    names = [f"m{k + 1}_{axis}" for k in range(3) for axis in "xyz"]
    rows = np.column_stack([run.t_seen, run.command[::3], markers.reshape(len(markers), -1)])
    header = ",".join(["time", "motor_1", "motor_2", *names])
    np.savetxt(tmp_path / "log.csv", rows, "%.4f", ",", header=header, comments="")
    log, mapping, npz, bundle = (
        str(tmp_path / name) for name in ("log.csv", "map.toml", "run.npz", "finger")
    )
    assert main(["import", log, "--guess", "--out", mapping]) == 0
    assert main(["import", log, "--map", mapping, "--out", npz]) == 0
    capsys.readouterr()
    assert main(["learn", npz, "--out", bundle, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    (one,) = document["learned_in"]
    assert one["name"] == "backlash"
    values = {number["label"]: number["value"] for number in one["params"]}
    assert values == {
        f"backlash.gap[{c}]": pytest.approx(gap, rel=0.1) for c, gap in enumerate(gaps)
    }
    model = load_bundle(bundle)
    assert model.learned_in[0].name == "backlash" and model.taught_by(Run.load(npz))
    assert not model.taught_by(run)


def swing(period, seed, late=0.2, seconds=60.0):
    """One servo that swings at one speed and follows late, from rest."""

    def command(t):
        return 10.0 * np.clip(t / 4.0, 0.0, 1.0) * np.sin(2 * np.pi * t / period)

    t = np.arange(0.0, seconds, 0.02)
    acting = command(t - late)
    markers = arc(np.column_stack([acting, 0.0 * acting]))[::3]
    markers = markers + np.random.default_rng(seed).normal(0, 0.5, markers.shape)
    return Run(t=t, command=command(t)[:, None], t_seen=t[::3], markers=markers)


def test_a_second_run_of_another_speed_decides_between_families():
    """Delay, creep and memory all draw an ellipse for a sine of one speed; for a second speed only
    one of them does.
    """
    one, other = swing(12.0, 1), swing(3.0, 2)
    (alone,), both = learn(one).learned_in, learn([one, other])
    assert alone.law == "ambiguous" and {"creep", "rate"} <= {
        rival.family for rival in alone.alternatives
    }
    (reported,) = both.learned_in
    assert (reported.name, reported.law) == ("latency", "identified")
    assert reported.params[0].value == pytest.approx(0.2, abs=0.005)
    assert [other.name for other in reported.alternatives] == [
        "clock_shift"
    ]  # no run distinguishes it
    assert both.made_from["runs"] == [one.hash(), other.hash()]


def test_memory_begins_again_in_each_run():
    """Two halves of a run, the second recorded after the command had been moved in between."""
    first, second = (
        recorded((1.4, 1.4), seconds=50.0),
        recorded((1.4, 1.4), seconds=50.0, drive=lambda t: wander(t + 77)),
    )
    both = learn([first, second])
    assert (
        both.error_mm < 0.3
        and both.chain_params["backlash.gap" if len(both.chain_params) == 1 else "backlash.gap[0]"]
    )
    model = learned_model([first, second], both)
    for run in (first, second):
        assert np.sqrt(((model.predict(run) - run.markers) ** 2).sum(-1).mean()) < 0.35


# --- the parts ------------------------------------------------------------------------------------


def test_the_map_is_solved_again_for_every_law():
    """With the true play the map is exact; at any other gap it is not: the projected loss has its
    minimum there.
    """
    run = recorded((1.4, 1.4), noise=0.0)
    seen = observe([run], None, (), 20.0)
    static = StaticMap(
        seen.markers.reshape(len(seen.markers), -1), search_folds(seen, Basis(3)), Basis(3)
    )
    at = {
        gap: float((static.residual(play_at(run, gap, seen)) ** 2).sum())
        for gap in (1.0, 1.3, 1.4, 1.5, 1.8)
    }
    assert min(at, key=at.get) == 1.4 and at[1.3] > 1.5 * at[1.4] < at[1.5]


def play_at(run, gap, seen):
    return Record(run.command, run.t, seen.t).read(play(run.command, (gap, gap))[None])[0]


def test_held_out_losses_are_those_of_a_plain_refit():
    rng = np.random.default_rng(0)
    run = recorded(seconds=30.0)
    seen = observe([run], None, (), 20.0)
    static = StaticMap(rng.normal(size=(len(seen.t), 2)), search_folds(seen, Basis(1)), Basis(1))
    u = seen.drive.commanded
    columns = np.column_stack([np.ones(len(u)), u])
    plain = []
    for train, test in static.parts:
        weights = np.linalg.lstsq(columns[train], static.targets[train], rcond=None)[0]
        plain.append(((columns[test] @ weights - static.targets[test]) ** 2).sum())
    # its ridge is small but not zero
    np.testing.assert_allclose(static.losses(u), plain, rtol=2e-3)


def test_families_bring_only_effects_that_act_on_commands():
    members = {one.name: one.members for one in families()}
    assert {"memory", "delay", "rate", "creep", "softening", "time", "static map"} <= set(members)
    assert members["static map"] == () and "clock_shift" not in members["delay"]
    assert {"latency", "lag"} <= set(members["delay"]) and "backlash" in members["memory"]


def test_runs_of_different_robots_are_not_learned_together():
    from softmap_edge.errors import RunError

    run = recorded(seconds=20.0)
    for other in (replace(run, markers=run.markers[:, :2]), replace(run, command_unit="deg")):
        with pytest.raises(RunError, match="run 2 has"):
            learn([run, other])


# --- the command line -----------------------------------------------------------------------------


def test_learn_prints_what_it_put_into_the_chain(loose, tmp_path, capsys):
    loose.save(tmp_path / "run.npz")
    assert main(["learn", str(tmp_path / "run.npz"), "--out", str(tmp_path / "finger")]) == 0
    said = capsys.readouterr().out
    assert (
        "backlash: memory, law identified, held-out error" in said
        and "backlash.gap" in said
        and "±" in said
    )
    assert (
        main(["learn", str(tmp_path / "run.npz"), "--out", str(tmp_path / "map"), "--static"]) == 0
    )
    assert "not tested (--static)" in capsys.readouterr().out
    assert (
        load_bundle(tmp_path / "map").chain_names == ()
        and load_bundle(tmp_path / "map").learned_in == ()
    )


def test_a_learned_memory_survives_the_journey_and_predicts(loose, tmp_path):
    model = learn_model(loose)
    again = load_bundle(save_bundle(model, tmp_path / "finger"))
    assert again.learned_in == model.learned_in and again.chain_names == ("backlash",)
    np.testing.assert_allclose(again.predict(loose), model.predict(loose), atol=1e-6)
    assert again.taught_by(loose) and not again.taught_by(recorded(seed=9))


# --- machines of others ---------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "gap", "limit"), [("vio000", 45.0, 1.2), ("vio090", 58.0, 1.1)])
def test_a_tendon_sheath_joint_has_play_as_its_first_answer(name, gap, limit):
    folder = published("memory")
    run, held = (Run.load(folder / f"{name}_{part}.npz") for part in ("fit", "held"))
    learned = learn(run)
    first = learned.learned_in[0]
    assert (first.name, first.family) == ("backlash", "memory")
    assert first.params[0].value == pytest.approx(gap, rel=0.05)
    model = learned_model(run, learned)
    error = np.sqrt(((model.predict(held) - held.markers) ** 2).sum(-1).mean())
    assert error <= limit * DEGREE_MM
    # Without the play, the same map is ten times as far off.
    static = learned_model(run, learn(run, static=True))
    assert (
        np.sqrt(((static.predict(held) - held.markers) ** 2).sum(-1).mean()) > 5 * limit * DEGREE_MM
    )


def test_a_friction_damper_with_a_gap_has_a_memory_whose_law_stays_open():
    folder = published("memory")
    run, held = (Run.load(folder / f"arts_30lb_05hz_1in_{part}.npz") for part in ("fit", "held"))
    learned = learn(run)
    first = learned.learned_in[0]
    assert first.family == "memory" and (first.law == "open" or len(learned.learned_in) > 1)
    error = learned_model(run, learned).predict(held) - held.markers
    assert np.sqrt((error**2).sum(-1).mean()) <= 0.20 * np.sqrt(
        ((held.markers - held.markers.mean(0)) ** 2).sum(-1).mean()
    )


def bouc_wen(y, gamma=0.9, delta=-1.2, nu=1.0, parts=8):
    """ζ (T,): dζ = dy − γ|dy||ζ|^(ν−1)ζ − δ dy|ζ|^ν, a smooth hysteresis that hardens."""
    zeta, out = 0.0, [0.0]
    for step in np.diff(y) / parts:
        for _ in range(parts):
            zeta += (
                step
                - gamma * abs(step) * abs(zeta) ** (nu - 1) * zeta
                - delta * step * abs(zeta) ** nu
            )
        out.append(zeta)
    return np.array(out)


def driven(gamma, delta, damping=0.0):
    """A force log along a random multisine of 0.3 to 3 Hz: a spring, a smooth hysteresis and a
    damper.
    """
    rng, t = np.random.default_rng(1), np.arange(0.0, 90.0, 0.01)
    y = np.sin(
        2 * np.pi * (rng.uniform(0.3, 3.0, 40)[:, None] * t + rng.uniform(size=(40, 1)))
    ).sum(axis=0)
    y /= y.std()
    force = (y + 3.0 * bouc_wen(y, gamma, delta) + damping * np.gradient(y, t))[::8]
    force += rng.normal(0, 0.02 * force.std(), len(force))
    return Run.of_outputs(force[:, None], "N", ["force"], t=t, t_seen=t[::8], command=y[:, None])


def test_a_smooth_hysteresis_that_no_law_reaches_is_a_memory_of_unknown_law():
    """Plays cannot draw it: its small cycles do not close. A law that explains a part of it does
    not join the chain.
    """
    learned = learn(driven(0.9, -1.2, damping=0.02))
    (one,) = learned.learned_in
    assert (one.name, one.family, one.law) == (
        "",
        "memory",
        "unknown",
    ) and learned.chain_names == ()
    assert one.after_mm < 0.2 * one.before_mm


@pytest.mark.parametrize(("gamma", "delta"), [(1.5, 0.3), (3.0, -1.5), (0.5, 0.5)])
def test_of_a_smooth_hysteresis_the_law_of_the_library_stays_open(gamma, delta):
    first = learn(driven(gamma, delta)).learned_in[0]
    assert (first.family, first.law) == ("memory", "open")


def certain(labels, other_labels=(), more=False):
    """How sure a law of one family is, also alongside another one that leaves a little less, but
    not in every fold.
    """

    def fitted(names, losses):
        return SimpleNamespace(
            chain=SimpleNamespace(labels=tuple(names)),
            losses=losses,
            bounded=np.zeros(len(names), bool),
        )

    family, up_and_down = Family("delay", ("latency", "lag")), np.tile([0.4, -0.4], 4)
    first = fitted(labels, 50.0 / 8 + up_and_down)
    second = fitted(other_labels, 49.0 / 8 - up_and_down)
    others = (FittedEffect(family, "lag", second),) if other_labels else ()
    return Step(family, ("latency",), first, np.full(8, 50.0), others, False, False, more).certainty


def test_numbers_for_each_channel_count_as_one_when_laws_are_compared():
    """Which channels share a number says nothing about the form of a law."""
    assert certain(("latency.delay",)) == "identified"
    assert certain(("latency.delay",), ("lag.tau[0]", "lag.tau[1]")) == "ambiguous"
    # more numbers, not seen to leave less
    assert certain(("latency.delay",), ("lag.tau", "lag.order")) == "identified"


def test_a_law_is_open_if_its_family_explains_more_on_top_of_it():
    assert certain(("backlash.gap",), more=True) == "open"
