"""Markers carried by a model: off the surface, hidden, far away, in other units, without places."""

import numpy as np
import pytest

from softmap_edge import Run, builtin_model, compare, diagnose
from softmap_edge.errors import RunError, SoftmapError
from softmap_edge.geometry.rigid import kabsch
from softmap_edge.geometry.sections import attach
from softmap_edge.run.protocol import standard_protocol

HEIGHTS, ANGLES = (12, 40, 75, 105), (0.3, 1.9, 4.0)


def stalks(length):
    """Markers `length` mm off the surface of the built-in finger (mm), or inside where it is
    negative.
    """
    radius = (
        np.interp(HEIGHTS, [0, 11, 30, 50, 70, 90, 116], [15.9, 15.9, 14.7, 13.4, 12, 10.5, 9])
        + length
    )
    return np.array(
        [[r * np.cos(a), r * np.sin(a), z] for r, z in zip(radius, HEIGHTS) for a in ANGLES]
    )


def run_of(rest, noise=0.15, hidden=0.0, play=2.0, **change):
    """The standard protocol of a finger with play, seen by markers of which a share is hidden."""
    model, p = builtin_model(), standard_protocol()
    rng = np.random.default_rng(2)
    record = {
        "t": p.t,
        "command": p.command,
        "gravity": p.gravity,
        "t_seen": p.t_seen,
        "robot": model.robot,
        "marker_rest": rest,
    }
    blank = np.repeat(rest[None], p.frames, axis=0)
    seen = model.with_effects(["backlash"], {"backlash.gap": play}).predict(
        Run(**record, markers=blank)
    )
    seen = seen + noise * rng.normal(size=seen.shape)
    visible = rng.random(seen.shape[:2]) >= hidden
    seen[~visible] = np.nan
    return Run(**(record | {"markers": seen, "visible": visible} | change))


@pytest.mark.parametrize(("length", "allowed"), [(-8, 0.06), (0, 0.06), (8, 0.08), (20, 0.16)])
def test_a_marker_on_a_stalk_follows_the_ring_that_it_stands_on(length, allowed):
    """Against a rigid stalk on the vertices within 7 mm of its height; the body's own strain is
    what is left.
    """
    model, rest = builtin_model(), stalks(length)
    commands = np.array([[0.0, 0], [10, 0], [-8, 8], [6, -6], [0, -10]])
    shapes = model.prior.evaluate(commands).reshape(len(commands), -1, 3)
    weights = attach(rest, model.rest)
    carried = np.einsum("mn,knc->kmc", weights, shapes)
    stiff = np.empty_like(carried)
    for m, point in enumerate(rest):
        ring = np.abs(model.rest[:, 2] - point[2]) < 7
        for k, shape in enumerate(shapes):
            stiff[k, m] = kabsch(model.rest[ring], shape[ring], np.ones(ring.sum()))(point[None])[0]
    moved = np.linalg.norm(stiff[1:] - stiff[:1], axis=2)
    off = np.linalg.norm(carried - stiff, axis=2)[1:]
    assert np.sqrt(np.mean(off**2)) < allowed * np.sqrt(np.mean(moved**2))
    # noise is not blown up
    assert np.abs(weights).max() < 1.0 and np.sqrt((weights**2).sum(axis=1)).max() < 0.6
    np.testing.assert_allclose(weights @ model.rest, rest, atol=1e-6)


def test_hidden_markers_neither_hide_the_effect_nor_count():
    run = run_of(stalks(3), hidden=0.3)
    model = builtin_model()
    assert 0.65 < run.visible.mean() < 0.75
    found = diagnose(model, run, effects=["backlash", "gain", "mount"])
    assert [e.name for e in found.effects] == ["backlash"] and found.faults == ()
    assert found.params_of("backlash")["backlash.gap"] == pytest.approx(2.0, abs=0.1)
    truth = model.with_effects(["backlash"], {"backlash.gap": 2.0})
    assert compare(truth, run).error["rms_mm"] == pytest.approx(0.15 * np.sqrt(3), rel=0.05)
    spoilt = np.array(run.markers)
    spoilt[~run.visible] = 1000.0  # what a tracker writes for a marker that it lost
    again = run_of(stalks(3), hidden=0.3, markers=spoilt)
    assert compare(truth, again).error == compare(truth, run).error


def test_a_marker_far_from_the_robot_is_refused_with_its_number_and_distance():
    rest = stalks(0)
    rest[5] = [80.0, 0.0, 40.0]
    blank = np.repeat(rest[None], standard_protocol().frames, axis=0)
    p = standard_protocol()
    run = Run(t=p.t, command=p.command, t_seen=p.t_seen, markers=blank, marker_rest=rest)
    with pytest.raises(
        SoftmapError, match=r"marker 6 at \(80, 0, 40\) mm is 6\d\.?\d* mm from the model"
    ) as fault:
        compare(builtin_model(), run)
    assert "\n" not in str(fault.value) and "leave out markers" in str(fault.value)


def test_labels_of_an_import_name_the_markers():
    labels = np.array([f"ring{k // 3}_{'abc'[k % 3]}" for k in range(12)])
    named = run_of(stalks(0), extra={"marker_labels": labels})
    assert [
        row.label for row in compare(builtin_model(), named).where["section"]
    ] == labels.tolist()
    spoilt = run_of(stalks(0), extra={"marker_labels": labels[:5]})  # of another recording
    assert compare(builtin_model(), spoilt).where["section"][0].label == "marker 1"
    far = stalks(0)
    far[4, 0] = 90.0
    with pytest.raises(SoftmapError, match="^ring1_b at"):
        compare(
            builtin_model(),
            Run(
                **{k: getattr(named, k) for k in ("t", "command", "t_seen", "markers", "visible")},
                marker_rest=far,
                extra={"marker_labels": labels},
            ),
        )


@pytest.mark.parametrize("factor", [0.001, 0.1, 1000.0])
def test_places_in_other_units_are_refused(factor):
    with pytest.raises(RunError, match="marker_rest") as fault:
        run_of(stalks(0), marker_rest=stalks(0) * factor)
    assert "mm" in str(fault.value) and "\n" not in str(fault.value)


def test_markers_without_places_are_refused_with_their_number():
    run = run_of(stalks(0), marker_rest=None)
    with pytest.raises(RunError, match="12 markers but no `marker_rest`"):
        compare(builtin_model(), run)
