"""The laws of hidden effects, one class per effect, independent of the effect library.

Each law differs in form from the effect of the same name in the library (after the semicolon):

    offset      horn mounted at an angle, rounded to encoder steps; rounding, sign per channel
    gain        spool radius that grows with the wound length; slightly curved, per channel
    lag         two poles in series (servo, then cable), exact for ramps; second order
    latency     bus packets at a fixed period, each with its own delay; sample and hold, jitter
    backlash    mean of eight plays of different width (friction-like); soft corners
    hysteresis  Bouc-Wen: z' = v (1 - |z|^n (1 + sgn(v z))/2), y = u - H z; differential law
    creep       three Kelvin-Voigt terms at τ/5, τ, 5τ; three terms
    gravity     density and mounting angle, solved in the finite elements; equilibrium
    payload     dead weight at the tip, solved in the finite elements; equilibrium
    mount       rigid rotation (Rodrigues) and shift of all points; exact rotation

Units: s, mm, g, degrees. Each law starts in equilibrium with its first command. `scaled(s)`
multiplies the strength and keeps the other parameters; `LIMIT` is the largest s that is plausible
for a real finger. Loops over time are in Python on purpose: they validate the compiled loops.
Pinned by `tests/synthetic/test_truth.py` against closed forms.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Numbers = tuple[float, ...]

NEWTON_PER_GRAM = 9.80665e-3


@dataclass(frozen=True)
class Law:
    """One hidden law; a subclass overrides the one method at its place in the chain."""

    NAME: ClassVar[str]
    LIMIT: ClassVar[float] = 2.0

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        """Draw the parameters at strength 1, near the middle of the plausible range."""
        raise NotImplementedError

    def scaled(self, s: float) -> Self:
        """Return the same law, s times as strong."""
        raise NotImplementedError

    def command(self, t: Floats, u: Floats) -> Floats:
        """Return the command that reaches the body: t (T,) s, u (T, C) mm → (T, C) mm."""
        return u

    def gravity(self, g: Floats) -> Floats:
        """Return the true weight vector for the declared g (3,), in g."""
        return g

    def force(self, g: Floats) -> Floats:
        """Return the force (3,) N at the tip under the declared g (3,)."""
        return np.zeros(3)

    def seen(self, points: Floats) -> Floats:
        """Return where points (..., 3) mm are seen."""
        return points

    def params(self) -> dict[str, float | list[float]]:
        """Return the parameters of the law, with units in their names."""
        return {
            k: [float(x) for x in v] if isinstance(v, tuple) else v for k, v in asdict(self).items()
        }


@dataclass(frozen=True)
class AskewHorn(Law):
    """y = round((u + b) r)/r: the horn is offset by b, the encoder counts r steps per mm."""

    NAME = "offset"
    shift_mm: Numbers
    steps_per_mm: float = 280.0

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(tuple(_spread(rng, channels)))

    def scaled(self, s: float) -> Self:
        return replace(self, shift_mm=tuple(s * x for x in self.shift_mm))

    def command(self, t: Floats, u: Floats) -> Floats:
        return np.asarray(
            np.round((u + np.array(self.shift_mm)) * self.steps_per_mm) / self.steps_per_mm
        )


@dataclass(frozen=True)
class OtherSpool(Law):
    """y = (1 + e) u + e k u²/2 per side: the radius is off by e and grows with the wound length."""

    NAME = "gain"
    radius_excess: Numbers
    growth_per_mm: float = 0.004

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(tuple(0.1 * _spread(rng, channels)))

    def scaled(self, s: float) -> Self:
        return replace(self, radius_excess=tuple(s * x for x in self.radius_excess))

    def command(self, t: Floats, u: Floats) -> Floats:
        excess = np.array(self.radius_excess)
        return np.asarray(u + excess * (u + 0.5 * self.growth_per_mm * u * np.abs(u)))


@dataclass(frozen=True)
class TwoPoles(Law):
    """Servo and cable, each x' = (in − x)/τ, in series; exact for linear pieces of commands."""

    NAME = "lag"
    servo_s: float
    cable_s: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(0.25, 0.25 * float(rng.uniform(0.15, 0.35)))

    def scaled(self, s: float) -> Self:
        return replace(self, servo_s=s * self.servo_s, cable_s=s * self.cable_s)

    def command(self, t: Floats, u: Floats) -> Floats:
        return _pole(t, _pole(t, u, self.servo_s), self.cable_s)


@dataclass(frozen=True)
class LatePackets(Law):
    """The servo holds the newest packet; packet k, sent at kΔ, has its own random delay."""

    NAME = "latency"
    delay_s: float
    period_s: float
    spread_s: float
    seed: int

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(0.16, 0.02, 0.006, int(rng.integers(2**31)))

    def scaled(self, s: float) -> Self:
        return replace(self, delay_s=s * self.delay_s)

    def command(self, t: Floats, u: Floats) -> Floats:
        sent = np.arange(t[0], t[-1] + self.period_s, self.period_s)
        late = self.delay_s + self.spread_s * np.random.default_rng(self.seed).uniform(
            -1.0, 1.0, sent.size
        )
        arrival = np.maximum.accumulate(sent + np.maximum(late, 0.0))
        newest = np.searchsorted(arrival, t, side="right") - 1
        packets = np.stack([np.interp(sent, t, u[:, c]) for c in range(u.shape[1])], axis=1)
        return np.where(newest[:, None] < 0, u[:1], packets[np.maximum(newest, 0)])


@dataclass(frozen=True)
class ManyPlays(Law):
    """Mean of eight plays y_j = clamp(y_j, u ± w_j) with half-widths spread about w."""

    NAME = "backlash"
    half_width_mm: Numbers
    spread: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(tuple(0.7 * rng.uniform(0.8, 1.25, channels)), float(rng.uniform(0.1, 0.3)))

    def scaled(self, s: float) -> Self:
        return replace(self, half_width_mm=tuple(s * x for x in self.half_width_mm))

    def command(self, t: Floats, u: Floats) -> Floats:
        share = 1.0 + self.spread * np.linspace(-1.0, 1.0, 8)
        half = np.outer(np.array(self.half_width_mm), share)  # (C, 8)
        play = np.repeat(u[0][:, None], 8, axis=1)
        out = np.empty_like(u)
        for k, now in enumerate(u):
            play = np.minimum(np.maximum(play, now[:, None] - half), now[:, None] + half)
            out[k] = play.mean(axis=1)
        return out


@dataclass(frozen=True)
class BoucWen(Law):
    """y = u − H z, z' = (u'/d0)(1 − |z|^n (1 + sgn(u' z))/2), in steps of at most d0/20."""

    NAME = "hysteresis"
    share: Numbers  # share of the motion that is lost after a reversal: H = share · d0
    saturation_mm: float  # d0
    sharpness: float  # n

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(
            tuple(0.25 * rng.uniform(0.85, 1.18, channels)),
            float(rng.uniform(3.0, 5.0)),
            float(rng.uniform(1.0, 1.5)),
        )

    def scaled(self, s: float) -> Self:
        return replace(self, share=tuple(s * x for x in self.share))

    def command(self, t: Floats, u: Floats) -> Floats:
        height = np.array(self.share) * self.saturation_mm
        z = np.zeros(u.shape[1])
        out = np.empty_like(u)
        out[0] = u[0]
        for k in range(1, len(u)):
            step = (u[k] - u[k - 1]) / self.saturation_mm
            parts = max(1, int(np.ceil(20.0 * float(np.max(np.abs(step))))))
            for _ in range(parts):
                z = z + step / parts * (
                    1.0 - np.abs(z) ** self.sharpness * (1.0 + np.sign(step * z)) / 2.0
                )
            out[k] = u[k] - height * z
        return out


@dataclass(frozen=True)
class ThreeTerms(Law):
    """y = u + c Σ wᵢ xᵢ, xᵢ' = (u − xᵢ)/τᵢ at τ/5, τ, 5τ: compliance that grows in a dwell."""

    NAME = "creep"
    LIMIT = 2.5
    compliance: Numbers
    middle_s: float
    weights: Numbers

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        weights = np.array([0.25, 0.5, 0.25]) * rng.uniform(0.8, 1.25, 3)
        return cls(
            tuple(0.12 * rng.uniform(0.85, 1.18, channels)),
            float(rng.uniform(4.0, 10.0)),
            tuple(weights / weights.sum()),
        )

    def scaled(self, s: float) -> Self:
        return replace(self, compliance=tuple(s * x for x in self.compliance))

    def command(self, t: Floats, u: Floats) -> Floats:
        late = np.zeros_like(u)
        for weight, factor in zip(self.weights, (0.2, 1.0, 5.0)):
            late += weight * (_pole(t, u, factor * self.middle_s) - u[0])
        return np.asarray(u + np.array(self.compliance) * (late + u[0]))


@dataclass(frozen=True)
class TrueWeight(Law):
    """g_true = (1 + e) R g: density off by e, the mounting askew by two angles."""

    NAME = "gravity"
    # Half or double the weight, 56 degrees: smaller changes move some fingers by less than 1 mm.
    LIMIT = 4.0
    density_excess: float
    askew_deg: Numbers  # about x and y of the base frame

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        angle = rng.uniform(0.0, 2 * np.pi)
        return cls(float(rng.uniform(-0.12, 0.3)), (14 * np.cos(angle), 14 * np.sin(angle)))

    def scaled(self, s: float) -> Self:
        return replace(
            self,
            density_excess=s * self.density_excess,
            askew_deg=tuple(s * x for x in self.askew_deg),
        )

    def gravity(self, g: Floats) -> Floats:
        return (1.0 + self.density_excess) * rotation((*self.askew_deg, 0.0)) @ g


@dataclass(frozen=True)
class TipWeight(Law):
    """A dead weight at the tip, pulling along the declared gravity."""

    NAME = "payload"
    LIMIT = 3.0
    mass_g: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(float(rng.uniform(8.0, 12.0)))

    def scaled(self, s: float) -> Self:
        return replace(self, mass_g=s * self.mass_g)

    def force(self, g: Floats) -> Floats:
        return self.mass_g * NEWTON_PER_GRAM * g


@dataclass(frozen=True)
class AskewBase(Law):
    """p_seen = R p + s: the base is not at the origin of the camera frame."""

    NAME = "mount"
    turn_deg: Numbers
    shift_mm: Numbers

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(
            tuple(rng.uniform(-1.0, 1.0, 3) * [1.5, 1.5, 1.0]), tuple(rng.uniform(-1.0, 1.0, 3))
        )

    def scaled(self, s: float) -> Self:
        return replace(
            self,
            turn_deg=tuple(s * x for x in self.turn_deg),
            shift_mm=tuple(s * x for x in self.shift_mm),
        )

    def seen(self, points: Floats) -> Floats:
        return np.asarray(points @ rotation(self.turn_deg).T + np.array(self.shift_mm))


# In the order of the chain: command, transmission, material, body, camera.
LAWS: dict[str, type[Law]] = {
    law.NAME: law
    for law in (
        LatePackets,
        TwoPoles,
        AskewHorn,
        OtherSpool,
        ManyPlays,
        BoucWen,
        ThreeTerms,
        TrueWeight,
        TipWeight,
        AskewBase,
    )
}


def rotation(degrees: Numbers) -> Floats:
    """Return the rotation matrix (3, 3) of a rotation vector in degrees.

    Rodrigues: I + sin a K + (1 − cos a) K².
    """
    vector = np.radians(np.asarray(degrees, dtype=np.float64))
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * (k @ k))


def _pole(t: Floats, u: Floats, tau: float) -> Floats:
    """Solve x' = (u − x)/τ exactly for u linear between samples, x(0) = u(0)."""
    out = np.empty_like(u)
    out[0] = x = u[0]
    step = np.diff(t)
    ratio = step / max(tau, 1e-9)
    keep = np.exp(-ratio)
    mean = np.where(ratio > 1e-12, -np.expm1(-ratio) / np.maximum(ratio, 1e-12), 1.0)
    for k in range(step.size):
        x = keep[k] * x + (mean[k] - keep[k]) * u[k] + (1.0 - mean[k]) * u[k + 1]
        out[k + 1] = x
    return out


def _spread(rng: np.random.Generator, channels: int) -> Floats:
    """Draw one number per channel: random signs, sizes within 0.5..1, the largest 1."""
    size = rng.uniform(0.5, 1.0, channels)
    return np.asarray(size / size.max() * rng.choice([-1.0, 1.0], channels), dtype=np.float64)
