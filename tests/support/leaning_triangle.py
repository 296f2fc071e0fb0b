"""Small models of a leaning tube and recordings of them, for comparisons and reports."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np

from softmap_edge.run.run import Run

RINGS, AROUND = 5, 8


def tube():
    angle = np.arange(AROUND) * 2 * np.pi / AROUND
    ring = np.column_stack([10 * np.cos(angle), 10 * np.sin(angle), np.zeros(AROUND)])
    rest = np.concatenate([ring + [0, 0, 25.0 * k] for k in range(RINGS)])
    a, b = np.meshgrid(np.arange(RINGS - 1), np.arange(AROUND), indexing="ij")
    p, q = (a * AROUND + b).ravel(), (a * AROUND + (b + 1) % AROUND).ravel()
    return rest, np.concatenate([np.column_stack([p, q, p + AROUND]), np.column_stack([q, q + AROUND, p + AROUND])])


def shapes(rest, u):
    """A tube that leans by its command: an exact stand-in for a prior, (K, N, 3)."""
    lean = (rest[:, 2] / 100.0) ** 2
    move = np.zeros((len(u), len(rest), 3))
    move[..., :2] = u[:, None, :] * lean[None, :, None]
    return rest + move


@dataclass
class Lean:
    """A model with the face that `compare` uses, and an error put in by hand."""

    rest: np.ndarray
    triangles: np.ndarray
    tip_indices: np.ndarray
    sections: np.ndarray
    error: object = None
    robot: str = "tube"
    command_unit: str = "mm"
    chain_names: tuple = ()
    params: dict = field(default_factory=dict)
    arrays: dict = field(default_factory=dict)
    calibration: object = None
    output: object = None

    @property
    def markers(self):
        return len(self.triangles) == 0

    @property
    def structure(self):
        return self

    @property
    def arc_length(self):
        return self.rest[:, 2]

    def commands(self, run):
        return run.command

    def points_in_mm(self, run):
        return run.vertices if run.vertices is not None else run.markers

    def predict(self, run):
        u = np.stack([np.interp(run.t_seen, run.t, c) for c in run.command.T], axis=1)
        points = shapes(self.rest, u)
        return points if self.error is None else points + self.error(run, points)


def lean(error=None):
    rest, triangles = tube()
    return Lean(rest, triangles, np.arange(4 * AROUND, 5 * AROUND), np.repeat(np.arange(RINGS), AROUND), error)


class Recording(SimpleNamespace):
    """A run that tests may bend in ways that `Run` refuses."""

    hash = Run.hash
    extra = {}
    output, timeless = None, False

    def arrays(self):
        return {name: np.asarray(value) for name, value in vars(self).items() if value is not None}


def record(t, u, t_seen, noise=0.0, seed=0, **more):
    rest, _ = tube()
    at = np.stack([np.interp(t_seen, t, c) for c in u.T], axis=1)
    vertices = shapes(rest, at) + noise * np.random.default_rng(seed).normal(size=(len(t_seen), len(rest), 3))
    return Recording(
        **{"t": t, "command": u, "t_seen": t_seen, "vertices": vertices, "markers": None, "visible": None}
        | {"gravity": None, "temperature": None, "robot": "tube"}
        | more
    )


def triangle(noise=0.0, seed=0, **more):
    """u1: up to 10 mm in 5 s, 5 s dwell, down to −10 mm in 10 s, 5 s dwell; u2 still."""
    t = np.arange(0, 25.0001, 0.02)
    u1 = np.interp(t, [0, 5, 10, 20, 25], [0, 10, 10, -10, -10])
    return record(t, np.column_stack([u1, 0 * t]), np.arange(0.0, 25.0, 0.1), noise, seed, **more)
