"""A residual is learned, carried and predicted with; a diagnosis takes it out, so that it hides no
physics.

The commands of docs/do/residual.md run as they stand there, and print what stands there.
"""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from finger_runs import finger_run, named
from page import blocks, run_commands
from story_of_demo import FIRST, SECRETS

from softmap_edge import (
    _core,
    builtin_model,
    compare,
    diagnose,
    learn_residual,
    load_bundle,
    refit,
    save_bundle,
)
from softmap_edge.cli import main
from softmap_edge.errors import BundleError, SoftmapError
from softmap_edge.experiment.blocks import chosen, plan
from softmap_edge.files.npz import Stored
from softmap_edge.rod.robot import Robot
from softmap_edge.run.protocol import Limits
from softmap_edge.synthetic.finger import HiddenEffect, Truth

MODEL = builtin_model()
PAGE = (Path(__file__).parents[2] / "docs/do/residual.md").read_text(encoding="utf-8")
PAYLOAD = {"payload.mass": 15.0}
SOME = [
    "offset",
    "gain",
    "tendon_stretch",
    "backlash",
    "hysteresis",
    "creep",
    "gravity",
    "payload",
    "pre_curve",
    "mount",
]


def hanging(run):
    """The frames in which gravity points along the body, as a run of one orientation."""
    level = run.gravity[np.searchsorted(run.t, run.t_seen)][:, 2] > 0.9
    return replace(run.at(level), gravity=np.array([0.0, 0.0, 1.0]))


def warped(run, size):
    """The run of a body that differs from the model by a smooth static field which is no effect's,
    mm at the tip.
    """
    u = run.command_at(run.t_seen)
    field = np.stack([np.sin(u[:, 0] / 5), np.cos(u[:, 1] / 6) * u[:, 0] / 8, 0 * u[:, 0]], axis=1)
    height = (MODEL.rest[:, 2] / MODEL.rest[:, 2].max()) ** 2
    return replace(run, vertices=run.vertices + size * field[:, None] * height[None, :, None])


@pytest.fixture(scope="module")
def loaded():
    return hanging(finger_run(["payload"], PAYLOAD))


@pytest.fixture(scope="module")
def adapted(loaded):
    return learn_residual(MODEL, loaded)


# --- learned, predicted, carried ----------------------------------------------------------------


def test_commands_beyond_those_that_taught_it_are_reported(loaded, tmp_path, capsys):
    u = loaded.command_at(loaded.t_seen)
    near, _ = learn_residual(MODEL, loaded.at((np.abs(u) < 6.0).all(axis=1)))
    save_bundle(near, tmp_path / "near")
    loaded.save(tmp_path / "run.npz")
    outside = (np.abs(u) > 6.0 * 1.1).any(axis=1).mean()
    for verb in ("predict", "compare"):
        assert main([verb, str(tmp_path / "run.npz"), "--bundle", str(tmp_path / "near")]) == 0
        said = capsys.readouterr().err
        assert "leave what taught the residual" in said and "channel 1 from" in said
        share = int(said.split(" of ")[0].split()[-1]) / loaded.frames
        assert outside - 0.05 < share < 1.0
    assert main(["model", "predict", "5,-5", "--bundle", str(tmp_path / "near")]) == 0
    assert "taught" not in capsys.readouterr().err
    # A bundle is somebody else's file: its description of itself may be anything.
    odd = replace(
        near, made_from=dict(near.made_from) | {"residual": {"command_range": [["x"], None]}}
    )
    save_bundle(odd, tmp_path / "odd")
    assert main(["model", "predict", "12,12", "--bundle", str(tmp_path / "odd")]) == 0


def test_it_takes_the_error_away_and_says_so_held_out(adapted, loaded):
    model, report = adapted
    noise = 0.25 * np.sqrt(3.0)
    before, after = (compare(m, loaded).error["rms_mm"] for m in (MODEL, model))
    assert report["before_rms_mm"] == pytest.approx(before, rel=0.05)
    assert after < 1.03 * noise < 0.9 * before
    assert noise < report["after_held_out_rms_mm"] < 1.05 * noise
    assert model.made_from["residual"]["run"] == [loaded.hash()]


def test_every_prediction_has_it_and_the_clamp_stays(adapted, loaded):
    model, _ = adapted
    more = model.predict(loaded) - MODEL.predict(loaded)
    field = model.residual.evaluate(loaded.command_at(loaded.t_seen)).reshape(more.shape)
    np.testing.assert_allclose(more, field, atol=1e-9)
    assert np.sqrt(np.mean(np.sum(field**2, axis=2))) == pytest.approx(
        adapted[1]["size_mm"], rel=1e-6
    )
    clamp = MODEL.rest[:, 2] < 1e-6
    assert clamp.any() and np.all(field[:, clamp] == 0.0)
    np.testing.assert_allclose(
        model.features(loaded), model.structure.feature_map(model.predict(loaded)), atol=1e-6
    )
    markers = replace(
        loaded, vertices=None, markers=loaded.vertices[:, ::50], marker_rest=MODEL.rest[::50]
    )
    moved = model.predict(markers) - MODEL.predict(markers)
    assert np.sqrt(np.mean((moved - field[:, ::50]) ** 2)) < 0.05 < np.sqrt(np.mean(moved**2))
    assert compare(model, loaded).bundle["sha256"] != compare(MODEL, loaded).bundle["sha256"]


def test_it_acts_on_what_the_effects_make_of_the_command(loaded):
    late = MODEL.with_effects(["latency"], {"latency.delay": 0.3})
    run = replace(loaded, vertices=late.predict(loaded))
    field = warped(run, 1.0)
    shifted = replace(field, vertices=late.predict(loaded) + (field.vertices - run.vertices))
    model, _ = learn_residual(late, shifted)
    assert model.chain_names == ("latency",) and compare(model, shifted).error["rms_mm"] < 0.25


def test_a_bundle_carries_it(adapted, loaded, tmp_path):
    model = replace(adapted[0], safety=None)  # as an older bundle, without limits
    folder = save_bundle(model, tmp_path / "b")
    again = load_bundle(folder)
    np.testing.assert_allclose(again.predict(loaded), model.predict(loaded), atol=1e-4)
    assert json.loads((folder / "manifest.json").read_text())["schema"] == 4
    for file in save_bundle(again, tmp_path / "c").iterdir():
        assert file.read_bytes() == (folder / file.name).read_bytes(), file.name
    (folder / "residual.npz").unlink()
    with pytest.raises(BundleError, match="residual.npz is missing"):
        load_bundle(folder)
    plain = save_bundle(model.with_residual(None), tmp_path / "d")
    assert json.loads((plain / "manifest.json").read_text())["schema"] < 4
    assert not (plain / "residual.npz").exists()
    shutil.copy(tmp_path / "c" / "residual.npz", plain)  # no manifest names it
    assert load_bundle(plain).residual is None


def test_it_belongs_to_its_effects(adapted, loaded):
    model, _ = adapted
    assert model.with_effects(["gain"], {"gain.factor[0]": 1.02}).residual is None
    assert (
        model.with_residual(None).residual is None
        and model.with_residual(None).arrays.residual is None
    )
    with pytest.raises(
        SoftmapError, match="the residual maps 2 commands to 3 numbers, the prior 2 to"
    ):
        known = model.arrays.residual
        few = replace(known, mean=np.zeros(3), modes=Stored(known.modes.array[:, :3]))
        MODEL.with_residual(few)
    worn = MODEL.with_effects(["backlash"], {"backlash.gap": 0.5})
    changed, _ = refit(learn_residual(worn, loaded)[0], loaded)
    assert changed.residual is None


def test_an_effect_of_the_prior_s_own_law_reaches_the_prior_through_it():
    robot = Robot.load(Path(__file__).parents[2] / "examples/tdcr_robot.toml").with_slack(1.0)
    rod, rng = robot.layout.compiled(robot.start), np.random.default_rng(0)
    size, t = rod.size, np.arange(0.0, 9.0, 0.5)
    nodes, weights = rng.uniform(-4, 4, (12, 9)), rng.normal(size=(22, 1))
    field = _core.Scattered(nodes, np.full(9, 4.0), 1, weights, np.zeros(size), np.ones((1, size)))
    assert rod.numbers and _core.Sum(rod, field).numbers == rod.numbers
    u = 4.0 * np.sin((0.3 + 0.1 * np.arange(9)) * t[:, None])
    chain = _core.Chain(["slack"], 9)
    both, alone = (
        _core.Predictor(prior, {}, np.ones(size // 3, bool), np.array([0.0, 0.0, 1.0])).predict(
            chain, np.array([[0.3]]), _core.Inputs(u, t, t)
        )[0]
        for prior in (_core.Sum(rod, field), rod)
    )
    np.testing.assert_allclose((both - alone).reshape(len(t), -1), field.evaluate(u), atol=1e-9)
    assert np.abs(alone.reshape(len(t), -1) - rod.evaluate(u)).max() > 0.1


def test_what_teaches_nothing_is_refused(loaded):
    with pytest.raises(SoftmapError, match="29 frames show every point, at least 30"):
        learn_residual(MODEL, loaded.at(np.arange(29)))
    still = replace(loaded, command=np.zeros_like(loaded.command))
    with pytest.raises(SoftmapError, match="1 different commands are too few"):
        learn_residual(MODEL, still)
    markers = replace(
        loaded, vertices=None, markers=loaded.vertices[:, :4], marker_rest=MODEL.rest[:4]
    )
    with pytest.raises(SoftmapError, match="4 markers on a model of 548 points"):
        learn_residual(MODEL, markers)
    hidden = np.ones(loaded.vertices.shape[:2], bool)
    hidden[::2, 7] = False
    assert learn_residual(MODEL, replace(loaded, visible=hidden))[1]["frames"] == loaded.frames // 2


# --- what it may hide ---------------------------------------------------------------------------


def test_a_payload_behind_a_residual_is_named(adapted, loaded):
    """In one orientation gravity is an alternative; in two orientations it is not."""
    found = diagnose(adapted[0], loaded)
    assert named(found) == {"payload"} and found.verdict == "ambiguous"
    assert found.effects[0].params["payload.mass"].value == pytest.approx(15.0, abs=1.0)
    assert "residual of 0.3" in found.sentence and "was taken out" in found.sentence
    assert found.model.residual is None and set(found.model.chain_names) == {"payload"}
    both = diagnose(adapted[0], finger_run(["payload"], PAYLOAD), effects=SOME)
    assert named(both) == {"payload"} and both.verdict == "identified"
    json.dumps(found.to_dict(), allow_nan=False)


def test_a_run_too_poor_to_identify_an_effect_reports_the_candidates(adapted):
    """With 24 times the noise no effect can be accepted: that is not nothing."""
    run = hanging(finger_run(["payload"], PAYLOAD, noise=6.0))
    assert diagnose(MODEL, run).verdict == "nothing"
    found = diagnose(adapted[0], run)
    assert found.verdict == "cannot_tell" and not named(found)
    open_ones = {row.name: row for row in found.not_testable}
    assert found.not_testable[0].name == "payload" and "may be it" in open_ones["payload"].why
    assert open_ones["payload"].experiment == "another orientation" == found.next[0].block
    assert "it may hide payload" in found.sentence
    assert found.made_from["residual"]["may_be"][0][0] == "payload"


def of_another_finger(hidden):
    """A run of one orientation, solved by finite elements on another mesh, in another batch of
    silicone.
    """
    truth = Truth(4, (HiddenEffect(SECRETS[hidden], 0.0),))
    return truth.measure(plan(chosen(FIRST), Limits.of(MODEL.command_range)))


@pytest.mark.parametrize("hidden", ["payload", pytest.param("gravity", marks=pytest.mark.long)])
def test_a_weight_of_another_finger_is_never_nothing(hidden):
    run = of_another_finger(hidden)
    found = diagnose(learn_residual(MODEL, run)[0], run, effects=SOME)
    said = named(found) | {name for rival in found.alternatives for name in rival.effects}
    said |= {row.name for row in found.not_testable if "may be it" in row.why}
    assert hidden in said and found.verdict in ("identified", "ambiguous", "cannot_tell"), (
        found.sentence
    )


@pytest.mark.long
def test_memory_is_found_through_a_residual():
    run = finger_run(["hysteresis"], {"hysteresis.strength": 0.25, "hysteresis.reach": 5.0})
    model, report = learn_residual(MODEL, run)
    assert report["size_mm"] > 0.8  # it has learned what of the hysteresis looks static
    found = diagnose(model, run, effects=SOME)
    assert named(found) == {"hysteresis"} and found.verdict == "identified"
    assert found.effects[0].params["hysteresis.reach"].value == pytest.approx(5.0, rel=0.05)


@pytest.mark.parametrize(
    ("size", "reason"), [(0.15, "may be model error"), (0.7, "no single effect explains")]
)
def test_nothing_stays_nothing_and_says_what_the_residual_is(size, reason):
    run = warped(hanging(finger_run()), size)
    model, _ = learn_residual(MODEL, run)
    found = diagnose(model, run)
    assert found.verdict == "nothing" and not named(found)
    assert "was taken out" in found.sentence and reason in found.sentence
    assert found.model is model


def test_a_residual_of_another_run_is_reported(adapted):
    found = diagnose(adapted[0], hanging(finger_run()))
    assert (
        found.verdict == "nothing" and "it does not lower the error of this run" in found.sentence
    )


def test_a_reference_run_stands_for_the_residual_too(adapted, loaded):
    found = diagnose(
        adapted[0], loaded, effects=["payload", "offset"], reference=hanging(finger_run())
    )
    assert named(found) == {"payload"} and "was taken out" not in found.sentence


@pytest.mark.long
def test_the_page_as_written(tmp_path, capsys, monkeypatch):
    of_another_finger("payload").save(tmp_path / "hanging.npz")
    run_commands(PAGE, tmp_path)
    printed = [line.strip() for line in capsys.readouterr().out.splitlines()]
    wanted = [
        line for language, text in blocks(PAGE) if language == "text" for line in text.splitlines()
    ]
    assert len(wanted) == 4 and [line for line in wanted if line not in printed] == []
    assert load_bundle(tmp_path / "adapted").residual is not None
    nothing_left = [
        "model",
        "adapt",
        "hanging.npz",
        "--residual-only",
        "--bundle",
        "found",
        "--out",
        "again",
    ]
    monkeypatch.chdir(tmp_path)
    assert main(nothing_left) == 1


# --- the command ----------------------------------------------------------------------------------


def test_adapt_and_what_becomes_of_the_residual(tmp_path, loaded, capsys):
    loaded.save(tmp_path / "run.npz")
    run, bundle, out = (str(tmp_path / name) for name in ("run.npz", "adapted", "d.json"))
    assert main(["model", "adapt", run, "--residual-only", "--out", bundle]) == 0
    said = capsys.readouterr().out
    assert "residual of 0.3" in said and "blocks of the runs that were left out" in said
    assert (
        main(["model", "adapt", run, "--residual-only", "--out", bundle]) == 2
        and "--force" in capsys.readouterr().err
    )
    assert main(["compare", run, "--bundle", bundle]) == 0
    assert (
        main(
            ["diagnose", run, "--bundle", bundle, "--effects", "payload,gain,offset", "--out", out]
        )
        == 0
    )
    capsys.readouterr()
    assert (
        main(["add", "payload", "--from", out, "--bundle", bundle, "--out", str(tmp_path / "c")])
        == 0
    )
    assert "is dropped; `softmap model adapt` learns it again" in capsys.readouterr().out
    assert load_bundle(tmp_path / "c").residual is None and load_bundle(bundle).residual is not None
    assert (
        main(["model", "remove", "residual", "--bundle", bundle, "--out", str(tmp_path / "bare")])
        == 0
    )
    assert load_bundle(tmp_path / "bare").residual is None
    assert (
        main(
            [
                "model",
                "remove",
                "residual",
                "--bundle",
                str(tmp_path / "bare"),
                "--out",
                str(tmp_path / "no"),
            ]
        )
        == 2
    )
