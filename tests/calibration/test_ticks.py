"""Use of a found calibration: kept in a bundle, refused if damaged, runs in ticks
read through it.
"""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
from tick_runs import HOME, MODEL, A, B, commands, record, scattered

from softmap_edge import compare, diagnose, learn_residual, load_bundle, save_bundle
from softmap_edge.calibration.calibration import calibrate
from softmap_edge.errors import BundleError, CalibrationError, RunError
from softmap_edge.model.servo_calibration import Calibration, converted


@pytest.fixture(scope="module")
def found():
    return calibrate(MODEL, record(scattered(1), 1), home=HOME, window=(-7000.0, 7000.0))


# --- the calibration and the bundle -------------------------------------------------------------


def published(window=None):
    error = {"command": 0.1, "shape_mm": 1.0, "matched_shape_mm": 0.9}
    return Calibration(
        A, B, HOME, 0.01 * np.abs(A), np.full(2, 0.02), error, "0" * 64, 100, 30, window
    )


def test_ticks_and_commands_are_each_others_inverse_and_the_window_holds_what_is_called_usable():
    c, u = published((-7000.0, 7000.0)), np.random.default_rng(0).uniform(-16.0, 16.0, (50, 2))
    np.testing.assert_allclose(c.commands(c.ticks(u)), u, atol=np.abs(A).sum(axis=1).max() / 2)
    # as known of the published one
    assert np.abs(c.ticks([[18.0, 18.0]]) - HOME).max() == pytest.approx(7794, abs=1.0)
    reach = np.array([[-18.0, 18.0], [-18.0, 18.0]])
    usable = c.usable(reach)
    corners = np.stack(np.meshgrid(*usable), axis=-1).reshape(-1, 2)
    farthest = np.abs(c.ticks(corners) - HOME).max()
    assert farthest == pytest.approx(7000.0, abs=1.0)  # as large as its form allows
    assert np.all((usable[:, 0] > -18.0) & (usable[:, 1] < 18.0))
    np.testing.assert_array_equal(published().usable(reach), reach)


def test_a_command_beyond_the_window_becomes_what_its_held_servos_do():
    made = Calibration.stated([[0.01, 0.002], [0.0, 0.01]], [1.0, 0.0], [2000.0, 2000.0], "told")
    low, high = [1500, 1500], [2500, 2600]
    for ticks in ([2500, 1500], [1900, 2600], [2000, 2000]):
        np.testing.assert_allclose(
            made.within(made.commands(ticks), low, high), made.commands(ticks), atol=1e-12
        )
    np.testing.assert_allclose(
        made.within(made.commands([9000, 2100]), low, high), made.commands([2500, 2100])
    )
    np.testing.assert_allclose(
        made.within(made.commands([9000, -9000]), low, high), made.commands([2500, 1500])
    )


def test_a_window_holds_a_range_and_not_a_tick_less():
    reported, reach = published(), [[-1.0, 2.0], [-3.0, 1.0]]
    low, high = reported.holding(reach)
    corners = reported.ticks([[a, b] for a in reach[0] for b in reach[1]]) - reported.home
    assert corners.min() == low < 0 < high == corners.max()


def test_a_map_that_is_stated_claims_nothing_of_a_run():
    reported = Calibration.stated(A, B, HOME, "made up", (-5.0, 5.0), "ticks")
    np.testing.assert_array_equal(
        reported.commands([[2048, 2048]]), np.add(A @ (2048 - np.array(HOME)), B)[None]
    )
    assert (
        not reported.sigma_A.any()
        and not reported.sigma_b.any()
        and not any(reported.held_out.values())
    )
    assert (reported.run, reported.frames, reported.held, reported.unit) == (
        "made up",
        0,
        0,
        "ticks",
    )
    with pytest.raises(CalibrationError, match="expected"):
        Calibration.stated(A, B[:1], HOME, "made up")


def test_a_bundle_carries_its_calibration_and_older_ones_have_none(found, tmp_path):
    folder = save_bundle(replace(found.model, safety=None), tmp_path / "bundle")
    assert json.loads((folder / "manifest.json").read_text())["schema"] == 6
    read = load_bundle(folder).calibration
    assert read.to_dict() == found.calibration.to_dict()
    again = save_bundle(load_bundle(folder), tmp_path / "again")
    assert all((again / f.name).read_bytes() == f.read_bytes() for f in folder.iterdir())
    assert load_bundle(folder).with_effects(["gain"], {}).calibration is not None
    plain = save_bundle(replace(MODEL, safety=None), tmp_path / "plain")
    assert json.loads((plain / "manifest.json").read_text())["schema"] < 6
    assert load_bundle(plain).calibration is None


def set_to(*keys_and_value):
    *keys, last, value = keys_and_value

    def change(document):
        for key in keys:
            document = document[key]
        document[last] = value

    return change


@pytest.mark.parametrize(
    "change",
    [
        set_to("schema", "softmap.calibration/9"),
        set_to("unit", "turns"),
        set_to("A", [[1.0, 2.0], [2.0, 4.0]]),
        set_to("A", [[1.0, 0.0]]),
        set_to("A", [["1", "0"], ["0", "1"]]),
        set_to("b", [float("nan"), 0.0]),
        set_to("b", [1e300, 0.0]),
        set_to("b", [0.0]),
        set_to("home", [[1.0, 2.0]]),
        set_to("home", [10**400, 0]),
        set_to("sigma", "A", [[-1.0, 0.0], [0.0, 0.0]]),
        set_to("sigma", None),
        set_to("held_out", {}),
        set_to("frames", -3),
        set_to("run", "x\n" * 9),
        set_to("tick_window", [5, 10]),
        set_to("tick_window", 7),
    ],
)
def test_a_calibration_that_was_tampered_with_is_refused(found, tmp_path, change):
    folder = save_bundle(found.model, tmp_path / "bundle")
    file, manifest = folder / "calibration.json", json.loads((folder / "manifest.json").read_text())
    document = json.loads(file.read_text())
    change(document)
    file.write_text(json.dumps(document))
    with pytest.raises(BundleError, match="hash differs"):
        load_bundle(folder)
    manifest["sha256"]["calibration.json"] = hashlib.sha256(file.read_bytes()).hexdigest()
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(BundleError, match="calibration"):
        load_bundle(folder)


# --- runs that hold ticks -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def two():
    """One recording twice, in ticks and in mm, of a finger with a gain; and the calibrated
    model.
    """
    model = replace(MODEL, calibration=published())
    ticks = record(scattered(6, 24), 6, frames=3, wrong=0.0, off=0.0, law=lambda r: 1.15 * r)
    ticks = replace(ticks, present_ticks=ticks.ticks)
    u = commands(ticks.ticks)
    return model, ticks, replace(ticks, ticks=None, present_ticks=None, command=u, present=u)


def test_a_run_in_ticks_is_compared_predicted_diagnosed_and_adapted_to_like_the_same_run_in_mm(two):
    model, ticks, mm = two
    assert compare(model, ticks).error == pytest.approx(compare(model, mm).error, abs=1e-9)
    assert compare(model, ticks).run["sha256"] == ticks.hash()
    np.testing.assert_allclose(model.predict(ticks), model.predict(mm), atol=1e-9)
    found, same = (diagnose(model, run, effects=["gain", "offset"]) for run in (ticks, mm))
    assert found.verdict == same.verdict and "gain" in [e.name for e in found.effects]
    assert found.made_from["run"] == ticks.hash()
    one, other = (d.to_dict()["effects"] for d in (found, same))
    assert [e["name"] for e in one] == [e["name"] for e in other]
    for a, b in zip(one, other):
        assert {k: v["value"] for k, v in a["params"].items()} == pytest.approx(
            {k: v["value"] for k, v in b["params"].items()}, rel=1e-6
        )
    taught, same = (learn_residual(model, run)[1] for run in (ticks, mm))
    np.testing.assert_allclose(taught.pop("command_range"), same.pop("command_range"), rtol=1e-6)
    assert taught.pop("warnings") == same.pop("warnings") == []
    assert taught == pytest.approx(same, rel=1e-6)


def test_encoders_in_ticks_drive_the_model_and_what_was_seen_stays_as_it_is(two):
    model, ticks, _ = two
    away = replace(ticks, present_ticks=ticks.ticks + 400)
    run = converted(model, away)
    np.testing.assert_allclose(
        run.present - run.command, np.tile(A @ [400.0, 400.0], (len(run.t), 1)), atol=1e-9
    )
    assert run.vertices is away.vertices and run.ticks is None and run.present_ticks is None
    np.testing.assert_array_equal(model.commands(away), run.present)
    np.testing.assert_array_equal(replace(model, input="goal").commands(away), run.command)
    assert converted(MODEL, away) is away


def test_without_a_calibration_the_error_names_the_command(two):
    _, ticks, _ = two
    with pytest.raises(RunError, match="softmap model calibrate RUN --bundle"):
        compare(MODEL, ticks)
