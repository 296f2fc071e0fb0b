"""The numbers behind the mask of a numpy masked array enter no run, no command and no target."""

from dataclasses import replace

import numpy as np
import pytest
from sound_run import C, K, N, T, fields, sound

from softmap_edge import builtin_model
from softmap_edge.checks.summary import summary
from softmap_edge.errors import CalibrationError, RunError, SoftmapError
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Simulator
from softmap_edge.model.servo_calibration import Calibration
from softmap_edge.robot.control.supervisor import numbers
from softmap_edge.robot.motion.kinematics import Kinematics
from softmap_edge.run.fields import unmasked
from softmap_edge.run.run import Run, known


def masked(array, index, filler):
    """A masked array with a filler behind the mask."""
    found = np.ma.masked_array(np.array(array), mask=False)
    found[index] = filler
    found[index] = np.ma.masked
    return found


@pytest.mark.parametrize("filler", [0.0, -1.0, 9999.0, 1e20])
@pytest.mark.parametrize("index", [3, (3, 1), (3, 1, 2)])
def test_masked_places_are_not_seen(filler, index):
    given = fields()["markers"]
    run = sound(markers=masked(given, index, filler), visible=None)
    hidden = np.zeros((K, N), bool)
    hidden[index if index == 3 else index[:2]] = True
    assert (known(run, run.markers) == ~hidden).all()
    plain = sound(visible=~hidden)
    assert np.allclose(run.markers[~hidden], plain.markers[~hidden])
    assert replace(summary(run), hash="") == replace(summary(plain), hash="")


@pytest.mark.parametrize("filler", [0.0, -999.0, 65535.0, 1e20, np.nan])
def test_numbers_of_points_that_are_not_visible_count_nowhere(filler):
    visible = np.ones((K, N), bool)
    visible[[2, 5, 6], [1, 1, 3]] = False
    given = fields()["markers"]
    plain = sound(visible=visible)
    run = sound(visible=visible, markers=np.where(visible[..., None], given, filler))
    assert replace(summary(run), hash="") == replace(summary(plain), hash="")


def test_points_in_metres_are_found_whatever_stands_for_a_hidden_one():
    visible = np.ones((K, N), bool)
    visible[2, 1] = False
    metres = np.where(visible[..., None], fields()["markers"] / 1000, 500.0)
    with pytest.raises(RunError, match="looks like metres"):
        sound(visible=visible, markers=metres, marker_rest=None)


def test_the_mask_adds_to_visible():
    visible = np.ones((K, N), bool)
    visible[0, 0] = False
    run = sound(markers=masked(fields()["markers"], (2, 1), 0.0), visible=visible)
    assert np.argwhere(~run.visible).tolist() == [[0, 0], [2, 1]]


def test_an_array_that_masks_nothing_is_a_plain_one():
    run = sound(markers=np.ma.masked_array(fields()["markers"]), visible=None)
    assert run.visible is None and type(run.markers) is np.ndarray


@pytest.mark.parametrize("filler", [0.0, 5.0, 999.0])
@pytest.mark.parametrize("name", ["command", "present", "current", "temperature", "t_seen"])
def test_masked_rows_are_one_clear_error(name, filler):
    with pytest.raises(RunError, match=f"^{name}: .* masked, the first at .*; remove or interp"):
        sound(**{name: masked(fields()[name], 4, filler)})


def test_masked_ticks_and_labels_are_one_clear_error():
    ticks = masked(np.full((T, C), 2048), (7, 1), 0)
    with pytest.raises(RunError, match=r"ticks: 1 values of 120 are masked, the first at \[7, 1\]"):
        sound(command=None, present=None, ticks=ticks)
    with pytest.raises(RunError, match="block: 1 values of 12 are masked"):
        sound(block=masked(np.arange(K) // 4, 2, 999))


def test_masked_outputs_have_no_value():
    values = np.column_stack([np.sin(np.arange(40.0)), np.cos(np.arange(40.0))])
    t = np.arange(40) * 0.1
    run = Run.of_outputs(masked(values, (5, 0), -99.0), "N", t_seen=t, t=t, command=values)
    assert np.isnan(run.outputs[5, 0]) and np.isfinite(np.delete(run.outputs, 5, axis=0)).all()


def test_masked_commands_and_targets_are_not_driven():
    assert np.isnan(numbers(masked([1.0, 2.0], 1, 2.0))[1])
    with pytest.raises(SoftmapError, match="target 0 is"):
        Kinematics(builtin_model()).solve(masked([[0.0, 0.0, 90.0]], (0, 2), 90.0))


def test_whole_numbers_behind_a_mask_become_nan():
    assert np.isnan(unmasked(masked(np.array([1, 2]), 0, -1))).tolist() == [True, False]


@pytest.mark.parametrize(
    "given",
    [
        masked([1.5, 2.5, 3.5], 1, 9999.0),
        masked(np.array([7, 8, 9]), 1, -1),
        np.array([1.0, None, 3.0], object),
        [1, None, 3],
    ],
)
def test_missing_numbers_of_an_unknown_field_become_nan(given, tmp_path):
    run = sound(extra={"humidity": given})
    run.save(tmp_path / "run.npz")
    for one in (run, Run.load(tmp_path / "run.npz"), run.at([0, 1])):
        assert np.isnan(one.extra["humidity"]).tolist() == [False, True, False]
        assert type(one.extra["humidity"]) is np.ndarray


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("home_ticks", masked([2048.0, 2048.0], 1, 0.0)),
        ("spool_radius_mm", np.ma.masked_array(5.0, True)),
        ("operator", masked(np.array(["a", "b"]), 1, "?")),
        ("lamp", masked(np.array([True, False]), 0, True)),
        ("note", np.array([{"a": 1}], object)),
        ("home_ticks", [2048, None]),
    ],
)
def test_a_field_that_cannot_lack_a_value_is_one_clear_error(name, given):
    with pytest.raises(RunError, match=f"^extra {name}: ") as fault:
        sound(extra={name: given})
    assert "\n" not in str(fault.value)


def test_a_plain_unknown_field_is_the_same_array():
    given = np.arange(3)
    assert sound(extra={"count": given}).extra["count"] is given


TICKS = Calibration.stated(0.01 * np.eye(2), [0.0, 0.0], [2048.0, 2048.0], "stated")


@pytest.mark.parametrize(
    "command", [masked([[1.0, 2.0]], (0, 1), 5.0), [[1.0, None]], [[np.nan, 0.0]]]
)
def test_no_tick_stands_for_a_missing_command(command):
    with pytest.raises(CalibrationError, match="commands: 1 of 2 numbers are masked or not finite"):
        TICKS.ticks(command)
    with pytest.raises(CalibrationError, match="command: 1 of 2"):
        TICKS.within(command[0], [0, 0], [4096, 4096])
    assert np.isnan(TICKS.commands(command)).all()


@pytest.mark.parametrize("name", ["A", "b", "home"])
def test_a_calibration_with_a_masked_number_is_refused(name):
    given = dict(A=0.01 * np.eye(2), b=np.zeros(2), home=np.full(2, 2048.0))
    given[name] = masked(given[name], 0, 1.0)
    with pytest.raises(CalibrationError, match=f"calibration: {name} "):
        Calibration.stated(**given, source="stated")
    given |= dict(sigma_A=np.eye(2), sigma_b=np.zeros(2), held_out={}, run="r", frames=0, held=0)
    with pytest.raises(CalibrationError, match=rf"calibration: {name}: \d values of \d are masked"):
        Calibration(**given)


@pytest.mark.parametrize(
    "command", [masked([[1.0, 2.0], [3.0, 1.0]], (0, 1), 0.0), [[1, None], [3, 1]]]
)
def test_the_tip_of_a_missing_command_is_missing(command):
    model = builtin_model()
    tip, slopes = model.tip(command), model.tip_jacobian(command)
    assert np.isnan(tip[0]).all() and np.isfinite(tip[1]).all()
    assert np.isnan(slopes[0]).all() and np.isfinite(slopes[1]).all()


def test_masked_parameters_frames_and_times_are_not_taken():
    model = builtin_model()
    with pytest.raises(SoftmapError, match="is not a finite number"):
        model.with_effects(["gain"], masked([1.1] * model.channels, 0, 1.0))
    with pytest.raises(RunError, match="select: 1 values of 12 are masked"):
        sound().at(masked(np.ones(K, bool), 2, True))
    assert np.isnan(sound().command_at(masked([0.1, 0.2], 1, 0.0))[1]).all()
    with pytest.raises(SoftmapError, match="commands: got shape"):
        Simulator(Finger.builtin()).path(masked([[1.0, 2.0]], (0, 0), 0.0))
