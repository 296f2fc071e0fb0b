"""The promise: a sweep from another simulator builds, and what hides in runs of that robot is
named.

The robots and their statics are those of tests/support/robots.py; the hidden memory is the truth's
own law.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from robots import HANGING, Rod, arc, measured, rings

from softmap_edge import Run, build_model, diagnose, load_bundle, save_bundle
from softmap_edge.cli import main
from softmap_edge.errors import SoftmapError
from softmap_edge.fem.build import grid_axes
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Simulator
from softmap_edge.model.training_range import command_extrapolation
from softmap_edge.sweep.build import model_from_file

PLACE, OFFSET = rings(13, 12)
LEANING = np.array([np.sin(0.6) * np.cos(0.4), np.sin(0.6) * np.sin(0.4), np.cos(0.6)])
GRAMS, MASS = 20.0, 0.4 / 9.80665e-3  # known load, mass of the body
STIFF = Rod(tendon=5000.0)  # its shapes without load are the arc's
HEAVY = Rod(weight=0.4, gravity=LEANING)


def grid(reach=14.0, steps=15):
    axis = np.linspace(-reach, reach, steps)
    return np.stack([g.ravel() for g in np.meshgrid(axis, axis, indexing="ij")], axis=1)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Two bundles built by the command: an arc from a shuffled grid, a heavy rod from scattered
    commands and a load.
    """
    folder = tmp_path_factory.mktemp("elsewhere")
    rng = np.random.default_rng(0)
    u = grid()[rng.permutation(225)]
    np.savez(folder / "arc.npz", command=u, vertices=arc(u, PLACE, OFFSET), robot="arc")
    u = rng.uniform(-14, 14, (400, 2))
    hung = np.array([[0.0, 0.0], [6.0, 0.0], [0.0, -6.0], [-5.0, 5.0]])
    place, offset = rings(11, 8)
    known = {
        "load": np.full(4, GRAMS), "loaded_command": hung, "mass": MASS,
        "loaded_vertices": HEAVY.shapes(hung, place, offset, grams=GRAMS),
    }  # fmt: skip
    shapes = HEAVY.shapes(u, place, offset)
    np.savez(folder / "rod.npz", command=u, vertices=shapes, robot="rod", gravity=LEANING, **known)
    for name in ("arc", "rod"):
        assert main(["build", str(folder / f"{name}.npz"), "--out", str(folder / name)]) == 0
    return folder


def reported(built, name, run, capsys):
    run.save(built / "run.npz")
    assert main(["diagnose", str(built / "run.npz"), "--bundle", str(built / name), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def body(name):
    if name == "arc":
        return lambda u, gravity, grams: STIFF.shapes(u, PLACE, OFFSET, gravity, grams)
    return lambda u, gravity, grams: HEAVY.shapes(u, *rings(11, 8), LEANING, grams)


def recorded(name, hidden, scale, seed=3):
    run = measured(body(name), hidden, seed, orientations=2 if name == "arc" else 1, scale=scale)
    if name == "arc":
        return run
    return Run(
        t=run.t, command=run.command, gravity=LEANING, t_seen=run.t_seen, vertices=run.vertices
    )


def test_both_are_what_the_robots_do_at_commands_they_never_saw(built):
    u = np.random.default_rng(5).uniform(-12, 12, (300, 2))
    for name, kind in (("arc", "table"), ("rod", "scattered")):
        model = load_bundle(built / name)
        assert (
            model.kind == kind
            and not model.markers
            and model.structure.feature_map.positions.sum() == 9
        )
        true = body(name)(u, HANGING if name == "arc" else LEANING, 0.0)
        error = np.sqrt(
            np.mean(np.sum((model.prior.evaluate(u).reshape(true.shape) - true) ** 2, axis=2))
        )
        # 0.01 mm is what the truth's own links add to the arc's closed form.
        assert error < 2.0 * model.vertex_error_mm + 0.01 and model.vertex_error_mm < 0.05


@pytest.mark.parametrize("name", ["arc", "rod"])
def test_a_hidden_backlash_is_named(built, name, capsys):
    found = reported(built, name, recorded(name, "backlash", 0.5), capsys)
    assert [e["name"] for e in found["effects"]] == ["backlash"] and found[
        "verdict"
    ] == "identified"
    ladder = found["error"]["ladder"]
    assert ladder[-1]["value"] < 0.25 * found["error"]["model"]


def test_an_effect_behind_another_of_its_kind_leaves_a_doubt(built, capsys):
    """Commands that are off and a camera that leans look alike; the number of one of them alone is
    60 % wrong.
    """
    lean = np.array(
        [[np.cos(0.035), 0, np.sin(0.035)], [0, 1, 0], [-np.sin(0.035), 0, np.cos(0.035)]]
    )
    run = measured(lambda u, *_: arc(u + [0.8, 0.0], PLACE, OFFSET) @ lean.T, orientations=1)
    found = reported(built, "arc", run, capsys)
    if {"offset", "mount"} != {e["name"] for e in [*found["effects"], *found["faults"]]}:
        assert found["verdict"] == "ambiguous" and "both may act" in found["sentence"], found[
            "sentence"
        ]


def test_a_hidden_payload_is_named_and_never_in_grams(built, capsys):
    found = reported(built, "arc", recorded("arc", "payload", 2.5), capsys)
    assert found["effects"][0]["name"] == "payload" and len(found["effects"]) == 1
    assert found["effects"][0]["params"]["payload.mass"]["unit"] == "of the model's own load scale"
    assert found["error"]["ladder"][-1]["value"] < 0.15 * found["error"]["model"]


def test_with_a_known_load_a_payload_is_weighed(built, capsys):
    """In one orientation own weight and a weight at the tip look alike: ambiguous within the family
    is right.
    """
    found = reported(built, "rod", recorded("rod", "payload", 1.5), capsys)
    assert found["verdict"] == "ambiguous" and [e["name"] for e in found["effects"]] == ["payload"]
    assert [r["effects"] for r in found["alternatives"]] == [["gravity"]]
    mass = found["effects"][0]["params"]["payload.mass"]
    # loads are answered linearly
    assert mass["unit"] == "g" and mass["value"] == pytest.approx(15.0, rel=0.1)


@pytest.mark.parametrize("name", ["arc", "rod"])
def test_nothing_hidden_nothing_claimed(built, name, capsys):
    found = reported(built, name, recorded(name, None, 1.0), capsys)
    assert found["verdict"] == "nothing" and not found["effects"] and not found["faults"]


def test_the_known_load_finds_the_stiffness(built):
    model = load_bundle(built / "rod")
    assert model.structure.stiffness_known
    reported = model.made_from["compliance"]
    # 20 g bend the rod past the linear range: 13 % too stiff.
    assert reported["per_n_mm2"] == pytest.approx(1.0 / HEAVY.stiffness, rel=0.2)
    # Held tendons carry k r² L / (EI + k r² L) of the mean moment, two of them about each axis.
    carried = 2 * HEAVY.tendon * 6.5**2 * 100.0
    assert reported["lock"] == pytest.approx(carried / (carried + HEAVY.stiffness), abs=0.03)
    assert reported["residual_mm"] < 0.05 * reported["known_load_moved_mm"]
    u = np.random.default_rng(5).uniform(-12, 12, (60, 2))
    t = np.arange(60.0)
    place, offset = rings(11, 8)
    here = HEAVY.shapes(u, place, offset)
    for gravity, grams in ((HANGING, 0.0), (LEANING, 20.0)):
        true = HEAVY.shapes(u, place, offset, gravity, grams)
        found = model.predict(
            Run(t=t, command=u, t_seen=t, gravity=gravity, load=np.full(60, grams))
        )
        # linear response: 5 to 10 % off
        assert np.linalg.norm(found - true) < 0.12 * np.linalg.norm(here - true)


def test_loads_that_a_run_declares_are_not_made_up_where_no_stiffness_is_known(built):
    model = load_bundle(built / "arc")
    assert not model.structure.stiffness_known
    t, u = np.arange(3.0), np.full((3, 2), 5.0)
    plain = Run(t=t, command=u, t_seen=t)
    hung = Run(t=t, command=u, t_seen=t, gravity=LEANING, load=np.full(3, 50.0))
    np.testing.assert_array_equal(model.predict(plain), model.predict(hung))
    assert (
        command_extrapolation(model, plain) == []
        and "another gravity and a load" in command_extrapolation(model, hung)[0]
    )
    assert model.with_structure(stiffness_known=True).predict(hung)[0] != pytest.approx(
        model.predict(hung)[0], abs=0.1
    )


def test_a_bundle_of_a_sweep_is_the_same_after_a_journey(built, tmp_path):
    for name in ("arc", "rod"):
        model = load_bundle(built / name)
        again = load_bundle(save_bundle(model, tmp_path / name))
        run = recorded(name, None, 1.0)
        np.testing.assert_array_equal(
            model.predict_features((), np.zeros((1, 0)), run), again.features(run)[None]
        )
        for file in ("prior.npz", "fields.npz", "template.npz", "manifest.json"):
            assert (built / name / file).read_bytes() == (tmp_path / name / file).read_bytes()


def test_markers_without_a_mesh_on_three_places_and_five_thousand_vertices():
    for place, offset, features in (
        (np.array([33.0, 66.0, 100.0]), np.zeros((3, 3)), 3),
        (np.linspace(0, 100, 101), np.zeros((101, 3)), 9),
        (*rings(100, 50), 27),
    ):
        u = grid(steps=9)
        model = model_from_array(u, arc(u, place, offset))
        assert len(model.structure.feature_map.weights) == features and len(model.rest) == len(
            place
        )
        t, held = np.arange(3.0), np.full((3, 2), 4.0)
        run = Run(t=t, command=held, t_seen=t, vertices=arc(held, place, offset))
        assert np.abs(model.seen_features(run) - model.features(run)).max() < 0.2
        assert all(model.fields[name].evaluate(u[:1]).any() for name in model.fields)


def model_from_array(command, vertices, **fields):
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        np.savez(Path(folder) / "sweep.npz", command=command, vertices=vertices, **fields)
        return model_from_file(Path(folder) / "sweep.npz")


def test_three_channels_and_uneven_axes_are_a_table_and_six_are_scattered():
    axes = [np.array([-12.0, -7.0, 0.0, 5.0, 12.0])] * 2 + [np.linspace(0.0, 3.0, 4)]
    u = np.stack([g.ravel() for g in np.meshgrid(*axes, indexing="ij")], axis=1)[::-1]
    model = model_from_array(u, arc(u[:, :2] + u[:, 2:], PLACE, OFFSET))
    assert model.kind == "table" and model.channels == 3
    np.testing.assert_allclose([len(a) for a in model.prior.axes], [5, 5, 4])
    at_nodes = arc(u[:7, :2] + u[:7, 2:], PLACE, OFFSET).reshape(7, -1)
    np.testing.assert_allclose(model.prior.evaluate(u[:7]), at_nodes, atol=0.02)
    u = np.random.default_rng(2).uniform(-4, 4, (300, 6))
    pulled = u[:, :2] + u[:, 2:4] + 0.3 * u[:, 4:]
    model = model_from_array(u, arc(pulled, PLACE, OFFSET), command_unit="deg")
    assert (
        model.kind == "scattered"
        and model.command_unit == "deg"
        and 0.01 < model.vertex_error_mm < 3.0
    )


def test_one_channel_is_diagnosed_without_what_lies_between_channels():
    u = np.linspace(-12.0, 12.0, 25)[:, None]
    model = model_from_array(u, arc(np.pad(u, ((0, 0), (0, 1))), PLACE, OFFSET))
    t = np.arange(0.0, 120.0, 0.4)
    command = (8.0 * np.sin(0.35 * t) * np.clip(1.5 * np.sin(0.11 * t), -1.0, 1.0))[:, None]
    run = Run(t=t, command=command, t_seen=t)
    worn = model.with_effects(("backlash",), np.array([1.5]))
    noise = np.random.default_rng(1).normal(size=(len(t), *model.rest.shape)) * 0.2
    found = diagnose(model, replace(run, vertices=worn.predict(run) + noise))
    assert [e.name for e in found.effects] == ["backlash"], found.sentence
    assert "coupling" in {row.name for row in found.not_testable}


@pytest.mark.long
def test_a_sweep_of_this_simulator_builds_exactly_as_its_finger(tmp_path):
    finger = Finger.builtin().replace(core=2, layers=12, command_range=((-4.0, 4.0), (-4.0, 4.0)))
    Simulator(finger).sweep(grid_axes(finger, 5)).save(tmp_path / "sweep.npz")
    assert main(["build", str(tmp_path / "sweep.npz"), "--out", str(tmp_path / "one")]) == 0
    save_bundle(build_model(finger, 5), tmp_path / "two")
    for file in (tmp_path / "two").iterdir():
        assert file.read_bytes() == (tmp_path / "one" / file.name).read_bytes(), file.name


def test_check_and_show_say_what_a_sweep_holds(built, capsys):
    for verb in ("check", "show"):
        assert main([verb, str(built / "rod.npz")]) == 0
        said = capsys.readouterr().out
        assert "400 of 2 channels, scattered" in said and "20 g" in said and "88" in said
    assert main(["check", str(built / "arc.npz"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (
        document["kind"] == "sweep"
        and document["grid"] == [15, 15]
        and document["length_mm"] == pytest.approx(100.0)
    )
    assert any("no known load" in line for line in document["missing"])
    assert main(["check", str(built / "arc")]) == 0 and "stiffness_known" in capsys.readouterr().out


def test_a_known_load_that_says_nothing_is_refused(built):
    u = grid()
    few = u[[3, 50, 112]]
    known = {"load": np.full(3, 5.0), "loaded_command": few, "mass": 40.0, "gravity": LEANING}
    with pytest.raises(SoftmapError, match="effect size of the known load"):
        model_from_array(u, arc(u, PLACE, OFFSET), loaded_vertices=arc(few, PLACE, OFFSET), **known)
    light = Rod(tendon=5000.0)
    away = light.shapes(few, PLACE, OFFSET, -LEANING, 30.0)
    with pytest.raises(SoftmapError, match="against its own direction"):
        model_from_array(u, arc(u, PLACE, OFFSET), loaded_vertices=away, **known)
