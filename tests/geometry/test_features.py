"""Features of shapes: what they see, what they ignore, and how markers ride on a template."""

import numpy as np
import pytest

from softmap_edge.errors import SoftmapError
from softmap_edge.files.npz import read_npz, write_npz
from softmap_edge.geometry.sections import attach, section_features, seen_residual, upright


def cylinder(rings=28, around=12, radius=12.0, height=100.0):
    z, phi = np.meshgrid(
        np.linspace(0, height, rings), np.arange(around) * 2 * np.pi / around, indexing="ij"
    )
    return np.stack([radius * np.cos(phi), radius * np.sin(phi), z], axis=-1).reshape(-1, 3)


def rotation(axis, angle):
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def test_places_move_under_translation_and_directions_do_not():
    rest = cylinder()
    features = section_features(upright(rest))
    shift = np.array([1.0, -2.0, 0.5])
    moved = features(rest + shift) - features(rest)
    np.testing.assert_allclose(moved[features.positions], np.tile(shift, (9, 1)), atol=1e-9)
    np.testing.assert_allclose(moved[~features.positions], 0.0, atol=1e-9)


def test_features_turn_with_the_body():
    rest = cylinder()
    features, turn = section_features(upright(rest)), rotation([1, 2, 3], 0.3)
    np.testing.assert_allclose(features(rest @ turn.T), features(rest) @ turn.T, atol=1e-9)


def test_moments_see_a_twist_that_centroids_do_not():
    rest = cylinder()
    features = section_features(upright(rest))
    twist = 0.1 * rest[:, 2] / 100.0
    turned = rest.copy()
    turned[:, 0] = np.cos(twist) * rest[:, 0] - np.sin(twist) * rest[:, 1]
    turned[:, 1] = np.sin(twist) * rest[:, 0] + np.cos(twist) * rest[:, 1]
    moved = np.linalg.norm(features(turned) - features(rest), axis=1)
    assert moved[features.positions].max() < 1e-9
    assert moved[~features.positions].max() > 0.5  # radius 12 mm times about 0.1 rad


def test_matrix_is_the_same_map():
    rest = cylinder()
    features = section_features(upright(rest))
    np.testing.assert_allclose(
        (rest.ravel() @ features.matrix()).reshape(-1, 3), features(rest), atol=1e-9
    )


def test_attached_markers_follow_every_affine_motion():
    rest = cylinder()
    markers = np.array([[0.0, 0.0, 50.0], [13.0, 1.0, 20.0], [3.0, -11.0, 97.0]])
    stretch = rotation([0, 1, 0], 0.2) @ np.diag([1.1, 0.95, 1.02])
    carried = attach(markers, rest) @ (rest @ stretch.T + 3.0)
    np.testing.assert_allclose(carried, markers @ stretch.T + 3.0, atol=1e-5)


def test_half_seen_section_gives_the_residual_of_the_full_one():
    rest = cylinder()
    body = upright(rest)
    features = section_features(body)
    angle = np.arctan2(rest[:, 1], rest[:, 0])
    residual = np.stack([1 + 0.5 * np.cos(angle), np.sin(angle), 0.2 + 0 * angle], axis=1)
    seen = rest[:, 0] > -0.5
    none, five = (
        np.zeros(len(rest), bool),
        np.isin(np.arange(len(rest)), np.flatnonzero(body.section == 0)[:5]),
    )
    found = seen_residual(np.stack([residual] * 3), body, np.stack([seen, none, five]))
    np.testing.assert_allclose(found[0, :9], features(residual)[:9], atol=1e-6)
    assert np.isnan(found[1:]).all()


def test_archives_are_deterministic_and_refuse_objects(tmp_path):
    arrays = {"b": np.arange(6.0).reshape(2, 3), "a": np.array([1, 2], np.int32)}
    write_npz(tmp_path / "one.npz", arrays)
    write_npz(tmp_path / "two.npz", dict(reversed(list(arrays.items()))))
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()
    np.testing.assert_array_equal(read_npz(tmp_path / "one.npz")["b"], arrays["b"])
    np.savez(tmp_path / "evil.npz", x=np.array([{"a": 1}], dtype=object))
    with pytest.raises(SoftmapError, match="Python objects"):
        read_npz(tmp_path / "evil.npz")
