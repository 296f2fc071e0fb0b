"""`softmap check` reports what a run can and cannot identify, each from a number, with a remedy;
with a model, per effect.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from softmap_edge import Run, builtin_model, effects, save_bundle
from softmap_edge.checks.advice import advice, missing_data
from softmap_edge.checks.summary import summary
from softmap_edge.checks.summary_text import sentences
from softmap_edge.cli import main
from softmap_edge.files.numbers import WIDTH
from softmap_edge.model.servo_calibration import ERRORS, Calibration
from softmap_edge.run.protocol import Limits, standard_protocol
from softmap_edge.run.run import OURS

SIDEWAYS = (0.6, 0.0, 0.8)


def full(**change):
    """The standard protocol seen by twelve markers with noise: a run that can identify nearly
    everything.
    """
    p = standard_protocol()
    rng = np.random.default_rng(0)
    rest = 40 * rng.normal(size=(12, 3)) + [0, 0, 60]
    fields = {
        "t": p.t,
        "command": p.command,
        "gravity": p.gravity,
        "t_seen": p.t_seen,
        "marker_rest": rest,
        "temperature": 20 + 6 * (1 - np.abs(2 * p.t / p.t[-1] - 1)),
        "robot": "finger",
        "markers": rest + 0.1 * rng.normal(size=(p.frames, 12, 3)),
    }
    return Run(**(fields | change))


def short(**change):
    """The same that always moves, with too few frames to know the body's shapes."""
    run = full(command=triangle(standard_protocol().t), **change)
    return run.at(np.arange(30))


def answers(run):
    return {word.about: word for word in (*summary(run).can_tell, *summary(run).cannot_tell)}


def test_a_full_protocol_can_identify_everything():
    found = summary(full())
    assert found.cannot_tell == [] and len(found.can_tell) == 9
    assert "2 orientations" in answers(full())["orientation"].text
    # √3 · 0.1
    assert answers(full())["noise"].text.startswith("noise vs. effects: the noise is 0.17 mm")


def held(t):
    return np.zeros((len(t), 2))


def one_way(t):
    return np.column_stack([np.minimum(t / 20.0, 12.0), -np.minimum(t / 25.0, 10.0) * (t > 60)])


def together(t):
    return np.column_stack([6 * np.sin(t / 3), 6 * np.sin(t / 3)])


def alone(t):
    return np.column_stack([6 * np.sin(t / 3), 0 * t])


def triangle(t):
    wave = 12 * (2 * np.abs((t / 8) % 2 - 1) - 1)
    return np.column_stack([wave, -np.roll(wave, 100)])


@pytest.mark.parametrize(
    ("command", "about", "words"),
    [
        (held, "drive", "the commands never change"),
        (one_way, "direction", "channel 0, 1 is seen coming from one side only"),
        (one_way, "sides", "pulled to one side only"),
        (together, "channels", "channel 0 vs. channel 1: they move together (correlation 1.00)"),
        (alone, "channels", "channel 1: it never moves"),
        (triangle, "speed", "always moves at about 0.12 of its range"),
        (triangle, "dwell", "rest for 0."),
        (triangle, "home", "home is never visited"),
    ],
)
def test_what_the_motion_cannot_identify_is_reported_with_a_remedy(command, about, words):
    run = full(command=command(standard_protocol().t))
    words_about = [word for word in summary(run).cannot_tell if word.about == about]
    assert any(words in word.text for word in words_about), summary(run).cannot_tell
    assert all(word.remedy and word.minutes > 0 for word in words_about)


@pytest.mark.parametrize(
    ("change", "about", "words"),
    [
        ({"gravity": None}, "orientation", "the orientation is not declared"),
        ({"gravity": np.array([0.0, 0, 1])}, "orientation", "in one orientation"),
        ({"temperature": None}, "temperature", "no temperature is logged"),
        ({"temperature": 21.0}, "temperature", "changes by 0.0 °C only"),
        (
            {"temperature": np.linspace(20, 26, len(standard_protocol().t))},
            "temperature",
            "vs. drift over time",
        ),
        ({"marker_rest": np.arange(12)[:, None] * [0.0, 0.1, 10]}, "markers", "lie on one line"),
    ],
)
def test_what_was_not_declared_or_seen_is_reported(change, about, words):
    found = answers(full(**change))[about]
    assert not found.tells and words in found.text


def test_few_frames_and_one_marker_are_reported():
    run = full()
    assert "5 frames are too few" in answers(run.at(np.arange(5)))["frames"].text
    assert "30 frames leave too few" in answers(run.at(np.arange(30)))["frames"].text
    tip = full(markers=run.markers[:, :1], marker_rest=run.marker_rest[:1])
    assert "one marker is seen" in answers(tip)["markers"].text


def smooth(t):
    """Six channels of slow random moves, as on a real trunk: each is fast and slow in turn."""
    rng = np.random.default_rng(3)
    waves = 2 * np.pi * t[:, None, None] * rng.uniform(0.1, 0.5, (6, 4))
    return (
        np.array([50, 80, 30, 80, 30, 50]) * np.sin(waves + rng.uniform(0, 6, (6, 4))).mean(axis=2)
    ).round(3)


def test_smooth_moves_of_many_channels_are_fast_and_slow():
    run = full(command=smooth(standard_protocol().t), command_unit="deg")
    assert answers(run)["speed"].tells and answers(run)["channels"].tells


@pytest.mark.parametrize("fastest", [None, 6.0])
def test_both_paces_of_the_standard_protocol_are_seen(fastest):
    model = builtin_model()
    limits, both = (
        Limits.of(model.command_range, model.command_unit, fastest),
        ((0.0, 0.0, 1.0), SIDEWAYS),
    )
    p = standard_protocol(seed=0, limits=limits, back=True, orientations=both)
    markers = np.repeat(full().marker_rest[None], p.frames, axis=0)
    run = full(
        t=p.t,
        command=p.command,
        gravity=p.gravity,
        t_seen=p.t_seen,
        markers=markers,
        temperature=None,
    )
    assert answers(run)["speed"].tells, answers(run)["speed"]
    # though the robot was turned
    assert not [note for note in summary(run).warnings if "gap" in note]
    still = replace(run, gravity=np.array([0.0, 0.0, 1.0]))
    assert not fastest or any("t_seen has a gap" in note for note in summary(still).warnings)


def test_markers_on_the_base_are_counted_and_are_no_unknown_field():
    run = full(
        extra={"base_markers": np.zeros((standard_protocol().frames, 3, 3)), "wind": np.zeros(2)}
    )
    found = summary(run)
    assert found.base_markers == 3 and found.unknown_fields == ["wind"]
    assert any("3 markers on the base" in line for line in sentences(found))


@pytest.mark.parametrize("name", sorted(OURS))
def test_fields_that_our_own_commands_write_are_no_unknown_ones(name):
    held = {
        "base_markers": np.zeros((standard_protocol().frames, 3, 3)),
        "roll_seen": np.array(False),
    }
    found = summary(full(extra={name: held.get(name, np.array(["a"] * 12)), "wind": np.zeros(2)}))
    assert found.unknown_fields == ["wind"] and "kept      wind (not known" in "\n".join(
        sentences(found)
    )


def test_check_and_diagnosis_agree_on_a_noise_that_is_declared_alone():
    """A declared sigma is held against repeats; where there are none the noise is a guess, as a
    diagnosis says.
    """
    run = short(sigma=np.array(0.3))
    word = answers(run)["noise"]
    assert word.remedy and word.minutes > 0
    assert (
        not word.tells
        and "to estimate the noise; the declared 0.3 mm per coordinate is not used" in word.text
    )
    assert any(word.text in remark for remark in missing_data([full(), run], 400, False))
    assert "declares" not in answers(replace(run, sigma=None))["noise"].text
    assert (
        "too few repeated" not in str(missing_data([run], 400, True))
        and answers(full(sigma=np.array(0.3)))["noise"].tells
    )


def test_orientations_count_where_something_is_seen():
    run = sideways_after(10.0)
    assert told_of(run, "orientation") and not told_of(run.at(run.t_seen < 9.0), "orientation")


def sideways_after(seconds):
    protocol = standard_protocol(2)
    return Run(
        t=protocol.t,
        command=protocol.command,
        t_seen=protocol.t_seen,
        gravity=np.where(protocol.t[:, None] < seconds, [0.0, 0.0, 1.0], SIDEWAYS),
        markers=np.zeros((protocol.frames, 1, 3)) + [[[0.0, 0.0, 50.0]]],
    )


def told_of(run, about):
    return next(word for word in advice(run, 3) if word.about == about).tells


def test_a_changing_load_stands_for_a_second_orientation():
    run = full(
        gravity=np.array([0.0, 0, 1]), load=np.where(np.arange(len(full().t)) < 3000, 0.0, 10.0)
    )
    assert answers(run)["orientation"].tells


def test_a_run_without_commands_says_so():
    still = Run(
        t_seen=np.arange(80.0),
        t=np.arange(80.0),
        markers=np.random.default_rng(0).normal(size=(80, 4, 3)) * 20,
    )
    found = answers(still)
    assert "nothing is commanded" in found["drive"].text and "speed" not in found
    assert advice(still, 0)[0].tells


def test_the_text_is_for_a_terminal_and_adds_the_minutes_up(tmp_path, capsys):
    run = full(command=triangle(standard_protocol().t), temperature=None)
    moved = np.interp(run.t_seen, run.t, run.command[:, 0])
    replace(run, markers=run.markers + moved[:, None, None] * [1.0, 0.0, 0.0]).save(
        tmp_path / "run.npz"
    )
    assert main(["check", str(tmp_path / "run.npz")]) == 0
    text = capsys.readouterr().out
    assert max(len(line) for line in text.splitlines() if str(tmp_path) not in line) <= WIDTH
    document = summary(Run.load(tmp_path / "run.npz"))
    minutes = sum(word.minutes for word in document.cannot_tell)
    assert f"about {minutes:g} minutes" in text
    assert text.index("This run can identify") < text.index("This run cannot identify")
    assert text.count("      > ") == len(document.cannot_tell)
    assert sentences(document)[-1] in text


def test_points_far_from_the_base_are_reported_to_be_aligned():
    run = full()
    assert not any("align" in note for note in summary(run).warnings)
    camera = full(markers=run.markers + [0, 0, 900.0])
    assert any("softmap run align" in note for note in summary(camera).warnings)
    framed = full(markers=run.markers + [0, 0, 900.0], frame=np.eye(3, 4))
    assert not any("align" in note for note in summary(framed).warnings)


@pytest.mark.parametrize("rate", [1.0, 5.0, 20.0])
@pytest.mark.parametrize("gap", [30.0, 600.0, 3600.0])
def test_a_gap_in_the_frames_is_no_rest(rate, gap):
    """Nothing was seen in it; a rest that was seen counts."""
    t = np.arange(0, 60, 1 / rate)
    u = np.column_stack([6 + 5 * np.sin(1.5 * t), 6 + 5 * np.cos(1.5 * t)])
    t = t + gap * (np.arange(len(t)) >= len(t) // 2)
    points = np.random.default_rng(0).normal(size=(len(t), 3, 3)) + 5 * u[:, :1, None]
    rest = {
        word.about: word.text
        for word in summary(Run(t=t, command=u, t_seen=t, markers=points)).cannot_tell
    }
    assert "it is seen to rest for" in rest["dwell"]
    u[(t > 10) & (t < 25)] = (11.0, 6.0)
    found = {
        word.about: word.text
        for word in summary(Run(t=t, command=u, t_seen=t, markers=points)).can_tell
    }
    assert "it is seen to rest away from home for up to 1" in found["dwell"]


def test_visits_of_home_without_a_dwell_between_are_counted():
    t = np.arange(0, 60, 0.05)
    # six homes, never at rest at another place
    u = np.where((t % 10) < 6, 0.0, 8 * np.sin(np.pi * ((t % 10) - 6) / 4))
    run = Run(
        t=t,
        command=u[:, None],
        t_seen=t[::4],
        markers=np.random.default_rng(0).normal(size=(300, 4, 3)) * 20,
    )
    assert summary(run).home_visits == 6


# --- with a model --------------------------------------------------------------------------


def recorded(p, command=None, gravity=None, noise=0.25):
    model = builtin_model()
    record = {
        "t": p.t,
        "command": p.command if command is None else command,
        "t_seen": p.t_seen,
        "robot": model.robot,
        "gravity": p.gravity if gravity is None else gravity,
    }
    blank = np.repeat(model.rest[None], p.frames, axis=0)
    points = model.predict(Run(**record, vertices=blank))
    return Run(
        **record, vertices=points + noise * np.random.default_rng(1).normal(size=points.shape)
    )


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    return str(save_bundle(builtin_model(), tmp_path_factory.mktemp("advice") / "finger"))


def effects_of(run, bundle, folder, capsys):
    run.save(folder / "run.npz")
    assert main(["check", str(folder / "run.npz"), "--bundle", bundle, "--json"]) == 0
    return {row["name"]: row for row in json.loads(capsys.readouterr().out)["effects"]}


def test_every_candidate_has_its_line(bundle, tmp_path, capsys):
    found = effects_of(recorded(standard_protocol()), bundle, tmp_path, capsys)
    # a table has no law of tendons
    assert list(found) == [e["name"] for e in effects() if e["role"] != "prior"]
    hidden = {name for name, row in found.items() if not row["shows"]}
    # the room stays cool, and the cameras have no poses
    assert hidden == {"thermal_softening", "lens"}
    alike = {name: set(row["alike"]) for name, row in found.items() if row["alike"]}
    assert alike["latency"] == {"clock_shift"} and alike["clock_shift"] == {"latency"}
    loads = alike.get("gravity", set()) | alike.get("payload", set())
    # two orientations separate loads; softness under them needs another load
    assert loads <= {"stiffness"}
    assert main(["check", str(tmp_path / "run.npz"), "--bundle", bundle]) == 0
    text = capsys.readouterr().out
    assert all((f"+ {name}" in text) == (name not in hidden) for name in found)


def test_a_calibrated_bundle_says_what_the_ticks_are(bundle, tmp_path, capsys):
    run, home, b = recorded(standard_protocol()), np.array([1500.0, 1800.0]), np.zeros(2)
    one = np.eye(2)
    calibration = Calibration(
        0.005 * one, b, home, one, b, dict.fromkeys(ERRORS, 0.0), "none", 1, 1
    )
    reported = replace(run, command=None, ticks=np.rint(run.command / 0.005 + home).astype(int))
    reported.save(tmp_path / "ticks.npz")
    own = str(save_bundle(replace(builtin_model(), calibration=calibration), tmp_path / "own"))
    assert main(["check", str(tmp_path / "ticks.npz"), "--bundle", own]) == 0
    text = capsys.readouterr().out
    assert (
        "missing   command" not in text
        and "ticks, as commands by the calibration of the bundle" in text
    )
    with_it, without = (
        summary(reported, replace(builtin_model(), calibration=calibration)),
        summary(reported),
    )
    assert with_it.hash == without.hash == reported.hash() and with_it.command_unit == "mm"
    np.testing.assert_allclose(with_it.command_range, summary(run).command_range, atol=0.003)
    assert with_it.home_visits == summary(run).home_visits > without.home_visits
    assert any("only ticks are given" in line for line in without.missing)


def test_effects_that_a_poor_run_cannot_show_are_named_with_the_experiment(
    bundle, tmp_path, capsys
):
    p = standard_protocol()
    still = effects_of(recorded(p, held(p.t), np.array([0.0, 0, 1])), bundle, tmp_path, capsys)
    for name in ("gain", "latency", "lag", "backlash", "hysteresis", "creep"):
        assert not still[name]["shows"] and "too weak to detect here" in still[name]["why"], name
    assert set(still["gravity"]["alike"]) == {"payload", "stiffness"}  # one orientation, one load
    assert "orientation" in still["gravity"]["experiment"]
    slow = effects_of(recorded(p, p.command * 0.02), bundle, tmp_path, capsys)
    assert not slow["gain"]["shows"]
    main(["check", str(tmp_path / "run.npz"), "--bundle", bundle])
    assert "does not show" in capsys.readouterr().out


def test_larger_noise_hides_more(bundle, tmp_path, capsys):
    p = standard_protocol()
    clear, noisy = (effects_of(recorded(p, noise=n), bundle, tmp_path, capsys) for n in (0.1, 2.0))
    assert all(
        clear[name]["deviations"] > 3 * noisy[name]["deviations"]
        for name in ("latency", "backlash", "creep")
    )
