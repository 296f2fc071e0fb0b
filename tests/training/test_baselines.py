"""Encodings that are inverted exactly, and baselines that learn more than the mean shape."""

import importlib.util

import numpy as np
import pytest

pytest.importorskip("torch")

from softmap_training import choices, encodings
from softmap_training.baselines import NAMES, fit_baseline
from softmap_training.errors import TrainingError
from softmap_training.evaluate import holds_shapes_of
from softmap_training.prior import Surface, fit_prior, train_prior, vertex_error, with_prior

from softmap_edge import Run, builtin_model, load_bundle, save_bundle
from softmap_edge.fem.simulator import tensor_grid

BASE = builtin_model()
LOW, HIGH = BASE.command_range.T
RNG = np.random.default_rng(4)
COMMANDS = RNG.uniform(LOW, HIGH, (160, 2))
POINTS = np.asarray(BASE.prior.evaluate(COMMANDS))
TRAIN, TEST = np.arange(120), np.arange(120, 160)
SURFACE = Surface.of(BASE)
MEAN = vertex_error(np.broadcast_to(POINTS[TRAIN].mean(axis=0), POINTS[TEST].shape), POINTS[TEST])


def test_laplacian_coordinates_are_inverted():
    reported = encodings.laplacian(SURFACE.rest, SURFACE.triangles, SURFACE.held, POINTS[:5])
    back = reported.mean + reported.codes @ reported.modes
    assert np.abs(back - POINTS[:5]).max() < 0.02  # clamped vertices are held softly
    # differences: they know no place
    assert np.abs(reported.codes.reshape(5, -1, 3).sum(axis=1)).max() < 1e-6


def test_rotations_give_a_rigid_motion_back_exactly_and_a_bent_shape_nearly():
    rest = SURFACE.rest
    turn = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    moved = ((rest - rest[0]) @ turn.T + rest[0]).ravel()[None]
    reported = encodings.arap(rest, SURFACE.triangles, SURFACE.held[:1], moved)
    np.testing.assert_allclose(
        reported.codes[0, : 9 * len(rest)].reshape(-1, 3, 3),
        np.broadcast_to(turn, (len(rest), 3, 3)),
        atol=1e-9,
    )
    one = encodings.arap(rest, SURFACE.triangles, np.array([0]), moved)
    np.testing.assert_allclose(one.mean + one.codes[0] @ one.modes, moved[0], atol=1e-6)
    bent = encodings.arap(rest, SURFACE.triangles, SURFACE.held, POINTS[:8])
    left = vertex_error(bent.mean + bent.codes @ bent.modes, POINTS[:8])
    assert left < 0.05 * vertex_error(np.broadcast_to(rest.ravel(), POINTS[:8].shape), POINTS[:8])


@pytest.mark.parametrize("kind", ["laplacian", "arap", "linear"])
def test_an_encoded_prior_is_a_network_like_any_other(kind):
    parts = TRAIN, TEST[:20], TEST[20:]
    recipe = choices.PUBLISHED_PRIOR.with_(epochs=20)
    found = train_prior(COMMANDS, POINTS, parts, kind, SURFACE, recipe)
    assert found.report["test_vertex_mm"] < 0.8 * MEAN, (found.report["test_vertex_mm"], MEAN)
    assert found.report["parity_mm"] < 1e-3


def test_encodings_need_a_surface():
    with pytest.raises(TrainingError, match="surface"):
        train_prior(COMMANDS, POINTS, (TRAIN, TEST[:20], TEST[20:]), "arap")


EACH = [
    pytest.param(name, marks=pytest.mark.long) if name == "deepsoro" else name for name in NAMES
]


@pytest.mark.parametrize("name", EACH)
def test_a_baseline_learns_and_the_same_seed_gives_the_same(name, monkeypatch):
    if name == "xgboost" and importlib.util.find_spec("xgboost") is None:
        pytest.skip("xgboost-cpu is not installed")
    monkeypatch.setattr(choices, "DEEPSORO", choices.DEEPSORO.with_(epochs=20, rate=3e-3))
    monkeypatch.setattr(choices, "DEEPSORO_WIDTH", 32)
    monkeypatch.setattr(choices, "DEEPSORO_DRAWN", 1)
    monkeypatch.setattr(choices, "XGBOOST", choices.XGBOOST | {"n_estimators": 60})
    fitted = fit_baseline(name, COMMANDS[TRAIN], POINTS[TRAIN])
    found = fitted.predict(COMMANDS[TEST])
    assert found.shape == POINTS[TEST].shape and fitted.numbers > 0
    if name == "deepsoro":  # its points are no vertices
        from softmap_training.evaluate import on_shapes

        mean = np.broadcast_to(POINTS[TRAIN].mean(axis=0), POINTS[TEST].shape)
        reported = [
            on_shapes(name, lambda u, p=p: p[: len(u)], COMMANDS[TEST], POINTS[TEST], {})
            for p in (found, mean)
        ]
        assert reported[0].errors["chamfer"].mean() < reported[1].errors["chamfer"].mean()
    else:
        assert vertex_error(found, POINTS[TEST]) < (0.6 if name == "xgboost" else 0.1) * MEAN
    np.testing.assert_array_equal(
        found, fit_baseline(name, COMMANDS[TRAIN], POINTS[TRAIN]).predict(COMMANDS[TEST])
    )


@pytest.mark.parametrize("name", ["table", "gp", pytest.param("xgboost", marks=pytest.mark.long)])
def test_a_regressor_joins_a_bundle_as_a_table_of_its_own_values(name, tmp_path):
    if name == "xgboost" and importlib.util.find_spec("xgboost") is None:
        pytest.skip("xgboost-cpu is not installed")
    made = fit_prior(BASE, COMMANDS, POINTS, (TRAIN, TEST[:20], TEST[20:]), name)
    model = load_bundle(
        save_bundle(with_prior(BASE, made, COMMANDS[TEST[20:]], POINTS[TEST[20:]]), tmp_path / name)
    )
    assert model.kind == "table" and model.made_from["prior"]["kind"] == name
    # fitted to a part, it is tested on the rest
    assert not holds_shapes_of(model, tensor_grid(model.prior.axes))
    nodes = tensor_grid(model.prior.axes)[::17]
    alone = fit_baseline(name, COMMANDS[TRAIN], POINTS[TRAIN]).predict(nodes)
    np.testing.assert_allclose(model.prior.evaluate(nodes), alone, atol=2e-3)
    found = vertex_error(np.asarray(model.prior.evaluate(COMMANDS[TEST[20:]])), POINTS[TEST[20:]])
    assert found == pytest.approx(made.report["test_vertex_mm"], rel=1e-3) and found < 0.6 * MEAN
    t = np.arange(8.0)
    run = Run(t=t, command=COMMANDS[:8], t_seen=t)
    assert np.isfinite(model.with_effects(("payload",), {"payload.mass": 10.0}).predict(run)).all()


def test_what_is_no_prior_is_reported():
    with pytest.raises(TrainingError, match="no vertices"):
        fit_prior(BASE, COMMANDS, POINTS, (TRAIN, TEST[:20], TEST[20:]), "deepsoro")
    with pytest.raises(TrainingError, match="same finger"):
        fit_prior(BASE, COMMANDS[:, :1], POINTS, (TRAIN, TEST[:20], TEST[20:]), "gp")
    # tendons at other sides
    other = np.asarray(BASE.prior.evaluate(np.ascontiguousarray(COMMANDS[:, ::-1])))
    damaged = np.where(np.arange(len(POINTS))[:, None] == 3, 1e30, POINTS)
    parts = TRAIN, TEST[:20], TEST[20:]
    for points, said in (
        (other, "another finger or material"),
        (damaged, "is damaged"),
        (0 * POINTS, "mm from those"),
    ):
        with pytest.raises(TrainingError, match=said):
            fit_prior(BASE, COMMANDS, points, parts, "gp")
    with pytest.raises(TrainingError, match="4, 0 and 1 samples"):
        fit_prior(
            BASE, COMMANDS[:5], POINTS[:5], (np.arange(4), np.arange(0), np.arange(4, 5)), "gp"
        )


def test_a_prior_replaced_again_has_the_error_of_the_last_alone_and_no_wider_range():
    near = np.flatnonzero((np.abs(COMMANDS) < 6.0).all(axis=1))
    parts = near[:-8], near[-8:-4], near[-4:]
    judged = COMMANDS[parts[2]], POINTS[parts[2]]
    made = fit_prior(BASE, COMMANDS, POINTS, parts, "table")
    once = with_prior(BASE, made, *judged)
    bad = with_prior(
        BASE, fit_prior(BASE, COMMANDS, POINTS, (near[:3], *parts[1:]), "table"), *judged
    )
    assert bad.vertex_error_mm > 2 * once.vertex_error_mm
    again = with_prior(bad, made, *judged)
    assert again.vertex_error_mm == pytest.approx(once.vertex_error_mm)
    np.testing.assert_allclose(again.form_error, once.form_error)
    assert (np.abs(once.command_range) <= 6.0).all()


def test_an_unknown_baseline_is_reported():
    with pytest.raises(TrainingError, match="no baseline 'forest'"):
        fit_baseline("forest", COMMANDS, POINTS)
