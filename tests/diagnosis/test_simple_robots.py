"""Robots that are a few lines of kinematics: learned from one log, diagnosed on another.

Nothing here comes from the library: a planar arm of constant curvature, an angle over a pressure, a
force over a displacement.
"""

import contextlib
import json
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import Normalize

from softmap_edge import Run, diagnose, learn_model, load_bundle, save_bundle
from softmap_edge.cli import main
from softmap_edge.comparison.series import series
from softmap_edge.diagnosis import conclusion
from softmap_edge.diagnosis.findings import Alternative
from softmap_edge.diagnosis.refit import refit
from softmap_edge.errors import RunError
from softmap_edge.experiment.choose import next_experiment
from softmap_edge.model.effect_info import registry
from softmap_edge.noise import motion_at_rest
from softmap_edge.report import figures
from softmap_edge.rod.learn import learn

LENGTH, RATE = 110.0, 10.0
SILENT = ("nothing", "cannot_tell")


def moves(seed, seconds, channels=2):
    """Ramps between random places, some with a rest, in -1 … 1."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1.0 / RATE)
    u = np.empty((len(t), channels))
    for c in range(channels):
        at, to = [0.0, 3.0], [0.0, 0.0]
        while at[-1] < seconds:
            at.append(at[-1] + rng.uniform(0.8, 2.5))
            to.append(rng.uniform(-1.0, 1.0))
            if rng.random() < 0.4:
                at.append(at[-1] + 2.0)
                to.append(to[-1] if rng.random() < 0.7 else 0.0)
        u[:, c] = np.interp(t, at, to)
    return t, u


def play(u, gap):
    out, held = np.empty_like(u), u[0]
    for k, x in enumerate(u):
        held = np.clip(held, x - gap / 2, x + gap / 2)
        out[k] = held
    return out


def arm(u):
    """Markers (K, 4, 3) mm of an arm that bends by up to 70 deg about either axis, a little less
    the farther it is.
    """
    bend = 1.2 * u * (1.0 - 0.06 * (u**2).sum(axis=1, keepdims=True))
    angle = np.maximum(np.linalg.norm(bend, axis=1), 1e-9)
    along, places = bend / angle[:, None], []
    for s in (0.25, 0.5, 0.75, 1.0):
        side, up = LENGTH / angle * (1.0 - np.cos(s * angle)), LENGTH / angle * np.sin(s * angle)
        places.append(np.column_stack([side[:, None] * along, up]))
    return np.stack(places, axis=1)


def arm_run(seed, change=lambda u: u, seconds=90.0, points=slice(None), more=lambda p: p):
    """A run in degrees of two servos, ±50; `change` acts on the commands, `more` on the markers."""
    t, u = moves(seed, seconds)
    seen = (
        more(arm(change(u)))[:, points]
        + 0.1 * np.random.default_rng(seed + 99).normal(size=(len(t), 4, 3))[:, points]
    )
    return Run(
        t,
        50.0 * u,
        t,
        command_unit="deg",
        markers=seen,
        robot="arm",
        gravity=np.array([0.0, 0.0, 1.0]),
    )


def pressure_run(seed, change, reach=100.0, seconds=60.0):
    """Degrees over a pressure of 0 … `reach` kPa."""
    t, u = moves(seed, seconds, 1)
    x = 0.5 * reach * (u + 1.0)
    angle = 0.4 * change(x) + 1e-5 * change(x) ** 3
    noise = 0.05 * np.random.default_rng(seed + 99).normal(size=angle.shape)
    return Run.of_outputs(angle + noise, "deg", t=t, command=x, command_unit="kPa", t_seen=t)


@pytest.fixture(scope="module")
def learned():
    return learn_model(arm_run(1, seconds=150.0))


@pytest.mark.parametrize(
    "change",
    [
        dict(change=lambda u: 1.008 * u + [0.006, -0.004]),
        dict(change=lambda u: u + 0.01),
        dict(more=lambda p: p + [0.25, -0.2, 0.1]),
        dict(change=lambda u: 0.99 * u, more=lambda p: p + [0.0, 0.2, 0.0]),
    ],
)
def test_what_differs_from_day_to_day_is_no_discovery(learned, change):
    """A learned map has no error of its own, so 1 % of the motion is seen clearly; it is still
    ordinary.
    """
    found = diagnose(learned, arm_run(2, **change))
    assert found.verdict in SILENT and not found.effects and not found.faults and not found.families
    assert (
        found.error.before > 2.0 * found.error.floor and "ordinary imperfections" in found.sentence
    )
    assert found.unexplained.ordinary_mm > 0.1


@pytest.mark.parametrize(
    ("names", "change"),
    [
        (["gain"], lambda u: 0.92 * u),
        (["offset"], lambda u: u + [0.1, -0.1]),
        (["saturation"], lambda u: np.clip(u, -0.8, 0.8)),
    ],
)
def test_a_static_effect_beyond_that_is_named_first(learned, names, change):
    found = diagnose(learned, arm_run(3, change))
    assert [effect.name for effect in found.effects[:1]] == names and found.families[
        0
    ].kind == "static"


def test_a_gain_of_one_channel_is_no_hysteresis():
    """Triangles of one channel: a hysteresis whose reach is beyond the range is a gain."""
    run = pressure_run(5, lambda x: 1.08 * x)
    found = diagnose(learn_model(pressure_run(4, lambda x: x)), run)
    assert found.families[0].kind == "static" and "hysteresis" not in [
        e.name for e in found.effects
    ]


def test_a_parabola_is_no_asymmetry(learned):
    found = diagnose(learned, arm_run(6, lambda u: u + 0.12 * u**2))
    assert found.families[0].name == "static map" and found.verdict != "identified"


def test_play_in_one_servo_is_identified(learned):
    found = diagnose(learned, arm_run(7, lambda u: np.column_stack([u[:, 0], play(u[:, 1], 0.16)])))
    assert found.verdict == "identified" and [effect.name for effect in found.effects] == [
        "backlash"
    ]
    gaps = found.effects[0].params
    assert (
        gaps["backlash.gap[1]"].value == pytest.approx(8.0, rel=0.05)
        and not gaps["backlash.gap[0]"].at_bound
    )


def both(first, second):
    return lambda u: np.column_stack([play(u[:, 0], first), play(u[:, 1], second)])


@pytest.mark.long
def test_play_in_one_servo_is_learned_as_identified_and_refit_comes_first_when_it_changes():
    model = learn_model(arm_run(8, both(0.0, 0.12), seconds=150.0))
    (law,) = model.learned_in
    none, gap = law.params
    assert (law.name, law.law) == ("backlash", "identified") and not none.at_bound
    assert gap.value == pytest.approx(6.0, rel=0.05) and none.sigma >= none.value
    same = diagnose(model, arm_run(9, both(0.0, 0.12)))
    # a limit of the model is none of the data
    assert same.verdict == "nothing" and not same.effects
    changed = diagnose(model, arm_run(10, both(0.0, 0.24)))
    assert (
        changed.sentence.startswith("Refit first: the model's own backlash")
        and changed.verdict == "ambiguous"
    )
    again, _ = refit(model, arm_run(10, both(0.0, 0.24)))
    assert again.learned_in[0].params[1].value == pytest.approx(12.0, rel=0.05)
    assert not diagnose(again, arm_run(20, both(0.0, 0.24))).effects


def test_one_marker_at_the_tip_need_not_stand_where_it_stood():
    tip = learn_model(arm_run(11, points=slice(3, 4), seconds=150.0))
    found = diagnose(tip, arm_run(12, points=slice(3, 4), more=lambda p: p + [0.8, 0.0, 0.0]))
    assert found.verdict not in ("identified", "measurement_fault")
    with pytest.raises(RunError, match="turned by .* and shifted by"):
        diagnose(tip, arm_run(12, points=slice(3, 4), more=lambda p: p + [90.0, 0.0, 0.0]))


def test_a_marker_that_is_never_seen_says_nothing(learned):
    run = arm_run(7, lambda u: np.column_stack([play(u[:, 0], 0.16), u[:, 1]]))
    seen = np.ones((run.frames, 4), bool)
    seen[:, 1] = False
    found = diagnose(learned, replace(run, visible=seen))
    assert [effect.name for effect in found.effects] == ["backlash"]


def test_a_limit_near_the_end_of_a_drive_that_pulls_only_is_found():
    found = diagnose(
        learn_model(pressure_run(13, lambda x: x)), pressure_run(14, lambda x: np.minimum(x, 88.0))
    )
    assert [effect.name for effect in found.effects] == ["saturation"]
    assert found.effects[0].params["saturation.above"].value == pytest.approx(88.0, rel=0.01)


def test_logs_of_one_output_with_other_ranges_are_learned_together():
    runs = [pressure_run(15, lambda x: x), pressure_run(16, lambda x: x, reach=70.0)]
    assert runs[0].output != runs[1].output
    model = learn_model(runs)
    assert model.output == runs[0].output
    assert diagnose(model, pressure_run(17, lambda x: x)).verdict in SILENT
    with pytest.raises(
        RunError, match="run 2 has angle in rad as its outputs, the first run output 1 in deg"
    ):
        other = Run.of_outputs(
            runs[1].output.values(runs[1].markers),
            "rad",
            ("angle",),
            t=runs[1].t,
            command=runs[1].command,
            command_unit="kPa",
            t_seen=runs[1].t,
        )
        learn_model([runs[0], other])


def test_a_recording_given_twice_teaches_nothing_more():
    run = pressure_run(15, lambda x: x)
    with pytest.raises(RunError, match="given twice"):
        learn_model([run, run])


def test_a_zero_that_drifts_is_no_fault_of_the_camera(learned):
    """Steadily, by a tenth of the half range in all: neither a camera that moves nor a slip is
    named first.
    """
    found = diagnose(
        learned, arm_run(18, lambda u: u + np.linspace(0.0, 0.15, len(u))[:, None] * [1.0, -1.0])
    )
    assert [effect.name for effect in found.effects] == ["zero_drift"] and not found.faults
    rates = [found.effects[0].params[f"zero_drift.rate[{c}]"].value for c in (0, 1)]
    assert rates == pytest.approx([5.0, -5.0], rel=0.06)  # deg/min


def test_a_camera_that_is_hit_is_no_slip_of_a_tendon(learned):
    """At one instant, with the base: no law of the library, but of the frame."""
    run = arm_run(19)
    hit = run.markers + np.where(run.t_seen > 50.0, 1.0, 0.0)[:, None, None] * [2.5, -1.5, 1.0]
    found = diagnose(learned, replace(run, markers=hit))
    assert found.families[0].name == "frame drift" and not found.effects


def test_commands_of_the_other_sign_are_no_turned_frame_alone(learned):
    run = arm_run(21)
    with pytest.raises(
        RunError,
        match=r"turned by 1[78].*set sign = -1 in the mapping, with which the commands explain",
    ):
        diagnose(learned, replace(run, command=-run.command))


def sticks(u, width=0.25):
    """Commands of a joint that sticks and then jumps to its command."""
    out, held = np.empty_like(u), u[0].copy()
    for k, x in enumerate(u):
        held = np.where(np.abs(x - held) > width, x, held)
        out[k] = held
    return out


def test_a_learned_law_that_leaves_much_of_the_error_is_open():
    """The play that is nearest to stick-slip leaves its jumps; a map that fits badly would leave as
    much.
    """
    model = learn_model(arm_run(22, sticks, seconds=150.0))
    assert model.learned_in and all(one.law != "identified" for one in model.learned_in)


def test_noise_that_was_measured_is_not_called_guessed(learned):
    found = diagnose(learned, arm_run(23))
    assert found.verdict == "nothing" and not any(
        "to estimate the noise" in remark for remark in found.remarks
    )


def test_all_that_a_diagnosis_names_is_added_unless_it_names_nothing(learned, tmp_path, capsys):
    run = arm_run(24, lambda u: np.column_stack([u[:, 0], play(u[:, 1], 0.16)]))
    save_bundle(learned, tmp_path / "arm")
    for name, one in (("d", run), ("n", arm_run(25))):
        (tmp_path / f"{name}.json").write_text(
            json.dumps(diagnose(learned, one).to_dict()), encoding="utf-8"
        )
    words = ["--bundle", str(tmp_path / "arm"), "--out", str(tmp_path / "more")]
    assert main(["add", "--from", str(tmp_path / "n.json"), *words]) == 2
    assert (
        "names no effect (verdict nothing)" in capsys.readouterr().err
        and not (tmp_path / "more").exists()
    )
    assert main(["add", "--from", str(tmp_path / "d.json"), *words]) == 0
    assert load_bundle(tmp_path / "more").chain_names == ("backlash",)


def test_gravity_is_asked_for_another_orientation_and_a_limit_of_the_model_for_nothing(learned):
    run = arm_run(26, lambda u: np.column_stack([u[:, 0], play(u[:, 1], 0.16)]))
    found = diagnose(learned, run)
    assert {row.name for row in found.not_testable if row.of_model} >= {"kink", "twist", "routing"}
    ranked = next_experiment(learned, found, [run])
    assert {one.block for one in ranked if one.plan and "gravity" in one.settles} == {
        "another orientation"
    }
    assert not {"kink", "twist", "routing"} & {name for one in ranked for name in one.settles}


def test_a_page_is_written_though_its_reader_closes_the_pipe(learned, tmp_path, monkeypatch):
    save_bundle(learned, tmp_path / "arm")
    arm_run(27).save(tmp_path / "run.npz")

    def closed(*_, **__):
        raise BrokenPipeError

    with monkeypatch.context() as patch:
        patch.setattr("builtins.print", closed)
        words = ["diagnose", str(tmp_path / "run.npz"), "--bundle", str(tmp_path / "arm")]
        with contextlib.suppress(BrokenPipeError):
            main([*words, "--html", str(tmp_path / "d.html")])
    assert (tmp_path / "d.html").read_text(encoding="utf-8").startswith("<!doctype html")


@pytest.mark.parametrize("rate", [5.0, 4.9])
def test_frames_at_twice_a_frequency_show_no_hum(rate):
    """At half the rate of the frames a wave may vanish in all of them: no amplitude follows from
    that.
    """
    t = np.arange(200) / rate
    level = motion_at_rest._levels([np.arange(100), np.arange(100, 200)], 200)
    values = np.random.default_rng(0).normal(size=(200, 2))
    share = motion_at_rest._explained(np.array([0.5 * rate, 0.6]), t, values, level)
    assert np.all(share[0] == 0.0) and np.all(share[1] > 0.0)


def test_colours_reach_three_times_the_noise(learned, monkeypatch):
    """A model that leaves only noise is pale, not as dark as the worst."""
    seen = []
    monkeypatch.setattr(
        figures, "Normalize", lambda low, high: seen.append(high) or Normalize(low, high)
    )
    shown = series(arm_run(28), learned, kind="measured")
    figures.body(shown)
    assert (
        seen[0] == pytest.approx(3.0 * shown.noise_floor_mm)
        and seen[0] > 2.0 * shown.point_before.max()
    )


def test_a_fault_that_physics_may_explain_is_not_the_verdict():
    known = registry()
    drift, time = (
        Alternative((), "", "camera_drift", "frame drift"),
        Alternative((), "", "camera_drift", "time"),
    )
    assert not conclusion._physical([drift], known) and conclusion._physical([drift, time], known)


# --- what tests with a finger in a physics engine found -------------------------------------------


@pytest.mark.parametrize("gains", [(1.01, 1.01), (0.99, 1.015), (1.012, 0.99), (0.985, 1.004)])
def test_gains_that_differ_a_little_from_day_to_day_are_no_creep(learned, gains):
    """So near the noise, slow columns do as well as a static map by chance; what a static map can
    do is ordinary.
    """
    found = diagnose(learned, arm_run(50 + int(1000 * gains[0]) % 7, lambda u: np.array(gains) * u))
    assert found.verdict == "nothing" and not found.families and found.unexplained.ordinary_mm > 0.1


MORE = (pytest.param(0.9, gap, marks=pytest.mark.long) for gap in (0.05, 0.2))


@pytest.mark.parametrize(("gain", "gap"), [(0.85, 0.1), *MORE])
def test_gain_and_play_are_neither_friction_nor_hysteresis(learned, gain, gap):
    """One law alone does most of what both do, and leaves three to six times the floor."""
    found = diagnose(learned, arm_run(31, lambda u: gain * both(gap, gap)(u)))
    assert {effect.name for effect in found.effects} == {"gain", "backlash"}
    assert found.error.after < 1.2 * found.error.floor


def rarely(u):
    """Commands of which the second leaves the middle of its range for seven seconds only."""
    once = np.where((np.arange(len(u)) >= 360) & (np.arange(len(u)) < 430), 1.0, 0.6)
    return np.column_stack([u[:, 0], once * u[:, 1]])


def test_a_stop_that_one_block_alone_shows_is_kept(learned):
    """The blocks without it say nothing of where it is, so there it stays where all blocks put
    it.
    """
    (t, u), run = moves(32, 90.0), arm_run(32)
    u = rarely(np.column_stack([u[:, 0], np.sin(t)]))
    seen = arm(np.clip(u, [-0.75, -0.85], [0.75, 0.85])) + 0.1 * np.random.default_rng(131).normal(
        size=(len(t), 4, 3)
    )
    found = diagnose(learned, replace(run, command=50.0 * u, markers=seen))
    assert [effect.name for effect in found.effects] == ["saturation"]
    assert found.effects[0].params["saturation.above[1]"].value == pytest.approx(42.5, rel=0.03)


def turned(p):
    """Markers seen by a camera that leans by two degrees and stands 1 mm aside."""
    lean = np.radians(2.0)
    return p @ np.array(
        [[np.cos(lean), 0.0, -np.sin(lean)], [0.0, 1.0, 0.0], [np.sin(lean), 0.0, np.cos(lean)]]
    ) + [
        1,
        0,
        0,
    ]


@pytest.mark.parametrize(("lift", "verdict"), [(0.0, "ambiguous"), (0.8, "measurement_fault")])
def test_a_camera_that_leans_may_be_a_body_that_bends_unless_it_is_lifted(learned, lift, verdict):
    """A learned model has neither weight nor curvature at rest, so it cannot exclude them; neither
    lifts a body.
    """
    found = diagnose(learned, arm_run(33, more=lambda p: turned(p) + [0.0, 0.0, lift]))
    assert [fault.name for fault in found.faults] == ["mount"] and found.verdict == verdict
    others = {name for one in found.alternatives for name in one.effects}
    assert others == ({"pre_curve", "gravity"} if lift == 0.0 else set())


def test_a_fast_drift_of_a_zero_is_no_camera(learned):
    found = diagnose(
        learned, arm_run(34, lambda u: u + np.linspace(0.0, 0.3, len(u))[:, None] * [1.0, 0.0])
    )
    assert found.verdict == "identified" and [effect.name for effect in found.effects] == [
        "zero_drift"
    ]


def late(u, seconds, rate=RATE):
    t = np.arange(len(u)) / rate
    return np.column_stack([np.interp(t - s, t, column) for s, column in zip(seconds, u.T)])


@pytest.mark.long
def test_a_delay_of_one_servo_is_a_matter_of_the_model_s_own_delay():
    """All servos were late alike when the model was learned; now one is later: the own delay is
    fitted for each.
    """
    model = learn_model(arm_run(35, lambda u: late(u, (0.15, 0.15)), seconds=150.0))
    assert set(model.chain_names) == {"latency"}
    run = arm_run(36, lambda u: late(u, (0.15, 0.45)))
    found = diagnose(model, run)
    assert found.sentence.startswith("Refit first: the model's own latency")
    again, report = refit(model, run)
    delays = [report.params[f"latency.delay[{c}]"].value for c in (0, 1)]
    assert delays == pytest.approx([0.15, 0.45], abs=0.02)
    assert not diagnose(again, arm_run(37, lambda u: late(u, (0.15, 0.45)))).effects
    same, report = refit(model, arm_run(38, lambda u: late(u, (0.3, 0.3))))
    assert list(report.params) == ["latency.delay"]  # one number for all does as well


def test_two_orientations_are_noted_when_a_model_is_learned():
    hanging, leaning = arm_run(39), replace(arm_run(40), gravity=np.array([0.6, 0.0, 0.8]))
    assert "orientations 37 degrees apart" in str(learn([hanging, leaning], static=True))
    assert "orientations" not in str(learn([hanging, arm_run(41)], static=True))
