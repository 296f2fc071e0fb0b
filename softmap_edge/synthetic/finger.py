"""Simulate a second finger with hidden effects, measured by a noisy camera.

It is used by the demo and all hidden-effect tests.

**This module never calls the effect library**, nor the linear fields, nor a model's prior. The
finite elements solve the body, with its weights, on another mesh with a modulus up to 10 % off. All
other effects are the separately written laws of `robot/emulated/laws.py`. The observed points are
the template's material points, embedded in that solid.

    command ─laws─> u ─finite elements (own mesh, modulus, true weights)─> points ─mount─> ─camera
    noise─> run

Every frame is solved: the change of tendons between slack and taut causes kinks in the shapes,
which no table of a sweep represents (one of 15 × 15 commands was 0.8 mm off next to them). Only the
search for the strength of an effect interpolates. The strength is scaled until the section
centroids move by a drawn 1.2-3.6 mm RMS on the standard protocol. Units: mm, s, N, g. Randomness
only from the seeds; the same arguments give the same numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import SoftmapError
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Simulator, tour
from softmap_edge.files.atomic import Document
from softmap_edge.geometry.sections import SECTIONS, sections_of
from softmap_edge.robot.emulated.laws import LAWS, NEWTON_PER_GRAM, Law, rotation
from softmap_edge.robot.emulated.named_laws import NAMED, check_hidden
from softmap_edge.run.protocol import Protocol, standard_protocol
from softmap_edge.run.run import Run

Floats = NDArray[np.float64]
Vector = tuple[float, float, float]
Body = Callable[[Finger, float, Vector, Vector, Floats], Floats]

# modulus of the second finger relative to the first, by seed (batch of silicone)
BATCHES = (0.9, 0.95, 1.05, 1.1)
LAYERS = 0.75  # of the first finger's layers: another mesh along the body
STEPS = 9  # commands per channel of the sweep for the strength of an effect,
WEIGHT_STEPS = 5  # and of an effect with a separate sweep
# called with the completed share of the work
WATCH: ContextVar[Callable[[float], None] | None] = ContextVar("WATCH", default=None)
SCALED, SOLVED = 0.3, 0.8  # progress of drawing an effect: scaled, solved with the effect
EVERY = 3  # every third frame is used for the effect size
REACH = 18.0  # limit of effective commands, mm
TARGET = (1.2, 3.6)  # drawn effect size, mm RMS of the section centroids; 1-4 mm are accepted


@contextmanager
def stretch(begin: float, end: float) -> Iterator[None]:
    """Report the progress of the solves inside as a stretch of that outside."""
    outer = WATCH.get()
    if outer is None:
        yield
        return
    before = WATCH.set(lambda share: outer(begin + (end - begin) * share))
    try:
        yield
    finally:
        WATCH.reset(before)


@dataclass(frozen=True)
class Camera:
    """Measurement noise: independent for each vertex, and a slow rigid jitter of the frame.

    `vertex_mm` per coordinate, `shift_mm` and `turn_deg` per component (Ornstein-Uhlenbeck, memory
    `memory_s`), one σ each.
    """

    vertex_mm: float = 0.25
    shift_mm: float = 0.05
    turn_deg: float = 0.03
    memory_s: float = 1.0

    def look(self, points: Floats, t: Floats, rng: np.random.Generator) -> Floats:
        """Return `points` (K, N, 3) mm with noise at t (K,) s."""
        jitter = np.empty((t.size, 6))
        state = rng.normal(size=6)
        for k in range(t.size):
            keep = np.exp(-(t[k] - t[k - 1]) / self.memory_s) if k else 1.0
            state = keep * state + np.sqrt(1.0 - keep * keep) * rng.normal(size=6)
            jitter[k] = state
        seen = (
            points
            + self.vertex_mm * rng.normal(size=points.shape)
            + self.shift_mm * jitter[:, None, :3]
        )
        for k in range(t.size):
            seen[k] = seen[k] @ rotation(tuple(self.turn_deg * jitter[k, 3:])).T
        return seen


@dataclass(frozen=True)
class HiddenEffect:
    """A hidden effect: its name in the library, its own law, and its effect size, mm RMS.

    The effect size is measured on the finger.
    """

    law: Law
    displacement_mm: float

    @property
    def name(self) -> str:
        """Return the effect's name."""
        return self.law.NAME

    def to_dict(self) -> Document:
        """Return `{name, params, displacement_mm}`."""
        return {
            "name": self.name,
            "params": self.law.params(),
            "displacement_mm": round(self.displacement_mm, 4),
        }


@dataclass(frozen=True)
class Truth:
    """A second finger: its silicone (by `seed`), and its hidden effects in order of action."""

    seed: int
    hidden: tuple[HiddenEffect, ...] = ()
    camera: Camera = field(default_factory=Camera)
    finger: Finger = field(default_factory=Finger.builtin)

    @property
    def modulus(self) -> float:
        """Return the modulus relative to the first finger."""
        return BATCHES[self.seed % len(BATCHES)]

    def twin(self) -> Truth:
        """Return the finger without its hidden effects: the floor of every error."""
        return Truth(self.seed, (), self.camera, self.finger)

    def to_body(self, protocol: Protocol) -> Floats:
        """Return the effective commands (K, C) mm at the frame times."""
        u = protocol.command
        for effect in self.hidden:
            u = effect.law.command(protocol.t, u)
        return np.stack(
            [np.interp(protocol.t_seen, protocol.t, u[:, c]) for c in range(u.shape[1])], axis=1
        )

    def shapes(self, protocol: Protocol, every: int = 1) -> Floats:
        """Return the true points (K, N, 3) mm of each `every`-th frame.

        They are the points of a camera without noise.
        """
        return self.shapes_by(_solved, protocol, every)

    def rough(self, protocol: Protocol, steps: int) -> Floats:
        """Return approximate points, interpolated in a sweep of `steps` commands per channel."""
        return self.shapes_by(
            lambda body, m, g, f, u: _interpolated(body, m, g, f, u, steps), protocol
        )

    def shapes_by(self, body: Body, protocol: Protocol, every: int = 1) -> Floats:
        """Return the points (K, N, 3) mm of a `body`.

        The arguments are finger, modulus, gravity g, tip force N and u (n, C).
        """
        u = self.to_body(protocol)
        points = np.empty((protocol.frames, *template(self.finger).shape))
        done = 0
        for frames, gravity, force in self._weights(protocol):
            chosen = frames[frames % every == 0]
            until = done + len(frames)
            with stretch(done / protocol.frames, until / protocol.frames):
                points[chosen] = body(self.finger, self.modulus, gravity, force, u[chosen])
            done = until
        points = points[::every]
        for effect in self.hidden:
            points = effect.law.seen(points)
        return points

    def measure(self, protocol: Protocol, seed: int = 0) -> Run:
        """Run the protocol on this finger with the camera; `seed` draws the camera's noise."""
        rng = np.random.default_rng([self.seed, seed, protocol.frames])
        return Run(
            t=protocol.t,
            command=protocol.command,
            gravity=protocol.gravity,
            load=protocol.load,
            temperature=protocol.temperature,
            t_seen=protocol.t_seen,
            vertices=self.camera.look(self.shapes(protocol), protocol.t_seen, rng),
            block=protocol.block,
            robot=self.finger.name,
            command_unit=self.finger.command_unit,
        )

    def _weights(self, protocol: Protocol) -> list[tuple[NDArray[np.int64], Vector, Vector]]:
        """Return the frames, true gravity (g) and tip force (N) of each condition.

        A condition is an orientation and a declared load.
        """
        at = np.searchsorted(protocol.t, protocol.t_seen, side="right") - 1
        hung = np.zeros(len(protocol.t)) if protocol.load is None else protocol.load
        declared = np.column_stack([protocol.gravity, hung])[at]
        parts = []
        for row in np.unique(declared, axis=0):
            direction = row[:3]
            gravity, force = direction, row[3] * NEWTON_PER_GRAM * direction
            for effect in self.hidden:
                gravity, force = effect.law.gravity(gravity), force + effect.law.force(direction)
            parts.append(
                (np.flatnonzero((declared == row).all(axis=1)), _vector(gravity), _vector(force))
            )
        return parts


def hide(
    names: Sequence[str], seed: int, camera: Camera | None = None, finger: Finger | None = None
) -> Truth:
    """Make a second finger with hidden effects `names`, with strengths drawn from `seed`.

    Args: `names` out of `LAWS` (none: nothing is hidden) and `NAMED`; `seed` ≥ 0 draws batch,
    characters and strengths; `finger` is the first one, usually the built-in. Returns the truth;
    each effect of `LAWS` alone moves the section centroids by 1-4 mm RMS on the standard protocol.
    Raises SoftmapError for an unknown or repeated name.
    """
    check_hidden(names, seed)
    plain = Truth(seed, (), camera or Camera(), finger or _builtin())
    chosen = [name for name in (*NAMED, *LAWS) if name in names]
    hidden = []
    for k, name in enumerate(chosen):
        with stretch(k / len(chosen), (k + 1) / len(chosen)):
            hidden.append(_named(name, plain) if name in NAMED else _drawn(name, plain))
    return replace(plain, hidden=tuple(hidden))


def surprise(seed: int) -> list[str]:
    """Draw one or two effects to hide."""
    rng = np.random.default_rng([seed, 77])
    return [
        str(name)
        for name in rng.choice(
            list(LAWS), size=int(rng.choice([1, 2], p=[0.65, 0.35])), replace=False
        )
    ]


@lru_cache(maxsize=4)
def template(finger: Finger | None = None) -> Floats:
    """Return the observed material points (N, 3) mm: the vertices of the first template."""
    return np.asarray(Simulator(finger or _builtin()).template.vertices, dtype=np.float64)


def centroids(points: Floats, finger: Finger | None = None) -> Floats:
    """Return section centroids (K, 9, 3) mm of points (K, N, 3): nine slices at rest."""
    section = sections_of(template(finger))
    return np.stack([points[:, section == s].mean(axis=1) for s in range(SECTIONS)], axis=1)


def _named(name: str, plain: Truth) -> HiddenEffect:
    """Use a law unscaled; its effect size is its motion in a sweep of the plain finger."""
    protocol = standard_protocol(len(plain.finger.pairs))
    law = NAMED[name].draw(np.random.default_rng(plain.seed), len(plain.finger.pairs))
    both = (
        replace(plain, hidden=hidden).rough(protocol, STEPS)
        for hidden in ((), (HiddenEffect(law, 0.0),))
    )
    before, after = (centroids(points, plain.finger) for points in both)
    return HiddenEffect(law, _rms(after - before))


def _drawn(name: str, plain: Truth) -> HiddenEffect:
    """Draw a law and scale it to move a finger's section centroids by the drawn target."""
    seed, channels = plain.seed, len(plain.finger.pairs)
    rng = np.random.default_rng([seed, list(LAWS).index(name)])
    law = LAWS[name].draw(rng, channels)
    target = float(rng.uniform(*TARGET))
    protocol = standard_protocol(channels)
    is_weight = name in ("gravity", "payload")

    def there(strength: float) -> Truth:
        return replace(plain, hidden=(HiddenEffect(law.scaled(strength), 0.0),))

    def apart(one: Floats, other: Floats) -> float:
        return _rms(centroids(one, plain.finger) - centroids(other, plain.finger))

    strength, steps = 1.0, WEIGHT_STEPS if is_weight else STEPS
    # a weight needs a sweep each time, and its motion is nearly proportional
    for k in range(2 if is_weight else 8):
        truth = there(strength)
        begin, end = (SCALED * (1.0 - 0.5**n) for n in (k, k + 1))  # it may end after any trial
        with stretch(begin, 0.5 * (begin + end)):
            moved = truth.rough(protocol, steps)
        with stretch(0.5 * (begin + end), end):
            distance = apart(moved, plain.rough(protocol, steps))
        strength = float(
            np.clip(strength * target / distance, strength / 4, min(strength * 4, law.LIMIT))
        )
        if abs(distance - target) < 0.02 * target:
            break
    truth, thin = there(strength), slice(None, None, EVERY)
    with stretch(SCALED, SOLVED):
        moved = truth.shapes(protocol)[thin]
    with stretch(SOLVED, 1.0):
        distance = apart(moved, plain.shapes(protocol, EVERY))
    if not 1.0 <= distance <= 4.0:
        raise SoftmapError(
            f"'{name}' with seed {seed} moves the finger by {distance:.2f} mm RMS at "
            f"{strength:.2f} of its usual strength, outside 1-4 mm; take another seed"
        )
    return HiddenEffect(law.scaled(strength), distance)


def _rms(difference: Floats) -> float:
    """Return the RMS length mm of 3-vectors."""
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=-1))))


def _vector(v: Floats) -> Vector:
    return (float(v[0]), float(v[1]), float(v[2]))


@lru_cache(maxsize=1)
def _builtin() -> Finger:
    return Finger.builtin()


@lru_cache(maxsize=8)
def _simulator(finger: Finger, modulus: float) -> Simulator:
    """Return the second finger: another mesh, another batch, the first finger's material points."""
    other = finger.replace(solid=finger.solid.along(LAYERS), young_mpa=finger.young_mpa * modulus)
    return Simulator(other, template=Simulator(finger).template)


def _solved(finger: Finger, modulus: float, gravity: Vector, force: Vector, u: Floats) -> Floats:
    """Solve the second finger under weights at each command (K, C) mm: points (K, N, 3) mm."""
    places, which = different(u)
    return _path(finger, modulus, gravity, force, places.tobytes(), u.shape[1])[which]


def different(u: Floats) -> tuple[Floats, NDArray[np.intp]]:
    """Return the distinct commands (n, C) of commands (K, C) mm, and their indices.

    Raises SoftmapError beyond REACH.
    """
    largest = float(np.max(np.abs(u), initial=0.0))
    if largest > REACH:
        raise SoftmapError(
            f"commands of {largest:.1f} mm reach the body, the truth is solved to {REACH:g} mm; "
            "hide less or move less"
        )
    places, which = np.unique(np.round(u, 6), axis=0, return_inverse=True)
    return places, which.ravel()


@lru_cache(maxsize=48)
def _path(
    finger: Finger, modulus: float, gravity: Vector, force: Vector, commands: bytes, channels: int
) -> Floats:
    places = np.frombuffer(commands).reshape(-1, channels)
    return toured(_simulator(finger, modulus), gravity, force, places)


def toured(simulator: Simulator, gravity: Vector, force: Vector, places: Floats) -> Floats:
    """Solve distinct commands (n, C) mm, each from a near one: points (n, N, 3) mm."""
    order = tour(places)
    along = simulator.path(places[order], gravity=gravity, load=force, progress=WATCH.get())
    points = np.empty_like(along)
    points[order] = along
    return points


def _interpolated(
    finger: Finger, modulus: float, gravity: Vector, force: Vector, u: Floats, steps: int
) -> Floats:
    return (
        _sweep(finger, modulus, gravity, force, steps)
        .evaluate(u)
        .reshape(-1, *template(finger).shape)
    )


@lru_cache(maxsize=64)
def _sweep(
    finger: Finger, modulus: float, gravity: Vector, force: Vector, steps: int
) -> _core.Table:
    """Sweep the second finger under these weights and interpolate (to 0.1 µm).

    All significant modes are used.
    """
    axes = [np.linspace(-REACH, REACH, steps)] * len(finger.pairs)
    sweep = _simulator(finger, modulus).sweep(
        axes, gravity=gravity, load=force, progress=WATCH.get()
    )
    values = np.asarray(sweep.vertices, dtype=np.float64).reshape(len(sweep.command), -1)
    mean = values.mean(axis=0)
    left, size, modes = np.linalg.svd(values - mean, full_matrices=False)
    kept = max(1, int(np.sum(size > 1e-4)))
    return _core.Table(
        axes,
        np.ascontiguousarray(left[:, :kept] * size[:kept]),
        mean,
        np.ascontiguousarray(modes[:kept]),
    )
