"""The tables of `softmap evaluate`: figures that are known, and the words beside those of the paper."""

import json
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch")

from softmap_training.evaluate import PUBLISHED, fall, judged, on_run, on_shapes

from softmap_edge import Run, builtin_model
from softmap_edge.cli import main
from softmap_edge.solid.finger import Finger
from softmap_edge.solid.simulator import Simulator
from softmap_edge.truth_clouds import FULL, TWO

MODEL = builtin_model()


def test_a_shift_has_the_vertex_error_of_the_shift_and_no_shift_has_none():
    u = np.random.default_rng(0).uniform(-8, 8, (6, 2))
    points = np.asarray(MODEL.prior.evaluate(u))
    shifted = points + np.tile([0.0, 0.3, 0.4], points.shape[1] // 3)
    exact, off = (on_shapes("x", lambda v, p=p: p[: len(v)], u, points, {}) for p in (points, shifted))
    assert off.errors["vertex"] == pytest.approx(np.full(6, 0.5)) and exact.errors["vertex"].max() == 0.0
    assert off.errors["chamfer"] == pytest.approx(np.full(6, 1.0), rel=0.05) and exact.errors["chamfer"].max() < 1e-6
    assert fall(off, exact, "vertex") == pytest.approx(1.0)


def test_exact_geometry_scores_chamfer_on_two_views_but_not_surface():
    """Why both are told: the side that no camera sees has no points."""
    rng = np.random.default_rng(1)
    shape = np.asarray(MODEL.prior.evaluate(np.array([[6.0, -3.0]]))).reshape(1, -1, 3)
    two = replace(TWO, outliers=0.0, sigma_mm=0.0)
    clouds = [cameras.look(shape[0], MODEL.triangles, rng) for cameras in (two, replace(FULL, sigma_mm=0.0))]
    seen, whole = (judged(shape, [cloud], MODEL.triangles) for cloud in clouds)
    assert seen["surface"][0] < 0.02 and seen["chamfer"][0] > 1.5
    assert whole["chamfer"][0] < seen["chamfer"][0] - 0.5


def test_the_verb_prints_both_tables_beside_the_papers(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    finger = Finger.builtin().replace(core=2, layers=12)
    axis = np.linspace(-16.0, 16.0, 7)
    Simulator(finger, template=Simulator(Finger.builtin()).template).sweep([axis, axis]).save("s.npz")
    rng = np.random.default_rng(2)
    t = np.arange(4.0)
    run = Run(t=t, command=rng.uniform(-8, 8, (4, 2)), t_seen=t, robot=MODEL.robot)
    true = np.asarray(MODEL.with_effects(["offset"], {"offset.shift[0]": 1.0}).predict(run))
    clouds = [replace(TWO, points=800).look(shape, MODEL.triangles, rng) for shape in true]
    start = np.concatenate([[0], np.cumsum([len(c) for c in clouds])])
    replace(run, points=np.concatenate(clouds), start=start).save("run.npz")
    np.savez("truth.npz", vertices=true)
    assert main(["evaluate", "--set", "s.npz", "--model", "table", "--run", "run.npz", "--truth", "truth.npz"]) == 0
    text = capsys.readouterr().out
    assert "built-in" in text and "other data" in text and "±" in text and "surface" in text
    assert main(["evaluate", "--run", "run.npz", "--truth", "truth.npz", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    row = said["recorded"][0]
    exact = np.linalg.norm(MODEL.predict(run) - true, axis=2).mean()
    assert row["vertex_mm"]["mean"] == pytest.approx(exact) and row["surface_mm"]["mean"] > 0
    assert said["schema"] == "softmap.evaluation/1" and said["simulated"] == []


def test_the_papers_figures_are_those_of_its_table():
    assert PUBLISHED["published"] == ((0.389, 0.188), (0.196, 0.098)) and PUBLISHED["linear"][1] == (2.620, 1.143)


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        ([], "give --set SET, --run RUN"),
        (["--truth", "x.npz", "--set", "s.npz"], "goes with --run"),
        (["--set", "s.npz", "--model", "forest"], "there are"),
        (["--run", "r.npz", "--model", "gp"], "give --set"),
    ],
)
def test_wrong_use_is_said_before_the_work(argv, says, capsys):
    assert main(["evaluate", *argv]) == 2
    assert says in capsys.readouterr().err


def test_a_truth_of_another_run_is_refused():
    from softmap_training.errors import TrainingError

    t = np.arange(2.0)
    run = Run(t=t, command=np.zeros((2, 2)), t_seen=t, points=MODEL.rest[:2], start=np.array([0, 1, 2]))
    with pytest.raises(TrainingError, match="give that of this run"):
        on_run("x", MODEL, run, np.zeros((3, 548, 3)))
