"""Handle vertices: chosen in the finger's file, carried by its bundle, and what the published
registration holds.
"""

from dataclasses import replace

import numpy as np
import pytest

from softmap_edge.alignment.register import PAPER_ROUNDS, register
from softmap_edge.cli import main
from softmap_edge.errors import FingerError
from softmap_edge.fem.build import build_model, handles_of
from softmap_edge.fem.finger import Finger
from softmap_edge.model.bundle import builtin_model, load_bundle, save_bundle
from softmap_edge.model.manifest import load_manifest

FINGER, MODEL = Finger.builtin(), builtin_model()


def distances(a, b):
    return np.linalg.norm(a[:, None] - b[None], axis=2)


@pytest.mark.parametrize("count", [2, 20, 137])
def test_they_are_spread_over_the_surface(count):
    handles = handles_of(FINGER.replace(handles=count), MODEL.rest)
    assert handles.shape == (count,) and np.all(np.diff(handles) > 0)
    assert np.argmax(np.linalg.norm(MODEL.rest, axis=1)) in handles
    # Farthest-point sampling leaves no vertex farther from a handle than two handles are from each
    # other.
    apart = distances(MODEL.rest[handles], MODEL.rest[handles]) + 1e9 * np.eye(count)
    assert distances(MODEL.rest, MODEL.rest[handles]).min(axis=1).max() <= apart.min()
    assert set(handles) < set(handles_of(FINGER.replace(handles=count + 1), MODEL.rest))


@pytest.mark.long
def test_the_file_the_bundle_and_the_command_carry_them(tmp_path, capsys):
    small = FINGER.replace(core=2, layers=10, handles=30)
    (tmp_path / "finger.toml").write_text(small.to_toml(), encoding="utf-8")
    assert Finger.load(tmp_path / "finger.toml") == small
    assert (
        main(
            [
                "model",
                "sweep",
                str(tmp_path / "finger.toml"),
                "--steps",
                "5",
                "--out",
                str(tmp_path / "sweep.npz"),
            ]
        )
        == 0
    )
    assert main(["build", str(tmp_path / "sweep.npz"), "--out", str(tmp_path / "bundle")]) == 0
    assert "(30 handles)" in capsys.readouterr().out
    model = load_bundle(tmp_path / "bundle")
    np.testing.assert_array_equal(model.handles, handles_of(small, model.rest))
    assert model.handles.shape == (30,) and load_manifest(tmp_path / "bundle")["schema"] >= 6
    again = save_bundle(model, tmp_path / "again")
    assert (again / "template.npz").read_bytes() == (
        tmp_path / "bundle" / "template.npz"
    ).read_bytes()


def test_a_bundle_that_does_not_name_them_means_all_and_stays_as_it_is(tmp_path):
    plain = replace(MODEL, safety=None)
    assert (
        MODEL.handles is None
        and load_manifest(save_bundle(plain, tmp_path / "plain"))["schema"] < 6
    )


def test_more_than_there_are_vertices_is_refused_before_the_sweep():
    reported = []
    with pytest.raises(
        FingerError, match=r"template.handles: 549, the template has 548 vertices; give 1 to 548"
    ):
        build_model(FINGER.replace(handles=549), progress=lambda what, share: reported.append(what))
    assert not reported


@pytest.mark.parametrize("verb", ["build", "model sweep"])
def test_the_commands_refuse_them_in_one_line(verb, tmp_path, capsys):
    (tmp_path / "finger.toml").write_text(
        FINGER.replace(core=1, layers=4, handles=900).to_toml(), encoding="utf-8"
    )
    assert (
        main(
            [
                *verb.split(),
                str(tmp_path / "finger.toml"),
                "--steps",
                "5",
                "--out",
                str(tmp_path / "out.npz"),
            ]
        )
        == 2
    )
    said = capsys.readouterr().err
    assert (
        "template.handles: 900" in said
        and said.count("\n") == 1
        and not (tmp_path / "out.npz").exists()
    )


def test_all_of_them_as_handles_register_as_before():
    cloud = MODEL.prior.evaluate(np.array([[4.0, -2.0]])).reshape(-1, 3)
    found, named = (
        register(model, [cloud], mode="paper")
        for model in (MODEL, replace(MODEL, handles=np.arange(len(MODEL.rest))))
    )
    np.testing.assert_array_equal(named.vertices, found.vertices)
    np.testing.assert_array_equal(named.support, found.support)


def test_only_handles_ask_for_the_cloud_and_the_others_go_along():
    """One point of a resting cloud is away from the surface: its vertex follows it if it is a
    handle, else not at all.
    """
    alone = int(np.argmin(np.linalg.norm(MODEL.rest - [12.0, 0.0, 60.0], axis=1)))
    cloud = MODEL.rest.copy()
    cloud[alone, 0] += 1.5
    others = replace(MODEL, handles=np.delete(np.arange(len(MODEL.rest)), alone))
    (handle,), (carried,) = (
        register(model, [cloud], mode="paper").vertices for model in (MODEL, others)
    )
    assert np.linalg.norm(handle - MODEL.rest, axis=1)[alone] > 0.3
    np.testing.assert_allclose(carried, MODEL.rest, atol=1e-9)


def test_a_few_carry_the_surface_and_are_all_that_is_seen():
    cloud = MODEL.prior.evaluate(np.array([[6.0, -4.0]])).reshape(-1, 3)
    few = replace(MODEL, handles=handles_of(FINGER.replace(handles=40), MODEL.rest))
    found = register(few, [cloud], mode="paper")
    assert found.frames[0]["rounds"] <= PAPER_ROUNDS and found.support.sum() == len(cloud)
    assert found.visible[0].sum() > 10 and set(np.flatnonzero(found.visible[0])) <= set(few.handles)
    moved = np.linalg.norm(found.vertices[0] - MODEL.rest, axis=1)
    rest = np.setdiff1d(np.flatnonzero(MODEL.rest[:, 2] > 80.0), few.handles)
    assert moved[rest].min() > 1.0
    # Each handle sits nearer to its point of the cloud than the others do to theirs.
    off = distances(found.vertices[0], cloud).min(axis=1)
    assert off[few.handles].mean() < off[np.setdiff1d(np.arange(len(cloud)), few.handles)].mean()
