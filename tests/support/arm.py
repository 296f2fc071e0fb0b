"""A small bending arm as a model: six markers on a table of a curve in closed form, and loads at
its tip.

The curve is no simulator's, so the statistics of a diagnosis are tested on a robot that nothing was
tuned to.
"""

from dataclasses import replace
from functools import cache

import numpy as np

from softmap_edge import _core
from softmap_edge.model.model import Model
from softmap_edge.model.structure import Structure
from softmap_edge.run.run import Run

SECTIONS, LENGTH, RADIUS = 6, 100.0, 10.0
# the candidates of these tests
NAMES = ["offset", "gain", "latency", "backlash", "creep", "payload", "mount"]
FIELDS = ("tip_force_x", "tip_force_y", "tip_force_z")
SAG = 0.05 / 9.80665e-3  # mm of the tip of the straight arm for each N across it: 0.05 mm/g


def curve(u):
    """The markers (n, 6, 3) mm of the arm at commands (n, 2) mm: an arc that bends towards the
    command.
    """
    s = (np.arange(SECTIONS) + 0.5) / SECTIONS
    size = np.linalg.norm(u, axis=1)[:, None]
    angle = size / (2 * RADIUS) * s + 1e-9
    unit = u / (size + 1e-12)
    side = LENGTH * s * (1 - np.cos(angle)) / angle
    return np.stack(
        [unit[:, :1] * side, unit[:, 1:] * side, LENGTH * s * np.sin(angle) / angle], axis=2
    )


def moved(u, axis):
    """Displacements (n, 6, 3) mm of the arm at commands (n, 2) mm for a force of 1 N on its tip
    along x, y or z.
    """
    s = (np.arange(SECTIONS) + 0.5) / SECTIONS
    size = np.linalg.norm(u, axis=1)[:, None]
    angle, unit = 0.7 * size / (2 * RADIUS) * s, u / (size + 1e-12)
    found = np.zeros((len(u), SECTIONS, 3))
    if axis < 2:
        found[..., axis] = SAG * s**2 * np.cos(angle)
        found[..., 2] = -0.5 * SAG * s**2 * np.sin(angle) * unit[:, axis : axis + 1]
    return found


def table(shapes):
    """A table of shapes (n, 6, 3) over commands of ±14 mm."""
    axis = np.linspace(-14.0, 14.0, 15)
    nodes = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    size = 3 * SECTIONS
    return _core.Table(
        [axis, axis], shapes(nodes).reshape(len(nodes), size), np.zeros(size), np.eye(size)
    )


@cache
def structure():
    fields = {name: table(lambda u, k=k: moved(u, k)) for k, name in enumerate(FIELDS)}
    return Structure(
        prior=table(curve),
        fields=fields,
        rest=curve(np.zeros((1, 2)))[0],
        triangles=np.zeros((0, 3), np.int32),
        tip_indices=np.array([SECTIONS - 1]),
        gravity_reference=np.array([1.0, 0.0, 0.0]),
        command_range=np.array([[-12.0, 12.0]] * 2),
    )


def arm(form=0.15, kind="table"):
    """The arm, which states an error of `form` mm a coordinate."""
    return Model(kind, structure(), np.full((SECTIONS, 3), form), form * np.sqrt(3.0), robot="arm")


def protocol(rng=None, minutes=4.0):
    """Triangles of growing size, loops at offsets, fast moves and dwells with home revisits: t
    (T,), u (T, 2).
    """
    dt, u = 0.1, []
    points = [
        (0, 0, 6),
        (8, 0, 4),
        (8, 0, 8),
        (-8, 0, 6),
        (0, 0, 3),
        (0, 0, 5),
        (0, 8, 3),
        (0, -8, 5),
        (0, 0, 3),
    ]
    points += [
        (0, 0, 5),
        (4, 4, 2),
        (4, 4, 6),
        (-4, -4, 2),
        (6, -6, 2),
        (6, -6, 6),
        (3, -3, 1),
        (5, -5, 1),
    ]
    points += [(0, 0, 3), (0, 0, 5)]
    points += [
        (10, 0, 1.2),
        (-10, 0, 1.2),
        (10, 0, 1.2),
        (0, 0, 1.2),
        (0, 10, 1.2),
        (0, -10, 1.2),
        (0, 10, 1.2),
    ]
    points += [
        (0, 0, 1.2),
        (0, 0, 6),
        (5, 7, 2),
        (5, 7, 8),
        (-6, 3, 2),
        (-6, 3, 6),
        (0, 0, 2),
        (0, 0, 6),
    ]
    if rng is not None:
        points = [
            (float(rng.uniform(-9, 9)), float(rng.uniform(-9, 9)), float(rng.uniform(1, 6)))
            for _ in range(30)
        ]
    while len(u) * dt < 60 * minutes:
        for x, y, seconds in points:
            last = np.array(u[-1] if u else (0.0, 0.0))
            steps = int(seconds / dt)
            u += [last + (np.array((x, y)) - last) * (k + 1) / steps for k in range(steps)]
    u = np.array(u[: int(60 * minutes / dt)], float)
    return np.arange(len(u)) * dt, u


def record_run(
    hidden=None, seed=0, noise=0.15, warp=0.1, t=None, u=None, frames=350, moving=True, other=False
):
    """A run of the arm with hidden effects `{label: value}`, camera noise and a smooth static error
    over commands.
    """
    rng = np.random.default_rng(seed)
    if t is None:
        t, u = protocol(np.random.default_rng(seed + 77) if other else None)
    t_seen = np.linspace(t[0] + 0.1, t[-1], frames) if moving is True else np.asarray(moving, float)
    run = Run(t=t, command=u, t_seen=t_seen, markers=curve(np.zeros((len(t_seen), 2))), robot="arm")
    hidden = hidden or {}
    clean = (
        arm().with_effects(tuple({label.split(".")[0] for label in hidden}), hidden).predict(run)
    )
    phase = u[np.searchsorted(t, t_seen, side="right") - 1] / 8.0
    body = (np.arange(SECTIONS) + 1) / SECTIONS
    draw = rng.normal(size=(3, 4))
    static = draw[:, 0] * np.sin(phase[:, :1]) + draw[:, 1] * np.cos(phase[:, 1:])
    static = static + draw[:, 2] * phase[:, :1] * phase[:, 1:]
    markers = (
        clean + warp * body[:, None] * static[:, None, :] + noise * rng.normal(size=clean.shape)
    )
    return replace(run, markers=markers)
