"""Noise and model-form error: what the estimators recover, and that whitened numbers are white."""

from dataclasses import replace

import numpy as np
import pytest
from bending import at, record, shaken, shape, wander

from softmap_edge import Run, builtin_model
from softmap_edge.checks.advice import DWELL_FRAMES
from softmap_edge.checks.summary import summary
from softmap_edge.comparison.comparison import compare
from softmap_edge.diagnosis.prepare import candidates_of, problem_of
from softmap_edge.diagnosis.record import Record
from softmap_edge.errors import SoftmapError
from softmap_edge.noise.floor import noise_of_points
from softmap_edge.noise.memoryless import Repeats
from softmap_edge.noise.noise_model import (
    Noise,
    Whitener,
    command_kernel,
    estimate_noise,
    form_covariance,
    measure_noise,
    noise_off_shapes,
    rod_noise,
    whitener,
)
from softmap_edge.run.conditions import conditions
from softmap_edge.run.protocol import standard_protocol
from softmap_edge.synthetic.finger import Camera, Truth

V, F = 6, 18


def dwells(rng, sigma, count=20, frames=8, drift=1.0):
    """Frames of `count` dwells with white noise (F,) on top of a slow drift within each dwell."""
    visit = np.repeat(np.arange(count), frames)
    tau = np.tile(np.linspace(0, 1, frames), count)
    residual = rng.normal(size=(count * frames, F)) * sigma + drift * tau[:, None] * rng.normal(
        size=F
    )
    return residual, np.arange(len(visit)) * 0.5, visit


def test_replicates_give_the_noise_and_not_the_drift():
    rng = np.random.default_rng(1)
    sigma = np.linspace(0.05, 0.3, F)
    noise = estimate_noise(*dwells(rng, sigma))
    assert "replicates" in noise.source
    # 100 degrees of freedom: one standard deviation of a variance is 14 %; shrinkage pulls to the
    # median.
    assert np.allclose(np.sqrt(np.diag(noise.covariance)), sigma, rtol=0.5)
    assert np.sqrt(np.mean(np.diag(noise.covariance))) == pytest.approx(
        np.sqrt(np.mean(sigma**2)), rel=0.15
    )
    assert noise.inflation == 1.0


def test_three_frames_of_a_dwell_are_replicates():
    """A robot that is looked at three times wherever it has settled: from dwell to dwell only the
    model errs.
    """
    rng = np.random.default_rng(6)
    visit = np.repeat(np.arange(49), 3)
    t = np.ravel(7.0 * np.arange(49)[:, None] + [0.0, 0.3, 0.55])
    wrong = np.repeat(rng.normal(size=(49, F)), 3, axis=0) + 0.1 * t[:, None]
    noise = estimate_noise(wrong + 0.2 * rng.normal(size=wrong.shape), t, visit)
    assert noise.source == "replicates (49 degrees of freedom)"
    assert np.sqrt(np.mean(np.diag(noise.covariance))) == pytest.approx(0.2, rel=0.1)


def test_three_dwells_as_the_advice_asks_identify_the_noise():
    dwell, rng = np.repeat(np.arange(3), DWELL_FRAMES), np.random.default_rng(0)
    reported = [
        estimate_noise(rng.normal(size=(n, F)), np.arange(n), dwell[:n])
        for n in (len(dwell), len(dwell) - 4)
    ]
    assert [noise.measured for noise in reported] == [True, False]


def test_what_is_hidden_at_times_is_no_noise():
    """A model that is 5 mm wrong at a marker has no noise of 5 mm where the marker is hidden now
    and then.
    """
    rng = np.random.default_rng(5)
    residual, t, visit = dwells(rng, np.full(F, 0.2), drift=0.0)
    residual += 5.0
    residual[rng.random(residual.shape) < 0.1] = np.nan
    for still in (visit, np.full(len(visit), -1)):
        found = np.sqrt(np.mean(np.diag(estimate_noise(residual, t, still).covariance)))
        assert found == pytest.approx(0.2, rel=0.15)


def test_correlation_in_time_inflates():
    rng = np.random.default_rng(2)
    white = rng.normal(size=(400, F)) * 0.1
    slow = white.copy()
    for k in range(1, len(slow)):
        slow[k] = 0.7 * slow[k - 1] + white[k]
    visit = np.repeat(np.arange(10), 40)
    assert estimate_noise(slow, np.arange(400.0), visit).inflation > 2.5
    assert estimate_noise(white, np.arange(400.0), visit).inflation == 1.0


def test_without_replicates_the_high_frequency_part_is_used_and_reported():
    rng = np.random.default_rng(3)
    t = np.arange(300) * 0.2
    residual = 3.0 * np.sin(0.2 * t)[:, None] + rng.normal(size=(300, F)) * 0.1
    noise = estimate_noise(residual, t, np.full(300, -1))
    assert "high-frequency" in noise.source
    assert np.sqrt(np.mean(np.diag(noise.covariance))) == pytest.approx(0.1, rel=0.15)


def test_too_few_frames_is_an_error():
    with pytest.raises(SoftmapError, match="too few"):
        estimate_noise(np.zeros((3, F)), np.arange(3.0), np.full(3, -1))


def test_kernel_is_low_rank_and_right():
    rng = np.random.default_rng(4)
    command = rng.uniform(-10, 10, size=(500, 2))
    kernel = command_kernel(command, np.array([20.0, 20.0]))
    assert len(kernel.strength) <= 64
    low_rank = (kernel.basis * kernel.strength) @ kernel.basis.T
    x = command / 20 / 0.4
    full = np.exp(-0.5 * np.sum((x[:, None] - x[None]) ** 2, axis=2))
    assert np.abs(low_rank - full).max() < 0.02
    assert np.allclose(kernel.basis.T @ kernel.basis, np.eye(len(kernel.strength)), atol=1e-9)


def test_channel_that_stands_still_identifies_nothing():
    """Wherever it stands: 3 mm divided by a spread of nothing drowned the distances in rounding."""
    command = np.column_stack([np.linspace(-5, 5, 40), np.full(40, 3.0)])
    moved, still = (command_kernel(c, np.ptp(c, axis=0)) for c in (command[:, :1], command))
    assert still.strength == pytest.approx(moved.strength)
    constant = command_kernel(command[:, 1:], np.zeros(1))
    assert constant.strength == pytest.approx([40.0])


def test_whitened_form_error_and_noise_have_unit_variance():
    rng = np.random.default_rng(5)
    count = 300
    command = rng.uniform(-10, 10, size=(count, 2))
    kernel = command_kernel(command, np.array([20.0, 20.0]))
    positions, section = np.ones(V, bool), np.arange(V)
    form = form_covariance(np.full((V, 3), 0.4), positions, section)
    noise = Noise(np.diag(np.full(F, 0.1**2)), "known", 1.0)
    signatures = rng.normal(size=(8, count, F))
    white = whitener(noise, form, signatures, kernel)
    root = np.linalg.cholesky(form + 1e-12 * np.eye(F))
    over_commands = kernel.basis * np.sqrt(kernel.strength)
    values, blind = [], []
    for _ in range(20):
        error = over_commands @ rng.normal(size=(len(kernel.strength), F)) @ root.T
        draw = error + 0.1 * rng.normal(size=(count, F))
        values.append(np.mean(white.shrink(white.modes(draw)) ** 2))
        blind.append(np.mean(white.modes(draw) ** 2))
    # 300 x 18 x 20 numbers: one standard deviation of their mean square is 0.5 %.
    assert np.mean(values) == pytest.approx(1.0, abs=0.03)
    assert np.mean(blind) > 5.0  # without the model-form error the same numbers are far from white


def test_squares_are_those_of_the_shrunk_modes():
    rng = np.random.default_rng(3)
    kernel = command_kernel(rng.uniform(-8, 8, (90, 2)), np.array([16.0, 16.0]))
    for form in (np.array([40.0, 3.0, 0.0]), np.zeros(3)):
        found = Whitener(np.eye(3), form, kernel)
        modes = rng.normal(size=(4, 90, 3))
        np.testing.assert_allclose(
            found.squares(modes), np.sum(found.shrink(modes) ** 2, axis=(1, 2)), rtol=1e-12
        )


def rods(residual, form, repeats=None):
    t = np.arange(len(residual)) * 0.05
    measured = estimate_noise(residual, t, np.full(len(residual), -1))
    return rod_noise(residual, t, np.full((3, 3), form), measured, repeats)


def test_rod_noise_counts_correlated_frames_once():
    rng = np.random.default_rng(6)
    slow = np.repeat(rng.normal(size=(60, 9)), 20, axis=0)
    noise = rods(slow, 4.0)
    assert noise.inflation > 15
    assert rods(rng.normal(size=(1200, 9)), 4.0).inflation < 5
    assert noise.rms_mm(np.ones(3, bool)) == pytest.approx(4 * np.sqrt(3), rel=0.01)


def test_what_does_not_repeat_is_no_error_of_a_rods_map():
    """A residual that is all memory: the same command, two shapes. The map's model error cannot
    absorb it.
    """
    rng = np.random.default_rng(7)
    branch = np.sign(np.sin(np.arange(1200) * 0.05))[:, None] * np.ones(9)
    residual = 2.0 * branch + 0.1 * rng.normal(size=(1200, 9))
    memory = Repeats(np.full(9, 4.0), poses=20, passages=60, rows=np.arange(600))
    hidden, seen = rods(residual, 2.0), rods(residual, 2.0, memory)
    assert hidden.rms_mm(np.ones(3, bool)) > 3.4 and seen.rms_mm(np.ones(3, bool)) < 0.5
    static = replace(memory, variance=np.full(9, 0.01))  # poses that repeat: then it is model error
    assert rods(residual, 2.0, static).rms_mm(np.ones(3, bool)) > 3.4


def test_unseen_features_do_not_count():
    noise = Noise(np.eye(F), "known", 1.0)
    kernel = command_kernel(np.zeros((4, 0)), np.zeros(0))
    white = whitener(noise, np.zeros((F, F)), np.ones((1, 4, F)), kernel)
    hole = np.ones((4, F))
    hole[2] = np.nan
    assert np.all(white.shrink(white.modes(hole))[2] == 0) and np.any(
        white.shrink(white.modes(hole))[1] != 0
    )


def test_what_a_lean_makes_is_another_error_in_another_orientation():
    """The same smooth field everywhere is forgiven; one that turns round with the orientation only
    where it may.
    """
    rng = np.random.default_rng(2)
    command = rng.uniform(-10.0, 10.0, (120, 2))
    side = np.where(np.arange(120) < 60, 1.0, -1.0)
    field = 0.5 * np.cos(0.1 * command[:, 0])
    leaning = np.stack([np.ones(120), 0.8 * side], axis=1)
    spread = np.array([20.0, 20.0])
    noise = Noise(np.eye(3) * 1e-2, "known", 1.0)
    left = {}
    for name, rows in (("command", None), ("orientation", leaning)):
        kernel = command_kernel(command, spread, rows)
        white = whitener(noise, np.eye(3) * 0.25, np.ones((1, 120, 3)), kernel)
        modes = [white.modes(values[:, None] * np.ones(3)) for values in (field, side * field)]
        left[name] = [float(np.sum(white.shrink(m) ** 2)) for m in modes]
    assert left["command"][0] < 0.02 * left["command"][1]
    assert left["orientation"][1] < 0.05 * left["command"][1]


# --- the complete model, on the simulated finger --------------------------------------------------


def chi2(vertices, protocol):
    """Chi² per number of the built-in model on a run without a hidden effect, and the noise of a
    point, mm.
    """
    run = Run(
        t=protocol.t,
        command=protocol.command,
        gravity=protocol.gravity,
        t_seen=protocol.t_seen,
        block=protocol.block,
        vertices=vertices,
        command_unit="mm",
    )
    record = Record(builtin_model(), run)
    names = candidates_of(record, None)[0]
    problem = problem_of(record, names)
    return problem.null().chi2 / problem.numbers, noise_of_points(run).mm


@pytest.mark.parametrize("camera", [Camera(), Camera(shift_mm=0.3, turn_deg=0.2, memory_s=10.0)])
def test_with_nothing_hidden_chi2_is_the_count_of_numbers(camera):
    """The model as its own truth, seen by the camera of the hidden truths: once with a jitter of 10
    s.
    """
    protocol, model = standard_protocol(), builtin_model()
    rest = np.repeat(model.rest[None], protocol.frames, axis=0)
    clean = model.predict(
        Run(
            t=protocol.t,
            command=protocol.command,
            gravity=protocol.gravity,
            t_seen=protocol.t_seen,
            vertices=rest,
            command_unit="mm",
        )
    )
    found = [
        chi2(camera.look(clean, protocol.t_seen, np.random.default_rng(s)), protocol)
        for s in range(3)
    ]
    assert [ratio for ratio, _ in found] == pytest.approx([1.0] * 3, abs=0.15)
    # a point: its own noise, and the frame's at 60 mm from the base, in all directions
    turn = np.radians(camera.turn_deg) * np.sqrt(2.0) * np.sqrt(np.mean(np.sum(clean**2, axis=2)))
    true = np.sqrt(3 * camera.vertex_mm**2 + 3 * camera.shift_mm**2 + turn**2)
    assert np.mean([mm for _, mm in found]) == pytest.approx(true, rel=0.15)


@pytest.mark.prove
@pytest.mark.parametrize("seed", range(4))
def test_with_nothing_hidden_chi2_is_right_on_another_finger(seed):
    protocol = standard_protocol()
    ratio, _ = chi2(np.asarray(Truth(seed).measure(protocol).vertices), protocol)
    assert ratio == pytest.approx(1.0, abs=0.15)


def test_check_and_compare_report_one_noise():
    protocol, model = standard_protocol(), builtin_model()
    rest = np.repeat(model.rest[None], protocol.frames, axis=0)
    run = Run(
        t=protocol.t,
        command=protocol.command,
        gravity=protocol.gravity,
        t_seen=protocol.t_seen,
        vertices=rest,
        command_unit="mm",
        robot=model.robot,
    )
    seen = Camera(memory_s=5.0, shift_mm=0.2).look(
        model.predict(run), run.t_seen, np.random.default_rng(0)
    )
    run = replace(run, vertices=seen)
    number = compare(model, run).noise_floor_mm
    assert noise_of_points(run).mm == number
    text = next(w.text for w in summary(run).can_tell if w.about == "noise")
    assert f"the noise is {number:.2g} mm" in text


@pytest.mark.parametrize(("share", "seed"), [(0.03, 1), (0.1, 2), (0.2, 3), (0.3, 4)])
def test_points_that_are_hidden_at_times_leave_the_noise_as_it_is(share, seed):
    """Five markers of a finger that visits places again; a hidden one is not where others were seen
    in between.
    """
    rng, model = np.random.default_rng(seed), builtin_model()
    places = 8.0 * np.array(
        [[0, 0], [1, 0], [0, 0], [0, 1], [-1, 0], [0, 0], [0, -1], [1, 0], [0, 0]]
    )
    goal = np.repeat(np.tile(places, (2, 1)), 6, axis=0)
    t = 0.7 * np.arange(len(goal))
    blank = Run(t=t, command=goal, t_seen=t, robot=model.robot)
    points = model.predict(blank)[:, np.linspace(0, len(model.rest) - 1, 5).astype(int)]
    run = replace(blank, markers=points + rng.normal(0.0, 0.3, points.shape))
    hidden = replace(run, visible=rng.random(points.shape[:2]) > share)
    assert noise_of_points(hidden).mm == pytest.approx(noise_of_points(run).mm, rel=0.15)
    assert noise_of_points(run).mm == pytest.approx(0.3 * np.sqrt(3.0), rel=0.15)


@pytest.mark.parametrize("markers", [(0, 1, 2, 3, 4, 5, 6, 7), (1, 3, 5, 7), (2, 5, 7)])
@pytest.mark.parametrize("lost", [0.0, 1.0, 5.0])
def test_play_of_a_body_that_never_dwells_is_no_noise(lost, markers):
    """It moves on all the time, on a path that never comes back; play loses up to half of it."""
    rng = np.random.default_rng(int(lost))
    t = np.arange(0.0, 100.0, 0.05)
    command = 9.0 * np.stack(
        [np.sin(t / 2.7 + 1) * np.sin(t / 9.7), np.sin(t / 3.7) * np.cos(t / 11.3)], axis=1
    )
    acting = command.copy()
    for k in range(1, len(t)):
        acting[k] = np.clip(acting[k - 1], command[k] - lost, command[k] + lost)
    seen = np.arange(0.3, 99.0, 0.5)
    own, truth = (shape(at(t, u, seen))[:, list(markers)] for u in (command, acting))
    points = (truth + 0.1 * rng.normal(size=truth.shape)).reshape(len(seen), -1)
    state = conditions(record(t, command, seen), command)
    places = np.ones(len(markers), bool)
    noise = measure_noise(points - own.reshape(points.shape), points, places, state.time, state)
    assert noise.rms_mm(places) == pytest.approx(0.1 * np.sqrt(3), rel=0.15)


def test_a_frame_that_wanders_under_a_moving_body_is_noise():
    """The body's own shapes show it, also where it correlates over seconds."""
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 100.0, 0.05)
    command = 9.0 * np.stack([np.sin(t / 2.7 + 1), np.sin(t / 3.7)], axis=1)
    seen = np.arange(0.3, 99.0, 0.5)
    state = conditions(record(t, command, seen), command)
    away = wander(seen, 8.0, rng, 6)
    points = shaken(shape(at(t, command, seen)), np.radians(0.25) * away[:, :3], 0.3 * away[:, 3:])
    points = (points + 0.1 * rng.normal(size=points.shape)).reshape(len(seen), -1)
    noise = noise_off_shapes(points, state)
    assert noise.inflation > 3.0 and 0.3 < noise.rms_mm(np.ones(8, bool)) < 0.8
