"""A robot without a simulator: its rod is learned from a reference run, and says honestly how far
it is off.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from logs import published
from rod_commands import commands

from softmap_edge import _core
from softmap_edge.cli import main
from softmap_edge.diagnosis.diagnose import diagnose
from softmap_edge.errors import RunError, SoftmapError
from softmap_edge.model.basis import Basis
from softmap_edge.model.bundle import load_bundle, save_bundle
from softmap_edge.model.polynomial_rod import PolynomialRodArrays
from softmap_edge.rod.learn import LearnedRod, learn, learn_model
from softmap_edge.rod.regression import Drive, Record, Regression, rms
from softmap_edge.run.folds import folds
from softmap_edge.run.run import Run

ROOT = Path(__file__).parents[2]
DELAY, LAG = 0.12, 0.1  # s


@pytest.fixture(scope="module")
def truth():
    """A rod of two chords that shorten as they bend, driven by two commands, quadratic."""
    rng = np.random.default_rng(5)
    angles = rng.normal(0.0, 0.06, (6, 4))
    angles[1:3] = [[0.5, 0.05, -0.1, 0.3], [0.0, 0.4, 0.6, 0.1]]
    lengths = np.zeros((15, 2))
    lengths[0], lengths[5], lengths[14] = (110.0, 90.0), (-4.0, 0.0), (0.0, -3.0)
    return PolynomialRodArrays(
        np.zeros(3), np.zeros(2), np.array([10.0, 8.0]), 2, angles, lengths, 1e-6
    )


def delayed_and_lagged(t):
    """What a drive with DELAY and LAG makes of `commands`: a plain Euler sum in steps of 0.5 ms, no
    effect library.
    """
    fine = np.arange(0.0, t[-1] + 0.01, 5e-4)
    u = commands(np.maximum(fine - DELAY, 0.0))
    x, out = u[0].copy(), np.empty_like(u)
    for i, now in enumerate(u):
        x += 5e-4 / LAG * (now - x)
        out[i] = x
    return np.stack([np.interp(t, fine, out[:, c]) for c in range(2)], axis=1)


def make_run(truth, seconds=60.0, drive=commands, **more):
    t = np.arange(0.0, seconds, 0.01)
    seen = t[::5]
    markers = truth.compiled().evaluate(drive(t))[::5].reshape(len(seen), -1, 3)
    return Run(
        t=t,
        command=commands(t),
        t_seen=seen,
        markers=markers,
        gravity=np.array([0.0, 0.0, 1.0]),
        **more,
    )


@pytest.fixture(scope="module")
def plain(truth):
    return make_run(truth)


@pytest.fixture(scope="module")
def learned(plain):
    return learn(plain)


def test_a_rod_is_recovered_exactly(truth, learned):
    # The rest is the smallest ridge (1e-7 of the usual), not the polynomial: far below any
    # camera's noise.
    assert learned.error_mm < 1e-3
    assert learned.chain_names == ()
    assert learned.rod.degree >= 2
    u = np.random.default_rng(1).uniform(-1, 1, (50, 2)) * [8.0, 6.0]
    assert np.abs(learned.rod.compiled().evaluate(u) - truth.compiled().evaluate(u)).max() < 1e-2


def test_too_low_a_degree_is_seen_in_the_error(plain, learned):
    assert learn(plain, degree=1).error_mm > 100 * learned.error_mm


def test_a_missing_command_is_reported(plain):
    poor = learn(replace(plain, command=plain.command[:, :1]))
    assert any("may miss a command" in note for note in poor.notes)
    assert learn(plain).notes == ()


def test_delay_and_lag_of_the_drive_are_found(truth):
    run = make_run(truth, drive=delayed_and_lagged)
    rod = learn(run)
    assert set(rod.chain_names) == {"latency", "lag"}
    # The last steps of the search are 0.02 s / 2⁴.
    assert rod.chain_params["latency.delay"] == pytest.approx(DELAY, abs=0.005)
    assert rod.chain_params["lag.tau"] == pytest.approx(LAG, abs=0.005)
    assert rod.error_mm < 0.5
    # Without them the same polynomial fails.
    fit = Regression(run.markers, np.zeros(3), folds(run.t_seen, 5, 2.0))
    undelayed = Drive(Record(run.command, run.t, run.t_seen)).commanded
    assert rms(fit.cross_validate(undelayed, Basis(rod.rod.degree), 1.0)) > 10 * rod.error_mm


def test_frames_held_out_are_never_looked_at(truth, plain):
    markers = plain.markers.copy()
    inside = (plain.t_seen >= 20.0) & (plain.t_seen < 30.0)
    markers[inside] += 500.0
    spoiled = Run(t=plain.t, command=plain.command, t_seen=plain.t_seen, markers=markers)
    rod = learn(spoiled, hold_out=[(20.0, 30.0)])
    assert rod.error_mm < 1e-3 and not np.any(inside[rod.frames])
    assert learn(spoiled).error_mm > 50.0


@pytest.mark.parametrize("interval", ["30:20", "nan:20", "1000:2000"])
def test_holding_out_nothing_is_an_error(plain, interval, tmp_path, capsys):
    """With blocks kept from the fit, the model must not see everything."""
    plain.save(tmp_path / "run.npz")
    arguments = [
        "learn",
        str(tmp_path / "run.npz"),
        "--out",
        str(tmp_path / "rod"),
        "--hold-out",
        interval,
    ]
    assert main(arguments) == 2
    assert "--hold-out" in capsys.readouterr().err and not (tmp_path / "rod").exists()


def test_frames_near_a_block_do_not_predict_it():
    t = np.arange(0.0, 50.0, 0.05)
    for train, test in folds(t, 5, 2.0):
        assert np.abs(t[train][:, None] - t[test][[0, -1]]).min() > 2.0
        assert len(np.intersect1d(test, train)) == 0
    assert np.array_equal(np.concatenate([test for _, test in folds(t, 5, 2.0)]), np.arange(len(t)))


def test_hidden_markers_are_left_out(plain):
    visible = np.ones(plain.markers.shape[:2], bool)
    visible[::7, 1] = False
    markers = np.where(visible[..., None], plain.markers, np.nan)
    rod = learn(
        Run(t=plain.t, command=plain.command, t_seen=plain.t_seen, markers=markers, visible=visible)
    )
    assert rod.error_mm < 1e-3 and np.all(visible[rod.frames])


def test_slopes_match_finite_differences_also_in_the_straight_pose(truth):
    angles = truth.angles.copy()
    angles[0] = 0.0
    rod = PolynomialRodArrays(
        truth.base, truth.centre, truth.scale, 2, angles, truth.lengths, 1e-6
    ).compiled()
    for u in ([0.0, 0.0], [1e-6, -1e-6], [4.0, -7.0]):
        slopes = rod.jacobian(np.array([u]))[0]
        assert np.all(np.isfinite(slopes))
        for c in range(2):
            step = np.zeros(2)
            step[c] = 1e-4
            ends = rod.evaluate(np.stack([u + step, u - step]))
            np.testing.assert_allclose(slopes[:, c], (ends[0] - ends[1]) / 2e-4, atol=1e-6)
    np.testing.assert_allclose(
        rod.evaluate(np.zeros((1, 2)))[0], [0, 0, 110, 0, 0, 200], atol=1e-12
    )


def test_one_newton_across_the_tip_moves_it_by_a_tenth_of_the_length():
    straight = np.array([[0.0, 0.0, 0.0, 0.0], [0.1, 0.0, 0.1, 0.0]])
    lengths = np.zeros((15, 2))
    lengths[0] = 120.0, 80.0
    compliance = 0.1 * 200.0 / ((120.0**3 + 80.0**3) / 12.0)
    fields = PolynomialRodArrays(
        np.zeros(3), np.zeros(1), np.ones(1), 1, straight, lengths, compliance
    ).fields()
    assert set(fields) == set(_core.LOADS)
    home = np.zeros((1, 1))
    np.testing.assert_allclose(
        fields["tip_force_x"].evaluate(home)[0, 3:], [20.0, 0.0, 0.0], atol=1e-9
    )
    # An even weight of 1 N, as a plain sum: moment less its mean on each chord, times the arm to
    # the tip.
    s = (np.arange(20000) + 0.5) / 100.0
    moment = (200.0 - s) ** 2 / 400.0
    for chord in (s < 120.0, s >= 120.0):
        moment[chord] -= moment[chord].mean()
    tip = compliance * (moment * (200.0 - s)).sum() / 100.0
    np.testing.assert_allclose(
        fields["gravity_y"].evaluate(home)[0, 3:], [0.0, tip, 0.0], atol=1e-5
    )
    np.testing.assert_array_equal(fields["gravity_z"].evaluate(home), 0.0)


def test_learned_rods_have_that_compliance(learned):
    tip = learned.rod.fields()["tip_force_x"].evaluate(np.zeros((1, 2)))[0, 3:]
    assert np.linalg.norm(tip) == pytest.approx(20.0, rel=0.05)  # the rest pose is a little bent


def test_arrays_carry_the_full_rod(learned):
    again = PolynomialRodArrays.from_npz(learned.rod.to_npz())
    u = np.array([[3.0, -2.0]])
    np.testing.assert_array_equal(again.compiled().evaluate(u), learned.rod.compiled().evaluate(u))
    for name in learned.rod.to_npz():
        damaged = {**learned.rod.to_npz(), name: np.zeros((2, 2, 2))}
        with pytest.raises(SoftmapError, match=name):
            PolynomialRodArrays.from_npz(damaged)
    with pytest.raises(_core.CoreError, match="angle"):
        PolynomialRodArrays.from_npz(
            {**learned.rod.to_npz(), "angles": np.zeros((3, 4))}
        ).compiled()


def test_a_bundle_predicts_like_the_rod_it_was_made_from(truth, tmp_path):
    run = make_run(truth, drive=delayed_and_lagged, robot="two-chords")
    model = learn_model(run)
    model = load_bundle(save_bundle(model, tmp_path / "rod"))
    assert model.kind == "rod" and set(model.chain_names) == {"latency", "lag"}
    assert np.sqrt(((model.predict(run) - run.markers) ** 2).sum(-1).mean()) < 0.5
    assert model.form_error.shape == (2, 3)


@pytest.mark.parametrize(
    "change",
    [
        {"markers": None},
        {"command": np.zeros((6000, 0))},
        {"t_seen": np.arange(4) / 20.0, "markers": np.zeros((4, 2, 3))},
        {"t_seen": np.arange(60) / 20.0, "markers": np.zeros((60, 2, 3)) + [0.0, 0.0, 1.0]},
    ],
)
def test_runs_that_teach_nothing_are_refused_in_one_line(plain, change):
    fields = {
        "t": plain.t,
        "command": plain.command,
        "t_seen": plain.t_seen,
        "markers": plain.markers,
    } | change
    if fields["markers"] is None:
        fields["t_seen"] = np.zeros(0)
    with pytest.raises(RunError) as refused:
        learn(Run(**fields))
    assert "\n" not in str(refused.value)


def test_bad_arguments_are_refused(plain):
    with pytest.raises(SoftmapError, match="base"):
        learn(plain, base=[1.0, 2.0])
    with pytest.raises(RunError, match="present"):
        learn(plain, input="present")
    with pytest.raises(RunError, match="blocks"):
        learn(plain, blocks=1)
    with pytest.raises((SoftmapError, _core.CoreError), match="degree"):
        learn(plain, degree=9)


@pytest.fixture(scope="module")
def trunk():
    folder = published("trunk")
    from softmap_edge.logs.importer import import_logs
    from softmap_edge.logs.mapping import read_mapping

    logs = [folder / "control_inputs_controlled_1.csv", folder / "observations_controlled_1.csv"]
    return import_logs(logs, read_mapping(ROOT / "examples/trunk.toml")).run


@pytest.mark.parametrize("source", ["goal", "present"])
def test_the_trunk_robot_is_learned(trunk, source):
    rod: LearnedRod = learn(trunk, source)
    print(rod)
    assert rod.error_mm <= 6.3
    assert (max(rod.per_fold_mm) < 8.0) and len(rod.per_fold_mm) == 5
    if source == "goal":  # the encoders lag the commands by about a fifth of a second
        assert 0.15 < sum(rod.chain_params.values()) < 0.3


def test_the_trunk_holds_for_seconds_that_were_kept_from_it(trunk):
    low, high = trunk.t_seen[-1] * 0.7, trunk.t_seen[-1]
    model = learn_model(trunk, hold_out=[(low - 2.0, high + 1.0)])
    kept = trunk.t_seen >= low
    error = (model.predict(trunk) - trunk.markers)[kept]
    assert np.sqrt((error**2).sum(-1).mean()) <= 6.3


@pytest.mark.parametrize(("unit", "size"), [("deg", 10.0), ("rad", 0.1), ("ticks", 150.0)])
def test_play_is_sought_in_the_size_of_the_drive(truth, unit, size):
    """A drive of ±100 degrees may have 8 of play: bounds are declared for tendons of ±16 mm and
    grow with the drive.
    """
    rng = np.random.default_rng(4)

    def log(gap, seconds):
        t = np.arange(0.0, seconds, 0.02)
        goal = commands(0.5 * t)
        moved, at = np.empty_like(goal), goal[0]
        for i, now in enumerate(goal):
            at = np.clip(at, now - gap / 2, now + gap / 2)
            moved[i] = at
        markers = truth.compiled().evaluate(moved)[::5].reshape(-1, 2, 3)
        markers = markers + rng.normal(0, 0.1, markers.shape)
        return Run(t=t, command=size * goal, t_seen=t[::5], markers=markers, command_unit=unit)

    found = diagnose(learn_model(log(0.0, 120.0)), log(0.8, 120.0))
    assert found.verdict == "identified" and [e.name for e in found.effects] == ["backlash"]
    gap = found.effects[0].params["backlash.gap"]
    assert (
        gap.value == pytest.approx(0.8 * size, rel=0.03) and gap.unit == unit and not gap.at_bound
    )


def test_tendons_that_add_up_to_zero_are_reported(truth):
    """Three tendons drive two directions: the effect of one alone cannot be learned, but learning
    still works.
    """
    t = np.arange(0.0, 60.0, 0.02)
    two = commands(t)
    three = np.column_stack([two, -two.sum(axis=1)])
    markers = truth.compiled().evaluate(two)[::3].reshape(-1, 2, 3)
    rod = learn(Run(t=t, command=three, t_seen=t[::3], markers=markers))
    (note,) = rod.notes
    assert "2 of 3 directions" in note and "u1 + u2 + u3 stays at" in note
    assert rod.error_mm < 0.1 and rod.chain_names == ()
    pair = learn(
        Run(
            t=t,
            command=np.column_stack([two, 1.0 - 0.5 * two[:, 0]]),
            t_seen=t[::3],
            markers=markers,
        )
    )
    assert "(0.5·u1 + u3 stays at 1 mm)" in pair.notes[0]


def test_a_robot_is_learned_from_the_ticks_of_its_servos(truth, tmp_path, capsys):
    """The proposal of a mapping keeps whole numbers as ticks; a learned model takes them as its
    unit.
    """
    t = np.arange(0.0, 60.0, 0.05)
    ticks = np.rint(2048 + 90.0 * commands(t))
    markers = truth.compiled().evaluate((ticks - 2048) / 90.0).reshape(len(t), -1)
    names = ",".join(
        ["time", "motor_1", "motor_2", *(f"m{m}_{axis}" for m in (1, 2) for axis in "xyz")]
    )
    np.savetxt(
        tmp_path / "log.csv",
        np.column_stack([t, ticks, markers]),
        "%.3f",
        ",",
        header=names,
        comments="",
    )
    log, mapping, npz, bundle = (
        str(tmp_path / name) for name in ("log.csv", "map.toml", "run.npz", "rod")
    )
    assert main(["import", log, "--guess", "--out", mapping]) == 0
    assert main(["import", log, "--map", mapping, "--out", npz]) == 0
    assert main(["learn", npz, "--out", bundle]) == 0
    run, model = Run.load(npz), load_bundle(bundle)
    assert run.command is not None and model.command_unit == "ticks"
    # The proposal guesses the clamp, and chords from another point have angles that are no
    # polynomials.
    assert np.sqrt(((model.predict(run) - run.markers) ** 2).sum(-1).mean()) < 0.3
    assert main(["compare", npz, "--bundle", bundle]) == 0
    capsys.readouterr()
