"""What the page receives: numbers that are those of a comparison, and shapes of single frames."""

from dataclasses import replace

import numpy as np
import pytest
from lab_runs import HIDDEN, measured

from softmap_edge import builtin_model, compare
from softmap_edge.errors import LabError
from softmap_edge.lab.views import frames_of, predicted_by, rms_of, shape_of, tried, view_of


def test_the_errors_are_those_of_the_comparison():
    model, run = builtin_model(), measured()
    visible = np.random.default_rng(2).random(run.vertices.shape[:2]) > 0.2
    run = replace(run, visible=visible)
    view, found = view_of(model, run), compare(model, run)
    assert rms_of(view.before, view) == pytest.approx(found.error["rms_mm"], rel=1e-6)
    header, arrays = frames_of(view, None)
    squared, counts = arrays["before"].astype(float), arrays["counts"].astype(float)
    for name, rows in found.where.items():
        if name == "section":
            values = np.sqrt(squared.sum(axis=0) / counts.sum(axis=0))
        else:
            index = arrays[f"class_{name}"]
            values = [np.sqrt(squared[index == k].sum() / counts[index == k].sum())
                      for k in range(len(header["classes"][name]))]  # fmt: skip
        np.testing.assert_allclose(values, [row.rms_mm for row in rows], rtol=1e-4)


def test_a_step_changes_shape_and_error_and_a_trial_gives_the_same():
    model, view = builtin_model(), view_of(builtin_model(), measured())
    better = model.with_effects(["backlash"], HIDDEN)
    after = predicted_by(better, view)
    assert rms_of(after, view) < 0.1 < rms_of(view.before, view)
    error, arrays = tried(better, view, 7)
    assert error == pytest.approx(rms_of(after, view), rel=1e-5), "every frame of a short run"
    np.testing.assert_allclose(arrays["points"], shape_of(view, after, 7)["after"], atol=1e-4)
    assert "loop0_after" in frames_of(view, after)[1]
    for frame in (-1, len(view.seen)):
        with pytest.raises(LabError, match="there is no frame"):
            shape_of(view, after, frame)


@pytest.mark.parametrize("down", [[0, 0, 1], [0, 0, -1], [0.6, 0, 0.8], None])
def test_the_page_gets_gravity_only_where_it_is_declared(down):
    run = measured(frames=20)
    run = replace(run, gravity=None if down is None else np.array(down, float))
    arrays = frames_of(view_of(builtin_model(), run), None)[1]
    if down is None:
        assert "gravity" not in arrays
    else:
        np.testing.assert_allclose(arrays["gravity"], np.tile(down, (20, 1)), atol=1e-6)
