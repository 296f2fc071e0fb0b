"""Drifts, chance, other robots and faulty drives; the list of all laws outside the library.

The list is in case order.

    frame_noise      the frame wanders, with a memory or as a random walk
    bending_noise    the body bends irregularly, with a memory or as a random walk
    timely_gain      gain along a line, a step or an exponential in time
    other_modulus, longer_body, mixed_channels   another robot than the model's
    still, stuck     the drive is off, or off for a part of the run

Units: s, mm. Randomness only from the given generator, or from a stored seed. Pinned by
tests/benches/test_bank_odd.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from benches.bank.law import Floats, Law, Numbers, Record
from benches.bank.laws_motion import (
    FadingMemory,
    Hooked,
    Hum,
    Overshoot,
    RateBend,
    RateSquare,
    Snap,
    SpeedyPlay,
    StickSlip,
    Stribeck,
    some,
)
from benches.bank.laws_wear import (
    BigCreep,
    Bimetal,
    Clutch,
    Fatigue,
    Held,
    MountedGain,
    Steps,
    Torn,
    WarmCreep,
    WarmPlay,
)
from benches.bank.rotations import turn
from benches.bank.section import Design


def wandering(t: Floats, memory_s: float, count: int, seed: int) -> Floats:
    """Return `count` Ornstein-Uhlenbeck processes of variance 1 at t (T,) s, from zero.

    It is a walk for infinite memory.

    A walk has the variance t/100 s.
    """
    rng = np.random.default_rng(seed)
    gap = np.diff(t, prepend=t[0])
    if np.isinf(memory_s):
        return np.asarray(
            np.cumsum(rng.normal(size=(len(t), count)) * np.sqrt(gap / 100.0)[:, None], axis=0)
        )
    out, state = np.empty((len(t), count)), rng.normal(size=count)
    for k, keep in enumerate(np.exp(-gap / memory_s)):
        state = keep * state + np.sqrt(1.0 - keep * keep) * rng.normal(size=count)
        out[k] = state
    return out - out[0] if memory_s > 2.0 else out


@dataclass(frozen=True)
class FrameNoise(Law):
    """The frame of the camera turns and shifts as `wandering`."""

    NAME, STRONG = "frame_noise", ("shift_mm", "turn_deg")
    shift_mm: float
    turn_deg: float
    memory_s: float
    seed: int

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        memory = float(rng.choice([10.0, 30.0, 80.0, np.inf]))
        return cls(0.4, 0.25, memory, int(rng.integers(2**31)))

    def seen(self, points: Floats, t: Floats) -> Floats:
        at = wandering(t, self.memory_s, 6, self.seed)
        turned = np.einsum("kij,knj->kni", turn(np.radians(self.turn_deg) * at[:, :3]), points)
        return np.asarray(turned + self.shift_mm * at[:, None, 3:])


@dataclass(frozen=True)
class BendingNoise(Law):
    """The body bends irregularly, as if commands wandered."""

    NAME, STRONG = "bending_noise", ("size_mm",)
    size_mm: Numbers
    memory_s: float
    seed: int

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        memory = float(rng.choice([0.02, 0.3, 3.0, 20.0, np.inf]))
        return cls(some(rng, channels), memory, int(rng.integers(2**31)))

    def drive(self, record: Record, u: Floats) -> Floats:
        return np.asarray(
            u + np.array(self.size_mm) * wandering(record.t, self.memory_s, u.shape[1], self.seed)
        )


def profile(kind: str, t: Floats) -> Floats:
    """Return a course (T,) from 0 to 1 in time: a `ramp`, a `step` or an `exponential` approach."""
    share = (t - t[0]) / max(float(np.ptp(t)), 1e-9)
    return np.asarray(
        {
            "ramp": share,
            "step": (share > 0.55).astype(float),
            "exponential": -np.expm1(-4.0 * share),
        }[kind]
    )


@dataclass(frozen=True)
class TimelyGain(Law):
    """u (1 + a p(t)), p as `profile`."""

    NAME, STRONG = "timely_gain", ("amount",)
    amount: float
    course: str

    @classmethod
    def of(cls, course: str, rng: np.random.Generator) -> Self:
        """Draw the amount for one course."""
        return cls(0.2 * float(rng.choice([-1.0, 1.0])), course)

    def drive(self, record: Record, u: Floats) -> Floats:
        return np.asarray(u * (1.0 + self.amount * profile(self.course, record.t))[:, None])


@dataclass(frozen=True)
class OtherModulus(Law):
    """Another silicone."""

    NAME, STRONG, SHAPE = "other_modulus", ("log",), True
    log: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(float(rng.choice([-0.6, 0.5]) * rng.uniform(0.7, 1.3)))

    def design(self, design: Design) -> Design:
        return design.stiffer(np.full(len(design.radius), np.exp(self.log)))


@dataclass(frozen=True)
class LongerBody(Law):
    """A body that is longer by a share, and thinner by its root."""

    NAME, STRONG, SHAPE = "longer_body", ("more",), True
    more: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(0.12 * float(rng.choice([-1.0, 1.0])))

    def design(self, design: Design) -> Design:
        return replace(
            design,
            place=design.place * (1.0 + self.more),
            radius=design.radius / np.sqrt(1.0 + self.more),
        )


@dataclass(frozen=True)
class MixedChannels(Law):
    """The horns are turned: each servo drives a part of the other's pair."""

    NAME, STRONG = "mixed_channels", ("turn_deg",)
    turn_deg: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(float(rng.choice([-1.0, 1.0]) * rng.uniform(12.0, 30.0)))

    def drive(self, record: Record, u: Floats) -> Floats:
        angle = np.radians(self.turn_deg)
        return np.asarray(
            np.cos(angle) * u + np.sin(angle) * np.roll(u, 1, axis=1) * np.array([-1.0, 1.0])
        )


@dataclass(frozen=True)
class Still(Law):
    """The drive was never engaged."""

    NAME, STRONG = "still", ()

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls()

    def drive(self, record: Record, u: Floats) -> Floats:
        return np.zeros_like(u)


@dataclass(frozen=True)
class Stuck(Law):
    """The drive stands still for a part of the run, then continues."""

    NAME, STRONG = "stuck", ()
    start: float
    share: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(float(rng.uniform(0.2, 0.5)), float(rng.uniform(0.15, 0.35)))

    def drive(self, record: Record, u: Floats) -> Floats:
        since = (record.t - record.t[0]) / np.ptp(record.t)
        rows = np.flatnonzero((since >= self.start) & (since < self.start + self.share))
        out = u.copy()
        out[rows] = u[rows[0]]
        return out


UNKNOWN_LAWS: tuple[type[Law], ...] = (
    Hum,
    StickSlip,
    WarmCreep,
    SpeedyPlay,
    RateSquare,
    MountedGain,
    Fatigue,
    Torn,
    Overshoot,
    Hooked,
    Stribeck,
    Snap,
    BigCreep,
    Bimetal,
    FadingMemory,
    RateBend,
    WarmPlay,
    Clutch,
    Held,
    Steps,
)
