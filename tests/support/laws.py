"""Every effect's law in plain NumPy: what the tests of effects and predictor compare with."""

from itertools import combinations, product

import numpy as np
from bodies import BENDING, CAMERAS, COEFFICIENTS, HOME, MIDDLES, OBSTACLE, TENDONS, warming

from softmap_edge import _core

EFFECTS = {effect["name"]: effect for effect in _core.effects()}
ROLES = ("channel", "shape", "sensing", "prior")
BY_ROLE = {role: [n for n, e in EFFECTS.items() if e["role"] == role] for role in ROLES}


def values(chain, kind):
    """Null, start or typical parameters (P,) of a chain; typical is halfway from null to the
    far end.
    """
    far = np.where(chain.high > chain.null, chain.high, chain.low)
    return {"null": chain.null, "start": chain.start, "middle": 0.5 * (chain.null + far)}[kind]


def random_params(chain, seed):
    """Parameters (P,) drawn between low and high, on a log scale where a fit searches on one."""
    share = np.random.default_rng(seed).uniform(size=len(chain.low))
    ratio = np.where(chain.log, chain.high / np.where(chain.log, chain.low, 1.0), 1.0)
    return np.where(
        chain.log, chain.low * ratio**share, chain.low + share * (chain.high - chain.low)
    )


# --- the oracles: the same laws in another form ---------------------------------------------------


def relaxed(u, t, tau):
    """First-order low pass of piecewise linear u by superposing the response to every piece
    (Duhamel).
    """
    if tau <= 0:
        return u
    slope = (np.diff(u, axis=0).T / np.diff(t)).T
    out = u.copy()
    for k in range(1, len(t)):
        missing = np.exp(-(t[k] - t[1 : k + 1]) / tau) - np.exp(-(t[k] - t[:k]) / tau)
        out[k] -= tau * missing @ slope[:k]
    return out


def each(law):
    """The law (p, u (T,), t) of one channel for all channels, each with its own number where `p`
    has one.
    """

    def channels(p, u, t):
        own = [{k: v[c] if np.ndim(v) else v for k, v in p.items()} for c in range(u.shape[1])]
        return np.stack([law(one, column, t) for one, column in zip(own, u.T)], axis=1)

    return channels


def slot(u, half):
    """A pin u (T,) in a slot of half-width `half`: the slot's centre, which starts under the
    pin.
    """
    centre, out = u[0], []
    for pin in u:
        if pin - centre > half:
            centre = pin - half
        elif centre - pin > half:
            centre = pin + half
        out.append(centre)
    return np.array(out)


def prandtl_ishlinskii(p, u, t):
    """What a stop holds back is what its play lets slip: stop = identity − play."""
    held = [u - slot(u, p["reach"] * share ** p["shape"]) for share in (0.25, 0.5, 0.75, 1.0)]
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
        out, x = u.copy(), u[0]
        for k in range(1, len(t)):
            at, left = u[k - 1], t[k] - t[k - 1]
            slope = (u[k] - at) / left
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
            out[k] = x
        return out

    return law


def eccentric(p, u, t):
    size, phase = np.hypot(p["sine"], p["cosine"]), np.arctan2(p["cosine"], p["sine"])
    return u + size * (np.sin(u / p["radius"] + phase) - np.sin(phase))


def rubbed(p, u, t):
    """Five beads on the tendon, each dragged along once the pull leaves its own play."""
    beads, out = np.tile(u[0], (5, 1)), []
    for pull in u:
        for j, bead in enumerate(beads):
            width = p["mu"] * (2 * j + 1) / 10 * (np.abs(pull) + p["preload"])
            bead[:] = np.where(
                bead > pull + width, pull + width, np.where(bead < pull - width, pull - width, bead)
            )
        out.append(beads.mean(axis=0))
    return np.array(out)


def broken_in(p, u, t):
    count = u.shape[1]
    together = 2 if count % 2 == 0 else 3 if count % 3 == 0 else count  # bend one section
    size = np.repeat(np.linalg.norm(u.reshape(len(u), -1, together), axis=2), together, axis=1)
    below = np.maximum.accumulate(size, axis=0) - size
    return u + u * p["softening"] * (1.0 - np.exp(-below / p["reach"]))


def slipped(p, u, t):
    """The cable that got longer is the one that +u pulls where the slip is negative."""
    half = 0.5 * p["width"] * p["at"]
    gone = np.interp(t - t[0], [p["at"] - half, p["at"] + half], [0.0, 1.0])[:, None] * np.abs(
        p["slip"]
    )
    side = np.where(p["slip"] < 0, 1.0, -1.0)
    pull, taut = side * u, p["taut"]
    loose = np.where(pull > 0, taut * (pull - gone), pull - taut * gone)
    return side * np.where(pull >= gone, pull - gone, loose)


def crept(p, u, t):
    """Piece by piece: one cable pulls, the other does, or neither, where only a taut pair moves."""
    ours, others = (
        loss * relaxed(np.maximum(pull, 0.0), t, p["tau"])
        for loss, pull in zip(p["loss"].T, (u, -u))
    )
    one, other = u - ours + p["taut"] * others, u + others - p["taut"] * ours
    neither = p["taut"] * (u - ours + others)
    return np.where(u > ours, one, np.where(u < -others, other, neither))


def turn(axis, degrees):
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def coefficients(count, **named):
    """Coefficients (count, F + 1): those named, each a number or (count,), and zeros."""
    out = np.zeros((count, len(COEFFICIENTS)))
    for name, value in named.items():
        out[:, COEFFICIENTS.index(name)] = value
    return out


def triple(name, vectors):
    return coefficients(
        len(vectors), **{f"{name}_{axis}": column for axis, column in zip("xyz", vectors.T)}
    )


def gravity_coefficients(p, gravity, u):
    actual = (1 + p["density"]) * gravity @ (turn(1, p["tilt_y"]) @ turn(0, p["tilt_x"])).T
    return triple("gravity", actual - gravity)


def payload_coefficients(p, gravity, u):
    return triple("tip_force", p["mass"] / 1000 * 9.80665 * gravity)


def section(centre, width, count):
    """Coefficients of stiff_0 … stiff_6 for 1 in a section: its mean under each stretch's cos², by
    Gauss's rule.
    """
    node, weight = np.polynomial.legendre.leggauss(24)

    def under(middle, low, high):
        low, high = max(low, middle - 1 / 6, 0.0), min(high, middle + 1 / 6, 1.0)
        s = low + (high - low) * (node + 1) / 2
        return max(high - low, 0.0) / 2 * weight @ np.cos(3 * np.pi * (s - middle)) ** 2

    low, high = centre - width / 2, centre + width / 2
    means = {f"stiff_{k}": under(m, low, high) / under(m, -1.0, 2.0) for k, m in enumerate(MIDDLES)}
    return coefficients(count, **means)


def gradient_coefficients(p, gravity, u):
    values = {f"stiff_{k}": p["gradient"] * (middle - 0.5) for k, middle in enumerate(MIDDLES)}
    return coefficients(len(gravity), **values)


def relays(p, u):
    """The relay (T, C): the elongation of a stop (input minus play of the same half-width), as a
    share of the width.
    """
    return (u - np.stack([slot(column, p["width"]) for column in u.T], axis=1)) / p["width"]


def body_friction_coefficients(p, gravity, u, remembered=None):
    """The relays (K, C): those `remembered` at the frames of a longer record, or one for each row
    of `u`.
    """
    relay = relays(p, u) if remembered is None else remembered
    loading = np.einsum(
        "kc,kc->k", u / np.maximum(np.linalg.norm(u, axis=1), 1e-300)[:, None], relay
    )
    return loading[:, None] * gradient_coefficients({"gradient": p["amount"]}, gravity, u)


def obstacle_coefficients(p, gravity, u):
    towards = np.array([np.cos(np.deg2rad(p["heading"])), np.sin(np.deg2rad(p["heading"])), 0.0])
    normal = -np.cos(np.deg2rad(p["tilt"])) * towards - np.sin(np.deg2rad(p["tilt"])) * HOME
    row = [1.0, *(p["distance"] * towards + p["height"] * HOME), *normal, p["curvature"]]
    return coefficients(len(gravity), **dict(zip(OBSTACLE, row)))


def kink_coefficients(p, gravity, u):
    beyond = 1.0 - p["bend"] / np.maximum(np.linalg.norm(u, axis=1), 1e-12)
    softer = p["softening"] * np.clip(beyond, 0.0, 1.0)
    return -softer[:, None] * section(p["centre"], 0.25, len(gravity))


def moved(p, frames, positions):
    """The turn as the exponential series of its cross-product matrix."""
    x, y, z = np.deg2rad([p["turn_x"], p["turn_y"], p["turn_z"]])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix, term = np.eye(3), np.eye(3)
    for n in range(1, 30):
        term = term @ cross / n
        matrix = matrix + term
    return frames @ matrix.T + positions[:, None] * np.array(
        [p["shift_x"], p["shift_y"], p["shift_z"]]
    )


# Sensing effects change how one sees: `see(t)` gives the frames (K, V, 3) at any times, before and
# after.


def drifted(p, see, positions, t):
    frames, minutes = see(t), (t - t[0]) / 60.0
    return np.stack(
        [moved({k: v * m for k, v in p.items()}, f, positions) for f, m in zip(frames, minutes)]
    )


def beside(p, see, positions, t):
    """Each point where the bent rays of the cameras meet: all their equations side by side, least
    squares.
    """
    frames = see(t).copy()
    for frame in frames:
        for v in np.flatnonzero(positions):
            rows, right = [], []
            for pose in CAMERAS:
                turn, shift = pose[:, :3], pose[:, 3]
                q = turn @ frame[v] + shift
                n = q[:2] / q[2]
                n = n * (1.0 + p["radial"] * (n @ n))
                # A point s lies on the ray where (turn s + shift) is in line with (n, 1).
                cross = np.array([[0, -1, n[1]], [1, 0, -n[0]], [-n[1], n[0], 0]])
                cross = cross / np.linalg.norm([*n, 1.0])
                rows.append(cross @ turn)
                right.append(-cross @ shift)
            frame[v] = np.linalg.lstsq(np.vstack(rows), np.hstack(right), rcond=None)[0]
    return frames


def slackened(p, u):
    """Markers (n, 9, 3) of `rod_body` with tendons that push `ratio` times as hard as they pull.

    Every set of pulling tendons is tried; the one that agrees with its own stretch is the
    equilibrium.
    """
    out = np.empty((len(u), 9, 3))
    reach = np.concatenate([TENDONS, TENDONS], axis=1)
    drawn = np.concatenate([u, -u], axis=1)
    for d, points in zip(drawn, out):
        for pulling in product([1.0, p["ratio"]], repeat=4):
            w = np.array(pulling)
            bent = np.linalg.solve(BENDING * np.eye(4) + reach.T * w @ reach, reach.T @ (w * d))
            if np.array_equal(np.where(d - reach @ bent > 0, 1.0, p["ratio"]), w):
                break
        else:
            raise AssertionError("no set of tendons agrees")
        # both halves bend alike: one arc
        for at, point in zip(np.linspace(0.0, 100.0, 10)[1:], points):
            point[:] = arc(bent[:2] / 50.0, at)
    return out


def arc(curvature, along):
    """Where an arc of curvature (2,) 1/mm from the origin along z is after `along` mm: its tangent,
    summed.
    """
    s = along * (np.arange(2000) + 0.5) / 2000
    turn = np.linalg.norm(curvature) * s
    aside = np.sin(turn)[:, None] * curvature / max(np.linalg.norm(curvature), 1e-300)
    return np.column_stack([aside, np.cos(turn)]).mean(axis=0) * along


ORACLES = {
    "slack": slackened,
    "servo_swap": swapped,
    "saturation": lambda p, u, t: np.clip(u, -p["below"], p["above"]),
    "offset": lambda p, u, t: u + p["shift"],
    "gain": lambda p, u, t: u * p["factor"],
    "latency": each(lambda p, u, t: np.interp(t - p["delay"], t, u)),
    "rate_limit": each(followed("speed")),
    "lag": each(lambda p, u, t: relaxed(u, t, p["tau"])),
    "eccentric_pulley": eccentric,
    "backlash": each(lambda p, u, t: slot(u, p["gap"] / 2)),
    "friction": rubbed,
    "coupling": lambda p, u, t: u @ (np.eye(u.shape[1]) + p["factor"]).T,
    "dead_zone": lambda p, u, t: (
        np.maximum(u - p["slack"][:, 0], 0.0) - np.maximum(-u - p["slack"][:, 1], 0.0)
    ),
    "tendon_creep": crept,
    "anchor_slip": slipped,
    "zero_drift": lambda p, u, t: u + np.outer(np.minimum((t - t[0]) / 60.0, 15.0), p["rate"]),
    "hysteresis": each(prandtl_ishlinskii),
    "creep": lambda p, u, t: (
        u
        + p["strength"]
        * 0.5
        * (relaxed(u, t, p["tau"] * p["spread"]) + relaxed(u, t, p["tau"] / p["spread"]))
    ),
    "mullins": broken_in,
    "thermal_softening": lambda p, u, t: (
        u * (1.0 + 0.01 * p["rate"] * (warming(t) - warming(t[0])))[:, None]
    ),
    "asymmetry": lambda p, u, t: np.where(u > 0, u * (1.0 + p["excess"]), u * (1.0 - p["excess"])),
    "tendon_stretch": lambda p, g, u: coefficients(
        len(g),
        **{
            f"compliance_{c}{side}": row[k]
            for c, row in enumerate(p["compliance"])
            for k, side in enumerate("+-")
        },
    ),
    "routing": lambda p, g, u: coefficients(
        len(g), routing_0=p["phase"][0], routing_1=p["phase"][1]
    ),
    "gravity": gravity_coefficients,
    "payload": payload_coefficients,
    "body_friction": body_friction_coefficients,
    "stiffness": lambda p, g, u: coefficients(
        len(g), **{f"stiff_{k}": p["amount"] for k in range(len(MIDDLES))}
    ),
    "stiffness_gradient": gradient_coefficients,
    "stiff_section": lambda p, g, u: p["amount"] * section(p["centre"], p["width"], len(g)),
    "one_sided_stiffness": lambda p, g, u: coefficients(len(g), stiff_x=p["x"], stiff_y=p["y"]),
    "kink": kink_coefficients,
    "twist": lambda p, g, u: coefficients(len(g), twist=p["angle"]),
    "pre_curve": lambda p, g, u: coefficients(len(g), curve_x=p["x"], curve_y=p["y"]),
    "contact": obstacle_coefficients,
    "lens": beside,
    "scale": lambda p, see, positions, t: p["factor"] * see(t),
    "mount": lambda p, see, positions, t: moved(p, see(t), positions),
    "camera_drift": drifted,
    "clock_shift": lambda p, see, positions, t: see(t - p["late"]),
}


# Memory of a shape effect for all effective commands: it is read at the frames, like the commands.
REMEMBERED = {"body_friction": relays}


def named(name, params, channels):
    """Flat parameters (P,) of one effect by name; per channel (C,), per cable (C, 2), per pair (C,
    C).
    """
    out, at = {}, 0
    near = np.abs(np.subtract.outer(np.arange(channels), np.arange(channels)))
    pairs = (near > 0) & ((near == 1) | (channels <= 4))
    for p in EFFECTS[name]["parameters"]:
        width = channels if p["per_channel"] else int(pairs.sum()) if p["per_pair"] else 1
        width = 2 * channels if p["per_cable"] else width
        own = params[at : at + width]
        if p["per_cable"]:
            own = own.reshape(channels, 2)
        if p["per_pair"]:
            own, values = np.zeros((channels, channels)), own
            own[pairs] = values
        out[p["name"]] = own if p["per_channel"] or p["per_pair"] or p["per_cable"] else own[0]
        at += width
    assert at == len(params)
    return out
