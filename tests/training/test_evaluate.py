"""The tables of `softmap evaluate`: figures that are known, what is fitted next to them, and the
words next to the paper's.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from softmap_training import choices  # noqa: E402
from softmap_training.contenders import Plan, fitted_to_set, residuals  # noqa: E402
from softmap_training.errors import TrainingError  # noqa: E402
from softmap_training.evaluate import (  # noqa: E402
    PUBLISHED,
    Recording,
    Row,
    fall,
    halfway,
    holds_shapes_of,
    on_shapes,
)
from softmap_training.prior import Surface, train_prior, with_prior  # noqa: E402
from softmap_training.recordings import Lesson  # noqa: E402
from softmap_training.simulated import SimulatedSet  # noqa: E402

from softmap_edge import Run, builtin_model, load_bundle, save_bundle  # noqa: E402
from softmap_edge.adaptation.residual import learn_residual  # noqa: E402
from softmap_edge.alignment.result import in_frame  # noqa: E402
from softmap_edge.cli import main  # noqa: E402
from softmap_edge.errors import RunError  # noqa: E402
from softmap_edge.fem.finger import Finger  # noqa: E402
from softmap_edge.fem.simulator import Simulator  # noqa: E402
from softmap_edge.geometry.rigid import RigidPose, rotation  # noqa: E402
from softmap_edge.synthetic.depth_camera import FULL, TWO  # noqa: E402

torch.set_num_threads(1)
MODEL = builtin_model()
OFF = MODEL.with_effects(["offset"], {"offset.shift[0]": 1.0})
CAMERAS = replace(TWO, points=800)


def recorded(rows, seed):
    """Held commands, seen as clouds of a finger whose first command is off by 1 mm; and the true
    vertices.
    """
    rng = np.random.default_rng(seed)
    t = 3.0 * np.arange(float(rows))
    run = Run(t=t, command=rng.uniform(-8, 8, (rows, 2)), t_seen=t, robot=MODEL.robot)
    true = np.asarray(OFF.predict(run))
    clouds = [CAMERAS.look(shape, MODEL.triangles, rng) for shape in true]
    start = np.concatenate([[0], np.cumsum([len(c) for c in clouds])])
    return replace(run, points=np.concatenate(clouds), start=start), true


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with a small simulated set, a run for the fit, and one for validation with its
    truth.
    """
    folder = tmp_path_factory.mktemp("evaluate")
    finger = Finger.builtin().replace(core=2, layers=12)
    axis = np.linspace(-16.0, 16.0, 7)
    Simulator(finger, template=Simulator(Finger.builtin()).template).sweep([axis, axis]).save(
        folder / "s.npz"
    )
    recorded(32, 1)[0].save(folder / "teaches.npz")
    run, true = recorded(4, 2)
    run.save(folder / "run.npz")
    np.savez(folder / "truth.npz", vertices=true)
    return folder


def test_a_shift_has_the_vertex_error_of_the_shift_and_no_shift_has_none():
    u = np.random.default_rng(0).uniform(-8, 8, (6, 2))
    points = np.asarray(MODEL.prior.evaluate(u))
    shifted = points + np.tile([0.0, 0.3, 0.4], points.shape[1] // 3)
    exact, off = (
        on_shapes("x", lambda v, p=p: p[: len(v)], u, points, {}) for p in (points, shifted)
    )
    assert (
        off.errors["vertex"] == pytest.approx(np.full((1, 6), 0.5))
        and exact.errors["vertex"].max() == 0.0
    )
    assert off.errors["chamfer"] == pytest.approx(np.full((1, 6), 1.0), rel=0.05)
    assert exact.errors["chamfer"].max() < 1e-6
    assert fall(off, exact)["vertex"] == pytest.approx(1.0)


def test_exact_geometry_scores_chamfer_on_two_views_but_not_surface():
    """Why both are reported: the side that no camera sees has no points."""
    rng = np.random.default_rng(1)
    t = np.zeros(1)
    shape = np.asarray(MODEL.prior.evaluate(np.array([[6.0, -3.0]]))).reshape(1, -1, 3)
    run = Run(t=t, command=np.array([[6.0, -3.0]]), t_seen=t)
    two = replace(TWO, outliers=0.0, sigma_mm=0.0)
    clouds = [
        cameras.look(shape[0], MODEL.triangles, rng)
        for cameras in (two, replace(FULL, sigma_mm=0.0))
    ]
    runs = [replace(run, points=cloud, start=np.array([0, len(cloud)])) for cloud in clouds]
    seen, whole = (
        Recording.of(one, MODEL, shape).evaluate_shapes("x", shape, MODEL.triangles).errors
        for one in runs
    )
    assert seen["surface"][0, 0] < 0.02 and seen["chamfer"][0, 0] > 1.5
    assert whole["chamfer"][0, 0] < seen["chamfer"][0, 0] - 0.5
    assert seen["visible"][0, 0] < seen["chamfer"][0, 0] - 0.5  # unseen vertices do not count
    assert seen["vertex"][0, 0] == 0.0 and seen["whole"][0, 0] < 1e-6


def test_seeds_are_reported_as_a_mean_and_how_far_it_moves():
    rows = [
        Row("x", {"vertex": np.array([[1.0, 3.0]]) + shift}, {"seconds": 2.0 + shift})
        for shift in (0.0, 1.0, 2.0)
    ]
    said = Row.of_seeds(rows).to_dict()
    assert said["seeds"] == 3 and said["seconds"] == 3.0
    assert (
        said["vertex_mm"]["mean"] == 3.0
        and said["vertex_mm"]["sd"] == 1.0
        and said["vertex_mm"]["sd_of_seeds"] == 1
    )
    assert rows[0].to_dict()["vertex_mm"]["sd_of_seeds"] is None


def test_a_table_is_compared_where_nothing_was_reported():
    axis = np.asarray(MODEL.prior.axes[0])
    nodes = np.array([[axis[3], axis[30]], [axis[25], axis[20]], [axis[40], axis[0]]])
    assert holds_shapes_of(MODEL, nodes) and not holds_shapes_of(MODEL, nodes + 0.1)
    assert not holds_shapes_of(MODEL.with_structure(prior=MODEL.fields["gravity_x"]), nodes + 0.1)
    moved, shapes = halfway(MODEL, nodes, Finger.builtin())
    step = axis[1] - axis[0]
    np.testing.assert_allclose(np.abs(moved - nodes), step / 2, rtol=1e-6)
    assert (np.abs(moved) <= 16.0).all()
    off = np.linalg.norm((MODEL.prior.evaluate(moved) - shapes).reshape(3, -1, 3), axis=2).mean(
        axis=1
    )
    away = np.linalg.norm((MODEL.prior.evaluate(nodes) - shapes).reshape(3, -1, 3), axis=2).mean(
        axis=1
    )
    assert (off < 0.1).all() and (away > 5 * off).all()


@pytest.mark.long
def test_a_prior_of_two_seeds_is_one_row_and_what_no_seed_changes_is_fitted_once(files):
    data = SimulatedSet.load(files / "s.npz")
    plan = Plan((0, 1), 3)
    rows = [
        fitted_to_set(name, data, Surface.of(MODEL), plan, lambda what, share: None)
        for name in ("modes", "table")
    ]
    assert [len(row.errors["vertex"]) for row in rows] == [2, 1]
    assert rows[0].errors["vertex"][0].mean() != rows[0].errors["vertex"][1].mean()


@pytest.mark.long
def test_parts_of_a_recording_are_complete_blocks_and_each_holds_the_smaller_ones(files, tmp_path):
    lesson = Lesson.of(MODEL, [Run.load(files / "teaches.npz")])
    parts = [lesson.share(share, 3) for share in choices.SHARES]
    assert [len(part) for part in parts] == [4, 8, 16, 32]
    for small, large in zip(parts[:-1], parts[1:]):
        assert set(small) < set(large)
    assert all(
        set(block) <= set(parts[1]) or not set(block) & set(parts[1]) for block in lesson.blocks
    )
    assert set(lesson.share(0.25, 4)) != set(parts[1])
    run, true = recorded(4, 2)
    judge = Recording.of(run, MODEL, true)
    found = residuals(lesson, judge, "modes", Plan(), lambda what, share: None)
    assert [row.details["frames"] for row in found] == [16, 32]  # 8 are too few for a residual
    before = judge.evaluate("x", MODEL).errors["vertex"].mean()
    assert found[-1].errors["vertex"].mean() < 0.6 * before
    # From its checkpoints a training ends as it did.
    plan = Plan((0,), 3, tmp_path)
    once, again = (
        residuals(lesson, judge, "modes", plan, lambda what, share: None) for _ in range(2)
    )
    assert len(list(tmp_path.iterdir())) == 2 and once[-1].details["kind"] == "modes"
    np.testing.assert_array_equal(once[-1].errors["vertex"], again[-1].errors["vertex"])


def test_a_frame_in_which_nothing_is_seen_is_left_out_of_what_is_seen_alone():
    run, true = recorded(4, 2)
    judge = Recording.of(run, MODEL, true)
    visible = judge.laid.visible.copy()
    visible[1] = False
    doubtful = replace(judge, laid=replace(judge.laid, visible=visible))
    seen, fewer = (one.evaluate("x", MODEL) for one in (judge, doubtful))
    assert np.isnan(fewer.errors["visible"][0, 1]) and np.isfinite(fewer.errors["chamfer"]).all()
    rest = np.delete(seen.errors["visible"][0], 1)
    assert fewer.to_dict()["visible_mm"]["mean"] == pytest.approx(rest.mean())
    assert fewer.to_dict()["visible_mm"]["worst"] == rest.max()
    json.dumps(fewer.to_dict(), allow_nan=False)


def test_runs_that_teach_together_are_one_lesson_a_minute_apart(files):
    run = Run.load(files / "teaches.npz")
    bare = replace(run, points=None, start=None)
    with pytest.raises(TrainingError, match="no clouds and no vertices"):
        Lesson.of(MODEL, [bare])
    hidden = np.ones((run.frames, len(MODEL.rest)), bool)
    hidden[:, 7] = False
    sigma = np.array(0.4)
    shapes = replace(bare, vertices=MODEL.predict(run) + 1.0, sigma=sigma, visible=hidden)
    # need not be recorded alike
    later = replace(run, t=run.t + 100.0, t_seen=run.t_seen + 100.0, temperature=20.0)
    both = Lesson.of(MODEL, [later, shapes])
    assert (
        len(both) == 2 * run.frames
        and not both.of_clouds
        and both.runs == [later.hash(), shapes.hash()]
    )
    assert both.times[run.frames] - both.times[run.frames - 1] == pytest.approx(60.0)
    np.testing.assert_array_equal(np.concatenate(both.clouds), run.points)
    np.testing.assert_allclose(both.points[run.frames :], MODEL.predict(run))
    taught = both.weight[run.frames :] > 0
    assert not taught[:, 7].any() and taught.sum() == taught.size - len(taught)
    assert both.weight[run.frames :].max() == pytest.approx(1 / sigma**2)
    np.testing.assert_array_equal(both.vertices[run.frames :, 7], both.points[run.frames :, 7])
    markers = shapes.vertices[:, ::200]
    with pytest.raises(TrainingError, match="markers, which do not show"):
        Lesson.of(MODEL, replace(bare, markers=markers, marker_rest=markers[0]))
    with pytest.raises(RunError, match="wrong units"):
        Lesson.of(MODEL, replace(bare, vertices=0.1 * shapes.vertices))
    with pytest.raises(RunError, match="points"):
        Lesson.of(MODEL, replace(shapes, vertices=shapes.vertices[:, 1:], visible=hidden[:, 1:]))


def test_a_run_of_another_robot_among_those_that_teach_is_reported():
    mine, other = (replace(recorded(40, seed)[0], points=None, start=None) for seed in (1, 2))
    rest = MODEL.prior.evaluate(np.zeros((1, 2))).reshape(-1, 3)
    bent = 0.001 * rest[:, 2:] ** 2 * np.array([1.0, 0.5, 0.0])
    shapes = [
        replace(run, vertices=MODEL.predict(run) + sign * bent)
        for run, sign in ((mine, 1.0), (other, -1.0))
    ]
    said = Lesson.of(MODEL, shapes).remarks
    assert (
        len(said) == 2
        and "run 1 of 2" in said[0]
        and "another robot, load or orientation" in said[1]
    )
    assert (
        Lesson.of(
            MODEL, [shapes[0], replace(other, vertices=MODEL.predict(other) + 0.8 * bent)]
        ).remarks
        == []
    )
    assert learn_residual(MODEL, shapes)[1]["warnings"] == said


def test_the_command_prints_both_tables_next_to_the_papers(files, capsys, monkeypatch):
    monkeypatch.chdir(files)
    assert (
        main(
            [
                "evaluate",
                "--set",
                "s.npz",
                "--model",
                "table",
                "--run",
                "run.npz",
                "--truth",
                "truth.npz",
            ]
        )
        == 0
    )
    text = capsys.readouterr().out
    assert "built-in" in text and "other data" in text and "±" in text and "surface" in text
    assert main(["evaluate", "--run", "run.npz", "--truth", "truth.npz", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    row, run = said["recorded"][0], Run.load("run.npz")
    exact = np.linalg.norm(MODEL.predict(run) - np.load("truth.npz")["vertices"], axis=2).mean()
    assert row["vertex_mm"]["mean"] == pytest.approx(exact) and row["surface_mm"]["mean"] > 0
    assert (
        said["schema"] == "softmap.evaluation/1"
        and said["simulated"] == []
        and said["samples"] == []
    )


@pytest.mark.long
def test_a_bundle_of_a_decoder_stands_next_to_models_and_has_no_vertices(
    files, capsys, monkeypatch
):
    monkeypatch.chdir(files)
    assert (
        main(["train", "prior", "s.npz", "--model", "deepsoro", "--epochs", "1", "--out", "rival"])
        == 0
    )
    save_bundle(MODEL, "finger")
    capsys.readouterr()
    laid = []
    for order in (["rival", "finger"], ["finger", "rival"]):
        options = [
            "--set",
            "s.npz",
            "--run",
            "run.npz",
            "--truth",
            "truth.npz",
            "--json",
            "--trust-onnx",
        ]
        assert main(["evaluate", *order, *options]) == 0
        said = json.loads(capsys.readouterr().out)
        rows = {row["name"]: row for row in said["recorded"]}
        assert (
            set(rows) == {"rival", "finger, without residual"}
            and rows["rival"]["what"] == "deepsoro"
        )
        assert "vertex_mm" not in rows["rival"] and "visible_mm" not in rows["rival"]
        assert (
            rows["rival"]["whole_mm"]["mean"] > rows["finger, without residual"]["whole_mm"]["mean"]
        )
        laid.append(rows["finger, without residual"]["visible_mm"])
        learned = load_bundle("rival", trust_onnx=True).made_from["prior"]["parameters"]
        assert {
            row["parameters"]
            for row in (rows["rival"], *said["simulated"])
            if row["name"] == "rival"
        } == {learned}
    assert laid[0] == laid[1]  # clouds are laid by the finger, whichever comes first
    for options in (["--run", "run.npz"], ["--set", "s.npz", "--model", "table"]):
        assert main(["evaluate", "rival", *options, "--trust-onnx"]) == 2
        assert "rival has points of its own" in capsys.readouterr().err


@pytest.mark.long
def test_the_papers_three_rows_both_falls_and_a_page(files, capsys, monkeypatch):
    monkeypatch.chdir(files)
    monkeypatch.setattr(choices, "DEEPSORO_DRAWN", 1)
    argv = [
        "--run",
        "run.npz",
        "--truth",
        "truth.npz",
        "--train",
        "teaches.npz",
        "--seeds",
        "2",
        "--epochs",
        "6",
    ]
    assert main(["evaluate", *argv, "--set", "s.npz", "--html", "page.html", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    rows = {row["name"]: row for row in said["recorded"]}
    assert list(rows) == [
        "DeepSoRo",
        "built-in, without residual",
        "residual, ours",
        "residual, published",
    ]
    assert rows["DeepSoRo"]["seeds"] == 2 and "vertex_mm" not in rows["DeepSoRo"]
    assert (
        rows["residual, ours"]["vertex_mm"]["mean"]
        < rows["built-in, without residual"]["vertex_mm"]["mean"]
    )
    falls = {(row["name"], row["against"]): row for row in said["falls"]}
    one = falls["residual, ours", "built-in, without residual"]
    means = [
        rows[name]["vertex_mm"]["mean"] for name in ("residual, ours", "built-in, without residual")
    ]
    assert (
        one["vertex_share"] == pytest.approx(1 - means[0] / means[1])
        and one["paper_chamfer_share"] == 0.334
    )
    assert falls["residual, published", "DeepSoRo"]["paper_chamfer_share"] == 0.407
    assert [row["frames"] for row in said["samples"]] == 2 * [16, 32]
    page = (files / "page.html").read_text(encoding="utf-8")
    assert page.count("data:image/") == 4 and "http:" not in page and "<script" not in page
    for text in (
        "other data",
        "DeepSoRo",
        "number of real samples",
        "s of training",
        "over 2 seeds",
        "−40.7 %",
    ):
        assert text in page, text


@pytest.mark.long
def test_commands_beyond_those_that_taught_a_prior_or_a_residual_are_reported(
    files, capsys, monkeypatch
):
    monkeypatch.chdir(files)
    data = SimulatedSet.load("s.npz")
    near = np.flatnonzero((np.abs(data.command) < 12.0).all(axis=1))
    points = data.shapes(near).reshape(len(near), -1).astype(float)
    parts = np.arange(len(near) - 4), np.arange(2), np.arange(len(near) - 4, len(near))
    trained = train_prior(data.command[near], points, parts, recipe=choices.PRIOR.with_(epochs=2))
    low, high = np.array(trained.report["command_range"]).T
    save_bundle(with_prior(MODEL, trained, data.command[near][-4:], points[-4:]), files / "near")
    assert main(["evaluate", "near", "--set", "s.npz", "--json"]) == 0
    test = data.command[data.split(choices.SPLIT_SEED).test]
    outside = ((test < low - 0.05 * (high - low)) | (test > high + 0.05 * (high - low))).any(axis=1)
    assert 0 < outside.sum() < len(test)
    (said,) = json.loads(capsys.readouterr().out)["warnings"]
    assert (
        f"{outside.sum()} of {len(test)} frames ({100 * outside.mean():.0f} %) leave what taught "
        "the prior" in said
    )
    # Of a recording, by the residual that it teaches.
    run, _ = recorded(40, 1)
    run.at(np.flatnonzero((np.abs(run.command) < 5.0).all(axis=1))).save("narrow.npz")
    argv = [
        "--run",
        "run.npz",
        "--train",
        "narrow.npz",
        "--residual",
        "modes",
        "--no-decoder",
        "--epochs",
        "2",
        "--json",
    ]
    assert main(["evaluate", *argv]) == 0
    said = json.loads(capsys.readouterr().out)
    early, *warnings = said["warnings"]
    assert (
        "--epochs 2" in early and [row["name"] for row in said["recorded"]][-1] == "residual, ours"
    )
    assert not any(row["what"] == "deepsoro" for row in said["recorded"])
    assert warnings and all(
        "taught the residual" in text and "frames:" in text for text in warnings
    )


@pytest.mark.long
def test_clouds_with_a_shifted_base_are_compared_in_the_frame_of_their_base(files):
    """So that what is compared is the shape, and the true vertices, which are in that frame,
    fit.
    """
    run, true = recorded(24, 5)
    stood = in_frame(
        run,
        RigidPose(rotation(np.radians([1.2, -0.7, 0.0])), np.array([1.0, -0.8, 0.0])),
        np.zeros(6),
    )
    there, moved = (Recording.of(one, MODEL, true) for one in (run, stood))
    assert there.remarks == [] and "softmap run align" in moved.remarks[0]
    exact = [judge.evaluate("x", OFF).errors["surface"].mean() for judge in (there, moved)]
    assert exact[1] < exact[0] + 0.1


def test_the_papers_figures_are_those_of_its_table():
    assert PUBLISHED["published"] == ((0.389, 0.188), (0.196, 0.098)) and PUBLISHED["linear"][
        1
    ] == (2.620, 1.143)


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        ([], "give --set SET, --run RUN"),
        (["--truth", "x.npz", "--set", "s.npz"], "goes with --run"),
        (["--train", "x.npz", "--set", "s.npz"], "goes with --run"),
        (["--set", "s.npz", "--model", "forest"], "there are"),
        (["--run", "r.npz", "--model", "gp"], "give --set"),
        (["--run", "r.npz", "--seeds", "0"], "give 1 to"),
        (["--run", "r.npz", "a/one", "b/one"], "one name"),
        (["--run", "r.npz", "--html", "page.txt"], ".html"),
    ],
)
def test_wrong_use_is_reported_before_the_work(argv, says, capsys):
    assert main(["evaluate", *argv]) == 2
    assert says in capsys.readouterr().err


def test_a_truth_of_another_run_is_refused():
    t = np.arange(2.0)
    run = Run(
        t=t, command=np.zeros((2, 2)), t_seen=t, points=MODEL.rest[:2], start=np.array([0, 1, 2])
    )
    with pytest.raises(TrainingError, match="give that of this run"):
        Recording.of(run, MODEL, np.zeros((3, 548, 3)))
