"""Several runs of one robot are diagnosed together: shared effects, a camera frame of its own for
each run.
"""

from dataclasses import replace

import numpy as np
import pytest
from arm import arm, record_run
from finger_runs import finger_run

from softmap_edge import builtin_model, diagnose, refit
from softmap_edge.alignment.base_motion import FRAME
from softmap_edge.cli import main
from softmap_edge.diagnosis.document import Diagnosis
from softmap_edge.diagnosis.prepare import problem_of
from softmap_edge.diagnosis.records import Records, record_of
from softmap_edge.errors import SoftmapError


def turned(run, degrees, shift):
    """The run as a camera sees it that is turned about z and shifted, mm."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return replace(run, vertices=run.vertices @ turn.T + np.asarray(shift, float))


def test_several_runs_predict_as_each_alone():
    runs = [record_run({"gain.factor[0]": 1.1}, seed=s, frames=n) for s, n in ((0, 60), (1, 90))]
    both = Records(arm(), runs)
    names = ("gain", "mount")
    labels = both.layout(names).labels
    assert [label for label in labels if "@" in label] == [f"{name}@2" for name in FRAME]
    params = np.random.default_rng(0).normal(size=(3, len(labels))) * 0.1
    found, done = both.predict(names, params), 0
    for k, run in enumerate(runs):
        alone = record_of(arm(), run)
        own = params[:, both.layout(names).columns[k]]
        np.testing.assert_array_equal(found[:, done : done + len(alone)], alone.predict(names, own))
        done += len(alone)
    assert done == len(both) and np.all(np.diff(both.t_seen) > 0)


def test_some_frames_of_runs_are_those_frames_of_all_of_them():
    """Also where one of the runs is so short that evenly spread numbers would miss it."""
    runs = [record_run(seed=s, frames=n) for s, n in ((0, 300), (1, 2), (2, 300))]
    both, names = Records(arm(), runs), ("backlash", "mount")
    rows = both.spread_rows(50)
    few = both.some(rows)
    assert [part.frames for part in few.parts] == [25, 2, 25] and few._within == both._within
    params = np.random.default_rng(0).normal(size=(2, len(both.layout(names).labels))) * 0.1
    np.testing.assert_allclose(
        few.predict(names, params), both.predict(names, params)[:, rows], atol=1e-12
    )
    np.testing.assert_array_equal(few.seen, both.seen[rows])


@pytest.mark.parametrize(
    "names", [(), ("backlash", "payload"), ("camera_drift", "lag")], ids="+".join
)
def test_frames_of_which_little_is_seen_are_reported_with_the_others(names):
    """Sections that are hidden in some frames leave the same residual, predicted by forms or by all
    features.
    """
    run = finger_run(["backlash"], {"backlash.gap": 1.0})
    dark = np.ones((run.frames, run.vertices.shape[1]), bool)
    dark[3::29, :90] = dark[-1, 40:160] = False
    for runs in (replace(run, visible=dark), [replace(run, visible=dark), run]):
        problem = problem_of(
            record_of(builtin_model(), runs), ["backlash", "payload", "camera_drift", "lag"]
        )
        hidden = ~np.isfinite(problem.record.seen).all(axis=1)
        assert 5 < hidden.sum() < 0.25 * len(hidden) and problem._projected().few is not None
        space = problem.space(names)
        x = np.stack([space.start, 0.7 * space.start][: 2 if names else 1])
        whole = problem.modes(problem.record.predict(space.names, space.params(x)))
        np.testing.assert_allclose(
            problem.at(space, x), whole, rtol=0, atol=1e-7 * np.abs(whole).max()
        )


def test_shared_effect_and_a_camera_frame_for_each_run():
    """Two sessions of one finger: the same play, and a camera that was set up again."""
    run = finger_run(["backlash"], {"backlash.gap": 1.0})
    runs = [turned(run, 2.0, [0.0, 1.0, 0.0]), turned(run, -3.0, [1.5, 0.0, 0.0])]
    found = diagnose(builtin_model(), runs, effects=["backlash", "hysteresis", "gain", "mount"])
    assert [e.name for e in found.effects] == ["backlash"] and [f.name for f in found.faults] == [
        "mount"
    ]
    params = {k: p.value for k, p in found.faults[0].params.items()}
    assert params["mount.turn_z"] == pytest.approx(2.0, abs=0.3) and params[
        "mount.turn_z@2"
    ] == pytest.approx(-3.0, abs=0.3)
    assert found.effects[0].params["backlash.gap"].value == pytest.approx(1.0, abs=0.05)
    assert found.made_from["run"] == [r.hash() for r in runs]
    assert (
        found.model.params["mount.turn_z"] == params["mount.turn_z"]
        and len(found.model.params) == 7
    )
    again = Diagnosis.from_dict(found.to_dict())
    assert set(again.params_of("mount")) == {label for label in params if "@" not in label}


def test_two_orientations_in_two_runs_identify_what_neither_identifies_alone():
    run = finger_run(["payload"], {"payload.mass": 15.0})
    level = run.gravity[np.searchsorted(run.t, run.t_seen)][:, 2] > 0.9
    hanging, lying = run.at(level), run.at(~level)
    hanging = replace(hanging, gravity=np.array([0.0, 0.0, 1.0]))
    wanted = ["gravity", "payload", "offset"]
    both = diagnose(builtin_model(), [hanging, lying], effects=wanted)
    assert [e.name for e in both.effects] == ["payload"]
    assert both.effects[0].params["payload.mass"].value == pytest.approx(15.0, rel=0.1)


def test_refit_of_several_runs_and_runs_that_do_not_fit_together():
    run = finger_run(["backlash"], {"backlash.gap": 1.0})
    model = builtin_model().with_effects(["backlash"], {"backlash.gap": 0.3})
    better, report = refit(model, [run, run])
    assert better.params["backlash.gap"] == pytest.approx(1.0, abs=0.02)
    assert report.after_held_out_rms_mm < report.before_rms_mm
    markers = replace(run, vertices=None, markers=run.vertices[:, :3], marker_rest=model.rest[:3])
    with pytest.raises(SoftmapError, match="seen in the same way"):
        diagnose(model, [run, markers])
    with pytest.raises(SoftmapError, match="no run"):
        diagnose(model, [])


def test_command_takes_several_runs(tmp_path, capsys):
    for k in (1, 2):
        finger_run(["backlash"], {"backlash.gap": 1.0}, seed=k).save(tmp_path / f"{k}.npz")
    paths = [str(tmp_path / "1.npz"), str(tmp_path / "2.npz")]
    out = str(tmp_path / "d.json")
    assert main(["diagnose", *paths, "--effects", "backlash,offset", "--out", out]) == 0
    assert "backlash" in capsys.readouterr().out and len(Diagnosis.load(out).made_from["run"]) == 2
    assert main(["add", "backlash", "--from", out, "--out", str(tmp_path / "b")]) == 0
