"""Hidden laws of the body, of its weight and of who looks at it.

hysteresis           Bouc-Wen with different loading and unloading exponents
creep                Prony series of three terms, from a sixth to six times the middle time
mullins  Ogden-Roxburgh: η = 1 − erf((W_max − W)/(m + β W_max))/r, W from both bends together
thermal_softening    modulus ∝ exp(−a (T − T₀)) of a body that warms later than its sensor
asymmetry            a smooth corner: a (√(d² + w²) − w)
gravity, payload     other weight in the equilibrium of the rod
stiffness_gradient   modulus that falls exponentially along the rod
stiff_section        a stiffer stretch with smooth ends
one_sided_stiffness  fibres of one half are stiffer, also a little beyond the half
twist, pre_curve     curvature at rest
kink                 one element gives way, and more on one side
routing              guides turned by an angle that grows along the rod
contact              a springy plane in the energy of the rod
mount, scale, camera_drift   exact rigid motion; another scale along the axis of the camera; a slow
                             random walk
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from benches.bank.law import Floats, Law, Numbers, Record, chosen, per_channel, slow
from benches.bank.rod import Loads, Poses
from benches.bank.rotations import turn
from benches.bank.section import GRAVITY, Design


@dataclass(frozen=True)
class BoucWen(Law):
    """u − h z, z' = v/d₀ (1 − |z|ⁿ (β + (1 − β) sgn(v z)))."""

    NAME, STRONG, LIMIT = "hysteresis", ("share",), 3.0
    share: Numbers
    yield_mm: float
    power: float
    beta: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        share = tuple(0.25 * np.array(per_channel(rng, channels, False)))
        return cls(
            share,
            float(rng.uniform(3.0, 5.0)),
            float(rng.uniform(0.8, 1.5)),
            float(rng.uniform(0.4, 0.6)),
        )

    def drive(self, record: Record, u: Floats) -> Floats:
        z, out = np.zeros(u.shape[1]), np.empty_like(u)
        height = np.array(self.share) * self.yield_mm
        last = u[0]
        for k, now in enumerate(u):
            parts = 1 + int(np.max(np.abs(now - last)) / (0.1 * self.yield_mm))
            step = (now - last) / self.yield_mm / parts
            for _ in range(parts):
                z = z + step * (
                    1.0
                    - np.abs(z) ** self.power * (self.beta + (1.0 - self.beta) * np.sign(step * z))
                )
            out[k] = now - height * z
            last = now
        return out


@dataclass(frozen=True)
class Prony(Law):
    """u (1 + c) in the end, by three terms."""

    NAME, STRONG, LIMIT = "creep", ("compliance",), 2.3
    compliance: Numbers
    tau_s: float
    weight: Numbers

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        weight = np.array([0.3, 0.45, 0.25]) * rng.uniform(0.8, 1.25, 3)
        share = tuple(0.15 * np.array(per_channel(rng, channels, False)))
        return cls(share, float(rng.uniform(3.0, 8.0)), tuple(weight / weight.sum()))

    def drive(self, record: Record, u: Floats) -> Floats:
        terms = zip(self.weight, (1 / 6, 1.0, 6.0))
        late = sum((w * slow(record.t, u, f * self.tau_s) for w, f in terms), np.zeros_like(u))
        return np.asarray(u + np.array(self.compliance) * late)


@dataclass(frozen=True)
class OgdenRoxburgh(Law):
    """d (1 + a (1 − η)); the energy W goes with the square of the bend of both channels."""

    NAME, STRONG, LIMIT = "mullins", ("softening",), 4.0
    softening: float
    m: float
    beta: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(0.2, float(rng.uniform(8.0, 20.0)), float(rng.uniform(0.2, 0.5)))

    def drive(self, record: Record, u: Floats) -> Floats:
        from scipy.special import erf

        stored = np.sum(u**2, axis=1)
        most = np.maximum.accumulate(stored)
        damage = erf((most - stored) / (self.m + self.beta * most))
        return np.asarray(u * (1.0 + self.softening * damage[:, None]))


@dataclass(frozen=True)
class Warm(Law):
    """d (1 + a (1 − e^{−b (T_body − T₀)})), T_body late by a time constant."""

    NAME, STRONG, LIMIT = "thermal_softening", ("share",), 4.0
    share: float
    rate: float
    tau_s: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(0.4, float(rng.uniform(0.02, 0.04)), float(rng.uniform(3.0, 12.0)))

    def drive(self, record: Record, u: Floats) -> Floats:
        body = slow(record.t, record.temperature, self.tau_s)
        return np.asarray(
            u * (1.0 + self.share * -np.expm1(-self.rate * (body - body[0])))[:, None]
        )


@dataclass(frozen=True)
class Corner(Law):
    """d + a (√(d² + w²) − w)."""

    NAME, STRONG = "asymmetry", ("share",)
    share: Numbers
    soft_mm: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(tuple(0.1 * np.array(per_channel(rng, channels))), float(rng.uniform(0.5, 1.5)))

    def drive(self, record: Record, u: Floats) -> Floats:
        return np.asarray(u + np.array(self.share) * (np.hypot(u, self.soft_mm) - self.soft_mm))


@dataclass(frozen=True)
class OtherWeight(Law):
    """Density off by a share, and the stand askew."""

    NAME, STRONG, SHAPE, LIMIT = "gravity", ("excess", "askew_deg"), True, 5.0
    excess: float
    askew_deg: Numbers

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        angle = rng.uniform(0, 2 * np.pi)
        return cls(float(rng.uniform(-0.1, 0.25)), (12 * np.cos(angle), 12 * np.sin(angle), 0.0))

    def loads(self, loads: Loads, poses: Poses | None) -> Loads:
        askew = turn(np.radians(self.askew_deg))
        return replace(loads, gravity=(1.0 + self.excess) * loads.gravity @ askew.T)


@dataclass(frozen=True)
class Hung(Law):
    """A weight at the tip."""

    NAME, STRONG, SHAPE, LIMIT = "payload", ("mass_g",), True, 6.0
    mass_g: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(10.0)

    def loads(self, loads: Loads, poses: Poses | None) -> Loads:
        return replace(loads, tip=loads.tip + self.mass_g * GRAVITY * loads.gravity)


@dataclass(frozen=True)
class Falling(Law):
    """E e^{a (½ − s/L)}."""

    NAME, STRONG, SHAPE, LIMIT = "stiffness_gradient", ("slope",), True, 4.0
    slope: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(0.8 * float(rng.choice([-1.0, 1.0])))

    def design(self, design: Design) -> Design:
        return design.stiffer(np.exp(self.slope * (0.5 - design.middle / design.place[-1])))


@dataclass(frozen=True)
class Sleeve(Law):
    """log E rises by `log` between z₀ ± w/2, with ends of 4 mm."""

    NAME, STRONG, SHAPE, LIMIT = "stiff_section", ("log",), True, 4.0
    log: float
    at_mm: float
    width_mm: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(0.8, float(rng.uniform(25.0, 70.0)), float(rng.uniform(15.0, 30.0)))

    def design(self, design: Design) -> Design:
        near = np.abs(design.middle - self.at_mm) - self.width_mm / 2
        return design.stiffer(np.exp(self.log / (1.0 + np.exp(np.clip(near / 2.0, -50, 50)))))


@dataclass(frozen=True)
class Half(Law):
    """Fibres towards an angle are stiffer: log E + a (1 + tanh(6 cos))/2."""

    NAME, STRONG, SHAPE, LIMIT = "one_sided_stiffness", ("log",), True, 4.0
    log: float
    side: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(0.6, float(rng.uniform(0, 2 * np.pi)))

    def design(self, design: Design) -> Design:
        x, y, _ = design.fibres()
        towards = (x * np.cos(self.side) + y * np.sin(self.side)) / design.radius[:, None]
        return design.stiffer(np.exp(self.log * (1.0 + np.tanh(6.0 * towards)) / 2.0))


@dataclass(frozen=True)
class Screw(Law):
    """Twisted at rest."""

    NAME, STRONG, SHAPE, LIMIT = "twist", ("turn_deg",), True, 6.0
    turn_deg: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(8.0 * float(rng.choice([-1.0, 1.0])))

    def design(self, design: Design) -> Design:
        rest = design.rest.copy()
        rest[:, 2] += np.radians(self.turn_deg) / design.place[-1]
        return replace(design, rest=rest)


@dataclass(frozen=True)
class Curled(Law):
    """Curved at rest, more towards the tip."""

    NAME, STRONG, SHAPE, LIMIT = "pre_curve", ("bend_deg",), True, 5.0
    bend_deg: Numbers  # about x and y
    growth: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        angle = rng.uniform(0, 2 * np.pi)
        return cls((6 * np.cos(angle), 6 * np.sin(angle)), float(rng.uniform(-0.3, 0.6)))

    def design(self, design: Design) -> Design:
        share = 1.0 + self.growth * (2 * design.middle / design.place[-1] - 1.0)
        rest = design.rest.copy()
        rest[:, :2] += np.radians(self.bend_deg) / design.place[-1] * share[:, None]
        return replace(design, rest=rest)


@dataclass(frozen=True)
class Hinge(Law):
    """One element softer by e^{a}, and by half as much again on one side."""

    NAME, STRONG, SHAPE, LIMIT, ALSO = "kink", ("log",), True, 2.0, ("one_sided_stiffness",)
    log: float
    at_mm: float
    side: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(1.0, float(rng.uniform(25.0, 75.0)), float(rng.uniform(0, 2 * np.pi)))

    def design(self, design: Design) -> Design:
        here = np.abs(design.middle - self.at_mm) <= np.abs(design.middle - self.at_mm).min() + 1e-9
        return design.stiffer(
            np.exp(-self.log * here[:, None] * (1.0 + 0.5 * design.half(self.side)))
        )


@dataclass(frozen=True)
class TurnedGuides(Law):
    """Guides turned about the axis, from 0.6 of the angle at the base to 1.2 at the anchor."""

    NAME, STRONG, SHAPE, LIMIT = "routing", ("turn_deg",), True, 4.0
    turn_deg: float
    uneven: Numbers

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(
            6.0 * float(rng.choice([-1.0, 1.0])), tuple(rng.uniform(0.85, 1.15, 2 * channels))
        )

    def design(self, design: Design) -> Design:
        along = np.linspace(0.6, 1.2, design.guide.shape[1])
        return design.turned_guides(np.radians(self.turn_deg) * np.outer(self.uneven, along))


@dataclass(frozen=True)
class Wall(Law):
    """A springy plane beside the finger; stronger is nearer."""

    NAME, STRONG, SHAPE, LIMIT = "contact", ("near_mm",), True, 2.2
    near_mm: float  # from 45 mm off the axis
    side: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(13.0, float(rng.uniform(0, 2 * np.pi)))

    def loads(self, loads: Loads, poses: Poses | None) -> Loads:
        normal = np.array([np.cos(self.side), np.sin(self.side), 0.0])
        return replace(loads, plane=(normal, 45.0 - self.near_mm))


@dataclass(frozen=True)
class Askew(Law):
    """R p + s."""

    NAME, STRONG, LIMIT = "mount", ("turn_deg", "shift_mm"), 4.0
    turn_deg: Numbers
    shift_mm: Numbers

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(tuple(rng.uniform(-1, 1, 3) * [1.5, 1.5, 1.0]), tuple(rng.uniform(-1, 1, 3)))

    def seen(self, points: Floats, t: Floats) -> Floats:
        return np.asarray(points @ turn(np.radians(self.turn_deg)).T + np.array(self.shift_mm))


@dataclass(frozen=True)
class Ruler(Law):
    """(1 + e) p, a little otherwise along the camera's axis."""

    NAME, STRONG, LIMIT = "scale", ("excess",), 4.0
    excess: float
    axis: Numbers

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        axis = rng.normal(size=3)
        return cls(0.03 * float(rng.choice([-1.0, 1.0])), tuple(axis / np.linalg.norm(axis)))

    def seen(self, points: Floats, t: Floats) -> Floats:
        axis = np.array(self.axis)
        return np.asarray(points + self.excess * (points - 0.1 * (points @ axis)[..., None] * axis))


@dataclass(frozen=True)
class Drifting(Law):
    """A camera that drifts: a smooth random walk through knots 20 s apart, from zero."""

    NAME, STRONG, LIMIT = "camera_drift", ("turn_deg", "shift_mm"), 5.0
    turn_deg: float
    shift_mm: float
    seed: int

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(0.5, 0.7, int(rng.integers(2**31)))

    def seen(self, points: Floats, t: Floats) -> Floats:
        from scipy.interpolate import PchipInterpolator

        rng = np.random.default_rng(self.seed)
        knots = np.arange(0.0, 1e3, 20.0)
        drift = rng.normal(size=6)  # mostly one way
        walk = np.cumsum(0.12 * drift + 0.12 * rng.normal(size=(len(knots), 6)), axis=0)
        walk -= walk[0]
        at = PchipInterpolator(knots, walk)(np.clip(t, 0.0, knots[-1]))
        turned = np.einsum("kij,knj->kni", turn(np.radians(self.turn_deg) * at[:, :3]), points)
        return np.asarray(turned + self.shift_mm * at[:, None, 3:])


BODY: dict[str, type[Law]] = chosen(
    (
        BoucWen,
        Prony,
        OgdenRoxburgh,
        Warm,
        Corner,
        OtherWeight,
        Hung,
        Falling,
        Sleeve,
        Half,
        Screw,
        Curled,
        Hinge,
        TurnedGuides,
        Wall,
        Askew,
        Ruler,
        Drifting,
    )
)
