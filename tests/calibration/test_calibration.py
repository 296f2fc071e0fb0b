"""Servo ticks in commands of a model: matched shapes, a map known as well as it says, what speaks
against it.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from tick_runs import HOME, MODEL, A, B, record, scattered

from softmap_edge import builtin_model, load_bundle
from softmap_edge.calibration.calibration import calibrate
from softmap_edge.calibration.matching import match
from softmap_edge.cli import main
from softmap_edge.errors import CalibrationError
from softmap_edge.geometry.rigid import rotation
from softmap_edge.run.run import ROLL_SEEN, Run
from softmap_edge.synthetic.depth_camera import FULL


@pytest.fixture(scope="module")
def found():
    return calibrate(MODEL, record(scattered(1), 1), home=HOME, window=(-7000.0, 7000.0))


# --- shapes to commands -------------------------------------------------------------------------


def shapes(u, seed=0, noise=0.5):
    rng, t = np.random.default_rng(seed), np.arange(len(u), dtype=float)
    seen = MODEL.prior.evaluate(u).reshape(len(u), -1, 3)
    visible = rng.random(seen.shape[:2]) < 0.6
    seen = np.where(visible[..., None], seen + noise * rng.normal(size=seen.shape), np.nan)
    return Run(t=t, command=u, t_seen=t, vertices=seen, visible=visible, sigma=np.array(noise))


def test_refined_matches_are_ten_times_nearer_than_those_of_the_grid_and_what_hangs_slack_is_not_reported():
    u = np.random.default_rng(0).uniform(-13.0, 13.0, (80, 2))
    run = shapes(u)
    fine, grid = match(MODEL, run), match(MODEL, run, refine=False)
    off = np.abs(fine.command - u)
    assert np.sqrt(np.mean(off[fine.observed] ** 2)) < 0.05
    assert np.sqrt(np.mean((grid.command - u)[grid.observed] ** 2)) > 0.2
    # both tendons of a pair slack
    assert 0.05 < 1.0 - fine.observed.mean() < 0.3 and off[~fine.observed].max() > 1.0
    spread = np.einsum(
        "kc,kcd,kd->k", fine.command - u, np.linalg.inv(fine.covariance), fine.command - u
    )
    assert 0.5 < np.median(spread) / 1.386 < 2.0  # the median of chi² of two


def test_what_only_roll_shows_does_not_move_a_match_that_is_seen_from_one_side():
    u, t = np.random.default_rng(1).uniform(5.0, 12.0, (20, 2)), np.arange(20.0)
    points = MODEL.prior.evaluate(u).reshape(20, -1, 3)
    centre = np.stack(
        [points[:, MODEL.sections == s].mean(axis=1) for s in np.unique(MODEL.sections)], axis=1
    )
    along = np.gradient(centre, axis=1)
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    axis, radius = along[:, MODEL.sections], points - centre[:, MODEL.sections]
    angle = np.radians(5.0) * np.random.default_rng(2).normal(size=(20, 1, 1))
    turned = (
        points
        + np.cross(axis, radius) * np.sin(angle)
        + np.cross(axis, np.cross(axis, radius)) * (1 - np.cos(angle))
    )
    side = np.tile(MODEL.rest[:, 0] > -1.0, (20, 1))
    run = Run(
        t=t, command=u, t_seen=t, vertices=turned, visible=side, extra={ROLL_SEEN: np.array(False)}
    )
    blind, fooled = match(MODEL, run), match(MODEL, replace(run, extra={}))
    errors = [
        np.sqrt(np.mean((m.command - u)[blind.observed & fooled.observed] ** 2))
        for m in (blind, fooled)
    ]
    assert errors[0] < 0.02 and errors[1] > 0.08, errors


# --- commands from ticks ------------------------------------------------------------------------


@pytest.mark.long
def test_the_published_map_is_recovered_within_its_stated_uncertainty_with_a_tenth_of_the_dwells_wrong():
    off, plain = [], []
    for seed in range(20):
        found = calibrate(MODEL, record(scattered(seed), seed), home=HOME)
        c = found.calibration
        off.append(np.r_[((c.A - A) / c.sigma_A).ravel(), (c.b - B) / c.sigma_b])
        x = np.column_stack([found.held.ticks - HOME, np.ones(len(found.held))])
        plain.append(np.linalg.lstsq(x, found.held.u, rcond=None)[0][:2].T - A)
        assert np.abs(c.A - A).max() < 1e-4
    assert 0.7 < np.std(off) < 1.4
    assert np.max(np.abs(off)) < 4.5
    # least squares is led astray by the wrong ones
    assert np.median([np.abs(p).max() for p in plain]) > 1e-4


def test_a_command_that_is_seen_often_counts_once():
    one, many = (
        calibrate(MODEL, record(scattered(2), 2, frames=f, wrong=0.0)).calibration for f in (1, 6)
    )
    assert many.frames == 6 * one.frames
    np.testing.assert_allclose(many.sigma_b, one.sigma_b, rtol=0.4)  # not by a factor of 2.4


def test_an_eccentric_pulley_is_reported_with_its_period_and_its_size():
    hold = scattered(3, 50)
    found = calibrate(
        MODEL, record(hold, 3, off=0.05, law=lambda r: r + 250.0 * np.sin(r * np.pi / 2048.0 + 0.5))
    )
    assert found.departures[0].kind == "period" and found.departures[0].better > 0.5
    assert "once a turn (4096 ticks) of servo 0, 1" in found.warnings[0]
    assert calibrate(MODEL, record(hold, 3, off=0.05)).affine


def test_play_is_reported_as_memory_and_as_large_as_it_is():
    found = calibrate(MODEL, record(scattered(4, 50), 4, off=0.05, play=0.8))
    assert [one.kind for one in found.departures] == ["memory"]
    apart = float(found.departures[0].sentence.split("act ")[1].split(" mm apart")[0])
    assert apart == pytest.approx(0.8, abs=0.1)


def test_a_kink_at_home_is_reported_where_it_is():
    found = calibrate(
        MODEL,
        record(scattered(5, 50), 5, off=0.05, law=lambda r: r * (1.0 + 0.3 * (r > 0))),
        home=HOME,
    )
    assert (
        found.departures[0].kind == "kink" and "all servos at home" in found.departures[0].sentence
    )


def test_a_turn_about_the_axis_is_reported_next_to_the_map_and_does_not_bend_it():
    """Tendons that are turned ask for commands across, which hang slack: matched commands jump over
    all of it.
    """
    turned, play = np.radians(5.0), 0.6
    run = record(scattered(11, 45), 11, off=0.05, wrong=0.05, play=play)
    run = replace(run, vertices=run.vertices @ rotation(np.array([0.0, 0.0, turned])).T)
    found = calibrate(MODEL, run, home=HOME)
    reported = {one.kind: one for one in found.departures}
    assert set(reported) == {"turn", "memory"} and "deg about the axis" in reported["turn"].sentence
    assert reported["turn"].size == pytest.approx(5.0, abs=0.1) and reported["turn"].better > 0.3
    off = (found.calibration.A - A) / found.calibration.sigma_A
    assert np.abs(off).max() < 4.0 and np.abs(found.calibration.A - A).max() < 3e-5
    as_published = calibrate(MODEL, run, home=HOME, refine=False)
    assert np.abs(as_published.calibration.A - A).max() > 8e-5
    straight = calibrate(
        MODEL, record(scattered(11, 45), 11, off=0.05, wrong=0.05, play=play), home=HOME
    )
    assert [one.kind for one in straight.departures] == ["memory"]


LATER = (pytest.param(seed, marks=pytest.mark.long) for seed in range(101, 104))


@pytest.mark.parametrize("seed", [100, *LATER])
def test_a_turn_of_two_degrees_is_reported_and_none_where_there_is_none(seed):
    run = record(scattered(seed), seed)
    turned = replace(run, vertices=run.vertices @ rotation(np.array([0.0, 0.0, np.radians(2.0)])).T)
    assert not calibrate(MODEL, run, home=HOME).departures
    found = calibrate(MODEL, turned, home=HOME)
    assert [one.kind for one in found.departures] == ["turn"]
    assert np.abs((found.calibration.A - A) / found.calibration.sigma_A).max() < 4.0


def test_what_no_form_explains_is_reported_as_well():
    found = calibrate(MODEL, record(scattered(9, 40), 9, off=0.9, wrong=0.0))
    assert found.affine and "less sure than their ± says" in found.warnings[0]


def test_shapes_that_the_model_makes_at_no_command_are_counted():
    run = record(scattered(1), 1)
    pushed = run.vertices.copy()
    pushed[4:7, :, 0] += 15.0 * np.sin(2.0 * np.pi * MODEL.rest[:, 2] / np.ptp(MODEL.rest[:, 2]))
    reported = [
        note
        for note in calibrate(MODEL, replace(run, vertices=pushed)).warnings
        if "like none" in note
    ]
    assert (
        len(reported) == 1
        and reported[0].startswith("3 of 30 shapes (10 %)")
        and "contact" in reported[0]
    ), reported
    assert not [note for note in calibrate(MODEL, run).warnings if "like none" in note]


def test_home_is_the_place_that_was_dwelt_at_most_often(found):
    own = calibrate(MODEL, record(scattered(1), 1))
    np.testing.assert_array_equal(own.calibration.home, np.rint(HOME))
    np.testing.assert_allclose(own.calibration.A, found.calibration.A, rtol=1e-6)
    moved = A @ (np.rint(HOME) - HOME)
    np.testing.assert_allclose(own.calibration.b - found.calibration.b, moved, atol=1e-5)


def test_a_run_of_clouds_is_registered_first():
    around = np.radians(np.arange(0.0, 360.0, 30.0) + 15.0)
    hold = np.rint(HOME + 2800.0 * np.column_stack([np.cos(around), np.sin(around)]))
    run, rng = record(hold, wrong=0.0, noise=0.01, off=0.0), np.random.default_rng(0)
    seen = [replace(FULL, points=2500).look(v, MODEL.triangles, rng) for v in run.vertices]
    start = np.cumsum([0, *map(len, seen)])
    clouds = replace(run, vertices=None, sigma=None, points=np.concatenate(seen), start=start)
    c = calibrate(MODEL, clouds, home=HOME).calibration
    np.testing.assert_allclose(c.A, A, atol=6e-5)
    np.testing.assert_allclose(c.b, B, atol=0.15)


@pytest.mark.parametrize(
    ("model", "run", "match"),
    [
        (
            MODEL,
            record(scattered(0, 5), wrong=0.0),
            r"different held commands.*at least 6 are needed.*hold 12",
        ),
        (
            MODEL,
            record(np.rint(HOME + np.linspace(-3e3, 3e3, 15)[:, None] * [1, 0.5])),
            r"lie on a line: .* across",
        ),
        (MODEL.with_effects(["gain"], {}), record(scattered(0, 9)), "counted twice"),
        (MODEL, shapes(np.zeros((3, 2))), "no ticks"),
        (MODEL, replace(record(scattered(0, 9)), ticks=np.zeros((360, 3), int)), "3 servos"),
        (
            MODEL,
            replace(record(scattered(0, 9)), vertices=record(scattered(0, 9)).vertices + 90.0),
            "softmap run align",
        ),
        (MODEL, record(scattered(0), law=lambda r: 0 * r), r"too few|not known|needed|line"),
    ],
    ids=["few", "line", "effects", "no ticks", "servos", "frame", "does not follow"],
)
def test_runs_that_identify_no_map_are_refused_with_numbers(model, run, match):
    with pytest.raises(CalibrationError, match=match):
        calibrate(model, run)


# --- the command ----------------------------------------------------------------------------------


def test_the_command_writes_a_bundle_a_document_and_a_picture(tmp_path, capsys):
    run = record(scattered(7), 7)
    run.save(tmp_path / "run.npz")
    out, picture = tmp_path / "calibrated", tmp_path / "pairs.svg"
    words = [
        "model",
        "calibrate",
        str(tmp_path / "run.npz"),
        "--out",
        str(out),
        "--home",
        *map(str, HOME),
    ]
    assert main([*words, "--window", "-7000", "7000", "--plot", str(picture), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "softmap.calibration/1" and document["affine"] is True
    assert document["run"] == run.hash() and document["tick_window"] == [-7000.0, 7000.0]
    assert (
        len(document["matched"]["ticks"])
        == document["held_commands"]
        == len(document["matched"]["command"])
    )
    np.testing.assert_allclose(document["A"], A, atol=1e-4)
    assert load_bundle(out).calibration.to_dict()["A"] == document["A"]
    assert picture.read_text().startswith("<?xml") and picture.stat().st_size > 10_000
    assert main(words) == 2  # the bundle stands there
    assert main([*words, "--force"]) == 0
    reported = capsys.readouterr().out
    assert "held out:" in reported and "±" in reported and "condition of A" in reported
    assert main(["check", str(out)]) == 0 and '"condition": 1.1' in capsys.readouterr().out


def test_the_command_ends_with_one_where_the_relation_is_not_affine(tmp_path, capsys):
    words = ["model", "calibrate", str(tmp_path / "run.npz"), "--out"]
    record(scattered(8, 45), 8, off=0.05, play=1.0).save(tmp_path / "run.npz")
    # which no map has, so that it is no fault of this one
    assert main([*words, str(tmp_path / "play")]) == 0
    assert "memory" in capsys.readouterr().out
    record(scattered(8, 45), 8, off=0.05, law=lambda r: r + 0.2 * np.abs(r)).save(
        tmp_path / "run.npz"
    )
    assert main([*words, str(tmp_path / "kink")]) == 1
    assert "a kink of all servos at home" in capsys.readouterr().out


def test_a_lean_that_is_declared_is_in_the_shapes_that_are_matched():
    """Without it a robot that leans seems to have got other commands."""
    model, t = builtin_model(), np.arange(12.0)
    commands = np.random.default_rng(5).uniform(-9.0, 9.0, (12, 2))
    lean = np.array([np.sin(0.35), 0.0, np.cos(0.35)])
    plain = Run(t=t, command=commands, t_seen=t, gravity=lean)
    run = replace(plain, vertices=np.asarray(model.predict(plain)))
    upright = replace(run, gravity=np.asarray(model.gravity_reference))
    found = [match(model, one) for one in (run, upright)]
    off = [np.median(np.abs(one.command - commands)[one.observed]) for one in found]
    assert found[0].mae_mm.max() < 0.05 < 0.1 < found[1].mae_mm.min()
    assert off[0] < 0.05 < 0.3 < off[1], off
