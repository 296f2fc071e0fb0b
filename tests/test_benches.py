"""The peers of the benchmarks do the same work as the core: a ratio of different work would say nothing."""

import numpy as np

from benches.__main__ import nine_tendons
from benches.peer_elastic import markers
from benches.peer_newton import NumpySolid
from benches.peer_rollout import NUMBERS, backlash_and_creep
from softmap_edge import _core
from softmap_edge.solid.finger import Finger
from softmap_edge.solid.simulator import Simulator


def test_the_numpy_solid_takes_the_same_newton_step():
    finger = Finger.builtin()
    solid, mesh = Simulator(finger).solid, finger.solid.cells([95.0])
    peer = NumpySolid(mesh.nodes, mesh.cells, finger.young_mpa, finger.poisson, mesh.fixed)
    bent = mesh.nodes + 0.02 * np.sin(mesh.nodes / 7.0) * (mesh.nodes[:, 2:] / mesh.nodes[:, 2].max())
    ours, theirs = solid.newton_step(bent).ravel()[peer.free], peer.newton_step(bent)
    # Round-off of two factorisations of one matrix; the step itself is 0.02 mm.
    assert np.abs(ours).max() > 1e-3 and np.abs(ours - theirs).max() < 1e-10


def test_the_numpy_rollout_gives_the_same_records():
    t = np.arange(400) * 0.02
    u = 8 * np.sin(0.7 * t[:, None] + [0.0, 1.0])
    chain = _core.Chain(["backlash", "creep"], 2)
    params = np.stack([chain.start, 1.1 * np.asarray(chain.start)])
    at = {label: k for k, label in enumerate(chain.labels)}
    numbers = [params[:, at[name]].copy() for name in NUMBERS]
    ours, theirs = chain.rollout(params, u, t), backlash_and_creep(*numbers, u, t)
    assert np.abs(ours - u).max() > 0.1 and np.abs(ours - theirs).max() < 1e-9


def test_the_numpy_rod_bends_the_same_way():
    robot, _, u = nine_tendons()
    layout, start = robot.layout, robot.start.copy()
    start[layout.places()["tilt"]] = 0.05, -0.03
    for slack in (0.0, 0.3, 1.0):
        start[0] = slack
        ours, theirs = layout.compiled(start).evaluate(u), markers(start, layout.places(), layout.ends, u)
        # Equilibria within 1e-12 rad of 180 mm; the poses themselves differ by 100 mm.
        assert np.abs(ours - theirs).max() < 1e-6 and np.ptp(ours, axis=0).max() > 50
