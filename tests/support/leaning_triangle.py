"""A model of a leaning tube with an error put in by hand, and recordings of it, for comparisons and
reports.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from softmap_edge import _core
from softmap_edge.geometry.sections import BodyCoordinates
from softmap_edge.model.model import Model
from softmap_edge.model.structure import Structure
from softmap_edge.run.run import Run

RINGS, AROUND = 5, 8
REACH = 12.0  # mm of each command


def tube():
    angle = np.arange(AROUND) * 2 * np.pi / AROUND
    ring = np.column_stack([10 * np.cos(angle), 10 * np.sin(angle), np.zeros(AROUND)])
    rest = np.concatenate([ring + [0, 0, 25.0 * k] for k in range(RINGS)])
    a, b = np.meshgrid(np.arange(RINGS - 1), np.arange(AROUND), indexing="ij")
    p, q = (a * AROUND + b).ravel(), (a * AROUND + (b + 1) % AROUND).ravel()
    return rest, np.concatenate(
        [np.column_stack([p, q, p + AROUND]), np.column_stack([q, q + AROUND, p + AROUND])]
    )


def shapes(rest, u):
    """The points (K, N, 3) mm of a tube that leans by its command."""
    lean = (rest[:, 2] / 100.0) ** 2
    move = np.zeros((len(u), len(rest), 3))
    move[..., :2] = u[:, None, :] * lean[None, :, None]
    return rest + move


@dataclass(frozen=True, eq=False)
class Wrong(Model):
    """A model that errs by `error(run, points)` mm."""

    error: Callable | None = None

    def predict(self, run):
        points = super().predict(run)
        return points if self.error is None else points + self.error(run, points)


def lean(error=None):
    rest, triangles = tube()
    ends = np.array([-REACH, REACH])
    # linear in the commands
    modes = np.stack([(shapes(rest, one[None])[0] - rest).ravel() for one in np.eye(2)])
    nodes = np.stack(np.meshgrid(ends, ends, indexing="ij"), axis=-1).reshape(-1, 2)
    structure = Structure(
        prior=_core.Table([ends, ends], nodes, rest.ravel(), modes),
        fields={},
        rest=rest,
        triangles=triangles.astype(np.int32),
        tip_indices=np.arange(4 * AROUND, 5 * AROUND),
        gravity_reference=np.array([0.0, 0.0, 1.0]),
        command_range=np.array([[-REACH, REACH]] * 2),
        body=BodyCoordinates(
            np.repeat(np.arange(RINGS), AROUND), rest[:, 2], np.arctan2(rest[:, 1], rest[:, 0])
        ),
    )
    return Wrong("table", structure, np.full((3 * RINGS, 3), 0.1), 0.1, robot="tube", error=error)


def markers_of(model):
    """The same without a template: its points are markers."""
    return model.with_structure(triangles=np.zeros((0, 3), np.int32), body=None)


def record(t, u, t_seen, noise=0.0, seed=0, **more):
    rest, _ = tube()
    at = np.stack([np.interp(t_seen, t, c) for c in u.T], axis=1)
    vertices = shapes(rest, at) + noise * np.random.default_rng(seed).normal(
        size=(len(t_seen), len(rest), 3)
    )
    return replace(Run(t=t, command=u, t_seen=t_seen, vertices=vertices, robot="tube"), **more)


def triangle(noise=0.0, seed=0, **more):
    """u1: up to 10 mm in 5 s, 5 s dwell, down to −10 mm in 10 s, 5 s dwell; u2 still."""
    t = np.arange(0, 25.0001, 0.02)
    u1 = np.interp(t, [0, 5, 10, 20, 25], [0, 10, 10, -10, -10])
    return record(t, np.column_stack([u1, 0 * t]), np.arange(0.0, 25.0, 0.1), noise, seed, **more)
