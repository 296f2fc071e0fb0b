"""What a user of two depth cameras sees, and the model's template fitted to it.

The clouds are noisy, with a hole and outliers.

Two cameras 90° apart stand somewhere around the finger for the whole case. Every second frame of a
long protocol is seen: laying a template onto a cloud takes 60 ms. Units: mm, degrees. Randomness
only from the seed that is given. Pinned by tests/benches/test_bank.py.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from softmap_edge.alignment.register import register
from softmap_edge.model.model import Model
from softmap_edge.run.protocol import Protocol
from softmap_edge.run.run import Run
from softmap_edge.synthetic.depth_camera import TWO

CAMERAS = replace(TWO, points=3000, hole_mm=10.0)  # 0.5 mm a coordinate, 5 % outliers
LONG = 200  # frames of a protocol above which every second is left out


def thinned(protocol: Protocol) -> Protocol:
    """Return a protocol of which clouds are taken."""
    every = 1 + int(protocol.frames > LONG)
    return replace(protocol, t_seen=protocol.t_seen[::every], block=protocol.block[::every])


def registered(model: Model, run: Run, seed: int) -> Run:
    """Return a run of true vertices as registration finds them in clouds.

    It has `visible`, `sigma`, and the roll not seen.
    """
    rng = np.random.default_rng([seed, run.frames, 6])
    view = float(rng.uniform(0.0, 360.0))
    cameras = replace(CAMERAS, views=(view, view + 90.0))
    clouds = [
        cameras.look(np.asarray(shape, float), model.triangles, rng) for shape in run.seen_points
    ]
    points, start = np.concatenate(clouds), np.cumsum([0, *map(len, clouds)])
    seen = replace(run, vertices=None, visible=None, points=points, start=start)
    return register(model, seen).run(seen)
