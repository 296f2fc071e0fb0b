"""Markers on the base bound its position and its motion, with correct standard deviations."""

from dataclasses import replace

import numpy as np
import pytest
from recorded_arms import recorded

from softmap_edge import Run, diagnose, load_bundle, save_bundle
from softmap_edge.alignment.base_motion import FRAME, PLACES, base_motion, base_of, excluded
from softmap_edge.diagnosis.record import Record
from softmap_edge.rod.learn import learn, learned_model

PLACE = np.array([[40.0, 0, 2], [-20, 35, 0], [-20, -35, 1], [0, 50, -3]])


def turned(points, turn_deg, shift_mm):
    """Rotation by the exponential of a cross product, independent of the library: about the axis,
    by its length.
    """
    angle = np.radians(np.linalg.norm(turn_deg))
    axis = np.asarray(turn_deg) / max(np.linalg.norm(turn_deg), 1e-12)
    cross = np.cross(np.eye(3), axis)
    matrix = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return points @ matrix.T + shift_mm


def run(turn=(0, 0, 0), shift=(0, 0, 0), noise=0.1, frames=200, seed=0, drift=0.0, place=PLACE):
    rng = np.random.default_rng(seed)
    t = np.arange(frames) * 0.1
    base = np.repeat(turned(place, turn, np.asarray(shift, float))[None], frames, axis=0)
    base = (
        base
        + drift * (t / t[-1])[:, None, None] * np.array([1.0, 0, 0])
        + noise * rng.normal(size=base.shape)
    )
    markers = 50.0 * rng.normal(size=(frames, 3, 3))
    return Run(
        t=t, command=np.zeros((frames, 1)), t_seen=t, markers=markers, extra={"base_markers": base}
    )


def test_a_misaligned_base_is_measured_against_another_run():
    found = base_motion(run((1.5, 0, -0.5), (0.8, 0, 2.0)), run(seed=1))
    assert np.array(found.turn_deg) == pytest.approx([1.5, 0, -0.5], abs=0.1)
    assert np.array(found.shift_mm) == pytest.approx([0.8, 0, 2.0], abs=0.1)
    assert found.moved_mm < 0.05 and found.turned_deg < 0.05
    assert found.allows([0.8, 0, 2.0], [1.5, 0, -0.5]) and not found.allows([0, 0, 0], [0, 0, 0])


def test_a_base_that_stands_excludes_a_turn():
    """Runs of one day: a mount turned by 1.8° contradicts base markers that show 0.0 ± 0.05°."""
    found = base_motion(run(seed=2), run(seed=3))
    assert found.allows([0, 0, 0], [0, 0, 0]) and not found.allows([0, 0, 0], [1.8, 0, 0])


def test_standard_deviations_are_those_of_repetition():
    scores = []
    for seed in range(60):
        one = base_motion(run(seed=2 * seed), run(seed=2 * seed + 1))
        scores.append(
            np.r_[one.shift_mm, one.turn_deg] / np.r_[one.shift_sigma_mm, one.turn_sigma_deg]
        )
    # white noise: 200 frames count as 20, so the stated deviation is wide, never narrow
    assert 0.1 < np.std(scores) < 1.0


def test_drift_of_the_base_is_motion_and_noise_is_not():
    assert base_motion(run(drift=1.0)).moved_mm == pytest.approx(1.0 / np.sqrt(12), rel=0.15)
    assert base_motion(run()).moved_mm < 0.03


def test_what_does_not_show_a_turn_is_none():
    line = np.array([[0.0, 0, 0], [30, 0, 0], [60, 0.5, 0]])
    assert base_motion(run(place=line)) is None and base_motion(run(place=PLACE[:2])) is None
    assert base_motion(run(frames=5)) is None and base_motion(run(), run(place=PLACE[:3])) is None
    bare = Run(
        t=np.arange(10.0),
        command=np.zeros((10, 1)),
        t_seen=np.arange(10.0),
        markers=np.ones((10, 2, 3)) * [[0], [9.0]],
    )
    assert base_motion(bare) is None


# --- what they allow in a diagnosis ---------------------------------------------------------------

TURN, SHIFT = np.array([0.0, 3.0, 0.0]), np.array([1.5, 0.0, 0.0])


def robot(
    turn=(0, 0, 0),
    shift=(0, 0, 0),
    base_turn=(0, 0, 0),
    base_shift=(0, 0, 0),
    seed=0,
    noise=0.05,
    **more,
):
    """A run of a robot that is turned and shifted as one, and base markers that are turned and
    shifted apart.
    """
    plain = recorded(seconds=60.0, seed=seed, noise=0.1, **more)
    base = run(base_turn, base_shift, noise, plain.frames, seed + 50).extra["base_markers"]
    return replace(
        plain,
        markers=turned(plain.markers, turn, np.asarray(shift, float)),
        extra={"base_markers": base},
    )


@pytest.fixture(scope="module")
def model():
    before = robot()
    return learned_model(before, learn(before))


def named(found):
    return {one.name for one in (*found.effects, *found.faults)}


def test_a_learned_model_keeps_where_its_base_markers_were(model, tmp_path):
    again = load_bundle(save_bundle(model, tmp_path / "finger"))
    measured = base_of(again, robot(base_turn=(0, 1.0, 0), base_shift=(0, 0, 0.5), seed=4))
    assert measured.turn_deg == pytest.approx([0, 1.0, 0], abs=0.05)
    assert measured.shift_mm == pytest.approx([0, 0, 0.5], abs=0.05)
    for wrong in (
        None,
        [],
        [[1, 2, 3]] * 2,
        [[1, 2]] * 4,
        [[0, 0, np.nan]] * 4,
        "abc",
        [["a", "b", "c"]] * 4,
    ):
        assert (
            base_of(replace(model, made_from=model.made_from | {PLACES: wrong}), robot(seed=4))
            is None
        )


def test_a_base_that_moved_is_named_where_its_markers_show_it(model):
    found = diagnose(model, robot(TURN, SHIFT, TURN, SHIFT, seed=2))
    assert named(found) == {"mount"} and found.verdict == "measurement_fault"
    params = {label: number.value for label, number in found.faults[0].params.items()}
    assert params["mount.turn_y"] == pytest.approx(3.0, abs=0.3) and params[
        "mount.shift_x"
    ] == pytest.approx(1.5, abs=0.3)
    assert not any(said.startswith("a mount of") for said in found.remarks)


def test_a_base_that_stands_is_not_named_however_well_it_would_fit(model):
    """The same body, with base markers at rest: a turned frame is excluded, and the report says by
    how much.
    """
    after = robot(TURN, SHIFT, seed=2)
    without = diagnose(model, replace(after, extra={}))
    assert named(without) == {"mount"}
    found = diagnose(model, after)
    assert "mount" not in named(found) and found.verdict != "measurement_fault"
    assert found.verdict not in ("nothing", "cannot_tell")  # what moved the body is still reported
    (said,) = [said for said in found.remarks if said.startswith("a mount of")]
    assert "base markers: the base is 0.0" in said and "excluded" in said


def test_a_mount_larger_than_the_markers_allow_is_fitted_within_their_bound(model):
    """The markers show a third of the turn: mount may not take more of it."""
    record = Record(model, robot(TURN, SHIFT, TURN / 3, SHIFT / 3, seed=2))
    layout, (base,) = record.layout(("mount",)), record.bases
    for name, low, high in zip(FRAME, *base.interval()):
        i = layout.labels.index(name)
        assert (
            layout.low[i] >= min(0.0, low) - 1e-12
            and layout.high[i] == layout.limit[i] <= max(0.0, high) + 1e-12
        )
        assert layout.low[i] <= layout.start[i] <= layout.high[i]
    turn = layout.labels.index("mount.turn_y")
    assert 1.0 < layout.high[turn] < 1.3


def test_a_drifting_camera_is_excluded_by_a_base_that_rests_during_the_run(model):
    rests = excluded([robot(seed=2)], [None], 120.0, 0.2)
    assert set(rests) == {"camera_drift"} and "during the run" in rests["camera_drift"]
    moving = replace(robot(seed=2), extra=run(drift=2.0, frames=robot().frames).extra)
    assert excluded([moving], [None], 120.0, 0.2) == {}
