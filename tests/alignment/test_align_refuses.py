"""Align refuses what cannot work in one line, with its number and remedy."""

import numpy as np
import pytest
from filmed_markers import changed, film, marked

from softmap_edge import builtin_model
from softmap_edge.alignment.align import align_home
from softmap_edge.cli import main
from softmap_edge.errors import AlignError, RunError

LINE = np.array([[0.0, 0, z] for z in (10, 40, 70, 110)])

filmed = pytest.fixture(scope="module")(film)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda run: marked(rest=LINE), ["one line", "rotation about it (about z)", "--base"]),
        (lambda run: changed(run, markers=run.markers * [1, 1, -1]), ["mirrored", "axes"]),
        (lambda run: changed(run, markers=run.markers * 1.3), ["1.3 times", "another robot"]),
        (
            lambda run: marked(visits=2).slice_time(0.0, 7.5),
            ["too few home frames", "1 visits", "2 are needed", "at the end"],
        ),
        (lambda run: run.at(np.arange(12)), ["too few home frames", "1 visits"]),
        (
            lambda run: changed(
                run, markers=run.markers[:, np.random.default_rng(0).permutation(12)]
            ),
            ["another order"],
        ),
    ],
)
def test_what_cannot_work_is_refused_with_its_number_and_remedy(spoil, words):
    with pytest.raises(AlignError) as fault:
        align_home(spoil(marked()), builtin_model())
    assert "\n" not in str(fault.value)
    for word in words:
        assert word in str(fault.value)


@pytest.mark.parametrize(
    ("factor", "words"), [(10.0, "centimetres"), (25.4, "inches"), (0.1, "tenths of a mm")]
)
def test_vertices_in_other_units_are_refused(factor, words, filmed):
    with pytest.raises(AlignError, match="wrong units.*convert the points to mm") as fault:
        align_home(changed(filmed[1], vertices=filmed[1].vertices / factor), builtin_model())
    assert words in str(fault.value)


def test_a_run_of_another_robot_is_refused():
    run = marked()
    with pytest.raises(RunError, match="3 commands a sample"):
        align_home(changed(run, command=np.zeros((len(run.t), 3))), builtin_model())


@pytest.mark.parametrize(
    ("base", "words"),
    [
        (["0", "1"], "2 base points"),
        (["0:0,0,0", "1:0,0,30", "2:0,0,60"], r"rotation about it \(about z\) is unknown"),
        (["0:0,0", "1", "2"], "three numbers"),
        (["0", "1", "99"], "markers 0 to 11"),
        (["0", "one", "2"], "no number of a marker"),
        (["clamped"], "needs a run and a model with vertices"),
        (["0:0,0,0", "1:0.03,0,0", "2:0,0.03,0"], "lie within"),
        (["0:0,0,0", "1:0,-80,0", "2:80,0,0"], "wrong units|another robot"),
    ],
)
def test_base_points_that_give_no_frame_are_refused_in_one_line(base, words, tmp_path, capsys):
    import re

    marked().save(tmp_path / "run.npz")
    assert (
        main(
            [
                "run",
                "align",
                str(tmp_path / "run.npz"),
                "--out",
                str(tmp_path / "out.npz"),
                "--base",
                *base,
            ]
        )
        == 2
    )
    error = capsys.readouterr().err
    assert re.search(words, error) and error.count("\n") == 1
    assert not (tmp_path / "out.npz").exists()


def test_a_frame_that_is_no_rotation_is_refused():
    run = marked()
    with pytest.raises(RunError, match="frame: its first three columns"):
        changed(run, frame=np.column_stack([np.diag([1.0, 1, -1]), np.zeros(3)]))
