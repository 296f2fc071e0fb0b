"""The peers of the benchmarks do the same work as the core: a ratio of different work would say
nothing.
"""

import numpy as np
import pytest

from benches import geometry, inverse, level, network
from benches.__main__ import nine_tendons
from benches.peer_elastic import markers
from benches.peer_newton import NumpySolid
from benches.peer_rollout import EFFECTS, backlash_and_creep, numbers
from softmap_edge import _core
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Simulator
from softmap_edge.model.bundle import builtin_model


def test_the_numpy_solid_takes_the_same_newton_step():
    finger = Finger.builtin()
    solid, mesh = Simulator(finger).solid, finger.solid.cells([95.0])
    peer = NumpySolid(mesh.nodes, mesh.cells, finger.young_mpa, finger.poisson, mesh.fixed)
    bent = mesh.nodes + 0.02 * np.sin(mesh.nodes / 7.0) * (
        mesh.nodes[:, 2:] / mesh.nodes[:, 2].max()
    )
    ours, theirs = solid.newton_step(bent).ravel()[peer.free], peer.newton_step(bent)
    # Round-off of two factorisations of one matrix; the step itself is 0.02 mm.
    assert np.abs(ours).max() > 1e-3 and np.abs(ours - theirs).max() < 1e-10


def test_the_numpy_rollout_gives_the_same_records():
    t = np.arange(400) * 0.02
    u = 8 * np.sin(0.7 * t[:, None] + [0.0, 1.0])
    chain = _core.Chain(EFFECTS, 2)
    start = np.asarray(chain.start)
    # the last differs per channel
    params = np.stack([start, 1.1 * start, start * np.linspace(0.7, 1.3, len(start))])
    ours, theirs = chain.rollout(params, u, t), backlash_and_creep(*numbers(chain, params), u, t)
    assert np.abs(ours - u).max() > 0.1 and np.abs(ours - theirs).max() < 1e-9


def test_the_numpy_rod_bends_the_same_way():
    robot, _, u = nine_tendons()
    layout, start = robot.layout, robot.start.copy()
    start[layout.places()["tilt"]] = 0.05, -0.03
    for slack in (0.0, 0.3, 1.0):
        start[0] = slack
        ours, theirs = (
            layout.compiled(start).evaluate(u),
            markers(start, layout.places(), layout.ends, u),
        )
        # Equilibria within 1e-12 rad of 180 mm; the poses themselves differ by 100 mm.
        assert np.abs(ours - theirs).max() < 1e-6 and np.ptp(ours, axis=0).max() > 50


@pytest.mark.long
def test_the_quick_rows_of_geometry_are_there_and_keep_what_does_not_hang_on_the_machine():
    found = {(row["name"], row.get("peer_name")): row for row in geometry.rows(quick=True)}
    assert len(found) == 5 and all(
        row["value"] > 0 and row["wanted"].startswith("goal") for row in found.values()
    )
    (torch,) = (row for (_, peer), row in found.items() if peer and peer.startswith("torch"))
    assert torch["ratio"] > 5  # 50 is promised of a quiet machine (`make bench`)
    (laid,) = (row for (name, _), row in found.items() if name.startswith("registration"))
    assert laid["error_mm"] <= 0.45


@pytest.mark.long
def test_the_rows_of_the_network_keep_what_does_not_hang_on_the_machine(monkeypatch):
    """Each row refuses to time what is not the same work; speeds are promised of a quiet machine
    (`make bench`).
    """
    monkeypatch.setattr("benches.row.REPEATS", 3)
    found = {
        (row["name"], row.get("peer_name")): row
        for row in [*network.rows(), *inverse.rows(waypoints=40)]
    }
    assert len(found) == 9 and all(
        row["value"] == row["value"] and row["wanted"] for row in found.values()
    )
    (above,) = (row for (name, _), row in found.items() if "above that of the paper's way" in name)
    assert above["value"] <= 2e-5
    (paper,) = (row for (_, peer), row in found.items() if peer == "the paper's way")
    assert paper["ratio"] > 3  # its looks are 15 times as many, whatever the machine


def test_cut_triangles_keep_the_surface_and_their_sides():
    model = builtin_model()
    vertices, triangles = geometry.halved(model.rest, np.asarray(model.triangles))
    assert vertices.shape == (2186, 3) and triangles.shape == (4 * 1092, 3)

    def normals(points, corners):
        a, b, c = points[corners].transpose(1, 0, 2)
        return 0.5 * np.cross(b - a, c - a)

    whole, quarters = normals(model.rest, np.asarray(model.triangles)), normals(vertices, triangles)
    np.testing.assert_allclose(
        quarters.reshape(4, -1, 3), np.broadcast_to(whole / 4, (4, 1092, 3)), atol=1e-12
    )


def test_a_peer_that_did_other_work_is_not_timed():
    with pytest.raises(RuntimeError, match="differ by 0.5"):
        geometry.same("steps", np.zeros(3), np.array([0.0, 0.5, 0.0]), 0.1)
    with pytest.raises(RuntimeError):
        geometry.same("steps", np.zeros(3), np.array([0.0, np.nan, 0.0]), 0.1)


def test_the_numpy_level_gives_the_same_losses(monkeypatch):
    monkeypatch.setattr("benches.row.REPEATS", 1)
    made = level.made(frames=80, modes=4, fields=3)
    ours, names = made.level(), list(made.columns)
    ours.close(made.residual)
    losses = []
    for train, test in made.grams():
        n = len(train) - 1
        ridge = level.RIDGE + 1e-9 * np.trace(train[:n, :n]) / n
        theta = np.linalg.solve(train[:n, :n] + ridge * np.eye(n), train[:n, n])
        losses.append(test[n, n] - 2 * theta @ test[:n, n] + theta @ test[:n, :n] @ theta)
    # The core skips pairs below 1e-4 (rust/families/gram.rs).
    np.testing.assert_allclose(ours.losses(names, [level.RIDGE] * len(names)), losses, rtol=1e-3)
    (row,) = level.rows(made)
    assert row["value"] > 0 and row["peer"] > 0 and f"{made.count} columns" in row["name"]
