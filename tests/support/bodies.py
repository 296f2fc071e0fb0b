"""A record, a finger and a rod in plain NumPy: what laws.py acts on in the tests of effects and
predictor.
"""

import numpy as np

from softmap_edge import _core

HOME = np.array([0.0, 0.0, 1.0])


def record(channels, seed=0, samples=900, rate=30.0):
    """Moves with dwells and home revisits, at jittered times: t (T,) s, u (T, C) mm."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.5, 1.5, samples) / rate)
    knots = np.arange(0.0, t[-1] + 3.0, 1.5)
    targets = rng.uniform(-12.0, 12.0, (len(knots), channels))
    targets[::5] = 0.0
    targets[1::4] = targets[0::4][: len(targets[1::4])]  # dwells
    return t, np.array([np.interp(t, knots, column) for column in targets.T]).reshape(
        channels, samples
    ).T


def protocol():
    """Three minutes as one would record them: fast triangles, then a staircase with dwells of 15 s;
    t, u (T, 2).
    """
    t = np.arange(0.0, 180.0, 1 / 30)
    fast = 12.0 * (2 / np.pi) * np.arcsin(np.sin(np.outer(t, [1.3, 0.9])))
    steps = np.array(
        [[0, 0], [8, 0], [12, 4], [10, 10], [4, 12], [0, 9], [6, 6], [12, 0], [3, 3], [0, 0]], float
    )
    moment = np.clip((t - 40.0) / 15.0, 0.0, len(steps) - 1.001)
    # moves for 1.5 s, then dwells
    position = np.floor(moment) + np.clip(10.0 * (moment % 1.0), 0.0, 1.0)
    staircase = np.stack(
        [np.interp(position, np.arange(len(steps)), column) for column in steps.T], axis=1
    )
    return t, np.where((t < 40.0)[:, None], fast, staircase)


def turning(samples, seed=1):
    """Unit vectors (T, 3) that turn slowly from hanging towards horizontal and back."""
    angle = np.linspace(0.0, np.pi, samples)
    lean = 1.3 * np.sin(angle)
    return np.stack(
        [np.sin(lean) * np.cos(seed), np.sin(lean) * np.sin(seed), np.cos(lean)], axis=1
    )


def warming(t):
    """Temperature (T,) °C of a body that warms up."""
    return 22.0 + 9.0 * (1.0 - np.exp(-np.asarray(t) / 40.0))


def camera(place, target, up=(0.0, 0.0, 1.0)):
    """The pose (3, 4) [R | t] of a camera at a place that looks at another, both (3,) mm in the
    base frame.
    """
    z = np.subtract(target, place) / np.linalg.norm(np.subtract(target, place))
    x = np.cross(z, up) / np.linalg.norm(np.cross(z, up))
    turn = np.stack([x, np.cross(z, x), z])
    return np.column_stack([turn, -turn @ place])


CAMERAS = np.stack(
    [camera([180.0, 30.0, 50.0], [0, 0, 20.0]), camera([-40.0, 170.0, 70.0], [0, 10.0, 30.0])]
)
SECTIONS = np.linspace(0.0, 100.0, 9)


def finger(u):
    """Centroids (n, 27) mm of nine sections of a finger that bends 5 degrees a millimetre, without
    twist.
    """
    bend = np.deg2rad(5.0) * np.linalg.norm(u, axis=1)
    heading = u / np.maximum(np.linalg.norm(u, axis=1), 1e-12)[:, None]
    angle = bend[:, None] * SECTIONS / 100.0
    out = SECTIONS * 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * angle  # s (1 − cos a) / a
    up = SECTIONS * np.sinc(angle / np.pi)
    return np.stack([heading[:, :1] * out, heading[:, 1:] * out, up], axis=2).reshape(len(u), -1)


def tabulated(values):
    """A table over ±20 mm of a family given as a function of commands (n, 2)."""
    axis = np.linspace(-20.0, 20.0, 21)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=2).reshape(-1, 2)
    nodes = values(grid)
    mean = nodes.mean(axis=0)
    left, size, modes = np.linalg.svd(nodes - mean, full_matrices=False)
    keep = max(1, int((size > 1e-9 * max(size[0], 1.0)).sum()))
    return _core.Table([axis, axis], left[:, :keep] * size[:keep], mean, modes[:keep])


def field(direction, tip):
    """Displacement (n, 27) that grows with the square along the body, `tip` mm at the tip, less
    when bent.
    """
    shape = tip * (SECTIONS / 100.0)[:, None] ** 2 * np.asarray(direction)

    def values(u):
        return (1.0 - 2e-4 * (u**2).sum(axis=1))[:, None] * shape.ravel()

    return values


def bent(direction, profile):
    """Displacement (n, 27): `direction` of commands (n, 2) → (n, 2 or 3) mm, times a number for
    each section.
    """

    def values(u):
        aside = np.zeros((len(u), 3))
        towards = direction(u)
        aside[:, : towards.shape[1]] = towards
        return (profile[None, :, None] * aside[:, None, :]).reshape(len(u), -1)

    return values


SHARE = SECTIONS / SECTIONS[-1]
MIDDLES = np.linspace(0.0, 1.0, 7)  # of the stretches of the fields stiff_0 … stiff_6
OBSTACLE = ("present", "q_x", "q_y", "q_z", "n_x", "n_y", "n_z", "curvature")
# of the cables that each command pulls
SIDES = [f"compliance_{c}{side}" for c in range(3) for side in "+-"]
COEFFICIENTS = [*_core.FIELDS, *SIDES, *OBSTACLE]

# Tip displacements per g and per N as the simulator finds them: 1 g lateral 3.5 mm, 20 g at the tip
# 3.2 mm.
FIELD_VALUES = {
    name: field(
        np.eye(3)["xyz".index(name[-1])],
        (3.5 if name[0] == "g" else 16.0) * (0.1 if name[-1] == "z" else 1.0),
    )
    for name in _core.LOADS
}
# A stretch that is stiffer bends less, and the rest makes up for four fifths of it.
FIELD_VALUES |= {
    f"stiff_{k}": bent(
        lambda u: -3.0 * u, np.maximum(SHARE - middle, 0.0) - 0.8 * SHARE * (1.0 - middle)
    )
    for k, middle in enumerate(MIDDLES)
}
FIELD_VALUES |= {
    "stiff_x": bent(lambda u: np.linalg.norm(u, axis=1)[:, None] * [[0.3, 0.0]], SHARE**2),
    "stiff_y": bent(lambda u: np.linalg.norm(u, axis=1)[:, None] * [[0.0, 0.3]], SHARE**2),
    "curve_x": field([1.0, 0.0, 0.0], 1.0),
    "curve_y": field([0.0, 1.0, 0.0], 1.0),
    "twist": bent(lambda u: 0.04 * u[:, ::-1] * [[-1.0, 1.0]], SHARE**3),
    "routing_0": bent(lambda u: 0.09 * u[:, :1] * [[0.0, 1.0]], SHARE**2),
    "routing_1": bent(lambda u: 0.09 * u[:, 1:] * [[-1.0, 0.0]], SHARE**2),
}


def cantilever(at):
    """Deflection along a beam that a force at a share of its length bends; 1 at the tip for one at
    the tip.
    """
    return np.where(at > SHARE, SHARE**2 * (3 * at - SHARE), at**2 * (3 * SHARE - at)) / 2


def pushing(axis, at):
    way = 16.0 * np.eye(3)["xyz".index(axis)] * (0.1 if axis == "z" else 1.0)
    return bent(lambda u: np.tile(way, (len(u), 1)), cantilever(at))


FIELD_VALUES |= {
    f"push_{k}_{a}": pushing(a, at) for k, at in enumerate(_core.STATIONS[:3]) for a in "xyz"
}
FIELD_VALUES |= {f"tip_force_{a}": pushing(a, 1.0) for a in "xyz"}
FIELD_VALUES = {name: FIELD_VALUES[name] for name in _core.FIELDS if name in FIELD_VALUES}

# Two pairs of tendons that are commanded u, 0.09 mm for each mm, and get 0.1 mm shorter for each N; no
# load changes their length.
CABLE, SHORTER, COMMANDED = 20.0, 0.1, 0.09
TENSION_VALUES = [
    field([*side, 0.0], 3.0) for side in ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
]


def pulls(u):
    """Pull (n, 4) N of the tendons, below zero how slack they are."""
    wound = COMMANDED * np.concatenate([u, -u], axis=1)
    return np.where(wound > 0.0, wound / (1.0 / CABLE + SHORTER), CABLE * wound)


def lost(compliance, u):
    """Change of the tensions (n, 4) N with so many mm/N more of every tendon: its length is shared
    out again.
    """
    before = np.maximum(pulls(u), 0.0)
    own = 1.0 / CABLE + SHORTER
    return before * own / (own + compliance) - before


def cables():
    """The tendons of that finger."""
    stretch = np.hstack([np.zeros((4, len(_core.FIELDS))), -SHORTER * np.eye(4)]).ravel()
    still = _core.Table(
        [[-20.0, 20.0]] * 2, np.tile(stretch, (4, 1)), np.zeros(stretch.size), np.eye(stretch.size)
    )
    fields = [tabulated(values) for values in TENSION_VALUES]
    return _core.Cables(np.full(4, CABLE), tabulated(pulls), still, fields)


STATIONS, GIRTH = [3, 5, 6, 8], 5.0  # sections that an obstacle can stop, and their radius mm


def stations():
    """What `_core.Predictor` takes for contact: the middles of these sections and how they move."""
    matrix, zero = np.zeros((27, 12)), np.zeros(12)
    for k, section in enumerate(STATIONS):
        matrix[3 * section : 3 * section + 3, 3 * k : 3 * k + 3] = np.eye(3)
    moved = {name: tabulated(values).project(matrix, zero) for name, values in FIELD_VALUES.items()}
    return (
        tabulated(finger).project(matrix, zero),
        moved,
        cables().project(matrix, zero),
        None,
        [GIRTH] * 4,
    )


def stopped(row, frames, u):
    """What an obstacle (coefficients from `present` on) adds to frames (n, 27): the one set of
    pushed stations that leaves no gap negative and no push either, found by trying all.
    """
    _, q, n, curvature = row[0], row[1:4], row[4:7], row[7]
    pushes = np.stack(
        [tabulated(FIELD_VALUES[f"push_{k}_{a}"]).evaluate(u) for k in range(3) for a in "xyz"],
        axis=1,
    )
    tip = np.stack([tabulated(FIELD_VALUES[f"tip_force_{a}"]).evaluate(u) for a in "xyz"], axis=1)
    unit = np.concatenate([pushes, tip], axis=1).reshape(len(u), 4, 3, 27)
    out = np.zeros_like(frames)
    for frame, units, more in zip(frames, unit, out):
        places = frame.reshape(9, 3)[STATIONS]
        if curvature > 0:
            away = places - (q - n / curvature)
            gaps = np.linalg.norm(away, axis=1) - 1 / curvature - GIRTH
            normals = away / np.linalg.norm(away, axis=1)[:, None]
        else:
            gaps, normals = (places - q) @ n - GIRTH, np.tile(n, (4, 1))
        by = np.einsum("ka,kam->km", normals, units)  # per newton on each station
        matrix = np.einsum("ia,kia->ik", normals, by.reshape(4, 9, 3)[:, STATIONS])
        for pushed in range(16):
            on = np.array([(pushed >> k) % 2 == 1 for k in range(4)])
            force = np.zeros(4)
            if on.any():
                force[on] = np.linalg.solve(matrix[np.ix_(on, on)], -gaps[on])
            if (force >= 0).all() and (gaps + matrix @ force >= -1e-9).all():
                more += force @ by
                break
        else:
            raise AssertionError("no set of stations answers")
    return out


def finger_body(positions=None):
    """A predictor of that finger with fields and tendons, solved hanging; `positions` (9,) as in
    _core.Predictor.
    """
    fields = {name: tabulated(values) for name, values in FIELD_VALUES.items()}
    return _core.Predictor(
        tabulated(finger),
        fields,
        np.ones(9, bool) if positions is None else positions,
        HOME,
        cables(),
        contact=stations(),
    )


TENDONS = np.array([[5.0, 0.0], [0.0, 5.0], [-5.0, 0.0], [0.0, -5.0]])  # radius and side, mm
BENDING = 20.0  # bending stiffness of a segment over that of a tendon, mm²


def rod_body(slack=1.0):
    """A predictor of an elastic rod of two halves and four tendons, all along it, that push as they
    pull or less.
    """
    angle, radius = np.arctan2(TENDONS[:, 1], TENDONS[:, 0]), np.linalg.norm(TENDONS, axis=1)
    numbers = [
        [slack],
        angle,
        radius,
        np.zeros(4),
        [BENDING] * 2,
        [50.0] * 2,
        np.zeros(4),
        np.zeros(3),
        np.zeros(2),
    ]
    pulls = [1, 1, 1, 1], [0, 1, 0, 1], [1.0, 1.0, -1.0, -1.0]
    rod = _core.ElasticRod(
        2, 2, *pulls, list(np.linspace(0.0, 2.0, 10)[1:]), np.concatenate(numbers)
    )
    fields = {name: _core.ElasticField(rod, name, 1.0) for name in _core.LOADS}
    return _core.Predictor(rod, fields, np.ones(9, bool), HOME)
