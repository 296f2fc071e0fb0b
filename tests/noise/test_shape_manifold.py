"""The manifold of a body's shapes: memory of the drive stays on it, whatever its size; what moves the
camera leaves it.
"""

import numpy as np
import pytest
from bending import at, record, shape, tour, visits

from softmap_edge.noise.repeats import RUN, settled_dwells
from softmap_edge.noise.shape_manifold import monomials, rank, shapes, slopes
from softmap_edge.run.conditions import conditions

WHITE = 0.05  # mm a coordinate


def run(seed=0, lost=0.0, gravity=None):
    """Return features (K, F) of an arm whose tendons lose up to `lost` mm at random, conditions."""
    rng = np.random.default_rng(seed)
    t, command, seen = visits(tour(rng, 4), rng)
    acting = at(t, command, seen) + lost * rng.uniform(-1.0, 1.0, (len(seen), 2))
    points = shape(acting) + WHITE * rng.normal(size=(len(seen), 8, 3))
    more = {} if gravity is None else {"gravity": gravity(t)}
    return points.reshape(len(seen), -1), conditions(record(t, command, seen, **more), command)


def rms(values):
    return float(np.sqrt(np.nanmean(values**2)))


@pytest.mark.parametrize("lost", [0.0, 1.0, 5.0])
def test_a_body_that_does_not_obey_still_takes_its_shapes(lost):
    seen, state = run(lost=lost)
    body = shapes(seen, state, settled_dwells(state))
    assert rms(body.remainder) == pytest.approx(WHITE, rel=0.1)


def test_what_moves_the_camera_leaves_the_manifold():
    seen, state = run(lost=2.0)
    seen = seen.reshape(len(seen), -1, 3)
    seen[::7] += [0.0, 0.0, 1.0]  # the body cannot become longer
    body = shapes(seen.reshape(len(seen), -1), state, settled_dwells(state))
    moved = body.remainder.reshape(seen.shape)[::7]
    assert moved[:, :, 2].mean() == pytest.approx(1.0, abs=0.25)


def test_tangents_are_the_slopes_of_the_shapes():
    seen, state = run(lost=3.0)
    body = shapes(seen, state, settled_dwells(state))
    command = np.array([[4.0, -3.0]])
    near = np.argsort(np.sum((seen - shape(command).ravel()) ** 2, axis=1))[:1]
    tangents = body.tangents(near)
    assert tangents.shape == (1, seen.shape[1], 2)
    along = np.linalg.qr(tangents[0])[0]
    for step in ([0.01, 0.0], [0.0, 0.01]):
        slope = (shape(command + step) - shape(command)).ravel()
        left = slope - along @ (along.T @ slope)
        assert np.linalg.norm(left) < 0.1 * np.linalg.norm(slope)


def test_two_orientations_are_two_manifolds():
    """The body hangs by 5 mm in the second, as no command moves it."""

    def gravity(t):
        return np.where(t[:, None] < np.median(t), [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])

    seen, state = run(lost=1.0, gravity=gravity)
    hangs = (state.gravity[:, 0] > 0.5)[:, None] * 5.0
    seen = (seen.reshape(len(seen), -1, 3) + hangs[:, :, None] * [1.0, 0.0, 1.0]).reshape(
        seen.shape
    )
    body = shapes(seen, state, settled_dwells(state))
    assert rms(body.remainder) == pytest.approx(WHITE, rel=0.15)


def test_two_runs_are_two_manifolds():
    seen, state = run(lost=1.0)
    dwell = settled_dwells(state)
    later = state.time > np.median(state.time)
    seen[later] += 4.0
    dwell[later & (dwell >= 0)] += 1 << RUN
    assert rms(shapes(seen, state, dwell).remainder) < 1.2 * WHITE


def test_unseen_features_have_no_remainder():
    seen, state = run()
    seen[5:9, 3:6] = np.nan
    body = shapes(seen, state, settled_dwells(state))
    assert (
        np.isnan(body.remainder[5:9, 3:6]).all()
        and np.isfinite(body.tangents(np.arange(len(seen)))).all()
    )


@pytest.mark.parametrize(
    ("columns", "directions"),
    [
        ([[1, 0], [0, 1]], 2),
        ([[1, 0], [-0.5, 0.866], [-0.5, -0.866]], 2),  # three tendons that add up to nothing
        ([[1, 0], [2, 0]], 1),
        ([[1, 0], [0, 1e-4]], 2),  # of another unit
        ([[0, 0]], 0),
    ],
)
def test_rank_of_commands(columns, directions):
    moved = np.random.default_rng(1).normal(size=(50, 2))
    assert rank(moved @ np.array(columns, float).T) == directions


def test_too_few_frames_or_too_many_channels_are_none():
    seen, state = run()
    few = np.arange(20, 40)
    state_of = type(state)(
        **{name: None if value is None else value[few] for name, value in vars(state).items()}
    )
    assert shapes(seen[few], state_of, settled_dwells(state_of)) is None
    wide = np.random.default_rng(2).normal(size=(len(seen), 7))
    many = type(state)(**(vars(state) | {"command": wide}))
    assert shapes(seen, many, settled_dwells(many)) is None


def test_slopes_of_monomials_are_differences():
    x, step = np.random.default_rng(3).uniform(-1, 1, (6, 3)), 1e-6
    values, slope = monomials(x, 3), slopes(x, 3)
    assert values.shape == (6, 20) and np.all(values[:, 0] == 1.0)
    for d in range(3):
        moved = x + step * (np.arange(3) == d)
        np.testing.assert_allclose(slope[:, :, d], (monomials(moved, 3) - values) / step, atol=1e-5)


def test_a_hidden_feature_is_where_the_manifold_has_it():
    """A third of the markers is hidden at random."""
    seen, state = run(lost=2.0)
    hidden = np.random.default_rng(4).random((len(seen), 8)) < 0.33
    shown = np.where(np.repeat(hidden, 3, axis=1), np.nan, seen)
    assert rms(shapes(shown, state, settled_dwells(state)).remainder) < 1.5 * WHITE
