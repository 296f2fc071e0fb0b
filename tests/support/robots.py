"""Two robots of other people, with statics of their own: what the tests of imported models
sweep and measure.

An inextensible rod of J links with a bending joint in the middle of each, tendons parallel to it at
a radius, dead loads. Moment balance at every joint, in the frame of its link, with θ_j = (θx, θy)
the bending there:

    EI/h θ_j + Σ_i T_i ∂l_i/∂θ_j = [R_jᵀ Σ_{k≥j} (p_k − p_j) × F_k]_xy
    l_i = d_i + Σ_j (θx r_y − θy r_x),   T = k⟨l + l₀⟩₊

Nothing here calls the simulator, the effect library or the fields of a model. Without load and with
stiff tendons the rod is an arc: `arc` is the same finger in closed form, as a kinematic simulator
would have it. Units: mm, N, rad, g.
"""

from dataclasses import dataclass, field

import numpy as np

from softmap_edge.robot.emulated.laws import LAWS
from softmap_edge.run.protocol import standard_protocol
from softmap_edge.run.run import Run
from softmap_edge.synthetic.finger import Camera

LENGTH, RADIUS, LEVER = 100.0, 9.0, 6.5  # mm: body, its surface, its tendons
HANGING = np.array([0.0, 0.0, 1.0])


def turned(vectors):
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3)."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vectors, -1, 0)
    o = np.zeros_like(x)
    k = np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], -2)
    return (
        np.eye(3) + np.sinc(angle / np.pi) * k + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (k @ k)
    )


def rings(count, around, angle0=0.0):
    """Material points (places along, offsets (N, 3)) on the surface: `count` rings of `around`
    points.
    """
    place = np.repeat(np.linspace(0.0, LENGTH, count), around)
    angle = np.tile(angle0 + np.arange(around) * 2 * np.pi / around, count)
    return place, RADIUS * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)


def arc(u, place, offset):
    """A constant-curvature finger in closed form: points (n, N, 3) mm at commands (n, 2) mm of
    tendon.
    """
    # rotation vector of the tip, (n, 3)
    bend = np.stack([-u[:, 1], u[:, 0], 0 * u[:, 0]], axis=1) / LEVER
    total = np.linalg.norm(bend, axis=1)[:, None]
    share = place / LENGTH
    angle = total * share  # (n, N)
    towards = np.stack([bend[:, 1], -bend[:, 0]], axis=1) / np.maximum(total, 1e-12)  # (n, 2)
    aside = place * angle / 2 * np.sinc(angle / (2 * np.pi)) ** 2
    line = np.concatenate(
        [aside[..., None] * towards[:, None], (place * np.sinc(angle / np.pi))[..., None]], axis=2
    )
    return line + np.einsum("knab,nb->kna", turned(bend[:, None] * share[:, None]), offset)


@dataclass
class Rod:
    """The rod: bending stiffness N mm², weight N, tendons' stiffness N/mm and pretension mm; two
    pairs along x and y.
    """

    stiffness: float = 2000.0
    weight: float = 0.0
    tendon: float = 20.0
    slack: float = 3.0
    links: int = 40
    gravity: np.ndarray = field(default_factory=lambda: HANGING)

    def shapes(self, u, place, offset, gravity=None, grams=0.0):
        """Points (n, N, 3) mm at commands (n, 2) under `gravity` (n, 3) or (3,), with `grams` at
        the tip.
        """
        gravity = np.broadcast_to(self.gravity if gravity is None else gravity, (len(u), 3))
        h, n = LENGTH / self.links, self.links
        sides = LEVER * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        pulled = np.stack([u[:, 0], -u[:, 0], u[:, 1], -u[:, 1]], axis=1)
        lever = np.stack([sides[:, 1], -sides[:, 0]], axis=1)  # ∂l_i/∂θ, the same at every joint
        theta, a = np.zeros((len(u), n, 2)), self.stiffness / h
        for _ in range(400):
            frames, points = self._line(theta, h)
            stretch = pulled + np.einsum("kjb,ib->ki", theta, lever) + self.slack
            tension = self.tendon * np.maximum(stretch, 0.0)
            load = self._moment(frames, points, gravity, grams)
            rest = a * theta + (tension @ lever)[:, None] - load
            if np.abs(rest).max() < 1e-9:
                break
            k = self.tendon * np.einsum("ki,ib,ic->kbc", (stretch > 0).astype(float), lever, lever)
            total = rest.sum(axis=1)[..., None]
            shared = k @ np.linalg.solve(a * np.eye(2) + n * k, total)
            theta = theta - (rest - shared[:, None, :, 0]) / a
        assert np.abs(rest).max() < 1e-6, np.abs(rest).max()
        at = np.clip((place / h).astype(int), 0, n - 1)
        share = (place / h - at)[:, None]
        part = np.concatenate([theta[:, at] * share, np.zeros((len(u), len(at), 1))], axis=2)
        before = np.concatenate(
            [np.broadcast_to(np.eye(3), (len(u), 1, 3, 3)), frames[:, :-1]], axis=1
        )[:, at]
        joints, half = points[:, at], (share - 0.5) * h
        line = joints + half * np.where(half < 0, before[..., 2], frames[:, at][..., 2])
        return line + np.einsum("knab,nb->kna", before @ turned(part), offset)

    def _line(self, theta, h):
        """Frames behind each joint (n, J, 3, 3); joints and the tip (n, J + 1, 3)."""
        frames, points = [], []
        frame, here = np.broadcast_to(np.eye(3), (len(theta), 3, 3)), np.zeros((len(theta), 3))
        for j in range(theta.shape[1]):
            points.append(here + 0.5 * h * frame[:, :, 2])
            frame = frame @ turned(np.concatenate([theta[:, j], np.zeros((len(theta), 1))], axis=1))
            here = points[-1] + 0.5 * h * frame[:, :, 2]
            frames.append(frame)
        return np.stack(frames, axis=1), np.stack([*points, here], axis=1)

    def _moment(self, frames, points, gravity, grams):
        n = frames.shape[1]
        tip = grams * 1e-3 * 9.80665 * gravity
        joints = points[:, :-1]
        beyond = np.cumsum(joints[:, ::-1], axis=1)[:, ::-1]  # each link's weight sits at its joint
        arm = (beyond - np.arange(n, 0, -1)[None, :, None] * joints) / n
        moment = np.cross(arm, self.weight * gravity[:, None]) + np.cross(
            points[:, -1:] - joints, tip[:, None]
        )
        return np.einsum("kjab,kja->kjb", frames, moment)[:, :, :2]


def measured(
    body, hidden=None, seed=3, orientations=2, camera=None, kind="vertices", scale=1.0, reach=12.0
):
    """A run of `body`(u (K, 2), gravity (K, 3), grams) under the standard protocol, hiding one of
    the truth's laws.
    """
    protocol = standard_protocol(2, seed=seed, reach=reach)
    end = len(protocol.t)
    if orientations == 1:
        end = int(np.argmax(np.any(protocol.gravity != protocol.gravity[0], axis=1)))
    t, u, gravity = protocol.t[:end], protocol.command[:end], protocol.gravity[:end]
    seen = protocol.t_seen < t[-1]
    rng = np.random.default_rng([seed, 11])
    acting, grams = u, 0.0
    if hidden == "backlash":
        acting = LAWS["backlash"].draw(rng, 2).scaled(scale).command(t, u)
    elif hidden == "payload":
        grams = 10.0 * scale
    at = protocol.t_seen[seen]
    acting = np.stack([np.interp(at, t, column) for column in acting.T], axis=1)
    points = body(acting, gravity[np.searchsorted(t, at, side="right") - 1], grams)
    points = (camera or Camera()).look(points, at, rng)
    return Run(
        t=t,
        command=u,
        gravity=gravity,
        t_seen=at,
        block=protocol.block[seen],
        robot="other",
        **{kind: points},
    )
