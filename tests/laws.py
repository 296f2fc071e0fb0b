"""A record, a finger and every effect's law in plain NumPy: what the tests of effects and predictor compare with."""

from itertools import combinations

import numpy as np

from softmap_edge import _core

EFFECTS = {effect["name"]: effect for effect in _core.effects()}
BY_ROLE = {role: [n for n, e in EFFECTS.items() if e["role"] == role] for role in ("channel", "shape", "sensing")}
HOME = np.array([0.0, 0.0, 1.0])


# --- a record and a finger -----------------------------------------------------------------------------------------


def record(channels, seed=0, samples=900, rate=30.0):
    """Moves with dwells and home revisits, at jittered times: t (T,) s, u (T, C) mm."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.5, 1.5, samples) / rate)
    knots = np.arange(0.0, t[-1] + 3.0, 1.5)
    targets = rng.uniform(-12.0, 12.0, (len(knots), channels))
    targets[::5] = 0.0
    targets[1::4] = targets[0::4][: len(targets[1::4])]  # dwells
    return t, np.array([np.interp(t, knots, column) for column in targets.T]).reshape(channels, samples).T


def protocol():
    """Three minutes as one would record them: fast triangles, then a staircase with dwells of 15 s; t, u (T, 2)."""
    t = np.arange(0.0, 180.0, 1 / 30)
    fast = 12.0 * (2 / np.pi) * np.arcsin(np.sin(np.outer(t, [1.3, 0.9])))
    steps = np.array([[0, 0], [8, 0], [12, 4], [10, 10], [4, 12], [0, 9], [6, 6], [12, 0], [3, 3], [0, 0]], float)
    moment = np.clip((t - 40.0) / 15.0, 0.0, len(steps) - 1.001)
    position = np.floor(moment) + np.clip(10.0 * (moment % 1.0), 0.0, 1.0)  # moves for 1.5 s, then dwells
    staircase = np.stack([np.interp(position, np.arange(len(steps)), column) for column in steps.T], axis=1)
    return t, np.where((t < 40.0)[:, None], fast, staircase)


def turning(samples, seed=1):
    """Unit vectors (T, 3) that turn slowly from hanging towards horizontal and back."""
    angle = np.linspace(0.0, np.pi, samples)
    lean = 1.3 * np.sin(angle)
    return np.stack([np.sin(lean) * np.cos(seed), np.sin(lean) * np.sin(seed), np.cos(lean)], axis=1)


def warming(t):
    """Temperature (T,) °C of a body that warms up."""
    return 22.0 + 9.0 * (1.0 - np.exp(-np.asarray(t) / 40.0))


SECTIONS = np.linspace(0.0, 100.0, 9)


def finger(u):
    """Centroids (n, 27) mm of nine sections of a finger that bends 5 degrees a millimetre, without twist."""
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
    """Displacement (n, 27) that grows with the square along the body, `tip` mm at the tip, less when bent."""
    shape = tip * (SECTIONS / 100.0)[:, None] ** 2 * np.asarray(direction)

    def values(u):
        return (1.0 - 2e-4 * (u**2).sum(axis=1))[:, None] * shape.ravel()

    return values


# Tip displacements per g and per N as the simulator finds them: 1 g lateral 3.5 mm, 20 g at the tip 3.2 mm.
FIELD_VALUES = {
    name: field(np.eye(3)["xyz".index(name[-1])], (3.5 if name[0] == "g" else 16.0) * (0.1 if name[-1] == "z" else 1.0))
    for name in _core.FIELDS
}


def finger_body(positions=None):
    """A predictor of that finger with all its fields, solved hanging; `positions` (9,) as in _core.Predictor."""
    fields = {name: tabulated(values) for name, values in FIELD_VALUES.items()}
    return _core.Predictor(tabulated(finger), fields, np.ones(9, bool) if positions is None else positions, HOME)


def values(chain, kind):
    """Null, start or mid-range parameters (P,) of a chain; mid-range is halfway from null to high."""
    return {"null": chain.null, "start": chain.start, "middle": 0.5 * (chain.null + chain.high)}[kind]


def random_params(chain, seed):
    """Parameters (P,) drawn between low and high, on a log scale where a fit searches on one."""
    share = np.random.default_rng(seed).uniform(size=len(chain.low))
    ratio = np.where(chain.log, chain.high / np.where(chain.log, chain.low, 1.0), 1.0)
    return np.where(chain.log, chain.low * ratio**share, chain.low + share * (chain.high - chain.low))


# --- the oracles: the same laws in another form ----------------------------------------------------------------------


def relaxed(u, t, tau):
    """First-order low pass of piecewise linear u by superposing the response to every piece (Duhamel)."""
    if tau <= 0:
        return u
    slope = np.diff(u, axis=0) / np.diff(t)[:, None]
    out = u.copy()
    for k in range(1, len(t)):
        missing = np.exp(-(t[k] - t[1 : k + 1]) / tau) - np.exp(-(t[k] - t[:k]) / tau)
        out[k] -= tau * missing @ slope[:k]
    return out


def slot(u, half):
    """A pin u (T,) in a slot of half-width `half`: the slot's centre, which starts under the pin."""
    centre, out = u[0], []
    for pin in u:
        if pin - centre > half:
            centre = pin - half
        elif centre - pin > half:
            centre = pin + half
        out.append(centre)
    return np.array(out)


def played(u, half):
    return np.stack([slot(column, half) for column in u.T], axis=1)


def delayed(p, u, t):
    return np.stack([np.interp(t - p["delay"], t, column) for column in u.T], axis=1)


def prandtl_ishlinskii(p, u, t):
    """What a stop holds back is what its play lets slip: stop = identity − play."""
    held = [u - played(u, p["reach"] * share) for share in (0.25, 0.5, 0.75, 1.0)]
    return u - p["strength"] * np.mean(held, axis=0)


def swapped(p, u, t):
    """Signed permutation matrices, listed."""
    eye = np.eye(u.shape[1])
    far = combinations(range(len(eye)), 2)
    pairs = [(i, j) for i, j in far if len(eye) <= 9 or j == i + 1]
    signs = [np.diag(1.0 - 2.0 * row) for row in eye]
    swaps = [eye[[j if k == i else i if k == j else k for k in range(len(eye))]] for i, j in pairs]
    return u @ [eye, *signs, *swaps][int(np.floor(p["case"] + 0.5))].T


def followed(speed):
    """A follower, from event to event: it meets its command, or the sample ends."""

    def law(p, u, t):
        out = u.copy()
        for c in range(u.shape[1]):
            x = u[0, c]
            for k in range(1, len(t)):
                at, left = u[k - 1, c], t[k] - t[k - 1]
                slope = (u[k, c] - at) / left
                while left > 0:
                    if abs(at - x) > 1e-12:
                        move = p[speed] * np.sign(at - x)
                        closing = abs(move) - slope * np.sign(move)
                        meet = abs(at - x) / closing if closing > 0 else np.inf
                    else:
                        move, meet = np.clip(slope, -p[speed], p[speed]), np.inf
                    span = min(meet, left)
                    x, at, left = x + move * span, at + slope * span, left - span
                    x = at if span == meet else x
                out[k, c] = x
        return out

    return law


def eccentric(p, u, t):
    size, phase = np.hypot(p["sine"], p["cosine"]), np.arctan2(p["cosine"], p["sine"])
    return u + size * (np.sin(u / p["radius"] + phase) - np.sin(phase))


def turned(p, u, t):
    """The pull as a complex number; of three tendons, the shortenings that make the turned pull with the same mean."""
    turn = np.exp(1j * np.deg2rad(p["phase"]))
    if u.shape[1] == 2:
        pull = (u[:, 0] + 1j * u[:, 1]) * turn
        return np.stack([pull.real, pull.imag], axis=1)
    if u.shape[1] != 3:
        return u
    tendons = np.exp(2j * np.pi * np.arange(3) / 3)
    system = np.array([tendons.real, tendons.imag, np.ones(3)])
    pull = (u @ tendons) * turn
    return np.linalg.solve(system, np.array([pull.real, pull.imag, u.sum(axis=1)])).T


def rubbed(p, u, t):
    """Five beads on the tendon, each dragged along once the pull leaves its own play."""
    beads, out = np.tile(u[0], (5, 1)), []
    for pull in u:
        for j, bead in enumerate(beads):
            width = p["mu"] * (2 * j + 1) / 10 * (np.abs(pull) + p["preload"])
            bead[:] = np.where(bead > pull + width, pull + width, np.where(bead < pull - width, pull - width, bead))
        out.append(beads.mean(axis=0))
    return np.array(out)


def broken_in(p, u, t):
    size = np.abs(u)
    below = np.maximum.accumulate(size, axis=0) - size
    return u + u * p["softening"] * (1.0 - np.exp(-below / p["reach"]))


def slipped(p, u, t):
    half = 0.5 * p["width"] * p["at"]
    return u + np.interp(t - t[0], [p["at"] - half, p["at"] + half], [0.0, 1.0])[:, None] * p["slip"]


def turn(axis, degrees):
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def gravity_coefficients(p, gravity):
    actual = (1 + p["density"]) * gravity @ (turn(1, p["tilt_y"]) @ turn(0, p["tilt_x"])).T
    return np.hstack([actual - gravity, np.zeros_like(gravity)])


def payload_coefficients(p, gravity):
    return np.hstack([np.zeros_like(gravity), p["mass"] / 1000 * 9.80665 * gravity])


def moved(p, frames, positions):
    """The turn as the exponential series of its cross-product matrix."""
    x, y, z = np.deg2rad([p["turn_x"], p["turn_y"], p["turn_z"]])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix, term = np.eye(3), np.eye(3)
    for n in range(1, 30):
        term = term @ cross / n
        matrix = matrix + term
    return frames @ matrix.T + positions[:, None] * np.array([p["shift_x"], p["shift_y"], p["shift_z"]])


# Sensing effects change how one sees: `see(t)` gives the frames (K, V, 3) at any times, before and after.


def drifted(p, see, positions, t):
    frames, minutes = see(t), (t - t[0]) / 60.0
    return np.stack([moved({k: v * m for k, v in p.items()}, f, positions) for f, m in zip(frames, minutes)])


ORACLES = {
    "servo_swap": swapped,
    "saturation": lambda p, u, t: np.clip(u, -p["below"], p["above"]),
    "offset": lambda p, u, t: u + p["shift"],
    "gain": lambda p, u, t: u * p["factor"],
    "latency": delayed,
    "rate_limit": followed("speed"),
    "lag": lambda p, u, t: relaxed(u, t, p["tau"]),
    "eccentric_pulley": eccentric,
    "backlash": lambda p, u, t: played(u, p["gap"] / 2),
    "friction": rubbed,
    "coupling": lambda p, u, t: u @ (np.eye(u.shape[1]) + p["factor"]).T,
    "routing": turned,
    "dead_zone": lambda p, u, t: np.sign(u) * np.maximum(np.abs(u) - p["slack"], 0.0),
    "tendon_creep": lambda p, u, t: u - p["loss"] * relaxed(u, t, p["tau"]),
    "anchor_slip": slipped,
    "hysteresis": prandtl_ishlinskii,
    "creep": lambda p, u, t: (
        u + p["strength"] * 0.5 * (relaxed(u, t, p["tau"] * p["spread"]) + relaxed(u, t, p["tau"] / p["spread"]))
    ),
    "mullins": broken_in,
    "thermal_softening": lambda p, u, t: u * (1.0 + 0.01 * p["rate"] * (warming(t) - warming(t[0])))[:, None],
    "asymmetry": lambda p, u, t: np.where(u > 0, u * (1.0 + p["excess"]), u * (1.0 - p["excess"])),
    "gravity": gravity_coefficients,
    "payload": payload_coefficients,
    "scale": lambda p, see, positions, t: p["factor"] * see(t),
    "mount": lambda p, see, positions, t: moved(p, see(t), positions),
    "camera_drift": drifted,
    "clock_shift": lambda p, see, positions, t: see(t - p["late"]),
}


def named(name, params, channels):
    """Flat parameters (P,) of one effect by name; per channel as arrays (C,), per pair as matrices (C, C)."""
    out, at = {}, 0
    near = np.abs(np.subtract.outer(np.arange(channels), np.arange(channels)))
    pairs = (near > 0) & ((near == 1) | (channels <= 4))
    for p in EFFECTS[name]["parameters"]:
        width = channels if p["per_channel"] else int(pairs.sum()) if p["per_pair"] else 1
        own = params[at : at + width]
        if p["per_pair"]:
            own, values = np.zeros((channels, channels)), own
            own[pairs] = values
        out[p["name"]] = own if p["per_channel"] or p["per_pair"] else own[0]
        at += width
    assert at == len(params)
    return out
