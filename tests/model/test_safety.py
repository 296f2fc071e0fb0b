"""Limits of a finger: derived from its model, carried by its bundle, edited by hand, never
out of range.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from robots import arc, rings

from softmap_edge.cli import main
from softmap_edge.errors import BundleError
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Simulator
from softmap_edge.model.bundle import builtin_model, load_bundle, save_bundle
from softmap_edge.model.manifest import load_manifest
from softmap_edge.model.safety import MARGIN, derived
from softmap_edge.rod.learn import learn_model
from softmap_edge.run.run import Run
from softmap_edge.sweep.build import model_from_file

FINGER = Finger.builtin()
MODEL = builtin_model()


@pytest.fixture
def bundle(tmp_path):
    return save_bundle(MODEL, tmp_path / "bundle")


def edit(bundle, *changes):
    """Change the text of a bundle's safety.toml as a human does: the manifest stays."""
    text = (bundle / "safety.toml").read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    (bundle / "safety.toml").write_text(text, encoding="utf-8")


def test_the_built_in_finger_has_limits_that_the_simulator_confirms():
    """Tension and strain are those of the simulation at the worst place, on the sweep's own
    mesh.
    """
    safety = MODEL.safety
    assert (safety.low, safety.high) == ((-16.0, -16.0), (16.0, 16.0))
    commands = np.array([[-16.0, -4.0], [16.0, 0.0], [16.0, 16.0], [4.0, 4.0]])
    simulator = Simulator(FINGER)
    vertices, pull = simulator.path_and_pull(commands)
    assert pull.max() == pytest.approx(safety.simulated["tension_n"], rel=0.01)
    assert safety.tension == pytest.approx(MARGIN * safety.simulated["tension_n"], rel=1e-3)
    assert safety.simulated["modulus_mpa"] == FINGER.young_mpa and "0.25 MPa" in safety.assumes
    rest, triangles = simulator.template.vertices, simulator.template.triangles
    longer = np.linalg.norm(vertices[:, triangles[:, 1]] - vertices[:, triangles[:, 0]], axis=2)
    sides = longer / np.linalg.norm(rest[triangles[:, 1]] - rest[triangles[:, 0]], axis=1) - 1.0
    assert 0.5 * safety.simulated["strain"] < sides.max() <= 1.02 * safety.simulated["strain"], (
        "no side is longer"
    )


@pytest.mark.parametrize("gamma", [0.0, 0.5])
def test_a_stretched_or_sheared_sheet_has_the_strain_of_its_closed_form(gamma):
    """λ − 1 of the larger principal stretch: of a stretch by a quarter, and of a simple shear γ/2 +
    √(1 + γ²/4) − 1.
    """
    gradient = (
        np.diag([1.25, 1.0, 1.0])
        if gamma == 0.0
        else np.eye(3) + gamma * np.outer([1, 0, 0], [0, 1, 0])
    )
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])

    class Sheet:
        channels = 2

        def evaluate(self, u):
            return np.tile((corners @ gradient.T).ravel(), (len(u), 1))

    sheet = replace(
        MODEL.with_structure(
            prior=Sheet(),
            rest=corners,
            triangles=np.array([[0, 1, 2], [1, 3, 2]], np.int32),
            body=None,
        ),
        arrays=None,
    )
    strain = 0.25 if gamma == 0.0 else gamma / 2 + np.sqrt(1 + gamma**2 / 4) - 1
    assert derived(sheet).simulated["strain"] == pytest.approx(strain, abs=1e-4)


def test_it_travels_with_the_bundle_and_its_bytes_are_the_same(bundle, tmp_path):
    read = load_bundle(bundle)
    assert read.safety == MODEL.safety and not read.safety.edited
    assert load_manifest(bundle)["schema"] == 7 and "safety.toml" in load_manifest(bundle)["sha256"]
    assert (save_bundle(read, tmp_path / "again") / "safety.toml").read_bytes() == (
        bundle / "safety.toml"
    ).read_bytes()
    assert read.with_effects(["gain"], {}).safety == MODEL.safety


def test_a_bundle_of_before_has_none_and_is_read(tmp_path):
    old = save_bundle(replace(MODEL, safety=None), tmp_path / "old")
    assert load_manifest(old)["schema"] < 7 and not (old / "safety.toml").exists()
    assert load_bundle(old).safety is None
    assert (
        derived(load_bundle(old)).high == (16.0, 16.0)
        and "an unnamed modulus" in derived(load_bundle(old)).assumes
    )


def test_what_is_edited_by_hand_counts_and_is_reported(bundle, tmp_path):
    edit(bundle, ("high = [16.0, 16.0]", "high = [9.0, 12.5]"), ("slew = 8.0", "slew = 3.0"))
    safety = load_bundle(bundle).safety
    assert safety.edited and safety.high == (9.0, 12.5) and safety.slew == 3.0
    again = save_bundle(load_bundle(bundle), tmp_path / "again")
    assert load_bundle(again).safety == safety and not load_bundle(again).safety.edited


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            "high = [16.0, 16.0]",
            "high = [16.0, 20.0]",
            r"window of command 2 is -16 to 20 mm; allowed is .* -16 to 16",
        ),
        ("low = [-16.0, -16.0]", "low = [17.0, -16.0]", "window of command 1 is 17 to 16"),
        ("high = [16.0, 16.0]", "high = [16.0]", r"high has shape \(1,\), expected \(2,\)"),
        ("low = [-16.0, -16.0]\n", "", "no low or no high"),
        ("slew = 8.0", "slew = 900.0", "slew = 900.0, expected 0.0032 to 640"),
        ("acceleration = 80.0", "acceleration = nan", "acceleration = nan, expected"),
        ("slew = 8.0", 'slew = "fast"', "slew is text .fast."),
        ("jump = [8.0, 32.0]", "jump = [8.0, 4.0]", "0 ≤ warned ≤ refused ≤ 32"),
        ("tension_n = 12.75", "tension_n = 90.0", "tension_n = 90.0, expected 0.001 to 25.497"),
        ("stale = 0.25", "stale = 9.0", "stale = 9.0, expected 0.001 to 2"),
        ("hold = 2.0\n", "", "no hold; give 0.001 to 60"),
        ("turns = 4.0", "turns = 0.0", "turns = 0.0, expected 0.1 to 100"),
        ("band = 0.02", "band = 5.0", "band = 5.0, expected 0 to 3.2"),
        ("[reversal]", "[reversal]\nfly = 1", "no key 'fly'"),
        ("[time]", "[times]", "no key 'times'"),
        ('unit = "mm"', 'unit = "N"', "unit = 'N', expected one of mm"),
        ("softmap.safety/1", "softmap.safety/9", "expected one of softmap.safety/1"),
        ("slew = 8.0", "slew = = 8.0", "no TOML"),
    ],
)
def test_what_is_out_of_range_or_unknown_is_refused_with_numbers(bundle, old, new, says):
    edit(bundle, (old, new))
    with pytest.raises(BundleError, match=says) as refused:
        load_bundle(bundle)
    assert "bundle: safety.toml" in str(refused.value) and "\n" not in str(refused.value)


def test_a_file_that_is_gone_or_no_text_is_refused(bundle):
    (bundle / "safety.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(BundleError, match="is not text"):
        load_bundle(bundle)
    (bundle / "safety.toml").unlink()
    with pytest.raises(BundleError, match=r"safety\.toml is missing"):
        load_bundle(bundle)


def test_a_narrower_model_narrows_the_window(tmp_path):
    narrow = MODEL.with_structure(command_range=np.array([[-5.0, 5.0], [-16.0, 16.0]]))
    read = load_bundle(save_bundle(narrow, tmp_path / "narrow")).safety
    assert read.low == (-5.0, -16.0) and read.high == (5.0, 16.0)
    elsewhere = MODEL.with_structure(command_range=np.array([[20.0, 30.0], [-16.0, 16.0]]))
    assert load_bundle(save_bundle(elsewhere, tmp_path / "elsewhere")).safety.low == (20.0, -16.0)


@pytest.mark.long
def test_build_writes_it_for_a_simulated_finger(tmp_path, capsys):
    finger = FINGER.replace(core=2, layers=10, young_mpa=0.4)
    (tmp_path / "finger.toml").write_text(finger.to_toml(), encoding="utf-8")
    argv = [
        "build",
        str(tmp_path / "finger.toml"),
        "--steps",
        "5",
        "--out",
        str(tmp_path / "bundle"),
        "--json",
    ]
    assert main(argv) == 0
    assert json.loads(capsys.readouterr().out)["schema"] == "softmap.build/1"
    safety = load_bundle(tmp_path / "bundle").safety
    assert (
        "0.4 MPa" in safety.assumes
        and safety.simulated["tension_n"] > MODEL.safety.simulated["tension_n"]
    )


def test_an_imported_sweep_has_strains_but_no_tension(tmp_path):
    u = np.random.default_rng(0).uniform(-5, 5, (25, 2))
    np.savez(tmp_path / "bare.npz", command=u, vertices=arc(u, *rings(4, 7)))
    corners = {"triangles": np.array([[0, 1, 7], [1, 8, 7]])}
    np.savez(tmp_path / "sweep.npz", command=u, vertices=arc(u, *rings(4, 7)), **corners)
    bare, whole = (model_from_file(tmp_path / name).safety for name in ("bare.npz", "sweep.npz"))
    assert (
        bare.tension is None
        and not bare.simulated
        and "tensions are not known, nor strains" in bare.assumes
    )
    assert (
        whole.tension is None
        and set(whole.simulated) == {"strain"}
        and "imported sweep" in whole.assumes
    )
    read = load_bundle(
        save_bundle(model_from_file(tmp_path / "bare.npz"), tmp_path / "bundle")
    ).safety
    assert read == bare


def test_a_rod_has_the_window_of_the_run_that_taught_it(tmp_path):
    t = np.arange(0.0, 60.0, 0.5)
    command = np.stack([4.0 * np.sin(0.5 * t), 3.0 * np.sin(0.31 * t)], axis=1)
    bent = np.stack([command[:, 0], command[:, 1], 80.0 - 0.02 * (command**2).sum(axis=1)], axis=1)
    markers = np.stack([0.4 * bent * [1, 1, 1.2], bent], axis=1)
    model = learn_model(Run(t=t, command=command, t_seen=t, markers=markers))
    safety = load_bundle(save_bundle(model, tmp_path / "rod")).safety
    assert safety == model.safety and safety.tension is None and not safety.simulated
    assert "the run that taught it" in safety.assumes
    assert np.all(np.array(safety.high) <= command.max(axis=0)) and safety.high[0] > 3.9


def test_nothing_commanded_has_no_limits():
    class Still:
        channels = 0

    assert derived(MODEL.with_structure(prior=Still())) is None
